"""ONNX networks by onnxruntime: with threads that sleep instead of spin, and smaller than they were exported."""

import logging
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.perception.backends.network import ModelFacts, UnknownFormError, facts_of
from caris_desktop.perception.backends.onnx_graph import cut_graph, describe
from caris_desktop.perception.backends.outputs import places

log = logging.getLogger(__name__)

# The detection head of YOLOv8, 9 and 11 before its boxes are decoded: (1, 4 * bins + classes, places).
_RAW_HEAD = re.compile(r"/model\.\d+/Concat_3_output_0")
_BINS = 16
_CUDA, _CPU = "CUDAExecutionProvider", "CPUExecutionProvider"


def session_options(threads: int) -> Any:
    """At most this many threads, none of which spins: that delayed other processes on two cores by up to 11 ms."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 3
    return options


class OnnxNetwork:
    """A ``Network``. One that was exported for a single input size is opened for any, where its head is known.

    ``confidence`` is the least that anybody will ask of it. Raises UnknownFormError, and what onnxruntime raises for
    a bad file.
    """

    channels_last = False
    relative = False

    def __init__(self, path: Path, *, confidence: float, threads: int, device: str = "cpu") -> None:
        import onnxruntime

        options = session_options(threads)
        on_gpu = device in ("auto", "cuda") and _CUDA in onnxruntime.get_available_providers()
        content = path.read_bytes()
        # On a GPU the exported size costs little.
        cut = None if on_gpu else _resizable(path, content, options)
        self._floor = min(max(confidence, 1e-6), 0.5) if cut is not None else None
        self._session = cut or onnxruntime.InferenceSession(
            content, options, providers=[_CUDA, _CPU] if on_gpu else [_CPU]
        )
        on_gpu = _CUDA in self._session.get_providers()
        (taken, *more) = self._session.get_inputs()
        if more or taken.type not in ("tensor(float)", "tensor(float16)") or len(taken.shape) != 4:
            raise UnknownFormError("it takes something else than one picture")
        self.facts: ModelFacts = facts_of(self._session.get_modelmeta().custom_metadata_map)
        self.runtime = f"onnxruntime on {'CUDA' if on_gpu else 'CPU'}"
        self._input, self._type = taken.name, np.float16 if taken.type == "tensor(float16)" else np.float32
        height, width = taken.shape[2:]
        fixed = isinstance(height, int) and isinstance(width, int)
        self.fixed_size: tuple[int, int] | None = (height, width) if fixed else None
        self._output = self._session.get_outputs()[0].name

    def run(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        (output,) = self._session.run([self._output], {self._input: values.astype(self._type, copy=False)})
        if self._floor is not None:
            return decode(output, height_px=values.shape[2], width_px=values.shape[3], confidence=self._floor)
        result: NDArray[np.float32] = output.astype(np.float32, copy=False)
        return result


def _resizable(path: Path, content: bytes, options: Any) -> Any:
    """A session of the network without its last nodes, for input of any size; None where its head is not known."""
    import onnxruntime

    try:
        known = describe(content)
        heads = [name for name in known.tensors if _RAW_HEAD.fullmatch(name)]
        facts = facts_of(known.metadata)
        if len(heads) != 1 or None in known.input_dims[2:] or facts.keypoint_values or not facts.class_names:
            return None
        cut = cut_graph(content, output=heads[0], input_dims=(1, 3, "height", "width"))
        session = onnxruntime.InferenceSession(cut, options, providers=[_CPU])
    except Exception as error:  # onnxruntime has types of its own
        log.info("%s keeps the input size that it was exported for: %s", path.name, error)
        return None
    (shape,) = (output.shape for output in session.get_outputs())
    return session if len(shape) == 3 and shape[1] == 4 * _BINS + len(facts.class_names) else None


def decode(raw: NDArray[np.float32], *, height_px: int, width_px: int, confidence: float) -> NDArray[np.float32]:
    """What the left-out nodes of such a head compute, for the places that are surer than ``confidence``.

    Parameters
    ----------
    raw
        Shape (1, 64 + classes, places): for each side of the box the logits of its distance from the place, in 16
        bins of one stride, then the logits of the classes.
    height_px, width_px
        Size of the network's input, multiples of 32.

    Returns
    -------
    Shape (1, 4 + classes, kept places): centre x and y, width and height in pixels of the input, class probabilities.
    """
    class_logits = raw[0, 4 * _BINS :]
    kept = np.flatnonzero(class_logits.max(axis=0) > np.log(confidence / (1.0 - confidence)))
    places_xy, stride_px = places(height_px, width_px)
    places_xy, stride_px = places_xy[:, kept], stride_px[kept]
    weights = raw[0, : 4 * _BINS, kept].T.reshape(4, _BINS, len(kept))
    weights = np.exp(weights - weights.max(axis=1, keepdims=True))
    bins = np.arange(_BINS, dtype=np.float32)[:, np.newaxis]
    distances = (weights * bins).sum(axis=1) / weights.sum(axis=1)
    near, far = places_xy - distances[:2], places_xy + distances[2:]
    boxes = np.concatenate([(near + far) / 2.0, far - near]) * stride_px
    probabilities = 1.0 / (1.0 + np.exp(-class_logits[:, kept]))
    return np.concatenate([boxes, probabilities])[np.newaxis].astype(np.float32)
