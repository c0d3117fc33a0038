"""Map files: images with a description as of map_server, and a pose graph in place of slam_toolbox's.

Names may contain folders, but never lead out of the map folder.
"""

import io
import re
import tempfile
import zipfile
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.picture_checks import PictureError, decoded
from caris_desktop.domain.yaml_source import parse_yaml
from caris_desktop.simulator.floor_plan import MAP_ORIGIN_M
from caris_desktop.simulator.simulated_mapping import RESOLUTION_M

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
    """Maps in ``folder``, created with the first map; without one in a temporary folder."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._temporary: tempfile.TemporaryDirectory[str] | None = None

    @property
    def folder(self) -> Path:
        if self._folder is None:
            self._temporary = tempfile.TemporaryDirectory(prefix="caris-simulator-maps-", ignore_cleanup_errors=True)
            self._folder = Path(self._temporary.name)
        return self._folder

    def close(self) -> None:
        """Remove the temporary folder, if any."""
        if self._temporary is not None:
            self._temporary.cleanup()

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
        within = path.parent.relative_to(self.folder.resolve())
        picture_path = self._path(str(within / description["image"]))
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
        folder = self.folder.resolve()
        if len(name) > _MOST_CHARS or _NAME.fullmatch(name) is None:
            raise MapFileError(
                "a map name can only contain letters, digits, spaces, '_', '-', '.' and '/', and must not "
                "start with a dot"
            )
        path = (folder / name).resolve()
        if not path.is_relative_to(folder) or path == folder:
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
