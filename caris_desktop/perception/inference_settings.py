"""What a run of inference is told, in words that bring no library along."""

import os
from dataclasses import field
from pathlib import Path
from typing import Literal, get_args

from caris_desktop.domain.value_class import dataclass
from caris_desktop.perception.weights import DetectorChoice

Device = Literal["auto", "cpu", "cuda", "mps"]
TrackerName = Literal["own", "deepsort", "bytetrack", "botsort"]
TRACKERS: tuple[TrackerName, ...] = get_args(TrackerName)
LEAST_CONFIDENCE = 0.1
"""Below it nobody is told of; who is followed may be hardly seen for a while, who is new may not."""


def default_threads() -> int:
    """Half of the cores, at most four: more gain little, and the console needs some.

    On two busy cores a second thread was measured to make a frame slower, since each waits for the other.
    """
    return max(1, min(4, (os.cpu_count() or 2) // 2))


@dataclass(frozen=True, slots=True)
class DetectorSettings:
    """What a scenario says of the detector; picklable.

    ``things`` are the classes beside people that are told of. ``server`` is the address of another machine that looks
    in this one's place, empty for none; without ``other_computers`` that has to be a program on this computer.
    """

    model: DetectorChoice = field(default_factory=DetectorChoice)
    device: Device = "auto"
    things: tuple[str, ...] = ()
    server: str = ""
    other_computers: bool = True


@dataclass(frozen=True, slots=True)
class InferenceSettings:
    """What a run of inference needs; picklable.

    ``weights_path`` is what the user configured, None for what ``detector`` says, which may have to be downloaded: the
    search runs in the child.
    ``recognise_looks``: people who were away are known again by how they look, with a re-identification network beside
    the detector or in a models folder, if there is one.
    Of the trackers ``own`` is :mod:`caris_desktop.perception.following`; the others are there to compare with.
    ``max_hz`` bounds the frames per second, ``max_load`` the share of time spent working, so that a slow model leaves
    room for others. ``niceness`` is added to the child's own (where the system knows such a thing). ``face_model`` is
    the study's network for faces, where it has one; looks that say so are looked at for faces too.
    """

    weights_path: Path | None = None
    detector: DetectorSettings = field(default_factory=DetectorSettings)
    recognise_looks: bool = True
    allow_download: bool = True
    tracker: TrackerName = "own"
    confidence: float = LEAST_CONFIDENCE
    max_hz: float = 30.0
    max_load: float = 0.8
    threads: int = field(default_factory=default_threads)
    niceness: int = 10
    face_model: Path | None = None
