"""Interface of person trackers for plug-ins of the group ``caris_desktop.trackers``, and the built-in ones."""

import itertools
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import field
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import dataclass
from caris_desktop.perception.kalman_tracker import (
    CameraTracker,
    Floats,
    Motion,
    assigned,
    corners_of,
    first_seen,
    overlaps,
)

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


class TrackerFrame:
    """One picture of a camera, as a tracker gets it.

    ``image_bgr``: uint8, shape (height, width, 3), read-only. ``stamp_s``: when it was taken, in seconds that only
    grow. ``shift_px``: by how much everything has moved to the right and down since the camera's last picture because
    the robot or its head turned; zeros if unknown.
    """

    def __init__(
        self,
        image_bgr: NDArray[np.uint8],
        stamp_s: float,
        shift_px: tuple[float, float] = (0.0, 0.0),
        embedder: Callable[[Sequence[int]], Floats] | None = None,
    ) -> None:
        self.image_bgr = image_bgr
        self.stamp_s = stamp_s
        self.shift_px = shift_px
        self._embedder = embedder
        self.embeddings: dict[int, Floats] = {}
        """Computed so far, by the row of the box. People are recognised by them, so more are not better but dearer."""

    def embed(self, rows: Sequence[int]) -> Floats:
        """Appearance embeddings of unit length of the boxes in ``rows``: float64, shape (rows, dimensions).

        A few milliseconds a box. Raises RuntimeError without an appearance network.
        """
        if self._embedder is None:
            raise RuntimeError("there is no appearance network: the tracker was made with appearance=False")
        wanted = [row for row in dict.fromkeys(rows) if row not in self.embeddings]
        if wanted:
            self.embeddings |= dict(zip(wanted, self._embedder(wanted), strict=True))
        return np.array([self.embeddings[row] for row in rows], np.float64)


class Tracker(Protocol):
    """Tracker of one camera: a class with the attribute ``caris_interface = 1``, called as
    ``Tracker(appearance=True)`` if there is a network for appearance embeddings, else with False.

    One instance is made for each camera, in the process that detects people (the console's, or that of a command), and
    called in one thread of it, in the order of the camera's pictures, which come at 5 to 30 Hz with gaps. The process
    is not the window's, the robot link's or the recorder's: none of them waits for a tracker. People are shown and
    recorded once :meth:`follow` has returned: 10 ms are good, and after five seconds the process is ended. The first
    instance is made before the first picture, within a minute with the import.

    A tracker that raises, is too slow, prints, ends its process, or returns anything else than what is described here
    is switched off until the program is started again, and the wizard is told its name; the built-in tracker begins
    in its place. Log with :mod:`logging`.
    """

    caris_interface: ClassVar[int]

    def follow(self, corners_px: Floats, confidences: Floats, frame: TrackerFrame) -> list[tuple[int, int]]:
        """Add the next picture, and return ``(track number, row)`` for each box that belongs to a person now.

        ``corners_px`` is left, top, right, bottom of each box, float64 of shape (n, 4); ``confidences`` has shape (n,),
        from 0.1 to 1. There may be no box. Both are read-only.

        A track number is a whole number from 1 up, and that of one person while they are followed; another person never
        gets it. A row, from 0 to n-1, and a number occur once. Boxes in no pair are not shown: do not return a
        box before somebody is surely there.
        """
        ...


class OwnTracker:
    """Our tracker (:mod:`caris_desktop.perception.kalman_tracker`)."""

    caris_interface: ClassVar[int] = 1

    def __init__(self, *, appearance: bool) -> None:
        self._appearance = appearance
        self._tracker = CameraTracker()

    def follow(self, corners_px: Floats, confidences: Floats, frame: TrackerFrame) -> list[tuple[int, int]]:
        height_px, width_px = frame.image_bgr.shape[:2]
        return self._tracker.follow(
            corners_px,
            confidences,
            frame.stamp_s,
            shift_px=frame.shift_px,
            picture_px=(width_px, height_px),
            appearance_of=frame.embed if self._appearance else None,
        )


class DeepSortTracker:
    """DeepSORT tracker (Wojke, Bewley and Paulus, 2017), as in the published system, for comparison. Motion gates the
    candidates, appearance decides, and recently seen tracks match first. Two differences: time is in seconds, as in the
    whole program, and without an appearance network motion alone decides.
    """

    caris_interface: ClassVar[int] = 1

    def __init__(self, *, appearance: bool) -> None:
        self._appearance = appearance
        self._numbers = itertools.count(1)
        self._tracks: list[_Track] = []

    def follow(self, corners_px: Floats, confidences: Floats, frame: TrackerFrame) -> list[tuple[int, int]]:
        stamp_s = frame.stamp_s
        for track in self._tracks:
            track.advance(stamp_s, frame.shift_px)
        boxes = np.flatnonzero(confidences >= _LEAST_CONFIDENCE).tolist()
        embeddings = dict(zip(boxes, frame.embed(boxes), strict=True)) if self._appearance and boxes else {}
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
                track.number = next(self._numbers)
        return [(track.number, box) for track, box in pairs if track.confirmed]


class _UltralyticsTracker:
    """Ultralytics' trackers, for the boxes of any detector. BoT-SORT uses appearance embeddings."""

    caris_interface: ClassVar[int] = 1
    name: ClassVar[Literal["bytetrack", "botsort"]]

    def __init__(self, *, appearance: bool) -> None:
        from caris_desktop.perception.backends.ultralytics_runtime import prepare_ultralytics

        prepare_ultralytics(threads=1)
        from ultralytics.trackers.track import TRACKER_MAP
        from ultralytics.utils import YAML, IterableSimpleNamespace
        from ultralytics.utils.checks import check_yaml

        settings = IterableSimpleNamespace(**YAML.load(check_yaml(f"{self.name}.yaml")))
        self._appearance = settings.with_reid = appearance and self.name == "botsort"
        self._tracker: Any = TRACKER_MAP[self.name](settings)

    def follow(self, corners_px: Floats, confidences: Floats, frame: TrackerFrame) -> list[tuple[int, int]]:
        from ultralytics.engine.results import Boxes

        rows = np.column_stack([corners_px, confidences, np.zeros(len(confidences))]).astype(np.float32)
        boxes = Boxes(rows.reshape(-1, 6), frame.image_bgr.shape[:2])
        embeddings = None
        if self._appearance and len(corners_px):
            embeddings = frame.embed(range(len(corners_px))).astype(np.float32)
        found = self._tracker.update(boxes, frame.image_bgr, embeddings)
        return [(int(row[4]), int(row[7])) for row in found]


class ByteTrack(_UltralyticsTracker):
    name = "bytetrack"


class BotSort(_UltralyticsTracker):
    name = "botsort"
