"""Person tracker: assigns the boxes of each frame to tracks, by motion and appearance.

Made for a robot's camera: 7 to 30 frames per second, dropped frames, and camera rotation. All limits are in seconds of
capture time, never in frames. No Qt, no detector: boxes in, track numbers out.
"""

import itertools
import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import dataclass

Floats = NDArray[np.float64]

# In box heights: a detector's position error; people's acceleration; the rate of size changes.
_SEEN_WITHIN = 0.05
_ACCELERATION_PER_S2 = 2.0
_SPEED_AT_FIRST_PER_S = 0.7
_RESIZE_PER_S = 0.25
_VELOCITY_DECAY_S = 0.6


@dataclass(slots=True, eq=False)
class Motion:
    """Centre, width and height with their speeds in pixels and seconds; axes are independent.

    ``mean`` (4, 2): value and speed. ``covariance`` (4, 2, 2). ``stamp_s`` is the time of the state, ``seen_s`` and
    ``first_s`` the last and first detection.
    """

    mean: Floats
    covariance: Floats
    stamp_s: float
    seen_s: float
    first_s: float

    @property
    def height_px(self) -> float:
        return max(4.0, float(self.mean[3, 0]))

    def corners(self) -> Floats:
        x, y, width, height = self.mean[:, 0]
        return np.array([x - width / 2, y - height / 2, x + width / 2, y + height / 2])

    def advance(self, stamp_s: float, shift_px: tuple[float, float]) -> None:
        """Predict the state; the speed decays while the box is not detected.

        ``shift_px`` is the image motion by camera rotation since the last frame.
        """
        dt = stamp_s - self.stamp_s
        self.stamp_s = stamp_s
        self.mean[:2, 0] += shift_px
        if dt <= 0.0:
            return
        unseen_s = stamp_s - self.seen_s - dt
        self.mean[:, 0] += self.mean[:, 1] * dt
        self.mean[:, 1] *= np.exp(-dt / _VELOCITY_DECAY_S) if unseen_s > 0.0 else 1.0
        # Sizes have no speed: someone who came nearer does not go on growing.
        self.mean[2:, 1] = 0.0
        step = np.array([[1.0, dt], [0.0, 1.0]])
        self.covariance = step @ self.covariance @ step.T
        q = (_ACCELERATION_PER_S2 * self.height_px) ** 2
        self.covariance[:2] += q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        self.covariance[2:, 0, 0] += (_RESIZE_PER_S * self.height_px) ** 2 * dt

    def see(self, corners: Floats, stamp_s: float) -> None:
        measured = _measured(corners)
        total = self.covariance[:, 0, 0] + _variance(measured)
        gain = self.covariance[:, :, 0] / total[:, None]
        self.mean = self.mean + gain * (measured - self.mean[:, 0])[:, None]
        self.covariance = self.covariance - gain[:, :, None] * self.covariance[:, None, 0, :]
        self.seen_s = stamp_s

    def unlikeliness(self, corners: Floats) -> float:
        """Squared Mahalanobis distance of a box from the predicted one."""
        measured = _measured(corners)
        return float(((measured - self.mean[:, 0]) ** 2 / (self.covariance[:, 0, 0] + _variance(measured))).sum())


def first_seen(corners: Floats, stamp_s: float) -> tuple[Floats, Floats, float, float, float]:
    """Initial fields of a :class:`Motion`."""
    measured = _measured(corners)
    height = max(4.0, float(measured[3]))
    covariance = np.zeros((4, 2, 2))
    covariance[:, 0, 0] = _variance(measured)
    covariance[:2, 1, 1] = (_SPEED_AT_FIRST_PER_S * height) ** 2
    covariance[2:, 1, 1] = (_RESIZE_PER_S * height) ** 2
    return np.stack([measured, np.zeros(4)], axis=1), covariance, stamp_s, stamp_s, stamp_s


def corners_of(motions: Sequence[Motion]) -> Floats:
    return np.stack([motion.corners() for motion in motions])


def assigned(cost: Floats, limit: float) -> list[tuple[int, int]]:
    """Optimal assignment as (row, column) pairs; none costs more than ``limit``."""
    import lap  # the console imports this module for its types, without lap

    _, columns, _ = lap.lapjv(np.ascontiguousarray(cost), extend_cost=True, cost_limit=limit)
    return [(row, column) for row, column in enumerate(columns.tolist()) if column >= 0]


def overlaps(first: Floats, second: Floats, buffer: float = 0.0) -> Floats:
    """Intersection over union of all pairs, shape (first, second), after enlarging both by ``buffer``."""
    a, b = _blown_up(first, buffer), _blown_up(second, buffer)
    wide = np.minimum(a[:, None, 2], b[None, :, 2]) - np.maximum(a[:, None, 0], b[None, :, 0])
    high = np.minimum(a[:, None, 3], b[None, :, 3]) - np.maximum(a[:, None, 1], b[None, :, 1])
    both = np.clip(wide, 0.0, None) * np.clip(high, 0.0, None)
    area_a = (a[:, 2] - a[:, 0]) * (a[:, 3] - a[:, 1])
    area_b = (b[:, 2] - b[:, 0]) * (b[:, 3] - b[:, 1])
    return np.asarray(both / np.maximum(1e-9, area_a[:, None] + area_b[None, :] - both))


def _blown_up(corners: Floats, buffer: float) -> Floats:
    width, height = (corners[:, 2] - corners[:, 0]) * buffer, (corners[:, 3] - corners[:, 1]) * buffer
    return np.asarray(corners + np.stack([-width, -height, width, height], axis=1))


def _measured(corners: Floats) -> Floats:
    left, top, right, bottom = corners
    return np.array([(left + right) / 2, (top + bottom) / 2, right - left, bottom - top])


def _variance(measured: Floats) -> float:
    return (_SEEN_WITHIN * max(4.0, float(measured[3]))) ** 2


# Confidence thresholds: a certain person, a possible continuation of a track, and a possible new track.
SURE, PERHAPS, NEW = 0.5, 0.1, 0.3
# Boxes are enlarged by these fractions before comparison, in two passes: between two frames people may move further
# than their boxes overlap (C-BIoU, Yang et al., WACV 2023).
BUFFERS = (0.3, 0.5)
_LEAST_OVERLAP = 0.1
_LEAST_OVERLAP_PERHAPS = 0.4
_SAME_BOX = 0.7
# Sum of confidences that confirms a new track: reached by two good frames, or later by poor ones.
_CONFIRM_AFTER = 1.0
# Without a certain box many poor ones count too, unless another box covers more than this fraction: those are mostly a
# person's legs, or two people as one.
_POOR_COUNTS = 0.25
_ALONE = 0.1
_TENTATIVE_S = 0.4
_PAUSES, _PATIENT_PAUSES, _PATIENCE_AT_MOST_S = 5, 1.5, 6.0
LOST_S = 2.0
"""How long somebody out of sight is looked for where their way would have led them."""
REMEMBERED_S = 300.0
"""How long they can be known again by how they look."""

# Cosine distances of two views: typical for one person; limit for re-identification by appearance alone, with the
# required margin to the second best; limit for waiting for a better view.
_USUAL_DISTANCE, _SAME_PERSON, _SAME_MARGIN, _LIKELY_SAME = 0.3, 0.27, 0.06, 0.4
_WAIT_FOR_VIEW_S = 0.5
_WEIGHT = 2.0
_UNLIKE, _MISTAKEN_BY, _STRANGE = 0.3, 0.15, 0.38
_MEMORY = 0.9
_EMBED_EVERY_S = 0.5
_GOOD_VIEW = 0.5
_CONTESTED, _RIVAL = 0.15, 0.5
_DOUBTED_AFTER_S = 0.25
_MAX_EMBEDDED, _EMBEDDED_PER_S = 6, 20.0
"""Of one camera's people, in one picture and in the long run: each costs a few milliseconds."""
_TALL_PX = 64.0

AppearanceOf = Callable[[Sequence[int]], Floats]
"""How the people in these boxes look, one row of unit length for each."""


@dataclass(slots=True, eq=False)
class _Track(Motion):
    number: int = 0
    evidence: float = 0.0
    embedding: Floats | None = None
    well_seen: bool = False
    doubted: bool = False
    looked_s: float = -math.inf

    @property
    def confirmed(self) -> bool:
        return self.number > 0


class CameraTracker:
    """Tracks the people of one camera."""

    def __init__(self) -> None:
        self._numbers = itertools.count(1)
        self._tracks: list[_Track] = []
        self._began = False
        self._stamp_s: float | None = None
        self._pauses_s: deque[float] = deque(maxlen=_PAUSES)
        self._embeddings_left = 0.0

    def follow(
        self,
        corners_px: Floats,
        confidences: Floats,
        stamp_s: float,
        *,
        shift_px: tuple[float, float] = (0.0, 0.0),
        picture_px: tuple[float, float] | None = None,
        appearance_of: AppearanceOf | None = None,
    ) -> list[tuple[int, int]]:
        """Add the next frame; returns the number of each person, which nobody else ever gets, and the row of the box.

        Parameters
        ----------
        corners_px
            Left, top, right, bottom of each box, shape (boxes, 4).
        confidences
            0..1, shape (boxes,).
        stamp_s
            When the picture was taken.
        shift_px
            By how much everything has moved in the picture since the last one because the camera turned.
        picture_px
            Width and height of the picture: who is cut off at its side is not seen well.
        appearance_of
            Asked for new and doubtful ones, and now and then for a good view of somebody; None without such a model.
        """
        since_s = math.inf if self._stamp_s is None else max(0.0, stamp_s - self._stamp_s)
        if self._stamp_s is not None:
            self._pauses_s.append(since_s)
        self._stamp_s, self._embeddings_left = (
            stamp_s,
            min(_MAX_EMBEDDED, self._embeddings_left + _EMBEDDED_PER_S * since_s),
        )
        # Tracks lost for longer are matched by appearance only.
        for track in self._tracks:
            if stamp_s - track.seen_s <= self._presence_timeout_s(LOST_S):
                track.advance(stamp_s, shift_px)
        sure = np.flatnonzero(confidences >= SURE).tolist()
        perhaps = np.flatnonzero((confidences >= PERHAPS) & (confidences < SURE)).tolist()
        waiting = [track for track in self._tracks if stamp_s - track.seen_s <= self._presence_timeout_s(LOST_S)]
        views = _Views(appearance_of, at_most=int(self._embeddings_left))
        views.compute(_doubtful(waiting, sure, corners_px, stamp_s))
        pairs: list[tuple[_Track, int]] = []
        for buffer in BUFFERS:
            found = _pairs(waiting, sure, corners_px, confidences, buffer=buffer, least=_LEAST_OVERLAP, views=views)
            pairs += found
            waiting, sure = _left(waiting, sure, found)
        # A low-confidence box may continue a track, but not begin one.
        known = [track for track in waiting if track.confirmed]
        found = _pairs(known, perhaps, corners_px, confidences, buffer=0.0, least=_LEAST_OVERLAP_PERHAPS)
        pairs += found
        waiting, perhaps = _left(waiting, perhaps, found)
        new = [box for box in perhaps if confidences[box] >= NEW]
        pairs += _pairs(waiting, new, corners_px, confidences, buffer=BUFFERS[0], least=_LEAST_OVERLAP_PERHAPS)
        for track, box in pairs:
            track.doubted |= stamp_s - track.seen_s > _DOUBTED_AFTER_S
            track.see(corners_px[box], stamp_s)
            track.evidence += _evidence(float(confidences[box]))
        taken = {box for _, box in pairs}
        left = [box for box in np.flatnonzero(confidences >= NEW).tolist() if box not in taken]
        pairs += self._begin(left, corners_px, confidences, stamp_s, [box for _, box in pairs])
        self._learn_appearance(pairs, view_qualities(corners_px, confidences, picture_px), stamp_s, views)
        followed = [(track.number, box) for track, box in pairs if self._counts(track, stamp_s)]
        self._forget(stamp_s)
        self._embeddings_left -= len(views)
        self._began = True
        return followed

    def _begin(
        self, boxes: list[int], corners_px: Floats, confidences: Floats, stamp_s: float, taken: list[int]
    ) -> list[tuple[_Track, int]]:
        begun = []
        for box in boxes:
            if confidences[box] < NEW:
                continue
            if taken and overlaps(corners_px[[box]], corners_px[taken]).max() > _SAME_BOX:
                continue
            if confidences[box] < SURE and _covered(corners_px[box], np.delete(corners_px, box, axis=0)) > _ALONE:
                continue
            track = _Track(*first_seen(corners_px[box], stamp_s), evidence=_evidence(float(confidences[box])))
            self._tracks.append(track)
            begun.append((track, box))
        return begun

    def _learn_appearance(
        self, pairs: list[tuple[_Track, int]], qualities: Floats, stamp_s: float, views: "_Views"
    ) -> None:
        """Learn from good views, periodically. For a new track every view counts until there is a good one."""
        new = [(track, box) for track, box in pairs if not track.confirmed]
        due = [
            (track, box)
            for track, box in pairs
            if track.confirmed and qualities[box] >= _GOOD_VIEW and stamp_s - track.looked_s >= _EMBED_EVERY_S
        ]
        views.compute([box for _, box in (*new, *due)])
        here = {id(track): box for track, box in pairs}
        for track, box in pairs:
            track.doubted |= bool(qualities[box] < _GOOD_VIEW)
        for track, box in (*new, *due):
            embedding, good = views.of(box), bool(qualities[box] >= _GOOD_VIEW)
            if embedding is None or (track.well_seen and not good):
                continue
            if track.confirmed and not self._exchange_mistaken(track, embedding, here, qualities, views):
                self._end_if_other_person(track, embedding, stamp_s)
            track.doubted = False
            track.embedding = embedding if good and not track.well_seen else _mixed(track.embedding, embedding)
            track.well_seen, track.looked_s = track.well_seen or good, stamp_s

    def _exchange_mistaken(
        self, track: _Track, embedding: Floats, here: dict[int, int], qualities: Floats, views: "_Views"
    ) -> bool:
        """Undo an identity switch: a track whose appearance clearly matches another track instead of its own."""
        distance = _apart(track.embedding, embedding)
        if distance <= _UNLIKE:
            return False
        others = [other for other in self._tracks if other is not track and other.confirmed and other.well_seen]
        other = min(others, key=lambda each: _apart(each.embedding, embedding), default=None)
        if other is None or _apart(other.embedding, embedding) > min(_SAME_PERSON, distance - _MISTAKEN_BY):
            return False
        box = here.get(id(other))
        if box is not None:
            if qualities[box] < _GOOD_VIEW:
                return False
            views.compute([box])
            theirs = views.of(box)
            if theirs is None or _apart(track.embedding, theirs) > _apart(other.embedding, theirs) - _MISTAKEN_BY:
                return False
        track.number, other.number = other.number, track.number
        track.embedding, other.embedding = other.embedding, track.embedding
        return True

    def _end_if_other_person(self, track: _Track, embedding: Floats, stamp_s: float) -> None:
        """End a track that continued on another person: the box matches no known appearance."""
        if not (track.doubted and track.well_seen and _apart(track.embedding, embedding) > _STRANGE):
            return
        away_s = stamp_s - self._presence_timeout_s(LOST_S) - 1e-3  # known by appearance only, without a position
        ended = replace(track, mean=track.mean.copy(), covariance=track.covariance.copy(), seen_s=away_s)
        self._tracks.append(ended)
        track.number, track.embedding, track.well_seen = next(self._numbers), None, False

    def _counts(self, track: _Track, stamp_s: float) -> bool:
        if not track.confirmed and track.evidence >= (_CONFIRM_AFTER if self._began else SURE):
            back, likely = self._who_is_back(track, stamp_s)
            if back is not None:
                self._tracks.remove(back)
                track.number = back.number
                track.embedding = _mixed(back.embedding, track.embedding)
            elif not likely or track.well_seen or stamp_s - track.first_s >= _WAIT_FOR_VIEW_S:
                track.number = next(self._numbers)
        return track.confirmed

    def _who_is_back(self, track: _Track, stamp_s: float) -> tuple[_Track | None, bool]:
        """Lost track that a new one matches by appearance unambiguously; and whether any track might match."""
        away = sorted(
            (
                (_apart(each.embedding, track.embedding), number)
                for number, each in enumerate(self._tracks)
                if each.confirmed and each.seen_s < stamp_s and each.embedding is not None
            )
        )
        if track.embedding is None or not away:
            return None, False
        nearest = away[0][0]
        clear = len(away) == 1 or away[1][0] - nearest >= _SAME_MARGIN
        return self._tracks[away[0][1]] if clear and nearest <= _SAME_PERSON else None, nearest <= _LIKELY_SAME

    def _forget(self, stamp_s: float) -> None:
        tentative_s, lost_s = self._presence_timeout_s(_TENTATIVE_S), self._presence_timeout_s(LOST_S)
        self._tracks = [
            track
            for track in self._tracks
            if stamp_s - track.seen_s
            <= (tentative_s if not track.confirmed else lost_s if track.embedding is None else REMEMBERED_S)
        ]

    def _presence_timeout_s(self, usual_s: float) -> float:
        """Timeout, longer at low frame rates, since absence is only known from frames."""
        return max(usual_s, min(_PATIENCE_AT_MOST_S, _PATIENT_PAUSES * max(self._pauses_s, default=0.0)))


def view_qualities(corners_px: Floats, confidences: Floats, picture_px: tuple[float, float] | None) -> Floats:
    """View quality per box, 0..1: confidence, size, occlusion, clipping at the image border."""
    qualities = confidences.astype(np.float64)
    for row, corners in enumerate(corners_px):
        covered = _covered(corners, np.delete(corners_px, row, axis=0))
        big = min(1.0, float(corners[3] - corners[1]) / _TALL_PX)
        cut = picture_px is not None and (corners[0] < 2.0 or corners[2] > picture_px[0] - 2.0)
        qualities[row] *= max(0.0, 1.0 - 1.5 * covered) * big * (0.5 if cut else 1.0)
    return qualities


def _covered(corners: Floats, others: Floats) -> float:
    """Largest fraction of a box that another box covers."""
    wide = np.minimum(corners[2], others[:, 2]) - np.maximum(corners[0], others[:, 0])
    high = np.minimum(corners[3], others[:, 3]) - np.maximum(corners[1], others[:, 1])
    area = (corners[2] - corners[0]) * (corners[3] - corners[1])
    return float((np.clip(wide, 0.0, None) * np.clip(high, 0.0, None)).max(initial=0.0) / max(1e-9, area))


class _Views:
    """Appearance embeddings of the boxes in one frame, as far as computed."""

    def __init__(self, appearance_of: AppearanceOf | None, at_most: int) -> None:
        self._appearance_of = appearance_of
        self._at_most = at_most
        self._known: dict[int, Floats] = {}

    def compute(self, boxes: Sequence[int]) -> None:
        unknown = [box for box in boxes if box not in self._known][: self._at_most - len(self._known)]
        if self._appearance_of is not None and unknown:
            self._known.update(zip(unknown, self._appearance_of(unknown), strict=True))

    def of(self, box: int) -> Floats | None:
        return self._known.get(box)

    def __len__(self) -> int:
        return len(self._known)


def _doubtful(tracks: list[_Track], boxes: list[int], corners_px: Floats, stamp_s: float) -> list[int]:
    """Boxes that match no track, several tracks, or only a lost one."""
    if not boxes:
        return []
    if not tracks:
        return boxes
    overlap = overlaps(corners_of(tracks), corners_px[boxes], BUFFERS[0])
    lost = np.array([stamp_s - track.seen_s > _DOUBTED_AFTER_S for track in tracks])
    near = overlap > np.maximum(_CONTESTED, _RIVAL * overlap.max(axis=0))
    clear = (near.sum(axis=0) == 1) & ~near[lost].any(axis=0)
    return [box for box, is_clear in zip(boxes, clear.tolist(), strict=True) if not is_clear]


def _mixed(before: Floats | None, embedding: Floats | None) -> Floats | None:
    if before is None or embedding is None:
        return embedding if before is None else before
    mixed = _MEMORY * before + (1 - _MEMORY) * embedding
    return np.asarray(mixed / np.linalg.norm(mixed))


def _apart(first: Floats | None, second: Floats | None) -> float:
    """Cosine distance of two embeddings, the typical one if one is missing."""
    return _USUAL_DISTANCE if first is None or second is None else 1.0 - float(first @ second)


def _pairs(
    tracks: list[_Track],
    boxes: list[int],
    corners_px: Floats,
    confidences: Floats,
    *,
    buffer: float,
    least: float,
    views: _Views | None = None,
) -> list[tuple[_Track, int]]:
    """Optimal assignment of boxes to tracks by overlap, weighted by confidence."""
    if not tracks or not boxes:
        return []
    overlap = overlaps(corners_of(tracks), corners_px[boxes], buffer)
    cost = 1.0 - overlap * (0.5 + 0.5 * confidences[boxes][None, :])
    if views is not None:
        embeddings = [views.of(box) for box in boxes]
        cost += [
            [_WEIGHT * (_apart(track.embedding, each) - _USUAL_DISTANCE) for each in embeddings] for track in tracks
        ]
    return [(tracks[row], boxes[column]) for row, column in assigned(cost, 1.0) if overlap[row, column] >= least]


def _left(tracks: list[_Track], boxes: list[int], found: list[tuple[_Track, int]]) -> tuple[list[_Track], list[int]]:
    used = {id(track) for track, _ in found}
    taken = {box for _, box in found}
    return [track for track in tracks if id(track) not in used], [box for box in boxes if box not in taken]


def _evidence(confidence: float) -> float:
    return confidence if confidence >= SURE else _POOR_COUNTS * confidence
