"""Manual marks: a tap marks a moment, a held key an interval; wizard errors, notes and the mark popup."""

from PySide6.QtCore import QObject, QTimer
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import Marked
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import dataclass
from caris_desktop.live.status import RecordingStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.recording_settings import ERROR_KEYS
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.action_rows import MARKS_GROUP
from caris_desktop.ui.action_spec import IntentNow
from caris_desktop.ui.drive_input_filter import DriveInputFilter
from caris_desktop.ui.mark_card import MarkCard
from caris_desktop.ui.mark_intents import move_last_mark_back, withdraw_last_mark
from caris_desktop.ui.theme import Theme

HELD_AFTER_S = 0.4
ANSWER_WITHIN_S = 5.0


@dataclass(slots=True)
class _Held:
    mark_id: str
    timer: QTimer
    stretched: bool = False


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
        self._held: dict[str, _Held] = {}
        self.card = MarkCard(theme, console, actions, window)
        self.card.earlier_requested.connect(lambda: self._ask(move_last_mark_back))
        self.card.withdraw_requested.connect(lambda: self._ask(withdraw_last_mark))
        actions.asking.connect(self._on_asking)
        actions.asked.connect(self._on_asked)
        self.card.label_chosen.connect(self._on_label_chosen)
        self.card.error_kind_chosen.connect(self._on_error_kind)
        self.card.note_kept.connect(self._on_note_stored)
        self.card.end_requested.connect(lambda mark_id: console.do(intents.EndMark(mark_id)))
        self._answer_time = QTimer(self, singleShot=True, interval=round(ANSWER_WITHIN_S * 1000))
        self._answer_time.timeout.connect(self._on_answer_late)
        self._taken_back: Marked | None = None
        console.state.recording.changed.connect(self._on_recording_changed)
        hold.mark_pressed.connect(self._on_key_pressed)
        hold.mark_released.connect(self._on_key_released)
        hold.escape_pressed.connect(self._on_escape)

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
        timer.timeout.connect(lambda: self._on_held(action_id))
        self._held[action_id] = _Held(intent.mark_id, timer)
        self._report_held()
        timer.start()

    def _report_held(self) -> None:
        self._console.state.held_marks.set(frozenset(held.mark_id for held in self._held.values()))

    def _on_held(self, action_id: str) -> None:
        """Turn the moment into an interval from the key press on, after a long hold."""
        held = self._held.get(action_id)
        if held is None or held.stretched:
            return
        held.stretched = True
        self._console.do(intents.StretchMark(held.mark_id))
        self.card.show_mark(held.mark_id, held=True)

    def _on_key_released(self, action_id: str) -> None:
        held = self._held.pop(action_id, None)
        if held is None:
            return
        self._report_held()
        held.timer.stop()
        held.timer.deleteLater()
        if held.stretched:
            self._console.do(intents.EndMark(held.mark_id))
            self.card.show_mark(held.mark_id)

    # ---- intents

    def _ask(self, find: IntentNow) -> None:
        intent = find(self._console.scenario, self._console.state, None)
        if intent is not None:
            self._actions.ask(intent)

    def _on_asking(self, intent: Intent) -> None:
        if isinstance(intent, intents.Mark | intents.BeginMark | intents.WithdrawMark):
            self._no_question()
            self._taken_back = self._console.state.marks.value.last

    def _on_asked(self, intent: Intent) -> None:
        """Show the outcome in the popup."""
        match intent:
            case intents.Mark(kind="wizard_error"):
                self._ask_what_error(intent.mark_id)
            case intents.Mark() | intents.BeginMark() | intents.EndMark():
                self.card.show_mark(intent.mark_id)
            case intents.ChangeMark() if intent.earlier_s:
                self.card.show_mark(intent.mark_id, earlier_s=intent.earlier_s)
            case intents.WithdrawMark() if self._taken_back is not None:
                self.card.show_taken_back(self._taken_back)

    def _ask_what_error(self, mark_id: str) -> None:
        """Ask for the kind of error with the next key."""
        self._hold.ask_next_key("".join(self._error_keys()), self._on_answer)
        self._answer_time.start()
        self.card.show_mark(mark_id, asks=True)

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
        mark_id = self.card.mark_id
        if mark_id:
            self._console.do(intents.ChangeMark(mark_id, label=label))
            self.card.show_mark(mark_id)

    def _on_answer_late(self) -> None:
        self._hold.ask_no_key()
        self.card.stop_asking()

    def _no_question(self) -> None:
        self._answer_time.stop()
        self._hold.ask_no_key()
        self.card.stop_asking()

    def _on_label_chosen(self, label: str) -> None:
        mark_id = self.card.mark_id
        if mark_id:
            self._console.do(intents.ChangeMark(mark_id, label=label))
            self.card.show_mark(mark_id)

    def _on_note_stored(self, text: str, mark_id: str, ago_s: float) -> None:
        """Save the note; empty ``mark_id`` for a separate note, ``ago_s``: seconds since its moment."""
        if self._console.state.recording.value.state != "recording":
            self.card.say(tr("The note was not saved"), tr("No recording is running."))
            return
        if mark_id:
            self._console.do(intents.ChangeNote(mark_id, text))
        else:
            written = intents.AddNote(text, earlier_s=max(0.0, ago_s))
            self._console.do(written)
            mark_id = written.note_id
        self.card.show_mark(mark_id)

    def _on_recording_changed(self, status: RecordingStatus) -> None:
        if status.state != "recording" and not self.card.writes_note:
            # Corrections would no longer be recorded.
            self._no_question()
            self.card.close_card()

    def _on_escape(self) -> None:
        self._no_question()
        self.card.close_card()
