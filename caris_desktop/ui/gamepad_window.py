"""Gamepad of the window: connects it to driving and opens its dialog."""

from typing import TYPE_CHECKING

from PySide6.QtWidgets import QWidget

from caris_desktop.live.gamepad import Gamepads
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.window_place import raise_window

if TYPE_CHECKING:  # imported at first use
    from caris_desktop.ui.gamepad_dialog import GamepadDialog


class GamepadWindow:
    """Connects a gamepad to driving, and opens the dialog in scenarios that drive."""

    def __init__(self, theme: Theme, console: WizardConsole, hold: DriveInputFilter, window: QWidget) -> None:
        self._theme = theme
        self._console = console
        self._hold = hold
        self._window = window
        self._gamepads: Gamepads | None = None
        self._dialog: GamepadDialog | None = None

    @property
    def offered(self) -> bool:
        return self._gamepads is not None and self._console.scenario.permissions.driving

    def use_gamepads(self, gamepads: Gamepads) -> None:
        """Connect the gamepad: driving, stop and button bindings, and its dialog."""
        if gamepads is not self._gamepads:
            self._gamepads = gamepads
            self._hold.use_gamepads(gamepads)

    def open(self) -> None:
        """Show the gamepad dialog. Non-modal: the robot can be stopped meanwhile."""
        if self._gamepads is None:
            return
        from caris_desktop.ui.gamepad_dialog import GamepadDialog

        dialog = self._dialog or GamepadDialog(self._theme, self._console.state, self._gamepads, self._window)
        self._dialog = dialog
        raise_window(dialog)
