"""Strip of small camera pictures below the large one."""

import math
import time
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PySide6.QtCore import QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QFontMetricsF, QImage, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QAbstractButton, QBoxLayout, QWidget

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.panel import Panel, draw_card_edge
from caris_desktop.ui.theme import Theme, draw_icon
from caris_desktop.ui.widgets.frame_view import detections_fit, fitted, paint_words

EVERY_S, EVERY_WHEN_BUSY_S = 0.25, 1.0
"""Refresh intervals in s: the least important work on a busy machine."""

_GAP_PX = 6
_WIDEST_PX, _NARROWEST_PX = 240, 104
_SHARE = 0.26  # of the panel's width or height
_LEAST_ROOM_PX = (380, 240)
_BAND_PX = 4
_LITTLE_ROOM_PX = 150
_BANDS = {"fresh": "green", "stale": "amber", "lost": "red", "none": "line"}


class StripPlace(Value):
    """Side of the strip and size of a thumbnail; ``side`` is empty if there is no room."""

    side: Literal["right", "below", ""]
    picture: QSize


NO_PLACE = StripPlace("", QSize(0, 0))


def strip_place(room: QSize, count: int, aspect: float) -> StripPlace:
    """Placement that leaves the largest main picture; none if there is too little room.

    ``room``: size of the panel. ``count``: number of other cameras. ``aspect``: width by height of the main picture,
    also used for thumbnails.
    """
    width, height = room.width(), room.height()
    if not count or width < _LEAST_ROOM_PX[0] or height < _LEAST_ROOM_PX[1]:
        return NO_PLACE
    found: list[tuple[float, StripPlace]] = []
    across = min(_WIDEST_PX, width * _SHARE, ((height - _GAP_PX) / count - _GAP_PX) * aspect)
    if across >= _NARROWEST_PX:
        left = min(width - across - 2 * _GAP_PX, height * aspect)
        found.append((left, StripPlace("right", QSize(int(across), int(across / aspect)))))
    across = min(_WIDEST_PX, height * _SHARE * aspect, (width - _GAP_PX) / count - _GAP_PX)
    if across >= _NARROWEST_PX:
        left = min(width, (height - across / aspect - 2 * _GAP_PX) * aspect)
        found.append((left, StripPlace("below", QSize(int(across), int(across / aspect)))))
    return max(found, key=lambda each: each[0], default=(0.0, NO_PLACE))[1]


class SmallPicture(QAbstractButton):
    """Thumbnail of a camera. A click selects the camera. Refreshed at intervals, only while visible."""

    def __init__(self, theme: Theme, panel: Panel, camera: str, parent: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName(f"small_picture_{camera}")
        self.setAccessibleName(tr("Show the {camera}").format(camera=text_formatting.camera_in_text(camera)))
        self.setToolTip(
            tr("Show the {camera} large ({key}: next camera)").format(
                camera=text_formatting.camera_in_text(camera), key=panel.table.key_text("next_camera")
            )
        )
        self.setCursor(Qt.CursorShape.PointingHandCursor)
        # The focus stays with driving or the text field.
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.setAttribute(Qt.WidgetAttribute.WA_OpaquePaintEvent)
        self.camera = camera
        self._theme = theme
        self._panel = panel
        self._image: QImage | None = None
        self._frame: FrameRef | None = None
        self._taken_s = -math.inf
        self._description = ""
        self._stream = panel.state.frame_of(camera)
        self._stream.changed.connect(self._on_frame_changed)
        self._stream.freshness_changed.connect(self._on_freshness_changed)

    @property
    def shows_picture(self) -> bool:
        return self._image is not None

    def words(self) -> tuple[str, str]:
        """Age of a picture that is not live, and the text without one."""
        live, age_s = self._panel.state.present.live, self._stream.age_s()
        match self._stream.freshness:
            case "fresh":
                return "", ""
            case "stale":
                return tr("{age} old").format(age=text_formatting.age(age_s or 0.0)), ""
            case _ if live:
                return "", text_formatting.no_picture(age_s, self._panel.state.state_of(self.camera).value)
            case _:
                return "", tr("No picture at this moment")

    def refresh_now(self) -> None:
        """Refresh now, after it was hidden."""
        if self._stream.value is not None and self._stream.freshness == "fresh":
            self._taken_s = -math.inf
            self._on_frame_changed(self._stream.value)

    def refresh(self) -> None:
        """Update the text, which changes with time (4 Hz)."""
        description = " ".join(self.words())
        if description != self._description:
            self._description = description
            self.setAccessibleDescription(description)
            self.update()

    def forget(self) -> None:
        """Drop the picture while hidden: it must not pass for the present later."""
        self._image = self._frame = None

    def _on_frame_changed(self, frame: FrameRef) -> None:
        if not self.isVisible() or not self._panel.in_view:
            return
        now_s = time.monotonic()
        busy = self._panel.state.load.value.pays_small
        if now_s - self._taken_s < (EVERY_WHEN_BUSY_S if busy else EVERY_S):
            return
        image_bgr = self._panel.console.frames.read(frame)
        if image_bgr is None:
            return
        self._taken_s = now_s
        self._image = shrunk(image_bgr, self.size() * self.devicePixelRatioF())
        self._frame = frame
        self.update()

    def _on_freshness_changed(self, freshness: str) -> None:
        if freshness in ("lost", "none"):
            self.forget()
        if self._panel.in_view:
            self.refresh()
            self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        theme, bounds = self._theme, QRectF(self.rect())
        painter.fillRect(bounds, theme.color("video_ground"))
        age, instead = self.words()
        if self._image is not None:
            picture = fitted(self._image, bounds)
            painter.setOpacity(0.4 if age else 1.0)
            painter.drawImage(picture, self._image)
            painter.setOpacity(1.0)
            if not age:
                self._paint_detections(painter, picture)
        elif instead:
            self._paint_words(painter, bounds, instead)
        band = _BANDS[self._stream.freshness]
        painter.fillRect(QRectF(0, bounds.bottom() - _BAND_PX, bounds.width(), _BAND_PX), theme.color(band))
        name = text_formatting.camera_title(self.camera)
        self._paint_name(painter, f"{name} · {age}" if age else name, warns=bool(age or instead))
        edge = "blue" if self.underMouse() else "line"
        painter.setPen(QPen(theme.color(edge), 2 if self.underMouse() else 1))
        painter.drawRect(bounds.adjusted(0.5, 0.5, -0.5, -0.5))

    def _paint_detections(self, painter: QPainter, picture: QRectF) -> None:
        people, frame = self._panel.state.people_of(self.camera).value, self._frame
        if frame is None or not detections_fit(people, frame) or people.frame_width_px <= 0:
            return
        scale_x, scale_y = picture.width() / people.frame_width_px, picture.height() / people.frame_height_px
        painter.setPen(QPen(self._theme.color("box_unnamed"), 1))
        painter.setBrush(Qt.BrushStyle.NoBrush)
        for box in people.boxes:
            left, top = picture.left() + box.left_px * scale_x, picture.top() + box.top_px * scale_y
            painter.drawRect(
                QRectF(left, top, box.width_px * scale_x, box.height_px * scale_y).intersected(picture).toRect()
            )

    def _paint_words(self, painter: QPainter, bounds: QRectF, text: str) -> None:
        theme, small = self._theme, bounds.width() < _LITTLE_ROOM_PX
        if not small:
            draw_icon(
                painter, QRectF(bounds.center().x() - 11, bounds.center().y() - 34, 22, 22), "video-camera-slash",
                theme.color("video_dim"),
            )  # fmt: skip
        painter.setPen(theme.color("video_text"))
        painter.setFont(theme.font(tokens.STATUS_PX))
        top = 26 if small else bounds.center().y() - 8
        painter.drawText(
            QRectF(6, top, bounds.width() - 12, bounds.height() - top - _BAND_PX),
            int(Qt.AlignmentFlag.AlignHCenter | Qt.AlignmentFlag.AlignTop | Qt.TextFlag.TextWordWrap), text,
        )  # fmt: skip

    def _paint_name(self, painter: QPainter, text: str, *, warns: bool) -> None:
        font = self._theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD)
        metrics = QFontMetricsF(font)
        text = metrics.elidedText(text, Qt.TextElideMode.ElideRight, self.width() - 20)
        place = QRectF(4, 4, math.ceil(metrics.horizontalAdvance(text)) + 12, 20)
        ink, ground = self._theme.color("box_warning" if warns else "video_text"), self._theme.color("video_chip")
        paint_words(painter, place, text, font=font, ink=ink, ground=ground)


def shrunk(image_bgr: NDArray[np.uint8], room: QSize) -> QImage:
    """Smooth scaled copy. A large image is subsampled first, which is fast."""
    step = max(1, image_bgr.shape[1] // max(1, 2 * room.width()))
    thinned = np.ascontiguousarray(image_bgr[::step, ::step])
    height, width = thinned.shape[:2]
    image = QImage(thinned.data, width, height, 3 * width, QImage.Format.Format_BGR888)
    # of the same size it would still share the array's memory
    smaller = image.scaled(room, Qt.AspectRatioMode.KeepAspectRatio, Qt.TransformationMode.SmoothTransformation)
    return smaller.copy() if smaller.size() == image.size() else smaller


class CameraStrip(QWidget):
    """Row of thumbnails; idle while hidden."""

    chosen = Signal(str)

    def __init__(self, theme: Theme, panel: Panel) -> None:
        super().__init__(panel)
        self.setObjectName("camera_strip")
        self._theme = theme
        self._panel = panel
        self._pictures: dict[str, SmallPicture] = {}
        self._place = NO_PLACE
        self._row = layouts.hbox(self, 1, 1, margins_px=_GAP_PX, spacing_px=_GAP_PX)
        self.setAttribute(Qt.WidgetAttribute.WA_OpaquePaintEvent)
        self.hide()

    @property
    def pictures(self) -> tuple[SmallPicture, ...]:
        """Visible thumbnails, in camera order."""
        return tuple(picture for picture in self._pictures.values() if not picture.isHidden())

    def show_cameras(self, cameras: tuple[str, ...], on_show: str) -> None:
        """Set the cameras; the main one is left out."""
        for camera in [known for known in self._pictures if known not in cameras]:
            layouts.discard(self._pictures.pop(camera))
        for camera in cameras:
            if camera not in self._pictures:
                self._pictures[camera] = picture = SmallPicture(self._theme, self._panel, camera, self)
                picture.clicked.connect(self._on_clicked)
        self._pictures = {camera: self._pictures[camera] for camera in cameras}
        for at, (camera, picture) in enumerate(self._pictures.items(), 1):
            self._row.insertWidget(at, picture)
            picture.setVisible(camera != on_show)
        self.use_place(self._place)

    def use_place(self, place: StripPlace) -> None:
        self._place = place
        self.setVisible(bool(place.side))
        right = place.side == "right"
        self._row.setDirection(QBoxLayout.Direction.TopToBottom if right else QBoxLayout.Direction.LeftToRight)
        for picture in self._pictures.values():
            picture.setFixedSize(place.picture)

    def refresh(self) -> None:
        for picture in self.pictures:
            picture.refresh()

    def refresh_all(self) -> None:
        """Refresh all thumbnails, when the panel becomes visible."""
        for picture in self.pictures:
            picture.refresh_now()

    def _on_clicked(self) -> None:
        picture = self.sender()
        if isinstance(picture, SmallPicture):
            self.chosen.emit(picture.camera)

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.fillRect(self.rect(), self._theme.color("video_ground"))
        card = QRectF(self._panel.rect()).translated(-QPointF(self.pos()))
        draw_card_edge(painter, self._theme, card, active=self._panel.active)


def strip_thickness_px(place: StripPlace) -> int:
    """Width of the strip on the right, or its height below."""
    return (place.picture.width() if place.side == "right" else place.picture.height()) + 2 * _GAP_PX
