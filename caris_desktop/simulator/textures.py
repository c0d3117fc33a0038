"""Textures of floor, ceiling and walls, painted once into one sheet for the camera renderer."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from caris_desktop.simulator.floor_plan import (
    MAP_ORIGIN_M,
    MAP_SIZE_M,
    POSTERS,
    SOLID,
    WALL_HEIGHT_M,
    WALLS,
    Box,
    Poster,
)

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
_ACCENTS = ((120, 92, 44), (60, 110, 190), (84, 128, 84), (70, 84, 160), (150, 120, 60))


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


def sign(text: str) -> Image:
    """Door sign, BGR."""
    picture = np.full((80, 360, 3), (92, 66, 38), dtype=np.uint8)
    _write(picture, text, colour=(250, 250, 250), share=0.5)
    return picture


def books(width_px: int, height_px: int, seed: int) -> Image:
    """Front of a full bookshelf, BGR."""
    chance = np.random.default_rng(seed)
    picture = np.full((height_px, width_px, 3), (66, 96, 128), dtype=np.uint8)
    boards = 5
    board = height_px // boards
    for row in range(boards):
        picture[row * board : (row + 1) * board - 5, 5:-5] = (38, 52, 66)
        x = 8
        while x < width_px - 16:
            thick = int(chance.integers(7, 17))
            high = int(board * chance.uniform(0.55, 0.85))
            colour = [int(value) for value in chance.integers(50, 190, 3)]
            bottom = (row + 1) * board - 6
            if chance.random() < 0.86:
                cv2.rectangle(picture, (x, bottom - high), (x + thick - 2, bottom), colour, cv2.FILLED)
            x += thick
    return picture


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
    width, height = round(poster.width_m * PX_PER_M), round(poster.height_m * PX_PER_M)
    left = round((position - start_m - poster.width_m / 2) * PX_PER_M)
    top = round((WALL_HEIGHT_M - poster.middle_height_m - poster.height_m / 2) * PX_PER_M)
    if left < 0 or left + width > strip.shape[1]:
        return
    picture = _poster(poster, width, height)
    # seen from the east or the north the axis runs from right to left
    strip[top : top + height, left : left + width] = picture[:, ::-1] if side in ("west", "north") else picture


def _poster(poster: Poster, width: int, height: int) -> Image:
    picture = np.full((height, width, 3), (240, 242, 242), dtype=np.uint8)
    accent = _ACCENTS[sum(map(ord, poster.text)) % len(_ACCENTS)]
    if poster.kind == "window":
        sky = np.linspace(0.0, 1.0, height, dtype=np.float32)[:, None, None]
        picture[:] = (np.array((236, 214, 186)) * (1 - sky) + np.array((226, 236, 238)) * sky).astype(np.uint8)
        picture[int(height * 0.72) :] = (120, 160, 140)
        cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (246, 246, 246), 8)
        cv2.line(picture, (width // 2, 0), (width // 2, height), (246, 246, 246), 5)
    elif poster.kind == "screen":
        picture[:] = (70, 54, 44)
        cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (24, 24, 24), 8)
        for line in range(4):
            y = int(height * (0.45 + 0.12 * line))
            cv2.line(picture, (width // 8, y), (width * (7 - line) // 8, y), (190, 180, 170), 3)
        _write(picture[: height * 2 // 5], poster.text, colour=(240, 240, 240), share=0.5)
    elif poster.kind == "sign":
        picture[:] = (92, 66, 38)
        _write(picture, poster.text, colour=(250, 250, 250), share=0.5)
    else:
        picture[: height * 2 // 3] = accent
        cv2.circle(picture, (width // 3, height // 3), min(width, height) // 6, (236, 236, 236), -1, cv2.LINE_AA)
        cv2.line(picture, (0, height // 2), (width, height // 4), (226, 230, 232), 5, cv2.LINE_AA)
        _write(picture[height * 2 // 3 :], poster.text, colour=(50, 50, 50), share=0.4)
        cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (70, 70, 70), 2)
    return picture


def _write(picture: Image, text: str, *, colour: tuple[int, int, int], share: float) -> None:
    height, width = picture.shape[:2]
    (text_width, text_height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 1.0, 2)
    scale = min(height * share / max(text_height, 1), width * 0.88 / max(text_width, 1))
    at = (int((width - text_width * scale) / 2), int((height + text_height * scale) / 2))
    cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, scale, colour, max(1, round(scale * 2)), cv2.LINE_AA)


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
