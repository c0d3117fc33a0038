"""Layout and painting of a transcript turn."""

from collections.abc import Callable

from PySide6.QtCore import QPointF, QRect, QRectF, Qt
from PySide6.QtGui import QFontMetrics, QPainter, QPen, QTextCharFormat, QTextLayout, QTextOption

from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import dataclass
from caris_desktop.ui import tokens
from caris_desktop.ui.conversation.transcript_rows import TranscriptRow
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.theme import Theme

WORDS_PX = tokens.SPEECH_PX - 1
SIDE_PX = 14
_HEAD_PX = 19
_ABOVE_PX, _BELOW_PX = 5, 6


@dataclass(frozen=True, slots=True)
class RowHighlight:
    """Highlighting of a turn. ``ahead``: after the current time of a replay. ``found``: searched words in it."""

    raised: bool
    focused: bool
    ahead: bool
    words_hidden: bool
    found: tuple[str, ...]
    buttons: tuple[tuple[str, QRect], ...]


def words_rect(rect: QRect) -> QRect:
    """Text rectangle within a turn's rectangle."""
    return rect.adjusted(SIDE_PX, _ABOVE_PX + _HEAD_PX, -SIDE_PX, -_BELOW_PX)


class RowPainter:
    """Lays out a turn for a given width and paints it."""

    def __init__(self, theme: Theme) -> None:
        self._theme = theme

    def height(self, row: TranscriptRow, width_px: int) -> int:
        layout = self._lay_out(row, _words_width(width_px))
        last = layout.lineAt(layout.lineCount() - 1)
        return _ABOVE_PX + _HEAD_PX + round(last.y() + last.height()) + _BELOW_PX

    def likely_heights(self, width_px: int) -> Callable[[TranscriptRow], int]:
        """Cheap height estimate for rows far out of view."""
        metrics = QFontMetrics(self._theme.font(WORDS_PX))
        per_line = max(8, _words_width(width_px) // max(1, metrics.averageCharWidth()))
        line_px = metrics.lineSpacing()
        return lambda row: _ABOVE_PX + _HEAD_PX + line_px * (1 + len(row.words) // per_line) + _BELOW_PX

    def paint(self, painter: QPainter, rect: QRect, row: TranscriptRow, look: RowHighlight) -> None:
        theme, ground = self._theme, QRectF(rect).adjusted(6, 1, -6, -1)
        if look.raised:
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(theme.color("blue_soft"))
            painter.drawRoundedRect(ground, 6, 6)
        if look.focused:
            painter.setPen(QPen(theme.color("blue"), 2))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(ground, 6, 6)
        words = words_rect(rect)
        head = QRect(words.left(), rect.top() + _ABOVE_PX, words.width(), _HEAD_PX - 1)
        for icon, place in look.buttons:
            head.setRight(min(head.right(), place.left() - 6))
            draw_icon(painter, QRectF(place).adjusted(4, 4, -4, -4), icon, theme.color("text"))
        self._paint_head(painter, head, row)
        if look.words_hidden:
            return
        layout = self._lay_out(row, words.width())
        painter.setPen(theme.color("dim" if look.ahead else "text"))
        layout.draw(painter, QPointF(words.topLeft()), self._formats(row, layout.text(), look.found))

    def _lay_out(self, row: TranscriptRow, width_px: int) -> QTextLayout:
        layout = QTextLayout(row.words + (" …" if row.cut_short else ""), self._theme.font(WORDS_PX))
        option = QTextOption()
        option.setWrapMode(QTextOption.WrapMode.WrapAtWordBoundaryOrAnywhere)
        layout.setTextOption(option)
        layout.beginLayout()
        height = 0.0
        while (line := layout.createLine()).isValid():
            line.setLineWidth(float(width_px))
            line.setPosition(QPointF(0.0, height))
            height += line.height()
        layout.endLayout()
        return layout

    def _paint_head(self, painter: QPainter, rect: QRect, row: TranscriptRow) -> None:
        """Paint time, speaker, remarks and tags."""
        theme, small = self._theme, self._theme.font(tokens.STATUS_PX)
        metrics, left = QFontMetrics(small), rect.left()
        painter.setFont(small)
        pieces = [(row.time, "dim"), (row.who, {"robot": "blue", "": "amber"}.get(row.speaker, "dim"))]
        if row.heard_text is not None:
            pieces.append((" ".join(("·", tr("corrected"))), "dim"))
        if row.cut_short:
            pieces.append((" ".join(("·", tr("cut short"))), "amber"))
        for text, role in pieces:
            room = max(0, rect.right() - left)
            cut = metrics.elidedText(text, Qt.TextElideMode.ElideRight, room)
            painter.setPen(theme.color(role))
            painter.drawText(QRect(left, rect.top(), room, rect.height()), int(Qt.AlignmentFlag.AlignVCenter), cut)
            left += metrics.horizontalAdvance(cut) + 6
        for tag in row.tags:
            width = metrics.horizontalAdvance(tag) + 12
            if left + width > rect.right():
                break
            painter.setPen(QPen(theme.color("line_strong"), 1))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(QRectF(left + 0.5, rect.top() + 0.5, width, 17), 5, 5)
            painter.setPen(theme.color("dim"))
            painter.drawText(QRect(left, rect.top(), width + 1, 18), Qt.AlignmentFlag.AlignCenter, tag)
            left += width + 6

    def _formats(self, row: TranscriptRow, text: str, found: tuple[str, ...]) -> list[QTextLayout.FormatRange]:
        formats = []
        if row.tentative:
            tentative = _format(len(row.words) - len(row.tentative), len(row.tentative))
            tentative.format.setForeground(self._theme.color("dim"))
            tentative.format.setUnderlineStyle(QTextCharFormat.UnderlineStyle.DotLine)
            tentative.format.setUnderlineColor(self._theme.color("dim"))
            formats.append(tentative)
        plain = text.casefold()
        for word in found:
            at = plain.find(word)
            while at >= 0:
                marked = _format(at, len(word))
                marked.format.setBackground(self._theme.color("amber_soft"))
                marked.format.setForeground(self._theme.color("amber"))
                marked.format.setFontUnderline(True)  # visible without colour too
                formats.append(marked)
                at = plain.find(word, at + len(word))
        return formats


def _words_width(width_px: int) -> int:
    return max(80, width_px - 2 * SIDE_PX)


def _format(start: int, length: int) -> QTextLayout.FormatRange:
    made = QTextLayout.FormatRange()
    made.start, made.length = start, length
    made.format = QTextCharFormat()
    return made
