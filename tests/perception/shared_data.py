"""Paths of test data and weights outside the repository."""

import importlib.util
import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

_SHARED = Path(__file__).resolve().parents[3] / "shared"
_MODELS = Path(os.environ.get("CARIS_MODELS_DIR") or _SHARED / "models")

TUD_CAMPUS_VIDEO = _SHARED / "data" / "TUD-Campus" / "TUD-Campus.mp4"
TUD_CAMPUS_TRUTH = _SHARED / "data" / "TUD-Campus" / "gt.txt"
MOT_SCORE = _SHARED / "tools" / "mot_score.py"
INT8_WEIGHTS = _MODELS / "yolov8n_int8.tflite"
YOLOX_WEIGHTS = _MODELS / "yolox_nano_416x416.onnx"
OSNET_WEIGHTS = _MODELS / "osnet_x0_25_msmt17.onnx"

needs_tud_campus = pytest.mark.skipif(not TUD_CAMPUS_VIDEO.is_file(), reason=f"needs {TUD_CAMPUS_VIDEO}")
needs_int8_weights = pytest.mark.skipif(not INT8_WEIGHTS.is_file(), reason=f"needs {INT8_WEIGHTS}")


def bus_picture() -> NDArray[np.uint8]:
    """Photo of four people in front of a bus, shipped with ultralytics."""
    import cv2

    spec = importlib.util.find_spec("ultralytics")
    assert spec is not None
    assert spec.origin is not None
    image_bgr = cv2.imread(str(Path(spec.origin).parent / "assets" / "bus.jpg"))
    assert image_bgr is not None
    return np.asarray(image_bgr, dtype=np.uint8)
