"""Transcript view: turns with variable height, painted only when visible, edited in place."""

import itertools
from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import Literal

from PySide6.QtCore import QEvent, QPoint, QPointF, QRect, QRectF, Qt, QTimer, Signal
from PySide6.QtGui import (
    QAccessible,
    QFontMetrics,
    QHelpEvent,
    QKeyEvent,
    QMouseEvent,
    QPainter,
    QPaintEvent,
    QPen,
    QResizeEvent,
    QTextCharFormat,
    QTextCursor,
    QTextLayout,
    QTextOption,
)
from PySide6.QtWidgets import QAbstractScrollArea, QFrame, QToolTip

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.ui import tokens
from caris_desktop.ui.conversation.transcript_rows import TranscriptRow
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.accessible_regions import AccessibleRegion, AccessibleRegions
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.submit_text_edit import SubmitTextEdit
from caris_desktop.ui.wrapped_tip import wrapped_tip

RowAct = Literal["text", "who", "tags", "mark"]
_BUTTON_PX = 24
_FIELD_PX = 36
_LONGEST = 1000
_EMPTY_PX = 50
_AT_ONCE = 150
"""Rows measured per event loop turn: a few milliseconds."""


class RowButton(Value):
    """Button of a turn."""

    act: RowAct
    icon: str
    tip: str


_BUTTONS = (
    RowButton("text", "pencil-simple", QT_TR_NOOP("Correct the text (Enter)")),
    RowButton("who", "user-focus", QT_TR_NOOP("Correct the speaker (S)")),
    RowButton("tags", "tag", QT_TR_NOOP("Tags (T)")),
    RowButton("mark", "bookmark-simple", QT_TR_NOOP("Mark this moment (M)")),
)
_ENTER = (Qt.Key.Key_Return, Qt.Key.Key_Enter)
_OF_HEARD_ONLY = ("text", "who")
_KEYS: dict[int, RowAct] = {
    Qt.Key.Key_Return: "text", Qt.Key.Key_Enter: "text", Qt.Key.Key_S: "who",
    Qt.Key.Key_T: "tags", Qt.Key.Key_M: "mark",
}  # fmt: skip


WORDS_PX = tokens.SPEECH_PX - 1
SIDE_PX = 14
_HEAD_PX = 19
_ABOVE_PX, _BELOW_PX = 5, 6


class RowHighlight(Value):
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

    def paint(self, painter: QPainter, rect: QRect, row: TranscriptRow, highlight: RowHighlight) -> None:
        theme, ground = self._theme, QRectF(rect).adjusted(6, 1, -6, -1)
        if highlight.raised:
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(theme.color("blue_soft"))
            painter.drawRoundedRect(ground, 6, 6)
        if highlight.focused:
            painter.setPen(QPen(theme.color("blue"), 2))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(ground, 6, 6)
        words = words_rect(rect)
        head = QRect(words.left(), rect.top() + _ABOVE_PX, words.width(), _HEAD_PX - 1)
        for icon, place in highlight.buttons:
            head.setRight(min(head.right(), place.left() - 6))
            draw_icon(painter, QRectF(place).adjusted(4, 4, -4, -4), icon, theme.color("text"))
        self._paint_head(painter, head, row)
        if highlight.words_hidden:
            return
        layout = self._lay_out(row, words.width())
        painter.setPen(theme.color("dim" if highlight.ahead else "text"))
        layout.draw(painter, QPointF(words.topLeft()), self._formats(row, layout.text(), highlight.found))

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


class TranscriptView(QAbstractScrollArea):
    """Scrolls with the newest turn (in a replay, the current one) until the wizard scrolls back.

    A click does not take the focus, so that it interrupts neither typing nor driving. ``picked``: a turn was clicked
    (or Enter pressed, if read-only); ``wanted``: one of its buttons; ``given``: its new text. ``may_change`` is False
    for a read-only transcript, as in a replay.
    """

    accessible_role = QAccessible.Role.List

    picked = Signal(str)  # utterance id
    action_requested = Signal(str, str)  # who or mark; utterance id
    given = Signal(str, str, str)  # text or tags; utterance id; what was written

    def __init__(self, theme: Theme, *, may_change: bool, empty: str) -> None:
        super().__init__()
        self._theme = theme
        self._painter = RowPainter(theme)
        self._may_change = may_change
        self._empty = empty
        self._rows: list[TranscriptRow] = []
        self._tops = [0]
        self._measured: dict[str, tuple[TranscriptRow, int]] = {}
        self._measured_at_px = 0
        self._all_known = True
        self._current = ""
        self._hovered = ""
        self._found: frozenset[int] = frozenset()
        self._query: tuple[str, ...] = ()
        self._following = True
        self._placing = False
        self._now_row: int | None = None
        self._below = 0
        self._writing: tuple[RowAct, str] | None = None
        self.setFrameShape(QFrame.Shape.NoFrame)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setAccessibleName(tr("Transcript"))
        self.viewport().setAutoFillBackground(False)
        self.viewport().setMouseTracking(True)
        self.setMinimumHeight(_EMPTY_PX)
        self.setMaximumHeight(_EMPTY_PX)
        self.verticalScrollBar().valueChanged.connect(self._on_scrolled)
        self.verticalScrollBar().setSingleStep(30)
        self._rest = QTimer(self, singleShot=True, interval=0)
        self._rest.timeout.connect(self._measure_some)
        self._to_newest = ActionButton(
            theme, "", icon="arrow-down", role="primary", height_px=28, text_px=tokens.STATUS_PX, parent=self
        )
        self._to_newest.setObjectName("new_below")
        self._to_newest.clicked.connect(self.follow)
        self._to_newest.hide()
        self._to_newest.raise_()
        self._field = SubmitTextEdit()
        self._field.setParent(self.viewport())
        self._field.setObjectName("transcript_field")
        self._field.hide()
        self._field.entered.connect(self._on_written)
        # Leaving without Enter discards the edit.
        self._field.left.connect(self.give_up_writing)
        self._regions = AccessibleRegions(
            self.viewport(), self.viewport(), lambda: _spots(self), self._on_accessible_press
        )
        theme.changed.connect(self._on_theme_changed)

    # ---- display

    @property
    def rows(self) -> Sequence[TranscriptRow]:
        return self._rows

    @property
    def current(self) -> str:
        """Turn that keys act on; empty for none."""
        return self._current

    def show_rows(self, rows: list[TranscriptRow]) -> None:
        """Set the turns."""
        came = max(0, len(rows) - len(self._rows)) if self._rows else 0

        def put() -> None:
            self._rows = rows
            if self._current and self._row_of(self._current) is None:
                self._current = ""

        self._change(put)
        self._report_below(0 if self._following or self._now_row is not None else self._below + came)

    def show_now(self, row: int) -> None:
        """Replay: set the current turn; later ones are dimmed. -1 for before the first."""
        if row != self._now_row:
            self._now_row = row
            if self._following:
                self._place(self._scroll_to_followed)
            self.viewport().update()

    def show_found(self, found: Sequence[int], query: str) -> None:
        """Highlight search results."""
        self._found, self._query = frozenset(found), tuple(query.casefold().split())
        self.viewport().update()

    def show_turn(self, row: int) -> None:
        """Scroll to a turn and make it current."""
        if 0 <= row < len(self._rows):
            self._following = False
            self._make_current(self._rows[row].utterance_id)

    def follow(self) -> None:
        """Scroll to the newest turn and follow it."""
        self._following = True
        self._place(self._scroll_to_followed)
        self._report_below(0)

    def row_rect(self, row: int) -> QRect:
        """Rectangle of a turn in the viewport."""
        top = self._tops[row] - self.verticalScrollBar().value()
        return QRect(0, top, self.viewport().width(), self._tops[row + 1] - self._tops[row])

    # ---- row heights

    def _change(self, change: Callable[[], object]) -> None:
        """Apply a change while the visible turn, or the newest, stays in place."""
        bar = self.verticalScrollBar()
        anchor = self._row_at(0) if not self._following else -1
        position = (self._rows[anchor].utterance_id, self._tops[anchor] - bar.value()) if anchor >= 0 else None
        change()
        self._sum_up()

        def place() -> None:
            row = None if position is None else self._row_of(position[0])
            if position is not None and row is not None:
                bar.setValue(self._tops[row] - position[1])
            else:
                self._scroll_to_followed()

        self._place(place)
        # Rows that come into view are measured before painting, which may bring others into view.
        for _ in range(6):
            if not self._measure(self.visible_rows()):
                break
            self._sum_up()
            self._place(place)
        if not self._all_known:
            self._rest.start()
        self._place_field()
        self.viewport().update()

    def _sum_up(self) -> None:
        if len(self._rows) <= _AT_ONCE:
            # Exact heights where all rows may fit: estimates toggled the scroll bar, and with it the width and the
            # estimates, endlessly.
            self._measure(range(len(self._rows)))
        width = self.viewport().width()
        likely = self._painter.likely_heights(width)
        known = [self._known_height(row) for row in self._rows]
        self._all_known = None not in known
        heights = (likely(row) if height is None else height for row, height in zip(self._rows, known, strict=True))
        self._tops = [0, *itertools.accumulate(heights)]
        total_px = max(_EMPTY_PX, self._tops[-1])
        bar = self.verticalScrollBar()
        self._placing = True
        bar.setPageStep(self.viewport().height())
        bar.setRange(0, max(0, self._tops[-1] - self.viewport().height()))
        self._placing = False
        if total_px != self.maximumHeight():
            self.setMaximumHeight(total_px)

    def _known_height(self, row: TranscriptRow) -> int | None:
        measured = self._measured.get(row.utterance_id)
        return measured[1] if measured is not None and measured[0] is row else None

    def _measure(self, rows: Sequence[int]) -> bool:
        """Measure rows; returns whether any were unmeasured."""
        unknown = [row for row in rows if self._known_height(self._rows[row]) is None]
        for number in unknown:
            row = self._rows[number]
            self._measured[row.utterance_id] = (row, self._painter.height(row, self.viewport().width()))
        return bool(unknown)

    def _measure_some(self) -> None:
        """Measure the rest while idle, newest first."""
        unknown = (row for row in reversed(range(len(self._rows))) if self._known_height(self._rows[row]) is None)
        some = list(itertools.islice(unknown, _AT_ONCE))
        self._change(lambda: self._measure(some))

    def visible_rows(self) -> range:
        """Rows at least partly in view."""
        return range(max(0, self._row_at(0)), self._row_at(self.viewport().height() - 1) + 1)

    def _row_at(self, y: int) -> int:
        """Row at this y of the viewport, or the nearest; -1 without rows."""
        return min(bisect_right(self._tops, y + self.verticalScrollBar().value()) - 1, len(self._rows) - 1)

    def _row_of(self, utterance_id: str) -> int | None:
        # Usually one of the last rows.
        return next(
            (row for row in reversed(range(len(self._rows))) if self._rows[row].utterance_id == utterance_id), None
        )

    # ---- scrolling

    def _place(self, place: Callable[[], None]) -> None:
        """Scroll without counting it as the wizard's scrolling."""
        self._placing = True
        place()
        self._placing = False
        self._place_field()

    def _scroll_to_followed(self) -> None:
        bar = self.verticalScrollBar()
        if self._now_row is None:
            bar.setValue(bar.maximum())
        elif self._rows:
            last = min(max(0, self._now_row), len(self._rows) - 1)
            bar.setValue(self._tops[last + 1] - self.viewport().height() * 2 // 3)

    def _on_scrolled(self, _value: int) -> None:
        if not self._placing:
            bar = self.verticalScrollBar()
            if self._now_row is None:
                self._following = bar.value() >= bar.maximum() - 8
            else:
                self._following = False
            if self._following:
                self._report_below(0)
            if self._measure(self.visible_rows()):
                self._change(lambda: None)
            self._place_field()
        self.viewport().update()

    def _report_below(self, count: int) -> None:
        self._below = count
        self._to_newest.set_label(tr("%n new below", "", count) if count else tr("Go to newest"))
        self._to_newest.setVisible(bool(count) and self._now_row is None)
        self._place_button()

    def _place_button(self) -> None:
        self._to_newest.adjustSize()
        self._to_newest.move(
            (self.width() - self._to_newest.width()) // 2, self.height() - self._to_newest.height() - 6
        )

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        if self.viewport().width() != self._measured_at_px:
            self._measured_at_px = self.viewport().width()
            self._measured.clear()
        self._change(lambda: None)
        self._place_button()

    def _on_theme_changed(self) -> None:
        self._measured.clear()
        self._change(lambda: None)

    # ---- editing in place

    def write(self, act: RowAct, utterance_id: str) -> None:
        """Open the field for the text or the tags of a turn."""
        row = self._row_of(utterance_id)
        if row is None or not self._may_change:
            return
        utterance = self._rows[row]
        self._make_current(utterance_id)
        self._writing = (act, utterance_id)
        self._field.setFont(self._theme.font(WORDS_PX))
        self._field.setPlaceholderText(tr("Tags separated by commas, then Enter") if act == "tags" else "")
        named = tr("Tags of {said}") if act == "tags" else tr("Transcript text: {said}")
        self._field.setAccessibleName(named.format(said=utterance.text))
        self._field.setPlainText(", ".join(utterance.tags) if act == "tags" else utterance.text)
        self._field.moveCursor(QTextCursor.MoveOperation.End)
        self._place_field()
        self._field.show()
        self._field.setFocus(Qt.FocusReason.OtherFocusReason)

    @property
    def writing(self) -> bool:
        return self._writing is not None

    def _place_field(self) -> None:
        row = None if self._writing is None else self._row_of(self._writing[1])
        if row is not None:
            words = words_rect(self.row_rect(row))
            height = max(_FIELD_PX, words.height() + 18)
            self._field.setGeometry(words.left() - 11, words.top() - 3, words.width() + 22, height)

    def _on_written(self) -> None:
        if self._writing is not None:
            act, utterance_id = self._writing
            text = " ".join(self._field.toPlainText().split())[:_LONGEST]
            self.give_up_writing()
            if text or act == "tags":
                self.given.emit(act, utterance_id, text)

    def give_up_writing(self) -> None:
        """Cancel the edit."""
        if self._writing is None:
            return
        self._writing = None
        if self._field.hasFocus():
            # Qt would focus the next widget, which may be the robot's speech field or driving.
            self.setFocus(Qt.FocusReason.OtherFocusReason)
        self._field.hide()

    # ---- mouse and keyboard

    def buttons(self, row: int) -> list[tuple[RowButton, QRect]]:
        """Buttons of a turn with their rectangles in the viewport."""
        utterance = self._rows[row]
        if not self._may_change or utterance.utterance_id not in (self._current, self._hovered):
            return []
        rect, placed = self.row_rect(row), []
        right = rect.right() - SIDE_PX + 6
        for button in reversed(_BUTTONS):
            if utterance.changeable or button.act not in _OF_HEARD_ONLY:
                right -= _BUTTON_PX
                placed.append((button, QRect(right, rect.top() + 2, _BUTTON_PX, _BUTTON_PX)))
        return placed[::-1]

    def _button_at(self, at: QPoint) -> RowButton | None:
        row = self._row_under(at)
        if row is None:
            return None
        return next((button for button, rect in self.buttons(row) if rect.contains(at)), None)

    def _row_under(self, at: QPoint) -> int | None:
        row = self._row_at(at.y())
        return row if row >= 0 and self.row_rect(row).contains(at) else None

    def mousePressEvent(self, event: QMouseEvent) -> None:
        at = event.position().toPoint()
        row = self._row_under(at)
        if event.button() != Qt.MouseButton.LeftButton or row is None:
            return
        utterance_id, button = self._rows[row].utterance_id, self._button_at(at)
        self._on_accessible_press((utterance_id, button.act if button is not None else "pick"))

    def _on_accessible_press(self, key: tuple[str, ...]) -> None:
        """Handle a click, also from the accessibility interface, on a turn or its button."""
        utterance_id, act = key
        button = next((button for button in _BUTTONS if button.act == act), None)
        if button is not None:
            self._act(button.act, utterance_id)
        elif self._row_of(utterance_id) is not None:
            self._current = utterance_id
            self.viewport().update()
            self.picked.emit(utterance_id)

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        row = self._row_under(event.position().toPoint())
        if row is not None and self._rows[row].changeable:
            self._act("text", self._rows[row].utterance_id)

    def _act(self, act: RowAct, utterance_id: str) -> None:
        row = self._row_of(utterance_id)
        if row is None or not self._may_change or (act in _OF_HEARD_ONLY and not self._rows[row].changeable):
            return
        if act in ("text", "tags"):
            self.write(act, utterance_id)
        else:
            self.action_requested.emit(act, utterance_id)

    def viewportEvent(self, event: QEvent) -> bool:
        if event.type() == QEvent.Type.MouseMove and isinstance(event, QMouseEvent):
            self._hover(event.position().toPoint())
        elif event.type() == QEvent.Type.Leave:
            self._hover(None)
        elif event.type() == QEvent.Type.ToolTip and isinstance(event, QHelpEvent):
            QToolTip.showText(event.globalPos(), wrapped_tip(self._tip_at(event.pos())), self)
            return True
        return super().viewportEvent(event)

    def _tip_at(self, at: QPoint) -> str:
        button, row = self._button_at(at), self._row_under(at)
        if button is not None:
            return tr(button.tip)
        heard_text = None if row is None else self._rows[row].heard_text
        return (
            "" if heard_text is None else tr("Corrected. Originally transcribed as “{heard}”").format(heard=heard_text)
        )

    def _hover(self, at: QPoint | None) -> None:
        row = None if at is None else self._row_under(at)
        hovered = "" if row is None else self._rows[row].utterance_id
        if hovered != self._hovered:
            self._hovered = hovered
            self.viewport().update()

    def _make_current(self, utterance_id: str) -> None:
        self._current = utterance_id
        row = self._row_of(utterance_id)
        if row is not None:
            utterance = self._rows[row]
            self.setAccessibleDescription(utterance.spoken)
            self._bring_into_view(row)
        self.viewport().update()

    def _bring_into_view(self, row: int) -> None:
        bar, rect = self.verticalScrollBar(), self.row_rect(row)
        if rect.top() < 0:
            bar.setValue(bar.value() + rect.top())
        elif rect.bottom() >= self.viewport().height():
            bar.setValue(bar.value() + rect.bottom() - self.viewport().height() + 1)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        key, last = event.key(), len(self._rows) - 1
        now = self._row_of(self._current) if self._current else None
        page = max(1, len(self.visible_rows()) - 1)
        steps = {
            Qt.Key.Key_Up: -1, Qt.Key.Key_Down: 1, Qt.Key.Key_PageUp: -page, Qt.Key.Key_PageDown: page,
            Qt.Key.Key_Home: -last - 1, Qt.Key.Key_End: last + 1,
        }  # fmt: skip
        if key in steps and last >= 0:
            row = last if now is None else min(max(0, now + steps[Qt.Key(key)]), last)
            self._make_current(self._rows[row].utterance_id)
        elif now is not None and key in _ENTER and not self._may_change:
            self.picked.emit(self._current)
        elif now is not None and key in _KEYS and not event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier:
            self._act(_KEYS[key], self._current)
        else:
            super().keyPressEvent(event)

    # ---- painting

    def paintEvent(self, event: QPaintEvent) -> None:
        painter = QPainter(self.viewport())
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if not self._rows:
            painter.setFont(self._theme.font(tokens.BODY_PX))
            painter.setPen(self._theme.color("dim"))
            place = self.viewport().rect().adjusted(SIDE_PX, 10, -SIDE_PX, 0)
            painter.drawText(place, int(Qt.AlignmentFlag.AlignTop) | int(Qt.TextFlag.TextWordWrap), self._empty)
            return
        for row in self.visible_rows():
            if self.row_rect(row).intersects(event.rect()):
                self._painter.paint(painter, self.row_rect(row), self._rows[row], self._highlight(row))

    def _highlight(self, number: int) -> RowHighlight:
        row = self._rows[number]
        current = row.utterance_id == self._current
        return RowHighlight(
            raised=current or number == self._now_row,
            focused=current and self.hasFocus(),
            ahead=self._now_row is not None and number > self._now_row,
            words_hidden=self._writing == ("text", row.utterance_id),
            found=self._query if number in self._found else (),
            buttons=tuple((button.icon, place) for button, place in self.buttons(number)),
        )


def _spots(view: TranscriptView) -> list[AccessibleRegion]:
    """Accessible regions: visible turns and their buttons."""
    spots = []
    for row in view.visible_rows() if view.rows else ():
        utterance = view.rows[row]
        about = tr("Selected") if utterance.utterance_id == view.current else ""
        spots.append(AccessibleRegion((utterance.utterance_id, "pick"), utterance.spoken, view.row_rect(row), about))
        spots += [
            AccessibleRegion((utterance.utterance_id, button.act), f"{tr(button.tip)}: {utterance.words}", place)
            for button, place in view.buttons(row)
        ]
    return spots
