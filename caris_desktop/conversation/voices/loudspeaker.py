"""Output device: plays a sound still being synthesised, stops at once, and reports what was heard when."""

import contextlib
import threading
import time
from collections.abc import Callable
from typing import Any

from caris_desktop.conversation.voices.utterance_sound import StreamingBuffer

# Low latency starves PulseAudio's ALSA plug-in. A stream is audible as soon as it is opened, whatever its latency, and
# aborting drops its buffer, so that this delays neither start nor stop.
_LATENCY_S = 0.12
_BLOCK_FRAMES = 512
# An idle sink may first play two seconds of silence.
_STALL_S = 4.0
_HEARTBEAT_S = 0.5
# At its start a device requests its full buffer, possibly more than is ready by then.
_LEAST_AHEAD_S = 0.05
_LOOK_S = 0.003
# Added to the computed end, which some drivers report slightly early.
_TAIL_S = 0.03
_AWAKE_LATENCY_S = 0.5
_AWAKE_BLOCK_FRAMES = 4096
_AWAKE_RATE_HZ = 22050


class DeviceTroubleError(Exception):
    """No sound can be played; ``played_s`` of the utterance was."""

    def __init__(self, detail: str, *, played_s: float = 0.0, hung: bool = False) -> None:
        super().__init__(detail)
        self.played_s = played_s
        self.hung = hung


class _Playback:
    """PortAudio callback: copies and notes times in PortAudio's thread, and waits only for audio that can arrive
    without a gap.

    Times are those at the loudspeaker, including the device's buffer as reported by PortAudio.
    """

    def __init__(
        self,
        sound: StreamingBuffer,
        silenced: threading.Event,
        woken: threading.Event,
        *,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._sound = sound
        self._silenced = silenced
        self._woken = woken
        self._now_ns = now_ns
        self._asked_ns: int | None = None
        self._waiting = threading.Lock()
        self.started_ns: int | None = None
        self.ends_ns: int | None = None
        self.stream_ended = False

    @property
    def played_s(self) -> float:
        """Seconds that the device has accepted."""
        return min(self._sound.position, self._sound.end) / self._sound.rate_hz

    @property
    def heard_s(self) -> float:
        """Seconds that were audible."""
        since_s = 0.0 if self.started_ns is None else (time.monotonic_ns() - self.started_ns) / 1e9
        return max(0.0, min(self.played_s, since_s))

    def fill(self, out: Any, frames: int, times: Any, _status: object) -> None:
        buffered_s = times.outputBufferDacTime - times.currentTime
        if not 0.0 <= buffered_s < _STALL_S:
            buffered_s = _LATENCY_S
        if self._silenced.is_set():
            out[:] = bytes(len(out))
            return
        if self._asked_ns is None:
            self._asked_ns = self._now_ns()
        with self._waiting:
            while self._may_wait(frames, self._asked_ns):
                time.sleep(_LOOK_S)
        out[:] = self._sound.take(frames).tobytes()
        if self.started_ns is None:
            self.started_ns = self._now_ns() + int(buffered_s * 1e9)
            self._woken.set()
        if self.ends_ns is None and self._sound.over:
            self.ends_ns = self.started_ns + self._sound.end * 1_000_000_000 // self._sound.rate_hz
            self._woken.set()

    def _may_wait(self, frames: int, asked_ns: int) -> bool:
        """True if more audio will come before the device runs empty: silence would be an audible gap."""
        sound = self._sound
        if sound.complete or self._silenced.is_set() or sound.end >= sound.position + frames:
            return False
        ahead_s = sound.position / sound.rate_hz - (self._now_ns() - asked_ns) / 1e9
        return ahead_s > _LEAST_AHEAD_S

    def leave(self) -> None:
        """Return once no callback waits, after silencing: aborting a stream may end its thread anywhere."""
        with self._waiting:
            pass

    def on_stream_ended(self) -> None:
        self.stream_ended = True
        self._woken.set()


class Loudspeaker:
    """Output device, reopened for each utterance, so that it may come and go."""

    def __init__(self, device: str, *, awake: bool) -> None:
        """``awake``: a second stream plays silence continuously, since sound servers suspend idle devices."""
        self._device = device or None
        self._sounddevice: Any = None
        self._awake = awake
        self._silence: Any = None
        self.audible = False

    def find_device(self) -> str:
        """Find the device again; return the reason if there is none, else an empty text."""
        try:
            if self._sounddevice is None:
                import sounddevice

                self._sounddevice = sounddevice
            else:
                # PortAudio lists devices only at initialisation.
                self._silence = None
                self._sounddevice._terminate()
                self._sounddevice._initialize()
            if self._device is None and self._sounddevice.default.device[1] < 0:
                self.audible = False
                return "no output device"
            self._sounddevice.check_output_settings(self._device, channels=1, dtype="int16", samplerate=22050)
        except (OSError, ValueError, self._error()) as error:
            self.audible = False
            return " ".join(str(error).split()) or type(error).__name__
        self.audible = True
        return ""

    def stay_awake(self) -> None:
        """Play silence if configured; without it, speech starts later."""
        if not self._awake or not self.audible or self._silence is not None:
            return

        def fill(out: Any, *_: object) -> None:
            out[:] = bytes(len(out))

        with contextlib.suppress(ValueError, self._error()):
            self._silence = self._sounddevice.RawOutputStream(
                samplerate=_AWAKE_RATE_HZ,
                channels=1,
                dtype="int16",
                device=self._device,
                latency=_AWAKE_LATENCY_S,
                blocksize=_AWAKE_BLOCK_FRAMES,
                callback=fill,
            )
            self._silence.start()

    def play(
        self,
        sound: StreamingBuffer,
        *,
        silenced: threading.Event,
        woken: threading.Event,
        tell: Callable[[str, float | int], None],
    ) -> int:
        """Play to the end or until ``silenced``; return the end time in ns. Reports started and playing.

        Raises DeviceTroubleError.
        """
        playback = _Playback(sound, silenced, woken)
        try:
            stream = self._sounddevice.RawOutputStream(
                samplerate=sound.rate_hz,
                channels=1,
                dtype="int16",
                device=self._device,
                latency=_LATENCY_S,
                blocksize=_BLOCK_FRAMES,
                callback=playback.fill,
                finished_callback=playback.on_stream_ended,
            )
            stream.start()
        except (ValueError, self._error()) as error:
            raise DeviceTroubleError(" ".join(str(error).split())) from error
        start_reported = False
        moved, moved_at_s = -1, time.monotonic()
        while True:
            woken.wait(self._wait_s(playback, start_reported=start_reported))
            woken.clear()
            now_ns = time.monotonic_ns()
            if playback.started_ns is not None and now_ns >= playback.started_ns and not start_reported:
                start_reported = True
                tell("started", playback.started_ns)
            if silenced.is_set():
                playback.leave()
                stream.abort()
                ended_ns = time.monotonic_ns()
                stream.close()
                return ended_ns
            if playback.ends_ns is not None and now_ns >= playback.ends_ns + int(_TAIL_S * 1e9):
                stream.abort()
                stream.close()
                return playback.ends_ns
            if playback.stream_ended:
                with contextlib.suppress(self._error()):
                    stream.close()
                raise DeviceTroubleError("the sound device was disconnected", played_s=playback.played_s)
            if sound.position > moved:
                moved, moved_at_s = sound.position, time.monotonic()
            elif playback.ends_ns is None and time.monotonic() - moved_at_s > _STALL_S:
                raise DeviceTroubleError(
                    "the sound device does not accept audio", played_s=playback.played_s, hung=True
                )
            if not sound.complete and sound.position - sound.end > _STALL_S * sound.rate_hz:
                sound.finish("it took too long")
            tell("playing", playback.heard_s)

    def _wait_s(self, playback: _Playback, *, start_reported: bool) -> float:
        if playback.started_ns is not None and not start_reported:
            return max(0.001, playback.started_ns / 1e9 - time.monotonic())
        if playback.ends_ns is None:
            return _HEARTBEAT_S
        return min(_HEARTBEAT_S, max(0.001, playback.ends_ns / 1e9 + _TAIL_S - time.monotonic()))

    def _error(self) -> type[Exception]:
        return OSError if self._sounddevice is None else self._sounddevice.PortAudioError
