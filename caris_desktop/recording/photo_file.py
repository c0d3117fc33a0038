"""Photo files: PNG with text metadata, which viewers show and copies retain."""

import shutil
import struct
import zlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.media_checks import PictureError, decoded

TIME, CAMERA, PEOPLE, POSE, TAGS = "Creation Time", "Camera", "People", "Robot pose", "Keywords"
"""The texts that this program writes. The time is UTC, people are opaque ids, the pose is x and y in metres and the
heading in degrees."""

PREVIEW_PX, THUMBNAIL_PX = 960, 200
"""Of pictures of a photo for the window."""

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_LONGEST_TEXT_BYTES = 100_000
_NO_PICTURE = "it is not an image"
_HEAD = struct.Struct(">I4s")


class PhotoFileError(ValueError):
    """Not a PNG file, or a damaged one."""


def with_texts(png: bytes, texts: Mapping[str, str]) -> bytes:
    """Replace texts of a PNG by name; an empty text removes it.

    Texts are written as iTXt (UTF-8, uncompressed), which holds any language. Raises PhotoFileError.
    """
    parts = [_SIGNATURE]
    for kind, content, chunk in _chunks(png):
        entry = _text(kind, content)
        if entry is None or entry[0] not in texts:
            parts.append(chunk)
        if kind == b"IHDR":
            parts += [
                _chunk(b"iTXt", name.encode("latin-1") + b"\0\0\0\0\0" + text.encode("utf-8", "replace"))
                for name, text in texts.items()
                if text
            ]
    return b"".join(parts)


def texts_of(png: bytes) -> dict[str, str]:
    """Texts of a PNG file by name. Raises PhotoFileError."""
    return dict(entry for entry in (_text(kind, content) for kind, content, _ in _chunks(png)) if entry is not None)


def change_texts(path: Path, texts: Mapping[str, str]) -> None:
    """Apply :func:`with_texts` to a file atomically. Raises OSError, PhotoFileError."""
    replace_file(path, with_texts(path.read_bytes(), texts), durable=False, on_full=lambda: False)


def previews(path: Path, *most_px: int) -> list[bytes]:
    """JPEGs of the photo, each within the given size, in descending order. Raises OSError, PhotoFileError."""
    try:
        image_bgr = decoded(path.read_bytes())
    except PictureError as error:
        raise PhotoFileError(_NO_PICTURE) from error
    return jpegs_of(image_bgr, *most_px)


def jpegs_of(image_bgr: NDArray[Any], *most_px: int) -> list[bytes]:
    """As :func:`previews`. ``image_bgr``: uint8, shape (height, width, 3). Raises PhotoFileError."""
    import cv2

    jpegs = []
    try:
        for most in most_px:
            share = most / max(image_bgr.shape[:2])
            if share < 1.0:
                image_bgr = cv2.resize(image_bgr, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
            jpegs.append(cv2.imencode(".jpg", image_bgr, [cv2.IMWRITE_JPEG_QUALITY, 85])[1].tobytes())
    except cv2.error as error:
        raise PhotoFileError(_NO_PICTURE) from error
    return jpegs


def move_photo(path: Path, to: Path) -> None:
    """Move a photo, creating its folder. Raises OSError."""
    to.parent.mkdir(parents=True, exist_ok=True)
    shutil.move(path, to)


def remove_photos(paths: Iterable[Path]) -> None:
    """Remove the files that exist. Raises OSError."""
    for path in paths:
        path.unlink(missing_ok=True)


def remove_all(folder: Path) -> None:
    """Remove a folder and its content as far as possible."""
    shutil.rmtree(folder, ignore_errors=True)


def _chunks(png: bytes) -> list[tuple[bytes, bytes, bytes]]:
    """Type, content and raw bytes of each chunk."""
    if not png.startswith(_SIGNATURE):
        raise PhotoFileError("it is not a PNG file")
    chunks, at = [], len(_SIGNATURE)
    while at + _HEAD.size <= len(png):
        length, kind = _HEAD.unpack_from(png, at)
        end = at + _HEAD.size + length + 4
        if end > len(png):
            raise PhotoFileError("it is truncated")
        chunks.append((kind, png[at + _HEAD.size : end - 4], png[at:end]))
        at = end
        if kind == b"IEND":
            return chunks
    raise PhotoFileError("it is truncated")


def _chunk(kind: bytes, content: bytes) -> bytes:
    return _HEAD.pack(len(content), kind) + content + struct.pack(">I", zlib.crc32(kind + content))


def _text(kind: bytes, content: bytes) -> tuple[str, str] | None:
    """Name and text of an uncompressed text chunk; None for other chunks."""
    if kind not in (b"tEXt", b"iTXt") or len(content) > _LONGEST_TEXT_BYTES:
        return None
    name, _, rest = content.partition(b"\0")
    if kind == b"iTXt":
        compressed, rest = rest[:1] != b"\0", rest[2:]
        _language, _, rest = rest.partition(b"\0")
        _translated, _, rest = rest.partition(b"\0")
        if compressed:
            return None
    return name.decode("latin-1"), rest.decode("utf-8" if kind == b"iTXt" else "latin-1", "replace")
