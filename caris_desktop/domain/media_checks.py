"""Checks of images and videos: decoding and limits of camera frames and image files, safe opening of videos.

cv2 is imported with the first image, so that modules that only refer to images start fast.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_FRAME_PIXELS = 1920 * 1080
LEAST_SIDE_PX = 8
"""Smaller images make no video, and show no person."""
MOST_PIXELS = 64_000_000
"""Larger images would take memory that a session needs: 8K has 33 million."""

# Each costs a decoder up to 0.1 s, whatever its bytes: files of others have some ten scans and a few texts.
_MOST_SCANS = _MOST_TEXTS = 100
_JPEG_SCAN, _PNG_TEXTS = b"\xff\xda", (b"zTXt", b"iTXt")


class PictureError(ValueError):
    """Image that cannot be shown; the text completes the sentence "The picture ..."."""


def fitting_size(width_px: int, height_px: int) -> tuple[int, int]:
    """Size, reduced in proportion if necessary to fit a slot of the frame ring."""
    pixels = width_px * height_px
    if pixels <= MAX_FRAME_PIXELS:
        return width_px, height_px
    scale = (MAX_FRAME_PIXELS / pixels) ** 0.5
    return int(width_px * scale), int(height_px * scale)


def check_size(width_px: int, height_px: int) -> None:
    """Check the limits of the size. Raises PictureError."""
    if min(fitting_size(width_px, height_px)) < LEAST_SIDE_PX:
        raise PictureError(f"has {width_px} x {height_px} pixels, which is too small")
    if width_px * height_px > MOST_PIXELS:
        raise PictureError(f"has {width_px} x {height_px} pixels, which is too large")


def fitted(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Grey, colour or colour with transparency, 8 or 16 bits, as 8-bit BGR of a size that fits.

    Raises PictureError.
    """
    channels = image.shape[2] if image.ndim == 3 else 1
    if image.ndim not in (2, 3) or channels not in (1, 3, 4) or image.dtype not in (np.uint8, np.uint16):
        raise PictureError(f"is not a greyscale or colour image ({image.dtype}, {' x '.join(map(str, image.shape))})")
    height_px, width_px = image.shape[:2]
    check_size(width_px, height_px)
    import cv2

    size_px = fitting_size(width_px, height_px)
    if size_px != (width_px, height_px):
        image = cv2.resize(image, size_px, interpolation=cv2.INTER_AREA)
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    if channels == 1:
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    return np.ascontiguousarray(image[:, :, :3], np.uint8)


def decode_compressed(content: bytes) -> NDArray[np.uint8]:
    """Decode a whole JPEG or PNG as :func:`fitted` gives it. Raises PictureError, also for a truncated one."""
    import cv2

    flag = cv2.IMREAD_COLOR
    size_px = checked_size(content)
    check_size(*size_px)
    # Decoding a JPEG at a fraction of its size takes a fraction of the time.
    pixels = size_px[0] * size_px[1]
    if content[:2] == b"\xff\xd8" and pixels >= 4 * MAX_FRAME_PIXELS:
        flag = cv2.IMREAD_REDUCED_COLOR_4 if pixels >= 16 * MAX_FRAME_PIXELS else cv2.IMREAD_REDUCED_COLOR_2
    return fitted(decoded(content, flag))


def checked_size(content: bytes) -> tuple[int, int]:
    """(width, height) of a JPEG or PNG from its header, before decoding.

    Raises PictureError if too large, and for other formats, whose decoders may expand kilobytes to gigabytes.
    """
    size_px = picture_size(content)
    if size_px is None or not (
        _chunks_fit(content) if content[:1] == b"\x89" else content.count(_JPEG_SCAN) <= _MOST_SCANS
    ):
        raise PictureError("is not a complete JPEG or PNG image")
    if min(size_px) < 1 or size_px[0] * size_px[1] > MOST_PIXELS:
        raise PictureError(f"has {size_px[0]} x {size_px[1]} pixels, which is too large")
    return size_px


def _chunks_fit(content: bytes) -> bool:
    """Whether a PNG is whole, with one head. Decoders allocate the length that a chunk claims: 2.5 GB for 9 kB."""
    at, texts = 8, 0
    while at + 12 <= len(content):
        kind, end = content[at + 4 : at + 8], at + 12 + int.from_bytes(content[at : at + 4])
        texts += kind in _PNG_TEXTS
        if end > len(content) or (kind == b"IHDR") != (at == 8) or texts > _MOST_TEXTS:
            return False
        if kind == b"IEND":
            return True
        at = end
    return False


def decoded(content: bytes, flag: int | None = None) -> NDArray[Any]:
    """JPEG or PNG as ``cv2.imdecode`` gives it (BGR, or by ``flag``). Raises PictureError.

    The only decoder for images from other sources: it checks format and size first.
    """
    import cv2

    checked_size(content)
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR if flag is None else flag)
    except cv2.error:
        image = None
    if image is None:
        raise PictureError("is not a complete JPEG or PNG image")
    return np.asarray(image)


def jpeg_of(image_bgr: NDArray[np.uint8], *, quality: int, most_px: int | None = None) -> bytes:
    """JPEG of the image, reduced if it is wider than ``most_px``."""
    import cv2

    height_px, width_px = image_bgr.shape[:2]
    if most_px is not None and width_px > most_px:
        size_px = (most_px, max(1, round(height_px * most_px / width_px)))
        image_bgr = np.asarray(cv2.resize(image_bgr, size_px, interpolation=cv2.INTER_AREA), np.uint8)
    _, content = cv2.imencode(".jpg", image_bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return bytes(content.tobytes())


def picture_size(content: bytes) -> tuple[int, int] | None:
    """(width, height) from the header of a JPEG or PNG; None if absent."""
    if content[:8] == b"\x89PNG\r\n\x1a\n" and content[12:16] == b"IHDR" and len(content) >= 24:
        return int.from_bytes(content[16:20]), int.from_bytes(content[20:24])
    at = 2
    while content[:2] == b"\xff\xd8" and at + 9 <= len(content) and content[at] == 0xFF:
        if content[at + 1] == 0xFF:  # any number of fill bytes may precede a marker
            at += 1
            continue
        marker, length = content[at + 1], int.from_bytes(content[at + 2 : at + 4])
        # Frame headers SOF0..SOF15, without the tables among their numbers.
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return int.from_bytes(content[at + 7 : at + 9]), int.from_bytes(content[at + 5 : at + 7])
        at += 2 + length
    return None


# Safe opening of foreign video files: no references to other files.

FILM_OPTIONS = {
    # A playlist, which looks like a film to ffmpeg, names other files and addresses.
    "protocol_whitelist": "file",
    "format_whitelist": (
        "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,flv,asf,ogg,h264,hevc,m4v,mjpeg,ivf,mxf,gif"
    ),
}
"""Options of ``av.open`` for reading."""
