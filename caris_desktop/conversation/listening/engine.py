"""Interface of speech recognition engines, local or on a server."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.local_agreement import RecognisedWord
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.value_class import Value


class NoEngineError(UserFacingError):
    """No engine is available, and a retry would not help."""


class EngineUnavailableError(UserFacingError):
    """The engine did not answer; a retry may succeed."""


class Recognised(Value):
    """Transcript of an interval."""

    words: tuple[RecognisedWord, ...]
    language: str


class Engine(Protocol):
    """``every_s`` is the minimum interval between requests during continuous speech."""

    model: str
    language: str
    every_s: float

    def transcribe(self, sound: NDArray[np.float32], before: str, *, careful: bool, voice_s: float = 0.0) -> Recognised:
        """Transcribe ``sound``: 16 kHz, mono. ``before`` is the preceding text. ``careful``: possibly the final pass,
        worth more time. ``voice_s``: end of known voice in the sound. Raises EngineUnavailableError.
        """

    def close(self) -> None:
        """Release the engine."""
