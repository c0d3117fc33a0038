"""System prompt page: the texts sent before a question, edited for this session or reset."""

from collections.abc import Callable
from typing import Literal, cast

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QPlainTextEdit, QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import AssistantSetup
from caris_desktop.ui import layouts
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.drop_down import DropDown

_Kind = Literal["system_prompt", "notes", "role", "style"]
_BUTTON_PX = 30


class SystemPromptPage(QWidget):
    """One text at a time: instructions, notes, a role or a style. The scenario file is not changed."""

    closed = Signal()

    def __init__(self, theme: Theme, do: Callable[[Intent], str]) -> None:
        super().__init__()
        self._do = do
        self._setup = AssistantSetup()
        self._shown: tuple[str, str] = ("", "")
        self.which = DropDown(theme, "assistant_which_words", tr("Prompt text"))
        self.which.activated.connect(self._on_which)
        self.field = QPlainTextEdit(tabChangesFocus=True)
        self.field.setObjectName("assistant_words_field")
        self.field.setAccessibleName(tr("Prompt for the model"))
        self.field.textChanged.connect(self._show_buttons)
        self.save = ActionButton(theme, tr("Apply"), icon="check", look="primary", height_px=_BUTTON_PX)
        self.save.setObjectName("assistant_words_save")
        self.save.clicked.connect(self._save)
        self.reset = ActionButton(theme, tr("Reset to scenario"), height_px=_BUTTON_PX, may_shrink=True)
        self.reset.setObjectName("assistant_words_reset")
        self.reset.setToolTip(tr("Reset the model, role, style and all texts to those of the scenario"))
        self.reset.clicked.connect(self._on_reset)
        self.back = ActionButton(theme, tr("Back"), icon="arrow-left", height_px=_BUTTON_PX)
        self.back.setObjectName("assistant_words_back")
        self.back.clicked.connect(self.closed)
        top = layouts.hbox(spacing_px=6)
        top.addWidget(self.back)
        top.addWidget(self.which, 1)
        bottom = layouts.hbox(spacing_px=6)
        bottom.addWidget(self.save)
        bottom.addWidget(self.reset)
        bottom.addStretch(1)
        column = layouts.vbox(self, margins_px=0, spacing_px=6)
        column.addLayout(top)
        column.addWidget(self.field, 1)
        column.addLayout(bottom)

    def forget(self) -> None:
        """Discard an edit; the next setup is shown from its beginning."""
        self.which.clear()
        self._shown = ("", "")

    def show_setup(self, setup: AssistantSetup) -> None:
        """Show the setup; an unsaved edit stays in the field."""
        changed = self._changed
        self._setup = setup
        wanted = [(tr("Instructions"), ("system_prompt", "")), (tr("Notes"), ("notes", ""))]
        wanted += [(tr("Role: {name}").format(name=each.name), ("role", each.name)) for each in setup.roles]
        wanted += [(tr("Style: {name}").format(name=each.name), ("style", each.name)) for each in setup.styles]
        if [self.which.itemText(at) for at in range(self.which.count())] != [text for text, _ in wanted]:
            self.which.clear()
            for text, key in wanted:
                self.which.addItem(text, key)
            self._shown = wanted[0][1]
            changed = False
        if not changed:
            self._fill()
        self._show_buttons()

    @property
    def _changed(self) -> bool:
        return bool(self._shown[0]) and self.field.toPlainText().strip() != self._text_of(self._shown)

    def _text_of(self, key: tuple[str, str]) -> str:
        kind, name = key
        if kind == "system_prompt":
            return self._setup.system_prompt.strip()
        if kind == "notes":
            return self._setup.notes.strip()
        named = self._setup.roles if kind == "role" else self._setup.styles
        return next((each.text.strip() for each in named if each.name == name), "")

    def _fill(self) -> None:
        text = self._text_of(self._shown)
        if self.field.toPlainText().strip() != text:
            self.field.setPlainText(text)

    def _show_buttons(self) -> None:
        self.save.setEnabled(self._changed)
        self.reset.setEnabled(self._setup.edited)

    def _on_which(self, at: int) -> None:
        if self._changed and not self._save():
            self.which.setCurrentIndex(self.which.findText(self._name_of_shown()))
            return
        kind, name = self.which.itemData(at)
        self._shown = (kind, name)
        self._fill()
        self._show_buttons()

    def _name_of_shown(self) -> str:
        kind, name = self._shown
        match kind:
            case "system_prompt":
                return tr("Instructions")
            case "notes":
                return tr("Notes")
            case "role":
                return tr("Role: {name}").format(name=name)
            case _:
                return tr("Style: {name}").format(name=name)

    def _save(self) -> bool:
        """Save the edit; False if refused, with the text left in the field."""
        kind, name = self._shown
        return not self._do(intents.EditPrompt(cast(_Kind, kind), self.field.toPlainText().strip(), name))

    def _on_reset(self) -> None:
        self.field.setPlainText(self._text_of(self._shown))
        self._do(intents.ResetPrompts())
