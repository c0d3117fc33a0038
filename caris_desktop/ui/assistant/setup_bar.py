"""Setup of the next question: model, role, style, prepared question, picture. All are drop-downs."""

from collections.abc import Callable, Sequence

from PySide6.QtCore import Signal

from caris_desktop.domain import intents
from caris_desktop.domain.intents import CAMERA_PICTURE, Intent
from caris_desktop.domain.translation import tr
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import AssistantSetup, ModelChoice
from caris_desktop.ui.assistant.prompt_context_chips import picture_words
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.drop_down import DropDown
from caris_desktop.ui.widgets.flow_layout import FlowRow

_PHOTOS_OFFERED = 8
_HEIGHT_PX = 28
_MODEL_WIDEST_PX, _WIDEST_PX = 280, 180


class SetupBar(FlowRow):
    """Setup bar; drop-downs without a choice in this scenario are hidden."""

    template_chosen = Signal(str)
    picture_chosen = Signal(str)
    words_wanted = Signal()

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
        self.words = ActionButton(theme, "", icon="note-pencil", height_px=_HEIGHT_PX)
        self.words.setObjectName("assistant_words")
        self.words.setToolTip(tr("Prompt for the model: view it or change it for this session"))
        self.words.setAccessibleName(tr("Prompt for the model"))
        self.words.clicked.connect(self.words_wanted)
        for drop_down in (self.model, self.role, self.style_choice, self.template, self.picture):
            drop_down.setMinimumHeight(_HEIGHT_PX)
            drop_down.setMaximumHeight(_HEIGHT_PX)
            drop_down.show_whole(up_to_px=_MODEL_WIDEST_PX if drop_down is self.model else _WIDEST_PX)
            self.add(drop_down)
        self.add(self.words)
        self.model.activated.connect(self._on_model)
        self.role.activated.connect(lambda at: self._do(intents.ChoosePrompt("role", self.role.itemData(at))))
        self.style_choice.activated.connect(
            lambda at: self._do(intents.ChoosePrompt("style", self.style_choice.itemData(at)))
        )
        self.template.activated.connect(self._on_template)
        self.picture.activated.connect(self._on_picture)

    def show_setup(self, setup: AssistantSetup, *, live: bool) -> None:
        _fill(self.model, [(_model_words(choice), choice.model) for choice in setup.models], setup.model)
        _fill(self.role, [(tr("No role"), ""), *((each.name, each.name) for each in setup.roles)], setup.role)
        _fill(
            self.style_choice, [(tr("Any style"), ""), *((each.name, each.name) for each in setup.styles)], setup.style
        )
        _fill(self.template, [(tr("Prepared…"), ""), *((each.name, each.text) for each in setup.templates)], "")
        self.role.setVisible(bool(setup.roles))
        self.style_choice.setVisible(bool(setup.styles))
        self.template.setVisible(bool(setup.templates))
        self.picture.setVisible(setup.pictures)
        if setup.pictures:
            self._fill_pictures()
        for part in (self.model, self.role, self.style_choice, self.template, self.picture, self.words):
            part.setEnabled(live)
        self._setup = setup

    def _fill_pictures(self) -> None:
        names = [f"{CAMERA_PICTURE}{camera}" for camera in self._state.cameras.value]
        names += [photo.file_name for photo in self._state.photos.value if not photo.deleted][:_PHOTOS_OFFERED]
        _fill(self.picture, [(tr("Picture…"), ""), *((picture_words(name), name) for name in names)], "")

    def _on_model(self, at: int) -> None:
        if self._do(intents.ChooseModel(self.model.itemData(at))) and self._setup is not None:
            self.model.setCurrentIndex(self.model.findData(self._setup.model))

    def _on_template(self, at: int) -> None:
        text = self.template.itemData(at)
        self.template.setCurrentIndex(0)
        if text:
            self.template_chosen.emit(text)

    def _on_picture(self, at: int) -> None:
        name = self.picture.itemData(at)
        self.picture.setCurrentIndex(0)
        if name:
            self.picture_chosen.emit(name)


def _model_words(choice: ModelChoice) -> str:
    return choice.title if choice.title.endswith(choice.where) else f"{choice.title} · {choice.where}"


def _fill(drop_down: DropDown, wanted: Sequence[tuple[str, str]], current: str) -> None:
    """Fill a drop-down only if it changed, so that an open list stays open."""
    if [(drop_down.itemText(at), drop_down.itemData(at)) for at in range(drop_down.count())] != list(wanted):
        drop_down.clear()
        for text, data in wanted:
            drop_down.addItem(text, data)
    at = drop_down.findData(current)
    if at != drop_down.currentIndex():
        drop_down.setCurrentIndex(at)
    drop_down.setToolTip(drop_down.currentText())
