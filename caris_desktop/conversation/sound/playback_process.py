"""Streaming playback process, as audio libraries may hang or crash."""

import contextlib
import logging
import queue
import threading
import time
from collections import deque
from dataclasses import field
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.value_class import Value

# Messages between the console and a streaming playback process.


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


_log = logging.getLogger(__name__)
_ALIVE_EVERY_S = 1.0
# Low latency starves PulseAudio's ALSA plug-in.
_LATENCY_S = 0.08
_BLOCK_S = 0.02
_PLAUSIBLE_DELAY_S = 2.0


def run_playback(connection: Connection, device: str = "") -> None:
    """Process entry point. Uses the messages of ``playback_messages``. ``device`` is part of an output's name, empty:
    the system default.
    """
    _Playback(connection, device or None).run()


_AHEAD_S = 0.08
_QUIET = 400
"""Level below which nobody speaks, of 32768."""


class JitterBuffer:
    """Jitter buffer: regular playback of irregular audio, preferring gaps to delay.

    Single-channel buffer. Playback begins with ``_AHEAD_S`` buffered; beyond ``most_s`` the oldest samples are dropped,
    so that the delay does not grow. An initial backlog is reduced by shortening quiet passages.
    """

    def __init__(self, rate_hz: int, most_s: float = 0.25) -> None:
        self._ahead = round(_AHEAD_S * rate_hz)
        self._most = round(most_s * rate_hz)
        self._pieces: deque[NDArray[np.int16]] = deque()
        self._waiting = 0
        self._playing = False
        self._ending = False
        self.dropped = 0

    @property
    def waiting(self) -> int:
        """Number of buffered samples."""
        return self._waiting

    def push(self, samples: NDArray[np.int16]) -> None:
        """Add samples, shape (n,)."""
        self._ending = False
        if self._waiting > 2 * self._ahead and max(int(samples.max(initial=0)), -int(samples.min(initial=0))) < _QUIET:
            self.dropped += 1
            return
        self._pieces.append(samples)
        self._waiting += len(samples)
        if self._waiting > self._most:
            self._take(self._waiting - self._ahead)
            self.dropped += 1

    def finish(self) -> None:
        """End of input: the rest is played, however short."""
        self._ending = True

    def pull(self, count: int) -> tuple[NDArray[np.int16], int]:
        """Samples to play now, shape (count,), padded with silence, and the number of real ones."""
        out = np.zeros(count, np.int16)
        if not self._playing and (self._waiting >= self._ahead or (self._ending and self._waiting)):
            self._playing = True
        if not self._playing:
            return out, 0
        sound = self._take(count)
        out[: len(sound)] = sound
        # After running empty, buffer again before playing.
        self._playing = self._waiting > 0
        return out, len(sound)

    def _take(self, count: int) -> NDArray[np.int16]:
        taken: list[NDArray[np.int16]] = []
        missing = min(count, self._waiting)
        self._waiting -= missing
        while missing:
            piece = self._pieces.popleft()
            if len(piece) > missing:
                self._pieces.appendleft(piece[missing:])
                piece = piece[:missing]
            missing -= len(piece)
            taken.append(piece)
        return np.concatenate(taken) if taken else np.zeros(0, np.int16)


class _Playback:
    def __init__(self, connection: Connection, device: str | None) -> None:
        self._connection = connection
        self._device = device
        self._stream: Any = None
        self._stream_id = ""
        self._volume, self._most_s = 1.0, 0.25
        self._rate_hz = 0
        self._buffer: JitterBuffer | None = None
        self._lock = threading.Lock()
        self._played: queue.SimpleQueue[tuple[int, NDArray[np.int16]] | None] = queue.SimpleQueue()
        self._played_until_ns = 0
        self._ending = False
        self._alive_reported_s = 0.0

    def run(self) -> None:
        with contextlib.suppress(OSError, ImportError):
            import sounddevice  # noqa: F401 - the import is slow, and speech must not wait for it

        try:
            while self._take_commands():
                self._work()
        except (BrokenPipeError, ConnectionResetError):
            _log.info("the console is gone")
        finally:
            self._close()

    def _take_commands(self) -> bool:
        """Handle pending commands; False when the connection is closed."""
        idle_s = 0.5 if self._stream is None else 0.01
        try:
            while self._connection.poll(idle_s):
                idle_s = 0.0
                self._obey(self._connection.recv())
        except (EOFError, OSError):
            return False
        return True

    def _obey(self, command: Any) -> None:
        match command:
            case BeginPlaying(stream_id, volume, most_s):
                self._close()
                self._stream_id, self._volume, self._most_s = stream_id, volume, most_s
            case PlayThis(rate_hz, samples) if self._stream_id:
                self._play(rate_hz, samples)
            case SetVolume(volume):
                self._volume = volume
            case EndPlaying(at_once) if self._stream_id:
                self._ending = True
                if self._buffer is None or at_once:
                    self._end()
                else:
                    with self._lock:
                        self._buffer.finish()
            case PlayThis() | EndPlaying():
                pass  # failed earlier, with more data on its way
            case other:
                _log.error("unknown command %r", other)

    def _play(self, rate_hz: int, samples: NDArray[np.int16]) -> None:
        if self._stream is None or rate_hz != self._rate_hz:
            self._open(rate_hz)
        if self._buffer is None:
            return
        mono = samples[:, 0] if samples.shape[1] == 1 else samples.mean(axis=1)
        with self._lock:
            self._buffer.push((mono * self._volume).astype(np.int16))

    def _work(self) -> None:
        if self._stream is None:
            return
        if time.monotonic() - self._alive_reported_s >= _ALIVE_EVERY_S:
            self._alive_reported_s = time.monotonic()
            self._connection.send(PlaybackAlive())
        while not self._played.empty():
            part = self._played.get()
            if part is None:
                self._fail("the sound device was disconnected")
                return
            stamp_ns, sound = part
            self._played_until_ns = stamp_ns + len(sound) * 1_000_000_000 // self._rate_hz
            self._connection.send(PlaybackStarted(self._stream_id, stamp_ns, self._rate_hz, sound[:, None]))
        if self._ending and self._buffer is not None and not self._buffer.waiting and self._played.empty():
            self._end()

    def _open(self, rate_hz: int) -> None:
        self._close_stream()
        buffer = JitterBuffer(rate_hz, self._most_s)
        try:
            import sounddevice

            # PortAudio lists devices only at initialisation.
            sounddevice._terminate()
            sounddevice._initialize()
            stream = sounddevice.RawOutputStream(
                samplerate=rate_hz,
                channels=1,
                dtype="int16",
                device=self._device,
                latency=_LATENCY_S,
                blocksize=round(rate_hz * _BLOCK_S),
                callback=self._filler(buffer, rate_hz),
                finished_callback=lambda: self._played.put(None),
            )
            stream.start()
        except Exception as error:
            # PortAudio raises its own types, and ValueError for a missing device.
            _log.info("no sound is played", exc_info=True)
            self._fail(" ".join(str(error).split()) or type(error).__name__)
            return
        self._stream, self._buffer, self._rate_hz = stream, buffer, rate_hz

    def _filler(self, buffer: JitterBuffer, rate_hz: int) -> Any:
        played, lock = self._played, self._lock

        def fill(out: Any, frames: int, times: Any, _status: Any) -> None:
            # In PortAudio's thread: only copy, and note the playback time.
            with lock:
                samples, sound = buffer.pull(frames)
            out[:] = samples.tobytes()
            if sound:
                ahead_s = times.outputBufferDacTime - times.currentTime
                if not 0.0 <= ahead_s < _PLAUSIBLE_DELAY_S:
                    ahead_s = _LATENCY_S + frames / rate_hz
                played.put((clock.now_ns() + round(ahead_s * 1e9), samples[:sound]))

        return fill

    def _end(self) -> None:
        """End the stream after the device's buffer has been played."""
        played_out_ns = max(self._played_until_ns, clock.now_ns()) if self._buffer is not None else clock.now_ns()
        stream_id = self._stream_id
        self._close()
        self._connection.send(PlayedOut(stream_id, played_out_ns))

    def _fail(self, reason: str) -> None:
        stream_id = self._stream_id
        self._close()
        self._connection.send(PlaybackFailed(stream_id, reason))

    def _close(self) -> None:
        self._stream_id, self._ending = "", False
        self._close_stream()

    def _close_stream(self) -> None:
        stream, self._stream, self._buffer = self._stream, None, None
        if stream is not None:
            with contextlib.suppress(Exception):
                # Not abort: the device's buffer holds the end of a sentence.
                stream.stop()
                stream.close()
        while not self._played.empty():
            self._played.get()
