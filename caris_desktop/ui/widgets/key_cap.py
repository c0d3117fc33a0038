"""Key cap: the key of a control, painted on it."""

from PySide6.QtCore import QRectF, Qt
from PySide6.QtGui import QColor, QFontMetricsF, QPainter, QPen
from PySide6.QtWidgets import QLabel, QSizePolicy, QWidget

from caris_desktop.ui import tokens
from caris_desktop.ui.theme import Theme

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
