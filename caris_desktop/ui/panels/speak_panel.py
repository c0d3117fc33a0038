"""Speak panel: text field, phrases, current utterance and speech queue."""

from collections.abc import Callable, Sequence
from functools import partial

from PySide6.QtCore import QPoint, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QAccessible, QFocusEvent, QHideEvent, QKeyEvent, QMouseEvent
from PySide6.QtWidgets import QFrame, QMenu, QScrollArea, QSizePolicy, QWidget

from caris_desktop.conversation.spoken_text import NAME, PLACE
from caris_desktop.domain import intents
from caris_desktop.domain.actor import WIZARD
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.person_marks import mark_of
from caris_desktop.domain.sound_values import WIZARD_MICROPHONE, Hearing
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import MicrophoneStatus, OpenGap, SoundStatus, SpeechStatus
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.phrases import MOST_GESTURES, phrase_groups, sentences
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.action_bindings import Actions, cap_text, keyed_phrases
from caris_desktop.ui.action_rows import (
    PHRASE_COUNT,
    QUEUE_GROUP,
    perform_nth_gesture,
    phrases_on_keys,
    say_keyed_phrase,
)
from caris_desktop.ui.focus_widget import existing, focus_widget, focused_widget
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.people.shown_people import as_permitted, name_of
from caris_desktop.ui.speak.speak_field import SpeakField, voice_choices
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import FlowRow, list_area
from caris_desktop.ui.widgets.inputs import SubmitLineEdit
from caris_desktop.ui.widgets.labels import ElidedLabel, KeyCap, label, named, restyle
from caris_desktop.ui.widgets.rows import show_rows

ROW_PX = 30


class QueueList(QWidget):
    """Row per queued utterance. While focused it handles the keys of rows ``within`` the queue."""

    accessible_role = QAccessible.Role.List

    left_over = Signal(str)  # edited text of an utterance that is already being spoken
    emptied = Signal()  # the last row was removed while focused
    row_chosen = Signal(QWidget)

    def __init__(self, theme: Theme, console: WizardConsole, actions: Actions) -> None:
        super().__init__()
        self._theme = theme
        self._console = console
        self._actions = actions
        self._rows: dict[str, _QueueRow] = {}
        self._chosen = ""
        named(self, "speak_queue", tr("Speech queue"))
        self.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self._column = layouts.vbox(self, margins_px=0, spacing_px=0)
        actions.answer_for(QUEUE_GROUP, self)
        self.setVisible(False)

    @property
    def count(self) -> int:
        return len(self._rows)

    @property
    def texts(self) -> list[str]:
        """Displayed texts, in order."""
        return [row.label.text() for row in self._rows.values()]

    def show_waiting(self, waiting: tuple[UtteranceChanged, ...]) -> None:
        """Update the rows for ``waiting``, which have unique ids."""
        row_ids = list(self._rows)
        focused = focused_widget()
        had_focus = focused is not None and (focused is self or self.isAncestorOf(focused))
        keys = [utterance.utterance_id for utterance in waiting]
        left_over = [row.changed_text for key, row in self._rows.items() if key not in keys]
        show_rows(self._column, self._rows, keys, self._new_row)
        for text in filter(None, left_over):
            self.left_over.emit(text)
        for number, utterance in enumerate(waiting, start=1):
            spoken = text_formatting.with_names(utterance.text, lambda person_id: name_of(self._console, person_id))
            self._rows[utterance.utterance_id].show_utterance(number, len(waiting), spoken, utterance)
        self._choose(self._chosen if self._chosen in self._rows else self._nearest(row_ids))
        self.setVisible(bool(waiting))
        if had_focus and not waiting:
            self.emptied.emit()

    def _nearest(self, row_ids: list[str]) -> str:
        """Replacement for a removed selected row: the next one, else the previous one."""
        at = row_ids.index(self._chosen) if self._chosen in row_ids else 0
        near = (*row_ids[at + 1 :], *reversed(row_ids[:at]), *self._rows)
        return next((each for each in near if each in self._rows), "")

    def _new_row(self, utterance_id: str) -> "_QueueRow":
        row = _QueueRow(self._theme, self._actions.key_text("focus_queue"))
        row.action_requested.connect(lambda act: self._act_on(utterance_id, act))
        row.written.connect(lambda text: self._change(utterance_id, text))
        row.pressed.connect(lambda: self._choose(utterance_id))
        row.given_up.connect(lambda: self.setFocus(Qt.FocusReason.OtherFocusReason))
        return row

    def _act_on(self, utterance_id: str, act: str) -> None:
        self._choose(utterance_id)
        if act == "queued_edit":
            self.edit()
            return
        row = self._actions.spec(act)
        intent = None if row is None else self._actions.intent_of(row)
        if intent is not None:
            self._actions.ask(intent)

    def _change(self, utterance_id: str, text: str) -> None:
        if self._console.do(intents.EditQueued(utterance_id, text)):
            self.left_over.emit(text)

    def give_up_edit(self) -> None:
        """Cancel editing."""
        for row in self._rows.values():
            row.end_edit()

    # ---- callbacks of the action table

    def edit(self) -> None:
        row = self._rows.get(self._chosen)
        if row is not None:
            row.begin_edit()

    def go(self, step: int) -> None:
        """Choose the next (1) or previous (-1) item."""
        ids = list(self._rows)
        if ids:
            at = ids.index(self._chosen) if self._chosen in ids else 0
            self._choose(ids[min(max(0, at + step), len(ids) - 1)])

    def _choose(self, utterance_id: str) -> None:
        self._chosen = utterance_id
        self._console.state.chosen_utterance.set(utterance_id)
        for each, row in self._rows.items():
            restyle(row, current=each == utterance_id and self.hasFocus())
        if utterance_id in self._rows and self.hasFocus():
            self.row_chosen.emit(self._rows[utterance_id])

    # ---- keyboard

    def keyPressEvent(self, event: QKeyEvent) -> None:
        row = self._actions.pressed_in("queue", event)
        if row is None:
            super().keyPressEvent(event)
        elif not event.isAutoRepeat() or row.id != "queued_cancel":  # a held Delete must not empty the queue
            self._actions.run(row.id)

    def focusInEvent(self, event: QFocusEvent) -> None:
        super().focusInEvent(event)
        self._choose(self._chosen)
        self._actions.set_focused_part("queue")

    def focusOutEvent(self, event: QFocusEvent) -> None:
        super().focusOutEvent(event)
        self._choose(self._chosen)
        self._actions.set_focused_part("")


class _QueueRow(QFrame):
    """Row with number, text and buttons."""

    action_requested = Signal(str)
    written = Signal(str)
    given_up = Signal()
    pressed = Signal()

    def __init__(self, theme: Theme, key_text: str) -> None:
        super().__init__()
        self.setObjectName("queue_row")
        self._key_text = key_text
        self._key = KeyCap(key_text)
        self._template = ""
        self.setFixedHeight(ROW_PX)
        self._number = label("", "fine")
        self.label = ElidedLabel(role="fine")
        self._editor = SubmitLineEdit(objectName="queue_editor", accessibleName=tr("Replacement text"), maxLength=1000)
        self._editor.hide()
        self._editor.returnPressed.connect(self._on_return)
        row = layouts.hbox(self, self._number, margins_px=(5, 0, 1, 0), spacing_px=4)
        row.addSpacing(4)
        layouts.fill(row, (self.label, 1), (self._editor, 1), self._key)
        self._movers: list[ActionButton] = []
        for act, icon, tip in (
            ("queued_earlier", "arrow-up", tr("Move earlier")), ("queued_later", "arrow-down", tr("Move later")),
            ("queued_edit", "pencil-simple", tr("Edit the text")), ("queued_cancel", "x", tr("Remove from queue")),
        ):  # fmt: skip
            once = act == "queued_cancel"
            button = ActionButton(theme, icon=icon, role="ghost", height_px=26, once=once, objectName=act, toolTip=tip)
            button.setFocusPolicy(Qt.FocusPolicy.NoFocus)
            button.clicked.connect(lambda _checked=False, act=act: self.action_requested.emit(act))
            row.addWidget(button)
            if act in ("queued_earlier", "queued_later"):
                self._movers.append(button)

    @property
    def changed_text(self) -> str:
        """Edited text that was not submitted; empty if none."""
        text = " ".join(self._editor.text().split())
        return text if self._editor.isVisible() and text != self._template else ""

    def show_utterance(self, number: int, count: int, spoken: str, utterance: UtteranceChanged) -> None:
        self._number.setText(tr("Next") if count == 1 else tr("{number} of {count}").format(number=number, count=count))
        self._key.setVisible(number == 1 and bool(self._key_text))
        self.label.setText(f"“{spoken}”")
        # Template, to be filled again when it is spoken.
        self._template = utterance.text.replace(mark_of(utterance.person_id), "{name}")
        for button in self._movers:
            button.setVisible(count > 1)

    def begin_edit(self) -> None:
        self._editor.setText(self._template)
        self.label.hide()
        self._editor.show()
        self._editor.setFocus(Qt.FocusReason.OtherFocusReason)
        self._editor.selectAll()

    def end_edit(self) -> None:
        if self._editor.isVisible():
            had_focus = self._editor.hasFocus()
            self._editor.hide()
            self.label.show()
            if had_focus:
                self.given_up.emit()

    def _on_return(self) -> None:
        text = " ".join(self._editor.text().split())
        self.end_edit()
        if text != self._template:
            self.written.emit(text)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self.pressed.emit()
        event.ignore()

    def mouseDoubleClickEvent(self, _event: QMouseEvent) -> None:
        self.action_requested.emit("queued_edit")


_HINT = QT_TR_NOOP("Type what the robot says…")


class _Size(Value):
    """Size level of the panel. ``low``: phrase groups without a line of their own; ``tight``: no hints."""

    chip_px: int
    text_px: int
    gap_px: int
    queue_rows: int
    low: bool = False
    tight: bool = False


_SIZES = (
    _Size(40, tokens.BODY_PX + 1, 8, 4),
    _Size(32, tokens.BODY_PX, 6, 3),
    _Size(32, tokens.BODY_PX, 6, 3, low=True),
    _Size(32, tokens.BODY_PX, 6, 1, low=True),
    _Size(28, tokens.BODY_PX - 1, 5, 1, low=True, tight=True),
    _Size(26, tokens.BODY_PX - 1, 4, 1, low=True, tight=True),
)
_ROOMY_PX, _TIGHT_PX = 60, 18
"""Space for margins, gaps and hints."""
_IN_FIELD = (("↑", QT_TR_NOOP("earlier lines")), ("Tab", QT_TR_NOOP("complete")))
_IN_QUEUE = (
    ("⇧↑", QT_TR_NOOP("earlier")), ("⇧↓", QT_TR_NOOP("later")), ("Enter", QT_TR_NOOP("edit")),
    ("Delete", QT_TR_NOOP("remove")),
)  # fmt: skip
_CHANGE_NEXT, _BACK = QT_TR_NOOP("edit what is next"), QT_TR_NOOP("back to driving")
_TICK_MS = 200
_ENDS = (".", "!", "?", "…")
_PAUSE_MS = 250
"""Typing pause in ms after which an unfinished sentence is sent as a draft; a finished one is sent at once."""
_MANY = 12


def _scrolled(inside: QWidget) -> QScrollArea:
    """Wrap a widget in a scroll area, aligned to the top."""
    body = QWidget()
    layouts.vbox(body, inside, 1, margins_px=0, spacing_px=0)
    return list_area(body)


class SpeakPanel(Panel):
    """Speak panel. Enter says the line and clears the field; refused text stays."""

    title = QT_TR_NOOP("Speak")
    preferred_size, least_size = QSize(600, 220), QSize(270, 130)
    reads = ()

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("speak_panel")
        self._say_instead: Callable[[str], bool] | None = None
        self._last_typed = ""
        self._dictation_id = ""
        self._before_gap: QWidget | None = None
        self.field = SpeakField(
            self.theme, self._say, earlier=lambda: self.state.speech_history.value, sentences=self._sentences
        )
        self.field.setObjectName("speak_field")
        self.field.setPlaceholderText(tr(_HINT))
        self.field.textChanged.connect(self._on_text_changed)
        self._pause = QTimer(self, singleShot=True)
        self._pause.timeout.connect(self._report_draft)
        self._gap = PlaceholderPrompt(self.theme)
        self._gap.filled.connect(self._fill_gap)
        self._gap.given_up.connect(lambda: self._fill_gap(""))
        button = partial(ActionButton, self.theme, height_px=30)
        self._silence = button(tr("Silence"), icon="speaker-slash", may_lose_words=True, toolTip=tr("Silence"))
        self._silence.setObjectName("silence_button")
        self._silence.bind(self.table, "silence")
        self._talk: list[TalkButton] = []
        self._offer_talking()
        self._voice = button(icon="sliders-horizontal", objectName="voice_button", clicked=self._open_voice_menu)
        self._voice.set_quiet(True)
        self._voice.setAccessibleName(tr("Voice"))
        self._voice.setToolTip(tr("Who speaks, voice, speed and volume"))
        self._voice_menu = named(QMenu(self), "voice_menu")
        self._phrases = PhraseRows(self.theme, self.console, self.table)
        self._queue = QueueList(self.theme, self.console, self.table)
        self._queue.left_over.connect(self.field.bring)
        self._queue.emptied.connect(self.field.setFocus)
        phrases = _scrolled(self._phrases)
        queue = self._queue_area = _scrolled(self._queue)
        queue.setVisible(False)
        self._queue.row_chosen.connect(lambda row: queue.ensureWidgetVisible(row, 0, 0))
        self._hints = QWidget()
        self._hint_row = layouts.hbox(self._hints, margins_px=0, spacing_px=8)
        self._hinted: tuple[tuple[str, str], ...] = ()
        self._column = layouts.vbox(
            self, self.field, self._gap, (phrases, 1), queue, self._hints, margins_px=(14, 10, 14, 6), spacing_px=8
        )
        self.watch(self._on_speech_changed, self.state.speech.changed)
        self.watch(self._say_to_whom, self.state.selected_person.changed, self.state.persons.changed)
        self.watch(self._show_hints, self.table.keys_changed, self.table.availability_changed)
        self.state.event_happened.connect(self._on_event)
        self.state.hearing_of(WIZARD_MICROPHONE).changed.connect(self._on_wizard_heard)
        self.table.rows_changed.connect(self.fit)
        self.hold.escape_pressed.connect(self._on_escape)
        self.every(_TICK_MS, self._show_time_left)
        self._on_speech_changed(self.state.speech.value)
        self._show_hints()

    def _offer_talking(self) -> None:
        permitted = self.state.present.live and self.table.spec(TALK) is not None
        if permitted != bool(self._talk):
            self._talk = [TalkButton(self.theme, self.table, self.hold, self.state)] if permitted else []
            self.controls_changed.emit()

    def title_widgets(self) -> list[QWidget]:
        return [self._voice, *self._talk, self._silence] if self.state.present.live else [self._silence]

    def focus_target(self) -> QWidget:
        return self._gap.field if self._gap.isVisible() else self.field

    def focus_list(self) -> None:
        if self._queue.isVisible():
            focus_widget(self._queue)

    def save_state(self) -> str:
        return self.field.toPlainText()

    def restore_state(self, lasting: str) -> None:
        self.field.bring(lasting)

    def show_scenario(self) -> None:
        self._say_instead = None  # a suggestion of the former scenario becomes ordinary text
        self._offer_talking()
        self._phrases.show_scenario()
        super().show_scenario()

    def edit_first(self, text: str, say: Callable[[str], bool]) -> None:
        self.field.bring(text)
        self._say_instead = say
        focus_widget(self.field)

    def fit(self) -> None:
        """Choose the largest size level at which all phrases fit without scrolling."""
        for size in _SIZES:
            self._phrases.set_size(chip_px=size.chip_px, text_px=size.text_px, gap_px=size.gap_px, low=size.low)
            self.field.set_line_height(40 if size.tight else 48)
            self._column.setContentsMargins(14, 6 if size.tight else 10, 14, 2 if size.tight else 6)
            self._column.setSpacing(5 if size.tight else 8)
            self._hints.setVisible(not size.tight and self._hints.sizeHint().width() <= self.width() - 28)
            queue_px = ROW_PX * min(self._queue.count, size.queue_rows)
            rest_px = self.field.height() + queue_px + (_TIGHT_PX if size.tight else _ROOMY_PX)
            if self._phrases.height_for(self.width() - 36) <= self.height() - rest_px:
                break
        self._queue_area.setFixedHeight(queue_px)
        self._queue_area.setVisible(queue_px > 0)

    def _open_voice_menu(self) -> None:
        self._voice_menu.clear()
        for group in voice_choices(self.state.voice.value):
            many = len(group) > _MANY
            menu = self._voice_menu.addMenu(tr("All voices")) if many else self._voice_menu
            for choice in group:
                for where in (menu, self._voice_menu) if many and choice.chosen else (menu,):
                    action = where.addAction(
                        text_formatting.in_menu(choice.text), partial(self.console.do, choice.intent)
                    )
                    action.setCheckable(True)
                    action.setChecked(choice.chosen)
            self._voice_menu.addSeparator()
        self._voice_menu.popup(self._voice.mapToGlobal(QPoint(0, self._voice.height() + 4)))

    # ---- input

    def _say(self, text: str) -> bool:
        say, self._say_instead = self._say_instead, None
        if say is not None:
            if say(text):
                return True
            self._say_instead = say
            return False
        self._last_typed = text
        return not self.console.do(intents.Say(text, "dictated" if self.field.was_dictated else "typed"))

    def _on_wizard_heard(self, hearing: Hearing) -> None:
        """Insert dictation, which may continue after the key was released; speech sent to the robot as audio is not
        inserted.
        """
        if self.state.sound.value.talking == "dictation":
            self._dictation_id = hearing.utterance_id
        if hearing.utterance_id and hearing.utterance_id == self._dictation_id:
            self.field.dictate(hearing.utterance_id, hearing.committed, hearing.tentative)

    def _on_text_changed(self) -> None:
        if not self.field.toPlainText():
            self._say_instead = None  # the edited suggestion was deleted
            self._pause.stop()
        elif self.state.present.live:
            self._pause.start(0 if self.field.toPlainText().endswith(_ENDS) else _PAUSE_MS)

    def _report_draft(self) -> None:
        """Send a draft, so that synthesis finishes by the time Enter is pressed."""
        self.console.do(intents.DraftSpeech(self.field.toPlainText()))

    def _sentences(self) -> Sequence[str]:
        """Candidates for completion: phrases of the selected group first, then all others."""
        scenario = self.console.scenario
        chosen = (phrase.say for phrase in phrases_on_keys(scenario, self.state.phrase_group.value))
        return [
            *chosen,
            *sentences(scenario.phrases),
            *scenario.every_filler,
            *reversed(self.state.speech_history.value),
        ]

    def _on_event(self, event: object) -> None:
        """Restore typed text whose utterance failed, if the field is empty."""
        match event:
            case UtteranceChanged(state="failed", origin="typed" | "dictated", actor=actor) if actor == WIZARD:
                if self.state.present.live and self._last_typed and not self.field.toPlainText():
                    self.field.bring(self._last_typed)
                self._last_typed = ""

    # ---- questions

    def _ask_for_gap(self, gap: OpenGap | None) -> None:
        if gap is None:
            if self._gap.isVisible():
                back = existing(self._before_gap) if self._gap.field.hasFocus() else None
                self._gap.hide()
                if back is not None:
                    focus_widget(back, Qt.FocusReason.OtherFocusReason)
            return
        if not self._gap.isVisible():
            self._before_gap = focused_widget()
        self._gap.ask(gap)
        # Keep the focus on driving while a bare drive key is held.
        if not (self.hold.held and self.table.driving_focus):
            focus_widget(self._gap.field)

    def _fill_gap(self, value: str) -> None:
        gap: OpenGap | None = self.state.speech.value.gap
        self.console.do(intents.FillGap(value))
        if not value and gap is not None and gap.text == self._last_typed and not self.field.toPlainText():
            self.field.bring(gap.text)

    def _on_escape(self) -> None:
        self._queue.give_up_edit()
        if self._gap.isVisible():
            self._fill_gap("")

    # ---- display

    def update_view(self) -> None:
        self._on_speech_changed(self.state.speech.value)
        self._say_to_whom()
        self._show_hints()

    def _say_to_whom(self, _value: object = None) -> None:
        """Name the selected person in the placeholder: the utterance is added to their history."""
        selected = self.state.selected_person.value
        naming = self.console.scenario.permissions.naming_people
        persons = as_permitted(self.state.persons.value, naming=naming)
        name = next((text_formatting.person_name(row) for row in persons if row.person_id == selected), "")
        to_name = tr("Type what the robot says to {name}…").format(name=name)
        self.field.setPlaceholderText(to_name if name else tr(_HINT))

    def _on_speech_changed(self, speech: SpeechStatus) -> None:
        self._ask_for_gap(speech.gap)
        self._show_time_left()
        self._queue.show_waiting(speech.waiting)
        self.fit()

    def _show_time_left(self) -> None:
        speech: SpeechStatus = self.state.speech.value
        if speech.now is not None:
            utterance = text_formatting.with_names(speech.now.text, lambda person_id: name_of(self.console, person_id))
            self.set_fact(self._saying(text_formatting.shortened(utterance, 48), speech), "blue")
        elif not speech.ready and self.state.present.live:
            self.set_fact(tr(speech.detail) or tr("the voice is starting"), "amber" if speech.detail else "dim")
        else:
            self.set_fact(tr("quiet"))

    def _saying(self, utterance: str, speech: SpeechStatus) -> str:
        left_s = 0.0 if speech.ends_ns is None else (speech.ends_ns - self.state.present.now_ns()) / 1e9
        if left_s <= 0:
            return tr("now saying “{said}”").format(said=utterance)
        return tr("now saying “{said}” {left:.1f} s left").format(said=utterance, left=left_s)

    def _show_hints(self) -> None:
        hints: tuple[tuple[str, str], ...]
        if self.table.available("queued_edit"):
            hints = _IN_QUEUE
        elif self.table.available("focus_queue"):
            hints = (*_IN_FIELD, (self.table.key_text("focus_queue"), _CHANGE_NEXT))
        else:
            hints = _IN_FIELD
        if self.table.spec("focus_driving") is not None:
            hints = (*hints, (self.table.key_text("focus_driving"), _BACK))
        if hints != self._hinted:
            self._hinted = hints
            while (item := self._hint_row.takeAt(0)) is not None:
                if (widget := item.widget()) is not None:
                    widget.deleteLater()
            for cap, text in hints:
                layouts.fill(self._hint_row, KeyCap(cap), label(tr(text), "fine"))
                self._hint_row.addSpacing(8)
            self._hint_row.addStretch(1)


_QUESTIONS = {NAME: QT_TR_NOOP("Which name?"), PLACE: QT_TR_NOOP("Which place?")}


class PlaceholderPrompt(QWidget):
    """Placeholder prompt: asks in place for a template value before an utterance.

    Input field; Enter submits the value, Esc cancels.
    """

    filled = Signal(str)
    given_up = Signal()

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self.setObjectName("gap_row")
        self._question = label("", "title", tone="amber")
        self.field = SubmitLineEdit(objectName="gap_field", maxLength=200, minimumWidth=90)
        self.field.returnPressed.connect(self._on_return)
        self._say = ActionButton(theme, tr("Say it"), key="Enter", height_px=30, text_px=tokens.BODY_PX - 1)
        self._say.clicked.connect(self._on_return)
        self._leave = ActionButton(
            theme, tr("Cancel"), key="Esc", height_px=30, text_px=tokens.BODY_PX - 1, role="ghost",
            objectName="gap_leave", toolTip=tr(text_formatting.ESC_CLOSES), clicked=self.given_up,
        )  # fmt: skip
        self._question.setSizePolicy(QSizePolicy.Policy.Maximum, QSizePolicy.Policy.Fixed)
        layouts.hbox(self, self._question, (self.field, 1), self._say, self._leave, margins_px=0, spacing_px=8)
        self.hide()

    def ask(self, gap: OpenGap) -> None:
        question = tr("What is {gap}?").format(gap=f"{{{gap.gap}}}")
        self._question.setText(tr(_QUESTIONS[gap.gap]) if gap.gap in _QUESTIONS else question)
        self.field.setPlaceholderText(tr("for “{text}”").format(text=text_formatting.shortened(gap.text, 60)))
        named = tr("{question} It is for “{text}”")
        self.field.setAccessibleName(named.format(question=self._question.text(), text=gap.text))
        self.field.clear()
        self.show()

    def _on_return(self) -> None:
        text = " ".join(self.field.text().split())
        if text:
            self.filled.emit(text)


_UNTITLED = QT_TR_NOOP("General")
_GESTURES = tuple(f"gesture_{number}" for number in range(1, MOST_GESTURES + 1))
_CHIPS = (*(f"phrase_{number}" for number in range(1, PHRASE_COUNT + 1)), "filler", *_GESTURES)
"""Rows of the action table with a button here, in order."""


class PhraseRows(QWidget):
    """Phrase buttons: groups, phrases of the selected group, and gestures."""

    def __init__(self, theme: Theme, console: WizardConsole, actions: Actions) -> None:
        super().__init__()
        self._theme = theme
        self._console = console
        self._actions = actions
        self._titles: list[ActionButton] = []
        tabs = self._tabs = QWidget()
        self._next_key = KeyCap()
        self._tabs_row = layouts.hbox(tabs, self._next_key, 1, margins_px=0, spacing_px=4)
        self._chips: dict[str, ActionButton] = {}
        self._next = ActionButton(theme, key_first=True, role="ghost", height_px=32, may_shrink=True)
        self._next.setObjectName("next_phrases")
        self._next.bind(actions, "next_phrases")
        self._flow = FlowRow(self._next, gap_px=6)
        self._keyless = label("", "warning", wraps=True)
        layouts.vbox(self, tabs, self._flow, self._keyless, margins_px=0, spacing_px=6)
        actions.rows_changed.connect(self._refresh)
        self.show_scenario()

    def show_scenario(self) -> None:
        """Show groups, phrases and gestures of the scenario, reusing buttons."""
        groups = phrase_groups(self._console.scenario.phrases)
        while len(self._titles) > len(groups):
            title = self._titles.pop()
            layouts.discard(title)
        for number in range(len(self._titles), len(groups)):
            self._titles.append(self._new_title(number))
        for title, group in zip(self._titles, groups, strict=True):
            title.set_label(group.title or tr(_UNTITLED))
        self._next_key.setText(self._actions.key_text("next_phrases"))
        self._next_key.setVisible(bool(self._next_key.text()))
        there = {spec.id for spec in self._actions.all_specs}
        action_ids = [action_id for action_id in (*self._always_seen(), *_CHIPS) if action_id in there]
        for action_id in self._chips.keys() - set(action_ids):
            chip = self._chips.pop(action_id)
            self._flow.remove(chip)
            chip.deleteLater()
        for action_id in action_ids:
            if action_id not in self._chips:
                self._chips[action_id] = self._new_chip(action_id)
        self._flow.arrange([*(self._chips[action_id] for action_id in action_ids), self._next])
        self._report_keyless()
        self._refresh()

    def _always_seen(self) -> list[str]:
        """Phrases with a key of their own that a step of the protocol says, for example a hand-over, in every group."""
        steps = {step.say for step in self._console.scenario.protocol.steps}
        keyed = enumerate(keyed_phrases(self._console.scenario), start=1)
        return [f"keyed_phrase_{number}" for number, phrase in keyed if phrase.say in steps]

    def _new_title(self, number: int) -> ActionButton:
        title = ActionButton(self._theme, role="ghost", height_px=28, checkable=True)
        title.setObjectName(f"phrase_group_{number + 1}")
        title.clicked.connect(lambda: self._choose(number))
        self._tabs_row.insertWidget(number, title)
        title.show()
        return title

    def _new_chip(self, action_id: str) -> ActionButton:
        icon = "hand-waving" if action_id in _GESTURES else ""
        chip = ActionButton(
            self._theme, icon=icon, key_first=True, height_px=32, may_shrink=True, once=True, objectName=action_id
        )
        chip.bind(self._actions, action_id)
        self._flow.add(chip)
        return chip

    def set_size(self, *, chip_px: int, text_px: int, gap_px: int, low: bool) -> None:
        """Set button sizes; ``low``: instead of a line of groups, a button switches to the next group."""
        several = len(self._titles) > 1
        self._tabs.setVisible(several and not low)
        self._next.setVisible(several and low)
        self._flow.set_gap(gap_px)
        for chip in (*self._chips.values(), self._next):
            chip.set_size(height_px=chip_px, text_px=text_px)

    def height_for(self, width_px: int) -> int:
        """Total height at this width."""
        others = sum(30 + 6 for there in (self._tabs.isVisibleTo(self), bool(self._keyless.text())) if there)
        return self._flow.heightForWidth(width_px) + others

    def _choose(self, number: int) -> None:
        self._console.state.choose_phrases(number)
        self._refresh()

    def _refresh(self) -> None:
        chosen = self._console.state.phrase_group.value
        for number, title in enumerate(self._titles):
            title.setChecked(number == chosen)
        if self._titles:
            self._next.set_label(f"{self._titles[(chosen + 1) % len(self._titles)].text()} …")
        for action_id, chip in self._chips.items():
            spec = self._actions.spec(action_id)
            label = "" if spec is None else spec.text
            if spec is not None and spec.intent is perform_nth_gesture:
                # The keys may still belong to the former scenario, which had more gestures.
                titles = [gesture.title for gesture in self._console.scenario.gestures]
                spec, label = (spec, titles[spec.argument - 1]) if spec.argument <= len(titles) else (None, "")
            if spec is not None and spec.intent is say_keyed_phrase:
                on_keys = phrases_on_keys(self._console.scenario, chosen)
                spec = None if spec.argument in on_keys[:PHRASE_COUNT] else spec
            chip.setVisible(spec is not None)
            if spec is not None:
                chip.set_label(label, name=spec.text, tip=spec.text)
                chip.set_key(self._actions.key_text(action_id), self._actions.key_texts(action_id))
        self._flow.updateGeometry()

    def _report_keyless(self) -> None:
        """List phrases and gestures whose key is taken by another command."""
        scenario, clashing = self._console.scenario, [spec for spec, _other in self._actions.settled.clashes]
        lost = {spec.argument for spec in clashing}
        phrase_without = tr("{key} already has another function: “{phrase}” has no key.")
        gesture_without = tr("{key} already has another function: the gesture “{gesture}” has no key.")
        sentences = [
            phrase_without.format(key=cap_text(phrase.key), phrase=phrase.say)
            for phrase in keyed_phrases(scenario)
            if phrase in lost
        ]
        for spec in clashing:
            if spec.intent is perform_nth_gesture and spec.argument <= len(scenario.gestures):
                gesture = scenario.gestures[spec.argument - 1]
                sentences.append(gesture_without.format(key=cap_text(gesture.key), gesture=gesture.title))
        self._keyless.setText(" ".join(sentences))
        self._keyless.setVisible(bool(sentences))


TALK = "push_to_talk"
"""Row of the action table that the button requires."""


class TalkButton(ActionButton):
    """Push-to-talk button, held while the wizard speaks through the robot.

    Blue while the participant hears the wizard, amber until then.
    """

    def __init__(self, theme: Theme, actions: Actions, hold: DriveInputFilter, state: LiveState) -> None:
        super().__init__(theme, tr("Talk"), icon="microphone", height_px=30, may_lose_words=True)
        self.setObjectName("talk_button")
        self.setToolTip(tr("Hold and speak: the robot plays your own voice"))
        self._actions = actions
        self._hold = hold
        self._state = state
        self.pressed.connect(lambda: hold.mark_pressed.emit(TALK))
        self.released.connect(lambda: hold.mark_released.emit(TALK))
        actions.keys_changed.connect(self._show_key)
        for value in (state.sound, state.wizard_microphone):
            value.changed.connect(self._show)
        self._show_key()
        self._show()

    def _show_key(self) -> None:
        self.set_key(self._actions.key_text(TALK), self._actions.key_texts(TALK))

    def _show(self, _value: object = None) -> None:
        sound: SoundStatus = self._state.sound.value
        microphone: MicrophoneStatus = self._state.wizard_microphone.value
        talks = sound.talking == "robot"
        self.set_label(tr("Talk"), role="plain" if not talks else "primary" if microphone.state == "on" else "amber")

    def hideEvent(self, event: QHideEvent) -> None:
        if self.isDown():  # on shutdown a button that is not held may be hidden after the key handler was destroyed
            self._hold.mark_released.emit(TALK)
        super().hideEvent(event)
