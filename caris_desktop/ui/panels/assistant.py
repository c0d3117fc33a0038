"""Assistant: ask the language model, read its answer as it comes, and have it said or not."""

from PySide6.QtCore import QSize, Qt, Signal
from PySide6.QtGui import QKeyEvent, QResizeEvent
from PySide6.QtWidgets import QBoxLayout, QHBoxLayout, QLabel, QLineEdit, QPlainTextEdit, QVBoxLayout, QWidget

from caris_desktop.conversation.prompts import MAX_QUESTION_CHARACTERS, characters_too_long
from caris_desktop.domain import intents
from caris_desktop.live.status import AssistantStatus
from caris_desktop.ui import tokens, words
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.widgets.buttons import ActionButton

_MOST_TYPED = 32_000


class AssistantPanel(Panel):
    """Nothing that the model writes is said before the wizard says so."""

    title = "Assistant"

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("assistant_panel")
        self._exchange_id = ""
        self._editing = False
        self._answering = False
        self._too_long = 0
        self.field = QLineEdit()
        self.field.setObjectName("assistant_field")
        self.field.setAccessibleName("Question to the assistant")
        self.field.setPlaceholderText("Ask the assistant…")
        self.field.setMinimumHeight(40)
        # A pasted text stays whole: what is too long is said, and not cut behind the wizard's back.
        self.field.setMaxLength(_MOST_TYPED)
        self.field.returnPressed.connect(self._on_ask)
        self.field.textChanged.connect(self._on_question_changed)
        self._ask = ActionButton(self.theme, "Ask", key="Enter", height_px=40)
        self._ask.setObjectName("assistant_ask")
        self._ask.clicked.connect(self._on_ask)
        self._question = QLabel()
        self._question.setObjectName("assistant_question")
        self._question.setWordWrap(True)
        self._question.setTextFormat(Qt.TextFormat.PlainText)
        self._answer = _AnswerField()
        self._answer.entered.connect(self._on_say)
        self._answer.setObjectName("assistant_answer")
        self._answer.setAccessibleName("The assistant's answer")
        self._answer.setReadOnly(True)
        if self.state.present.live:
            self._answer.setPlaceholderText("Answers wait here until you say them.")
        self._answer.setTabChangesFocus(True)
        self._answer.setMinimumHeight(30)
        self._note = QLabel()
        self._note.setObjectName("assistant_note")
        self._note.setWordWrap(True)
        self._say = ActionButton(self.theme, "Say it", icon="speaker-high", look="primary")
        self._say.setObjectName("assistant_say")
        self._say.clicked.connect(self._on_say)
        self._edit = ActionButton(self.theme, "Edit first", icon="pencil-simple")
        self._edit.setObjectName("assistant_edit")
        self._edit.clicked.connect(self._on_edit)
        self._cancel = ActionButton(self.theme, "Cancel", icon="x")
        self._cancel.setObjectName("assistant_cancel")
        self._cancel.clicked.connect(lambda: self.console.do(intents.CancelAnswer()))
        top = QHBoxLayout()
        top.setSpacing(8)
        top.addWidget(self.field, 1)
        top.addWidget(self._ask)
        self._buttons = QBoxLayout(QBoxLayout.Direction.LeftToRight)
        self._buttons.setSpacing(8)
        for button in (self._say, self._edit, self._cancel):
            self._buttons.addWidget(button)
        self._buttons.addStretch(1)
        self._middle = QBoxLayout(QBoxLayout.Direction.TopToBottom)
        self._middle.setSpacing(8)
        self._middle.addWidget(self._answer, 1)
        self._middle.addLayout(self._buttons)
        self._column = QVBoxLayout(self)
        self._column.setContentsMargins(14, 12, 14, 12)
        self._column.setSpacing(8)
        self._column.addLayout(top)
        self._column.addWidget(self._question)
        self._column.addLayout(self._middle, 1)
        self._column.addWidget(self._note)
        self.state.assistant.changed.connect(self._on_assistant_changed)
        self.table.rebuilt.connect(self.catch_up)
        self.theme.changed.connect(self._style)
        self._style()

    def focus_target(self) -> QWidget:
        return self.field

    def sizeHint(self) -> QSize:
        return QSize(420, 240)

    def minimumSizeHint(self) -> QSize:
        return QSize(260, 112)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._question.setVisible(bool(self._question.text()) and self.height() >= 196)
        # Where it is low, the buttons stand beside the answer: it must be read before it is said.
        low = self.height() < 210
        self._middle.setDirection(QBoxLayout.Direction.LeftToRight if low else QBoxLayout.Direction.TopToBottom)
        self._buttons.setDirection(QBoxLayout.Direction.TopToBottom if low else QBoxLayout.Direction.LeftToRight)
        self._column.setContentsMargins(14, 8 if low else 12, 14, 8 if low else 12)

    def _style(self) -> None:
        for label in (self._question, self._note):
            label.setFont(self.theme.font(tokens.STATUS_PX))
        self._on_assistant_changed(self.state.assistant.value)

    def _asked(self) -> str:
        return " ".join(self.field.text().split())

    def _on_question_changed(self, _text: str) -> None:
        too_long = characters_too_long(self._asked())
        if too_long or self._too_long:
            self._too_long = too_long
            self._on_assistant_changed(self.state.assistant.value)

    def _on_ask(self) -> None:
        question = self._asked()
        if question and not self._too_long and self.state.assistant.value.state in ("ready", "failed"):
            self._stop_editing()
            self.field.clear()
            self.console.do(intents.Ask(question))

    def _on_say(self) -> None:
        text = " ".join(self._answer.toPlainText().split())
        if text:
            self._stop_editing()
            self.console.do(intents.SayAnswer(text))

    def _on_edit(self) -> None:
        self._editing = True
        self._answer.setReadOnly(False)
        self._restyle_answer()
        self._answer.setFocus(Qt.FocusReason.OtherFocusReason)
        self._answer.moveCursor(self._answer.textCursor().MoveOperation.End)
        self._on_assistant_changed(self.state.assistant.value)

    def _stop_editing(self) -> None:
        if self._editing:
            self._editing = False
            self._answer.setReadOnly(True)
            self._restyle_answer()

    def _restyle_answer(self) -> None:
        self._say.set_key("Enter" if self._editing else "")
        # The style sheet tells a field that can be edited from text by this property.
        self._answer.style().unpolish(self._answer)
        self._answer.style().polish(self._answer)

    def catch_up(self) -> None:
        self._on_assistant_changed(self.state.assistant.value)

    def _on_assistant_changed(self, status: AssistantStatus) -> None:
        if not self.in_view:
            return
        if status.exchange_id != self._exchange_id:
            self._exchange_id = status.exchange_id
            self._stop_editing()
        if not self._editing and self._answer.toPlainText() != status.answer:
            self._show_answer(status.answer)
        answering = status.state == "answering"
        if self._answering and not answering:
            # Written to the end: read from the beginning.
            self._answer.verticalScrollBar().setValue(0)
        self._answering = answering
        has_answer = bool(status.answer.strip()) and not answering
        self._question.setText(f"You asked: {words.shortened(status.question, 140)}" if status.question else "")
        self._question.setVisible(bool(status.question) and self.height() >= 196)
        # In a replay, whose table has no marks to set either, nothing is asked or said.
        live = self.table.spec("mark") is not None
        self.field.setReadOnly(not live)
        self._cancel.setEnabled(live)
        self._say.setEnabled(has_answer and live)
        self._edit.setEnabled(has_answer and not self._editing and live)
        self._say.setVisible(not answering)
        self._edit.setVisible(not answering)
        self._cancel.setVisible(answering)
        self._ask.setEnabled(live and not self._too_long and status.state in ("ready", "failed"))
        self._show_note(status, answering=answering)
        match status.state:
            case "ready":
                self.set_fact(status.model or "ready")
            case "answering":
                self.set_fact(f"{status.model} is writing", "blue")
            case "starting":
                self.set_fact("getting ready")
            case "failed":
                self.set_fact("no answer", "amber")
            case _:
                self.set_fact("off")

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

    def _show_note(self, status: AssistantStatus, *, answering: bool) -> None:
        role = "dim"
        if self._too_long:
            text, role = (
                f"The question is {self._too_long:,} characters too long. "
                f"The assistant takes {MAX_QUESTION_CHARACTERS:,}: shorten it to ask.",
                "amber",
            )
        elif status.state == "failed":
            text, role = status.detail or "The assistant gave no answer. Ask again.", "amber"
        elif status.state == "starting":
            text = "The language model is starting. Phrases and typing work meanwhile."
        elif status.state == "off":
            text = status.detail or "No language model is set up."
        elif answering and not status.answer:
            text = "Thinking…"
        elif self._editing:
            text = "Change the words. Enter says them."
        else:
            text = status.detail
        self._note.setText(text)
        self._note.setVisible(bool(text))
        for label, color in ((self._note, role), (self._question, "dim")):
            self.theme.color_text(label, color)


class _AnswerField(QPlainTextEdit):
    """An answer. While it is edited Enter says it; Shift+Enter begins a line."""

    entered = Signal()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        enter = event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter)
        if enter and not self.isReadOnly() and not event.modifiers() & Qt.KeyboardModifier.ShiftModifier:
            # A key that is held says it once.
            if not event.isAutoRepeat():
                self.entered.emit()
            event.accept()
            return
        super().keyPressEvent(event)
