"""From a picture to the people in it: detector, tracker, looks and portraits as one, for the console and offline."""

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.people import PersonPortrait
from caris_desktop.perception.appearance import AppearanceError, AppearanceModel, find_appearance
from caris_desktop.perception.backends.opening import open_detector
from caris_desktop.perception.detector import Detections, Detector, person_classes
from caris_desktop.perception.portraits import Portraits
from caris_desktop.perception.tracker import Look, PersonTracker, TrackedBox, TrackerName
from caris_desktop.perception.weights import Weights, find_weights, models_dirs

LEAST_CONFIDENCE = 0.1
"""Below it nobody is told of; who is followed may be hardly seen for a while, who is new may not."""


@dataclass(frozen=True, slots=True)
class Perceived:
    """What was found in one picture. ``boxes`` are the people among ``detections``."""

    boxes: list[TrackedBox]
    portraits: list[PersonPortrait]
    detections: Detections
    detector_s: float
    tracker_s: float


class Perceiver:
    """For one thread. ``label`` is the detector's; ``looks_model`` names the network that tells how people look, empty
    without one.
    """

    def __init__(self, detector: Detector, tracker: PersonTracker, looks_model: str, *, trouble: str = "") -> None:
        self.label = detector.label
        self.looks_model = looks_model
        self.trouble = trouble
        """What could not be opened and can be done without, in a sentence; empty if nothing."""
        self._detector = detector
        self._tracker = tracker
        self._portraits = Portraits()

    def perceive(self, image_bgr: NDArray[np.uint8], look: Look) -> Perceived:
        """Take in the next picture of a camera: uint8 BGR, shape (height, width, 3)."""
        began_s = time.perf_counter()
        detections = self._detector.detect(image_bgr)
        detected_s = time.perf_counter()
        boxes = self._tracker.track(detections, image_bgr, look)
        tracked_s = time.perf_counter()
        portraits = self._portraits.taken(image_bgr, look.frame, boxes)
        return Perceived(boxes, portraits, detections, detected_s - began_s, tracked_s - detected_s)


def open_perceiver(
    weights_path: Path | None,
    *,
    tracker: TrackerName,
    threads: int,
    recognise_looks: bool,
    allow_download: bool = True,
    confidence: float = LEAST_CONFIDENCE,
) -> Perceiver:
    """Find, load and warm up everything, which takes seconds.

    Raises
    ------
    WeightsError
        When there is no detector, it cannot be loaded, or it finds no people.
    """
    weights = find_weights(weights_path, allow_download=allow_download)
    detector = open_detector(weights, confidence=confidence, threads=threads)
    appearance, trouble = _appearance(weights, threads) if recognise_looks else (None, "")
    people = PersonTracker(person_classes(detector, weights), tracker=tracker, appearance=appearance)
    return Perceiver(detector, people, "" if appearance is None else appearance.name, trouble=trouble)


def _appearance(weights: Weights, threads: int) -> tuple[AppearanceModel | None, str]:
    """The network beside the detector or in a models folder, if there is one that can be used."""
    path = find_appearance((weights.path.parent, *models_dirs()))
    if path is None:
        return None, ""
    try:
        return AppearanceModel(path, threads=threads), ""
    except AppearanceError as error:
        return None, str(error)
