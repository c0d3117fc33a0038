"""What the console and the recogniser's process tell each other, beside the values of the stream table.

The console sends AudioChunk, PlayedSound, PlayedSoundEnded and the robot's UtteranceChanged as they are; the process
answers with Hearing, UtteranceChanged and Problem.
"""

from pathlib import Path
from typing import Literal

from caris_desktop.domain.events import Problem
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class RecogniserSettings:
    """What a run of the recogniser needs; picklable.

    ``model`` is a folder, an address or, of a ``server``, a name; a relative path is one below ``folder`` or in a
    models folder; empty for the usual one. ``cloud_models``: whether a server may be another computer.
    """

    engine: Literal["local", "server"] = "local"
    model: str = ""
    sha256: str = ""
    folder: Path | None = None
    server: str = ""
    language: str = "en"
    cloud_models: bool = True
    allow_download: bool = True
    threads: int = 1
    niceness: int = 6


@dataclass(frozen=True, slots=True)
class UseSilence:
    """To the process: the shortest and the longest silence that ends a turn, from now on."""

    at_least_s: float
    at_most_s: float


@dataclass(frozen=True, slots=True)
class EndTurns:
    """To the process: a recording ends or pauses. Turns under way are over; what is said later is not part of them."""


@dataclass(frozen=True, slots=True)
class RecogniserReady:
    """It listens: sound that is sent from now on is turned into text.

    ``detail`` says what is missing, in words, where something is.
    """

    model: str
    language: str
    load_s: float
    detail: str = ""


@dataclass(frozen=True, slots=True)
class RecogniserFailed:
    """There will be no text; the process sends nothing more. Starting it again would fail in the same way."""

    problem: Problem


@dataclass(frozen=True, slots=True)
class SpokenBy:
    """To the process: who said that utterance. Whoever is known to have a slow way of speaking is given time."""

    utterance_id: str
    person_id: str


@dataclass(frozen=True, slots=True)
class RecogniserAway:
    """The server does not answer: no text until RecogniserReady comes once more."""

    problem: Problem
