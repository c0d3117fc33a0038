"""Detector interface, implemented in ``backends``."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.perception.weights import Weights, WeightsError

_COCO_CLASS_COUNT = 80


class Detections(Value, eq=False):
    """Detections in one image, in no particular order.

    ``corners_px`` is left, top, right, bottom inside the image, shape (n, 4); ``confidences`` and ``classes`` (rows of
    the detector's ``class_names``) have shape (n,). ``keypoints`` is x, y in pixels and visibility of COCO's 17, shape
    (n, 17, 3), None if unsupported.
    """

    corners_px: NDArray[np.float64]
    confidences: NDArray[np.float64]
    classes: NDArray[np.int64]
    keypoints: NDArray[np.float64] | None = None


class DetectorAwayError(Exception):
    """A remote detector is unavailable; the reason as a phrase. A retry may succeed."""


class Detector(Protocol):
    """For one thread. ``label`` is displayed to the wizard."""

    label: str
    class_names: tuple[str, ...]

    def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
        """Detections above the confidence threshold in an image: uint8 BGR, shape (height, width, 3)."""
        ...


def person_classes(detector: Detector, weights: Weights) -> tuple[int, ...]:
    """Classes of the detector that mean a person.

    Raises
    ------
    WeightsError
        When none does.
    """
    names = detector.class_names
    lowered = {name.lower() for name in weights.person_class_names}
    classes = tuple(number for number, name in enumerate(names) if name.lower() in lowered)
    if classes:
        return classes
    unnamed = all(name == f"class{number}" for number, name in enumerate(names))
    if unnamed and len(names) >= _COCO_CLASS_COUNT:
        return (0,)
    raise WeightsError(
        localized(QT_TR_NOOP("The detector {name} does not detect people"), name=weights.path.name),
        searched=(str(weights.path),),
        advice=QT_TR_NOOP("Choose a detector with a class named person"),
    )
