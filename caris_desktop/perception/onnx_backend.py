"""Runs ONNX detectors for ultralytics: with threads that sleep instead of spin, and smaller than they were exported."""

import logging
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.perception.onnx_graph import cut_graph

log = logging.getLogger(__name__)

# YOLOv8's detection head before its boxes are decoded: (1, 4 * bins + classes, places).
_RAW_HEAD = "/model.22/Concat_3_output_0"
_STRIDES_PX = (8, 16, 32)
_BINS = 16
# Places less certain than this are left out; nobody asks a detector for less.
_CONFIDENCE_FLOOR = 0.01


def onnx_backend_class(*, threads: int) -> type[Any]:
    """An ultralytics backend class whose onnxruntime session uses at most ``threads`` threads.

    A YOLOv8 detector that was exported for one input size is opened for any size.
    """
    import onnxruntime
    from ultralytics.nn.backends.onnx import ONNXBackend

    class QuietOnnxBackend(ONNXBackend):  # type: ignore[misc]  # ultralytics is untyped
        def __init__(self, weight: Any, device: Any, fp16: bool = False) -> None:
            options = onnxruntime.SessionOptions()
            options.intra_op_num_threads = threads
            options.inter_op_num_threads = 1
            # Spinning threads were measured to delay another process on two cores by up to 11 ms.
            options.add_session_config_entry("session.intra_op.allow_spinning", "0")
            self._decodes = False
            super().__init__(weight, device, fp16, session_options=options)

        def load_model(self, weight: Any) -> None:
            # On a GPU the exported size costs little, and ultralytics knows the providers.
            session = self._resizable_session(Path(weight)) if self.device.type == "cpu" else None
            if session is None:
                super().load_model(weight)
                return
            self.apply_metadata(self.read_metadata(weight))
            self.session = session
            self.output_names = [_RAW_HEAD]
            self.dynamic = self.metadata["dynamic"] = True
            self.fp16 = self.use_io_binding = False
            self._decodes = True

        def _resizable_session(self, path: Path) -> Any:
            resizable = _resizable(path)
            if resizable is None:
                return None
            session = onnxruntime.InferenceSession(resizable, self.session_options, providers=["CPUExecutionProvider"])
            (shape,) = (output.shape for output in session.get_outputs())
            return session if len(shape) == 3 and isinstance(shape[1], int) and shape[1] > 4 * _BINS else None

        def forward(self, im: Any) -> Any:
            outputs = super().forward(im)
            return decode(outputs[0], height_px=im.shape[2], width_px=im.shape[3]) if self._decodes else outputs

    return QuietOnnxBackend


def _resizable(path: Path) -> bytes | None:
    """The model without its last nodes, for input of any size; None when it is not of the kind that allows this."""
    try:
        return cut_graph(path.read_bytes(), output=_RAW_HEAD, input_dims=(1, 3, "height", "width"))
    except ValueError as error:
        log.info("%s keeps the input size that it was exported for: %s", path.name, error)
        return None


def decode(raw: NDArray[np.float32], *, height_px: int, width_px: int) -> NDArray[np.float32]:
    """What the left-out nodes of a YOLOv8 head compute.

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
    floor = np.log(_CONFIDENCE_FLOOR / (1.0 - _CONFIDENCE_FLOOR))
    kept = np.flatnonzero(class_logits.max(axis=0) > floor)
    places_xy, stride_px = _places(height_px, width_px)
    places_xy, stride_px = places_xy[:, kept], stride_px[kept]
    weights = raw[0, : 4 * _BINS, kept].T.reshape(4, _BINS, len(kept))
    weights = np.exp(weights - weights.max(axis=1, keepdims=True))
    bins = np.arange(_BINS, dtype=np.float32)[:, np.newaxis]
    distances = (weights * bins).sum(axis=1) / weights.sum(axis=1)
    near, far = places_xy - distances[:2], places_xy + distances[2:]
    boxes = np.concatenate([(near + far) / 2.0, far - near]) * stride_px
    probabilities = 1.0 / (1.0 + np.exp(-class_logits[:, kept]))
    return np.concatenate([boxes, probabilities])[np.newaxis].astype(np.float32)


@lru_cache(maxsize=4)
def _places(height_px: int, width_px: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Centres of the head's cells in units of their stride, shape (2, places), and the stride of each."""
    centres, strides = [], []
    for stride_px in _STRIDES_PX:
        rows, columns = np.mgrid[0 : height_px // stride_px, 0 : width_px // stride_px]
        centres.append(np.stack([columns.ravel(), rows.ravel()]) + 0.5)
        strides.append(np.full(rows.size, stride_px))
    return np.concatenate(centres, axis=1).astype(np.float32), np.concatenate(strides).astype(np.float32)
