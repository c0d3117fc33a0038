"""Delegate base for painted rows: elided texts and tags side by side."""

from collections.abc import Iterable

from PySide6.QtCore import QModelIndex, QObject, QPersistentModelIndex, QRect, QRectF, Qt
from PySide6.QtGui import QFont, QFontMetrics, QPainter, QPen
from PySide6.QtWidgets import QStyledItemDelegate, QStyleOptionViewItem

from caris_desktop.ui import tokens
from caris_desktop.ui.theme import Theme

Index = QModelIndex | QPersistentModelIndex
_TAG_PX = 17


class RowDelegate(QStyledItemDelegate):
    """Paints a row by ``paint_row`` with the colours of the theme."""

    def __init__(self, theme: Theme, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._theme = theme

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: Index) -> None:
        painter.save()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        self.paint_row(painter, option.rect, index)
        painter.restore()

    def paint_row(self, painter: QPainter, rect: QRect, index: Index) -> None:
        """Paint one row into ``rect``."""
        raise NotImplementedError

    def paint_text(self, painter: QPainter, rect: QRect, text: str, font: QFont, ink: str) -> int:
        """Paint text at the left, elided to ``rect``; returns its width in px."""
        metrics = QFontMetrics(font)
        shown = metrics.elidedText(text, Qt.TextElideMode.ElideRight, max(0, rect.width()))
        painter.setFont(font)
        painter.setPen(self._theme.color(ink))
        painter.drawText(rect, int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter), shown)
        return metrics.horizontalAdvance(shown)

    def paint_tags(self, painter: QPainter, rect: QRect, tags: Iterable[str]) -> None:
        """Paint the tags that fit into ``rect``, each in a box."""
        font = self._theme.font(tokens.STATUS_PX)
        left, top = rect.left(), rect.top() + (rect.height() - _TAG_PX) / 2
        for tag in tags:
            width = QFontMetrics(font).horizontalAdvance(tag) + 12
            if left + width > rect.left() + rect.width():
                break
            painter.setPen(QPen(self._theme.color("line_strong"), 1))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(QRectF(left + 0.5, top, width, _TAG_PX), 5, 5)
            self.paint_text(painter, QRect(left + 6, rect.top(), width, rect.height()), tag, font, "dim")
            left += width + 6
