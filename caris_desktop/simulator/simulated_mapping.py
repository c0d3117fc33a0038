"""Occupancy mapping during exploration, and map files."""

import io
import math
import re
import zipfile
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.media_checks import PictureError, decoded
from caris_desktop.domain.sensing import LaserScan, OccupancyGrid
from caris_desktop.domain.value_class import Value
from caris_desktop.domain.yaml_files import parse_yaml
from caris_desktop.simulator.floor_plan import MAP_ORIGIN_M, MAP_SIZE_M

RESOLUTION_M = 0.05
WIDTH, HEIGHT = round(MAP_SIZE_M[0] / RESOLUTION_M), round(MAP_SIZE_M[1] / RESOLUTION_M)
_HIT, _MISS, _LIMIT = 6, 2, 40
_OCCUPIED_FROM, _FREE_FROM = 4, -2
_CELLS_WORTH_TELLING = 10
_SHIFT = 4  # fractional bits of cv2's drawing coordinates


class MapChange(Value, eq=False):
    """Rectangle of new cells: int8, shape (height, width), with its origin at column ``left``, row ``bottom``."""

    left: int
    bottom: int
    cells: NDArray[np.int8]


class Mapper:
    """Evidence per cell: hits increase it, passing beams decrease it."""

    def __init__(self) -> None:
        self._evidence = np.zeros((HEIGHT, WIDTH), dtype=np.int16)
        self._known = np.zeros((HEIGHT, WIDTH), dtype=bool)
        self._published: NDArray[np.int8] | None = None

    def add(self, scan: LaserScan, map_from_robot: Pose2D) -> None:
        """Add one scan made at ``map_from_robot``; ignored without a laser pose."""
        if scan.robot_from_laser is None:
            return
        laser = map_from_robot @ scan.robot_from_laser
        ranges = scan.ranges_m.astype(np.float64)
        # readings below the range are from blind beams
        hit = np.isfinite(ranges) & (ranges >= scan.range_min_m)
        angles = laser.heading_rad + scan.angle_min_rad + scan.angle_increment_rad * np.arange(len(ranges))
        # a beam without an echo frees the cells up to the counted range
        reach = np.where(hit, ranges - RESOLUTION_M, np.where(np.isinf(ranges), scan.range_max_m * 0.8, 0.0))
        free = np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
        outline = np.stack(
            [
                (laser.x_m + reach * np.cos(angles) - MAP_ORIGIN_M[0]) / RESOLUTION_M - 0.5,
                (laser.y_m + reach * np.sin(angles) - MAP_ORIGIN_M[1]) / RESOLUTION_M - 0.5,
            ],
            axis=1,
        )
        cv2.fillPoly(free, [np.round(outline * (1 << _SHIFT)).astype(np.int32)], 1, shift=_SHIFT)
        struck = np.zeros((HEIGHT, WIDTH), dtype=bool)
        columns = ((laser.x_m + ranges[hit] * np.cos(angles[hit]) - MAP_ORIGIN_M[0]) / RESOLUTION_M).astype(int)
        rows = ((laser.y_m + ranges[hit] * np.sin(angles[hit]) - MAP_ORIGIN_M[1]) / RESOLUTION_M).astype(int)
        inside = (rows >= 0) & (rows < HEIGHT) & (columns >= 0) & (columns < WIDTH)
        struck[rows[inside], columns[inside]] = True
        passed = free.astype(bool) & ~struck
        self._evidence[passed] -= _MISS
        self._evidence[struck] += _HIT
        np.clip(self._evidence, -_LIMIT, _LIMIT, out=self._evidence)
        self._known |= passed | struck

    def cells(self) -> NDArray[np.int8]:
        """int8, shape (HEIGHT, WIDTH): -1 unknown, 0 free, 100 occupied."""
        cells = np.full((HEIGHT, WIDTH), -1, dtype=np.int8)
        cells[self._known & (self._evidence <= _FREE_FROM)] = 0
        cells[self._known & (self._evidence >= _OCCUPIED_FROM)] = 100
        return cells

    def grid(self, *, stamp_ns: int) -> OccupancyGrid:
        """Whole map."""
        origin = Pose2D(MAP_ORIGIN_M[0], MAP_ORIGIN_M[1], 0.0)
        return OccupancyGrid(stamp_ns, stamp_ns, RESOLUTION_M, origin, self.cells())

    def change(self) -> "MapChange | None":
        """Changes since the last returned ones, as one rectangle; None if only a few cells changed."""
        cells = self.cells()
        before = self._published if self._published is not None else np.full_like(cells, -1)
        rows, columns = np.nonzero(cells != before)
        if len(rows) < _CELLS_WORTH_TELLING:
            return None
        self._published = cells
        bottom, top = int(rows.min()), int(rows.max()) + 1
        left, right = int(columns.min()), int(columns.max()) + 1
        return MapChange(left, bottom, cells[bottom:top, left:right].copy())

    def snapshot(self) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
        """State for later restoration: evidence, and known cells."""
        return self._evidence.copy(), self._known.copy()

    def restore(self, evidence: NDArray[np.int16], known: NDArray[np.bool_]) -> None:
        """Restore a snapshot. Raises ValueError when it is not one of this building."""
        if evidence.shape != (HEIGHT, WIDTH) or known.shape != (HEIGHT, WIDTH):
            raise ValueError(f"the map is not {WIDTH} x {HEIGHT} cells")
        self._evidence = np.clip(evidence, -_LIMIT, _LIMIT).astype(np.int16)
        self._known = known.astype(bool)

    def replace(self, cells: NDArray[np.int8]) -> None:
        """Use a finished map: int8, shape (HEIGHT, WIDTH), -1 unknown, 0 free, 100 occupied.

        Raises ValueError when it has another size.
        """
        self.restore(np.where(cells > 50, _LIMIT, -_LIMIT).astype(np.int16), cells >= 0)

    @property
    def known_share(self) -> float:
        """Fraction of known cells, 0..1."""
        return float(np.count_nonzero(self._known)) / math.prod(self._known.shape)


_FREE, _OCCUPIED, _UNKNOWN = 254, 0, 205
_FREE_THRESH, _OCCUPIED_THRESH = 0.25, 0.65
_NAME = re.compile(r"/?\w[\w .-]*(/\w[\w .-]*)*")
_PGM_HEAD = re.compile(rb"P5(?:\s|#.*\n)+(?P<width>\d{1,6})(?:\s|#.*\n)+(?P<height>\d{1,6})(?:\s|#.*\n)+255\s")
_MOST_CHARS = 200
_MOST_BYTES = 64 * 1024 * 1024


class MapFileError(Exception):
    """Map that cannot be saved or loaded, with the reason."""


class NoSuchMap(MapFileError):  # noqa: N818 - it is an answer to the caller, not a fault of the program
    """There is no map of that name."""


class MapFiles:
    """Maps in ``folder``, created with the first map."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder.resolve()

    def save_picture(self, name: str, cells: NDArray[np.int8]) -> Path:
        """Write NAME.pgm and NAME.yaml; return the latter. ``cells`` is int8, row 0 at the bottom."""
        path = self._path(name)
        picture = np.full(cells.shape, _UNKNOWN, dtype=np.uint8)
        picture[cells == 0] = _FREE
        picture[cells > 50] = _OCCUPIED
        done, content = cv2.imencode(".pgm", picture[::-1])
        if not done:
            raise MapFileError(f"the map cannot be written as an image: {path}")
        description = {
            "image": f"{path.name}.pgm",
            "mode": "trinary",
            "resolution": RESOLUTION_M,
            "origin": [*MAP_ORIGIN_M, 0.0],
            "negate": 0,
            "occupied_thresh": _OCCUPIED_THRESH,
            "free_thresh": _FREE_THRESH,
        }
        self._write(_with_ending(path, ".pgm"), content.tobytes())
        described = _with_ending(path, ".yaml")
        self._write(described, yaml.safe_dump(description, sort_keys=False).encode())
        return described

    def load_picture(self, name: str) -> NDArray[np.int8]:
        """Cells of NAME.yaml and its image: int8, shape (height, width), row 0 at the bottom."""
        path = _with_ending(self._path(name), ".yaml")
        try:
            description: Any = parse_yaml(self._read(path).decode()).data
        except ValueError as error:
            raise MapFileError(f"{path.name} is not a map description: {error}") from error
        if not isinstance(description, dict) or not isinstance(description.get("image"), str):
            raise MapFileError(f"{path.name} does not name its image")
        picture_path = self._path(str(path.parent.relative_to(self._folder) / description["image"]))
        try:
            picture = _grey(self._read(picture_path))
        except PictureError as error:
            raise MapFileError(f"{picture_path.name} {error}") from error
        cells = np.full(picture.shape, -1, dtype=np.int8)
        darkness = 1.0 - picture[::-1].astype(np.float64) / 255.0
        # the grey of unknown is just below map_server's free threshold, so it comes first
        unknown = picture[::-1] == _UNKNOWN
        cells[(darkness < _FREE_THRESH) & ~unknown] = 0
        cells[darkness > _OCCUPIED_THRESH] = 100
        return cells

    def save_graph(self, name: str, evidence: NDArray[np.int16], known: NDArray[np.bool_]) -> Path:
        """Write NAME.posegraph: the mapper's state for continuation."""
        path = _with_ending(self._path(name), ".posegraph")
        content = io.BytesIO()
        np.savez_compressed(content, allow_pickle=False, evidence=evidence, known=known)
        self._write(path, content.getvalue())
        return path

    def load_graph(self, name: str) -> tuple[NDArray[np.int16], NDArray[np.bool_]]:
        """Content of :meth:`save_graph`."""
        path = _with_ending(self._path(name), ".posegraph")
        if not path.is_file():
            raise NoSuchMap(f"there is no map '{name}'")
        try:
            with np.load(path, allow_pickle=False) as stored:
                return stored["evidence"], stored["known"]
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
            raise MapFileError(f"{path.name} cannot be read: {error}") from error

    def _path(self, name: str) -> Path:
        if len(name) > _MOST_CHARS or _NAME.fullmatch(name) is None:
            raise MapFileError(
                "a map name can only contain letters, digits, spaces, '_', '-', '.' and '/', and must not "
                "start with a dot"
            )
        path = (self._folder / name).resolve()
        if not path.is_relative_to(self._folder) or path == self._folder:
            raise MapFileError(f"'{name}' is outside the folder of the maps")
        return path

    def _write(self, path: Path, content: bytes) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            replace_file(path, content, durable=False)
        except OSError as error:
            raise MapFileError(f"{path.name} cannot be written: {error.strerror or error}") from error

    @staticmethod
    def _read(path: Path) -> bytes:
        try:
            if path.stat().st_size > _MOST_BYTES:
                raise MapFileError(f"{path.name} is too large for a map")
            return path.read_bytes()
        except FileNotFoundError as error:
            raise NoSuchMap(f"there is no {path.name}") from error
        except OSError as error:
            raise MapFileError(f"{path.name} cannot be read: {error.strerror or error}") from error


def _grey(content: bytes) -> NDArray[np.uint8]:
    """PGM, as map_server writes maps, PNG or JPEG: uint8, shape (height, width). Raises PictureError."""
    head = _PGM_HEAD.match(content)
    if head is None:
        return np.asarray(decoded(content, cv2.IMREAD_GRAYSCALE), np.uint8)
    width_px, height_px = int(head["width"]), int(head["height"])
    cells = np.frombuffer(content, np.uint8, offset=head.end())
    if width_px * height_px > len(cells):
        raise PictureError("is not a complete image")
    return cells[: width_px * height_px].reshape(height_px, width_px)


def _with_ending(path: Path, ending: str) -> Path:
    return path if path.suffix == ending else path.with_name(path.name + ending)
