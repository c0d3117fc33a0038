"""Prompt context chips: parts sent with the next question, with their size; and the choice of a model file to add."""

from collections.abc import Callable, Sequence
from typing import cast

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QWidget

from caris_desktop.conversation.models.embedded_models import SUFFIX
from caris_desktop.domain.intents import CAMERA_PICTURE, AddModel, Intent, PromptPart
from caris_desktop.domain.translation import tr
from caris_desktop.live.status import ContextPartStatus
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.form_dialog import file_dialog
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import FlowRow

_HEIGHT_PX = 26


class PromptContextChips(FlowRow):
    """Prompt context chips. ``left_out`` persists until the wizard restores a part; ``pictures`` go
    with one question.
    """

    changed = Signal()

    def __init__(self, theme: Theme) -> None:
        super().__init__(gap_px=6)
        self._theme = theme
        self._chips: dict[str, ActionButton] = {}
        self._parts: tuple[ContextPartStatus, ...] = ()
        self._left_out: set[str] = set()
        self._pictures: list[str] = []
        self.setObjectName("assistant_along")

    @property
    def left_out(self) -> tuple[PromptPart, ...]:
        return cast(tuple[PromptPart, ...], tuple(sorted(self._left_out)))

    @property
    def pictures(self) -> tuple[str, ...]:
        return tuple(self._pictures)

    @property
    def chips(self) -> Sequence[ActionButton]:
        return tuple(self._chips.values())

    def show_parts(self, parts: tuple[ContextPartStatus, ...]) -> None:
        if parts != self._parts:
            self._parts = parts
            self._show()

    def add_picture(self, name: str) -> None:
        if name not in self._pictures:
            self._pictures.append(name)
            self._show()

    def forget_pictures(self) -> None:
        """Clear the pictures after sending, or when they can no longer be sent."""
        if self._pictures:
            self._pictures.clear()
            self._show()

    def restore(self, left_out: Sequence[str], pictures: Sequence[str]) -> None:
        """Restore the state of the former panel."""
        self._left_out, self._pictures = set(left_out), list(pictures)
        self._show()

    def _show(self) -> None:
        entries: dict[str, tuple[str, bool]] = {}
        for part in self._parts:
            words = tr("1 word") if part.words == 1 else tr("%n words", "", part.words)
            entries[part.kind] = (" · ".join((tr(part.title), words)), part.kind not in self._left_out)
        for name in self._pictures:
            entries[f"picture {name}"] = (picture_words(name), True)
        for key in [key for key in self._chips if key not in entries]:
            chip = self._chips.pop(key)
            layouts.discard(chip)
        for key, (text, along) in entries.items():
            chip = self._chips.get(key) or self._new_chip(key)
            chip.setChecked(along)
            chip.set_label(text, icon="x" if along else "plus")
            tip = tr("Included in the question. Press to remove it.") if along else tr("Not included. Press to add it.")
            chip.setToolTip(tip)
            chip.setAccessibleDescription(tip)
        self.updateGeometry()
        self.changed.emit()

    def _new_chip(self, key: str) -> ActionButton:
        chip = self._chips[key] = ActionButton(
            self._theme, "", icon="x", height_px=_HEIGHT_PX, text_px=tokens.STATUS_PX, may_shrink=True
        )
        chip.setObjectName(f"along_{key.split(maxsplit=1)[0]}")
        chip.setCheckable(True)
        chip.clicked.connect(lambda: self._on_clicked(key))
        self.add(chip)
        chip.show()
        return chip

    def _on_clicked(self, key: str) -> None:
        if key.startswith("picture "):
            self._pictures.remove(key.removeprefix("picture "))
        else:
            self._left_out ^= {key}
        self._show()


def picture_words(name: str) -> str:
    """Label of a picture, named as in ``Ask.pictures``."""
    if name.startswith(CAMERA_PICTURE):
        return tr("Current picture: {camera}").format(camera=name.removeprefix(CAMERA_PICTURE))
    return tr("Photo {name}").format(name=name.rsplit("/", 1)[-1].removesuffix(".png"))


def choose_model_file(window: QWidget, do: Callable[[Intent], object]) -> None:
    """Open a dialog whose file is added."""
    files = tr("Language models ({files})").format(files=f"*{SUFFIX}")
    title = tr("Add a model file")
    file_dialog(window, "model_file_dialog", title, lambda path: do(AddModel(path)), files=files).show()
