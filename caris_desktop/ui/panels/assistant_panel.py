"""Assistant panel: ask the language model, read streamed answers, and say them or not."""

from typing import Any, Literal

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QKeyEvent, QResizeEvent
from PySide6.QtWidgets import (
    QApplication,
    QBoxLayout,
    QLabel,
    QLineEdit,
    QStackedLayout,
    QWidget,
)

from caris_desktop.conversation.prompts import MAX_QUESTION_CHARACTERS, characters_too_long
from caris_desktop.domain import intents
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import AssistantSetup, AssistantStatus, ExchangeStatus
from caris_desktop.scenario.panel_settings import PanelSettings
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.assistant.exchange_rows import ROW_PX, ExchangeRows
from caris_desktop.ui.assistant.prompt_context_chips import PromptContextChips
from caris_desktop.ui.assistant.setup_bar import SetupBar
from caris_desktop.ui.assistant.system_prompt_page import SystemPromptPage
from caris_desktop.ui.focus_widget import focused_widget
from caris_desktop.ui.panel import Panel, PanelContext, show_part
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.submit_text_edit import SubmitTextEdit

_MOST_TYPED = 32_000
_ROOMY_PX = 380
"""Panel height from which the prompt context is always visible; below it, only while a question is written."""
_LOW_PX = 210
_HINT_SIDES_PX = 10
_NO_EXCHANGE = ExchangeStatus("", "", "cancelled")


class AssistantPanel(Panel):
    """Assistant panel. No model output is spoken without the wizard's command."""

    title = QT_TR_NOOP("Assistant")
    reads = ()

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("assistant_panel")
        self._shown = _NO_EXCHANGE
        self._chosen = ""
        self._editing = False
        self._too_long = 0
        self._offered: list[ActionButton] = []
        self.field = _QuestionField()
        self.field.stepped.connect(self._step)
        self.field.setObjectName("assistant_field")
        self.field.setAccessibleName(tr("Question to the assistant"))
        self.field.hints = (tr("Ask the assistant…"), tr("Ask…"))
        self.field.setMinimumHeight(40)
        # A pasted text is not truncated: excess length is reported instead.
        self.field.setMaxLength(_MOST_TYPED)
        self.field.returnPressed.connect(self._on_ask)
        self.field.textChanged.connect(self._on_question_changed)
        self._ask = ActionButton(self.theme, tr("Ask"), key="Enter", height_px=40)
        self._ask.setObjectName("assistant_ask")
        self._ask.clicked.connect(self._on_ask)
        self.setup_bar = SetupBar(self.theme, self.state, self.console.do)
        self.setup_bar.template_chosen.connect(self._on_template)
        self.along = PromptContextChips(self.theme)
        self.setup_bar.picture_chosen.connect(self.along.add_picture)
        self.setup_bar.words_wanted.connect(self._open_words)
        self.with_what = ActionButton(self.theme, "", icon="sliders-horizontal", look="ghost", height_px=30)
        self.with_what.setObjectName("assistant_with_what")
        self.with_what.setCheckable(True)
        self.with_what.setToolTip(tr("Model, role, style, prepared questions, pictures"))
        self.with_what.setAccessibleName(tr("Question options"))
        self.with_what.toggled.connect(lambda _on: self._show_parts())
        self._rows = ExchangeRows(self.theme)
        self._rows.chosen.connect(self._choose)
        self._rows.say_wanted.connect(self._on_say_row)
        self._rows.edit_wanted.connect(self._on_edit_row)
        self._rows.away_wanted.connect(self._on_away)
        self._question = QLabel(wordWrap=True, textFormat=Qt.TextFormat.PlainText)
        self._question.setObjectName("assistant_question")
        self._answer = _AnswerField()
        self._answer.entered.connect(self._on_say)
        self._answer.setObjectName("assistant_answer")
        self._answer.setAccessibleName(tr("The assistant's answer"))
        self._answer.setReadOnly(True)
        self._answer.setTabChangesFocus(True)
        self._answer.setMinimumHeight(30)
        self._note = QLabel(wordWrap=True)
        self._note.setObjectName("assistant_note")
        self._say = self._button(tr("Say it"), "assistant_say", self._on_say, icon="speaker-high", primary=True)
        self._edit = self._button(tr("Edit first"), "assistant_edit", self._on_edit, icon="pencil-simple")
        self._again = self._button(tr("Ask again"), "assistant_again", self._on_again, icon="arrow-clockwise")
        self._dismiss = self._button(tr("Dismiss"), "assistant_dismiss", lambda: self._on_away(self._shown.exchange_id))
        self._cancel = self._button(
            tr("Cancel"),
            "assistant_cancel",
            lambda: self.console.do(intents.CancelAnswer(self._shown.exchange_id)),
            icon="x",
        )
        self._arrange()
        self.state.assistant.changed.connect(self._on_assistant_changed)
        self.state.assistant_setup.changed.connect(self._on_setup_changed)
        self.theme.changed.connect(self._style)
        app = QApplication.instance()
        if isinstance(app, QApplication):
            app.focusChanged.connect(self._on_focus_changed)
        self._style()

    def _button(self, text: str, name: str, act: Any, *, icon: str = "", primary: bool = False) -> ActionButton:
        button = ActionButton(
            self.theme, text, icon=icon, look="primary" if primary else "plain", may_shrink=not primary
        )
        button.setObjectName(name)
        button.clicked.connect(act)
        return button

    def _arrange(self) -> None:
        top = layouts.hbox(spacing_px=8)
        top.addWidget(self.field, 1)
        top.addWidget(self._ask)
        self._buttons = QBoxLayout(QBoxLayout.Direction.LeftToRight)
        self._buttons.setSpacing(8)
        for button in (self._say, self._edit, self._again, self._cancel, self._dismiss):
            self._buttons.addWidget(button)
        self._buttons.addStretch(1)
        self._middle = QBoxLayout(QBoxLayout.Direction.TopToBottom)
        self._middle.setSpacing(8)
        self._middle.addWidget(self._answer, 1)
        self._middle.addLayout(self._buttons)
        self._main = QWidget()
        self._column = layouts.vbox(self._main, margins_px=0, spacing_px=8)
        self._column.addLayout(top)
        self._column.addWidget(self.setup_bar)
        self._column.addWidget(self.along)
        self._column.addWidget(self._rows)
        self._column.addWidget(self._question)
        self._column.addLayout(self._middle, 1)
        self._column.addWidget(self._note)
        self._words = SystemPromptPage(self.theme, self.console.do)
        self._words.closed.connect(self._close_words)
        self._frame = layouts.vbox(self, margins_px=(14, 12, 14, 12))
        self._pages = QStackedLayout()
        self._frame.addLayout(self._pages)
        self._pages.addWidget(self._main)
        self._pages.addWidget(self._words)

    def focus_target(self) -> QWidget:
        return self.field

    def title_widgets(self) -> list[QWidget]:
        return [self.with_what]

    def sizeHint(self) -> QSize:
        return QSize(420, 240)

    def minimumSizeHint(self) -> QSize:
        return QSize(260, 136)

    def show_scenario(self) -> None:
        self._chosen = ""
        self._stop_editing()
        self.with_what.setChecked(False)
        # Edited prompts belong to the former scenario and must not leak into this one.
        self._words.forget()
        self._pages.setCurrentWidget(self._main)
        self.update_view()

    def use_settings(self, settings: PanelSettings) -> None:
        self.along.restore(settings.assistant.left_out, self.along.pictures)

    def save_state(self) -> Any:
        return self.field.text(), self.along.left_out, self.along.pictures

    def restore_state(self, lasting: Any) -> None:
        text, left_out, pictures = lasting
        self.field.setText(text)
        self.along.restore(left_out, pictures)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        # In a low panel the buttons are next to the answer, which must be read before it is said.
        low = self.height() < _LOW_PX
        self._middle.setDirection(QBoxLayout.Direction.LeftToRight if low else QBoxLayout.Direction.TopToBottom)
        self._buttons.setDirection(QBoxLayout.Direction.TopToBottom if low else QBoxLayout.Direction.LeftToRight)
        self._frame.setContentsMargins(14, 8 if low else 12, 14, 8 if low else 12)
        self._show_parts()

    def _style(self) -> None:
        for label in (self._question, self._note):
            label.setFont(self.theme.font(tokens.STATUS_PX))
        self.update_view()

    # Question

    def _asked(self) -> str:
        return " ".join(self.field.text().split())

    def _on_question_changed(self, _text: str) -> None:
        too_long = characters_too_long(self._asked())
        if too_long or self._too_long:
            self._too_long = too_long
            self._on_assistant_changed(self.state.assistant.value)
        self._show_parts()

    def _on_focus_changed(self, _before: QWidget | None, _now: QWidget | None) -> None:
        if self.in_view:
            self._show_parts()

    def _on_template(self, text: str) -> None:
        said = next((turn.text for turn in reversed(self.state.transcript.value) if turn.speaker == "participant"), "")
        self.field.setText(text.replace("{said}", f"“{said}”" if said else "…"))
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
            self.with_what.setChecked(False)
            self.along.forget_pictures()
            self.update_view()

    def _show_parts(self) -> None:
        """Show the widgets that fit: while a question is written, its context takes precedence over the last answer."""
        focus = focused_widget()
        beside = focus is not None and (self.setup_bar.isAncestorOf(focus) or self.along.isAncestorOf(focus))
        live, height = self._live, self.height()
        writing = live and not self._editing and (bool(self.field.text()) or beside)
        roomy = height >= _ROOMY_PX
        wanted = live and self.with_what.isChecked()
        self.setup_bar.setVisible(wanted or (live and (roomy or (writing and height >= _LOW_PX - 50))))
        self.along.setVisible(live and (roomy or writing) and bool(self.along.chips))
        read = roomy or not (writing or wanted)
        self._answer.setVisible(read)
        for button in self._offered:
            # Without room for the button, the Delete key and the row's close button do the same.
            button.setVisible(read and (button is not self._dismiss or height >= _LOW_PX))
        several = len(self.state.assistant.value.exchanges) > 1
        self._rows.setVisible(several and read and height >= _LOW_PX - 40)
        lines = min(len(self.state.assistant.value.exchanges), 3 if roomy else 2)
        self._rows.setMaximumHeight(lines * (ROW_PX + 2) + 2)
        self._question.setVisible(bool(self._question.text()) and height >= 196 and read and not several)

    @property
    def _speaks(self) -> bool:
        return bool(self.console.scenario.permissions.speech)

    @property
    def _live(self) -> bool:
        # A replay, whose table has no marks either, neither asks nor speaks.
        return self.table.spec("mark") is not None

    # Answers

    def _choose(self, exchange_id: str) -> None:
        if exchange_id != self._shown.exchange_id:
            self._chosen = exchange_id
            self._stop_editing()
            self.update_view()

    def _step(self, by: int) -> None:
        """Select the previous or next question."""
        ids = [each.exchange_id for each in self.state.assistant.value.exchanges]
        if self._shown.exchange_id in ids:
            at = ids.index(self._shown.exchange_id) + by
            if 0 <= at < len(ids):
                self._choose(ids[at])

    def _on_say(self) -> None:
        text = self._answer.toPlainText().strip()
        if text:
            exchange_id = self._shown.exchange_id
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
        self._chosen = self._shown.exchange_id  # a new answer must not replace the edited one
        self._answer.setReadOnly(False)
        self._restyle_answer()
        self._answer.setFocus(Qt.FocusReason.OtherFocusReason)
        self._answer.moveCursor(self._answer.textCursor().MoveOperation.End)
        self._on_assistant_changed(self.state.assistant.value)

    def _on_again(self) -> None:
        """Put the question back into the field for editing or asking again."""
        self.field.setText(self._shown.question)
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
        # Dynamic property of the style sheet for editable text.
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
        if not self.in_view:
            return
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
        if not self.in_view:
            return
        exchanges = status.exchanges or _the_one_of(status)
        chosen = next((each for each in exchanges if each.exchange_id == self._chosen), None)
        shown = chosen or (exchanges[0] if exchanges else _NO_EXCHANGE)
        if shown.exchange_id != self._shown.exchange_id:
            self._stop_editing()
        if not self._editing and self._answer.toPlainText() != shown.answer:
            self._show_answer(shown.answer)
        if self._shown.is_pending and not shown.is_pending:
            # Scroll a completed answer to its beginning.
            self._answer.verticalScrollBar().setValue(0)
        self._shown = shown
        live = self._live
        speaks = self._speaks
        self._rows.show_rows(exchanges, shown.exchange_id, live=live, speaks=speaks)
        has_answer = bool(shown.answer.strip()) and not shown.is_pending
        self._question.setText(
            tr("You asked: {question}").format(question=text_formatting.shortened(shown.question, 140))
            if shown.question
            else ""
        )
        waits = self.state.present.live and speaks
        self._answer.setPlaceholderText(tr("Answers wait here until you say them.") if waits else "")
        self.field.setReadOnly(not live)
        show_part(self.with_what, live)
        self._cancel.setEnabled(live)
        self._say.setEnabled(has_answer and live and speaks)
        self._edit.setEnabled(has_answer and not self._editing and live and speaks)
        self._dismiss.setEnabled(live)
        self._again.setEnabled(live)
        again = shown.state in ("failed", "cancelled") and bool(shown.question) and not has_answer
        offered = {
            self._say: speaks and not shown.is_pending and not again,
            self._edit: speaks and not shown.is_pending and not again,
            self._again: again,
            self._cancel: shown.is_pending,
            self._dismiss: bool(shown.exchange_id) and not shown.is_pending,
        }
        self._offered = [button for button, is_offered in offered.items() if is_offered]
        for button in offered:
            if button not in self._offered:
                button.hide()
        self._ask.setEnabled(live and not self._too_long and status.state in ("ready", "answering", "failed"))
        self._show_note(status, shown)
        self._show_fact(status)
        self._show_parts()

    def _show_fact(self, status: AssistantStatus) -> None:
        under_way = sum(exchange.is_pending for exchange in status.exchanges)
        match status.state:
            case "ready":
                self.set_fact(status.model or tr("ready"))
            case "answering":
                what = tr("{model} is writing").format(model=status.model)
                if under_way > 1:
                    what = tr("%n answers are being written", "", under_way)
                self.set_fact(what, "blue")
            case "starting":
                self.set_fact(tr("getting ready"))
            case "failed":
                self.set_fact(tr("no answer"), "amber")
            case _:
                self.set_fact(tr("off"))

    def _show_answer(self, answer: str) -> None:
        shown = self._answer.toPlainText()
        if answer.startswith(shown) and shown:
            cursor = self._answer.textCursor()
            cursor.movePosition(cursor.MoveOperation.End)
            cursor.insertText(answer[len(shown) :])
        else:
            self._answer.setPlainText(answer)
        bar = self._answer.verticalScrollBar()
        bar.setValue(bar.maximum())

    def _show_note(self, status: AssistantStatus, shown: ExchangeStatus) -> None:
        role = "dim"
        if self._too_long:
            text, role = (
                tr("The question is {over:,} characters too long. Shorten it to at most {most:,} characters.").format(
                    over=self._too_long, most=MAX_QUESTION_CHARACTERS
                ),
                "amber",
            )
        elif shown.state == "failed" and shown.exchange_id:
            text, role = tr(shown.detail) or tr("The assistant gave no answer. Ask again."), "amber"
        elif status.state == "failed" and not shown.answer:
            text, role = tr(status.detail) or tr("The assistant gave no answer. Ask again."), "amber"
        elif status.state == "starting":
            text = tr("The language model is starting. Phrases and typing work meanwhile.")
        elif status.state == "off":
            text = tr(status.detail) or tr("No language model is set up.")
        elif shown.state == "preparing":
            text = tr("Reading the pictures…")
        elif shown.is_pending and not shown.answer:
            text = tr(shown.detail) or tr("Thinking…")
        elif self._editing:
            text = tr("Edit the text. Enter says it.")
        elif shown.use:
            text = tr("Said.") if shown.use == "said" else tr("Said with your changes.")
        else:
            # A truncated answer is marked as such.
            text, role = tr(shown.detail), "amber" if shown.state == "answered" else "dim"
        self._note.setText(text)
        self._note.setVisible(bool(text))
        for label, color in ((self._note, role), (self._question, "dim")):
            self.theme.color_text(label, color)


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
        step = {Qt.Key.Key_Up: -1, Qt.Key.Key_Down: 1}.get(Qt.Key(event.key()))
        if step is None or event.modifiers() & ~Qt.KeyboardModifier.KeypadModifier:
            super().keyPressEvent(event)
        else:
            self.stepped.emit(step)
            event.accept()


class _AnswerField(SubmitTextEdit):
    """Answer field. While editing, Enter says the answer and Shift+Enter inserts a line break."""

    def means_enter(self, event: QKeyEvent) -> bool:
        begins_line = event.modifiers() & Qt.KeyboardModifier.ShiftModifier
        return not (self.isReadOnly() or begins_line) and super().means_enter(event)
