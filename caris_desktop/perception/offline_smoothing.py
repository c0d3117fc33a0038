"""Offline smoothing of tracks, once all frames are known: for recordings, never for the console."""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import dataclass
from caris_desktop.perception.kalman_tracker import Floats
from caris_desktop.perception.tracker import TrackedBox

_SAME_PERSON, _LIKELY_SAME = 0.25, 0.4
_GOOD_VIEW = 0.4
_NEAR_S = 1.5
"""Longest gap for joining track segments by extrapolation."""
_VELOCITY_S = 0.5
_NEAR_OF_HEIGHT = 0.5
_FILLED_S = 2.0
"""How long somebody may be unseen and still be put between where they were before and after."""
NOBODY_FOUND = 0.0
"""The confidence of boxes that were put between two others."""


@dataclass(slots=True)
class _TrackSegment:
    """All boxes of one track number. ``embedding`` is a sum over good views."""

    number: int
    pictures: set[int]
    first: TrackedBox
    embedding: Floats | None = None


def looked_back(pictures: Sequence[Sequence[TrackedBox]], stamps_s: Sequence[float]) -> list[list[TrackedBox]]:
    """Tracks with fragments joined, and gaps of up to two seconds filled.

    ``pictures`` are the people in each frame of one camera, ``stamps_s`` the capture times. Filled boxes have the
    confidence :data:`NOBODY_FOUND`.
    """
    one_for = linked(pictures, stamps_s)
    joined = [[replace(box, track=one_for[box.track]) for box in boxes] for boxes in pictures]
    filled = [list(boxes) for boxes in joined]
    last_boxes: dict[int, tuple[int, TrackedBox]] = {}
    for at, boxes in enumerate(joined):
        for box in boxes:
            before = last_boxes.get(box.track)
            if before is not None and at - before[0] > 1 and stamps_s[at] - stamps_s[before[0]] <= _FILLED_S:
                for between in range(before[0] + 1, at):
                    part = (stamps_s[between] - stamps_s[before[0]]) / max(1e-9, stamps_s[at] - stamps_s[before[0]])
                    filled[between].append(_between(before[1], box, part))
            last_boxes[box.track] = (at, box)
    return filled


def linked(pictures: Sequence[Sequence[TrackedBox]], stamps_s: Sequence[float]) -> dict[int, int]:
    """Representative number of each track's person; two boxes of one frame never share one."""
    stretches = _intervals(pictures)
    one_for = {number: number for number in stretches}
    for first, second in _nearest_first(stretches, pictures, stamps_s):
        a, b = stretches[one_for[first]], stretches[one_for[second]]
        if a is b or a.pictures & b.pictures or _apart(a, b, unknown=0.0) > _LIKELY_SAME:
            continue
        a.pictures |= b.pictures
        if b.embedding is not None:
            a.embedding = b.embedding if a.embedding is None else a.embedding + b.embedding
        one_for = {number: a.number if one == b.number else one for number, one in one_for.items()}
    return one_for


def _nearest_first(
    stretches: dict[int, _TrackSegment], pictures: Sequence[Sequence[TrackedBox]], stamps_s: Sequence[float]
) -> list[tuple[int, int]]:
    """Candidate pairs: continued motion first, then similar appearance, most likely first."""
    pairs: list[tuple[float, int, int]] = []
    for a, b in itertools.permutations(stretches.values(), 2):
        if max(a.pictures) < min(b.pictures):
            distance = _off_path(a, b, pictures, stamps_s)
            if distance <= _NEAR_OF_HEIGHT:
                pairs.append((distance - 1.0, a.number, b.number))
    for a, b in itertools.combinations(stretches.values(), 2):
        apart = _apart(a, b, unknown=1.0)
        if apart <= _SAME_PERSON:
            pairs.append((apart, a.number, b.number))
    return [(first, second) for _, first, second in sorted(pairs)]


def _off_path(
    a: _TrackSegment, b: _TrackSegment, pictures: Sequence[Sequence[TrackedBox]], stamps_s: Sequence[float]
) -> float:
    """Distance of the start of ``b`` from the extrapolated ``a``, in box heights; infinite after too long a gap."""
    last, begins = max(a.pictures), min(b.pictures)
    gap_s = stamps_s[begins] - stamps_s[last]
    if gap_s > _NEAR_S:
        return float("inf")
    before = min((at for at in a.pictures if stamps_s[last] - stamps_s[at] <= _VELOCITY_S), default=last)
    ended, earlier = _middle(_box(pictures, last, a.number)), _middle(_box(pictures, before, a.number))
    velocity = (ended - earlier) / max(1e-9, stamps_s[last] - stamps_s[before]) if before != last else np.zeros(2)
    height_px = max(1.0, b.first.height_px)
    return float(np.linalg.norm(_middle(b.first) - ended - velocity * gap_s) / height_px)


def _intervals(pictures: Sequence[Sequence[TrackedBox]]) -> dict[int, _TrackSegment]:
    stretches: dict[int, _TrackSegment] = {}
    for at, boxes in enumerate(pictures):
        for box in boxes:
            stretch = stretches.setdefault(box.track, _TrackSegment(box.track, set(), box))
            stretch.pictures.add(at)
            if box.embedding is not None and box.quality >= _GOOD_VIEW:
                weighted = box.quality * box.embedding
                stretch.embedding = weighted if stretch.embedding is None else stretch.embedding + weighted
    return stretches


def _apart(a: _TrackSegment, b: _TrackSegment, *, unknown: float) -> float:
    """Cosine distance of the mean embeddings."""
    if a.embedding is None or b.embedding is None:
        return unknown
    return 1.0 - float(a.embedding @ b.embedding / (np.linalg.norm(a.embedding) * np.linalg.norm(b.embedding)))


def _between(before: TrackedBox, after: TrackedBox, part: float) -> TrackedBox:
    def at(first: float, second: float) -> float:
        return first + part * (second - first)

    return TrackedBox(
        before.track,
        at(before.left_px, after.left_px),
        at(before.top_px, after.top_px),
        at(before.width_px, after.width_px),
        at(before.height_px, after.height_px),
        NOBODY_FOUND,
        -1,
    )


def _box(pictures: Sequence[Sequence[TrackedBox]], at: int, number: int) -> TrackedBox:
    return next(box for box in pictures[at] if box.track == number)


def _middle(box: TrackedBox) -> NDArray[np.float64]:
    return np.array([box.left_px + box.width_px / 2, box.top_px + box.height_px / 2])
