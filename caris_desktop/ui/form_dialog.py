"""Dialogs of fields above a row of buttons, and file dialogs."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from PySide6.QtCore import QSize, Qt
from PySide6.QtWidgets import QDialog, QFileDialog, QWidget

from caris_desktop.ui import layouts
from caris_desktop.ui.focus_widget import VisualTabOrderMixin
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import Scrolled
from caris_desktop.ui.widgets.labels import named

_MARGINS_PX = (24, 20, 24, 20)
_AROUND = QSize(40, 60)  # what a window leaves free of its screen


def lay_out_form(
    window: QWidget, *content: layouts.Item, buttons: Sequence[layouts.Item], scrolls: bool = True, spacing_px: int = 12
) -> None:
    """Lay out a window: the content, which scrolls where the screen is small, above the buttons."""
    foot = layouts.hbox(None, *buttons, spacing_px=8)
    if scrolls:
        holder = QWidget()
        layouts.vbox(holder, *content, margins_px=0, spacing_px=spacing_px)
        content = ((Scrolled(holder), 1),)
    layouts.vbox(window, *content, foot, margins_px=_MARGINS_PX, spacing_px=12)


def resize_to(window: QWidget, size: QSize) -> None:
    """Resize to ``size``, as far as the screen has it: Qt limits a first window to two thirds of the screen."""
    window.resize(size.boundedTo(window.screen().availableSize() - _AROUND))


def file_dialog(
    parent: QWidget, name: str, title: str, chosen: Callable[[Path], object], *, folder: Path | None = None,
    files: str = "", mode: QFileDialog.FileMode = QFileDialog.FileMode.ExistingFile,
) -> QFileDialog:  # fmt: skip
    """File dialog, to be shown, whose choice goes to ``chosen``; ``files``: its name filter.

    Not modal and not the system's, which would take the keys that stop the robot.
    """
    dialog = named(QFileDialog(parent, title, str(folder or Path.home()), files), name)
    dialog.setOption(QFileDialog.Option.DontUseNativeDialog)
    dialog.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
    dialog.setFileMode(mode)
    dialog.fileSelected.connect(lambda path: chosen(Path(path)))
    return dialog


class FormDialog(VisualTabOrderMixin, QDialog):
    """Non-modal: the robot can be driven and stopped meanwhile. Deleted when it is closed."""

    def __init__(self, theme: Theme, parent: QWidget, name: str, title: str) -> None:
        super().__init__(parent)
        self.setObjectName(name)
        self.setWindowTitle(title)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self._theme = theme

    def button(self, name: str, text: str, run: Callable[..., object], **more: Any) -> ActionButton:
        return ActionButton(self._theme, text, objectName=name, clicked=run, **{"height_px": 38, **more})
