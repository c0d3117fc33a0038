"""Push-to-talk: a key or gamepad button held while the wizard speaks."""

from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication

from caris_desktop.domain import intents
from caris_desktop.domain.sound_values import TalkTo
from caris_desktop.live.gamepad import Gamepads
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter

_GAMEPAD = "push_to_talk"
_TAKEN_BY_OTHERS = ("dialog", "menu", "elsewhere")


class Talking(QObject):
    """Push-to-talk from press to release. It ends when another program, a dialog or a menu takes over, and then needs a
    new press.
    """

    def __init__(self, console: WizardConsole, actions: Actions, hold: DriveInputFilter, parent: QObject) -> None:
        super().__init__(parent)
        self._console = console
        self._actions = actions
        self._hold = hold
        self._held: tuple[str, TalkTo] | None = None
        hold.mark_pressed.connect(self._on_pressed)
        hold.mark_released.connect(self._on_released)
        hold.key_owner_changed.connect(self._check_keyboard)
        hold.windows_changed.connect(self._check_keyboard)
        actions.rebuilt.connect(self.let_go)

    def use_gamepads(self, gamepads: Gamepads) -> None:
        gamepads.pressed.connect(self._on_gamepad_pressed)
        gamepads.released.connect(self._on_released)
        gamepads.lost.connect(self.let_go)

    def let_go(self, _reason: str = "") -> None:
        """End push-to-talk."""
        if self._held is not None:
            (_, to), self._held = self._held, None
            self._console.do(intents.PushToTalk(on=False, to=to))

    def _on_pressed(self, action_id: str) -> None:
        spec = self._actions.spec(action_id)
        if spec is None or spec.kind != "talk" or self._held is not None:
            return
        to: TalkTo = spec.argument
        if self._console.do(intents.PushToTalk(on=True, to=to)) == "":
            self._held = action_id, to

    def _on_gamepad_pressed(self, action_id: str) -> None:
        if action_id == _GAMEPAD and not self._others_have_the_keys():
            self._on_pressed(action_id)

    def _on_released(self, action_id: str) -> None:
        if self._held is not None and self._held[0] == action_id:
            self.let_go()

    def _check_keyboard(self, _owner: str = "") -> None:
        if self._others_have_the_keys():
            self.let_go()

    def _others_have_the_keys(self) -> bool:
        # Without driving in the scenario, no key owner is reported.
        return self._hold.key_owner in _TAKEN_BY_OTHERS or QApplication.activeModalWidget() is not None
