"""Voice engine: the killable part of speech synthesis that may hang or crash.

Run as ``python -m caris_desktop.conversation.voice_engine``. Commands are JSON lines on stdin, events JSON lines on
stdout, each followed by ``bytes`` bytes of audio; the first input line has the settings. One utterance at a time. It
exits when stdin closes.
"""

import contextlib
import functools
import json
import os
import queue
import shutil
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import IO, Any

import numpy as np

from caris_desktop.conversation.synthesis_messages import SynthesisSettings
from caris_desktop.conversation.voices.utterance_sound import (
    RenderingStoppedError,
    Samples,
    SoundCache,
    Stop,
    StreamingBuffer,
    Voice,
    trimmed,
    words_of,
)
from caris_desktop.conversation.voices.voice_selection import every_voice, open_voice
from caris_desktop.domain.plugins import PluginError
from caris_desktop.domain.process_settings import title_process

MAX_STORED_BYTES = 24_000_000
"""Nine minutes of a usual voice."""

OnPart = Callable[[int, Samples], None]


class _Making:
    """One text in synthesis. A listener may join when parts are ready.

    ``is_draft``: it is still being typed.
    """

    def __init__(self, text: str, *, is_draft: bool = False) -> None:
        self.text = text
        self.is_draft = is_draft
        self.stop = Stop()
        self.parts: list[Samples] = []
        self._telling = threading.Lock()
        self._listener: tuple[StreamingBuffer, OnPart] | None = None

    @property
    def playing(self) -> bool:
        return self._listener is not None

    def play(self, sound: StreamingBuffer, on_part: OnPart) -> None:
        """Send the ready parts at once, and others as they come. Before `finish`."""
        with self._telling:
            for part in self.parts:
                on_part(sound.append(part), part)
            self._listener = sound, on_part

    def add(self, part: Samples) -> None:
        with self._telling:
            self.parts.append(part)
            if self._listener is not None:
                sound, on_part = self._listener
                on_part(sound.append(part), part)

    def finish(self, trouble: str) -> None:
        if self._listener is not None:
            self._listener[0].finish(trouble)


class Rendering:
    """Synthesis worker: a thread that renders requested text first, and likely text in advance.

    One voice with its cached audio. ``run`` is the thread function; other methods are for other threads.
    """

    def __init__(self, voice: Voice, *, cache_bytes: int = MAX_STORED_BYTES) -> None:
        self._voice = voice
        self._cache = SoundCache(cache_bytes)
        self._changed = threading.Condition()
        self._pending: _Making | None = None
        self._making: _Making | None = None
        self._draft = ""
        self._ahead: deque[str] = deque()
        self._prepared: tuple[str, ...] = ()
        self._tuned: tuple[float, float] | None = None
        self._ended = False

    def say(self, text: str, sound: StreamingBuffer, on_part: OnPart) -> None:
        """Render now into ``sound``; ``told(frame, samples)`` is called with each part as it is ready.

        Advance rendering pauses until this is complete; if it is rendering this text, it is continued.
        """
        with self._changed:
            making = self._making
            if making is not None and making.text == text and not (making.playing or making.stop.is_set):
                making.play(sound, on_part)
                return
            self._pending = _Making(text)
            self._pending.play(sound, on_part)
            if making is not None:
                making.stop.set()
            self._changed.notify()

    def stop(self) -> None:
        """Cancel the requested text."""
        with self._changed:
            self._pending = None
            if self._making is not None and self._making.playing:
                self._making.stop.set()

    def draft(self, text: str) -> None:
        """Render this before all other texts in advance, as it may be requested at any time. Empty:
        nothing is typed.
        """
        with self._changed:
            self._draft = "" if self._cache.get(text) is not None else text
            making = self._making
            if making is not None and not making.playing and making.text != text and (self._draft or making.is_draft):
                making.stop.set()
            self._changed.notify()

    def prepare(self, texts: Sequence[str]) -> None:
        """Texts to render in advance, in order; replaces earlier ones."""
        with self._changed:
            self._cache.want(texts)
            self._prepared = tuple(texts)
            self._ahead = deque(texts)
            self._changed.notify()

    def tune(self, rate: float, volume: float) -> None:
        """Settings from the next utterance on; cached audio is rendered again."""
        with self._changed:
            self._tuned = (rate, volume)
            self._changed.notify()

    def end(self) -> None:
        with self._changed:
            self._ended = True
            if self._making is not None:
                self._making.stop.set()
            self._changed.notify()

    def run(self) -> None:
        while True:
            with self._changed:
                while not (self._pending or self._draft or self._ahead or self._tuned or self._ended):
                    self._changed.wait()
                if self._ended:
                    return
                if self._tuned is not None:
                    self._voice.tune(*self._tuned)
                    self._tuned = None
                    self._cache.clear()
                    self._ahead = deque(self._prepared)
                    continue
                making = self._next()
                cached = self._cache.get(making.text)
                if cached is not None and not making.playing:
                    continue
                self._making = making
            begun_s = time.monotonic()
            self._make(making, cached)
            if not (making.is_draft or making.playing):
                # Not urgent: leave half of the processor time to others.
                with self._changed:
                    if not (self._ended or self._pending or self._draft):
                        self._changed.wait(time.monotonic() - begun_s)

    def _next(self) -> _Making:
        if self._pending is not None:
            making, self._pending = self._pending, None
            return making
        if self._draft:
            draft, self._draft = self._draft, ""
            return _Making(draft, is_draft=True)
        return _Making(self._ahead.popleft())

    def _make(self, making: _Making, cached: Samples | None) -> None:
        trouble = ""
        try:
            parts = trimmed(self._voice.parts(making.text, making.stop), self._voice.rate_hz, self._voice.least_audible)
            for part in parts if cached is None else [cached]:
                making.stop.check()
                making.add(part)
        except RenderingStoppedError:
            trouble = "it was interrupted"
        except Exception as error:
            traceback.print_exc()
            trouble = words_of(error)
        with self._changed:
            self._making = None
            if making.stop.is_set and making.text in self._prepared:
                self._ahead.appendleft(making.text)
            elif not trouble and making.parts:
                self._cache.put(making.text, np.concatenate(making.parts))
        making.finish(trouble or ("" if making.parts else "the voice produced no audio"))


# Low latency starves PulseAudio's ALSA plug-in. A stream is audible as soon as it is opened, whatever its latency, and
# aborting drops its buffer, so that this delays neither start nor stop.
_LATENCY_S = 0.12
_BLOCK_FRAMES = 512
# An idle sink may first play two seconds of silence.
_STALL_S = 4.0
_HEARTBEAT_S = 0.5
# At its start a device requests its full buffer, possibly more than is ready by then.
_LEAST_AHEAD_S = 0.05
_POLL_S = 0.003
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
        self._requested_ns: int | None = None
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
        if self._requested_ns is None:
            self._requested_ns = self._now_ns()
        with self._waiting:
            while self._may_wait(frames, self._requested_ns):
                time.sleep(_POLL_S)
        out[:] = self._sound.read(frames).tobytes()
        if self.started_ns is None:
            self.started_ns = self._now_ns() + int(buffered_s * 1e9)
            self._woken.set()
        if self.ends_ns is None and self._sound.over:
            self.ends_ns = self.started_ns + self._sound.end * 1_000_000_000 // self._sound.rate_hz
            self._woken.set()

    def _may_wait(self, frames: int, requested_ns: int) -> bool:
        """True if more audio will come before the device runs empty: silence would be an audible gap."""
        sound = self._sound
        if sound.complete or self._silenced.is_set() or sound.end >= sound.position + frames:
            return False
        ahead_s = sound.position / sound.rate_hz - (self._now_ns() - requested_ns) / 1e9
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
        tell: Callable[..., None],
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
                tell("started", at_ns=playback.started_ns)
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
            tell("playing", played_s=playback.heard_s)

    def _wait_s(self, playback: _Playback, *, start_reported: bool) -> float:
        if playback.started_ns is not None and not start_reported:
            return max(0.001, playback.started_ns / 1e9 - time.monotonic())
        if playback.ends_ns is None:
            return _HEARTBEAT_S
        return min(_HEARTBEAT_S, max(0.001, playback.ends_ns / 1e9 + _TAIL_S - time.monotonic()))

    def _error(self) -> type[Exception]:
        return OSError if self._sounddevice is None else self._sounddevice.PortAudioError


class _Engine:
    def __init__(self, events: IO[bytes]) -> None:
        self._events = events
        self._telling = threading.Lock()
        self._commands: queue.SimpleQueue[tuple[str, int]] = queue.SimpleQueue()
        self._silenced = threading.Event()
        self._woken = threading.Event()
        self._rendering: Rendering | None = None
        self._latest: dict[str, tuple[Any, ...]] = {}  # of each command that lasts, also before the voice is loaded

    def run(self, settings: dict[str, Any], folder: Path) -> None:
        threading.Thread(target=self._read, args=(folder,), name="commands", daemon=True).start()
        choice = SynthesisSettings(**{each.name: settings[each.name] for each in fields(SynthesisSettings)})
        try:
            voice, why_not = open_voice(choice, folder, self._report_switched_off)
        except Exception as error:
            traceback.print_exc()
            self._notify("broken", detail=words_of(error))
            return
        rendering = self._rendering = Rendering(voice)
        threading.Thread(target=rendering.run, name="rendering", daemon=True).start()
        for do, values in tuple(self._latest.items()):
            getattr(rendering, do)(*values)
        self._notify("ready", voice=voice.name, why_not=why_not)
        loudspeaker = Loudspeaker(settings["device"], awake=settings["at_hand"])
        if settings["look"]:
            trouble = loudspeaker.find_device()
            # Before the console relies on it: a hanging sound server blocks this, too.
            loudspeaker.stay_awake()
            self._report_device(trouble)
        if settings["at_hand"]:
            # In a thread: speech must not wait for the system's voice list.
            threading.Thread(target=self._report_voices, args=(choice, voice), name="voices", daemon=True).start()
        while True:
            text, number = self._commands.get()
            sound = StreamingBuffer(voice.rate_hz, self._woken.set)
            rendering.say(text, sound, functools.partial(self._report_part, voice.rate_hz, number))
            self._say(sound, rendering, loudspeaker)
            loudspeaker.stay_awake()

    def _read(self, folder: Path) -> None:
        for line in sys.stdin:
            command = json.loads(line)
            match command["do"]:
                case "silence":
                    self._silenced.set()
                    self._woken.set()
                case "prepare" | "draft" | "tune" as do:
                    values = self._latest[do] = tuple(value for name, value in command.items() if name != "do")
                    if self._rendering is not None:
                        getattr(self._rendering, do)(*values)
                case "say":
                    # Cleared here, in command order, so that a later silence command is never lost.
                    self._silenced.clear()
                    self._commands.put((command["text"], command["number"]))
        # Usually the parent removes it; if the parent was killed, nothing else would.
        shutil.rmtree(folder, ignore_errors=True)
        # The main thread may hang, and no listener is left.
        os._exit(0)

    def _say(self, sound: StreamingBuffer, rendering: Rendering, loudspeaker: Loudspeaker) -> None:
        try:
            while not (sound.begun or sound.complete or self._silenced.is_set()):
                self._woken.wait()
                self._woken.clear()
            if not sound.begun and not self._silenced.is_set():
                self._notify("unrendered", detail=sound.trouble)
            else:
                self._play(sound, loudspeaker)
        finally:
            rendering.stop()

    def _play(self, sound: StreamingBuffer, loudspeaker: Loudspeaker) -> None:
        if not loudspeaker.audible and not self._silenced.is_set():
            self._report_device(loudspeaker.find_device())
        for attempt in (1, 2):
            if self._silenced.is_set():
                self._notify("silenced", at_ns=time.monotonic_ns())
                return
            if not loudspeaker.audible:
                self._report_inaudible(sound, played_s=0.0)
                return
            try:
                ended_ns = loudspeaker.play(sound, silenced=self._silenced, woken=self._woken, tell=self._notify)
            except DeviceTroubleError as trouble:
                if trouble.hung:
                    self._report_device(str(trouble))
                    self._report_inaudible(sound, played_s=trouble.played_s)
                    # Closing the stream may hang as well; only a new process helps.
                    os._exit(3)
                reason = loudspeaker.find_device()
                if attempt == 1 and trouble.played_s == 0.0 and loudspeaker.audible:
                    sound.rewind()
                    continue
                loudspeaker.audible = False
                self._report_device(reason or str(trouble))
                self._report_inaudible(sound, played_s=trouble.played_s)
                return
            if self._silenced.is_set():
                self._notify("silenced", at_ns=ended_ns)
            elif sound.trouble:
                self._notify("unrendered", detail=sound.trouble)
            else:
                self._notify("finished", at_ns=ended_ns)
            return

    def _report_switched_off(self, error: PluginError) -> None:
        self._notify("switched_off", plugin=error.plugin.name, package=error.plugin.package, reason=error.reason)

    def _report_voices(self, choice: SynthesisSettings, voice: Voice) -> None:
        try:
            self._notify("voices", voices=every_voice(choice, voice))
        except Exception:
            traceback.print_exc()

    def _report_inaudible(self, sound: StreamingBuffer, *, played_s: float) -> None:
        """Report the duration of an inaudible utterance once it is synthesised."""
        while not (sound.complete or self._silenced.is_set()):
            self._woken.wait()
            self._woken.clear()
        self._notify("inaudible", played_s=played_s)

    def _report_part(self, rate_hz: int, number: int, at: int, part: Samples) -> None:
        self._notify("part", sound=part.astype("<i2").tobytes(), at=at, rate_hz=rate_hz, number=number)

    def _report_device(self, trouble: str) -> None:
        self._notify("device", audible=not trouble, detail=trouble)

    def _notify(self, event: str, *, sound: bytes = b"", **values: Any) -> None:
        line = json.dumps({"event": event, "bytes": len(sound), **values}).encode() + b"\n"
        # If the parent has ended, the command thread cleans up and exits.
        with self._telling, contextlib.suppress(BrokenPipeError):
            self._events.write(line + sound)
            self._events.flush()


def main() -> None:
    # pyttsx3 prints to stdout, which carries our events.
    events = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    title_process("voice")
    settings = json.loads(sys.stdin.readline())
    _Engine(events).run(settings, Path(settings["files_folder"]))


if __name__ == "__main__":
    main()
