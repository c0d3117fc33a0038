"""Labels, icons and key caps, with the looks of the style sheet's roles."""

from typing import Any, TypeVar

from PySide6.QtCore import QRectF, Qt
from PySide6.QtGui import QColor, QFontMetricsF, QGuiApplication, QPainter, QPaintEvent, QPalette, QPen
from PySide6.QtWidgets import QLabel, QLineEdit, QSizePolicy, QWidget

from caris_desktop.ui import tokens
from caris_desktop.ui.theme import Theme, icon

FIELD_PX = 36
Named = TypeVar("Named", bound=QWidget)


def named(widget: Named, name: str, accessible_name: str = "") -> Named:
    """Set the object name, by which the style sheet finds the widget, and what a screen reader says."""
    widget.setObjectName(name)
    if accessible_name:
        widget.setAccessibleName(accessible_name)
    return widget


def label(text: str = "", role: str = "", *, tone: str = "", wraps: bool = False, **qt: Any) -> QLabel:
    """Label of a ``role`` in the style sheet, such as "heading" or "note".

    ``tone``: its colour, such as "dim" or "amber", for a role that sets none. ``qt``: properties, as objectName.
    """
    made = QLabel(text, wordWrap=wraps, **qt)
    made.setProperty("role", role)
    made.setProperty("tone", tone)
    return made


def line_edit(name: str, title: str, text: str = "", **qt: Any) -> QLineEdit:
    """Field with its object name, and its accessible name ``title``. ``qt``: properties and signals."""
    properties: dict[str, Any] = {"objectName": name, "accessibleName": title, **qt}
    field = QLineEdit(text, **properties)
    field.setMinimumHeight(FIELD_PX)
    return field


def restyle(widget: QWidget, **properties: object) -> None:
    """Set properties that the style sheet asks for, as ``role``, and apply it again where they changed."""
    if any(widget.property(name) != value for name, value in properties.items()):
        for name, value in properties.items():
            widget.setProperty(name, value)
        widget.style().unpolish(widget)
        widget.style().polish(widget)


class ElidedLabel(QLabel):
    """Label whose lines are elided; its tooltip has the whole text."""

    lead: int | None = None
    """Number of characters of a right-aligned line, the rest of which is dimmed."""

    def __init__(self, *, role: str = "", tone: str = "", **qt: Any) -> None:
        super().__init__(**qt)
        self.setProperty("role", role)
        self.setProperty("tone", tone)
        self.setSizePolicy(QSizePolicy.Policy.Ignored, QSizePolicy.Policy.Preferred)

    def setText(self, text: str) -> None:
        super().setText(text)
        self.setToolTip(text)
        self.setAccessibleName(text)

    def paintEvent(self, _event: QPaintEvent) -> None:
        painter = QPainter(self)
        rect = self.contentsRect()
        metrics, right = self.fontMetrics(), Qt.TextElideMode.ElideRight
        text = "\n".join(metrics.elidedText(line, right, rect.width()) for line in self.text().split("\n"))
        flags = int(self.alignment() | Qt.AlignmentFlag.AlignVCenter)
        if self.lead is not None:
            rest, text = text[self.lead :], text[: self.lead]
            painter.setPen(QGuiApplication.palette().color(QPalette.ColorRole.PlaceholderText))
            painter.drawText(rect, flags, rest)
            rect.setRight(rect.right() - metrics.horizontalAdvance(rest))
        painter.setPen(self.palette().color(self.foregroundRole()))
        painter.drawText(rect, flags, text)


class IconLabel(QLabel):
    """Icon of a fixed size beside the text that says what it means."""

    def __init__(self, theme: Theme, name: str = "", role: str = "dim", *, size_px: int = 18) -> None:
        super().__init__()
        self._theme, self._name, self._role = theme, name, role
        self.setFixedSize(size_px, size_px)
        theme.restyle_on_change(self._draw)

    def show_icon(self, name: str, role: str) -> None:
        if (name, role) != (self._name, self._role):
            self._name, self._role = name, role
            self._draw()

    def _draw(self) -> None:
        if self._name:
            self.setPixmap(icon(self._name, self._theme.color(self._role), self.width()).pixmap(self.size()))
        else:
            self.clear()


HEIGHT_PX = 20
_SIDE_PX = 6
_RADIUS_PX = 4


def key_cap_width(theme: Theme, text: str) -> float:
    """Width in px of the key cap; 0 for no text."""
    if not text:
        return 0.0
    metrics = QFontMetricsF(theme.font(tokens.KEY_CAP_PX, tokens.WEIGHT_SEMIBOLD))
    return max(float(HEIGHT_PX), metrics.horizontalAdvance(text) + 2 * _SIDE_PX)


def draw_key_cap(
    painter: QPainter, theme: Theme, text: str, left: float, center_y: float, *, pressed: bool = False, on: str = ""
) -> float:
    """Draw the cap at ``left``, centred on ``center_y``; returns its width.

    ``on``: colour role of the text for caps on a coloured background, drawn as an outline.
    """
    width = key_cap_width(theme, text)
    if not width:
        return 0.0
    rect = QRectF(left + 0.5, center_y - HEIGHT_PX / 2 + 0.5, width - 1, HEIGHT_PX - 1)
    painter.save()
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    if on:
        ground = theme.color(on)
        ground.setAlpha(38)
        line, ink = QColor(theme.color(on)), theme.color(on)
        line.setAlpha(150)
    elif pressed:
        ground, line, ink = theme.color("blue"), theme.color("blue"), theme.color("on_blue")
    else:
        ground, line, ink = theme.color("key_ground"), theme.color("key_line"), theme.color("text")
    painter.setPen(QPen(line, 1))
    painter.setBrush(ground)
    painter.drawRoundedRect(rect, _RADIUS_PX, _RADIUS_PX)
    painter.setFont(theme.font(tokens.KEY_CAP_PX, tokens.WEIGHT_SEMIBOLD))
    painter.setPen(ink)
    painter.drawText(rect, Qt.AlignmentFlag.AlignCenter, text)
    painter.restore()
    return width


class KeyCap(QLabel):
    """Key cap widget for hint lines, with its look from the style sheet."""

    def __init__(self, text: str = "", parent: QWidget | None = None) -> None:
        super().__init__(text, parent, alignment=Qt.AlignmentFlag.AlignCenter)
        self.setProperty("role", "key")
        self.setFixedHeight(HEIGHT_PX)
        self.setSizePolicy(QSizePolicy.Policy.Fixed, QSizePolicy.Policy.Fixed)
