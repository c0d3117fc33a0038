"""Buttons of the set-up page: large choices, and steps with their state."""

from PySide6.QtCore import QRect, QRectF, QSize, Qt
from PySide6.QtGui import QFontMetrics, QPainter, QPaintEvent, QPen
from PySide6.QtWidgets import QAbstractButton, QSizePolicy

from caris_desktop.domain.events import PreflightState
from caris_desktop.domain.translation import tr
from caris_desktop.ui import tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.preflight.preflight_words import ICONS, ROLES, STATES
from caris_desktop.ui.theme import Theme

_PAD_PX, _ICON_PX, _CHOICE_PX = 20, 40, 230
_WRAPPED = int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop | Qt.TextFlag.TextWordWrap)


class ChoiceButton(QAbstractButton):
    """Large button with icon, title and explanation."""

    def __init__(self, theme: Theme, title: str, about: str, icon: str, *, primary: bool = False) -> None:
        super().__init__()
        self._theme = theme
        self._about = about
        self._icon = icon
        self._primary = primary
        self._low = False
        self.setText(title)
        self.setAccessibleName(title)
        self.setAccessibleDescription(about)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setCursor(Qt.CursorShape.PointingHandCursor)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        policy = QSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Minimum)
        policy.setHeightForWidth(True)
        self.setSizePolicy(policy)
        theme.changed.connect(self.update)

    def set_low(self, low: bool) -> None:
        """Switch to a compact layout with the icon on the left."""
        if low != self._low:
            self._low = low
            self.updateGeometry()

    def sizeHint(self) -> QSize:
        least_px = self.minimumSizeHint().height() if self._low else _CHOICE_PX
        return QSize(340, max(least_px, self.heightForWidth(340)))

    def minimumSizeHint(self) -> QSize:
        return QSize(240, 64 if self._low else 120)

    def heightForWidth(self, width: int) -> int:
        return self._rects(width)[1].bottom() + (12 if self._low else _PAD_PX)

    def _rects(self, width: int) -> tuple[QRect, QRect]:
        """Rectangles of title and explanation."""
        left, top = (2 * _PAD_PX + _ICON_PX, 12) if self._low else (_PAD_PX, _PAD_PX + _ICON_PX + 14)
        room = width - left - _PAD_PX
        title = self._metrics(tokens.SPEECH_PX).boundingRect(QRect(left, top, room, 2000), _WRAPPED, self.text())
        below = title.bottom() + 8
        about = self._metrics(tokens.BODY_PX).boundingRect(QRect(left, below, room, 2000), _WRAPPED, self._about)
        return QRect(left, top, room, title.height()), QRect(left, below, room, about.height())

    def _metrics(self, size_px: int) -> QFontMetrics:
        weight = tokens.WEIGHT_SEMIBOLD if size_px == tokens.SPEECH_PX else tokens.WEIGHT_NORMAL
        return QFontMetrics(self._theme.font(size_px, weight))

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter, theme = QPainter(self), self._theme
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        over = self.underMouse() or self.isDown()
        ground = "blue_soft" if self._primary else "raised"
        painter.setBrush(theme.color("raised_hover" if over and not self._primary else ground))
        strong = self.hasFocus() or self._primary or over
        painter.setPen(QPen(theme.color("blue" if strong else "line"), 2.5 if self.hasFocus() else 1.2))
        painter.drawRoundedRect(QRectF(self.rect()).adjusted(1.5, 1.5, -1.5, -1.5), 10, 10)
        place = QRectF(_PAD_PX, _PAD_PX, _ICON_PX, _ICON_PX)
        draw_icon(painter, place, self._icon, theme.color("blue" if self._primary else "dim"))
        title, about = self._rects(self.width())
        painter.setFont(theme.font(tokens.SPEECH_PX, tokens.WEIGHT_SEMIBOLD))
        painter.setPen(theme.color("text"))
        painter.drawText(title, _WRAPPED, self.text())
        painter.setFont(theme.font(tokens.BODY_PX))
        painter.setPen(theme.color("dim"))
        painter.drawText(about, _WRAPPED, self._about)


class StepButton(QAbstractButton):
    """Step with its state as shape and word."""

    def __init__(self, theme: Theme, title: str) -> None:
        super().__init__()
        self._theme = theme
        self._state: PreflightState = "not checked"
        self.setText(title)
        self.setCheckable(True)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setCursor(Qt.CursorShape.PointingHandCursor)
        self.setAttribute(Qt.WidgetAttribute.WA_Hover)
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
        theme.changed.connect(self.update)
        self._name()

    def show_state(self, state: PreflightState) -> None:
        if state != self._state:
            self._state = state
            self._name()
            self.update()

    def _name(self) -> None:
        self.setAccessibleName(tr("{step}: {state}").format(step=self.text(), state=tr(STATES[self._state])))

    def sizeHint(self) -> QSize:
        lines = QFontMetrics(self._theme.font()).height() + QFontMetrics(self._theme.font(tokens.STATUS_PX)).height()
        return QSize(180, lines + 18)

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter, theme = QPainter(self), self._theme
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if self.isChecked() or self.underMouse() or self.hasFocus():
            painter.setBrush(theme.color("raised" if self.isChecked() or self.underMouse() else "panel"))
            painter.setPen(QPen(theme.color("blue"), 2) if self.hasFocus() else Qt.PenStyle.NoPen)
            painter.drawRoundedRect(QRectF(self.rect()).adjusted(1, 1, -1, -1), 8, 8)
        middle = self.height() / 2
        draw_icon(painter, QRectF(12, middle - 11, 22, 22), ICONS[self._state], theme.color(ROLES[self._state]))
        painter.setFont(theme.font(tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD if self.isChecked() else 400))
        painter.setPen(theme.color("text"))
        room = self.width() - 52
        upper = QRectF(44, 0, room, middle + 1)
        text = painter.fontMetrics().elidedText(self.text(), Qt.TextElideMode.ElideRight, room)
        painter.drawText(upper, int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignBottom), text)
        painter.setFont(theme.font(tokens.STATUS_PX))
        painter.setPen(theme.color(ROLES[self._state]))
        lower = QRectF(44, middle + 1, room, middle - 1)
        painter.drawText(lower, int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop), tr(STATES[self._state]))
