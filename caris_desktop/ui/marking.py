"""Manual marks: a tap marks a moment, a held key an interval; wizard errors, notes and the mark popup."""

import time
from collections.abc import Callable, Sequence
from typing import Any

from PySide6.QtCore import QObject, QPoint, QRect, QTimer, Signal
from PySide6.QtGui import QAccessible
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import Marked
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import RecordingStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.scenario_model import ERROR_KEYS, ErrorKind
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import MARKS_GROUP
from caris_desktop.ui.dock_area import Dock, DockArea
from caris_desktop.ui.focus_widget import focus_widget, give_focus_back
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter
from caris_desktop.ui.panel import TITLE_HEIGHT_PX
from caris_desktop.ui.text_formatting import ESC_CLOSES
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import FlowRow
from caris_desktop.ui.widgets.inputs import SubmitLineEdit
from caris_desktop.ui.widgets.labels import IconLabel, label
from caris_desktop.ui.widgets.popups import Popup
from caris_desktop.ui.window_place import clear_place, windows_above

HELD_AFTER_S = 0.4
ANSWER_WITHIN_S = 5.0


class Marking(QObject):
    """Runs the mark actions of the table and shows each mark in the popup for a while."""

    def __init__(
        self, theme: Theme, console: WizardConsole, actions: Actions, hold: DriveInputFilter, window: QWidget
    ) -> None:
        super().__init__(window)
        self._console = console
        self._actions = actions
        self._hold = hold
        actions.answer_for(MARKS_GROUP, self)
        # Mark of each held key, with the timer that turns it from a moment into an interval.
        self._held: dict[str, tuple[str, QTimer]] = {}
        self.card = MarkCard(theme, console, actions, window)
        actions.asking.connect(self._on_asking)
        actions.intent_sent.connect(self._on_intent_sent)
        self.card.error_kind_chosen.connect(self._on_error_kind)
        self._answer_time = QTimer(self, singleShot=True, interval=round(ANSWER_WITHIN_S * 1000))
        self._answer_time.timeout.connect(self._no_question)
        self._taken_back: Marked | None = None
        console.state.recording.changed.connect(self._on_recording_changed)
        hold.mark_pressed.connect(self._on_key_pressed)
        hold.mark_released.connect(self._on_key_released)
        hold.escape_pressed.connect(self._cancel)

    # ---- keys

    def _on_key_pressed(self, action_id: str) -> None:
        spec = self._actions.spec(action_id)
        if spec is None:
            return
        intent = self._actions.intent_of(spec)
        if not isinstance(intent, intents.Mark) or intent.kind != "mark":
            self._actions.run(action_id)
            return
        self._actions.ask(intent)
        timer = QTimer(self, singleShot=True, interval=round(HELD_AFTER_S * 1000))
        timer.timeout.connect(lambda: self._on_held(intent.mark_id))
        self._held[action_id] = intent.mark_id, timer
        self._report_held()
        timer.start()

    def _report_held(self) -> None:
        self._console.state.held_marks.set(frozenset(mark_id for mark_id, _timer in self._held.values()))

    def _on_held(self, mark_id: str) -> None:
        """Turn the moment into an interval from the key press on, after a long hold."""
        self._console.do(intents.StretchMark(mark_id))
        self.card.show_mark(mark_id, held=True)

    def _on_key_released(self, action_id: str) -> None:
        if action_id not in self._held:
            return
        mark_id, timer = self._held.pop(action_id)
        self._report_held()
        if not timer.isActive():
            self._console.do(intents.EndMark(mark_id))
            self.card.show_mark(mark_id)
        timer.stop()
        timer.deleteLater()

    # ---- intents

    def _on_asking(self, intent: Intent) -> None:
        if isinstance(intent, intents.Mark | intents.BeginMark | intents.WithdrawMark):
            self._no_question()
            self._taken_back = self._console.state.marks.value.last

    def _on_intent_sent(self, intent: Intent) -> None:
        """Show the outcome in the popup."""
        match intent:
            case intents.Mark(kind="wizard_error"):
                # Ask for the kind of error with the next key.
                self._hold.ask_next_key("".join(self._error_keys()), self._on_answer)
                self._answer_time.start()
                self.card.show_mark(intent.mark_id, asks=True)
            case intents.Mark() | intents.BeginMark() | intents.EndMark():
                self.card.show_mark(intent.mark_id)
            case intents.ChangeMark() if intent.earlier_s:
                self.card.show_mark(intent.mark_id, earlier_s=intent.earlier_s)
            case intents.WithdrawMark() if self._taken_back is not None:
                self.card.show_taken_back(self._taken_back)

    def write_note(self) -> None:
        """Open a note on this moment: the key press is the time stamp, however long the writing takes."""
        self._no_question()
        self.card.write_note()

    # ---- answers

    def _on_answer(self, letter: str) -> None:
        self._answer_time.stop()
        label = self._error_keys().get(letter, "")
        if label:
            self._on_error_kind(label)
        else:
            self.card.close_card()

    def _error_keys(self) -> dict[str, str]:
        kinds = self._console.scenario.recording.error_kinds
        return {letter: kind.kind for letter, kind in zip(ERROR_KEYS, kinds, strict=False)}

    def _on_error_kind(self, label: str) -> None:
        self._no_question()
        self.card.choose_label(label)

    def _no_question(self) -> None:
        self._answer_time.stop()
        self._hold.ask_no_key()
        self.card.stop_asking()

    def _on_recording_changed(self, status: RecordingStatus) -> None:
        if status.state != "recording" and not self.card.writes_note:
            self._cancel()  # corrections would no longer be recorded

    def _cancel(self) -> None:
        self._no_question()
        self.card.close_card()


_WIDEST_PX = 720
_SHOWN_MS = 6000
_SAID_MS = 2500
_EDGE_PX = 4
_LEAST_PX = 400
"""Least width of a picture that the popup lies on."""
_UPPER_PX = 2 * TITLE_HEIGHT_PX
"""The tabs and title bars of the upper panels are in this height."""
_ICONS = {"mark": "bookmark-simple", "note": "note-pencil", "wizard_error": "warning"}


class MarkCard(Popup):
    """Mark popup: shows a mark for a few seconds with time, label and single-key corrections.

    Lies on the picture, below its controls, and covers no title. Takes the focus only for writing a note, and returns
    it.
    """

    accessible_role = QAccessible.Role.Dialog

    error_kind_chosen = Signal(str)

    def __init__(self, theme: Theme, console: WizardConsole, actions: Actions, window: QWidget) -> None:
        super().__init__(theme, window, tone="blue")
        self.setObjectName("mark_card")
        self._console = console
        self._actions = actions
        self._window = window
        self._mark: Marked | None = None
        self._earlier_s = 0.0
        self._held = False
        self._asks = False
        self._note_for = ""
        self._note_began_s = 0.0
        self._docks: DockArea | None = None
        self._below: Sequence[QWidget] = ()
        self._focus_before: QWidget | None = None
        self._icon = IconLabel(theme, size_px=20)
        self._title = label("", "title", objectName="mark_card_title")
        self._line = label("", "note", wraps=True, objectName="mark_card_line")
        close = self._button("mark_card_close", "", self.close_card, icon="x", role="ghost", accessibleName=tr("Close"))
        self._labels = FlowRow(gap_px=6)
        self._label_buttons: list[ActionButton] = []
        self._kinds = FlowRow(gap_px=6)
        self._kind_buttons: list[tuple[str, str, ActionButton]] = []
        self._kinds_shown: tuple[ErrorKind, ...] = ()
        self._end = self._button("mark_card_end", tr("End"), self._on_end, icon="stop", role="primary")
        self._earlier = self._button(
            "mark_card_earlier", tr("3 s earlier"), lambda: actions.run("mark_earlier"), icon="rewind",
            toolTip=tr("Move the mark 3 seconds earlier. Press again for 6, 9, …"),
        )  # fmt: skip
        self._add_note = self._button(
            "mark_card_note", tr("Note"), self._on_add_note, icon="note-pencil", toolTip=tr("Add a note to this mark")
        )
        self._undo = self._button(
            "mark_card_undo", tr("Undo"), lambda: actions.run("mark_undo"), icon="arrow-u-up-left",
            toolTip=tr("Undo this mark"),
        )  # fmt: skip
        self._correct = FlowRow(self._end, self._earlier, self._add_note, self._undo, gap_px=6)
        self.field = SubmitLineEdit(objectName="note_field", accessibleName=tr("Note"), maxLength=400, minimumHeight=36)
        self.field.setPlaceholderText(tr("What is happening?"))
        self.field.returnPressed.connect(self._store_note)
        self._keep = self._button("note_keep", tr("Save"), self._store_note, key="Enter", role="primary")
        leave = self._button("note_leave", tr("Discard"), self.close_card, key="Esc", toolTip=tr(ESC_CLOSES))
        self._note_row = QWidget()
        layouts.hbox(self._note_row, (self.field, 1), self._keep, leave, margins_px=0, spacing_px=6)
        words, top = layouts.vbox(None, self._title, self._line, spacing_px=1), layouts.TOP
        head = layouts.hbox(None, (self._icon, 0, top), (words, 1), (close, 0, top), spacing_px=10)
        parts = self._labels, self._kinds, self._correct, self._note_row
        self._column = layouts.vbox(self, head, *parts, margins_px=(14, 10, 8, 12), spacing_px=8)
        self._away = QTimer(self, singleShot=True)
        self._away.timeout.connect(self._on_away)
        self._second = QTimer(self, interval=250)
        self._second.timeout.connect(self._show_words)
        console.state.marks.changed.connect(self._on_marks_changed)
        actions.keys_changed.connect(self._show_keys)
        self.follow_parent()
        self._show_keys()

    def _button(self, name: str, text: str, run: Callable[..., object] | None, **more: Any) -> ActionButton:
        more = {"height_px": 30, "text_px": tokens.STATUS_PX + 1, "objectName": name, "clicked": run, **more}
        return ActionButton(self._theme, text, **more)

    def lie_on(self, docks: DockArea, *, below: Sequence[QWidget]) -> None:
        """Place the popup on the picture, else under the titles of the upper panels, and below the visible strips."""
        self._docks, self._below = docks, below

    # ---- display

    @property
    def mark_id(self) -> str:
        """Id of the mark on display; empty if none."""
        return "" if self._mark is None else self._mark.mark_id

    @property
    def text(self) -> str:
        """Text of the popup."""
        return f"{self._title.text()}. {self._line.text()}".strip()

    def show_mark(self, mark_id: str, *, earlier_s: float = 0.0, held: bool = False, asks: bool = False) -> None:
        """Show this mark for a while; ``asks``: the next key selects the kind of wizard error."""
        mark = self._known(mark_id)
        if mark is None or self.writes_note:
            return
        self._earlier_s = earlier_s + (self._earlier_s if mark.mark_id == self.mark_id else 0.0)
        self._mark, self._held, self._asks = mark, held, asks
        self._note_row.hide()
        self._fill()
        self._open(_SHOWN_MS)

    def _known(self, mark_id: str) -> Marked | None:
        status = self._console.state.marks.value
        return next((mark for mark in (status.last, *status.open) if mark and mark.mark_id == mark_id), None)

    def show_taken_back(self, mark: Marked) -> None:
        """Confirm that the mark was withdrawn."""
        if not self.writes_note:
            title = tr("Note removed") if mark.kind == "note" else tr("Mark removed")
            line = tr("{label} is not counted.") if mark.label else tr("It is not counted.")
            self.say(title, line.format(label=mark.label))

    def say(self, title: str, line: str) -> None:
        """Show a sentence for a moment, without buttons."""
        self._mark = None
        self._earlier_s = 0.0
        self._asks = False
        self._title.setText(title)
        self._line.setText(line)
        self.setAccessibleName(self.text)
        for part in (self._labels, self._kinds, self._correct, self._note_row):
            part.hide()
        self._icon.show_icon(_ICONS["mark"], "blue")
        self._second.stop()
        self._open(_SAID_MS)

    def stop_asking(self) -> None:
        """Stop waiting for an answer key."""
        if self._asks:
            self._asks = False
            self._show_words()
            self._show_keys()

    def write_note(self, mark: Marked | None = None) -> None:
        """Open the field for a note about this moment, or about ``mark``."""
        if self.writes_note and mark is None:
            focus_widget(self.field)
            return
        focused = self._window.focusWidget()
        if focused is not self.field:
            self._focus_before = focused
        self._note_began_s = time.monotonic()
        self._note_for = "" if mark is None else mark.mark_id
        at_ns = self._console.state.present.now_ns() if mark is None else mark.moment_ns
        self._mark = None
        at = text_formatting.clock_time(at_ns, self._console.state.present.anchor)
        self._title.setText(tr("Note about {time}").format(time=at))
        self._line.setText(tr("You can still drive with Alt while you write."))
        for part in (self._labels, self._kinds, self._correct):
            part.hide()
        self._second.stop()
        self._away.stop()
        self.field.setText("" if mark is None else mark.note)
        self._note_row.show()
        self._icon.show_icon(_ICONS["note"], "blue")
        self._open(None)
        focus_widget(self.field)

    @property
    def writes_note(self) -> bool:
        return self.isVisible() and not self._note_row.isHidden()

    def close_card(self) -> None:
        """Hide; an unsaved note is discarded."""
        if self.isHidden():
            return
        had_focus = self.field.hasFocus()
        self._note_row.hide()
        self._mark = None
        self._asks = False
        self._earlier_s = 0.0
        self._away.stop()
        self._second.stop()
        self.hide()
        if had_focus:
            give_focus_back(self._focus_before)

    # ---- layout

    def _fill(self) -> None:
        mark = self._mark
        if mark is None:
            return
        self._fill_labels(mark)
        self._fill_kinds()
        self._kinds.setVisible(mark.kind == "wizard_error")
        self._correct.show()
        self._end.setVisible(mark.state == "open" and not self._held)
        self._add_note.setVisible(mark.state != "open" and self._console.scenario.permissions.notes)
        self._show_words()
        self._show_keys()
        self._icon.show_icon(_ICONS[mark.kind], "blue")
        if mark.state == "open":
            self._second.start()
        else:
            self._second.stop()

    def _fill_kinds(self) -> None:
        """Create a button per kind of wizard error in the scenario."""
        kinds = self._console.scenario.recording.error_kinds
        if kinds == self._kinds_shown:
            return
        self._kinds_shown = kinds
        for *_, button in self._kind_buttons:
            self._kinds.remove(button)
            layouts.discard(button)
        self._kind_buttons.clear()
        for letter, kind in zip(ERROR_KEYS, kinds, strict=False):
            title = tr(kind.kind)
            name = f"mark_card_{kind.kind.replace(' ', '_')}"
            button = self._button(
                name, f"{title[:1].upper()}{title[1:]}",
                lambda _on=False, chosen=kind.kind: self.error_kind_chosen.emit(chosen), key=letter, key_first=True,
                toolTip=tr(kind.meaning) if kind.meaning else "",
            )  # fmt: skip
            self._kinds.add(button)
            self._kind_buttons.append((letter, kind.kind, button))

    def _fill_labels(self, mark: Marked) -> None:
        labels = self._console.scenario.recording.labels if mark.kind == "mark" else ()
        while len(self._label_buttons) < len(labels):
            number = len(self._label_buttons) + 1
            button = self._button(f"mark_card_label_{number}", "", None, checkable=True)
            button.clicked.connect(lambda _on=False, button=button: self.choose_label(button.text()))
            self._labels.add(button)
            self._label_buttons.append(button)
        for index, button in enumerate(self._label_buttons):
            visible = index < len(labels)
            button.setVisible(visible)
            if visible:
                button.set_label(labels[index])
                button.setChecked(labels[index] == mark.label)
        self._labels.setVisible(bool(labels) and not self._held)

    def _show_words(self) -> None:
        mark = self._mark
        if mark is None:
            return
        anchor = self._console.state.present.anchor
        at = text_formatting.clock_time(mark.moment_ns, anchor)
        if mark.state == "open":
            lasts_s = (self._console.state.present.now_ns() - mark.moment_ns) / 1e9
            stretch = mark.label or tr("Interval")
            self._title.setText(f"{stretch} · {text_formatting.duration(lasts_s)}")
            since = tr("Since {time}, until you release the key") if self._held else tr("Since {time}")
            self._line.setText(since.format(time=at))
        else:
            text = {"wizard_error": tr("Wizard error"), "note": tr("Note saved")}.get(mark.kind, tr("Marked"))
            if mark.label:
                text = text_formatting.with_label(text, mark.label)
            elif self._asks:
                text = tr("{marked} · what kind?").format(marked=text)
            self._title.setText(text)
            parts = [at]
            if mark.end_ns is not None:
                parts.append(tr("lasted {time}").format(time=text_formatting.age((mark.end_ns - mark.moment_ns) / 1e9)))
            if self._earlier_s:
                parts.append(tr("moved {time} s earlier").format(time=f"{self._earlier_s:.0f}"))
            if mark.note:
                parts.append(f"“{text_formatting.shortened(mark.note, 60)}”")
            self._line.setText(" · ".join(parts))
        self.setAccessibleName(self.text)

    def _show_keys(self) -> None:
        self._end.set_key(self._actions.key_text("stretch"))
        self._earlier.set_key(self._actions.key_text("mark_earlier"))
        self._undo.set_key(self._actions.key_text("mark_undo"))
        for letter, kind, button in self._kind_buttons:
            button.set_key(self._actions.letter(letter) if self._asks else "")
            button.setCheckable(True)
            button.setChecked(self._mark is not None and self._mark.label == kind)

    def _on_marks_changed(self) -> None:
        if self._mark is None or self.isHidden():
            return
        mark = self._known(self.mark_id)
        if mark is not None and mark != self._mark:
            self._mark = mark
            self._fill()
            self.place()

    def choose_label(self, label: str) -> None:
        """Give the mark on display this label."""
        mark_id = self.mark_id
        if mark_id:
            self._console.do(intents.ChangeMark(mark_id, label=label))
            self.show_mark(mark_id)

    def _on_add_note(self) -> None:
        if self._mark is not None:
            self.write_note(self._mark)

    def _on_end(self) -> None:
        if self.mark_id:
            self._console.do(intents.EndMark(self.mark_id))
            self._open(_SHOWN_MS)

    def _store_note(self) -> None:
        text = " ".join(self.field.text().split())
        mark_id, ago_s = self._note_for, time.monotonic() - self._note_began_s
        self.close_card()
        if not (text or mark_id):
            return
        if self._console.state.recording.value.state != "recording":
            self.say(tr("The note was not saved"), tr("No recording is running."))
            return
        if mark_id:
            self._console.do(intents.ChangeNote(mark_id, text))
        else:
            written = intents.AddNote(text, earlier_s=max(0.0, ago_s))
            self._console.do(written)
            mark_id = written.note_id
        self.show_mark(mark_id)

    # ---- placement and style

    def _open(self, for_ms: int | None) -> None:
        self.place()
        self.show()
        self.place()
        self.raise_()
        if for_ms is not None:
            self._away.start(for_ms)

    def _on_away(self) -> None:
        if self.underMouse() or self._held:
            self._away.start(1500)
        else:
            self.close_card()

    def place(self) -> None:
        if self._docks is None:
            return
        picture = self._docks.picture_place()
        room = picture if picture.width() >= _LEAST_PX else self._docks.rect()
        docks = (dock for dock in self._docks.findChildren(Dock) if dock.isVisible())
        titles = [
            dock.title_bar for dock in docks if room.intersects(dock.geometry()) and dock.y() < room.top() + _UPPER_PX
        ]
        above = [part for part in (*self._below, *titles) if part.isVisible()]
        top = max((part.mapTo(self._window, part.rect().bottomLeft()).y() for part in above), default=0) + _EDGE_PX
        left = room.translated(self._docks.mapTo(self._window, QPoint())).left() + _EDGE_PX
        width = min(_WIDEST_PX, room.width() - 2 * _EDGE_PX)
        self._column.invalidate()
        self._column.activate()
        usual = QRect(left, top, width, self._column.heightForWidth(width))
        taken = [window.place_in(self._window) for window in windows_above(self._window)]
        free = clear_place(usual, QRect(_EDGE_PX, top, self._window.width() - 2 * _EDGE_PX, usual.height()), taken)
        self.setGeometry(free or usual)
