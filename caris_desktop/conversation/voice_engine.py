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
from pathlib import Path
from typing import IO, Any

from caris_desktop.conversation.voices.loudspeaker import DeviceTroubleError, Loudspeaker
from caris_desktop.conversation.voices.synthesis_worker import Rendering
from caris_desktop.conversation.voices.utterance_sound import Samples, StreamingBuffer, Voice, words_of
from caris_desktop.conversation.voices.voice_selection import VoiceChoice, every_voice, open_voice
from caris_desktop.domain.process_title import title_process


class _Engine:
    def __init__(self, events: IO[bytes]) -> None:
        self._events = events
        self._telling = threading.Lock()
        self._commands: queue.SimpleQueue[tuple[str, int]] = queue.SimpleQueue()
        self._silenced = threading.Event()
        self._woken = threading.Event()
        self._rendering: Rendering | None = None
        self._to_prepare: list[str] = []
        self._draft = ""
        self._tuned: tuple[float, float] | None = None

    def run(self, settings: dict[str, Any], folder: Path) -> None:
        threading.Thread(target=self._read, args=(folder,), name="commands", daemon=True).start()
        choice = VoiceChoice(
            settings["voice"],
            settings["language"],
            settings["rate"],
            settings["volume"],
            settings["folder"],
            settings["at_hand"],
        )
        try:
            voice, why_not = open_voice(choice, folder)
        except Exception as error:
            traceback.print_exc()
            self._notify("broken", detail=words_of(error))
            return
        rendering = self._rendering = Rendering(voice)
        threading.Thread(target=rendering.run, name="rendering", daemon=True).start()
        rendering.prepare(self._to_prepare)
        rendering.draft(self._draft)
        if self._tuned is not None:
            rendering.tune(*self._tuned)
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
                case "prepare":
                    self._to_prepare = command["texts"]
                    if self._rendering is not None:
                        self._rendering.prepare(self._to_prepare)
                case "draft":
                    self._draft = command["text"]
                    if self._rendering is not None:
                        self._rendering.draft(self._draft)
                case "tune":
                    self._tuned = (command["rate"], command["volume"])
                    if self._rendering is not None:
                        self._rendering.tune(*self._tuned)
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
                ended_ns = loudspeaker.play(
                    sound, silenced=self._silenced, woken=self._woken, tell=self._report_playing
                )
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

    def _report_voices(self, choice: VoiceChoice, voice: Voice) -> None:
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

    def _report_playing(self, event: str, value: float) -> None:
        if event == "started":
            self._notify("started", at_ns=value)
        else:
            self._notify("playing", played_s=value)

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
