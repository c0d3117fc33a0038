"""Frames of the simulator's twenty people without a robot: crops of one person, and a camera that films visits.

Ground truth for recognition benchmarks: identity, box, clothes and orientation. No process, socket or clock; a frame
takes one or two milliseconds once everybody has been drawn (40 ms for each side of each person).

>>> for frame in film([Visit(person=3, comes_s=0.0), Visit(person=7, comes_s=4.0, clothes=1)], rate_hz=7.5):
...     look_at(frame.image_bgr, frame.boxes)
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.simulator.characters import CHARACTERS, Appearance, draw
from caris_desktop.simulator.floor_plan import START
from caris_desktop.simulator.picture import Painter
from caris_desktop.simulator.robot_simulation import (
    FOCAL_PX,
    HEIGHT_PX,
    MOUNT_HEIGHT_M,
    ROBOT_FROM_CAMERA,
    WIDTH_PX,
    View,
)
from caris_desktop.simulator.simulated_people import Visit

PEOPLE = len(CHARACTERS)
_Image = NDArray[np.uint8]
_WALK_MPS, _STRIDE_M = 1.1, 1.3
_IN_FROM_M = 4.5
_NOISE_STD = 3.0
IN_THE_LOBBY = START @ ROBOT_FROM_CAMERA
_SPOTS_M = (-0.8, 0.05, 0.85)


@dataclass(frozen=True, slots=True)
class TrueBox:
    """Identity and box of a person, clipped to the frame.

    ``visit`` is the index of the visit, ``facing_rad`` the rotation away from the camera, ``visible_share`` the part of
    the person not hidden by nearer ones.
    """

    visit: int
    person: int
    clothes: int
    left_px: float
    top_px: float
    width_px: float
    height_px: float
    facing_rad: float
    visible_share: float


@dataclass(frozen=True, slots=True, eq=False)
class FilmedFrame:
    """One frame, BGR, uint8, shape (480, 640, 3), with the boxes of all people in it."""

    stamp_ns: int
    image_bgr: _Image
    boxes: tuple[TrueBox, ...]


def crop_of(
    person: int, clothes: int, facing_rad: float, chance: np.random.Generator, *, stride_rad: float | None = None
) -> _Image:
    """Crop of one person along the box, 120 to 360 px high, with random background and brightness."""
    cut_out = draw(Appearance(person, clothes), facing_rad, stride_rad)[0]
    columns = np.flatnonzero(cut_out[:, :, 3].any(axis=0))
    cut_out = cut_out[:, columns[0] : columns[-1] + 1]
    scale = chance.uniform(0.3, 0.9)
    cut_out = cv2.resize(cut_out, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    height, width = cut_out.shape[:2]
    margin = height // 25 + 1
    size = (height + 2 * margin, width + 2 * margin, 3)
    picture = chance.uniform(90.0, 200.0, 3) + 100.0 * cv2.GaussianBlur(chance.normal(0.0, 1.0, size), (0, 0), 8.0)
    inside = picture[margin : margin + height, margin : margin + width]
    inside *= 1.0 - cut_out[:, :, 3:] / 255.0
    inside += cut_out[:, :, :3]
    picture = picture * chance.uniform(0.8, 1.15) + chance.normal(0.0, 4.0, size)
    return np.clip(picture, 0, 255).astype(np.uint8)


def film(
    visits: Iterable[Visit], *, rate_hz: float = 7.5, seed: int = 1, before: Pose2D = IN_THE_LOBBY
) -> Iterator[FilmedFrame]:
    """Frames of a stationary camera from the start of the first visit to the end of the last.

    Each person enters from the left or the right, stops at one of three places two or three metres away, turns (front,
    side, back, other side), and leaves. Brightness varies per visit, and each frame has noise.
    """
    rows = [_Walk.of(number, visit, np.random.default_rng([seed, number])) for number, visit in enumerate(visits)]
    if not rows:
        return
    empty = Painter().paint(View(before, ()))
    chance = np.random.default_rng([seed, len(rows)])
    # noise is expensive to generate: one array, shifted for each frame
    sheet = chance.normal(0.0, _NOISE_STD, (HEIGHT_PX + 64, WIDTH_PX + 64, 1)).astype(np.int16)
    begin_s, end_s = min(row.visit.comes_s for row in rows), max(row.end_s for row in rows)
    waiting = sorted(rows, key=lambda row: row.visit.comes_s)
    here: list[_Walk] = []
    for index in range(math.ceil((end_s - begin_s) * rate_hz) + 1):
        now_s = begin_s + index / rate_hz
        while waiting and waiting[0].visit.comes_s <= now_s:
            here.append(waiting.pop(0))
        here = [row for row in here if row.end_s > now_s]
        picture = empty.copy()
        boxes = _painted(picture, sorted((row.at(now_s) for row in here), key=lambda figure: -figure.ahead_m))
        down, right = (int(offset) for offset in chance.integers(0, 64, 2))
        noise = sheet[down : down + HEIGHT_PX, right : right + WIDTH_PX]
        noisy = np.clip(picture.astype(np.int16) + noise, 0, 255).astype(np.uint8)
        yield FilmedFrame(round(now_s * 1e9), noisy, boxes)


@dataclass(frozen=True, slots=True)
class _Figure:
    """One person at one time: position and orientation relative to the camera, and phase of the step."""

    walk: "_Walk"
    ahead_m: float
    right_m: float
    facing_rad: float
    stride_rad: float | None


@dataclass(frozen=True, slots=True)
class _Walk:
    number: int
    visit: Visit
    from_right: bool
    leaves_right: bool
    ahead_m: float
    right_m: float
    light: float

    @classmethod
    def of(cls, number: int, visit: Visit, chance: np.random.Generator) -> "_Walk":
        from_right, leaves_right = (bool(side) for side in chance.integers(0, 2, 2))
        ahead_m, light = chance.uniform(2.0, 3.2), chance.uniform(0.88, 1.1)
        right_m = _SPOTS_M[number % len(_SPOTS_M)] + chance.uniform(-0.15, 0.15)
        return cls(number, visit, from_right, leaves_right, float(ahead_m), float(right_m), float(light))

    def _side_m(self, right: bool) -> float:
        return (1.0 if right else -1.0) * (_IN_FROM_M * math.tan(math.radians(35.0)) + 0.4)

    @property
    def _in_s(self) -> float:
        return math.hypot(_IN_FROM_M - self.ahead_m, self._side_m(self.from_right) - self.right_m) / _WALK_MPS

    @property
    def _out_s(self) -> float:
        return math.hypot(_IN_FROM_M - self.ahead_m, self._side_m(self.leaves_right) - self.right_m) / _WALK_MPS

    @property
    def end_s(self) -> float:
        return self.visit.comes_s + self._in_s + self.visit.stays_s + self._out_s

    def at(self, now_s: float) -> _Figure:
        since_s = now_s - self.visit.comes_s
        spot = np.array((self.ahead_m, self.right_m))
        stand_s = since_s - self._in_s
        leave_s = stand_s - self.visit.stays_s
        if stand_s >= 0.0 > leave_s:
            return _Figure(self, self.ahead_m, self.right_m, math.pi / 2.0 * (int(stand_s / 4.0) % 4), None)
        if stand_s < 0.0:
            first, last, share = np.array((_IN_FROM_M, self._side_m(self.from_right))), spot, since_s / self._in_s
        else:
            first, last, share = spot, np.array((_IN_FROM_M, self._side_m(self.leaves_right))), leave_s / self._out_s
        ahead_m, right_m = (first + min(share, 1.0) * (last - first)).tolist()
        step = last - first
        # rotated to the left from facing the camera: walking to the camera's right shows the left side
        heading = math.atan2(-step[1], step[0])
        to_camera = math.atan2(right_m, -ahead_m)
        stride_rad = 2.0 * math.pi * share * float(np.linalg.norm(step)) / _STRIDE_M
        return _Figure(self, ahead_m, right_m, heading - to_camera, stride_rad)


def _painted(picture: _Image, figures: list[_Figure]) -> tuple[TrueBox, ...]:
    """Draw all people into the frame, the farthest first, and return their boxes."""
    boxes: list[tuple[_Figure, tuple[int, int, int, int], NDArray[np.bool_]]] = []
    for figure in figures:
        drawn = _drawn(figure)
        if drawn is None:
            continue
        left, top, cut_out = drawn
        height, width = cut_out.shape[:2]
        area = picture[top : top + height, left : left + width]
        rest = 255 - cut_out[:, :, 3:].astype(np.uint16)
        area[:] = (area * rest // 255).astype(np.uint8) + cut_out[:, :, :3]
        boxes.append((figure, (left, top, width, height), cut_out[:, :, 3] > 127))
    return tuple(_true_box(*box, nearer=boxes[index + 1 :]) for index, box in enumerate(boxes))


def _drawn(figure: _Figure) -> tuple[int, int, _Image] | None:
    """Left and top in the frame, and the sprite; None if it is less than two pixels wide or high."""
    visit = figure.walk.visit
    levels = draw(Appearance(visit.person, visit.clothes), figure.facing_rad, figure.stride_rad)
    px_per_m = FOCAL_PX / figure.ahead_m
    height_px = CHARACTERS[visit.person].height_m * px_per_m
    level = next((level for level in reversed(levels) if level.shape[0] >= height_px), levels[0])
    scale = height_px / level.shape[0]
    left_px = (WIDTH_PX - 1) / 2.0 + figure.right_m * px_per_m - level.shape[1] * scale / 2.0
    top_px = (HEIGHT_PX - 1) / 2.0 + MOUNT_HEIGHT_M * px_per_m - height_px
    x0, x1 = max(0, math.floor(left_px)), min(WIDTH_PX, math.ceil(left_px + level.shape[1] * scale))
    y0, y1 = max(0, math.floor(top_px)), min(HEIGHT_PX, math.ceil(top_px + height_px))
    if x1 - x0 < 2 or y1 - y0 < 2:
        return None
    to_picture = np.array([[scale, 0.0, left_px - x0], [0.0, scale, top_px - y0]])
    cut_out = cv2.warpAffine(level, to_picture, (x1 - x0, y1 - y0), flags=cv2.INTER_LINEAR)
    columns, rows = np.flatnonzero(cut_out[:, :, 3].any(axis=0)), np.flatnonzero(cut_out[:, :, 3].any(axis=1))
    if columns.size < 2 or rows.size < 2:
        return None
    cut_out = cut_out[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1].copy()
    lit = cv2.multiply(cut_out[:, :, :3], (figure.walk.light,) * 4)
    cut_out[:, :, :3] = np.minimum(lit, cut_out[:, :, 3:])
    return x0 + int(columns[0]), y0 + int(rows[0]), cut_out


def _true_box(
    figure: _Figure,
    area: tuple[int, int, int, int],
    body: NDArray[np.bool_],
    *,
    nearer: list[tuple[_Figure, tuple[int, int, int, int], NDArray[np.bool_]]],
) -> TrueBox:
    left, top, width, height = area
    seen = body.copy()
    for _, (other_left, other_top, other_width, other_height), other in nearer:
        x0, x1 = max(left, other_left), min(left + width, other_left + other_width)
        y0, y1 = max(top, other_top), min(top + height, other_top + other_height)
        if x0 < x1 and y0 < y1:
            hidden = other[y0 - other_top : y1 - other_top, x0 - other_left : x1 - other_left]
            seen[y0 - top : y1 - top, x0 - left : x1 - left] &= ~hidden
    visit = figure.walk.visit
    facing_rad = (figure.facing_rad + math.pi) % (2.0 * math.pi) - math.pi
    share = float(seen.sum() / max(1, int(body.sum())))
    return TrueBox(figure.walk.number, visit.person, visit.clothes, left, top, width, height, facing_rad, share)
