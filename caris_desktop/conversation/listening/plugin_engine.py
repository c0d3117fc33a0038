"""Recogniser of a plug-in."""

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation import speech_plugins
from caris_desktop.conversation.listening.engine import Recognised
from caris_desktop.conversation.listening.local_agreement import RecognisedWord
from caris_desktop.conversation.speech_plugins import open_speech


class PluginEngine:
    """Recogniser of a plug-in."""

    every_s = 2.0

    def __init__(self, name: str, language: str) -> None:
        """Raises PluginError."""
        self.model, self.language = name, language
        self._process, _ = open_speech(name, language)

    def transcribe(self, sound: NDArray[np.float32], before: str, *, careful: bool, voice_s: float = 0.0) -> Recognised:
        """See Engine. Raises PluginError."""
        words = self._process.ask(
            "transcribe", (sound,), {"before": before}, within_s=speech_plugins.TRANSCRIBE_WITHIN_S
        )
        return Recognised(tuple(RecognisedWord(*word) for word in words), self.language)

    def close(self) -> None:
        """See Engine."""
        self._process.close()
