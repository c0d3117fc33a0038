"""Person trackers of several cameras, with our tracker or ultralytics', for the boxes of any detector."""

import itertools
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.perception.appearance_embedding import AppearanceModel
from caris_desktop.perception.box_motion import Floats, Motion, assigned, corners_of, first_seen, overlaps
from caris_desktop.perception.detector import Detections
from caris_desktop.perception.inference_messages import DetectionRequest
from caris_desktop.perception.inference_settings import TrackerName
from caris_desktop.perception.kalman_tracker import AppearanceOf, CameraTracker, Followed, view_qualities

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


LibraryName = Literal["bytetrack", "botsort"]


class LibraryTracker:
    """Ultralytics' trackers, for the boxes of any detector.

    Tracker of one camera. Track numbers count from 1 for each. ``with_appearance``: it is given embeddings of all
    boxes, which BoT-SORT uses.
    """

    def __init__(self, name: LibraryName, *, with_appearance: bool = False) -> None:
        from caris_desktop.perception.backends.ultralytics_setup import prepare_ultralytics

        prepare_ultralytics(threads=1)
        from ultralytics.trackers.track import TRACKER_MAP
        from ultralytics.utils import YAML, IterableSimpleNamespace
        from ultralytics.utils.checks import check_yaml

        settings = IterableSimpleNamespace(**YAML.load(check_yaml(f"{name}.yaml")))
        self.uses_appearance = settings.with_reid = with_appearance and name == "botsort"
        self._tracker: Any = TRACKER_MAP[name](settings)

    def follow(
        self,
        corners_px: NDArray[np.float64],
        confidences: NDArray[np.float64],
        image_bgr: NDArray[np.uint8],
        embeddings: NDArray[np.float64] | None = None,
    ) -> list[tuple[int, int]]:
        """Add the next frame; return the track number and row of each assigned box."""
        from ultralytics.engine.results import Boxes

        rows = np.column_stack([corners_px, confidences, np.zeros(len(confidences))]).astype(np.float32)
        boxes = Boxes(rows.reshape(-1, 6), image_bgr.shape[:2])
        found = self._tracker.update(boxes, image_bgr, None if embeddings is None else embeddings.astype(np.float32))
        return [(int(row[4]), int(row[7])) for row in found]


class PersonTracker:
    """One tracker for each camera. For one thread.

    Track numbers start at 1 and are unique across cameras. ``person_classes`` are the class rows that mean a person.
    Without ``appearance``, tracks are matched by motion alone.
    """

    def __init__(
        self, person_classes: Sequence[int], *, tracker: TrackerName, appearance: AppearanceModel | None = None
    ) -> None:
        self._person_classes = tuple(person_classes)
        self._tracker = tracker
        self._appearance = appearance
        self._theirs: dict[str, LibraryTracker] = {}
        self._ours: dict[str, _Followed] = {}
        self._numbers: dict[tuple[str, int], int] = {}
        self._new_number = itertools.count(1).__next__
        if tracker == "bytetrack" or tracker == "botsort":  # noqa: PLR1714 - mypy narrows only so
            LibraryTracker(tracker)  # load the library before the first frame, since it takes seconds

    def track(
        self, detections: Detections, image_bgr: NDArray[np.uint8], request: DetectionRequest
    ) -> list[TrackedBox]:
        """Tracked people among the detections in the next frame of a camera: uint8 BGR, shape (height, width, 3)."""
        rows = _people(detections, self._person_classes)
        corners_px, confidences = detections.corners_px[rows], detections.confidences[rows]
        if self._tracker == "own" or self._tracker == "deepsort":  # noqa: PLR1714 - mypy narrows only so
            camera = request.frame.camera
            if camera not in self._ours:
                kind = CameraTracker if self._tracker == "own" else DeepSort
                self._ours[camera] = _Followed(kind(self._new_number))
            appearance_of = self._embeddings_in(image_bgr, corners_px)
            found = self._ours[camera].follow(corners_px, confidences, request, appearance_of)
        else:
            found = self._follow_with(self._tracker, corners_px, confidences, image_bgr, request.frame.camera)
        qualities = view_qualities(corners_px, confidences, _size_px(request.frame))
        tracked = []
        for each in found:
            left, top, right, bottom = corners_px[each.box].tolist()
            tracked.append(
                TrackedBox(
                    each.number,
                    left,
                    top,
                    right - left,
                    bottom - top,
                    float(confidences[each.box]),
                    int(rows[each.box]),
                    float(qualities[each.box]),
                    each.embedding,
                )
            )
        return tracked

    def _embeddings_in(self, image_bgr: NDArray[np.uint8], corners_px: NDArray[np.float64]) -> AppearanceOf | None:
        appearance = self._appearance
        if appearance is None:
            return None
        return lambda boxes: appearance.embed(image_bgr, [corners_px[box] for box in boxes])

    def _follow_with(
        self,
        name: LibraryName,
        corners_px: NDArray[np.float64],
        confidences: NDArray[np.float64],
        image_bgr: NDArray[np.uint8],
        camera: str,
    ) -> list[Followed]:
        theirs = self._theirs.pop(camera, None) or LibraryTracker(name, with_appearance=self._appearance is not None)
        self._theirs[camera] = theirs
        embeddings = None
        if theirs.uses_appearance and self._appearance is not None and len(corners_px):
            embeddings = self._appearance.embed(image_bgr, list(corners_px))
        found = theirs.follow(corners_px, confidences, image_bgr, embeddings)
        return [
            Followed(self._numbers.setdefault((camera, number), len(self._numbers) + 1), row) for number, row in found
        ]


_LEAST_CONFIDENCE = 0.3
_CONFIRM_AFTER = 3
_LOST_S = 1.2  # 30 frames at 25 Hz, its original frame rate
_MAX_EMBEDDINGS = 100
_MAX_DISTANCE = 0.3  # cosine distance; 0.2 for the network of the paper, whose vectors are closer together
_GATE = 9.4877  # chi-squared with four degrees of freedom, 95 %
_OVERLAP_AT_LEAST = 0.3
_NEVER = 1e5


@dataclass(slots=True, eq=False)
class _Track(Motion):
    number: int
    hits: int = 1
    embeddings: deque[Floats] = field(default_factory=lambda: deque(maxlen=_MAX_EMBEDDINGS))

    @property
    def confirmed(self) -> bool:
        return self.hits >= _CONFIRM_AFTER


class DeepSort:
    """DeepSORT tracker (Wojke, Bewley and Paulus, 2017), as in the published system, for comparison. Motion gates the
    candidates, appearance decides, and recently seen tracks match first. Two differences: time is in seconds, as in the
    whole program, and without an appearance network motion alone decides.

    Tracks the people of one camera. ``new_number`` returns the number of a new track.
    """

    def __init__(self, new_number: Callable[[], int]) -> None:
        self._new_number = new_number
        self._tracks: list[_Track] = []

    def follow(
        self,
        corners_px: Floats,
        confidences: Floats,
        stamp_s: float,
        *,
        shift_px: tuple[float, float] = (0.0, 0.0),
        appearance_of: AppearanceOf | None = None,
    ) -> list[Followed]:
        """Add the next frame; as :meth:`caris_desktop.perception.kalman_tracker.CameraTracker.follow`."""
        for track in self._tracks:
            track.advance(stamp_s, shift_px)
        boxes = np.flatnonzero(confidences >= _LEAST_CONFIDENCE).tolist()
        embeddings = dict(zip(boxes, appearance_of(boxes), strict=True)) if appearance_of is not None and boxes else {}
        pairs: list[tuple[_Track, int]] = []
        # The longer a track is lost, the larger its uncertainty and the more boxes match it.
        confirmed = sorted((track for track in self._tracks if track.confirmed), key=lambda track: -track.seen_s)
        before_s = max((track.seen_s for track in self._tracks), default=stamp_s)
        for _, same_age in itertools.groupby(confirmed, key=lambda track: track.seen_s):
            pairs += _by_appearance(list(same_age), _left(boxes, pairs), corners_px, embeddings)
        matched_ids = {id(track) for track, _ in pairs}
        others = [
            track
            for track in self._tracks
            if id(track) not in matched_ids and (not track.confirmed or track.seen_s == before_s)
        ]
        pairs += _by_overlap(others, _left(boxes, pairs), corners_px)
        for track, box in pairs:
            track.see(corners_px[box], stamp_s)
            track.hits += 1
            if box in embeddings:
                track.embeddings.append(embeddings[box])
        for box in _left(boxes, pairs):
            track = _Track(*first_seen(corners_px[box], stamp_s), number=0)
            if box in embeddings:
                track.embeddings.append(embeddings[box])
            self._tracks.append(track)
        self._tracks = [
            track for track in self._tracks if stamp_s - track.seen_s <= (_LOST_S if track.confirmed else 0.0)
        ]
        for track, _ in pairs:
            if track.confirmed and not track.number:
                track.number = self._new_number()
        return [Followed(track.number, box, embeddings.get(box)) for track, box in pairs if track.confirmed]


def _by_appearance(
    tracks: list[_Track], boxes: list[int], corners_px: Floats, embeddings: dict[int, Floats]
) -> list[tuple[_Track, int]]:
    if not tracks or not boxes:
        return []
    cost = np.array([[_apart(track, corners_px[box], embeddings.get(box)) for box in boxes] for track in tracks])
    return [(tracks[row], boxes[column]) for row, column in assigned(cost, _MAX_DISTANCE)]


def _apart(track: _Track, corners: Floats, embedding: Floats | None) -> float:
    """Minimum cosine distance over a track's views; without a network, scaled Mahalanobis distance."""
    unlikely = track.unlikeliness(corners)
    if unlikely > _GATE:
        return _NEVER
    if embedding is None or not track.embeddings:
        return _MAX_DISTANCE * unlikely / _GATE
    return float(1.0 - max(view @ embedding for view in track.embeddings))


def _by_overlap(tracks: list[_Track], boxes: list[int], corners_px: Floats) -> list[tuple[_Track, int]]:
    if not tracks or not boxes:
        return []
    cost = 1.0 - overlaps(corners_of(tracks), corners_px[boxes])
    return [(tracks[row], boxes[column]) for row, column in assigned(cost, 1.0 - _OVERLAP_AT_LEAST)]


def _left(boxes: list[int], pairs: list[tuple[_Track, int]]) -> list[int]:
    taken = {box for _, box in pairs}
    return [box for box in boxes if box not in taken]


@dataclass(slots=True)
class _Followed:
    """Our tracker for one camera, and the camera's last direction."""

    follower: CameraTracker | DeepSort
    direction: tuple[float, float] | None = None

    def follow(
        self,
        corners_px: NDArray[np.float64],
        confidences: NDArray[np.float64],
        request: DetectionRequest,
        appearance_of: AppearanceOf | None,
    ) -> list[Followed]:
        stamp_s, shift_px = request.frame.shown_ns / 1e9, self._shift_px(request)
        if isinstance(self.follower, DeepSort):
            return self.follower.follow(
                corners_px, confidences, stamp_s, shift_px=shift_px, appearance_of=appearance_of
            )
        return self.follower.follow(
            corners_px,
            confidences,
            stamp_s,
            shift_px=shift_px,
            picture_px=_size_px(request.frame),
            appearance_of=appearance_of,
        )

    def _shift_px(self, request: DetectionRequest) -> tuple[float, float]:
        """Image shift by the camera's rotation since the last frame; for small angles, in pixels."""
        before, self.direction = self.direction, request.direction
        if before is None or request.direction is None:
            return 0.0, 0.0
        focal_px = request.focal_per_width * request.frame.width_px
        return focal_px * (request.direction[0] - before[0]), focal_px * (before[1] - request.direction[1])


def _size_px(frame: FrameRef) -> tuple[float, float]:
    return float(frame.width_px), float(frame.height_px)


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
