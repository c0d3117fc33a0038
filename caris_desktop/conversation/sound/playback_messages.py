"""Messages between the console and a streaming playback process."""

from dataclasses import field

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value


class BeginPlaying(Value):
    """Start of a stream. ``stream_id`` is returned in reports. ``volume`` is 0 to 1; audio later than ``most_s`` is
    dropped.
    """

    stream_id: str
    volume: float = 1.0
    most_s: float = 0.25


class PlayThis(Value, eq=False):
    """Next samples, shape (samples, channels); channels are mixed."""

    sample_rate_hz: int
    samples: NDArray[np.int16] = field(metadata={"shape": (-1, -1)})


class SetVolume(Value):
    """Set the volume, 0 to 1."""

    volume: float


class EndPlaying(Value):
    """End of the stream. ``at_once``: drop buffered audio."""

    at_once: bool = False


class PlaybackStarted(Value, eq=False):
    """Samples played, the first at ``stamp_ns``, slightly in the future. int16, shape (samples, 1)."""

    stream_id: str
    stamp_ns: int
    sample_rate_hz: int
    samples: NDArray[np.int16] = field(metadata={"shape": (-1, -1)})


class PlayedOut(Value):
    """Everything was played by then."""

    stream_id: str
    stamp_ns: int


class PlaybackFailed(Value):
    """Output is missing or failed; the next stream tries again."""

    stream_id: str
    detail: str


class PlaybackAlive(Value):
    """Heartbeat: the process is not stuck in the audio library. Sent every second while playing."""
