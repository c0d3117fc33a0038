"""Export of ultralytics .pt weights to ONNX networks for images of any size, offline."""

import contextlib
import copy
import hashlib
import importlib.util
import io
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.onnx_graph import with_metadata
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.perception.backends.network import UNDECODED
from caris_desktop.perception.backends.outputs import BINS, STRIDES_PX
from caris_desktop.perception.backends.ultralytics_runtime import load_model
from caris_desktop.perception.backends.ultralytics_setup import prepare_ultralytics
from caris_desktop.perception.weights import Weights

_OPSET = 17


class ModelExportError(Exception):
    """Weights that cannot be exported, with the reason."""


def export_onnx(weights: Weights, target: Path, *, threads: int) -> None:
    """Export ``weights`` to ``target`` atomically. Takes seconds.

    Raises
    ------
    ExportError
        Whatever the reason; also for a full disk.
    """
    prepare_ultralytics(threads=threads)
    try:
        content = _exported(load_model(weights))
        target.parent.mkdir(parents=True, exist_ok=True)
        replace_file(target, content, durable=False)
        checksum = f"{hashlib.sha256(content).hexdigest()}  {target.name}\n"
        replace_file(target.with_name(f"{target.name}.sha256"), checksum.encode(), durable=False)
    except ModelExportError:
        raise
    except Exception as error:  # torch raises its own types for failed exports
        raise ModelExportError(" ".join(f"{type(error).__name__}: {error}".split())) from error


def _exported(model: Any) -> bytes:
    import torch
    from ultralytics.nn.modules import C2f, Detect
    from ultralytics.nn.modules.head import OBB, Segment

    task, names = str(model.task), dict(model.names)
    network = copy.deepcopy(model.model).float().cpu().eval().fuse()
    head = network.model[-1]
    if not isinstance(head, Detect) or isinstance(head, Segment | OBB):
        raise ModelExportError(QT_TR_NOOP("it is not a bounding-box detector"))
    for part in network.modules():
        if isinstance(part, Detect):
            # Attributes that ultralytics' exporter sets.
            part.export, part.dynamic, part.format = True, True, "onnx"
            part.max_det, part.agnostic_nms, part.xyxy, part.shape = 300, False, False, None
        elif isinstance(part, C2f):
            part.forward = part.forward_split
    picture = torch.zeros(1, 3, 640, 640)
    dynamic = {"images": {2: "height", 3: "width"}}
    if not head.end2end:
        dynamic["output0"] = {2: "places"}
    undecoded = (
        type(head) is Detect and not head.end2end and head.reg_max == BINS and head.stride.tolist() == STRIDES_PX
    )
    if undecoded:
        # Without the nodes that decode all anchors, of which few matter; it saves a sixteenth of the time.
        head._inference = lambda found: torch.cat([found["boxes"], found["scores"]], 1)
    written = io.BytesIO()
    with torch.no_grad(), warnings.catch_warnings(), _without_onnx_package():
        warnings.simplefilter("ignore")
        for _ in range(2):
            network(picture)
        torch.onnx.export(
            network,
            (picture,),
            written,
            dynamo=False,
            opset_version=_OPSET,
            input_names=["images"],
            output_names=["output0"],
            dynamic_axes=dynamic,
        )
    metadata = {UNDECODED: "true"} if undecoded else {}
    metadata |= {"task": task, "names": repr(names), "stride": str(int(max(network.stride)))}
    if task == "pose":
        metadata["kpt_shape"] = repr([int(number) for number in head.kpt_shape])
    return with_metadata(written.getvalue(), metadata)


@contextlib.contextmanager
def _without_onnx_package() -> Iterator[None]:
    """Disable torch's only step that needs the package onnx, which adds functions that no detector has."""
    if importlib.util.find_spec("onnx") is not None:
        yield
        return
    from torch.onnx._internal.torchscript_exporter import onnx_proto_utils

    step = onnx_proto_utils._add_onnxscript_fn
    onnx_proto_utils._add_onnxscript_fn = lambda content, _opsets: content
    try:
        yield
    finally:
        onnx_proto_utils._add_onnxscript_fn = step
