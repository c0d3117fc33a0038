"""Pose classification from key points: standing or sitting, a raised hand, facing the camera.

Each frame is judged by geometry in units of trunk length, independent of distance. The output changes only after
several frames, so that a single bad one has no effect.
"""

from dataclasses import field
from typing import Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value, dataclass

Posture = Literal["", "standing", "sitting"]
Points = NDArray[np.float64]
"""The 17 of COCO, shape (17, 3): x and y in pixels, y downwards, and how visible."""

_NOSE, _EYES, _EARS = 0, (1, 2), (3, 4)
_SHOULDERS, _WRISTS, _HIPS, _KNEES = (5, 6), (9, 10), (11, 12), (13, 14)
_VISIBLE = 0.5

# Height of the knees below the hips, in trunk lengths. A thigh is as long as the trunk; of a sitting person it is
# horizontal, or points at the camera.
_STANDING_ABOVE, _SITS_BELOW = 0.65, 0.45
# Position of the nose between the eyes: 0 in the middle, 1 at one of them, as for a head turned by about 50 degrees.
_FACES_WITHIN, _TURNED_BEYOND = 0.6, 1.0

CHANGES_AFTER_S = 0.5
UNKNOWN_AFTER_S = 2.0
_FORGOTTEN_AFTER_S = 10.0


class Pose(Value):
    """Pose as in ``PersonBox``."""

    posture: Posture = ""
    hand_raised: bool | None = None
    facing: bool | None = None


def posture_of(points: Points, before: Posture = "") -> Posture:
    """Standing or sitting, empty if unknown; ``before`` decides in between (hysteresis)."""
    trunk = _trunk(points)
    knees, hips = _visible(points, _KNEES), _visible(points, _HIPS)
    if trunk is None or not len(knees) or not len(hips):
        return ""
    upright, length = trunk
    if not upright:
        return ""
    drop = (knees[:, 1].mean() - hips[:, 1].mean()) / length
    if drop > _STANDING_ABOVE:
        return "standing"
    return "sitting" if drop < _SITS_BELOW else before


def raises_hand(points: Points, before: bool | None = None) -> bool | None:
    """True if a hand is as high as the head; once raised, until it is lower than the shoulders."""
    shoulders, wrists = _visible(points, _SHOULDERS), _visible(points, _WRISTS)
    if not len(shoulders) or not len(wrists):
        return None
    highest_y, shoulders_y = wrists[:, 1].min(), shoulders[:, 1].mean()
    head = points[[_NOSE, *_EYES, *_EARS]]
    head = head[head[:, 2] > _VISIBLE]
    trunk = _trunk(points)
    if len(head):
        line_y = head[:, 1].mean()
    elif trunk is not None:
        line_y = shoulders_y - 0.4 * trunk[1]
    else:
        return None
    if highest_y < line_y:
        return True
    return before if before and highest_y < shoulders_y else False


def faces_camera(points: Points, before: bool | None = None) -> bool | None:
    """True if the face is turned to the camera; None if neither head nor shoulders are visible."""
    eyes = _visible(points, _EYES)
    nose_seen = points[_NOSE, 2] > _VISIBLE
    if not nose_seen or len(eyes) < len(_EYES):
        # A head from behind or the side lacks a face; a head outside the image lacks the ears, too.
        return False if len(_visible(points, _EARS)) and len(_visible(points, _SHOULDERS)) else None
    between = abs(eyes[0, 0] - eyes[1, 0]) / 2.0
    if between <= 0.0:
        return False
    aside = abs(points[_NOSE, 0] - eyes[:, 0].mean()) / between
    if aside < _FACES_WITHIN:
        return True
    return False if aside > _TURNED_BEYOND else before


def _visible(points: Points, which: tuple[int, ...]) -> Points:
    chosen = points[list(which)]
    return chosen[chosen[:, 2] > _VISIBLE]


def _trunk(points: Points) -> tuple[bool, float] | None:
    """Whether the trunk is upright, and its length; None if it is not visible."""
    shoulders, hips = _visible(points, _SHOULDERS), _visible(points, _HIPS)
    if not len(shoulders) or not len(hips):
        return None
    right, down = hips[:, :2].mean(axis=0) - shoulders[:, :2].mean(axis=0)
    length = float(np.hypot(right, down))
    return (bool(down > abs(right)), length) if length > 1.0 else None


T = TypeVar("T")


@dataclass(slots=True)
class _Held(Generic[T]):
    """Value that changes after CHANGES_AFTER_S of another one, and is reset after UNKNOWN_AFTER_S without any."""

    unknown: T
    value: T
    candidate: T
    since_s: float = 0.0
    seen_s: float = 0.0

    def add(self, observed: T, stamp_s: float) -> None:
        if observed == self.unknown:
            self.candidate = self.value
            if stamp_s - self.seen_s > UNKNOWN_AFTER_S:
                self.value = self.candidate = self.unknown
        elif observed == self.value:
            self.candidate, self.seen_s = observed, stamp_s
        elif observed != self.candidate:
            self.candidate, self.since_s = observed, stamp_s
        elif stamp_s - self.since_s >= CHANGES_AFTER_S:
            self.value, self.seen_s = observed, stamp_s


@dataclass(slots=True)
class _Body:
    posture: _Held[Posture] = field(default_factory=lambda: _Held[Posture]("", "", ""))
    hand_raised: _Held[bool | None] = field(default_factory=lambda: _Held[bool | None](None, None, None))
    facing: _Held[bool | None] = field(default_factory=lambda: _Held[bool | None](None, None, None))
    last_s: float = 0.0


class Poses:
    """Poses of all tracks."""

    def __init__(self) -> None:
        self._bodies: dict[int, _Body] = {}

    def of(self, track: int, points: Points, stamp_s: float) -> Pose:
        """Filtered pose of a track, after key points in the frame of ``stamp_s``."""
        if track not in self._bodies:
            self._bodies = {
                known: body for known, body in self._bodies.items() if stamp_s - body.last_s < _FORGOTTEN_AFTER_S
            }
        body = self._bodies.setdefault(track, _Body())
        body.last_s = stamp_s
        body.posture.add(posture_of(points, body.posture.value), stamp_s)
        body.hand_raised.add(raises_hand(points, body.hand_raised.value), stamp_s)
        body.facing.add(faces_camera(points, body.facing.value), stamp_s)
        return Pose(body.posture.value, body.hand_raised.value, body.facing.value)
