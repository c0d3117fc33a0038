"""Perception pipeline from image to people: detector, tracker, embeddings and portraits, for the
console and offline.
"""

import time
from collections.abc import Callable, Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.model_files import models_dirs
from caris_desktop.domain.person_values import PersonPortrait
from caris_desktop.domain.plugins import Plugin, PluginCall
from caris_desktop.domain.sensing import FrameRef, PersonBox, ThingBox
from caris_desktop.domain.value_class import Value
from caris_desktop.perception.appearance_embedding import AppearanceModel, EmbeddingModelError, find_appearance
from caris_desktop.perception.backends.runtime_selection import Chosen, open_chosen
from caris_desktop.perception.blur import head_of
from caris_desktop.perception.detector import Detections, WatchedDetector
from caris_desktop.perception.inference_messages import (
    LEAST_CONFIDENCE,
    OWN_TRACKER,
    DetectionRequest,
    DetectorSettings,
)
from caris_desktop.perception.pose import Pose, Poses
from caris_desktop.perception.tracker import PersonTracker, TrackedBox

_THING_CONFIDENCE = 0.35


class Perceived(Value):
    """Result for one image. ``boxes`` are the people among ``detections``, ``poses`` theirs by track."""

    boxes: list[TrackedBox]
    poses: dict[int, Pose]
    things: tuple[ThingBox, ...]
    unfollowed: tuple[PersonBox, ...]
    portraits: list[PersonPortrait]
    detections: Detections
    detector_s: float
    tracker_s: float


class Perceiver:
    """Pipeline for one thread. ``label`` is the detector's; ``appearance_model`` names the re-identification network,
    empty without one.
    """

    def __init__(
        self,
        chosen: Chosen,
        tracker: PersonTracker,
        appearance_model: str,
        *,
        trouble: str = "",
        things: tuple[str, ...] = (),
    ) -> None:
        detector = chosen.detector
        self.label = detector.label
        self.appearance_model = appearance_model
        self.trouble = trouble
        """What could not be opened and can be done without, in a sentence; empty if nothing."""
        self.class_names = detector.class_names
        lowered = {name.lower() for name in things}
        self._things = {
            row: name
            for row, name in enumerate(detector.class_names)
            if name.lower() in lowered and row not in chosen.people
        }
        self.unknown_things = tuple(
            name for name in things if name.lower() not in {known.lower() for known in self._things.values()}
        )
        """Those of ``things`` that the detector does not know."""
        self._people = frozenset(chosen.people)
        self._poses = Poses()
        self._detector = detector
        self._tracker = tracker
        self._portraits = PortraitTaker()

    def perceive(self, image_bgr: NDArray[np.uint8], request: DetectionRequest) -> Perceived:
        """Process the next frame of a camera: uint8 BGR, shape (height, width, 3). Raises PluginError."""
        began_s = time.perf_counter()
        detections = self._detector.detect(image_bgr)
        detected_s = time.perf_counter()
        boxes = self._tracker.track(detections, image_bgr, request)
        tracked_s = time.perf_counter()
        portraits = self._portraits.extract(image_bgr, request.frame, boxes)
        poses = {}
        if detections.keypoints is not None:
            stamp_s = request.frame.stamp_ns / 1e9
            poses = {
                box.track: self._poses.of(box.track, detections.keypoints[box.detection], stamp_s) for box in boxes
            }
        things = self._things_of(detections)
        unfollowed = self._unfollowed(detections, boxes) if request.to_cover else ()
        detector_s, tracker_s = detected_s - began_s, tracked_s - detected_s
        return Perceived(boxes, poses, things, unfollowed, portraits, detections, detector_s, tracker_s)

    @property
    def plugins(self) -> tuple[Plugin, ...]:
        """Plug-ins in use, without the built-in ones."""
        detector = (self._detector.plugin,) if isinstance(self._detector, WatchedDetector) else ()
        return tuple(one for one in (*detector, self._tracker.plugin) if not one.is_built_in)

    def use_own_tracker(self) -> None:
        """Use the built-in tracker from now on."""
        self._tracker.use(OWN_TRACKER)

    def _unfollowed(self, detections: Detections, boxes: list[TrackedBox]) -> tuple[PersonBox, ...]:
        """Detected people without a track (yet), and separate head boxes where known: heads need not be at the upper
        end of a box.
        """
        followed = {box.detection for box in boxes}
        found = zip(detections.corners_px.tolist(), detections.confidences.tolist(), detections.classes, strict=True)
        unfollowed = []
        for row, (corners, confidence, kind) in enumerate(found):
            if int(kind) not in self._people:
                continue
            parts = [] if row in followed else [corners]
            if detections.keypoints is not None:
                head = head_of(detections.keypoints[row], corners[3] - corners[1])
                parts += [] if head is None else [head]
            for left, top, right, bottom in parts:
                unfollowed.append(PersonBox(0, "", left, top, right - left, bottom - top, confidence))
        return tuple(unfollowed)

    def _things_of(self, detections: Detections) -> tuple[ThingBox, ...]:
        if not self._things:
            return ()
        found = zip(detections.corners_px.tolist(), detections.confidences.tolist(), detections.classes, strict=True)
        return tuple(
            ThingBox(self._things[int(kind)], left, top, right - left, bottom - top, confidence)
            for (left, top, right, bottom), confidence, kind in found
            if int(kind) in self._things and confidence >= _THING_CONFIDENCE
        )


def open_perceiver(
    weights_path: Path | None,
    *,
    tracker: str,
    threads: int,
    recognise_appearance: bool,
    allow_download: bool = True,
    confidence: float = LEAST_CONFIDENCE,
    settings: DetectorSettings | None = None,
    models_folder: Path | None = None,
    notify: Callable[[PluginCall], None] = lambda _call: None,
) -> Perceiver:
    """Find, load and warm up everything; takes seconds. ``models_folder`` is the study's own. ``notify`` gets the calls
    of plug-ins.

    Raises
    ------
    WeightsError
        When there is no detector, it cannot be loaded, or it finds no people.
    PluginError
        When a plug-in cannot be used.
    """
    settings = settings or DetectorSettings()
    chosen = open_chosen(
        weights_path, settings, confidence=confidence, threads=threads, allow_download=allow_download, notify=notify
    )
    appearance, trouble = _appearance((models_folder, chosen.folder), threads) if recognise_appearance else (None, "")
    people = PersonTracker(chosen.people, tracker=tracker, appearance=appearance, notify=notify)
    appearance_model = "" if appearance is None else appearance.name
    return Perceiver(chosen, people, appearance_model, trouble=trouble, things=settings.things)


def _appearance(first: Iterable[Path | None], threads: int) -> tuple[AppearanceModel | None, str]:
    """Appearance network from these folders or a models folder, if usable, and the reason if not."""
    path = find_appearance((*(folder for folder in first if folder is not None), *models_dirs()))
    if path is None:
        return None, ""
    try:
        return AppearanceModel(path, threads=threads), ""
    except EmbeddingModelError as error:
        return None, str(error)


_NOT_SOONER_NS = 1_000_000_000
_AGAIN_AFTER_NS = 10_000_000_000
_BETTER = 1.2
_LEAST_QUALITY = 0.15
_TALL_PX = 320
_MARGIN = 0.05
_MAX_PORTRAITS = 500


class PortraitTaker:
    """Portraits: the best view of each person so far, as a small image.

    For one thread. At most one per second and track, and only if clearly better than the last or after ten seconds,
    since consent to photos may have been given meanwhile.
    """

    def __init__(self) -> None:
        self._best: dict[int, tuple[int, float]] = {}  # time and worth by track

    def extract(self, image_bgr: NDArray[np.uint8], frame: FrameRef, boxes: list[TrackedBox]) -> list[PersonPortrait]:
        """New best views in an image: uint8 BGR, shape (height, width, 3)."""
        portraits = []
        for box in boxes:
            # Closer people show more detail, even where a network would not benefit.
            worth = box.quality * min(1.0, box.height_px / _TALL_PX) ** 0.5
            best = self._best.get(box.track)
            if box.quality < _LEAST_QUALITY:
                continue
            if best is not None:
                least_ns = _NOT_SOONER_NS if worth >= _BETTER * best[1] else _AGAIN_AFTER_NS
                if frame.stamp_ns - best[0] < least_ns:
                    continue
            jpeg = _jpeg(image_bgr, box)
            if jpeg is None:
                continue
            self._best.pop(box.track, None)
            self._best[box.track] = frame.stamp_ns, worth
            if len(self._best) > _MAX_PORTRAITS:
                del self._best[next(iter(self._best))]
            portraits.append(PersonPortrait(frame.stamp_ns, frame.camera, box.track, jpeg, box.quality))
        return portraits


def _jpeg(image_bgr: NDArray[np.uint8], box: TrackedBox) -> bytes | None:
    height, width = image_bgr.shape[:2]
    margin = _MARGIN * box.height_px
    left, top = max(0, round(box.left_px - margin)), max(0, round(box.top_px - margin))
    right = min(width, round(box.left_px + box.width_px + margin))
    bottom = min(height, round(box.top_px + box.height_px + margin))
    if right - left < 2 or bottom - top < 2:
        return None
    crop = image_bgr[top:bottom, left:right]
    if bottom - top > _TALL_PX:
        smaller = (max(1, round((right - left) * _TALL_PX / (bottom - top))), _TALL_PX)
        crop = cv2.resize(crop, smaller, interpolation=cv2.INTER_AREA).astype(np.uint8)
    done, encoded = cv2.imencode(".jpg", crop, (cv2.IMWRITE_JPEG_QUALITY, 88))
    return encoded.tobytes() if done else None
