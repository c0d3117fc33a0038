"""Pictures of sessions, robots and other computers as Qt shows them."""

from PySide6.QtGui import QImage

from caris_desktop.domain.pictures import PictureError, checked_size


def image_of(content: bytes) -> QImage:
    """A JPEG or PNG; a null image for anything else and for one too large, before Qt reads any of it."""
    try:
        checked_size(content)
    except PictureError:
        return QImage()
    return QImage.fromData(content, "JPG" if content[:2] == b"\xff\xd8" else "PNG")  # type: ignore[arg-type]
