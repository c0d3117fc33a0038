"""The bar of a replay: play, pause, rate, steps, jumps, and the whole session to scrub through."""

from typing import Literal

from PySide6.QtWidgets import QWidget

from caris_desktop.live.intents import ReplayControls
from caris_desktop.live.state import LiveState
from caris_desktop.ui.actions import REPLAY_ACTIONS, Actions
from caris_desktop.ui.theme import Theme


class ReplayBar(QWidget):
    """Moves through the session; ``actions`` gets the keys of a replay."""

    def __init__(self, theme: Theme, replay: ReplayControls, state: LiveState, actions: Actions) -> None:
        super().__init__()
        self.setObjectName("replay_bar")
        self._theme = theme
        self._replay = replay
        self._state = state
        actions.add_rows(REPLAY_ACTIONS, self)

    # ---- what the table's actions do

    def toggle_playing(self) -> None:
        if self._replay.playback.value.playing:
            self._replay.pause()
        else:
            self._replay.play()

    def step(self, frames: int) -> None:
        self._replay.step(frames)

    def jump(self, where: tuple[Literal["mark", "utterance"], Literal[-1, 1]]) -> None:
        kind, direction = where
        self._replay.jump(kind, direction)

    def change_rate(self, direction: int) -> None:
        """The next faster (1) or slower (-1) rate."""
