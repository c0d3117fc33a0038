"""How somebody looks, as a vector: crops of people through a re-identification network (OSNet's form, ONNX)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH_PX, HEIGHT_PX = 128, 256
# ImageNet's, in RGB. Fed with pictures that are only scaled, OSNet recognises half as many.
_MEAN = np.array([0.485, 0.456, 0.406], np.float32)
_DEVIATION = np.array([0.229, 0.224, 0.225], np.float32)


class AppearanceModel:
    """For one thread. Raises whatever onnxruntime raises for a file that is no such network."""

    def __init__(self, path: Path, *, threads: int = 1) -> None:
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = threads
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        self._session: Any = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        self._input = self._session.get_inputs()[0].name

    def look(self, image_bgr: NDArray[np.uint8], corners_px: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """One row of unit length for each box (left, top, right, bottom), shape (boxes, length of a vector)."""
        crops = np.stack([_crop(image_bgr, corners) for corners in corners_px])
        vectors = np.asarray(self._session.run(None, {self._input: crops})[0], np.float64)
        return np.asarray(vectors / np.maximum(1e-12, np.linalg.norm(vectors, axis=1, keepdims=True)))


def _crop(image_bgr: NDArray[np.uint8], corners: NDArray[np.float64]) -> NDArray[np.float32]:
    height, width = image_bgr.shape[:2]
    left, top, right, bottom = corners.round().astype(int)
    left, top = min(max(left, 0), width - 1), min(max(top, 0), height - 1)
    right, bottom = min(max(right, left + 1), width), min(max(bottom, top + 1), height)
    crop = cv2.resize(image_bgr[top:bottom, left:right], (WIDTH_PX, HEIGHT_PX), interpolation=cv2.INTER_LINEAR)
    rgb = crop[:, :, ::-1].astype(np.float32) / 255.0
    return np.ascontiguousarray(((rgb - _MEAN) / _DEVIATION).transpose(2, 0, 1))
