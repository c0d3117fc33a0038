"""Microphone process, as audio libraries may hang or crash."""

import logging
import queue
import time
from collections.abc import Callable
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
    messages of ``microphone_messages``.
    """
    _Microphone(connection, source).run()


class _Microphone:
    def __init__(self, connection: Connection, source: str) -> None:
        self._connection = connection
        self._source = source
        self._blocks: queue.SimpleQueue[tuple[int, NDArray[np.int16]] | None] = queue.SimpleQueue()
        self._requested_name: str | None = None
        self._names: tuple[str, ...] = ()
        self._stream: Any = None
        self._rate_hz = SAMPLE_RATE_HZ
        self._received_s = 0.0
        self._settling_until_s = 0.0
        self._opened: MicrophoneOpened | None = None
        self._peak = 0
        self._level_reported_s = self._alive_reported_s = 0.0
        self._failures = 0
        self._retry_at_s = 0.0

    def run(self) -> None:
        self._list()
        try:
            while self._take_commands():
                self._work()
        except (BrokenPipeError, ConnectionResetError):
            _log.info("the console is gone")
        finally:
            self._close()

    def _take_commands(self) -> bool:
        """Handle pending commands; False when the connection is closed."""
        idle_s = 0.5 if self._stream is None else 0.0
        try:
            while self._connection.poll(idle_s):
                idle_s = 0.0
                match self._connection.recv():
                    case OpenMicrophone(name):
                        self._close()
                        self._requested_name, self._failures, self._retry_at_s = name, 0, 0.0
                    case CloseMicrophone():
                        self._requested_name = None
                        self._close()
                    case other:
                        _log.error("unknown command %r", other)
        except (EOFError, OSError):
            return False
        return True

    def _work(self) -> None:
        if self._requested_name is not None and time.monotonic() - self._alive_reported_s >= _ALIVE_EVERY_S:
            self._alive_reported_s = time.monotonic()
            self._connection.send(MicrophoneAlive())
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
            stream = sounddevice.InputStream(
                samplerate=self._rate_hz,
                channels=1,
                dtype="int16",
                device=device,
                blocksize=round(self._rate_hz * _BLOCK_S),
                callback=self._on_block(),
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

    def _on_block(self) -> Callable[[NDArray[np.int16], int, Any, Any], None]:
        blocks, rate_hz = self._blocks, self._rate_hz

        def on_block(samples: NDArray[np.int16], frames: int, times: Any, _status: Any) -> None:
            # In PortAudio's thread: only copy, and note the time of the first sample.
            ago_s = times.currentTime - times.inputBufferAdcTime
            if not 0.0 < ago_s < _PLAUSIBLE_DELAY_S:
                ago_s = frames / rate_hz
            blocks.put((clock.now_ns() - round(ago_s * 1e9), samples.copy()))

        return on_block

    def _list(self) -> Any:
        """List the inputs and report them; return the audio library, None if unavailable."""
        try:
            import sounddevice

            # PortAudio lists devices only at initialisation.
            sounddevice._terminate()
            sounddevice._initialize()
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
