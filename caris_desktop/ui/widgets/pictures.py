"""Pictures from sessions, robots and other computers: safe decoding, thumbnail of a photo just taken."""

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import Qt, QTimer
from PySide6.QtGui import QAccessible, QImage, QPixmap
from PySide6.QtWidgets import QLabel, QWidget

from caris_desktop.domain.media_checks import PictureError, checked_size
from caris_desktop.ui import layouts
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.labels import IconLabel, label
from caris_desktop.ui.widgets.popups import Popup


def image_of(content: bytes) -> QImage:
    """Decode a JPEG or PNG; a null image for anything else or oversized, checked before Qt reads it."""
    try:
        checked_size(content)
    except PictureError:
        return QImage()
    return QImage.fromData(content, "JPG" if content[:2] == b"\xff\xd8" else "PNG")  # type: ignore[arg-type]


SHOWN_MS = 4000
_PICTURE_PX = 168


def thumbnail_of(image_bgr: NDArray[np.uint8]) -> QImage:
    """Thumbnail of ``image_bgr``, uint8 of shape (height, width, 3)."""
    height, width = image_bgr.shape[:2]
    image = QImage(image_bgr.data, width, height, 3 * width, QImage.Format.Format_BGR888)
    return image.scaledToWidth(_PICTURE_PX, Qt.TransformationMode.FastTransformation)


class PhotoThumbnail(Popup):
    """Thumbnail over the lower right of ``over``, or so far below its upper edge; transparent to the mouse."""

    accessible_role = QAccessible.Role.Graphic

    def __init__(self, theme: Theme, over: QWidget) -> None:
        super().__init__(theme, over)
        self.setObjectName("photo_thumbnail")
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self.top_px: int | None = None
        self.image: QImage | None = None
        self._picture, self._line = QLabel(alignment=Qt.AlignmentFlag.AlignCenter), label("", "small")
        icon = IconLabel(theme, "check", "box_named", size_px=16)
        line = layouts.hbox(None, icon, (self._line, 1), margins_px=(2, 5, 4, 5), spacing_px=6)
        layouts.vbox(self, self._picture, line, margins_px=(8, 8, 8, 0), spacing_px=0)
        self._going = QTimer(self, singleShot=True, interval=SHOWN_MS)
        self._going.timeout.connect(self.hide)
        self.follow_parent()

    def show_photo(self, image: QImage | None, line: str, file_name: str) -> None:
        """Show the thumbnail; only the text if ``image`` is None."""
        self.image = image
        self._picture.setPixmap(QPixmap.fromImage(image or QImage()))
        self._picture.setVisible(image is not None)
        self._line.setText(line)
        self.setAccessibleName(f"{line}: {file_name}")
        self.show()
        self.place()
        self.raise_()
        self._going.start()

    def place(self) -> None:
        self.adjustSize()
        top = self._room.height() - self.height() - 12 if self.top_px is None else self.top_px
        self.move(self._room.width() - self.width() - 12, top)
