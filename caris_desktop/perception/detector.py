"""What finds things in one picture: the interface of all detectors, which ``backends`` opens."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.translation import QT_TR_NOOP, filled
from caris_desktop.domain.value_class import dataclass
from caris_desktop.perception.weights import Weights, WeightsError

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


class DetectorAwayError(Exception):
    """A detector on another machine cannot be asked now; says why, without an end. Trying again may help."""


class Detector(Protocol):
    """For one thread. ``label`` is what the wizard reads."""

    label: str
    class_names: tuple[str, ...]

    def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
        """Everything above the least confidence in a picture: uint8 BGR, shape (height, width, 3)."""
        ...


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
        filled(QT_TR_NOOP("The detector {name} does not detect people"), name=weights.path.name),
        searched=(str(weights.path),),
        advice=QT_TR_NOOP("Choose a detector with a class named person"),
    )
