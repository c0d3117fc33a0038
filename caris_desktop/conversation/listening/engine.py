"""What turns sound into words: this computer, or a server."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.agreement import HeardWord
from caris_desktop.domain.failure import ToldFailure
from caris_desktop.domain.value_class import dataclass


class NoEngine(ToldFailure):
    """Nothing here turns sound into words, and trying again would not help."""


class EngineAway(ToldFailure):
    """It did not answer this time; it may the next."""


@dataclass(frozen=True, slots=True)
class HeardText:
    """What was made out in a stretch of sound."""

    words: tuple[HeardWord, ...]
    language: str


class Engine(Protocol):
    """``every_s`` is how often it is asked at most while somebody speaks."""

    model: str
    language: str
    every_s: float

    def transcribe(self, sound: NDArray[np.float32], before: str, *, careful: bool, voice_s: float = 0.0) -> HeardText:
        """Of ``sound`` at 16 kHz, mono. ``before`` was said just before it. ``careful``: this may be the last time, so
        take some more time for it. ``voice_s``: until then somebody is known to speak in it. Raises EngineAway.
        """

    def close(self) -> None:
        """Nothing more is asked."""
