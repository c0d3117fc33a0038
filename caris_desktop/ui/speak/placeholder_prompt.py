"""Placeholder prompt: asks in place for a template value before an utterance."""

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QLabel, QSizePolicy, QWidget

from caris_desktop.conversation.placeholders import NAME, PLACE
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import AskedGap
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.submit_line_edit import SubmitLineEdit

_QUESTIONS = {NAME: QT_TR_NOOP("Which name?"), PLACE: QT_TR_NOOP("Which place?")}


class PlaceholderPrompt(QWidget):
    """Input field; Enter submits the value, Esc cancels."""

    filled = Signal(str)
    given_up = Signal()

    def __init__(self, theme: Theme) -> None:
        super().__init__()
        self._theme = theme
        self.setObjectName("gap_row")
        self._question = QLabel()
        self.field = SubmitLineEdit()
        self.field.setObjectName("gap_field")
        self.field.setMaxLength(200)
        self.field.setMinimumWidth(90)
        self.field.returnPressed.connect(self._on_return)
        self._say = ActionButton(theme, tr("Say it"), key="Enter", height_px=30, text_px=tokens.BODY_PX - 1)
        self._say.clicked.connect(self._on_return)
        self._leave = ActionButton(
            theme, tr("Cancel"), key="Esc", height_px=30, text_px=tokens.BODY_PX - 1, look="ghost"
        )
        self._leave.setObjectName("gap_leave")
        self._leave.clicked.connect(self.given_up)
        self._question.setSizePolicy(QSizePolicy.Policy.Maximum, QSizePolicy.Policy.Fixed)
        row = layouts.hbox(self, margins_px=0, spacing_px=8)
        row.addWidget(self._question)
        row.addWidget(self.field, 1)
        row.addWidget(self._say)
        row.addWidget(self._leave)
        theme.restyle_on_change(self._style)
        self.hide()

    def ask(self, asked: AskedGap) -> None:
        question = tr("What is {gap}?").format(gap=f"{{{asked.gap}}}")
        self._question.setText(tr(_QUESTIONS[asked.gap]) if asked.gap in _QUESTIONS else question)
        self.field.setPlaceholderText(tr("for “{text}”").format(text=text_formatting.shortened(asked.text, 60)))
        named = tr("{question} It is for “{text}”")
        self.field.setAccessibleName(named.format(question=self._question.text(), text=asked.text))
        self.field.clear()
        self.show()

    def _on_return(self) -> None:
        text = " ".join(self.field.text().split())
        if text:
            self.filled.emit(text)

    def _style(self) -> None:
        self._theme.style_text(self._question, "amber", tokens.BODY_PX, tokens.WEIGHT_SEMIBOLD)
