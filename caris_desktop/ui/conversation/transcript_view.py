"""Transcript: rows computed from turns, and their list with corrections."""

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from operator import attrgetter
from typing import Literal

from PySide6.QtCore import (
    QEvent,
    QModelIndex,
    QPersistentModelIndex,
    QPoint,
    QPointF,
    QRect,
    QRectF,
    QSignalBlocker,
    QSize,
    Qt,
    QTimer,
    Signal,
)
from PySide6.QtGui import (
    QKeyEvent,
    QPainter,
    QPen,
    QResizeEvent,
    QStandardItem,
    QTextCharFormat,
    QTextCursor,
    QTextLayout,
    QTextOption,
)
from PySide6.QtWidgets import QLayout, QListView, QWidget

from caris_desktop.conversation.conversation_transcript import Turn, is_heard
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.corrections import WhoSpoke
from caris_desktop.domain.sound_values import Hearing
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.text_formatting import wrapped_tip
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import SubmitTextEdit
from caris_desktop.ui.widgets.labels import label
from caris_desktop.ui.widgets.rows import VALUE_ROLE, Index, KeyedItems, RowDelegate, set_up_list

NOT_SURE = QT_TR_NOOP("somebody")
ROBOT, WIZARD, PARTICIPANT = QT_TR_NOOP("robot"), QT_TR_NOOP("wizard"), QT_TR_NOOP("participant")


class TranscriptRow(Value):
    """Row of a turn. ``tentative`` words may still change. ``changeable``: the speaker can be corrected."""

    utterance_id: str
    begins_ns: int
    time: str
    who: str
    speaker: WhoSpoke
    text: str
    tentative: str = ""
    cut_short: bool = False
    heard_text: str | None = None
    tags: tuple[str, ...] = ()
    changeable: bool = False

    @property
    def words(self) -> str:
        """Whole text, including partial results."""
        return " ".join(filter(None, (self.text, self.tentative)))

    @property
    def spoken(self) -> str:
        """The turn and its state as text for a screen reader."""
        state = (
            tr("still being transcribed") if self.tentative else "",
            tr("cut short") if self.cut_short else "",
            tr("corrected") if self.heard_text is not None else "",
            ", ".join(self.tags),
        )
        sentence = tr("{time}, {who}: {words}").format(time=self.time, who=self.who, words=self.words)
        return " · ".join(part for part in (sentence, *state) if part)


class RowMaker:
    """Makes rows from turns; unchanged rows are reused, as an hour has two thousand turns."""

    def __init__(self, anchor: ClockAnchor, *, with_tags: bool = True) -> None:
        self._anchor = anchor
        self._with_tags = with_tags
        self._made: dict[str, tuple[Turn, Hearing | None, object, TranscriptRow]] = {}

    def rows(
        self, turns: Iterable[Turn], names: Mapping[str, str], hearings: Mapping[str, Hearing]
    ) -> list[TranscriptRow]:
        """Rows of ``turns``, sorted by start; ``hearings``: partial results by utterance id."""
        made = {}
        for turn in turns:
            hearing = hearings.get(turn.utterance_id)
            if not turn.text and (hearing is None or not (hearing.committed or hearing.tentative)):
                continue
            named = names if "{" in turn.text else names.get(turn.person_id)
            before = self._made.get(turn.utterance_id)
            if before is None or before[0] is not turn or before[1] is not hearing or before[2] != named:
                before = (turn, hearing, named, self._row(turn, names, hearing))
            made[turn.utterance_id] = before
        self._made = made
        return [row for *_inputs, row in made.values()]

    def _row(self, turn: Turn, names: Mapping[str, str], hearing: Hearing | None) -> TranscriptRow:
        def name_of(person_id: str) -> str:
            return names.get(person_id, tr(NOT_SURE))

        return TranscriptRow(
            turn.utterance_id,
            turn.begins_ns,
            text_formatting.clock_time(turn.begins_ns, self._anchor),
            who_spoke(turn.speaker, turn.person_id, names),
            turn.speaker,
            text_formatting.with_names(turn.text, name_of) if hearing is None else hearing.committed.strip(),
            "" if hearing is None else hearing.tentative.strip(),
            cut_short=turn.state == "interrupted",
            heard_text=turn.heard_text,
            tags=turn.tags if self._with_tags else (),
            changeable=is_heard(turn),
        )


def who_spoke(speaker: WhoSpoke, person_id: str, names: Mapping[str, str]) -> str:
    """Speaker as text: a participant's name or number if known."""
    match speaker:
        case "robot":
            return tr(ROBOT)
        case "wizard":
            return tr(WIZARD)
        case "participant":
            return names.get(person_id, tr(PARTICIPANT))
        case _:
            return tr(NOT_SURE)


def found_in(rows: Sequence[TranscriptRow], query: str) -> list[int]:
    """Rows that contain all words of the query in text, speaker or tags."""
    query_words = query.casefold().split()
    if not query_words:
        return []
    return [
        number
        for number, row in enumerate(rows)
        if all(word in " ".join((row.words, row.who, *row.tags)).casefold() for word in query_words)
    ]


RowAct = Literal["text", "who", "tags", "mark"]
_BUTTON_PX = 24
_FIELD_PX = 36
_LONGEST = 1000
_EMPTY_PX = 50
_MEASURED_AT_ROLE = VALUE_ROLE + 1
"""Width in px for which the height of an item was measured."""
_AT_ONCE = 150
"""Rows measured per event loop turn: a few milliseconds."""


BUTTONS: dict[RowAct, tuple[str, str]] = {
    "text": ("pencil-simple", QT_TR_NOOP("Correct the text (Enter)")),
    "who": ("user-focus", QT_TR_NOOP("Correct the speaker (S)")),
    "tags": ("tag", QT_TR_NOOP("Tags (T)")),
    "mark": ("bookmark-simple", QT_TR_NOOP("Mark this moment (M)")),
}
"""Icons and tooltips of a turn's buttons, in order."""
_ENTER = (Qt.Key.Key_Return, Qt.Key.Key_Enter)
_STEPS = (Qt.Key.Key_Up, Qt.Key.Key_Down, Qt.Key.Key_PageUp, Qt.Key.Key_PageDown, Qt.Key.Key_Home, Qt.Key.Key_End)
_OF_HEARD_ONLY = ("text", "who")
_KEYS: dict[int, RowAct] = {
    Qt.Key.Key_Return: "text", Qt.Key.Key_Enter: "text", Qt.Key.Key_S: "who",
    Qt.Key.Key_T: "tags", Qt.Key.Key_M: "mark",
}  # fmt: skip


WORDS_PX = tokens.SPEECH_PX - 1
"""As the style sheet has it for ``transcript_field``."""
SIDE_PX = 14
_HEAD_PX = 19
_ABOVE_PX, _BELOW_PX = 5, 6


class RowHighlight(Value):
    """Highlighting of a turn. ``ahead``: after the current time of a replay. ``found``: searched words in it.
    ``buttons_px``: width of the buttons over its head.
    """

    raised: bool
    focused: bool
    ahead: bool
    words_hidden: bool
    found: tuple[str, ...]
    buttons_px: int = 0


def words_rect(rect: QRect) -> QRect:
    """Text rectangle within a turn's rectangle."""
    return rect.adjusted(SIDE_PX, _ABOVE_PX + _HEAD_PX, -SIDE_PX, -_BELOW_PX)


class RowPainter(RowDelegate):
    """Lays out a turn for a given width and paints it."""

    def __init__(self, theme: Theme, highlight_of: Callable[[int], RowHighlight] | None = None) -> None:
        super().__init__(theme)
        self._highlight_of = highlight_of

    def height(self, row: TranscriptRow, width_px: int) -> int:
        layout = self._lay_out(row, max(80, width_px - 2 * SIDE_PX))
        last = layout.lineAt(layout.lineCount() - 1)
        return _ABOVE_PX + _HEAD_PX + round(last.y() + last.height()) + _BELOW_PX

    def paint_row(self, painter: QPainter, rect: QRect, index: Index) -> None:
        if self._highlight_of is not None:
            self.paint_turn(painter, rect, index.data(VALUE_ROLE), self._highlight_of(index.row()))

    def paint_turn(self, painter: QPainter, rect: QRect, row: TranscriptRow, highlight: RowHighlight) -> None:
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
        head = QRect(words.left(), rect.top() + _ABOVE_PX, words.width() - highlight.buttons_px, _HEAD_PX - 1)
        # Paint time, speaker, remarks and tags.
        small = self._theme.font(tokens.STATUS_PX)
        pieces = [(row.time, "dim"), (row.who, {"robot": "blue", "": "amber"}.get(row.speaker, "dim"))]
        if row.heard_text is not None:
            pieces.append((" ".join(("·", tr("corrected"))), "dim"))
        if row.cut_short:
            pieces.append((" ".join(("·", tr("cut short"))), "amber"))
        for text, ink in pieces:
            head.setLeft(head.left() + self.paint_text(painter, head, text, small, ink) + 6)
        self.paint_tags(painter, head, row.tags)
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


def _format(start: int, length: int) -> QTextLayout.FormatRange:
    made = QTextLayout.FormatRange()
    made.start, made.length = start, length
    made.format = QTextCharFormat()
    return made


class TurnButtons(QWidget):
    """Buttons over the head of a turn."""

    def __init__(self, theme: Theme, view: "TranscriptView") -> None:
        super().__init__(view.viewport())
        self._utterance_id = ""
        self.buttons: dict[RowAct, ActionButton] = {}
        for act, (icon, tip) in BUTTONS.items():
            button = self.buttons[act] = ActionButton(
                theme, icon=icon, role="ghost", height_px=_BUTTON_PX, objectName=f"turn_{act}", toolTip=tr(tip),
                clicked=lambda _checked=False, act=act: view.act(act, self._utterance_id),
            )  # fmt: skip
            button.setFixedWidth(_BUTTON_PX)
            button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        layouts.hbox(self, *self.buttons.values(), margins_px=0, spacing_px=0)
        self.hide()

    def show_turn(self, row: TranscriptRow, acts: Sequence[RowAct], head: QPoint) -> None:
        """Show those of ``acts``, with their upper right corner at ``head``."""
        self._utterance_id = row.utterance_id
        for act, button in self.buttons.items():
            button.setVisible(act in acts)
            button.setAccessibleName(f"{tr(BUTTONS[act][1])}: {row.words}")
        width = _BUTTON_PX * len(acts)
        self.setGeometry(head.x() - width, head.y(), width, _BUTTON_PX)
        self.setVisible(bool(acts))


class TranscriptView(QListView):
    """Scrolls with the newest turn (in a replay, the current one) until the wizard scrolls back.

    A click does not take the focus, so that it interrupts neither typing nor driving. ``picked``: a turn was clicked
    (or Enter pressed, if read-only); ``action_requested``: one of its buttons; ``given``: its new text. ``may_change``
    is False for a read-only transcript, as in a replay.
    """

    picked = Signal(str)  # utterance id
    action_requested = Signal(str, str)  # who or mark; utterance id
    given = Signal(str, str, str)  # text or tags; utterance id; what was written

    def __init__(self, theme: Theme, *, may_change: bool, empty: str) -> None:
        super().__init__()
        self._theme = theme
        self._may_change = may_change
        self._painter = RowPainter(theme, self._highlight)
        self._items = KeyedItems[TranscriptRow](self, attrgetter("utterance_id"), self._fill)
        self.current = ""
        """Turn that keys act on; empty for none."""
        self._hovered = ""
        self._found: frozenset[int] = frozenset()
        self._query: tuple[str, ...] = ()
        self._following = True
        self._placing = False
        self._now_row: int | None = None
        self._below = 0
        self._writing: tuple[RowAct, str] | None = None
        self._nothing = label(empty, tone="dim", wraps=True)
        room = layouts.vbox(self.viewport(), margins_px=(SIDE_PX, 10, SIDE_PX, 0))
        room.setSizeConstraint(QLayout.SizeConstraint.SetNoConstraint)
        room.addWidget(self._nothing, 0, Qt.AlignmentFlag.AlignTop)
        self._rest = QTimer(self, singleShot=True, interval=0)
        self._rest.timeout.connect(self._measure_some)
        self._to_newest = ActionButton(
            theme, "", icon="arrow-down", role="primary", height_px=28, text_px=tokens.STATUS_PX, parent=self
        )
        self._to_newest.setObjectName("new_below")
        self._to_newest.clicked.connect(self.follow)
        self._to_newest.hide()
        self._on_current, self._on_hovered = TurnButtons(theme, self), TurnButtons(theme, self)
        self._field = SubmitTextEdit()
        self._field.setParent(self.viewport())
        self._field.setObjectName("transcript_field")
        self._field.hide()
        self._field.entered.connect(self._on_written)
        # Leaving without Enter discards the edit.
        self._field.left.connect(self.give_up_writing)
        self.setModel(self._items)
        self.setItemDelegate(self._painter)
        set_up_list(self)
        self.setMouseTracking(True)
        self.setAccessibleName(tr("Transcript"))
        self.setFixedHeight(_EMPTY_PX)
        bar = self.verticalScrollBar()
        bar.setSingleStep(30)
        bar.valueChanged.connect(self._on_scrolled)
        bar.rangeChanged.connect(self._on_range_changed)
        self.clicked.connect(lambda index: self.picked.emit(self.rows[index.row()].utterance_id))
        self.doubleClicked.connect(lambda index: self.act("text", self.rows[index.row()].utterance_id))
        self.entered.connect(self._on_entered)
        self.selectionModel().selectionChanged.connect(self._on_selection_changed)

    # ---- display

    @property
    def rows(self) -> Sequence[TranscriptRow]:
        return self._items.values

    def parts(self) -> list[QWidget]:
        """Widgets over the rows, which Qt does not report as children of a list."""
        buttons = (*self._on_current.buttons.values(), *self._on_hovered.buttons.values())
        return [self._to_newest, self._field, *buttons]

    def show_rows(self, rows: list[TranscriptRow]) -> None:
        """Set the turns."""
        came = max(0, len(rows) - len(self.rows)) if self.rows else 0
        if self.current and self.current not in {row.utterance_id for row in rows}:
            # Qt would select the next turn instead of a removed one.
            self.clearSelection()
            self.setCurrentIndex(QModelIndex())
        self._change(lambda: self._items.show_values(rows))
        self._nothing.setVisible(not rows)
        self._report_below(0 if self._following or self._now_row is not None else self._below + came)

    def show_now(self, row: int) -> None:
        """Replay: set the current turn; later ones are dimmed. -1 for before the first."""
        if row != self._now_row:
            self._now_row = row
            self._change(lambda: None)

    def show_found(self, found: Sequence[int], query: str) -> None:
        """Highlight search results."""
        self._found, self._query = frozenset(found), tuple(query.casefold().split())
        self.viewport().update()

    def show_turn(self, row: int) -> None:
        """Scroll to a turn and make it current."""
        if 0 <= row < len(self.rows):
            self._following = False
            self.setCurrentIndex(self._items.index(row, 0))

    def follow(self) -> None:
        """Scroll to the newest turn and follow it."""
        self._following = True
        self._change(lambda: None)
        self._report_below(0)

    def row_rect(self, row: int) -> QRect:
        """Rectangle of a turn in the viewport."""
        return self.visualRect(self._items.index(row, 0))

    def visible_rows(self) -> range:
        """Rows at least partly in view."""
        first = self.indexAt(QPoint(SIDE_PX, 0)).row()
        last = self.indexAt(QPoint(SIDE_PX, self.viewport().height() - 1)).row()
        return range(first, (last if last >= 0 else len(self.rows) - 1) + 1) if first >= 0 else range(0)

    def _highlight(self, number: int) -> RowHighlight:
        row = self.rows[number]
        current = row.utterance_id == self.current
        return RowHighlight(
            raised=current or number == self._now_row,
            focused=current and self.hasFocus(),
            ahead=self._now_row is not None and number > self._now_row,
            words_hidden=self._writing == ("text", row.utterance_id),
            found=self._query if number in self._found else (),
            buttons_px=_BUTTON_PX * len(self.acts(row.utterance_id)),
        )

    def _on_selection_changed(self) -> None:
        self.current = next((self.rows[index.row()].utterance_id for index in self.selectedIndexes()), "")
        self._place_parts()

    # ---- row heights

    def _fill(self, item: QStandardItem, row: TranscriptRow) -> None:
        item.setText(row.words)
        item.setData(row.spoken, Qt.ItemDataRole.AccessibleTextRole)
        heard = tr("Corrected. Originally transcribed as “{heard}”").format(heard=row.heard_text)
        item.setToolTip("" if row.heard_text is None else wrapped_tip(heard))
        self._measure(item, row)

    def _measure(self, item: QStandardItem, row: TranscriptRow) -> None:
        width = self.viewport().width()
        item.setData(width, _MEASURED_AT_ROLE)
        item.setSizeHint(QSize(1, self._painter.height(row, width)))

    def _measure_some(self) -> None:
        """Measure rows for a new width: those in view first, then the newest, the rest while idle."""
        width, newest_first = self.viewport().width(), reversed(range(len(self.rows)))
        stale = (
            row
            for row in dict.fromkeys((*self.visible_rows(), *newest_first))
            if self._items.item(row).data(_MEASURED_AT_ROLE) != width
        )
        some = list(itertools.islice(stale, _AT_ONCE))

        def measure() -> None:
            with QSignalBlocker(self._items):
                for row in some:
                    self._measure(self._items.item(row), self.rows[row])

        if some:
            self._change(measure)
            self._rest.start()

    def _change(self, change: Callable[[], object]) -> None:
        """Apply a change while the visible turn, or the newest, stays in place."""
        anchor = QPersistentModelIndex(self.indexAt(QPoint(SIDE_PX, 0)))
        top = self.visualRect(anchor).top()
        self._placing = True
        change()
        self.doItemsLayout()
        bar = self.verticalScrollBar()
        if self._following:
            self._scroll_to_followed()
        elif anchor.isValid():
            bar.setValue(bar.value() + self.visualRect(anchor).top() - top)
        self._placing = False

    def updateGeometries(self) -> None:
        super().updateGeometries()
        self.setMaximumHeight(max(_EMPTY_PX, self.contentsSize().height()))
        self._place_parts()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._measure_some()

    # ---- scrolling

    def _scroll_to_followed(self) -> None:
        bar = self.verticalScrollBar()
        if self._now_row is None:
            bar.setValue(bar.maximum())
        elif self.rows:
            last = min(max(0, self._now_row), len(self.rows) - 1)
            bar.setValue(bar.value() + self.row_rect(last).bottom() + 1 - self.viewport().height() * 2 // 3)

    def _on_range_changed(self) -> None:
        if self._following and not self._placing:
            self._placing = True
            self._scroll_to_followed()
            self._placing = False

    def _on_scrolled(self, value: int) -> None:
        if not self._placing:
            self._following = self._now_row is None and value >= self.verticalScrollBar().maximum() - 8
            if self._following:
                self._report_below(0)

    def _report_below(self, count: int) -> None:
        self._below = count
        self._to_newest.set_label(tr("%n new below", "", count) if count else tr("Go to newest"))
        self._to_newest.setVisible(bool(count) and self._now_row is None)
        self._place_parts()

    def _place_parts(self) -> None:
        """Place the widgets over the rows; scrolling takes them along."""
        size = self._to_newest.sizeHint()
        at = QPoint((self.width() - size.width()) // 2, self.height() - size.height() - 6)
        self._to_newest.setGeometry(QRect(at, size))
        row = None if self._writing is None else self._items.row_of(self._writing[1])
        if row is not None:
            words = words_rect(self.row_rect(row))
            height = max(_FIELD_PX, words.height() + 18)
            self._field.setGeometry(words.left() - 11, words.top() - 3, words.width() + 22, height)
        current = self.current
        hovered = self._hovered if self._hovered != current else ""
        for buttons, utterance_id in ((self._on_current, current), (self._on_hovered, hovered)):
            row = self._items.row_of(utterance_id) if utterance_id else None
            if row is None:
                buttons.hide()
            else:
                head = self.row_rect(row).topRight() + QPoint(1 + 6 - SIDE_PX, 2)
                buttons.show_turn(self.rows[row], self.acts(utterance_id), head)
        self.viewport().update()

    # ---- editing in place

    def write(self, act: RowAct, utterance_id: str) -> None:
        """Open the field for the text or the tags of a turn."""
        row = self._items.row_of(utterance_id)
        if row is None or not self._may_change:
            return
        utterance = self.rows[row]
        self.setCurrentIndex(self._items.index(row, 0))
        self._writing = (act, utterance_id)
        self._field.setPlaceholderText(tr("Tags separated by commas, then Enter") if act == "tags" else "")
        named = tr("Tags of {said}") if act == "tags" else tr("Transcript text: {said}")
        self._field.setAccessibleName(named.format(said=utterance.text))
        self._field.setPlainText(", ".join(utterance.tags) if act == "tags" else utterance.text)
        self._field.moveCursor(QTextCursor.MoveOperation.End)
        self._place_parts()
        self._field.show()
        self._field.setFocus(Qt.FocusReason.OtherFocusReason)

    @property
    def writing(self) -> bool:
        return self._writing is not None

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

    def acts(self, utterance_id: str) -> tuple[RowAct, ...]:
        """What the buttons of a turn do, in order; they exist while it is current or under the mouse."""
        shown = self._may_change and utterance_id in (self.current, self._hovered)
        row = self._items.row_of(utterance_id) if shown else None
        if row is None:
            return ()
        return tuple(act for act in BUTTONS if self.rows[row].changeable or act not in _OF_HEARD_ONLY)

    def act(self, act: RowAct, utterance_id: str) -> None:
        row = self._items.row_of(utterance_id)
        if row is None or not self._may_change or (act in _OF_HEARD_ONLY and not self.rows[row].changeable):
            return
        if act in ("text", "tags"):
            self.write(act, utterance_id)
        else:
            self.action_requested.emit(act, utterance_id)

    def viewportEvent(self, event: QEvent) -> bool:
        if event.type() == QEvent.Type.Leave:
            self._hover("")
        return super().viewportEvent(event)

    def _on_entered(self, index: QModelIndex) -> None:
        # Qt also reports a row that scrolls to where the pointer is, over whatever covers the list.
        self._hover(self.rows[index.row()].utterance_id if self.viewport().underMouse() else "")

    def _hover(self, utterance_id: str) -> None:
        if utterance_id != self._hovered:
            self._hovered = utterance_id
            self._place_parts()

    def keyboardSearch(self, _search: str) -> None:
        """Disabled: letters are for driving and the commands on a turn."""

    def keyPressEvent(self, event: QKeyEvent) -> None:
        key, current = event.key(), self.current
        if not current and self.rows and key in _STEPS:
            self.setCurrentIndex(self._items.index(len(self.rows) - 1, 0))
        elif current and key in _ENTER and not self._may_change:
            self.picked.emit(current)
        elif current and key in _KEYS and not event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier:
            self.act(_KEYS[key], current)
        else:
            super().keyPressEvent(event)
