"""Renderer of characters from any side: bodies of tubes with clothes and shading.

Characters have no photos, so that they can be shown from the front, the side and behind, in either set of clothes. They
are simplified: noise instead of creases, a face of a few spots, hands like mittens.
"""

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import field
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.simulator.shipped_data import built, shipped_data

Image = NDArray[np.uint8]
Floats = NDArray[np.float64]
Paint = Callable[[Floats, Floats], Floats]
"""Colour, BGR 0..255, shape (..., 3), of points at (share of the way along the tube, angle; 0 is the front)."""

HEIGHT_PX = 400
_DRAWN_PX = 800  # twice the size, for soft edges
_VIEWS, _STRIDES = 24, 6
_LIGHT = np.array([-0.35, 0.5, 0.75]) / np.linalg.norm([-0.35, 0.5, 0.75])  # from the right of the camera, front, above
_SIDES = 28
_AHEAD, _UP = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])


Hair = Literal["short", "long", "bun", "bald", "curls"]
Pattern = Literal["plain", "stripes", "checks", "halves", "print", "dots"]
Top = Literal["shirt", "jumper", "open jacket", "long coat", "vest", "hooded"]
Lower = Literal["trousers", "wide trousers", "skirt", "long skirt", "shorts", "dress"]
Bag = Literal["", "backpack", "shoulder bag"]
Headwear = Literal["", "cap", "beanie", "scarf"]


class Clothes(Value):
    """Set of clothes. Colours are written as ``#rrggbb``; ``second`` is that of the pattern or of the layer beneath."""

    top: Top
    colour: str
    second: str
    lower: Lower
    lower_colour: str
    shoes: str
    pattern: Pattern = "plain"
    bag: Bag = ""
    bag_colour: str = "#303030"
    headwear: Headwear = ""
    headwear_colour: str = "#202020"


class Character(Value):
    """Constant features of a person. ``build``: relative width, 1 is normal."""

    height_m: float
    build: float
    skin: str
    hair: Hair
    hair_colour: str
    clothes: tuple[Clothes, Clothes]
    beard: bool = False


CHARACTERS: tuple[Character, ...] = built(tuple[Character, ...], shipped_data("characters.yaml"))
"""The people, by their number."""


class Appearance(Value):
    """Person and clothes: rows of ``CHARACTERS`` and of their clothes."""

    person: int
    clothes: int = 0

    @property
    def figure(self) -> Character:
        return CHARACTERS[self.person % len(CHARACTERS)]

    @property
    def worn(self) -> Clothes:
        return self.figure.clothes[self.clothes % 2]


def levels_of(picture: Image) -> list[Image]:
    """Image pyramid: full size, half, a quarter ..., against aliasing of distant people."""
    levels = [picture]
    while levels[-1].shape[0] > 50:
        height, width = levels[-1].shape[:2]
        levels.append(np.asarray(cv2.resize(levels[-1], (width // 2, height // 2), interpolation=cv2.INTER_AREA)))
    return levels


def draw(appearance: Appearance, facing_rad: float, stride_rad: float | None = None) -> tuple[Image, ...]:
    """Image pyramid of the person: BGRA with premultiplied alpha, uint8, shape (400, width, 4), then half as large, ...

    Parameters
    ----------
    facing_rad
        How far they have turned to their left from facing the camera: pi shows their back. Rounded to 15 degrees.
    stride_rad
        Phase of their steps; None where they stand. Rounded to sixths.
    """
    view = round(facing_rad / (2.0 * math.pi) * _VIEWS) % _VIEWS
    stride = None if stride_rad is None else round(stride_rad / (2.0 * math.pi) * _STRIDES) % _STRIDES
    return _drawn(appearance, view, stride)


@functools.lru_cache(maxsize=256)
def _drawn(appearance: Appearance, view: int, stride: int | None) -> tuple[Image, ...]:
    phase = None if stride is None else stride / _STRIDES * 2.0 * math.pi
    mesh = _body(appearance, phase)
    return tuple(levels_of(_rasterised(mesh, view / _VIEWS * 2.0 * math.pi, appearance)))


@dataclass(slots=True)
class _Mesh:
    """Quadrilaterals: x to the person's left, y ahead, z up, in fractions of body height."""

    corners: list[Floats] = field(default_factory=list)
    colours: list[Floats] = field(default_factory=list)

    def tube(
        self, rows: Sequence[Sequence[float]] | Floats, paint: Paint, *, sides: int = _SIDES, rings: int = 16
    ) -> None:
        """Tube along ``rows``, shape (n, 5): x, y, z, and half widths sideways and ahead."""
        given = np.asarray(rows, dtype=np.float64)
        at, fine = np.linspace(0.0, 1.0, len(given)), np.linspace(0.0, 1.0, rings + 1)
        smooth = _rounded(np.stack([np.interp(fine, at, column) for column in given.T], axis=1))
        centre, radius = smooth[:, :3], smooth[:, 3:]
        along = np.gradient(centre, axis=0)
        along /= np.linalg.norm(along, axis=1, keepdims=True) + 1e-9
        side = np.broadcast_to(np.array([1.0, 0.0, 0.0]), along.shape)
        side = side - (side * along).sum(axis=1, keepdims=True) * along
        side /= np.linalg.norm(side, axis=1, keepdims=True) + 1e-9
        ahead = np.cross(side, along)
        ahead *= np.where(ahead[:, 1:2] < 0.0, -1.0, 1.0)
        angle = np.linspace(0.0, 2.0 * math.pi, sides + 1)
        ring = (
            centre[:, None, :]
            + np.sin(angle)[None, :, None] * (radius[:, 0, None] * side)[:, None, :]
            + np.cos(angle)[None, :, None] * (radius[:, 1, None] * ahead)[:, None, :]
        )
        faces = np.stack([ring[:-1, :-1], ring[:-1, 1:], ring[1:, 1:], ring[1:, :-1]], axis=2)
        shares = np.broadcast_to(((fine[:-1] + fine[1:]) / 2.0)[:, None], (rings, sides))
        angles = np.broadcast_to(((angle[:-1] + angle[1:]) / 2.0)[None, :], (rings, sides))
        outward = faces.mean(axis=2) - ((centre[:-1] + centre[1:]) / 2.0)[:, None, :]
        normal = np.cross(faces[:, :, 1] - faces[:, :, 0], faces[:, :, 3] - faces[:, :, 0])
        flipped = (normal * outward).sum(axis=2) < 0.0
        faces = np.where(flipped[:, :, None, None], faces[:, :, ::-1], faces)
        self.corners.append(faces.reshape(-1, 4, 3))
        self.colours.append(np.broadcast_to(paint(shares, angles), (rings, sides, 3)).reshape(-1, 3))

    def ball(self, centre: tuple[float, float, float], radius: tuple[float, float, float], paint: Paint) -> None:
        """Ellipsoid: half widths sideways, ahead and up. Its tube begins at the top."""
        polar = np.linspace(0.02, math.pi - 0.02, 15)
        path = np.array(centre) + np.outer(np.cos(polar) * radius[2], _UP)
        self.tube(np.hstack([path, np.outer(np.sin(polar), radius[:2])]), paint, sides=32, rings=20)


def _rounded(rings: Floats) -> Floats:
    """Smoothed along its length."""
    for _ in range(3):
        rings[1:-1] = (rings[:-2] + 2.0 * rings[1:-1] + rings[2:]) / 4.0
    return rings


def _bgr(colour: str) -> Floats:
    return np.array([int(colour[at : at + 2], 16) for at in (5, 3, 1)], dtype=np.float64)


def _plain(colour: Floats) -> Paint:
    return lambda along, angle: np.broadcast_to(colour, (*along.shape, 3))


def _mixed(mask: NDArray[np.bool_], first: Floats, second: Floats) -> Floats:
    return np.where(mask[..., None], first, second)


def _front(angle: Floats) -> Floats:
    """Angle from the middle of the front, 0..pi."""
    return np.abs((angle + math.pi) % (2.0 * math.pi) - math.pi)


def _patterned(worn: Clothes, *, turns: float = 1.0) -> Paint:
    colour, second = _bgr(worn.colour), _bgr(worn.second)

    def paint(along: Floats, angle: Floats) -> Floats:
        rows, columns = along * 14.0 * turns, angle / (2.0 * math.pi) * 16.0
        if worn.pattern == "stripes":
            return _mixed(rows % 2.0 < 1.0, colour, second)
        if worn.pattern == "checks":
            return (_mixed(rows % 2.0 < 1.0, colour, second) + _mixed(columns % 2.0 < 1.0, colour, second)) / 2.0
        if worn.pattern == "halves":
            return _mixed(along * turns < 0.45, colour, second)
        if worn.pattern == "dots":
            return _mixed((rows % 2.0 < 1.0) & ((columns + np.floor(rows / 2.0)) % 2.0 < 1.0), second, colour)
        if worn.pattern == "print" and turns == 1.0:
            return _mixed((_front(angle) < 0.75) & (along > 0.25) & (along < 0.55), second, colour)
        return np.broadcast_to(colour, (*along.shape, 3))

    return paint


def _torso_paint(worn: Clothes, skin: Floats) -> Paint:
    cloth = _patterned(worn)
    beneath = _bgr(worn.second)

    def paint(along: Floats, angle: Floats) -> Floats:
        colours = np.array(cloth(along, angle))
        front = _front(angle)
        if worn.top in ("open jacket", "long coat", "vest"):
            colours = _mixed(front < 0.34 - 0.18 * (along - 0.3), beneath, colours)
        colours = _mixed((front < 0.5 - 4.0 * along) & (along < 0.13), skin, colours)
        if worn.top == "hooded":
            colours = _mixed((_front(angle) > 2.3) & (along < 0.16), colours * 0.72, colours)
            colours = _mixed((front < 0.5) & (along > 0.62) & (along < 0.8), colours * 0.78, colours)
        return colours

    return paint


def _body(appearance: Appearance, phase: float | None) -> _Mesh:
    figure, worn = appearance.figure, appearance.worn
    mesh = _Mesh()
    skin = _bgr(figure.skin)
    wide = figure.build
    if phase is not None and worn.lower == "long skirt":
        phase = math.asin(0.45 * math.sin(phase))  # short steps
    swing = 0.0 if phase is None else math.sin(phase)
    coat = worn.top in ("long coat",)
    _legs(mesh, figure, worn, skin, phase)
    # torso: neck to hips, or to the knees for a coat
    hem_m = 0.34 if coat else 0.455 if worn.top in ("hooded", "jumper", "open jacket") else 0.49
    loose = 1.0 if worn.top in ("shirt", "vest") else 1.1
    belly = 0.069 + 0.07 * max(0.0, wide - 1.0)
    flare = 0.125 if coat else 0.098
    torso = np.array(
        [
            (0, 0, 0.852, 0.034, 0.036),
            (0, -0.002, 0.825, 0.085, 0.048),
            (0, 0, 0.79, 0.11, 0.058),
            (0, 0.004, 0.72, 0.11, 0.07),
            (0, 0.004, 0.62, 0.094, belly),
            (0, 0, 0.53, 0.1, belly + 0.006),
            (0, 0, hem_m, flare, belly + 0.008),
        ]
    )
    torso[1:, 3:] *= np.array([wide * loose, (0.5 + 0.5 * wide) * loose])
    torso[0, 3] *= wide**0.5
    torso[-1, 4] = max(float(torso[-1, 4]), _reach(swing, hem_m))
    mesh.tube(torso, _torso_paint(worn, skin), rings=34)
    _arms(mesh, figure, worn, swing=swing, loose=loose)
    _head(mesh, figure, worn, skin)
    if worn.bag == "backpack":
        bag = _bgr(worn.bag_colour)
        mesh.ball((0.0, -0.112 * (0.5 + 0.5 * wide), 0.69), (0.088, 0.062, 0.125), _plain(bag))
        mesh.ball((0.0, -0.155 * (0.5 + 0.5 * wide), 0.65), (0.06, 0.035, 0.06), _plain(bag * 0.8))
        for sign in (-1.0, 1.0):
            strap = [
                (sign * 0.072, -0.07, 0.8, 0.012, 0.012),
                (sign * 0.075, 0.01, 0.835, 0.012, 0.012),
                (sign * 0.08, 0.075, 0.77, 0.012, 0.012),
                (sign * 0.1, 0.05, 0.66, 0.012, 0.012),
            ]
            mesh.tube(strap, _plain(bag), sides=8, rings=12)
    elif worn.bag == "shoulder bag":
        bag = _bgr(worn.bag_colour)
        mesh.ball((0.135 * wide, 0.0, 0.5), (0.035, 0.075, 0.065), _plain(bag))
        strap = [
            (0.125 * wide, 0.03, 0.55, 0.009, 0.009),
            (0.05, 0.085, 0.68, 0.009, 0.009),
            (-0.055, 0.05, 0.82, 0.009, 0.009),
            (-0.05, -0.05, 0.82, 0.009, 0.009),
            (0.05, -0.085, 0.68, 0.009, 0.009),
            (0.125 * wide, -0.03, 0.55, 0.009, 0.009),
        ]
        mesh.tube(strap, _plain(bag), sides=8, rings=24)
    return mesh


def _legs(mesh: _Mesh, figure: Character, worn: Clothes, skin: Floats, phase: float | None) -> None:
    wide = figure.build
    lower, shoe = _bgr(worn.lower_colour), _bgr(worn.shoes)
    for sign in (-1.0, 1.0):
        turn = 0.0 if phase is None else sign * 0.42 * math.sin(phase)
        bend = 0.0 if phase is None else 0.5 * max(0.0, -sign * math.cos(phase))
        hip = np.array([sign * 0.05 * wide, 0.0, 0.5])
        knee = hip + 0.24 * np.array([sign * 0.03, math.sin(turn), -math.cos(turn)])
        ankle = knee + 0.225 * np.array([0.0, math.sin(turn - bend), -math.cos(turn - bend)])
        thigh, calf, foot = 0.058 * wide, 0.042 * wide**0.5, 0.027
        if worn.lower == "wide trousers":
            calf, foot = 0.055 * wide, 0.055 * wide
        elif worn.lower == "trousers":
            calf, foot = 0.045 * wide**0.5, 0.036
        bare_from = {"shorts": 0.45, "skirt": 0.0, "dress": 0.0, "long skirt": 0.0}.get(worn.lower, 2.0)

        def paint(along: Floats, angle: Floats, bare_from: float = bare_from) -> Floats:
            return _mixed(along > bare_from, skin, lower)

        deep = 0.056 * wide**0.6 if bare_from > 0.0 else 0.05
        leg = [
            (*(hip + 0.03 * _UP), 0.04, deep * 0.9),
            (*(hip - 0.05 * _UP), thigh, deep),
            (*knee, calf, calf * 1.08),
            (*((knee + ankle) / 2.0 - 0.006 * _AHEAD), calf * 0.96, calf * 1.05),
            (*ankle, foot, foot),
        ]
        mesh.tube(leg, paint, rings=24)
        toes = turn - bend
        toe = ankle + 0.075 * np.array([sign * 0.12, math.cos(toes), math.sin(toes)])
        sole = ankle - 0.008 * np.array([0.0, -math.sin(toes), math.cos(toes)])
        heel = sole - 0.034 * np.array([0.0, math.cos(toes), math.sin(toes)])
        shoe_rows = [
            (*heel, 0.003, 0.003),
            (*(sole + 0.01 * np.array([0, math.cos(toes), 0])), 0.028, 0.028),
            (*(toe - 0.028 * _UP), 0.027, 0.018),
            (*(toe + (0.02 * _AHEAD - 0.03 * _UP)), 0.012, 0.008),
        ]
        mesh.tube(shoe_rows, _plain(shoe), rings=10)
    if worn.lower in ("skirt", "long skirt", "dress"):
        hem_m = {"skirt": 0.31, "dress": 0.27, "long skirt": 0.1}[worn.lower]
        spread = 0.12 if worn.lower != "long skirt" else 0.125
        skirt = np.array([(0, 0, 0.6, 0.088, 0.066), (0, 0, 0.52, 0.103, 0.078), (0, 0, hem_m, spread, spread * 0.95)])
        skirt[:, 3:] *= wide**0.8
        swing = 0.0 if phase is None else math.sin(phase)
        skirt[-1, 4] = max(float(skirt[-1, 4]), _reach(swing, hem_m))
        cloth = _patterned(worn, turns=1.3) if worn.lower == "dress" else _plain(lower)
        mesh.tube(skirt, cloth, rings=22)


def _reach(swing: float, hem_m: float) -> float:
    """Forward reach of the legs at this height, which cloth hangs around."""
    return 0.09 + abs(math.sin(0.42 * swing)) * (0.58 - hem_m) if hem_m < 0.45 else 0.0


def _arms(mesh: _Mesh, figure: Character, worn: Clothes, *, swing: float, loose: float) -> None:
    skin = _bgr(figure.skin)
    wide = figure.build
    short = worn.top == "shirt" and worn.lower in ("shorts", "skirt", "dress", "wide trousers")
    sleeve = _patterned(worn, turns=0.8)
    beneath = _bgr(worn.second)
    for sign in (-1.0, 1.0):
        turn = -sign * 0.4 * swing
        shoulder = np.array([sign * (0.112 * wide * loose - 0.014), 0.0, 0.782])
        elbow = shoulder + 0.165 * np.array([sign * 0.16, math.sin(turn) - 0.04, -math.cos(turn)])
        hand = elbow + 0.15 * np.array([sign * 0.02, math.sin(turn + 0.3), -math.cos(turn + 0.3)])

        def paint(along: Floats, angle: Floats) -> Floats:
            if worn.top == "vest":
                return np.broadcast_to(beneath, (*along.shape, 3))
            return _mixed(along > 0.42, skin, sleeve(along, angle)) if short else sleeve(along, angle)

        thick = 0.034 * wide**0.7 * loose
        joints = (shoulder, (shoulder + elbow) / 2.0, elbow, hand)
        arm = [(*at, thick * share, thick * share) for at, share in zip(joints, (1.05, 1.02, 0.9, 0.68), strict=True)]
        round_cloth = _plain(beneath if worn.top == "vest" else _bgr(worn.colour))
        mesh.ball(
            (float(shoulder[0]), 0.0, float(shoulder[2])), (thick * 1.05, thick * 1.05, thick * 1.15), round_cloth
        )
        mesh.tube(arm, paint, sides=18, rings=20)
        palm = hand + 0.03 * np.array([0.0, math.sin(turn + 0.3), -math.cos(turn + 0.3)])
        mesh.ball((float(palm[0]), float(palm[1]), float(palm[2])), (0.016, 0.022, 0.042), _plain(skin))


def _head(mesh: _Mesh, figure: Character, worn: Clothes, skin: Floats) -> None:
    hair, cloth = _bgr(figure.hair_colour), _bgr(worn.headwear_colour)
    neck = [(0, -0.005, 0.9, 0.031, 0.033), (0, -0.008, 0.87, 0.032, 0.034), (0, -0.004, 0.83, 0.042, 0.042)]
    mesh.tube(neck, _plain(skin * 0.93), rings=6)
    line = {"bald": 0.0, "short": 0.3, "curls": 0.33, "bun": 0.27, "long": 0.3}[figure.hair]

    def face(along: Floats, angle: Floats) -> Floats:
        front = _front(angle)
        colours = np.broadcast_to(skin, (*along.shape, 3))
        # hair ends at the forehead in front, at the neck behind
        end = line + (0.42 if figure.hair != "bald" else 0.0) * np.clip((front - 1.0) / 0.7, 0.0, 1.0)
        colours = _mixed((along < end) & (line > 0.0), hair, colours)
        eyes = (np.abs(along - 0.5) < 0.026) & (np.abs(front - 0.4) < 0.11)
        brows = (np.abs(along - 0.43) < 0.025) & (np.abs(front - 0.42) < 0.2)
        mouth = (np.abs(along - 0.71) < 0.026) & (front < 0.3)
        colours = _mixed(brows, hair * 0.8 + skin * 0.2, colours)
        colours = _mixed(eyes, np.array([35.0, 30.0, 30.0]), colours)
        if figure.beard:
            colours = _mixed((along > 0.62) & (front < 1.35), hair * 0.85 + skin * 0.15, colours)
        return _mixed(mouth, skin * np.array([0.6, 0.55, 0.75]), colours)

    mesh.ball((0.0, 0.0, 0.928), (0.046, 0.056, 0.068), face)
    mesh.ball((0.0, 0.057, 0.921), (0.008, 0.011, 0.013), _plain(skin * 0.97))
    for sign in (-1.0, 1.0):
        if figure.hair in ("short", "bald", "bun") and worn.headwear != "scarf":
            mesh.ball((sign * 0.047, -0.004, 0.925), (0.007, 0.011, 0.016), _plain(skin * 0.9))
    if worn.headwear == "scarf":
        pass
    elif figure.hair == "curls":
        mesh.ball((0.0, -0.018, 0.951), (0.066, 0.064, 0.056), _plain(hair))
    elif figure.hair == "long":
        hair_rows = [
            (0, -0.012, 0.985, 0.03, 0.03),
            (0, -0.02, 0.95, 0.053, 0.046),
            (0, -0.03, 0.9, 0.058, 0.036),
            (0, -0.045, 0.84, 0.06, 0.03),
            (0, -0.055, 0.78, 0.045, 0.015),
        ]
        mesh.tube(hair_rows, _plain(hair), rings=14)
    elif figure.hair == "bun":
        mesh.ball((0.0, -0.058, 0.965), (0.027, 0.027, 0.027), _plain(hair * 0.9))
    if worn.headwear in ("cap", "beanie"):
        mesh.ball((0.0, -0.004, 0.957), (0.052, 0.062, 0.045), _plain(cloth))
        if worn.headwear == "cap":
            mesh.ball((0.0, 0.07, 0.955), (0.036, 0.035, 0.006), _plain(cloth * 0.85))
    elif worn.headwear == "scarf":
        mesh.ball((0.0, -0.014, 0.935), (0.056, 0.06, 0.072), _plain(cloth))
        scarf = [(0, -0.014, 0.9, 0.05, 0.05), (0, -0.01, 0.86, 0.06, 0.058), (0, 0.0, 0.81, 0.09, 0.07)]
        mesh.tube(scarf, _plain(cloth * 0.93), rings=8)


def _rasterised(mesh: _Mesh, facing_rad: float, appearance: Appearance) -> Image:
    corners = np.concatenate(mesh.corners)
    colours = np.concatenate(mesh.colours)
    cos, sin = math.cos(facing_rad), math.sin(facing_rad)
    # the camera is far away at +y; its right is +x
    turned = np.stack(
        [corners[..., 0] * cos + corners[..., 1] * sin, corners[..., 1] * cos - corners[..., 0] * sin, corners[..., 2]],
        axis=-1,
    )
    normal = np.cross(turned[:, 1] - turned[:, 0], turned[:, 3] - turned[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True) + 1e-12
    facing = normal[:, 1] > 0.0
    turned, normal, colours = turned[facing], normal[facing], colours[facing]
    light = 0.52 + 0.5 * np.clip(normal @ _LIGHT, 0.0, 1.0) + 0.12 * normal[:, 2]
    order = np.argsort(turned[:, :, 1].mean(axis=1))
    half_px = int(np.abs(turned[..., 0]).max() * _DRAWN_PX) + 4
    half_px += half_px % 2
    points = np.stack([turned[..., 0] * _DRAWN_PX + half_px, (1.0 - turned[..., 2]) * _DRAWN_PX], axis=-1)
    fixed = np.round(points * 16.0).astype(np.int32)
    shaded = np.clip(colours * light[:, None], 0.0, 255.0)
    picture: Image = np.zeros((_DRAWN_PX, 2 * half_px, 3), dtype=np.uint8)
    alpha: Image = np.zeros((_DRAWN_PX, 2 * half_px), dtype=np.uint8)
    paints = shaded.tolist()
    for at in order.tolist():
        cv2.fillConvexPoly(picture, fixed[at], paints[at], cv2.LINE_8, 4)
        cv2.fillConvexPoly(alpha, fixed[at], 255, cv2.LINE_8, 4)
    picture = _creased(picture, appearance)
    size = (half_px, HEIGHT_PX)
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    cover = cv2.resize(alpha, size, interpolation=cv2.INTER_AREA)
    return np.dstack([np.minimum(np.round(small), cover[:, :, None]), cover]).astype(np.uint8)


def _creased(picture: Image, appearance: Appearance) -> Image:
    """Image with soft folds and the grain of cloth."""
    chance = np.random.default_rng([appearance.person, appearance.clothes])
    folds = cv2.GaussianBlur(chance.normal(0.0, 1.0, picture.shape[:2]).astype(np.float32), (0, 0), 7.0, sigmaY=16.0)
    folds /= max(float(folds.std()), 1e-6)
    grain = cv2.GaussianBlur(chance.normal(0.0, 1.0, picture.shape[:2]).astype(np.float32), (0, 0), 1.2)
    gain = 1.0 + 0.055 * folds + 0.10 * grain
    return np.asarray(np.clip(picture * gain[:, :, None], 0, 255), dtype=np.uint8)
