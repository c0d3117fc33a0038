"""Processes of microphone and streaming playback, as audio libraries may hang or crash."""

import abc
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
from caris_desktop.domain.events import Problem
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import MICROPHONE, WIZARD_MICROPHONE
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

# Messages between the console and a microphone process.


class OpenMicrophone(Value):
    """Open the input of this name, empty: the system default; closes another one."""

    name: str


class CloseMicrophone(Value):
    """Close the input."""


class MicrophoneList(Value):
    """Available inputs. Sent at the start and before each opening."""

    names: tuple[str, ...]


class MicrophoneOpened(Value):
    """Sound follows; sent with the first chunk. ``name`` is the opened input."""

    name: str
    sample_rate_hz: int


class MicrophoneLevel(Value):
    """Recent peak level, 0 to 1."""

    peak: float


class MicrophoneAlive(Value):
    """Heartbeat: the process is not stuck in the audio library. Sent every second while open."""


class MicrophoneFailed(Value):
    """No sound; retried until it is closed. Without ``problem``: there is no microphone, and none was requested by
    name.
    """

    problem: Problem | None


_log = logging.getLogger(__name__)
SAMPLE_RATE_HZ = 16_000
# Minimum delay for listeners.
_BLOCK_S = 0.04
_LEVEL_EVERY_S = 0.2
_ALIVE_EVERY_S = 1.0
_TRY_AGAIN_S = (2.0, 4.0, 8.0)
_SILENT_S = 2.0
_PLAUSIBLE_DELAY_S = 2.0
# Sound systems change their buffers at the start, and with them the sample times.
_SETTLING_S = 0.5


def run_microphone(connection: Connection, source: str = MICROPHONE) -> None:
    """Process entry point. Receives OpenMicrophone and CloseMicrophone; sends AudioChunk of ``source``, and the
    messages about the microphone.
    """
    _Microphone(connection, source).run()


class _DeviceProcess:
    """Process of one audio device: commands in, sound and reports out."""

    work_every_s = 0.0  # wait for commands while the device is open

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._stream: Any = None
        self._alive_reported_s = 0.0

    def run(self) -> None:
        """Work until the connection closes."""
        try:
            while self._take_commands():
                self._work()
        except (BrokenPipeError, ConnectionResetError):
            _log.info("the console is gone")
        finally:
            self._close()

    def _take_commands(self) -> bool:
        """Handle pending commands; False when the connection is closed."""
        idle_s = 0.5 if self._stream is None else self.work_every_s
        try:
            while self._connection.poll(idle_s):
                idle_s = 0.0
                self._obey(self._connection.recv())
        except (EOFError, OSError):
            return False
        return True

    def _report_alive(self, heartbeat: object) -> None:
        if time.monotonic() - self._alive_reported_s >= _ALIVE_EVERY_S:
            self._alive_reported_s = time.monotonic()
            self._connection.send(heartbeat)

    @abc.abstractmethod
    def _obey(self, command: object) -> None:
        """Handle one command."""

    @abc.abstractmethod
    def _work(self) -> None:
        """Pass on what the device did, at most one block long."""

    @abc.abstractmethod
    def _close(self) -> None:
        """Close the device, if it is open."""


def _portaudio() -> Any:
    """Audio library with a fresh list of devices, which PortAudio makes only at initialisation."""
    import sounddevice

    sounddevice._terminate()
    sounddevice._initialize()
    return sounddevice


class _Microphone(_DeviceProcess):
    def __init__(self, connection: Connection, source: str) -> None:
        super().__init__(connection)
        self._source = source
        self._blocks: queue.SimpleQueue[tuple[int, NDArray[np.int16]] | None] = queue.SimpleQueue()
        self._requested_name: str | None = None
        self._names: tuple[str, ...] = ()
        self._rate_hz = SAMPLE_RATE_HZ
        self._received_s = 0.0
        self._settling_until_s = 0.0
        self._opened: MicrophoneOpened | None = None
        self._peak = 0
        self._level_reported_s = 0.0
        self._failures = 0
        self._retry_at_s = 0.0

    def run(self) -> None:
        self._list()
        super().run()

    def _obey(self, command: object) -> None:
        match command:
            case OpenMicrophone(name):
                self._close()
                self._requested_name, self._failures, self._retry_at_s = name, 0, 0.0
            case CloseMicrophone():
                self._requested_name = None
                self._close()
            case other:
                _log.error("unknown command %r", other)

    def _work(self) -> None:
        if self._requested_name is not None:
            self._report_alive(MicrophoneAlive())
        if self._stream is None:
            if self._requested_name is not None and time.monotonic() >= self._retry_at_s:
                self._open(self._requested_name)
            return
        try:
            block = self._blocks.get(timeout=_BLOCK_S)
        except queue.Empty:
            if time.monotonic() - self._received_s > _SILENT_S:
                self._fail(QT_TR_NOOP("no sound is received"))
            return
        if block is None:
            self._fail(QT_TR_NOOP("it was disconnected"))
            return
        self._received_s = time.monotonic()
        if self._received_s < self._settling_until_s:
            return
        if self._opened is not None:
            self._connection.send(self._opened)
            self._opened = None
        stamp_ns, samples = block
        self._connection.send(AudioChunk(stamp_ns, self._source, self._rate_hz, samples))
        self._peak = max(self._peak, int(np.abs(samples.astype(np.int32)).max(initial=0)))
        if self._received_s - self._level_reported_s >= _LEVEL_EVERY_S:
            self._connection.send(MicrophoneLevel(self._peak / 32768))
            self._level_reported_s, self._peak = self._received_s, 0

    def _open(self, name: str) -> None:
        try:
            sounddevice = self._list()
            if sounddevice is None or not (self._names or name):
                self._fail("")
                return
            device = name or None
            info = sounddevice.query_devices(device, "input")
            self._rate_hz = _usable_rate(sounddevice, device, info)
            blocks, rate_hz = self._blocks, self._rate_hz

            def on_block(samples: NDArray[np.int16], frames: int, times: Any, _status: Any) -> None:
                # In PortAudio's thread: only copy, and note the time of the first sample.
                ago_s = times.currentTime - times.inputBufferAdcTime
                if not 0.0 < ago_s < _PLAUSIBLE_DELAY_S:
                    ago_s = frames / rate_hz
                blocks.put((clock.now_ns() - round(ago_s * 1e9), samples.copy()))

            stream = sounddevice.InputStream(
                samplerate=self._rate_hz,
                channels=1,
                dtype="int16",
                device=device,
                blocksize=round(self._rate_hz * _BLOCK_S),
                callback=on_block,
                finished_callback=lambda: self._blocks.put(None),
            )
            stream.start()
        except Exception as error:
            # PortAudio raises its own types, and ValueError for a missing device.
            _log.info("the microphone %r was not opened", name, exc_info=True)
            self._fail(" ".join(str(error).split()) or type(error).__name__)
            return
        self._stream, self._received_s, self._failures = stream, time.monotonic(), 0
        # Push-to-talk speech must be complete.
        self._settling_until_s = 0.0 if self._source == WIZARD_MICROPHONE else self._received_s + _SETTLING_S
        self._opened = MicrophoneOpened(str(info["name"]), self._rate_hz)

    def _list(self) -> Any:
        """List the inputs and report them; return the audio library, None if unavailable."""
        try:
            sounddevice = _portaudio()
            names = tuple(
                dict.fromkeys(device["name"] for device in sounddevice.query_devices() if device["max_input_channels"])
            )
        except Exception:
            _log.info("no sound inputs", exc_info=True)
            sounddevice, names = None, ()
        self._names = names
        self._connection.send(MicrophoneList(names))
        return sounddevice

    def _fail(self, reason: str) -> None:
        self._close()
        self._retry_at_s = time.monotonic() + _TRY_AGAIN_S[min(self._failures, len(_TRY_AGAIN_S) - 1)]
        self._failures += 1
        if self._failures > 1:
            return
        if not reason:
            self._connection.send(MicrophoneFailed(None))
            return
        is_wizards = self._source == WIZARD_MICROPHONE
        self._connection.send(
            MicrophoneFailed(
                Problem(
                    clock.now_ns(),
                    "warning",
                    localized(
                        QT_TR_NOOP("Your microphone is not working ({why}).")
                        if is_wizards
                        else QT_TR_NOOP("The microphone is not working ({why})."),
                        why=reason,
                    ),
                    QT_TR_NOOP("Your speech is not heard, recorded or transcribed.")
                    if is_wizards
                    else QT_TR_NOOP("Speech there is not heard, recorded or transcribed."),
                    QT_TR_NOOP(
                        "Plug it in, or choose another one in the Window menu. The console tries again automatically."
                    ),
                    until="own_microphone" if is_wizards else "microphone",
                )
            )
        )

    def _close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            try:
                stream.abort()
                stream.close()
            except Exception:
                _log.info("closing the microphone", exc_info=True)
        while not self._blocks.empty():
            self._blocks.get()


def _usable_rate(sounddevice: Any, device: str | None, info: Any) -> int:
    """16 kHz if the input supports it, which suffices for speech; else its default rate."""
    try:
        sounddevice.check_input_settings(device, channels=1, dtype="int16", samplerate=SAMPLE_RATE_HZ)
    except (ValueError, sounddevice.PortAudioError):
        return int(info["default_samplerate"])
    return SAMPLE_RATE_HZ


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


# Low latency starves PulseAudio's ALSA plug-in.
_LATENCY_S = 0.08
_PLAYED_BLOCK_S = 0.02


def run_playback(connection: Connection, device: str = "") -> None:
    """Process entry point. ``device`` is part of an output's name, empty:
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
        self.waiting = 0
        self._playing = False
        self._ending = False
        self.dropped = 0

    def push(self, samples: NDArray[np.int16]) -> None:
        """Add samples, shape (n,)."""
        self._ending = False
        if self.waiting > 2 * self._ahead and max(int(samples.max(initial=0)), -int(samples.min(initial=0))) < _QUIET:
            self.dropped += 1
            return
        self._pieces.append(samples)
        self.waiting += len(samples)
        if self.waiting > self._most:
            self._take(self.waiting - self._ahead)
            self.dropped += 1

    def finish(self) -> None:
        """End of input: the rest is played, however short."""
        self._ending = True

    def pull(self, count: int) -> tuple[NDArray[np.int16], int]:
        """Samples to play now, shape (count,), padded with silence, and the number of real ones."""
        out = np.zeros(count, np.int16)
        if not self._playing and (self.waiting >= self._ahead or (self._ending and self.waiting)):
            self._playing = True
        if not self._playing:
            return out, 0
        sound = self._take(count)
        out[: len(sound)] = sound
        # After running empty, buffer again before playing.
        self._playing = self.waiting > 0
        return out, len(sound)

    def _take(self, count: int) -> NDArray[np.int16]:
        taken: list[NDArray[np.int16]] = []
        missing = min(count, self.waiting)
        self.waiting -= missing
        while missing:
            piece = self._pieces.popleft()
            if len(piece) > missing:
                self._pieces.appendleft(piece[missing:])
                piece = piece[:missing]
            missing -= len(piece)
            taken.append(piece)
        return np.concatenate(taken) if taken else np.zeros(0, np.int16)


class _Playback(_DeviceProcess):
    work_every_s = 0.01

    def __init__(self, connection: Connection, device: str | None) -> None:
        super().__init__(connection)
        self._device = device
        self._stream_id = ""
        self._volume, self._most_s = 1.0, 0.25
        self._rate_hz = 0
        self._buffer: JitterBuffer | None = None
        self._lock = threading.Lock()
        self._played: queue.SimpleQueue[tuple[int, NDArray[np.int16]] | None] = queue.SimpleQueue()
        self._played_until_ns = 0
        self._ending = False

    def run(self) -> None:
        with contextlib.suppress(OSError, ImportError):
            import sounddevice  # noqa: F401 - the import is slow, and speech must not wait for it

        super().run()

    def _obey(self, command: object) -> None:
        match command:
            case BeginPlaying(stream_id, volume, most_s):
                self._close()
                self._stream_id, self._volume, self._most_s = stream_id, volume, most_s
            case PlayThis(rate_hz, samples) if self._stream_id:
                if self._stream is None or rate_hz != self._rate_hz:
                    self._open(rate_hz)
                if self._buffer is None:
                    return
                mono = samples[:, 0] if samples.shape[1] == 1 else samples.mean(axis=1)
                with self._lock:
                    self._buffer.push((mono * self._volume).astype(np.int16))
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

    def _work(self) -> None:
        if self._stream is None:
            return
        self._report_alive(PlaybackAlive())
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

            stream = _portaudio().RawOutputStream(
                samplerate=rate_hz,
                channels=1,
                dtype="int16",
                device=self._device,
                latency=_LATENCY_S,
                blocksize=round(rate_hz * _PLAYED_BLOCK_S),
                callback=fill,
                finished_callback=lambda: self._played.put(None),
            )
            stream.start()
        except Exception as error:
            # PortAudio raises its own types, and ValueError for a missing device.
            _log.info("no sound is played", exc_info=True)
            self._fail(" ".join(str(error).split()) or type(error).__name__)
            return
        self._stream, self._buffer, self._rate_hz = stream, buffer, rate_hz

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
