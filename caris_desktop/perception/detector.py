"""Finds things in one picture: the interface of detectors, and ultralytics' behind it."""

import logging
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.perception.weights import Weights, WeightsError

log = logging.getLogger(__name__)

_COCO_CLASS_COUNT = 80


@dataclass(frozen=True, slots=True, eq=False)
class Detections:
    """What was found in one picture, in no particular order.

    ``corners_px`` is left, top, right, bottom inside the picture, shape (n, 4); ``confidences`` and ``classes`` (rows
    of the detector's ``class_names``) have shape (n,). ``keypoints`` is x, y in pixels and visibility of the 17 of
    COCO, shape (n, 17, 3), None from a detector that knows none.
    """

    corners_px: NDArray[np.float64]
    confidences: NDArray[np.float64]
    classes: NDArray[np.int64]
    keypoints: NDArray[np.float64] | None = None


class Detector(Protocol):
    """For one thread. ``label`` is what the wizard reads."""

    label: str
    class_names: tuple[str, ...]

    def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
        """Everything above the least confidence in a picture: uint8 BGR, shape (height, width, 3)."""
        ...


def open_detector(weights: Weights, *, confidence: float, threads: int) -> Detector:
    """Load and warm up a detector, which takes seconds. ``confidence`` is the least that it tells of.

    Raises
    ------
    WeightsError
        When the file cannot be loaded.
    """
    try:
        return UltralyticsDetector(weights, confidence=confidence, threads=threads)
    except Exception as error:  # torch, onnxruntime and tflite each raise types of their own for a bad file
        log.exception("could not load %s", weights.path)
        raise WeightsError(
            f"The detector {weights.path.name} could not be loaded",
            searched=(str(weights.path),),
            advice="Replace the file by an intact YOLO detector; the log has the details",
        ) from error


def person_classes(detector: Detector, weights: Weights) -> tuple[int, ...]:
    """Which classes of the detector mean a person.

    Raises
    ------
    WeightsError
        When none does.
    """
    names = detector.class_names
    wanted = {name.lower() for name in weights.person_class_names}
    classes = tuple(number for number, name in enumerate(names) if name.lower() in wanted)
    if classes:
        return classes
    unnamed = all(name == f"class{number}" for number, name in enumerate(names))
    if unnamed and len(names) >= _COCO_CLASS_COUNT:
        return (0,)
    raise WeightsError(
        f"The detector {weights.path.name} does not detect people",
        searched=(str(weights.path),),
        advice="Choose a detector with a class named person",
    )


class UltralyticsDetector:
    """Whatever ultralytics opens, run by ultralytics. Raises what torch, onnxruntime or tflite raise for a bad file."""

    def __init__(self, weights: Weights, *, confidence: float, threads: int) -> None:
        from caris_desktop.perception.ultralytics_setup import prepare_ultralytics

        prepare_ultralytics(threads=threads)
        from ultralytics import YOLO

        self._arguments: dict[str, Any] = {
            "conf": confidence,
            "imgsz": weights.input_px,
            "device": None,
            "verbose": False,
        }
        self._model = YOLO(str(weights.path), task="detect")
        # The first frame is many times slower than the rest, and loading happens in it.
        self._model.predict(np.full((480, 640, 3), 114, np.uint8), **self._arguments)
        names: dict[int, str] = self._model.predictor.model.names
        self.label = weights.label
        self.class_names = tuple(names.get(number, "") for number in range(max(names, default=-1) + 1))

    def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
        boxes = self._model.predict(image_bgr, **self._arguments)[0].boxes
        height_px, width_px = image_bgr.shape[:2]
        return Detections(
            boxes.xyxy.numpy(force=True).astype(np.float64).clip(0, [width_px, height_px, width_px, height_px]),
            boxes.conf.numpy(force=True).astype(np.float64),
            boxes.cls.numpy(force=True).astype(np.int64),
        )
