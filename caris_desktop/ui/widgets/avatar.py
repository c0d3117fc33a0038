"""Avatar of a person: initials if named, otherwise a silhouette."""

from PySide6.QtCore import QRectF, Qt
from PySide6.QtGui import QPainter, QPen

from caris_desktop.ui import tokens
from caris_desktop.ui.theme import Theme, draw_icon

SIZE_PX = 38


def draw_avatar(painter: QPainter, theme: Theme, place: QRectF, name: str, *, known: bool, here: bool) -> None:
    """Draw an avatar: solid outline for a named person, dashed without a name, hollow for one who left."""
    role = "dim" if not here else ("green" if known else "blue")
    painter.save()
    painter.setRenderHint(QPainter.RenderHint.Antialiasing)
    pen = QPen(theme.color(role), 1.6)
    if not known:
        pen.setDashPattern([3, 2.4])
    painter.setPen(pen)
    painter.setBrush(theme.color(f"{role}_soft") if here else Qt.BrushStyle.NoBrush)
    rect = place.adjusted(1, 1, -1, -1)
    painter.drawEllipse(rect)
    if known:
        initials = "".join(word[0] for word in name.split()[:2]).upper()
        painter.setFont(theme.font(tokens.STATUS_PX + 1, tokens.WEIGHT_SEMIBOLD))
        painter.setPen(theme.color(role))
        painter.drawText(rect, Qt.AlignmentFlag.AlignCenter, initials)
    else:
        draw_icon(painter, rect.adjusted(9, 9, -9, -9), "user", theme.color(role))
    painter.restore()
