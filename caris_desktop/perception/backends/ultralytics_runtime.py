"""Detector run by ultralytics: .pt weights, and networks with an unknown output format."""

import contextlib
import copy
import hashlib
import importlib
import importlib.machinery
import importlib.util
import io
import logging
import os
import sys
import types
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.model_files import onnx_options
from caris_desktop.domain.onnx_graph import with_metadata
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.perception.backends.network import (
    BINS,
    KEYPOINTS,
    STRIDES_PX,
    UNDECODED,
    person_groups,
    suppress,
)
from caris_desktop.perception.detector import Detections
from caris_desktop.perception.weights import Weights

log = logging.getLogger(__name__)


def prepare_runtimes(*, threads: int) -> None:
    """Limit the threads of onnxruntime and cv2. Call before their first use."""
    os.environ["OMP_NUM_THREADS"] = str(threads)

    import cv2

    cv2.setNumThreads(threads)


def prepare_ultralytics(*, threads: int, cache_dir: Path | None = None) -> None:
    """Prepare the import of ultralytics and torch. Call before the first one; once is enough.

    Parameters
    ----------
    threads
        Threads that one inference may use, at least 1, whatever runtime the weights need.
    cache_dir
        Where ultralytics keeps its settings and fonts; the user's cache folder when None.
    """
    if "ultralytics" in sys.modules:
        return
    if cache_dir is None:
        import platformdirs

        cache_dir = platformdirs.user_cache_path("caris-desktop", appauthor=False) / "ultralytics"
    cache_dir.mkdir(parents=True, exist_ok=True)
    os.environ["YOLO_CONFIG_DIR"] = str(cache_dir)
    os.environ["YOLO_OFFLINE"] = "true"
    os.environ["YOLO_AUTOINSTALL"] = "false"
    os.environ["YOLO_VERBOSE"] = "false"
    # A .pt is a pickle: it may contain only the classes that models consist of.
    os.environ["ULTRALYTICS_SAFE_LOAD"] = "true"
    prepare_runtimes(threads=threads)

    import torch

    torch.set_num_threads(threads)
    ensure_torchvision()

    import ultralytics.utils

    if ultralytics.utils.SETTINGS["sync"]:
        ultralytics.utils.SETTINGS.update({"sync": False})
    _limit_runtimes(threads)


def ensure_torchvision() -> bool:
    """Replace a torchvision that does not load by a stand-in. True if the real one loads.

    A torchvision built for CUDA does not load with a CPU build of torch. Ultralytics needs it only for non-maximum
    suppression, which it also implements itself.
    """
    try:
        importlib.import_module("torchvision")
    except (ImportError, RuntimeError, OSError) as error:
        log.info("torchvision does not load (%s); using ultralytics' own suppression", error)
        for name in [name for name in sys.modules if name.split(".")[0] == "torchvision"]:
            del sys.modules[name]
        sys.modules.update(_torchvision_stand_in())
        return False
    return True


def _torchvision_stand_in() -> dict[str, types.ModuleType]:
    def nms(boxes: Any, scores: Any, iou_threshold: float) -> Any:
        from ultralytics.utils.nms import TorchNMS

        return TorchNMS.nms(boxes, scores, iou_threshold)

    package, ops = types.ModuleType("torchvision"), types.ModuleType("torchvision.ops")
    for module in (package, ops):
        module.__spec__ = importlib.machinery.ModuleSpec(module.__name__, None)
    package.__path__ = []
    vars(ops)["nms"] = nms
    vars(package)["ops"] = ops
    return {"torchvision": package, "torchvision.ops": ops}


def _limit_runtimes(threads: int) -> None:
    """Limit the threads of runtimes that ultralytics opens itself, which has no setting for them."""
    from ultralytics.nn import autobackend
    from ultralytics.nn.backends import litert
    from ultralytics.nn.backends.onnx import ONNXBackend

    class QuietOnnxBackend(ONNXBackend):  # type: ignore[misc]  # ultralytics is untyped
        def __init__(self, weight: Any, device: Any, fp16: bool = False) -> None:
            super().__init__(weight, device, fp16, session_options=onnx_options(threads))

    litert.NUM_THREADS = threads
    autobackend.AutoBackend._BACKEND_MAP["onnx"] = QuietOnnxBackend


def torch_device(device: str) -> str:
    """torch device: the wanted one if available, for ``auto`` the best available."""
    import torch

    cuda, mps = torch.cuda.is_available(), torch.backends.mps.is_available()
    if device in ("auto", "cuda") and cuda:
        return "cuda:0"
    return "mps" if device in ("auto", "mps") and mps else "cpu"


class UltralyticsDetector:
    """``Detector`` by ultralytics. Raises what torch, onnxruntime or tflite raise for a bad file."""

    def __init__(self, weights: Weights, *, confidence: float, threads: int, device: str = "auto") -> None:
        prepare_ultralytics(threads=threads)
        where = torch_device(device)
        self._arguments: dict[str, Any] = {
            "conf": confidence,
            "imgsz": weights.input_px,
            "device": where,
            "verbose": False,
        }
        self._model = load_model(weights)
        # Warm-up: the first frame is much slower, and includes loading.
        self._model.predict(np.full((480, 640, 3), 114, np.uint8), **self._arguments)
        names: dict[int, str] = self._model.predictor.model.names
        self.class_names = tuple(names.get(number, "") for number in range(max(names, default=-1) + 1))
        runtime = "torch" if weights.path.suffix == ".pt" else "ultralytics"
        self.label = f"{weights.label}, {runtime} on {_SHOWN[where.split(':', maxsplit=1)[0]]}, {weights.input_px} px"
        self._groups = person_groups(self.class_names, weights.person_class_names)

    def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
        if not image_bgr.size:
            return Detections(np.zeros((0, 4)), np.zeros(0), np.zeros(0, np.int64))
        result = self._model.predict(image_bgr, **self._arguments)[0]
        boxes = result.boxes
        points = None if result.keypoints is None else result.keypoints.data.numpy(force=True).astype(np.float64)
        height_px, width_px = image_bgr.shape[:2]
        return suppress(
            Detections(
                boxes.xyxy.numpy(force=True).astype(np.float64).clip(0, [width_px, height_px, width_px, height_px]),
                boxes.conf.numpy(force=True).astype(np.float64),
                boxes.cls.numpy(force=True).astype(np.int64),
                points if points is not None and points.shape[1:] == (KEYPOINTS, 3) else None,
            ),
            self._groups,
        )


_SHOWN = {"cpu": "CPU", "cuda": "CUDA", "mps": "MPS"}


def load_model(weights: Weights) -> Any:
    """Load weights as ultralytics' ``YOLO``, after :func:`prepare_ultralytics`.

    A .pt is a pickle. It is restricted to the classes that such models consist of; only a file that the user named on
    the command line may contain other code.
    """
    from ultralytics import YOLO
    from ultralytics.nn import tasks

    if weights.path.suffix.lower() != ".pt":
        return YOLO(str(weights.path), task="detect")
    if not weights.may_run_code and not tasks._SafeLoad.SUPPORTED:
        raise RuntimeError("this version of torch cannot load a .pt file without running its code")
    # An import of ultralytics without its environment variable left this False.
    tasks.SAFE_LOAD = True
    try:
        return YOLO(str(weights.path))
    except Exception:
        if not weights.may_run_code:
            raise
    log.warning("%s brings code of its maker. It is run, because the command line names this file", weights.path)
    tasks.SAFE_LOAD = False
    try:
        return YOLO(str(weights.path))
    finally:
        tasks.SAFE_LOAD = True


# Export of ultralytics .pt weights to ONNX networks for images of any size, offline.

_OPSET = 17


class ModelExportError(Exception):
    """Weights that cannot be exported, with the reason."""


def export_onnx(weights: Weights, target: Path, *, threads: int) -> None:
    """Export ``weights`` to ``target`` atomically. Takes seconds.

    Raises
    ------
    ModelExportError
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
