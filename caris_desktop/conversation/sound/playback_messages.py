"""Messages between the console and a streaming playback process."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class BeginPlaying:
    """Start of a stream. ``stream_id`` is returned in reports. ``volume`` is 0 to 1; audio later than ``most_s`` is
    dropped.
    """

    stream_id: str
    volume: float = 1.0
    most_s: float = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class PlayThis:
    """Next samples, shape (samples, channels); channels are mixed."""

    sample_rate_hz: int
    samples: NDArray[np.int16] = field(metadata={"shape": (-1, -1)})


@dataclass(frozen=True, slots=True)
class SetVolume:
    """Set the volume, 0 to 1."""

    volume: float


@dataclass(frozen=True, slots=True)
class EndPlaying:
    """End of the stream. ``at_once``: drop buffered audio."""

    at_once: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class PlaybackStarted:
    """Samples played, the first at ``stamp_ns``, slightly in the future. int16, shape (samples, 1)."""

    stream_id: str
    stamp_ns: int
    sample_rate_hz: int
    samples: NDArray[np.int16] = field(metadata={"shape": (-1, -1)})


@dataclass(frozen=True, slots=True)
class PlayedOut:
    """Everything was played by then."""

    stream_id: str
    stamp_ns: int


@dataclass(frozen=True, slots=True)
class PlaybackFailed:
    """Output is missing or failed; the next stream tries again."""

    stream_id: str
    detail: str


@dataclass(frozen=True, slots=True)
class PlaybackAlive:
    """Heartbeat: the process is not stuck in the audio library. Sent every second while playing."""
