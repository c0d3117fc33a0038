"""Where test data and weights are that the repository does not carry."""

import os
from pathlib import Path

import pytest

_SHARED = Path(__file__).resolve().parents[3] / "shared"
_MODELS = Path(os.environ.get("CARIS_MODELS_DIR") or _SHARED / "models")

TUD_CAMPUS_VIDEO = _SHARED / "data" / "TUD-Campus" / "TUD-Campus.mp4"
TUD_CAMPUS_TRUTH = _SHARED / "data" / "TUD-Campus" / "gt.txt"
MOT_SCORE = _SHARED / "tools" / "mot_score.py"
INT8_WEIGHTS = _MODELS / "yolov8n_int8.tflite"

needs_tud_campus = pytest.mark.skipif(not TUD_CAMPUS_VIDEO.is_file(), reason=f"needs {TUD_CAMPUS_VIDEO}")
needs_int8_weights = pytest.mark.skipif(not INT8_WEIGHTS.is_file(), reason=f"needs {INT8_WEIGHTS}")
