"""On-screen joystick for mouse and touch: proportional, self-centring."""

import math
from typing import Literal

from PySide6.QtCore import QEvent, QPointF, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QAccessible, QHideEvent, QMouseEvent, QPainter, QPaintEvent, QPen, QTouchEvent
from PySide6.QtWidgets import QSizePolicy, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.gamepad import AT_REST, TeleopCommand
from caris_desktop.ui import tokens
from caris_desktop.ui.theme import Theme, draw_icon
from caris_desktop.ui.widgets.accessible_description import ThrottledAccessibleDescription

StickUse = Literal["base", "head"]

_DEAD_ZONE = 0.08
_RING = 0.74  # the ring outside this share of the radius moves sideways
_KNOB = 0.28


def stick_command(across: float, up: float, *, use: StickUse, sideways: bool) -> TeleopCommand:
    """Command for a stick at (right, up), each -1..1; with a round dead zone, the rest is rescaled."""
    reach = math.hypot(across, up)
    if reach <= _DEAD_ZONE:
        return AT_REST
    scale = min(1.0, (reach - _DEAD_ZONE) / (1.0 - _DEAD_ZONE)) / reach
    right, ahead = round(across * scale, 2) + 0.0, round(up * scale, 2) + 0.0
    if use == "head":
        return TeleopCommand(pan=-right, tilt=-ahead)
    return TeleopCommand(forward=ahead, left=-right) if sideways else TeleopCommand(forward=ahead, turn=-right)


class Joystick(QWidget):
    """Joystick. On a holonomic base, a drag from the outer ring or with Shift moves sideways.

    ``moved(TeleopCommand)`` on each change, and AT_REST at once on release, hiding or disabling.
    """

    accessible_role = QAccessible.Role.Graphic

    moved = Signal(object)

    def __init__(self, theme: Theme, *, use: StickUse) -> None:
        super().__init__()
        self._theme = theme
        self._use: StickUse = use
        self._can_go_sideways = False
        self._sideways = False
        self._held = False
        self._touch: int | None = None
        self._knob = QPointF()  # right and down, as shares of the reach
        self._wish = AT_REST
        self.setAttribute(Qt.WidgetAttribute.WA_AcceptTouchEvents)
        self.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Preferred)
        self.setAccessibleName(tr("Driving stick") if use == "base" else tr("Head stick"))
        self.setToolTip(tr("Drag to drive, release to stop") if use == "base" else tr("Drag to turn the head"))
        theme.changed.connect(self.update)
        self._description = ThrottledAccessibleDescription(self, self.command_text)

    def command_text(self) -> str:
        """Current command as text."""
        if not self.isEnabled():
            return tr("Off")
        forward, left, turn = self._wish.base
        pan, tilt = self._wish.head
        shares = (
            (forward, QT_TR_NOOP("{percent} % forward"), QT_TR_NOOP("{percent} % backward")),
            (left, QT_TR_NOOP("{percent} % sideways to the left"), QT_TR_NOOP("{percent} % sideways to the right")),
            (turn, QT_TR_NOOP("turning left at {percent} %"), QT_TR_NOOP("turning right at {percent} %")),
            (pan, QT_TR_NOOP("head to the left at {percent} %"), QT_TR_NOOP("head to the right at {percent} %")),
            (tilt, QT_TR_NOOP("head down at {percent} %"), QT_TR_NOOP("head up at {percent} %")),
        )  # fmt: skip
        parts = [
            tr(one if share > 0 else other).format(percent=f"{abs(share) * 100:.0f}")
            for share, one, other in shares
            if share
        ]
        return ", ".join(parts) or tr("At rest")

    @property
    def command(self) -> TeleopCommand:
        return self._wish

    @property
    def held(self) -> bool:
        return self._held

    def set_sideways(self, possible: bool) -> None:
        """Set whether the base is holonomic."""
        if possible != self._can_go_sideways:
            self._can_go_sideways = possible
            self.setToolTip(
                tr("Drag to drive, release to stop. Drag from the outer ring or hold Shift to move sideways.")
                if possible
                else tr("Drag to drive, release to stop")
            )
            self.update()

    def let_go(self) -> None:
        """Return to centre at once."""
        self._held, self._touch, self._knob = False, None, QPointF()
        self._notify(AT_REST)

    def sizeHint(self) -> QSize:
        return QSize(128, 128)

    def minimumSizeHint(self) -> QSize:
        return QSize(92, 62)

    def changeEvent(self, event: QEvent) -> None:
        # A disabled widget receives no mouse release.
        if event.type() == QEvent.Type.EnabledChange and not self.isEnabled():
            self.let_go()
        if event.type() == QEvent.Type.EnabledChange:
            self._description.changed()
        super().changeEvent(event)

    def hideEvent(self, event: QHideEvent) -> None:
        self.let_go()
        super().hideEvent(event)

    def leaveEvent(self, event: QEvent) -> None:
        # Qt grabs the pointer while the button is down; a leave event means that the grab was lost.
        if self._held and self._touch is None:
            self.let_go()
        super().leaveEvent(event)

    def event(self, event: QEvent) -> bool:
        if isinstance(event, QTouchEvent):
            return self._on_touch(event)
        if event.type() == QEvent.Type.UngrabMouse and self._held and self._touch is None:
            self.let_go()
        return bool(super().event(event))

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and self._touch is None:
            self._begin(event.position(), shift=bool(event.modifiers() & Qt.KeyboardModifier.ShiftModifier))

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        if self._held and self._touch is None:
            self._move(event.position())

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and self._touch is None:
            self.let_go()

    def _on_touch(self, event: QTouchEvent) -> bool:
        if event.type() == QEvent.Type.TouchCancel:
            self.let_go()
            return True
        for point in event.points():
            if event.type() == QEvent.Type.TouchBegin and not self._held:
                self._touch = point.id()
                self._begin(point.position(), shift=False)
            elif point.id() == self._touch and self._held:
                if point.state() == point.State.Released:
                    self.let_go()
                elif point.state() != point.State.Stationary:
                    self._move(point.position())
        if event.type() == QEvent.Type.TouchEnd and self._held:
            self.let_go()
        event.accept()
        return True

    def _begin(self, at: QPointF, *, shift: bool) -> None:
        self._held = True
        offset = at - self._center()
        in_ring = math.hypot(offset.x(), offset.y()) > self._radius() * _RING
        self._sideways = self._can_go_sideways and (in_ring or shift)
        self._move(at)

    def _move(self, at: QPointF) -> None:
        offset = (at - self._center()) / max(1.0, self._reach())
        length = math.hypot(offset.x(), offset.y())
        self._knob = offset / length if length > 1.0 else offset
        self._notify(stick_command(self._knob.x(), -self._knob.y(), use=self._use, sideways=self._sideways))

    def _notify(self, wish: TeleopCommand) -> None:
        self.update()
        if wish != self._wish:
            self._wish = wish
            self.moved.emit(wish)
            self._description.changed()

    def _center(self) -> QPointF:
        return QRectF(self.rect()).center()

    def _radius(self) -> float:
        return min(self.width(), self.height()) / 2 - 2

    def _reach(self) -> float:
        """Maximum displacement of the knob's centre."""
        ring = _RING if self._can_go_sideways else 1.0
        return self._radius() * (ring - _KNOB)

    def paintEvent(self, _event: QPaintEvent) -> None:
        theme, center, radius = self._theme, self._center(), self._radius()
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if not self.isEnabled():
            painter.setOpacity(0.5)
        painter.setPen(QPen(theme.color("blue" if self._held else "line"), 2 if self._held else 1))
        painter.setBrush(theme.color("raised"))
        painter.drawEllipse(center, radius, radius)
        inner = radius
        if self._can_go_sideways:
            inner = radius * _RING
            painter.setPen(QPen(theme.color("line_strong"), 1))
            painter.setBrush(theme.color("panel"))
            painter.drawEllipse(center, inner, inner)
            middle = radius * (1 + _RING) / 2
            ink = theme.color("blue" if self._held and self._sideways else "dim")
            for icon, side in (("caret-double-left", -1), ("caret-double-right", 1)):
                size = min(14.0, radius - inner)
                rect = QRectF(center.x() + side * middle - size / 2, center.y() - size / 2, size, size)
                draw_icon(painter, rect, icon, ink)
        self._paint_directions(painter, center, inner)
        knob = center + self._knob * self._reach()
        size = radius * _KNOB
        painter.setPen(QPen(theme.color("blue" if self._held else "line_strong"), 1.5))
        painter.setBrush(theme.color("blue" if self._held else "raised_hover"))
        painter.drawEllipse(knob, size, size)
        if self._use == "head":
            ink = theme.color("on_blue" if self._held else "text")
            draw_icon(painter, QRectF(knob.x() - 9, knob.y() - 9, 18, 18), "eye", ink)

    def _paint_directions(self, painter: QPainter, center: QPointF, inner: float) -> None:
        painter.setFont(self._theme.font(tokens.STATUS_PX))
        turns = self._use == "base"
        size = min(14.0, inner * 0.3)
        offset = inner - size * 0.85
        for icon, x, y in (
            ("caret-up", 0, -1), ("caret-down", 0, 1),
            ("arrow-counter-clockwise" if turns else "caret-left", -1, 0),
            ("arrow-clockwise" if turns else "caret-right", 1, 0),
        ):  # fmt: skip
            rect = QRectF(center.x() + x * offset - size / 2, center.y() + y * offset - size / 2, size, size)
            draw_icon(painter, rect, icon, self._theme.color("dim"))
