"""Detector interface, implemented in ``backends``."""

from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.plugins import CALL_WITHIN_S, LOAD_WITHIN_S, Plugin, PluginCall, PluginError, load, watched
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

    def at(self, rows: Any) -> "Detections":
        """Subset by row numbers or mask."""
        keypoints = None if self.keypoints is None else self.keypoints[rows]
        return Detections(self.corners_px[rows], self.confidences[rows], self.classes[rows], keypoints)


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


# Interface of person detectors for plug-ins of the group ``caris_desktop.detectors``, and what calls them.

Found = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]
_FIRST_WITHIN_S = 20.0


class DetectorPlugin(Protocol):
    """Person detector: a class with the attribute ``caris_interface = 1``, called as
    ``DetectorPlugin(confidence=0.1, threads=2)``: the least confidence that matters, and how many threads it may use.

    One instance is made in the process that detects people (the console's, or that of a command), within a minute with
    the import, and called in one thread of it with the pictures of all cameras in turn. The process is not the
    window's, the robot link's or the recorder's: none of them waits for a detector. As soon as :meth:`detect` has
    returned, the newest picture follows: 50 ms are good, and after five seconds (twenty for the first picture) the
    process is ended. Pictures do not leave this computer: a detector that sends them elsewhere says so in its
    description, and is not for scenarios with ``cloud_models: false``.

    A detector that raises, is too slow, prints, ends its process, or returns anything else than what is described here
    is switched off until the program is started again, and the wizard is told its name; the usual detector takes its
    place. Log with :mod:`logging`.
    """

    caris_interface: ClassVar[int]
    class_names: Sequence[str]
    """Names of the classes that it finds, among them ``person``."""

    def detect(self, image_bgr: NDArray[np.uint8]) -> Found:
        """Return corners, confidences and classes of what is in a picture: uint8, (height, width, 3), read-only.

        Corners are left, top, right, bottom in pixels of this picture, numbers of shape (n, 4), finite; confidences are
        0..1, shape (n,); classes are rows of ``class_names``, shape (n,). No order; one box for each person.
        """
        ...


class WatchedDetector:
    """A plug-in as detector of this program. Raises PluginError, also when it is made."""

    def __init__(
        self, plugin: Plugin, *, confidence: float, threads: int, notify: Callable[[PluginCall], None]
    ) -> None:
        self.plugin = plugin
        self._notify = notify
        self._confidence = confidence
        self._within_s = _FIRST_WITHIN_S
        with watched(plugin, notify, LOAD_WITHIN_S):
            self._detector: DetectorPlugin = load(plugin)(confidence=confidence, threads=threads)
            self.class_names = tuple(str(name) for name in self._detector.class_names)
        self.label = f"{plugin.name} ({plugin.package})"
        self.people = tuple(row for row, name in enumerate(self.class_names) if name.lower() == "person")
        if not self.people:
            raise PluginError(plugin, QT_TR_NOOP("none of its classes is named person"))

    def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
        image_bgr = image_bgr.view()
        image_bgr.flags.writeable = False
        with watched(self.plugin, self._notify, self._within_s):
            found = self._detector.detect(image_bgr)
            detections = checked_detections(self.plugin, found, image_bgr.shape[:2], len(self.class_names))
        self._within_s = CALL_WITHIN_S
        return detections.at(detections.confidences >= self._confidence)


def checked_detections(plugin: Plugin, found: object, size_px: tuple[int, ...], classes: int) -> Detections:
    """What a detector returned, inside the picture. Raises PluginError if it is not what the interface says."""
    try:
        corners, sure, kinds = cast("Sequence[Any]", found)
        corners_px, confidences = np.array(corners, np.float64).reshape(-1, 4), np.array(sure, np.float64)
        classes_found = np.array(kinds)
    except (TypeError, ValueError) as error:
        raise PluginError(plugin, QT_TR_NOOP("it did not return corners, confidences and classes")) from error
    count = len(corners_px)
    if confidences.shape != (count,) or classes_found.shape != (count,):
        raise PluginError(plugin, QT_TR_NOOP("corners, confidences and classes are not of one length"))
    if not np.isfinite(corners_px).all() or not ((confidences >= 0.0) & (confidences <= 1.0)).all():
        raise PluginError(plugin, QT_TR_NOOP("it returned corners that are no numbers, or a confidence beyond 0 to 1"))
    if count and (classes_found.dtype.kind not in "iu" or classes_found.min() < 0 or classes_found.max() >= classes):
        raise PluginError(plugin, QT_TR_NOOP("it returned classes that it does not name"))
    height_px, width_px = size_px[:2]
    corners_px = np.clip(corners_px, 0.0, [width_px, height_px, width_px, height_px])
    return Detections(corners_px, confidences, classes_found.astype(np.int64))
