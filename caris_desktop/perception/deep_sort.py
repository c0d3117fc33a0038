"""DeepSORT tracker, for comparison with ours."""

import itertools
from collections import deque
from collections.abc import Callable
from dataclasses import field

import numpy as np

from caris_desktop.domain.value_class import dataclass
from caris_desktop.perception.box_motion import Floats, Motion, assigned, corners_of, first_seen, overlaps
from caris_desktop.perception.kalman_tracker import AppearanceOf, Followed

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
