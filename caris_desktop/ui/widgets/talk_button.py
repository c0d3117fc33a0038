"""Push-to-talk button, held while the wizard speaks through the robot."""

from PySide6.QtGui import QHideEvent

from caris_desktop.domain.translation import tr
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import MicrophoneStatus, SoundStatus
from caris_desktop.ui.action_bindings import Actions
from caris_desktop.ui.drive_input_filter import DriveInputFilter
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton

TALK = "push_to_talk"
"""Row of the action table that the button requires."""


class TalkButton(ActionButton):
    """Blue while the participant hears the wizard, amber until then."""

    def __init__(self, theme: Theme, actions: Actions, hold: DriveInputFilter, state: LiveState) -> None:
        super().__init__(theme, tr("Talk"), icon="microphone", height_px=30, may_lose_words=True)
        self.setObjectName("talk_button")
        self.setToolTip(tr("Hold and speak: the robot plays your own voice"))
        self._actions = actions
        self._hold = hold
        self._state = state
        self.pressed.connect(lambda: hold.mark_pressed.emit(TALK))
        self.released.connect(lambda: hold.mark_released.emit(TALK))
        actions.keys_changed.connect(self._show_key)
        for value in (state.sound, state.wizard_microphone):
            value.changed.connect(self._show)
        self._show_key()
        self._show()

    def _show_key(self) -> None:
        self.set_key(self._actions.key_text(TALK))

    def _show(self, _value: object = None) -> None:
        sound: SoundStatus = self._state.sound.value
        microphone: MicrophoneStatus = self._state.wizard_microphone.value
        talks = sound.talking == "robot"
        self.set_label(tr("Talk"), look="plain" if not talks else "primary" if microphone.state == "on" else "amber")

    def hideEvent(self, event: QHideEvent) -> None:
        if self.isDown():  # on shutdown a button that is not held may be hidden after the key handler was destroyed
            self._hold.mark_released.emit(TALK)
        super().hideEvent(event)
