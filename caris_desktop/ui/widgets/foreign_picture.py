"""Safe decoding of images from sessions, robots and other computers."""

from PySide6.QtGui import QImage

from caris_desktop.domain.picture_checks import PictureError, checked_size


def image_of(content: bytes) -> QImage:
    """Decode a JPEG or PNG; a null image for anything else or oversized, checked before Qt reads it."""
    try:
        checked_size(content)
    except PictureError:
        return QImage()
    return QImage.fromData(content, "JPG" if content[:2] == b"\xff\xd8" else "PNG")  # type: ignore[arg-type]
