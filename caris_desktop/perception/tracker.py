"""Person trackers of several cameras, for the boxes of any detector."""

import operator
from collections.abc import Callable, Sequence
from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.plugins import LOAD_WITHIN_S, Plugin, PluginCall, PluginError, find, load, watched
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.perception.appearance_embedding import AppearanceModel
from caris_desktop.perception.detector import Detections
from caris_desktop.perception.inference_messages import DetectionRequest
from caris_desktop.perception.kalman_tracker import Floats, overlaps, view_qualities
from caris_desktop.perception.tracker_plugins import Tracker, TrackerFrame

_SAME_PERSON = 0.7


class TrackedBox(Value):
    """One person in one frame; ``track`` is constant while the person is tracked.

    ``detection`` is the row of the detection. ``quality`` is the view quality, 0..1, and ``embedding`` the one of
    unit length, if computed in this frame.
    """

    track: int
    left_px: float
    top_px: float
    width_px: float
    height_px: float
    confidence: float
    detection: int
    quality: float = 0.0
    embedding: NDArray[np.float64] | None = field(default=None, compare=False)


class PersonTracker:
    """One tracker for each camera. For one thread.

    Track numbers start at 1 and are unique across cameras. ``person_classes`` are the class rows that mean a person.
    ``tracker`` is a name in the group of plug-ins. Without ``appearance``, tracks are matched by motion alone.
    ``notify`` gets the calls of a tracker that is not built in.

    Raises
    ------
    PluginError
        When the tracker cannot be used; from :meth:`track` also later.
    """

    def __init__(
        self,
        person_classes: Sequence[int],
        *,
        tracker: str,
        appearance: AppearanceModel | None = None,
        notify: Callable[[PluginCall], None] = lambda _call: None,
    ) -> None:
        self._person_classes = tuple(person_classes)
        self._appearance = appearance
        self._notify = notify
        self._cameras: dict[str, Tracker] = {}
        self._directions: dict[str, tuple[float, float] | None] = {}
        self._numbers: dict[tuple[str, int], int] = {}
        self._first_number = 1
        self.use(tracker)

    def use(self, tracker: str) -> None:
        """Begin again with another tracker; nobody of before has the number of somebody later."""
        self.plugin = find("trackers", tracker)
        self._first_number += len(self._numbers)
        self._numbers, self._cameras = {}, {}
        # Before the first frame, since libraries take seconds.
        with watched(self.plugin, self._notify, LOAD_WITHIN_S):
            self._make: Callable[..., Tracker] = load(self.plugin)
            self._spare: Tracker | None = self._make(appearance=self._appearance is not None)

    def track(
        self, detections: Detections, image_bgr: NDArray[np.uint8], request: DetectionRequest
    ) -> list[TrackedBox]:
        """Tracked people among the detections in the next frame of a camera: uint8 BGR, shape (height, width, 3)."""
        rows = _people(detections, self._person_classes)
        corners_px, confidences = detections.corners_px[rows], detections.confidences[rows]
        frame = TrackerFrame(
            image_bgr, request.frame.shown_ns / 1e9, self._shift_px(request), self._embedder(image_bgr, corners_px)
        )
        found = self._follow(corners_px, confidences, frame, request.frame.camera)
        qualities = view_qualities(corners_px, confidences, (request.frame.width_px, request.frame.height_px))
        tracked = []
        for number, box in found:
            left, top, right, bottom = corners_px[box].tolist()
            tracked.append(
                TrackedBox(
                    number,
                    left,
                    top,
                    right - left,
                    bottom - top,
                    float(confidences[box]),
                    int(rows[box]),
                    float(qualities[box]),
                    frame.embeddings.get(box),
                )
            )
        return tracked

    def _embedder(
        self, image_bgr: NDArray[np.uint8], corners_px: NDArray[np.float64]
    ) -> Callable[[Sequence[int]], Floats] | None:
        appearance = self._appearance
        if appearance is None:
            return None
        return lambda boxes: appearance.embed(image_bgr, [corners_px[box] for box in boxes])

    def _follow(
        self, corners_px: Floats, confidences: Floats, frame: TrackerFrame, camera: str
    ) -> list[tuple[int, int]]:
        """Track number, unique across cameras, and row of each person."""
        if not self.plugin.is_built_in:
            corners_px, confidences = _read_only(corners_px), _read_only(confidences)
            frame.image_bgr = frame.image_bgr.view()
            frame.image_bgr.flags.writeable = False
        with watched(self.plugin, self._notify):
            tracker = self._cameras.get(camera) or self._spare or self._make(appearance=self._appearance is not None)
            self._cameras[camera] = tracker
            self._spare = None
            found = tracker.follow(corners_px, confidences, frame)
            if not self.plugin.is_built_in:
                found = checked_tracks(self.plugin, found, len(corners_px))
        return [
            (self._numbers.setdefault((camera, number), self._first_number + len(self._numbers)), row)
            for number, row in found
        ]

    def _shift_px(self, request: DetectionRequest) -> tuple[float, float]:
        """Image shift by the camera's rotation since its last frame; for small angles, in pixels."""
        camera, direction = request.frame.camera, request.direction
        before, self._directions[camera] = self._directions.get(camera), direction
        if before is None or direction is None:
            return 0.0, 0.0
        focal_px = request.focal_per_width * request.frame.width_px
        return focal_px * (direction[0] - before[0]), focal_px * (before[1] - direction[1])


def _read_only(array: Floats) -> Floats:
    copy = array.copy()
    copy.flags.writeable = False
    return copy


def checked_tracks(plugin: Plugin, found: object, boxes: int) -> list[tuple[int, int]]:
    """What a tracker returned, in plain numbers. Raises PluginError if it is not what the interface says."""
    try:
        pairs = [(operator.index(number), operator.index(row)) for number, row in found]  # type: ignore[attr-defined]
    except (TypeError, ValueError) as error:
        raise PluginError(plugin, QT_TR_NOOP("it did not return pairs of a track number and a row")) from error
    numbers, rows = {number for number, _ in pairs}, {row for _, row in pairs}
    if rows - set(range(boxes)):
        raise PluginError(plugin, QT_TR_NOOP("it returned rows of no box"))
    if len(numbers) < len(pairs) or len(rows) < len(pairs) or min(numbers, default=1) < 1:
        raise PluginError(plugin, QT_TR_NOOP("it returned a track number or a row twice, or a number below 1"))
    return pairs


def _people(detections: Detections, classes: Sequence[int]) -> NDArray[np.int64]:
    """Rows of the people, without duplicates from several person classes."""
    has_size = (detections.corners_px[:, 2:] > detections.corners_px[:, :2]).all(axis=1)
    rows = np.flatnonzero(np.isin(detections.classes, classes) & has_size)
    if len(classes) < 2 or len(rows) < 2:
        return rows
    surest_first = rows[np.argsort(-detections.confidences[rows], kind="stable")]
    together = overlaps(detections.corners_px[surest_first], detections.corners_px[surest_first])
    chosen: list[int] = []
    for each in range(len(surest_first)):
        if not chosen or together[each, chosen].max() <= _SAME_PERSON:
            chosen.append(each)
    return surest_first[chosen]
