"""Camera renderer: walls, floor and ceiling by ray casting, furniture as boxes, people as sprites."""

import math
from collections.abc import Callable, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value
from caris_desktop.simulator import characters
from caris_desktop.simulator.floor_plan import (
    FURNITURE,
    LINTELS,
    MAP_ORIGIN_M,
    MAP_SIZE_M,
    POSTERS,
    SOLID,
    WALL_HEIGHT_M,
    WALLS,
    Box,
    Colour,
    Poster,
)
from caris_desktop.simulator.lidar import corners_of, entry_and_exit
from caris_desktop.simulator.robot_simulation import FOCAL_PX, HEIGHT_PX, MOUNT_HEIGHT_M, WIDTH_PX, View
from caris_desktop.simulator.shipped_data import shipped_file
from caris_desktop.simulator.simulated_people import Seen

Image = NDArray[np.uint8]

PX_PER_M = 72
FLOOR_PX_PER_M = 48
SHEET_WIDTH_PX = 2400
_GAP_PX = 2
_FLOOR_SIZE = (round(MAP_SIZE_M[0] * FLOOR_PX_PER_M), round(MAP_SIZE_M[1] * FLOOR_PX_PER_M))
FLOOR_AT = (0, 0)
CEILING_AT = (_FLOOR_SIZE[0] + _GAP_PX, 0)
WALL_STRIP_PX = round(WALL_HEIGHT_M * PX_PER_M)
SIDES = ("west", "east", "south", "north")

_ROOMS = (
    # x0, y0, x1, y1, walls (blue, green, red), floor
    ((0.0, 0.0, 6.0, 4.2), (214, 226, 232), "oak"),
    ((6.0, 0.0, 12.0, 4.2), (228, 226, 220), "grey"),
    ((12.0, 0.0, 16.0, 4.2), (206, 226, 222), "tiles"),
    ((0.0, 4.2, 16.0, 5.8), (220, 226, 228), "grey"),
    ((0.0, 5.8, 4.6, 10.0), (208, 218, 206), "carpet"),
    ((4.6, 5.8, 10.0, 10.0), (224, 216, 206), "oak"),
    ((10.0, 5.8, 16.0, 10.0), (222, 222, 230), "oak"),
)


def shipped_image(name: str) -> Image:
    """Image of ``resources/simulator``: uint8, BGR or BGRA."""
    return np.asarray(cv2.imdecode(np.fromfile(shipped_file(name), np.uint8), cv2.IMREAD_UNCHANGED))


def sheet() -> tuple[Image, NDArray[np.float32]]:
    """Painted sheet, and the position of each wall side on it.

    Returns
    -------
    sheet
        BGR, uint8.
    strips
        float32, shape (walls, 4, 2): left and top pixel of each side in the order of :data:`SIDES`.
    """
    grain = np.random.default_rng(7)
    strips = np.zeros((len(WALLS), 4, 2), dtype=np.float32)
    painted: list[tuple[int, int, Image]] = []
    left, top = 0, _FLOOR_SIZE[1] + _GAP_PX
    for index, wall in enumerate(WALLS):
        for side in range(4):
            picture = _wall_side(wall, SIDES[side], grain)
            if left + picture.shape[1] > SHEET_WIDTH_PX:
                left, top = 0, top + WALL_STRIP_PX + _GAP_PX
            strips[index, side] = (left, top)
            painted.append((left, top, picture))
            left += picture.shape[1] + _GAP_PX
    texture = np.zeros((top + WALL_STRIP_PX + _GAP_PX, SHEET_WIDTH_PX, 3), dtype=np.uint8)
    for x, y, picture in painted:
        # the camera interpolates, so pixels beyond an edge must equal the edge
        wider = cv2.copyMakeBorder(picture, 0, 1, 0, 1, cv2.BORDER_REPLICATE)
        texture[y : y + wider.shape[0], x : x + wider.shape[1]] = wider
    floor = _floor(grain)
    texture[: floor.shape[0], : floor.shape[1]] = floor
    ceiling = _ceiling()
    texture[: ceiling.shape[0], CEILING_AT[0] : CEILING_AT[0] + ceiling.shape[1]] = ceiling
    return texture, strips


def _floor(grain: np.random.Generator) -> Image:
    width, height = _FLOOR_SIZE
    picture = np.full((height, width, 3), (150, 156, 160), dtype=np.uint8)
    for (x0, y0, x1, y1), _, kind in _ROOMS:
        (left, top), (right, bottom) = _floor_px(x0, y0), _floor_px(x1, y1)
        patch = picture[top:bottom, left:right]
        patch[:] = _FLOORS[kind](patch.shape[0], patch.shape[1], grain)
    # objects on the floor darken their surroundings
    shade = np.full((height, width), 1.0, dtype=np.float32)
    for box in SOLID:
        cv2.rectangle(shade, _floor_px(box.x0_m, box.y0_m), _floor_px(box.x1_m, box.y1_m), 0.45, cv2.FILLED)
    shade = cv2.GaussianBlur(shade, (0, 0), 0.16 * FLOOR_PX_PER_M)
    return np.asarray((picture * shade[:, :, None]).clip(0, 255), dtype=np.uint8)


def _oak(height: int, width: int, grain: np.random.Generator) -> Image:
    board = FLOOR_PX_PER_M // 5
    picture = np.zeros((height, width, 3), dtype=np.float32)
    for top in range(0, height, board):
        left = -int(grain.integers(0, FLOOR_PX_PER_M))
        while left < width:
            long = int(grain.integers(FLOOR_PX_PER_M, 2 * FLOOR_PX_PER_M))
            tone = grain.uniform(0.9, 1.06)
            picture[top : top + board, max(left, 0) : left + long] = np.array((112, 150, 184)) * tone
            left += long
        picture[top : top + 1] *= 0.86
        picture[top : top + board] += grain.normal(0.0, 2.5, (1, width, 1))
    return _noisy(picture, grain, 2.0)


def _tiles(height: int, width: int, grain: np.random.Generator) -> Image:
    tile = FLOOR_PX_PER_M // 2
    picture = np.full((height, width, 3), (186, 192, 194), dtype=np.float32)
    checked = (np.arange(height)[:, None] // tile + np.arange(width)[None, :] // tile) % 2
    picture[checked == 1] = (168, 174, 178)
    return _noisy(picture, grain, 2.0)


def _plain(colour: tuple[int, int, int], sigma: float) -> Callable[[int, int, np.random.Generator], Image]:
    return lambda height, width, grain: _noisy(np.full((height, width, 3), colour, np.float32), grain, sigma)


_FLOORS = {"oak": _oak, "grey": _plain((158, 162, 164), 4.0), "carpet": _plain((138, 126, 112), 7.0), "tiles": _tiles}


def _ceiling() -> Image:
    width, height = SHEET_WIDTH_PX - CEILING_AT[0], _FLOOR_SIZE[1]
    picture = np.full((height, min(width, _FLOOR_SIZE[0]), 3), (222, 226, 228), dtype=np.uint8)
    panel = round(0.6 * FLOOR_PX_PER_M)
    picture[::panel] = (202, 206, 208)
    picture[:, ::panel] = (202, 206, 208)
    for row in range(3, height // panel, 4):
        for column in range(2, picture.shape[1] // panel, 5):
            corner = (column * panel + 2, row * panel + 2)
            cv2.rectangle(picture, corner, (corner[0] + 2 * panel - 4, corner[1] + panel - 4), (252, 253, 254), -1)
    return picture


def _wall_side(wall: Box, side: str, grain: np.random.Generator) -> Image:
    along_x = side in ("south", "north")
    start, end = (wall.x0_m, wall.x1_m) if along_x else (wall.y0_m, wall.y1_m)
    width = max(2, round((end - start) * PX_PER_M))
    picture = np.zeros((WALL_STRIP_PX, width, 3), dtype=np.float32)
    surface = _surface_m(wall, side)
    across = surface - 0.1 if side in ("west", "south") else surface + 0.1
    for column in range(0, width, 4):
        position = start + (column + 2) / PX_PER_M
        colour = _room_colour(position, across) if along_x else _room_colour(across, position)
        picture[:, column : column + 4] = colour
    light = {"west": 0.9, "east": 0.94, "south": 1.0, "north": 0.97}[side]
    height_share = np.linspace(1.02, 0.9, WALL_STRIP_PX, dtype=np.float32)[:, None, None]
    picture *= light * height_share
    if end - start < 0.3:
        picture *= 0.88  # the reveal of a door
    painted = _noisy(picture, grain, 1.5)
    painted[-round(0.09 * PX_PER_M) :] = (painted[-1].mean(axis=0) * 0.62).astype(np.uint8)
    for poster in POSTERS:
        _hang(painted, poster, wall, side, start)
    return painted


def _surface_m(wall: Box, side: str) -> float:
    return {"west": wall.x0_m, "east": wall.x1_m, "south": wall.y0_m, "north": wall.y1_m}[side]


def _hang(strip: Image, poster: Poster, wall: Box, side: str, start_m: float) -> None:
    facing = {"west": 180, "east": 0, "south": 270, "north": 90}[side]
    along_x = side in ("south", "north")
    position, depth = (poster.x_m, poster.y_m) if along_x else (poster.y_m, poster.x_m)
    if poster.facing_deg != facing or abs(depth - _surface_m(wall, side)) > 0.1:
        return
    picture = shipped_image(f"pictures/{poster.picture}.png")
    height, width = picture.shape[:2]
    left = round((position - start_m - poster.width_m / 2) * PX_PER_M)
    top = round((WALL_HEIGHT_M - poster.middle_height_m - poster.height_m / 2) * PX_PER_M)
    if left < 0 or left + width > strip.shape[1]:
        return
    # seen from the east or the north the axis runs from right to left
    strip[top : top + height, left : left + width] = picture[:, ::-1] if side in ("west", "north") else picture


def sign(text: str) -> Image:
    """Door sign, BGR."""
    picture = np.full((80, 360, 3), (92, 66, 38), dtype=np.uint8)
    height, width = picture.shape[:2]
    (text_width, text_height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 2)
    scale = min(height * 0.5 / max(text_height, 1), width * 0.88 / max(text_width, 1))
    at = (int((width - text_width * scale) / 2), int((height + text_height * scale) / 2))
    thickness = max(1, round(scale * 2))
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, (250, 250, 250), thickness, cv2.LINE_AA)
    return picture


def _room_colour(x_m: float, y_m: float) -> tuple[int, int, int]:
    for (x0, y0, x1, y1), colour, _ in _ROOMS:
        if x0 <= x_m <= x1 and y0 <= y_m <= y1:
            return colour
    return (196, 200, 204)


def _noisy(picture: NDArray[np.float32], grain: np.random.Generator, sigma: float) -> Image:
    noise = grain.normal(0.0, sigma, picture.shape[:2]).astype(np.float32)
    return np.asarray((picture + noise[:, :, None]).clip(0, 255), dtype=np.uint8)


def _floor_px(x_m: float, y_m: float) -> tuple[int, int]:
    """Column and row of a point."""
    return round((x_m - MAP_ORIGIN_M[0]) * FLOOR_PX_PER_M), round((y_m - MAP_ORIGIN_M[1]) * FLOOR_PX_PER_M)


Floats = NDArray[np.floating]
Corner = tuple[float, float, float]  # depth, to the right, height above the floor

_NEAR_M = 0.12
_FARTHEST_PERSON_M = 14.0
_MIDDLE_X, _MIDDLE_Y = (WIDTH_PX - 1) / 2.0, (HEIGHT_PX - 1) / 2.0
MOST_TILT_RAD = 0.75
_TILT_STEP_RAD = 0.01
_MOST_PIXELS = 1_200_000
_BITS = 4  # fractional bits of cv2's drawing coordinates
_SHADES = {"west": 0.80, "east": 0.86, "south": 0.95, "north": 0.90, "top": 1.06, "bottom": 0.6}
_BOB_M = 0.025


class _Decal(Value):
    """Flat image on one side of a box."""

    side: str
    picture: Image
    share: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 1.0)  # left, top, right, bottom of the side


class _Thing(Value):
    """Object in the rooms, drawn as a whole from the floor up."""

    outline: Box
    parts: tuple[Box, ...] = ()
    decals: tuple[_Decal, ...] = ()
    person: Seen | None = None


class _Lens(Value):
    """Pinhole with a horizontal axis, so that vertical walls stay vertical."""

    width_px: int
    height_px: int
    focal_px: float
    middle_x_px: float
    middle_y_px: float
    eye_height_m: float


class _Rays:
    """Rays of each column and row of a lens, precomputed."""

    def __init__(self, lens: _Lens) -> None:
        self.lens = lens
        self.right = (np.arange(lens.width_px) - lens.middle_x_px) / lens.focal_px
        rows = (np.arange(lens.height_px) - lens.middle_y_px)[:, None]
        self.rows = rows.astype(np.float32)
        to_plane_m = np.where(rows > 0, lens.eye_height_m, WALL_HEIGHT_M - lens.eye_height_m)
        self.row_depth = (to_plane_m * lens.focal_px / np.abs(rows)).astype(np.float32)
        self.plane_left = np.where(rows > 0, FLOOR_AT[0], CEILING_AT[0]).astype(np.float32)


def _level_lens(height_m: float) -> _Lens:
    return _Lens(WIDTH_PX, HEIGHT_PX, FOCAL_PX, _MIDDLE_X, _MIDDLE_Y, height_m)


def _lens_around(tilt_rad: float, height_m: float) -> tuple[_Lens, Floats]:
    """Level lens that covers a tilted image, and the mapping of its pixels (3 x 3)."""
    cos, sin = math.cos(tilt_rad), math.sin(tilt_rad)
    turned = np.array([(1.0, 0.0, 0.0), (0.0, cos, sin), (0.0, -sin, cos)])
    to_ray = np.array([(1 / FOCAL_PX, 0, -_MIDDLE_X / FOCAL_PX), (0, 1 / FOCAL_PX, -_MIDDLE_Y / FOCAL_PX), (0, 0, 1)])
    corners = np.array([(x, y, 1.0) for x in (-1, WIDTH_PX) for y in (-1, HEIGHT_PX)])
    rays = corners @ (turned @ to_ray).T
    rays /= rays[:, 2:]
    left, top = rays[:, :2].min(axis=0).tolist()
    right, bottom = rays[:, :2].max(axis=0).tolist()
    # the most enlarged parts are near and need no more detail
    focal_px = FOCAL_PX * min(1.0, math.sqrt(_MOST_PIXELS / ((right - left) * (bottom - top))) / FOCAL_PX)
    lens = _Lens(
        width_px=math.ceil((right - left) * focal_px) + 2,
        height_px=math.ceil((bottom - top) * focal_px) + 2,
        focal_px=focal_px,
        middle_x_px=-left * focal_px + 0.5,
        # no row is exactly at the horizon, where floor and ceiling have no depth
        middle_y_px=math.floor(-top * focal_px) + 0.5,
        eye_height_m=height_m,
    )
    to_pixel = np.array([(focal_px, 0, lens.middle_x_px), (0, focal_px, lens.middle_y_px), (0, 0, 1)])
    return lens, to_pixel @ turned @ to_ray


def person_sprites() -> list[Image]:
    """Photo sprites of people: BGRA with premultiplied alpha, uint8, shape (640, width, 4)."""
    return [shipped_image(f"person-{number}.png") for number in (1, 2, 3)]


class Painter:
    """Renders images of the building."""

    def __init__(self) -> None:
        self._sheet, self._strips = sheet()
        self._walls = corners_of(WALLS)
        self._things = _furniture() + _lintels()
        self._outlines = corners_of(thing.outline for thing in self._things)
        self._people: list[Sequence[Image]] = [characters.levels_of(sprite) for sprite in person_sprites()]
        self._rays = _Rays(_level_lens(MOUNT_HEIGHT_M))

    def paint(self, view: View) -> Image:
        """Image, BGR, uint8, shape (480, 640, 3). Tilt is limited to 0.75 rad."""
        tilt_rad = round(min(max(view.tilt_rad, -MOST_TILT_RAD), MOST_TILT_RAD) / _TILT_STEP_RAD) * _TILT_STEP_RAD
        if tilt_rad == 0.0:
            return self._paint_level(view, _level_lens(view.height_m))
        # a camera rotating about its own centre sees a homography of the level image
        lens, from_picture = _lens_around(tilt_rad, view.height_m)
        level = self._paint_level(view, lens)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        return np.asarray(cv2.warpPerspective(level, from_picture, (WIDTH_PX, HEIGHT_PX), flags=flags), dtype=np.uint8)

    def _paint_level(self, view: View, lens: _Lens) -> Image:
        camera = view.map_from_camera
        if self._rays.lens != lens:
            self._rays = _Rays(lens)
        right = self._rays.right
        cos, sin = math.cos(camera.heading_rad), math.sin(camera.heading_rad)
        eye = _Eye(camera.x_m, camera.y_m, cos, sin, cos + right * sin, sin - right * cos, lens)
        picture, depth = self._background(eye)
        things = self._visible(eye, depth)
        things += [
            _Thing(
                Box(person.x_m - 0.12, person.y_m - 0.12, person.x_m + 0.12, person.y_m + 0.12, 0.0, person.height_m),
                person=person,
            )
            for person in view.people
            if 0.3 < eye.relative(person.x_m, person.y_m)[0] < _FARTHEST_PERSON_M
        ]
        for thing in _far_to_near(things, camera.x_m, camera.y_m):
            if thing.person is not None:
                self._paint_person(picture, thing.person, eye, depth)
            else:
                _paint_thing(picture, thing, eye, depth)
        return picture

    def _background(self, eye: "_Eye") -> tuple[Image, Floats]:
        """Walls, floor and ceiling, and the depth of the wall in each column, shape (width,)."""
        x_m, y_m, ray_x, ray_y, lens, rays = eye.x_m, eye.y_m, eye.ray_x, eye.ray_y, eye.lens, self._rays
        entry, _, every_through_x = entry_and_exit(x_m, y_m, ray_x, ray_y, self._walls)
        wall, every = entry.argmin(axis=0), np.arange(lens.width_px)
        depth = np.minimum(entry[wall, every], 1e3)
        through_x = every_through_x[wall, every]
        hit_x, hit_y = x_m + depth * ray_x, y_m + depth * ray_y
        side = np.where(through_x, np.where(ray_x > 0, 0, 1), np.where(ray_y > 0, 2, 3))
        corner = self._strips[wall, side]
        along = np.where(through_x, hit_y - self._walls[wall, 1], hit_x - self._walls[wall, 0])
        wall_u = (corner[:, 0] + along * PX_PER_M).astype(np.float32)
        wall_v0 = (corner[:, 1] + (WALL_HEIGHT_M - lens.eye_height_m) * PX_PER_M).astype(np.float32)
        wall_v1 = (depth / lens.focal_px * PX_PER_M).astype(np.float32)
        on_plane = rays.row_depth < depth.astype(np.float32)
        plane_x = ((x_m - MAP_ORIGIN_M[0]) * FLOOR_PX_PER_M + rays.plane_left) + rays.row_depth * (
            ray_x * FLOOR_PX_PER_M
        ).astype(np.float32)
        plane_y = np.float32((y_m - MAP_ORIGIN_M[1]) * FLOOR_PX_PER_M) + rays.row_depth * (
            ray_y * FLOOR_PX_PER_M
        ).astype(np.float32)
        map_x = np.where(on_plane, plane_x, wall_u[None, :]).astype(np.float32, copy=False)
        map_y = np.where(on_plane, plane_y, wall_v0 + rays.rows * wall_v1).astype(np.float32, copy=False)
        picture = cv2.remap(self._sheet, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(picture), depth

    def _visible(self, eye: "_Eye", depth: Floats) -> list[_Thing]:
        entry, _, _ = entry_and_exit(eye.x_m, eye.y_m, eye.ray_x[::4], eye.ray_y[::4], self._outlines)
        (visible,) = np.nonzero(np.any(entry < depth[::4] + 0.05, axis=1))
        return [self._things[index] for index in visible.tolist()]

    def _paint_person(self, picture: Image, person: Seen, eye: "_Eye", depth: Floats) -> None:
        ahead, right = eye.relative(person.x_m, person.y_m)
        levels, lens = self._people[person.sprite % len(self._people)], eye.lens
        if person.appearance is not None:
            to_eye = math.atan2(eye.y_m - person.y_m, eye.x_m - person.x_m)
            stride_rad = person.stride_rad if person.walking else None
            levels = characters.draw(person.appearance, person.heading_rad - to_eye, stride_rad)
        height_px = lens.focal_px * person.height_m / ahead
        level = next((level for level in reversed(levels) if level.shape[0] >= height_px), levels[0])
        scale = height_px / level.shape[0]
        bob = _BOB_M * abs(math.sin(person.stride_rad)) if person.walking else 0.0
        middle = lens.middle_x_px + lens.focal_px * right / ahead
        feet = lens.middle_y_px + lens.focal_px * (lens.eye_height_m - bob) / ahead
        left = middle - level.shape[1] * scale / 2.0
        top = feet - height_px
        x0, y0, x1, y1 = _within(lens, left, top, left + level.shape[1] * scale, feet)
        if x1 - x0 < 2 or y1 - y0 < 2:
            return
        ground = lens.middle_y_px + lens.focal_px * lens.eye_height_m / ahead
        _shadow(picture, middle, ground, lens.focal_px / ahead, hidden=depth < ahead, lens=lens)
        to_picture = np.array([[scale, 0.0, left - x0], [0.0, scale, top - y0]])
        drawn = cv2.warpAffine(level, to_picture, (x1 - x0, y1 - y0), flags=cv2.INTER_LINEAR)
        drawn[:, depth[x0:x1] < ahead] = 0
        area = picture[y0:y1, x0:x1]
        rest = (255 - drawn[:, :, 3:]).astype(np.uint16)
        area[:] = ((area * rest) // 255).astype(np.uint8) + drawn[:, :, :3]


def _paint_thing(picture: Image, thing: _Thing, eye: "_Eye", depth: Floats) -> None:
    entry, _, _ = entry_and_exit(eye.x_m, eye.y_m, eye.ray_x, eye.ray_y, corners_of([thing.outline]))
    box = thing.outline
    middle, _ = eye.relative((box.x0_m + box.x1_m) / 2.0, (box.y0_m + box.y1_m) / 2.0)
    # soft edges and overhanging parts reach into columns beyond the outline
    hidden = depth < np.where(np.isfinite(entry[0]), entry[0], middle) - 0.02
    shapes = [
        (points, _shaded(part.colour, _SHADES[side]))
        for part in sorted(thing.parts, key=lambda part: (round(part.low_m, 1), -_distance(part, eye.x_m, eye.y_m)))
        for side, corners in _sides_seen(part, eye)
        if (points := _projected(corners, eye.lens)) is not None
    ]
    if not shapes:
        return
    points = np.concatenate([points for points, _ in shapes])
    # with the soft edges of the shapes
    x0, y0, x1, y1 = _within(eye.lens, *(points.min(axis=0) - 2), *(points.max(axis=0) + 3))
    if x0 >= x1 or y0 >= y1 or hidden[x0:x1].all():
        return
    area, kept = picture[y0:y1, x0:x1], hidden[x0:x1]
    before = area[:, kept]
    for points, colour in shapes:
        _fill(picture, points, colour)
    for decal in thing.decals:
        for side, corners in _sides_seen(thing.outline, eye):
            if side == decal.side:
                _paste(picture, corners, decal, eye.lens)
    area[:, kept] = before


def _within(lens: _Lens, left: float, top: float, right: float, bottom: float) -> tuple[int, int, int, int]:
    """Whole pixels of an area that are in the image."""
    return (
        max(0, math.floor(left)),
        max(0, math.floor(top)),
        min(lens.width_px, math.ceil(right)),
        min(lens.height_px, math.ceil(bottom)),
    )


class _Eye(Value):
    """Pose of the camera; rays of each column, shape (width,), in units of depth."""

    x_m: float
    y_m: float
    cos: float
    sin: float
    ray_x: Floats
    ray_y: Floats
    lens: _Lens

    def relative(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Depth along the optical axis, and distance to the right."""
        dx, dy = x_m - self.x_m, y_m - self.y_m
        return dx * self.cos + dy * self.sin, dx * self.sin - dy * self.cos


def _far_to_near(things: list[_Thing], x_m: float, y_m: float) -> list[_Thing]:
    """Painter's order: hidden objects first."""
    left = sorted(things, key=lambda thing: -_distance(thing.outline, x_m, y_m))
    ordered = []
    while left:
        first = next(
            (
                thing
                for thing in left
                if not any(_may_hide(thing.outline, other.outline, x_m, y_m) for other in left if other is not thing)
            ),
            left[0],
        )
        left.remove(first)
        ordered.append(first)
    return ordered


def _may_hide(near: Box, far: Box, x_m: float, y_m: float) -> bool:
    """True if ``near`` is on the camera's side of a plane between two boxes, so that it may hide ``far``."""
    if (near.x1_m <= far.x0_m and x_m < far.x0_m) or (near.x0_m >= far.x1_m and x_m > far.x1_m):
        return not ((far.y1_m <= near.y0_m and y_m < near.y0_m) or (far.y0_m >= near.y1_m and y_m > near.y1_m))
    if (near.y1_m <= far.y0_m and y_m < far.y0_m) or (near.y0_m >= far.y1_m and y_m > far.y1_m):
        return not ((far.x1_m <= near.x0_m and x_m < near.x0_m) or (far.x0_m >= near.x1_m and x_m > near.x1_m))
    return False


def _distance(box: Box, x_m: float, y_m: float) -> float:
    return math.hypot((box.x0_m + box.x1_m) / 2.0 - x_m, (box.y0_m + box.y1_m) / 2.0 - y_m)


def _sides_seen(box: Box, eye: _Eye) -> list[tuple[str, list[Corner]]]:
    """Sides of ``box`` that face the camera, with their corners clockwise from the top left."""
    sides: list[tuple[str, tuple[float, float], tuple[float, float]]] = []
    if eye.x_m < box.x0_m:
        sides.append(("west", (box.x0_m, box.y1_m), (box.x0_m, box.y0_m)))
    if eye.x_m > box.x1_m:
        sides.append(("east", (box.x1_m, box.y0_m), (box.x1_m, box.y1_m)))
    if eye.y_m < box.y0_m:
        sides.append(("south", (box.x0_m, box.y0_m), (box.x1_m, box.y0_m)))
    if eye.y_m > box.y1_m:
        sides.append(("north", (box.x1_m, box.y1_m), (box.x0_m, box.y1_m)))
    seen = []
    for side, left, right in sides:
        (ld, lr), (rd, rr) = eye.relative(*left), eye.relative(*right)
        corners = [(ld, lr, box.high_m), (rd, rr, box.high_m), (rd, rr, box.low_m), (ld, lr, box.low_m)]
        seen.append((side, corners))
    eye_m = eye.lens.eye_height_m
    if box.high_m < eye_m or box.low_m > eye_m:
        side, level = ("top", box.high_m) if box.high_m < eye_m else ("bottom", box.low_m)
        ring = ((box.x0_m, box.y0_m), (box.x1_m, box.y0_m), (box.x1_m, box.y1_m), (box.x0_m, box.y1_m))
        seen.insert(0, (side, [(*eye.relative(x, y), level) for x, y in ring]))
    return seen


def _projected(corners: list[Corner], lens: _Lens) -> NDArray[np.float32] | None:
    """Pixels of a flat shape, clipped at the camera; None if nothing is in front."""
    if all(corner[0] < _NEAR_M for corner in corners):
        return None
    if any(corner[0] < _NEAR_M for corner in corners):
        corners = _cut_before_camera(corners)
    focal, middle_x, middle_y = lens.focal_px, lens.middle_x_px, lens.middle_y_px
    return np.array(
        [
            (middle_x + focal * right / depth, middle_y + focal * (lens.eye_height_m - height) / depth)
            for depth, right, height in corners
        ],
        dtype=np.float32,
    )


def _cut_before_camera(corners: list[Corner]) -> list[Corner]:
    cut: list[Corner] = []
    for here, following in zip(corners, corners[1:] + corners[:1], strict=True):
        if here[0] >= _NEAR_M:
            cut.append(here)
        if (here[0] >= _NEAR_M) != (following[0] >= _NEAR_M):
            share = (_NEAR_M - here[0]) / (following[0] - here[0])
            cut.append(
                (_NEAR_M, here[1] + share * (following[1] - here[1]), here[2] + share * (following[2] - here[2]))
            )
    return cut


def _fill(picture: Image, points: NDArray[np.float32], colour: Colour) -> None:
    fixed = np.round(np.clip(points, -4000.0, 4000.0) * (1 << _BITS)).astype(np.int32)
    cv2.fillConvexPoly(picture, fixed, colour, cv2.LINE_AA, _BITS)
    dark = _shaded(colour, 0.82)
    cv2.polylines(picture, [fixed], True, dark, 1, cv2.LINE_AA, _BITS)


def _paste(picture: Image, corners: list[Corner], decal: _Decal, lens: _Lens) -> None:
    left, top, right, bottom = decal.share
    (ld, lr, high), (rd, rr, _), _, (_, _, low) = corners
    inset = [
        (ld + u * (rd - ld), lr + u * (rr - lr), high + v * (low - high))
        for u, v in ((left, top), (right, top), (right, bottom), (left, bottom))
    ]
    if any(corner[0] < _NEAR_M for corner in inset):
        return
    points = _projected(inset, lens)
    if points is None:
        return
    x0, y0, x1, y1 = _within(lens, *points.min(axis=0), *points.max(axis=0))
    if x1 - x0 < 3 or y1 - y0 < 3:
        return
    height, width = decal.picture.shape[:2]
    source = np.array([(0, 0), (width, 0), (width, height), (0, height)], dtype=np.float32)
    target = points - np.array((x0, y0), dtype=np.float32)
    warp = cv2.getPerspectiveTransform(source, target)
    size = (x1 - x0, y1 - y0)
    area = np.ascontiguousarray(picture[y0:y1, x0:x1])
    flags = cv2.INTER_LINEAR
    cv2.warpPerspective(decal.picture, warp, size, dst=area, flags=flags, borderMode=cv2.BORDER_TRANSPARENT)
    picture[y0:y1, x0:x1] = area


def _shadow(picture: Image, x: float, y: float, px_per_m: float, *, hidden: NDArray[np.bool_], lens: _Lens) -> None:
    """Contact shadow of a person."""
    flat = min(0.5, px_per_m / lens.focal_px * lens.eye_height_m)
    half_width, half_height = 0.34 * px_per_m, max(1.0, 0.34 * px_per_m * flat)
    x0, x1 = max(0, int(x - half_width)), min(lens.width_px, int(x + half_width) + 1)
    y0, y1 = max(0, int(y - half_height)), min(lens.height_px, int(y + half_height) + 1)
    if x1 - x0 < 2 or y1 - y0 < 2:
        return
    across = ((np.arange(x0, x1) - x) / half_width) ** 2
    along = ((np.arange(y0, y1) - y) / half_height) ** 2
    light = 1.0 - 0.45 * np.clip(1.0 - across[None, :] - along[:, None], 0.0, 1.0)
    light[:, hidden[x0:x1]] = 1.0
    area = picture[y0:y1, x0:x1]
    area[:] = (area * light[:, :, None]).astype(np.uint8)


def _shaded(colour: Colour, light: float) -> Colour:
    blue, green, red = (min(255, int(value * light)) for value in colour)
    return blue, green, red


def _lintels() -> list[_Thing]:
    things = []
    for lintel in LINTELS:
        picture = sign(lintel.sign)
        long = lintel.box.x1_m - lintel.box.x0_m if lintel.along == "x" else lintel.box.y1_m - lintel.box.y0_m
        half = min(0.45, 0.45 / long)
        sides = ("south", "north") if lintel.along == "x" else ("west", "east")
        decals = tuple(_Decal(side, picture, (0.5 - half, 0.2, 0.5 + half, 0.6)) for side in sides)
        things.append(_Thing(lintel.box, (lintel.box,), decals))
    return things


def _furniture() -> list[_Thing]:
    things = []
    for piece in FURNITURE:
        decals: tuple[_Decal, ...] = ()
        if piece.name in ("bookshelf", "book wall", "tool shelf"):
            box = piece.footprint
            front = shipped_image(f"pictures/{piece.name.replace(' ', '-')}.png")
            long_x = box.x1_m - box.x0_m > box.y1_m - box.y0_m
            decals = tuple(_Decal(side, front) for side in (("south", "north") if long_x else ("west", "east")))
        things.append(_Thing(piece.footprint, piece.parts, decals))
    return things
