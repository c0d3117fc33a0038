"""What the console and a process that plays sound as it comes tell each other."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class BeginPlaying:
    """Sound follows. ``stream_id`` comes back with what is told of it. ``volume`` is 0 to 1; what is later than
    ``most_s`` is dropped.
    """

    stream_id: str
    volume: float = 1.0
    most_s: float = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class PlayThis:
    """The next of it, shape (samples, channels); several channels are mixed into one."""

    sample_rate_hz: int
    samples: NDArray[np.int16] = field(metadata={"shape": (-1, -1)})


@dataclass(frozen=True, slots=True)
class SetVolume:
    """From now on; 0 to 1."""

    volume: float


@dataclass(frozen=True, slots=True)
class EndPlaying:
    """Nothing more comes. ``at_once``: what is there already is not played either."""

    at_once: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Played:
    """This is heard, its first sample at ``stamp_ns``, which may lie a little ahead. int16, shape (samples, 1)."""

    stream_id: str
    stamp_ns: int
    sample_rate_hz: int
    samples: NDArray[np.int16] = field(metadata={"shape": (-1, -1)})


@dataclass(frozen=True, slots=True)
class PlayedOut:
    """All of it was heard by then."""

    stream_id: str
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class PlaybackFailed:
    """There is no output, or it went away; it is tried again with the next beginning."""

    stream_id: str
    detail: str


@dataclass(frozen=True, slots=True)
class PlaybackAlive:
    """The process has not got stuck in the sound library. Sent every second while it plays."""
