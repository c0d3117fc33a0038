"""Assistant panel: ask the language model, read streamed answers, and say them or not."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, Literal

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QAccessible, QKeyEvent, QMouseEvent, QResizeEvent
from PySide6.QtWidgets import (
    QBoxLayout,
    QFrame,
    QLineEdit,
    QPlainTextEdit,
    QScrollArea,
    QStackedLayout,
    QWidget,
)

from caris_desktop.conversation.prompts import MAX_QUESTION_CHARACTERS, characters_too_long
from caris_desktop.domain import intents
from caris_desktop.domain.intents import CAMERA_PICTURE, Intent
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import AssistantSetup, AssistantStatus, ExchangeStatus
from caris_desktop.scenario.scenario_model import PanelSettings
from caris_desktop.ui import layouts, text_formatting
from caris_desktop.ui.focus_widget import application, focused_widget
from caris_desktop.ui.panel import Panel, PanelContext, show_part
from caris_desktop.ui.prompt_context_chips import PromptContextChips, choose_model_file, picture_words
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import FlowRow
from caris_desktop.ui.widgets.inputs import DropDown, SubmitTextEdit
from caris_desktop.ui.widgets.labels import ElidedLabel, label, named, restyle
from caris_desktop.ui.widgets.rows import show_rows

_MOST_TYPED = 32_000
_ROOMY_PX = 380
"""Panel height from which the prompt context is always visible; below it, only while a question is written."""
_LOW_PX = 210
_HINT_SIDES_PX = 10
_ADD = "add"
"""Entry of the list of models that is none."""
_NO_EXCHANGE = ExchangeStatus("", "", "cancelled")
_STEPS: dict[int, int] = {Qt.Key.Key_Up: -1, Qt.Key.Key_Down: 1}


class AssistantPanel(Panel):
    """Assistant panel. No model output is spoken without the wizard's command."""

    title = QT_TR_NOOP("Assistant")
    preferred_size, least_size = QSize(420, 240), QSize(260, 136)
    reads = ()

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("assistant_panel")
        self._exchange = _NO_EXCHANGE
        self._chosen = ""
        self._editing = False
        self._too_long = 0
        self._offered: list[ActionButton] = []
        # A pasted text is not truncated: excess length is reported instead.
        self.field = named(_QuestionField(maxLength=_MOST_TYPED), "assistant_field", tr("Question to the assistant"))
        self.field.stepped.connect(self._step)
        self.field.hints = (tr("Ask the assistant…"), tr("Ask…"))
        self.field.setMinimumHeight(40)
        self.field.returnPressed.connect(self._on_ask)
        self.field.textChanged.connect(self._on_question_changed)
        self._ask = ActionButton(self.theme, tr("Ask"), key="Enter", height_px=40, objectName="assistant_ask")
        self._ask.clicked.connect(self._on_ask)
        self.setup_bar = SetupBar(self.theme, self.state, self.console.do)
        self.setup_bar.template_chosen.connect(self._on_template)
        self.along = PromptContextChips(self.theme)
        self.setup_bar.picture_chosen.connect(self.along.add_picture)
        self.setup_bar.words_requested.connect(self._open_words)
        self.setup_button = ActionButton(
            self.theme, "", icon="sliders-horizontal", role="ghost", height_px=30, objectName="assistant_with_what",
            checkable=True, accessibleName=tr("Question options"),
            toolTip=tr("Model, role, style, prepared questions, pictures"),
        )  # fmt: skip
        self.setup_button.toggled.connect(lambda _on: self._show_parts())
        self._rows = ExchangeRows(self.theme)
        self._rows.chosen.connect(self._choose)
        self._rows.stepped.connect(self._step)
        self._rows.say_requested.connect(self._on_say_row)
        self._rows.edit_requested.connect(self._on_edit_row)
        self._rows.away_requested.connect(self._on_away)
        self._question = label("", "note", wraps=True, objectName="assistant_question")
        self._answer = named(_AnswerField(), "assistant_answer", tr("The assistant's answer"))
        self._answer.entered.connect(self._on_say)
        self._answer.setReadOnly(True)
        self._answer.setTabChangesFocus(True)
        self._answer.setMinimumHeight(30)
        self._note = label("", "small", wraps=True, objectName="assistant_note")
        button = partial(ActionButton, self.theme, may_shrink=True, once=True)
        self._say = ActionButton(
            self.theme, tr("Say it"), icon="speaker-high", role="primary", once=True, objectName="assistant_say",
            clicked=self._on_say,
        )  # fmt: skip
        self._edit = button(tr("Edit first"), icon="pencil-simple", objectName="assistant_edit", clicked=self._on_edit)
        self._again = button(tr("Ask again"), icon="arrow-clockwise", objectName="assistant_again")
        self._again.clicked.connect(self._on_again)
        self._dismiss = button(tr("Dismiss"), objectName="assistant_dismiss")
        self._dismiss.clicked.connect(lambda: self._on_away(self._exchange.exchange_id))
        self._cancel = button(tr("Cancel"), icon="x", objectName="assistant_cancel")
        self._cancel.clicked.connect(lambda: self.console.do(intents.CancelAnswer(self._exchange.exchange_id)))
        self._arrange()
        self.watch(self._on_assistant_changed, self.state.assistant.changed)
        self.watch(self._on_setup_changed, self.state.assistant_setup.changed)
        self.watch(self._show_parts, application().focusChanged)
        self.update_view()

    def _arrange(self) -> None:
        top = layouts.hbox(None, (self.field, 1), self._ask, spacing_px=8)
        buttons = (self._say, self._edit, self._again, self._cancel, self._dismiss)
        self._buttons: QBoxLayout = layouts.hbox(None, *buttons, 1, spacing_px=8)
        self._middle: QBoxLayout = layouts.vbox(None, (self._answer, 1), self._buttons, spacing_px=8)
        self._main = QWidget()
        layouts.vbox(
            self._main, top, self.setup_bar, self.along, self._rows, self._question, (self._middle, 1), self._note,
            margins_px=0, spacing_px=8,
        )  # fmt: skip
        self._words = SystemPromptPage(self.theme, self.console.do)
        self._words.closed.connect(self._close_words)
        self._pages = QStackedLayout()
        self._frame = layouts.vbox(self, self._pages, margins_px=(14, 12, 14, 12))
        self._pages.addWidget(self._main)
        self._pages.addWidget(self._words)

    def focus_target(self) -> QWidget:
        return self.field

    def title_widgets(self) -> list[QWidget]:
        return [self.setup_button]

    def show_scenario(self) -> None:
        self._chosen = ""
        self._stop_editing()
        self.setup_button.setChecked(False)
        # Edited prompts belong to the former scenario and must not leak into this one.
        self._words.forget()
        self._pages.setCurrentWidget(self._main)
        super().show_scenario()

    def use_settings(self, settings: PanelSettings) -> None:
        self.along.restore(settings.assistant.left_out, self.along.pictures)

    def save_state(self) -> Any:
        return self.field.text(), self.along.left_out, self.along.pictures

    def restore_state(self, lasting: Any) -> None:
        text, left_out, pictures = lasting
        self.field.setText(text)
        self.along.restore(left_out, pictures)

    def fit(self) -> None:
        # In a low panel the buttons are next to the answer, which must be read before it is said.
        low = self.height() < _LOW_PX
        self._middle.setDirection(QBoxLayout.Direction.LeftToRight if low else QBoxLayout.Direction.TopToBottom)
        self._buttons.setDirection(QBoxLayout.Direction.TopToBottom if low else QBoxLayout.Direction.LeftToRight)
        self._frame.setContentsMargins(14, 8 if low else 12, 14, 8 if low else 12)
        self._show_parts()

    # Question

    def _asked(self) -> str:
        return " ".join(self.field.text().split())

    def _on_question_changed(self, _text: str) -> None:
        too_long = characters_too_long(self._asked())
        if too_long or self._too_long:
            self._too_long = too_long
            self._on_assistant_changed(self.state.assistant.value)
        self._show_parts()

    def _on_template(self, text: str) -> None:
        last_utterance = next(
            (turn.text for turn in reversed(self.state.transcript.value) if turn.speaker == "participant"), ""
        )
        self.field.setText(text.replace("{said}", f"“{last_utterance}”" if last_utterance else "…"))
        self.field.setFocus(Qt.FocusReason.OtherFocusReason)

    def _on_ask(self) -> None:
        question = self._asked()
        if not question or self._too_long:
            return
        # A refused question stays in the field, with its pictures.
        if not self.console.do(intents.Ask(question, self.along.left_out, self.along.pictures)):
            self._chosen = ""
            self._stop_editing()
            self.field.clear()
            self.setup_button.setChecked(False)
            self.along.forget_pictures()
            self.update_view()

    def _show_parts(self) -> None:
        """Show the widgets that fit: while a question is written, its context takes precedence over the last answer."""
        focus = focused_widget()
        beside = focus is not None and (self.setup_bar.isAncestorOf(focus) or self.along.isAncestorOf(focus))
        live, height = self._live, self.height()
        writing = live and not self._editing and (bool(self.field.text()) or beside)
        roomy = height >= _ROOMY_PX
        setup_open = live and self.setup_button.isChecked()
        self.setup_bar.setVisible(setup_open or (live and (roomy or (writing and height >= _LOW_PX - 50))))
        self.along.setVisible(live and (roomy or writing) and bool(self.along.chips))
        read = roomy or not (writing or setup_open)
        self._answer.setVisible(read)
        for button in self._offered:
            # Without room for the button, the Delete key and the row's close button do the same.
            button.setVisible(read and (button is not self._dismiss or height >= _LOW_PX))
        several = len(self.state.assistant.value.exchanges) > 1
        self._rows.setVisible(several and read and height >= _LOW_PX - 40)
        lines = min(len(self.state.assistant.value.exchanges), 3 if roomy else 2)
        self._rows.setMaximumHeight(lines * (EXCHANGE_ROW_PX + 2) + 2)
        self._question.setVisible(bool(self._question.text()) and height >= 196 and read and not several)

    @property
    def _live(self) -> bool:
        # A replay, whose table has no marks either, neither asks nor speaks.
        return self.table.spec("mark") is not None

    # Answers

    def _choose(self, exchange_id: str) -> None:
        if exchange_id != self._exchange.exchange_id:
            self._chosen = exchange_id
            self._stop_editing()
            self.update_view()

    def _step(self, by: int) -> None:
        """Select the previous or next question."""
        ids = [each.exchange_id for each in self.state.assistant.value.exchanges]
        if self._exchange.exchange_id in ids:
            at = ids.index(self._exchange.exchange_id) + by
            if 0 <= at < len(ids):
                self._choose(ids[at])

    def _on_say(self) -> None:
        text = self._answer.toPlainText().strip()
        if text:
            exchange_id = self._exchange.exchange_id
            self._stop_editing()
            self.console.do(intents.SayAnswer(text, exchange_id))

    def _on_say_row(self, exchange_id: str) -> None:
        self._choose(exchange_id)
        if self._say.isEnabled():
            self._on_say()

    def _on_edit_row(self, exchange_id: str) -> None:
        self._choose(exchange_id)
        if self._edit.isEnabled():
            self._on_edit()

    def _on_edit(self) -> None:
        self._editing = True
        self._chosen = self._exchange.exchange_id  # a new answer must not replace the edited one
        self._answer.setReadOnly(False)
        self._restyle_answer()
        self._answer.setFocus(Qt.FocusReason.OtherFocusReason)
        self._answer.moveCursor(self._answer.textCursor().MoveOperation.End)
        self._on_assistant_changed(self.state.assistant.value)

    def _on_again(self) -> None:
        """Put the question back into the field for editing or asking again."""
        self.field.setText(self._exchange.question)
        self.field.setFocus(Qt.FocusReason.OtherFocusReason)

    def _on_away(self, exchange_id: str) -> None:
        if exchange_id:
            self.console.do(intents.DismissAnswer(exchange_id))

    def _stop_editing(self) -> None:
        if self._editing:
            self._editing = False
            self._answer.setReadOnly(True)
            self._restyle_answer()

    def _restyle_answer(self) -> None:
        self._say.set_key("Enter" if self._editing else "")
        # The style sheet selects by readOnly.
        self._answer.style().unpolish(self._answer)
        self._answer.style().polish(self._answer)

    # Prompts

    def _open_words(self) -> None:
        self._words.show_setup(self.state.assistant_setup.value)
        self._pages.setCurrentWidget(self._words)
        self._words.field.setFocus(Qt.FocusReason.OtherFocusReason)

    def _close_words(self) -> None:
        self._pages.setCurrentWidget(self._main)
        self.field.setFocus(Qt.FocusReason.OtherFocusReason)

    def _on_setup_changed(self, setup: AssistantSetup) -> None:
        if not setup.pictures:
            self.along.forget_pictures()
        self.along.show_parts(setup.parts)
        self.setup_bar.show_setup(setup, live=self._live)
        self._words.show_setup(setup)
        self._show_parts()

    # Display

    def update_view(self) -> None:
        self._on_setup_changed(self.state.assistant_setup.value)
        self._on_assistant_changed(self.state.assistant.value)

    def _on_assistant_changed(self, status: AssistantStatus) -> None:
        exchanges = status.exchanges or _the_one_of(status)
        chosen = next((each for each in exchanges if each.exchange_id == self._chosen), None)
        exchange = chosen or (exchanges[0] if exchanges else _NO_EXCHANGE)
        if exchange.exchange_id != self._exchange.exchange_id:
            self._stop_editing()
        if not self._editing and self._answer.toPlainText() != exchange.answer:
            previous = self._answer.toPlainText()
            if exchange.answer.startswith(previous) and previous:
                cursor = self._answer.textCursor()
                cursor.movePosition(cursor.MoveOperation.End)
                cursor.insertText(exchange.answer[len(previous) :])
            else:
                self._answer.setPlainText(exchange.answer)
            bar = self._answer.verticalScrollBar()
            bar.setValue(bar.maximum())
        if self._exchange.is_pending and not exchange.is_pending:
            # Scroll a completed answer to its beginning.
            self._answer.verticalScrollBar().setValue(0)
        self._exchange = exchange
        live, speaks = self._live, bool(self.console.scenario.permissions.speech)
        self._rows.show_rows(exchanges, exchange.exchange_id, live=live, speaks=speaks)
        has_answer = bool(exchange.answer.strip()) and not exchange.is_pending
        question = text_formatting.shortened(exchange.question, 140)
        self._question.setText(tr("You asked: {question}").format(question=question) if question else "")
        waits = self.state.present.live and speaks
        self._answer.setPlaceholderText(tr("Answers wait here until you say them.") if waits else "")
        self.field.setReadOnly(not live)
        show_part(self.setup_button, live)
        self._cancel.setEnabled(live)
        self._say.setEnabled(has_answer and live and speaks)
        self._edit.setEnabled(has_answer and not self._editing and live and speaks)
        self._dismiss.setEnabled(live)
        self._again.setEnabled(live)
        # The model for practice often just continues the question, and an answer that was cut off needs an end.
        read_first = bool(exchange.detail) or self.state.assistant_setup.value.model == "embedded"
        self._say.set_label(self._say.text(), role="plain" if read_first else "primary")
        self._edit.set_label(self._edit.text(), role="primary" if read_first else "plain")
        again = exchange.state in ("failed", "cancelled") and bool(exchange.question) and not has_answer
        offered = {
            self._say: speaks and not exchange.is_pending and not again,
            self._edit: speaks and not exchange.is_pending and not again,
            self._again: again,
            self._cancel: exchange.is_pending,
            self._dismiss: bool(exchange.exchange_id) and not exchange.is_pending,
        }
        self._offered = [button for button, is_offered in offered.items() if is_offered]
        for button in offered:
            if button not in self._offered:
                button.hide()
        self._ask.setEnabled(live and not self._too_long and status.state in ("ready", "answering", "failed"))
        self._show_note(status, exchange)
        self._show_fact(status)
        self._show_parts()

    def _show_fact(self, status: AssistantStatus) -> None:
        under_way = sum(exchange.is_pending for exchange in status.exchanges)
        match status.state:
            case "ready":
                self.set_fact(status.model or tr("ready"))
            case "answering":
                text = tr("{model} is writing").format(model=status.model)
                if under_way > 1:
                    text = tr("%n answers are being written", "", under_way)
                self.set_fact(text, "blue")
            case "starting":
                self.set_fact(tr("getting ready"))
            case "failed":
                self.set_fact(tr("no answer"), "amber")
            case _:
                self.set_fact(tr("off"))

    def _show_note(self, status: AssistantStatus, exchange: ExchangeStatus) -> None:
        role = "dim"
        if self._too_long:
            text = tr("The question is {over:,} characters too long. Shorten it to at most {most:,} characters.")
            text, role = text.format(over=self._too_long, most=MAX_QUESTION_CHARACTERS), "amber"
        elif exchange.state == "failed" and exchange.exchange_id:
            text, role = tr(exchange.detail) or tr("The assistant gave no answer. Ask again."), "amber"
        elif status.state == "failed" and not exchange.answer:
            text, role = tr(status.detail) or tr("The assistant gave no answer. Ask again."), "amber"
        elif status.state == "starting":
            text = tr("The language model is starting. Phrases and typing work meanwhile.")
        elif status.state == "off":
            text = tr(status.detail) or tr("No language model is set up.")
        elif exchange.state == "preparing":
            text = tr("Reading the pictures…")
        elif exchange.is_pending and not exchange.answer:
            text = tr(exchange.detail) or tr("Thinking…")
        elif self._editing:
            text = tr("Edit the text. Enter says it.")
        elif exchange.use:
            text = tr("Said.") if exchange.use == "said" else tr("Said with your changes.")
        else:
            # A truncated answer is marked as such.
            text, role = tr(exchange.detail), "amber" if exchange.state == "answered" else "dim"
        self._note.setText(text)
        self._note.setVisible(bool(text))
        restyle(self._note, tone=role)


def _the_one_of(status: AssistantStatus) -> tuple[ExchangeStatus, ...]:
    """Exchanges from older recordings, which hold a single question."""
    if not (status.exchange_id or status.question or status.answer):
        return ()
    state: Literal["answering", "answered", "failed"] = "answered"
    if status.state in ("answering", "failed"):
        state = status.state
    return (ExchangeStatus(status.exchange_id, status.question, state, status.model, status.answer, status.detail),)


class _QuestionField(QLineEdit):
    """Question field: arrow keys step through earlier questions. Shows the first of ``hints`` that fits."""

    stepped = Signal(int)
    hints: tuple[str, ...] = ("",)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        room_px = self.contentsRect().width() - _HINT_SIDES_PX
        wide = self.fontMetrics().horizontalAdvance
        self.setPlaceholderText(next((hint for hint in self.hints if wide(hint) <= room_px), self.hints[-1]))

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in _STEPS and not event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier:
            self.stepped.emit(_STEPS[event.key()])
            event.accept()
        else:
            super().keyPressEvent(event)


class _AnswerField(SubmitTextEdit):
    """Answer field. While editing, Enter says the answer and Shift+Enter inserts a line break."""

    def means_enter(self, event: QKeyEvent) -> bool:
        begins_line = event.modifiers() & Qt.KeyboardModifier.ShiftModifier
        return not (self.isReadOnly() or begins_line) and super().means_enter(event)


EXCHANGE_ROW_PX = 30
_STATE_PX = 108
_WORDS = {
    "preparing": QT_TR_NOOP("Reading pictures"), "answering": QT_TR_NOOP("Writing"), "answered": QT_TR_NOOP("Answered"),
    "cancelled": QT_TR_NOOP("Cancelled"),
    "failed": QT_TR_NOOP("No answer"),
}  # fmt: skip
_USED = {"said": QT_TR_NOOP("Said"), "edited": QT_TR_NOOP("Said, edited")}


class ExchangeRows(QScrollArea):
    """List of pending and answered questions, one line each; the selected one is shown below.

    Arrow keys select a row, Enter says its answer, Shift+Enter edits it first, Delete dismisses it.
    """

    accessible_role = QAccessible.Role.List

    chosen = Signal(str)
    stepped = Signal(int)
    say_requested = Signal(str)
    edit_requested = Signal(str)
    away_requested = Signal(str)

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self._rows: dict[str, _Row] = {}
        self._current = ""
        named(self, "assistant_rows", tr("Questions to the assistant"))
        self.setWidgetResizable(True)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        inner = QWidget()
        self._column = layouts.vbox(inner, 1, margins_px=0, spacing_px=2)
        self.setWidget(inner)

    def sizeHint(self) -> QSize:
        return QSize(200, len(self._rows) * (EXCHANGE_ROW_PX + 2))

    def minimumSizeHint(self) -> QSize:
        return QSize(100, min(len(self._rows), 2) * (EXCHANGE_ROW_PX + 2))

    def show_rows(self, exchanges: Sequence[ExchangeStatus], current: str, *, live: bool, speaks: bool = True) -> None:
        """Show the exchanges, newest first. ``live``: they can be used; ``speaks``: answers can be said."""
        count = len(self._rows)
        self._current = current
        show_rows(self._column, self._rows, [exchange.exchange_id for exchange in exchanges], self._new_row)
        for exchange in exchanges:
            row = self._rows[exchange.exchange_id]
            row.show_exchange(exchange, current=exchange.exchange_id == current, live=live, speaks=speaks)
        if len(self._rows) != count:
            self.updateGeometry()

    def _new_row(self, exchange_id: str) -> "_Row":
        row = _Row(self._theme)
        row.pressed.connect(lambda: self.chosen.emit(exchange_id))
        row.say.clicked.connect(lambda: self.say_requested.emit(exchange_id))
        row.away.clicked.connect(lambda: self.away_requested.emit(exchange_id))
        return row

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in _STEPS and self._current in self._rows:
            self.stepped.emit(_STEPS[event.key()])
            self.ensureWidgetVisible(self._rows[self._current])
        elif event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter) and not event.isAutoRepeat():
            edited = event.modifiers() & Qt.KeyboardModifier.ShiftModifier
            (self.edit_requested if edited else self.say_requested).emit(self._current)
        elif event.key() == Qt.Key.Key_Delete and not event.isAutoRepeat():
            self.away_requested.emit(self._current)
        else:
            super().keyPressEvent(event)


class _Row(QFrame):
    """Row with state, question and two buttons."""

    pressed = Signal()

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self.setObjectName("exchange_row")
        self.setFixedHeight(EXCHANGE_ROW_PX)
        self._state = label("", "small")
        self._state.setFixedWidth(_STATE_PX)
        self._question = ElidedLabel(role="small")
        self.say = ActionButton(theme, "", icon="speaker-high", role="ghost", height_px=26, once=True)
        self.say.setObjectName("assistant_row_say")
        self.away = ActionButton(
            theme, "", icon="x", role="ghost", height_px=26, once=True, objectName="assistant_row_away"
        )
        layouts.hbox(self, self._state, (self._question, 1), self.say, self.away, margins_px=(7, 0, 1, 0), spacing_px=6)

    def show_exchange(self, exchange: ExchangeStatus, *, current: bool, live: bool, speaks: bool) -> None:
        role = {"answered": "green", "failed": "amber"}.get(exchange.state, "blue" if exchange.is_pending else "dim")
        self._state.setText(tr(_USED.get(exchange.use) or _WORDS[exchange.state]))
        restyle(self._state, tone="dim" if exchange.use else role)
        self._question.setText(exchange.question)
        restyle(self._question, tone="text" if current else "dim")
        self.say.setVisible(speaks)
        self.say.setEnabled(live and exchange.state == "answered" and bool(exchange.answer))
        self.say.setToolTip(tr("Say this answer"))
        self.say.setAccessibleName(tr("Say the answer to: {question}").format(question=exchange.question))
        self.away.setEnabled(live)
        self.away.setToolTip(tr("Cancel this question") if exchange.is_pending else tr("Dismiss this question"))
        away = tr("Cancel: {question}") if exchange.is_pending else tr("Dismiss: {question}")
        self.away.setAccessibleName(away.format(question=exchange.question))
        restyle(self, current=current)

    def mousePressEvent(self, event: QMouseEvent) -> None:
        self.pressed.emit()
        event.accept()


_PHOTOS_OFFERED = 8
_HEIGHT_PX = 28
_MODEL_WIDEST_PX, _WIDEST_PX = 280, 180


class SetupBar(FlowRow):
    """Setup of the next question: model, role, style, prepared question, picture.

    Drop-downs without a choice in this scenario are hidden.
    """

    template_chosen = Signal(str)
    picture_chosen = Signal(str)
    words_requested = Signal()

    def __init__(self, theme: Theme, state: LiveState, do: Callable[[Intent], str]) -> None:
        super().__init__(gap_px=6)
        self._state = state
        self._do = do
        self._setup: AssistantSetup | None = None
        self.model = DropDown(theme, "assistant_model", tr("Language model"))
        self.role = DropDown(theme, "assistant_role", tr("Assistant role"))
        self.style_choice = DropDown(theme, "assistant_style", tr("Answer style"))
        self.template = DropDown(theme, "assistant_template", tr("Prepared questions"))
        self.picture = DropDown(theme, "assistant_picture", tr("Add a picture"))
        self.words = ActionButton(theme, "", icon="note-pencil", height_px=_HEIGHT_PX, objectName="assistant_words")
        self.words.setToolTip(tr("Prompt for the model: view it or change it for this session"))
        self.words.setAccessibleName(tr("Prompt for the model"))
        self.words.clicked.connect(self.words_requested)
        for drop_down in (self.model, self.role, self.style_choice, self.template, self.picture):
            drop_down.setFixedHeight(_HEIGHT_PX)
            drop_down.show_whole(up_to_px=_MODEL_WIDEST_PX if drop_down is self.model else _WIDEST_PX)
            self.add(drop_down)
        self.add(self.words)
        self.model.activated.connect(self._on_model)
        style = self.style_choice
        self.role.activated.connect(lambda at: self._do(intents.ChoosePrompt("role", self.role.itemData(at))))
        style.activated.connect(lambda at: self._do(intents.ChoosePrompt("style", style.itemData(at))))
        self.template.activated.connect(partial(self._take, self.template, self.template_chosen.emit))
        self.picture.activated.connect(partial(self._take, self.picture, self.picture_chosen.emit))

    def show_setup(self, setup: AssistantSetup, *, live: bool) -> None:
        self._setup = setup
        models = text_formatting.models_offered(setup.models)
        self.model.fill([*models, (tr("Add a model file…"), _ADD)], setup.model)
        self.model.setVisible(bool(models))  # none are known before the models were looked for
        pictures = [f"{CAMERA_PICTURE}{camera}" for camera in self._state.cameras.value]
        pictures += [photo.file_name for photo in self._state.photos.value if not photo.deleted][:_PHOTOS_OFFERED]
        for drop_down, none, offered, chosen in (
            (self.role, tr("No role"), [(each.name, each.name) for each in setup.roles], setup.role),
            (self.style_choice, tr("Any style"), [(each.name, each.name) for each in setup.styles], setup.style),
            (self.template, tr("Prepared…"), [(each.name, each.text) for each in setup.templates], ""),
            (self.picture, tr("Picture…"), [(picture_words(name), name) for name in pictures], ""),
        ):
            drop_down.fill([(none, ""), *offered], chosen)
            drop_down.setVisible(setup.pictures if drop_down is self.picture else bool(offered))
        for part in (self.model, self.role, self.style_choice, self.template, self.picture):
            part.setToolTip(part.currentText())
            part.setEnabled(live)
        self.words.setEnabled(live)

    def _on_model(self, at: int) -> None:
        chosen = self.model.itemData(at)
        if chosen == _ADD:
            choose_model_file(self.window(), self._do)
        if self._setup is not None and (chosen == _ADD or self._do(intents.ChooseModel(chosen))):
            self.model.setCurrentIndex(self.model.findData(self._setup.model))

    def _take(self, drop_down: DropDown, take: Callable[[str], None], at: int) -> None:
        """Take the choice, and show the heading of the list again."""
        value = drop_down.itemData(at)
        drop_down.setCurrentIndex(0)
        if value:
            take(value)


_Kind = Literal["system_prompt", "notes", "role", "style"]
_BUTTON_PX = 30


class SystemPromptPage(QWidget):
    """System prompt page: the texts sent before a question, edited for this session or reset.

    One text at a time: instructions, notes, a role or a style. The scenario file is not changed.
    """

    closed = Signal()

    def __init__(self, theme: Theme, do: Callable[[Intent], str]) -> None:
        super().__init__()
        self._do = do
        self._texts: dict[tuple[_Kind, str], str] = {}
        self._selected: tuple[_Kind, str] = ("system_prompt", "")
        self.which = DropDown(theme, "assistant_which_words", tr("Prompt text"), activated=self._on_which)
        self.field = named(QPlainTextEdit(tabChangesFocus=True), "assistant_words_field", tr("Prompt for the model"))
        self.field.textChanged.connect(self._show_buttons)
        button = partial(ActionButton, theme, height_px=_BUTTON_PX)
        self.save = button(tr("Apply"), icon="check", role="primary", objectName="assistant_words_save")
        self.save.clicked.connect(self._save)
        self.reset = button(tr("Reset to scenario"), may_shrink=True, objectName="assistant_words_reset")
        self.reset.setToolTip(tr("Reset the model, role, style and all texts to those of the scenario"))
        self.reset.clicked.connect(self._on_reset)
        self.back = button(tr("Back"), icon="arrow-left", objectName="assistant_words_back", clicked=self.closed)
        top = layouts.hbox(None, self.back, (self.which, 1), spacing_px=6)
        bottom = layouts.hbox(None, self.save, self.reset, 1, spacing_px=6)
        layouts.vbox(self, top, (self.field, 1), bottom, margins_px=0, spacing_px=6)

    def forget(self) -> None:
        """Discard an edit; the next setup is shown from its beginning."""
        self.which.clear()
        self._texts = {}

    def show_setup(self, setup: AssistantSetup) -> None:
        """Show the setup; an unsaved edit stays in the field."""
        changed = self._changed
        roles, styles = tr("Role: {name}"), tr("Style: {name}")
        shown: list[tuple[str, _Kind, str, str]] = [
            (tr("Instructions"), "system_prompt", "", setup.system_prompt),
            (tr("Notes"), "notes", "", setup.notes),
            *((roles.format(name=each.name), "role", each.name, each.text) for each in setup.roles),
            *((styles.format(name=each.name), "style", each.name, each.text) for each in setup.styles),
        ]  # fmt: skip
        self._texts = {(kind, name): text.strip() for _title, kind, name, text in shown}
        titles = [title for title, *_ in shown]
        if [self.which.itemText(at) for at in range(self.which.count())] != titles:
            self.which.clear()
            self.which.addItems(titles)
            self._selected = ("system_prompt", "")
            changed = False
        if not changed:
            self._fill()
        self._show_buttons()
        self.reset.setEnabled(setup.edited)

    @property
    def _changed(self) -> bool:
        text = self._texts.get(self._selected)
        return text is not None and self.field.toPlainText().strip() != text

    def _fill(self) -> None:
        if self._changed:
            self.field.setPlainText(self._texts[self._selected])

    def _show_buttons(self) -> None:
        self.save.setEnabled(self._changed)

    def _on_which(self, at: int) -> None:
        keys = list(self._texts)
        if self._changed and not self._save():
            self.which.setCurrentIndex(keys.index(self._selected))
            return
        self._selected = keys[at]
        self._fill()
        self._show_buttons()

    def _save(self) -> bool:
        """Save the edit; False if refused, with the text left in the field."""
        kind, name = self._selected
        return not self._do(intents.EditPrompt(kind, self.field.toPlainText().strip(), name))

    def _on_reset(self) -> None:
        self.field.setPlainText(self._texts.get(self._selected, ""))
        self._do(intents.ResetPrompts())
