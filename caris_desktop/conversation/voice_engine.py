"""The part of speech that may hang or crash: renders with pyttsx3, plays through PortAudio, and can be killed any time.

Run as ``python -m caris_desktop.conversation.voice_engine``. Commands come as JSON lines on stdin, events leave as JSON
lines on stdout; the first line in is the settings. One utterance at a time. It ends with its stdin.
"""

import array
import contextlib
import json
import os
import queue
import shutil
import sys
import threading
import time
import traceback
import wave
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from caris_desktop.domain.process_title import title_process

SOUND_FILE = "utterance.pcm"
# Low latency starves PulseAudio's ALSA plug-in; aborting a stream drops what is buffered, so this delays no silence.
_LATENCY_S = 0.12
_BLOCK_FRAMES = 512
# An idle sink may first play out two seconds of its own silence.
_STALL_S = 4.0
_HEARTBEAT_S = 0.5
# Added to the computed end, which some drivers report a little early.
_TAIL_S = 0.03
# Voices put a third of a second of silence behind what they say, and some before it. Of the loudest sample, this much
# is heard; so much is left of the silence that the sound begins and ends softly.
_HEARD_SHARE = 0.005
_SILENCE_KEPT_S = 0.005


class _DeviceTroubleError(Exception):
    """No sound can be played; ``played_s`` of the utterance was."""

    def __init__(self, detail: str, *, played_s: float = 0.0, hung: bool = False) -> None:
        super().__init__(detail)
        self.played_s = played_s
        self.hung = hung


@dataclass(frozen=True, slots=True)
class _Pcm:
    """Signed 16 bit, one channel."""

    samples: bytes
    rate_hz: int

    @property
    def duration_s(self) -> float:
        return len(self.samples) / 2 / self.rate_hz


def _without_silence(pcm: _Pcm) -> _Pcm:
    """From the first to the last sample that is heard, so that its playing begins and ends when the words do."""
    samples = array.array("h", pcm.samples)
    if sys.byteorder == "big":
        samples.byteswap()
    loudest = max(samples)
    least = max(1, round(max(loudest, -min(samples)) * _HEARD_SHARE))
    first = next((number for number, sample in enumerate(samples) if abs(sample) >= least), 0)
    last = next((number for number in range(len(samples) - 1, first, -1) if abs(samples[number]) >= least), first)
    kept = round(_SILENCE_KEPT_S * pcm.rate_hz)
    return _Pcm(pcm.samples[2 * max(0, first - kept) : 2 * (last + 1 + kept)], pcm.rate_hz)


class _Renderer:
    """pyttsx3 used in the one way that works: ``save_to_file``, one file per utterance."""

    def __init__(self, settings: dict[str, Any], folder: Path) -> None:
        import pyttsx3

        self._engine = pyttsx3.init()
        self._completions: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._engine.connect("finished-utterance", lambda name, completed: self._completions.put(completed))
        if settings["voice"]:
            self._engine.setProperty("voice", settings["voice"])
        self._engine.setProperty("rate", settings["rate_wpm"])
        self._engine.setProperty("volume", settings["volume"])
        # The first run returns after 10 ms, whatever it was to do.
        self._engine.runAndWait()
        self.voice = str(self._engine.getProperty("voice") or "")
        self._path = folder / "utterance.wav"

    def render(self, text: str) -> _Pcm:
        for pause_s in (0.05, 0.1, 0.2, 0.0):
            pcm = self._attempt(text)
            if pcm is not None:
                return pcm
            time.sleep(pause_s)
        raise ValueError("the voice made no sound")

    def _attempt(self, text: str) -> _Pcm | None:
        """None when pyttsx3 cancelled its own work, which it does when espeak still seems busy with the last."""
        while not self._completions.empty():
            self._completions.get()
        self._path.unlink(missing_ok=True)
        self._engine.save_to_file(text, str(self._path))
        self._engine.runAndWait()
        completions = [self._completions.get()]
        while not self._completions.empty():
            completions.append(self._completions.get())
        if not all(completions):
            return None
        with wave.open(str(self._path), "rb") as file:
            if file.getnchannels() != 1 or file.getsampwidth() != 2:
                raise ValueError(f"the voice made {file.getnchannels()} channels of {file.getsampwidth()} bytes")
            pcm = _Pcm(file.readframes(file.getnframes()), file.getframerate())
        self._path.unlink()
        return _without_silence(pcm) if pcm.samples else None


class _Playback:
    """What the PortAudio callback does; it runs in PortAudio's thread, so it only copies and notes times.

    Times are those at the loudspeaker: PortAudio tells how long what it takes now waits in the device's buffer.
    """

    def __init__(self, pcm: _Pcm, silenced: threading.Event, woken: threading.Event) -> None:
        self._pcm = pcm
        self._silenced = silenced
        self._woken = woken
        self._offset = 0
        self.started_ns: int | None = None
        self.ends_ns: int | None = None
        self.stream_ended = False

    @property
    def played_s(self) -> float:
        """How much the device has taken."""
        return self._offset / 2 / self._pcm.rate_hz

    @property
    def heard_s(self) -> float:
        """How much of that has come out of it."""
        since_s = 0.0 if self.started_ns is None else (time.monotonic_ns() - self.started_ns) / 1e9
        return max(0.0, min(self.played_s, since_s))

    def fill(self, out: Any, _frames: int, times: Any, _status: object) -> None:
        buffered_s = times.outputBufferDacTime - times.currentTime
        if not 0.0 <= buffered_s < _STALL_S:
            buffered_s = _LATENCY_S
        out_ns = time.monotonic_ns() + int(buffered_s * 1e9)
        part = b"" if self._silenced.is_set() else self._pcm.samples[self._offset : self._offset + len(out)]
        out[: len(part)] = part
        out[len(part) :] = bytes(len(out) - len(part))
        self._offset += len(part)
        if self.started_ns is None:
            self.started_ns = out_ns
            self._woken.set()
        if self.ends_ns is None and self._offset >= len(self._pcm.samples):
            self.ends_ns = out_ns + int(len(part) / 2 / self._pcm.rate_hz * 1e9)
            self._woken.set()

    def on_stream_ended(self) -> None:
        self.stream_ended = True
        self._woken.set()


class _SoundCard:
    """The output device, opened anew for each utterance so that it may come and go."""

    def __init__(self, device: str) -> None:
        self._device = device or None
        self._sounddevice: Any = None
        self.audible = False

    def look(self) -> str:
        """Find the device again; says why there is none, or nothing."""
        try:
            if self._sounddevice is None:
                import sounddevice

                self._sounddevice = sounddevice
            else:
                # PortAudio lists the devices only once, when it is initialised.
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

    def play(
        self, pcm: _Pcm, *, silenced: threading.Event, woken: threading.Event, tell: Callable[[str, float | int], None]
    ) -> int:
        """Play to the end or until ``silenced``; the time in ns when it ended. Tells started and playing."""
        playback = _Playback(pcm, silenced, woken)
        try:
            stream = self._sounddevice.RawOutputStream(
                samplerate=pcm.rate_hz,
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
            raise _DeviceTroubleError(" ".join(str(error).split())) from error
        told_start = False
        moved_s, moved_at_s = -1.0, time.monotonic()
        while True:
            woken.wait(self._wait_s(playback, told_start=told_start))
            woken.clear()
            now_ns = time.monotonic_ns()
            if playback.started_ns is not None and now_ns >= playback.started_ns and not told_start:
                told_start = True
                tell("started", playback.started_ns)
            if silenced.is_set():
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
                raise _DeviceTroubleError("the sound device went away", played_s=playback.played_s)
            if playback.played_s > moved_s:
                moved_s, moved_at_s = playback.played_s, time.monotonic()
            elif playback.ends_ns is None and time.monotonic() - moved_at_s > _STALL_S:
                raise _DeviceTroubleError("the sound device takes no sound", played_s=playback.played_s, hung=True)
            tell("playing", playback.heard_s)

    def _wait_s(self, playback: _Playback, *, told_start: bool) -> float:
        if playback.started_ns is not None and not told_start:
            return max(0.001, playback.started_ns / 1e9 - time.monotonic())
        if playback.ends_ns is None:
            return _HEARTBEAT_S
        return min(_HEARTBEAT_S, max(0.001, playback.ends_ns / 1e9 + _TAIL_S - time.monotonic()))

    def _error(self) -> type[Exception]:
        return OSError if self._sounddevice is None else self._sounddevice.PortAudioError


class _Engine:
    def __init__(self, events: TextIO) -> None:
        self._events = events
        self._folder = Path()
        self._commands: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        self._silenced = threading.Event()
        self._woken = threading.Event()

    def run(self, settings: dict[str, Any], folder: Path) -> None:
        self._folder = folder
        threading.Thread(target=self._read, args=(folder,), name="commands", daemon=True).start()
        try:
            renderer = _Renderer(settings, folder)
        except Exception as error:
            traceback.print_exc()
            self._tell("broken", detail=" ".join(str(error).split()) or type(error).__name__)
            return
        self._tell("ready", voice=renderer.voice)
        card = _SoundCard(settings["device"])
        if settings["look"]:
            self._tell_device(card.look())
        while True:
            command = self._commands.get()
            self._say(command, renderer, card)

    def _read(self, folder: Path) -> None:
        for line in sys.stdin:
            command = json.loads(line)
            if command["do"] == "silence":
                self._silenced.set()
                self._woken.set()
            else:
                # Cleared here, in the order of the commands, so that a silence after this one is never lost.
                self._silenced.clear()
                self._commands.put(command)
        # Usually the parent removes it; when the parent was killed, nobody else would.
        shutil.rmtree(folder, ignore_errors=True)
        # Whatever the main thread hangs in, nobody is left to hear it.
        os._exit(0)

    def _say(self, command: dict[str, Any], renderer: _Renderer, card: _SoundCard) -> None:
        try:
            pcm = renderer.render(command["text"])
        except Exception as error:
            traceback.print_exc()
            self._tell("unrendered", detail=" ".join(str(error).split()) or type(error).__name__)
            return
        self._keep_sound(pcm)
        self._tell("rendered", duration_s=pcm.duration_s, rate_hz=pcm.rate_hz)
        if not card.audible:
            self._tell_device(card.look())
        for attempt in (1, 2):
            if self._silenced.is_set():
                self._tell("silenced", at_ns=time.monotonic_ns())
                return
            if not card.audible:
                self._tell("inaudible", played_s=0.0)
                return
            try:
                ended_ns = card.play(pcm, silenced=self._silenced, woken=self._woken, tell=self._tell_playing)
            except _DeviceTroubleError as trouble:
                if trouble.hung:
                    self._tell_device(str(trouble))
                    self._tell("inaudible", played_s=trouble.played_s)
                    # Closing the stream may hang as well; a new process is the only sure way on.
                    os._exit(3)
                reason = card.look()
                if attempt == 1 and trouble.played_s == 0.0 and card.audible:
                    continue
                card.audible = False
                self._tell_device(reason or str(trouble))
                self._tell("inaudible", played_s=trouble.played_s)
                return
            self._tell("silenced" if self._silenced.is_set() else "finished", at_ns=ended_ns)
            return

    def _keep_sound(self, pcm: _Pcm) -> None:
        """For the console, which records what is heard of it; it has read the file before it asks for the next one."""
        try:
            (self._folder / SOUND_FILE).write_bytes(pcm.samples)
        except OSError:
            traceback.print_exc()

    def _tell_playing(self, event: str, value: float) -> None:
        if event == "started":
            self._tell("started", at_ns=value)
        else:
            self._tell("playing", played_s=value)

    def _tell_device(self, trouble: str) -> None:
        self._tell("device", audible=not trouble, detail=trouble)

    def _tell(self, event: str, **values: str | float | bool) -> None:
        # With the parent gone, the thread that reads commands tidies up and ends the process.
        with contextlib.suppress(BrokenPipeError):
            self._events.write(json.dumps({"event": event, **values}) + "\n")
            self._events.flush()


def main() -> None:
    # pyttsx3 prints to stdout, which is our wire.
    events = os.fdopen(os.dup(sys.stdout.fileno()), "w", encoding="utf-8")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    title_process("voice")
    settings = json.loads(sys.stdin.readline())
    _Engine(events).run(settings, Path(settings["folder"]))


if __name__ == "__main__":
    main()
