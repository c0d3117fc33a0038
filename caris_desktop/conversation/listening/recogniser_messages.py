"""Messages between console and recogniser process, in addition to values of the stream table.

The console sends AudioChunk, PlayedSound, PlayedSoundEnded and the robot's UtteranceChanged as they are; the process
answers with Hearing, UtteranceChanged and Problem.
"""

from pathlib import Path
from typing import Literal

from caris_desktop.domain.events import Problem
from caris_desktop.domain.value_class import Value


class RecogniserSettings(Value):
    """Settings of the recogniser; picklable.

    ``model`` is a folder, an address or, for a ``server``, a name; a relative path is resolved in ``folder`` or a
    models folder; empty: the default. ``cloud_models``: a server may be another computer.
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


class UseSilence(Value):
    """To the process: minimum and maximum silence that ends a turn, whatever the probability."""

    at_least_s: float = 0.3
    at_most_s: float = 3.0


class EndTurns(Value):
    """To the process: end all turns because a recording ends or pauses."""


class RecogniserReady(Value):
    """The recogniser is ready for sound.

    ``detail`` is a user text on missing parts, if any.
    """

    model: str
    language: str
    load_s: float
    detail: str = ""


class RecogniserFailed(Value):
    """Recognition is impossible; no more messages follow. A restart would fail in the same way."""

    problem: Problem


class SpokenBy(Value):
    """To the process: speaker of an utterance, for their endpointing delay."""

    utterance_id: str
    person_id: str


class RecogniserAway(Value):
    """The server does not answer: no text until another RecogniserReady."""

    problem: Problem
