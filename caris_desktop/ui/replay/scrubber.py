"""Seek slider over the whole session, with events and a preview on hover."""

from collections.abc import Callable

from PySide6.QtCore import QPoint, QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import (
    QAccessible,
    QFontMetricsF,
    QHideEvent,
    QImage,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QPixmap,
    QPolygonF,
    QResizeEvent,
)
from PySide6.QtWidgets import QSizePolicy, QWidget

from caris_desktop.domain.translation import tr, tr_filled
from caris_desktop.recording.annotation.timeline_overview import SessionOverview
from caris_desktop.ui import tokens
from caris_desktop.ui.replay.seek_throttle import SeekThrottle
from caris_desktop.ui.replay.thumbnails import Thumbnails
from caris_desktop.ui.replay.timeline_model import exact_text
from caris_desktop.ui.theme import Theme

HEIGHT_PX = 32
_SIDE_PX = 8
_GROOVE_Y = 17.0
_STEP_NS = 5_000_000_000
_PICTURE = QSize(192, 108)
_PROBLEMS = ("problem", "trouble", "gap", "emergency")


class Scrubber(QWidget):
    """Slider over the session; ``seek_wanted(at_ns)`` while dragging.

    Marks are flags above the line, utterances strokes on it, problems triangles below: distinguished by shape.
    """

    accessible_role = QAccessible.Role.Slider

    seek_wanted = Signal(object)

    def __init__(self, theme: Theme, thumbnails: Thumbnails, named: Callable[[str], str]) -> None:
        super().__init__()
        self.setObjectName("replay_scrubber")
        self.setAccessibleName(tr("Position in the session"))
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setMouseTracking(True)
        self.setFixedHeight(HEIGHT_PX)
        self.setMinimumWidth(120)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        self._theme = theme
        self._thumbnails = thumbnails
        self._named = named
        self._start_ns = self._end_ns = self._position_ns = 0
        self._overview: SessionOverview | None = None
        self._problems_ms: list[int] = []
        self._words: Callable[[int], str] = lambda _at_ns: ""
        self._ticks: QPixmap | None = None
        self._hover_ns: int | None = None
        self._dragging = False
        self._by_key = False
        self._seeks = SeekThrottle(self)
        self._seeks.due.connect(self.seek_wanted)
        self._bubble: SeekPreview | None = None
        thumbnails.made.connect(self._on_picture_made)
        theme.changed.connect(self._forget_ticks)

    # ---- display

    def show_session(self, start_ns: int, end_ns: int) -> None:
        if (start_ns, end_ns) != (self._start_ns, self._end_ns):
            self._start_ns, self._end_ns = start_ns, end_ns
            self._forget_ticks()

    def show_position(self, position_ns: int) -> None:
        """Set the replay's position; during a drag the handle stays at the pointer."""
        if position_ns != self._position_ns:
            before = self.x_of(self._position_ns)
            self._position_ns = position_ns
            if round(before * 2) != round(self.x_of(position_ns) * 2) and not self._dragging:
                self.update()
            if self._by_key:
                # Announce a jump by key, not every position of a playing replay.
                self._by_key = False
                self.setAccessibleDescription(self.accessible_words())

    def show_overview(self, overview: SessionOverview | None, words: Callable[[int], str]) -> None:
        """Set the events to show; ``words`` formats a time."""
        self._overview, self._words = overview, words
        self._problems_ms = []
        if overview is not None:
            problems = {
                tier.tier_id for tier in overview.tiers.tiers if any(word in tier.name.casefold() for word in _PROBLEMS)
            }
            self._problems_ms = [item.start_ms for item in overview.tiers.annotations if item.tier_id in problems]
        self._forget_ticks()

    def _forget_ticks(self) -> None:
        self._ticks = None
        self.update()

    @property
    def shown_ns(self) -> int:
        """Position of the handle."""
        return self._hover_ns if self._dragging and self._hover_ns is not None else self._position_ns

    def accessible_words(self) -> str:
        return self._words(self._position_ns)

    def x_of(self, at_ns: int) -> float:
        room = max(1, self.width() - 2 * _SIDE_PX)
        length = max(1, self._end_ns - self._start_ns)
        return _SIDE_PX + room * min(1.0, max(0.0, (at_ns - self._start_ns) / length))

    def moment_at(self, x_px: float) -> int:
        room = max(1, self.width() - 2 * _SIDE_PX)
        fraction = min(1.0, max(0.0, (x_px - _SIDE_PX) / room))
        return self._start_ns + round(fraction * (self._end_ns - self._start_ns))

    # ---- pointer and keys

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton:
            self._dragging = True
            self._point_at(event.position().x())
            self._seeks.want(self.moment_at(event.position().x()))

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        self._point_at(event.position().x())
        if self._dragging:
            self._seeks.want(self.moment_at(event.position().x()))

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and self._dragging:
            self._dragging = False
            self._position_ns = self.moment_at(event.position().x())
            self._seeks.want(self._position_ns)
            self.update()
            if not self.rect().contains(event.position().toPoint()):
                self._put_away()

    def leaveEvent(self, _event: object) -> None:
        if not self._dragging:
            self._put_away()

    def hideEvent(self, event: QHideEvent) -> None:
        super().hideEvent(event)
        self._put_away()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        steps = {
            Qt.Key.Key_Left: -1, Qt.Key.Key_Down: -1, Qt.Key.Key_Right: 1, Qt.Key.Key_Up: 1,
            Qt.Key.Key_PageDown: -6, Qt.Key.Key_PageUp: 6,
        }  # fmt: skip
        key = Qt.Key(event.key())
        self._by_key = key in steps or key in (Qt.Key.Key_Home, Qt.Key.Key_End)
        if event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier:
            super().keyPressEvent(event)
        elif key in steps:
            self.seek_wanted.emit(self._bounded(self._position_ns + steps[key] * _STEP_NS))
        elif key == Qt.Key.Key_Home:
            self.seek_wanted.emit(self._start_ns)
        elif key == Qt.Key.Key_End:
            self.seek_wanted.emit(self._end_ns)
        else:
            super().keyPressEvent(event)

    def _bounded(self, at_ns: int) -> int:
        return min(max(self._start_ns, at_ns), self._end_ns)

    def _point_at(self, x_px: float) -> None:
        self._hover_ns = self.moment_at(x_px)
        self._show_bubble()
        self.update()

    def _put_away(self) -> None:
        self._hover_ns = None
        if self._bubble is not None:
            self._bubble.hide()
        self.update()

    # ---- preview

    def _picture_moment(self, at_ns: int) -> int:
        """Time rounded to the preview grid, so that small pointer moves reuse the image."""
        grain_ns = max(500_000_000, (self._end_ns - self._start_ns) // 400)
        return self._start_ns + (at_ns - self._start_ns) // grain_ns * grain_ns

    def _show_bubble(self) -> None:
        if self._hover_ns is None or self._end_ns <= self._start_ns:
            return
        window = self.window()
        if self._bubble is None or self._bubble.parent() is not window:
            self._bubble = SeekPreview(self._theme, window)
        cameras = () if self._overview is None else self._overview.cameras
        picture = None
        if cameras:
            moment = self._picture_moment(self._hover_ns)
            picture = self._thumbnails.picture(cameras[0], moment)
            if picture is None:
                self._thumbnails.want(cameras[0], moment)
        at = self.mapTo(window, QPoint(round(self.x_of(self._hover_ns)), 0))
        self._bubble.show_moment(at, self._words(self._hover_ns), self._nearby(), picture, with_picture=bool(cameras))

    def _nearby(self) -> str:
        """Events at the pointer, as text."""
        if self._overview is None or self._hover_ns is None:
            return ""
        at_px = self.x_of(self._hover_ns)
        near = [moment for moment in self._overview.moments if abs(self.x_of(moment.at_ns) - at_px) <= 4]
        if not near:
            return ""
        nearest = min(near, key=lambda moment: (moment.kind != "mark", abs(self.x_of(moment.at_ns) - at_px)))
        if nearest.kind == "utterance":
            return self._named(tr_filled(nearest.text))
        return tr("Mark: {label}").format(label=tr_filled(nearest.text)) if nearest.text else tr("Mark: no label")

    def _on_picture_made(self, _camera: str, _at_ns: object) -> None:
        if self._bubble is not None and self._bubble.isVisible():
            self._show_bubble()

    # ---- drawing

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._ticks = None

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme = self._theme
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        groove = QRectF(_SIDE_PX, _GROOVE_Y - 2, self.width() - 2 * _SIDE_PX, 4)
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(theme.color("line_strong"))
        painter.drawRoundedRect(groove, 2, 2)
        x = self.x_of(self.shown_ns)
        painter.setBrush(theme.color("blue"))
        painter.drawRoundedRect(QRectF(groove.left(), groove.top(), x - groove.left(), 4), 2, 2)
        if self._ticks is None:
            self._ticks = self._draw_ticks()
        painter.drawPixmap(0, 0, self._ticks)
        if self._hover_ns is not None and not self._dragging:
            painter.setPen(QPen(theme.color("dim"), 1))
            over = self.x_of(self._hover_ns)
            painter.drawLine(QPointF(over, 6), QPointF(over, HEIGHT_PX - 4))
        painter.setPen(QPen(theme.color("blue"), 2))
        painter.setBrush(theme.color("panel"))
        painter.drawEllipse(QPointF(x, _GROOVE_Y), 7, 7)
        if self.hasFocus():
            painter.setPen(QPen(theme.color("blue"), 2))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(
                QRectF(self.rect()).adjusted(1, 1, -1, -1), tokens.CONTROL_RADIUS_PX, tokens.CONTROL_RADIUS_PX
            )

    def _draw_ticks(self) -> QPixmap:
        theme, ratio = self._theme, self.devicePixelRatioF()
        pixmap = QPixmap(round(self.width() * ratio), round(HEIGHT_PX * ratio))
        pixmap.setDevicePixelRatio(ratio)
        pixmap.fill(Qt.GlobalColor.transparent)
        if self._overview is None or self._end_ns <= self._start_ns:
            return pixmap
        painter = QPainter(pixmap)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        utterances = {round(self.x_of(item.at_ns)) for item in self._overview.moments if item.kind == "utterance"}
        painter.setPen(QPen(theme.color("dim"), 1))
        for x in utterances:
            painter.drawLine(QPointF(x + 0.5, _GROOVE_Y + 5), QPointF(x + 0.5, _GROOVE_Y + 10))
        painter.setPen(Qt.PenStyle.NoPen)
        painter.setBrush(theme.color("amber"))
        for x in {round(self.x_of(self._start_ns + at_ms * 1_000_000)) for at_ms in self._problems_ms}:
            painter.drawPolygon(QPolygonF([QPointF(x, _GROOVE_Y + 4), QPointF(x - 4, 28), QPointF(x + 4, 28)]))
        painter.setBrush(theme.color("blue"))
        for x in {round(self.x_of(item.at_ns)) for item in self._overview.moments if item.kind == "mark"}:
            painter.drawRect(QRectF(x - 0.75, 3, 1.5, _GROOVE_Y - 5))
            painter.drawPolygon(QPolygonF([QPointF(x, 3), QPointF(x + 8, 6), QPointF(x, 9)]))
        painter.end()
        return pixmap


class SeekPreview(QWidget):
    """Seek preview: image and time above the pointed position. Transparent to the mouse."""

    def __init__(self, theme: Theme, window: QWidget) -> None:
        super().__init__(window)
        self.setObjectName("moment_bubble")
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self._theme = theme
        self._time = ""
        self._text = ""
        self._picture: QImage | None = None
        self._with_picture = False
        self.hide()

    @property
    def shown_picture(self) -> QImage | None:
        return self._picture

    @property
    def text(self) -> str:
        """Text of the speech or mark at that time."""
        return self._text

    @property
    def time_text(self) -> str:
        return self._time

    def show_moment(
        self, above: QPoint, time_text: str, text: str, picture: QImage | None, *, with_picture: bool
    ) -> None:
        self._time, self._text, self._picture, self._with_picture = time_text, text, picture, with_picture
        metrics = QFontMetricsF(self._theme.font(tokens.STATUS_PX))
        width = max(metrics.horizontalAdvance(time_text), min(metrics.horizontalAdvance(text), 260.0)) + 24
        if with_picture:
            width = max(width, _PICTURE.width() + 16)
        height = 28 + (20 if text else 0) + (_PICTURE.height() + 8 if with_picture else 0)
        self.resize(round(width), round(height))
        room = self.window().width()
        left = min(max(8, above.x() - self.width() // 2), room - self.width() - 8)
        self.move(left, max(8, above.y() - self.height() - 4))
        self.show()
        self.raise_()
        self.update()

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme = self._theme
        painter = theme.paint_box(self, ground="panel", line="line_strong", radius_px=8)
        painter.setRenderHint(QPainter.RenderHint.SmoothPixmapTransform)
        top = 8.0
        if self._with_picture:
            place = QRectF((self.width() - _PICTURE.width()) / 2, top, _PICTURE.width(), _PICTURE.height())
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(theme.color("video_ground"))
            painter.drawRoundedRect(place, 4, 4)
            if self._picture is not None and not self._picture.isNull():
                size = self._picture.size().scaled(_PICTURE, Qt.AspectRatioMode.KeepAspectRatio)
                shown = QRectF(0, 0, size.width(), size.height())
                shown.moveCenter(place.center())
                painter.drawImage(shown, self._picture)
            top += _PICTURE.height() + 4
        painter.setFont(theme.font(tokens.STATUS_PX, tokens.WEIGHT_MEDIUM))
        painter.setPen(theme.color("text"))
        painter.drawText(QRectF(8, top, self.width() - 16, 20), Qt.AlignmentFlag.AlignCenter, self._time)
        if self._text:
            painter.setFont(theme.font(tokens.STATUS_PX))
            painter.setPen(theme.color("dim"))
            metrics = QFontMetricsF(painter.font())
            shown_text = metrics.elidedText(self._text, Qt.TextElideMode.ElideRight, self.width() - 16)
            painter.drawText(QRectF(8, top + 20, self.width() - 16, 18), Qt.AlignmentFlag.AlignCenter, shown_text)


def moment_words(at_ms: float, wall: str) -> str:
    """Session time and wall-clock time, as 12:34.500 · 10:26:36."""
    return f"{exact_text(at_ms)[:-2]} · {wall[:8]}"
