"""Speech on this computer: the process body that queues utterances, tells what became of them and paces the unheard."""

import json
import logging
import os
import queue
import shutil
import subprocess
import sys
import tempfile
import threading
import unicodedata
from collections import deque
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np

from caris_desktop.conversation.speech_messages import (
    CloseSpeech,
    SilenceSpeech,
    Speak,
    SpeechFailed,
    SpeechReady,
    SpeechSettings,
)
from caris_desktop.conversation.voice_engine import SOUND_FILE
from caris_desktop.domain import clock
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import Problem, UtteranceChanged, UtteranceState
from caris_desktop.domain.sensing import AudioChunk

_log = logging.getLogger(__name__)

MAX_UTTERANCE_CHARACTERS = 1000
ROBOT_VOICE = "robot voice"
UNHEARD = "not heard: this computer has no sound output"
_PACKAGE_PARENT = Path(__file__).resolve().parents[2]
_RENDER_S_PER_CHARACTER = 0.02

_Phase = Literal["off", "starting", "looking", "idle", "rendering", "opening", "playing", "silencing", "pacing"]


@dataclass(frozen=True, slots=True)
class SpeechDeadlines:
    """How long the voice may take for each step before it counts as hung. ``render_s`` grows with the text."""

    start_s: float = 15.0
    look_s: float = 3.0
    render_s: float = 3.0
    open_s: float = 3.0
    heartbeat_s: float = 3.0
    silence_s: float = 0.3


def run_speech(
    connection: Connection, settings: SpeechSettings, deadlines: SpeechDeadlines = SpeechDeadlines()
) -> None:
    """Process body: speak what is asked until the connection ends.

    Receives Speak, SilenceSpeech and CloseSpeech. Sends SpeechReady (again whenever it changes), SpeechFailed, Problem,
    and UtteranceChanged with the states started, finished, interrupted and failed.
    """
    inbox: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
    threading.Thread(target=_read_console, args=(connection, inbox), name="console", daemon=True).start()
    desk = _SpeechDesk(connection, settings, deadlines, inbox)
    try:
        desk.run()
    except (BrokenPipeError, ConnectionResetError):
        _log.info("the console is gone")
    finally:
        desk.kill_engine()


def speakable(text: str) -> str:
    """One line without control characters; empty when nothing is left to say."""
    visible = "".join(
        character if unicodedata.category(character) not in ("Cc", "Cf", "Cs", "Co", "Cn") else " "
        for character in text
    )
    return " ".join(visible.split())


_CONSOLE = 0


def _read_console(connection: Connection, inbox: "queue.SimpleQueue[tuple[int, Any]]") -> None:
    while True:
        try:
            message = connection.recv()
        except (EOFError, OSError):
            inbox.put((_CONSOLE, CloseSpeech()))
            return
        inbox.put((_CONSOLE, message))


class VoiceEngine:
    """One run of the killable engine process; its events arrive in ``inbox`` as (number, dict), None when it ended."""

    def __init__(
        self, settings: SpeechSettings, inbox: "queue.SimpleQueue[tuple[int, Any]]", *, number: int, look: bool
    ) -> None:
        search_path = [str(_PACKAGE_PARENT), *filter(None, [os.environ.get("PYTHONPATH")])]
        self.number = number
        self._inbox = inbox
        self._folder = tempfile.mkdtemp(prefix="caris-voice-")
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "caris_desktop.conversation.voice_engine"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(search_path), "PYTHONIOENCODING": "utf-8"},
        )
        for stream, read in ((self._process.stdout, self._read_events), (self._process.stderr, self._log_noise)):
            threading.Thread(target=read, args=(stream,), name=f"engine-{number}", daemon=True).start()
        self.send({**asdict(settings), "look": look, "folder": self._folder})

    def send(self, command: dict[str, Any]) -> None:
        """A dead engine shows by its end in the inbox, not here."""
        stdin = self._process.stdin
        assert stdin is not None  # noqa: S101 - asked for above
        try:
            stdin.write(json.dumps(command).encode() + b"\n")
            stdin.flush()
        except (BrokenPipeError, ValueError):
            _log.info("the voice engine takes no more commands")

    def sound(self) -> bytes:
        """What the utterance sounds like, signed 16 bit, one channel; empty where it cannot be had."""
        try:
            return (Path(self._folder) / SOUND_FILE).read_bytes()
        except OSError:
            _log.warning("the sound of an utterance is not recorded", exc_info=True)
            return b""

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)

    def close(self, *, grace_s: float = 0.5) -> None:
        """Let it tidy up, then kill."""
        if self._process.stdin is not None:
            try:
                self._process.stdin.close()
            except BrokenPipeError:
                _log.debug("the voice engine was gone already")
        try:
            self._process.wait(grace_s)
        except subprocess.TimeoutExpired:
            _log.debug("the voice engine is killed")
        self.kill()

    def _read_events(self, stdout: IO[bytes]) -> None:
        for line in stdout:
            self._inbox.put((self.number, json.loads(line)))
        self._inbox.put((self.number, None))

    def _log_noise(self, stderr: IO[bytes]) -> None:
        for line in stderr:
            if not line.startswith(b"Audio saved to"):
                _log.info("voice engine: %s", line.decode("utf-8", "replace").rstrip())


class _HeardSound:
    """The sound of one utterance, handed on as far as it was heard. ``started_ns`` is 0 until it is."""

    def __init__(self, pcm: bytes, rate_hz: int) -> None:
        self._samples = np.frombuffer(pcm[: len(pcm) // 2 * 2], dtype="<i2").astype(np.int16, copy=False)
        self._rate_hz = rate_hz
        self._sent = 0
        self.started_ns = 0

    def until(self, heard_s: float) -> AudioChunk | None:
        first, end = self._sent, min(len(self._samples), round(max(0.0, heard_s) * self._rate_hz))
        if not self.started_ns or end <= first:
            return None
        self._sent = end
        stamp_ns = self.started_ns + first * 1_000_000_000 // self._rate_hz
        return AudioChunk(stamp_ns, ROBOT_VOICE, self._rate_hz, self._samples[first:end, None].copy())


class _SpeechDesk:
    """One utterance at a time through an engine that is never trusted to answer: every phase has a deadline."""

    def __init__(
        self,
        connection: Connection,
        settings: SpeechSettings,
        deadlines: SpeechDeadlines,
        inbox: "queue.SimpleQueue[tuple[int, Any]]",
    ) -> None:
        self._connection = connection
        self._settings = settings
        self._deadlines = deadlines
        self._inbox = inbox
        self._engine: VoiceEngine | None = None
        self._engines = _CONSOLE
        self._phase: _Phase = "off"
        self._deadline_ns: int | None = None
        self._waiting: deque[Speak] = deque()
        self._dropped: list[Speak] = []
        self._now: Speak | None = None
        self._started = False
        self._duration_s = self._played_s = 0.0
        self._heard = _HeardSound(b"", 1)
        self._voice = ""
        self._audible: bool | None = None
        self._silenced_by: Actor = CONSOLE
        self._closed = False

    def run(self) -> None:
        self._start_engine()
        while not self._closed:
            if self._waiting and self._phase in ("off", "idle"):
                self._begin()
            try:
                source, message = self._inbox.get(timeout=self._seconds_left())
            except queue.Empty:
                self._on_deadline()
                continue
            if source == _CONSOLE:
                self._on_command(message)
            elif self._engine is not None and source == self._engine.number:
                self._on_engine(message)

    def kill_engine(self) -> None:
        if self._engine is not None:
            self._engine.close(grace_s=0.0 if self._phase != "idle" else 0.5)
            self._engine = None

    def _on_command(self, command: object) -> None:
        match command:
            case Speak():
                self._take(command)
            case SilenceSpeech(actor):
                self._silenced_by = actor
                self._silence()
            case CloseSpeech():
                self._closed = True
                self._silenced_by = CONSOLE
                self._dropped += self._waiting
                self._waiting.clear()
                if self._now is not None:
                    self.kill_engine()
                    self._end("interrupted", clock.now_ns())
                self._report_dropped()
            case _:
                _log.error("unknown command %r", type(command).__name__)

    def _take(self, command: Speak) -> None:
        text = speakable(command.text)
        if not text:
            self._report(command, "failed", clock.now_ns(), "there is nothing to say in it")
        elif len(text) > MAX_UTTERANCE_CHARACTERS:
            too_long = f"it is longer than {MAX_UTTERANCE_CHARACTERS} characters: say it in parts"
            self._report(command, "failed", clock.now_ns(), too_long)
        else:
            self._waiting.append(command)

    def _silence(self) -> None:
        self._dropped += self._waiting
        self._waiting.clear()
        if self._now is None:
            self._report_dropped()
        elif self._phase == "pacing":
            self._end("interrupted", clock.now_ns())
        elif self._phase != "silencing" and self._engine is not None:
            self._engine.send({"do": "silence"})
            self._enter("silencing", self._deadlines.silence_s)

    def _start_engine(self, *, look: bool = True) -> None:
        self._engines += 1
        self._engine = VoiceEngine(self._settings, self._inbox, number=self._engines, look=look)
        self._enter("starting", self._deadlines.start_s)

    def _begin(self) -> None:
        if self._engine is None:
            # The sound device is looked for with the utterance itself: it may be what hung the last engine.
            self._start_engine(look=False)
            return
        self._now = self._waiting.popleft()
        self._started = False
        self._duration_s = self._played_s = 0.0
        text = speakable(self._now.text)
        self._engine.send({"do": "say", "text": text})
        self._enter("rendering", self._deadlines.render_s + _RENDER_S_PER_CHARACTER * len(text))

    def _on_engine(self, event: dict[str, Any] | None) -> None:
        match event:
            case None:
                self._on_engine_lost("the voice ended unexpectedly")
            case {"event": "broken", "detail": str(detail)}:
                self._fail_voice(detail)
            case {"event": "ready", "voice": str(voice)}:
                self._voice = voice
                if self._audible is None:
                    self._enter("looking", self._deadlines.look_s)
                else:
                    self._enter("idle", None)
            case {"event": "device", "audible": bool(audible), "detail": str(detail)}:
                self._set_audible(audible, detail)
                if self._phase == "looking":
                    self._enter("idle", None)
            case {"event": "unrendered", "detail": str(detail)}:
                self._end("failed", clock.now_ns(), f"it could not be turned into sound ({detail})")
            case {"event": "rendered", "duration_s": float(duration_s), "rate_hz": int(rate_hz)}:
                self._duration_s = duration_s
                self._heard = _HeardSound(self._engine.sound() if self._engine is not None else b"", rate_hz)
                if self._phase == "rendering":
                    self._enter("opening", self._deadlines.open_s)
            case {"event": "started", "at_ns": int(at_ns)}:
                self._heard.started_ns = at_ns
                self._report_started(at_ns)
                if self._phase == "opening":
                    self._enter("playing", self._deadlines.heartbeat_s)
            case {"event": "playing", "played_s": float(played_s)}:
                self._played_s = played_s
                self._send_heard(played_s)
                if self._phase == "playing":
                    self._enter("playing", self._deadlines.heartbeat_s)
            case {"event": "inaudible", "played_s": float(played_s)}:
                self._played_s = played_s
                self._pace()
            case {"event": "finished", "at_ns": int(at_ns)}:
                self._send_heard(self._duration_s)
                self._end("finished", at_ns)
            case {"event": "silenced", "at_ns": int(at_ns)}:
                self._send_heard((at_ns - self._heard.started_ns) / 1e9)
                self._end("interrupted", at_ns)
            case _:
                _log.error("the voice engine sent %r", event)

    def _send_heard(self, until_s: float) -> None:
        """What was heard since the last time, for the recording."""
        chunk = self._heard.until(until_s)
        if chunk is not None:
            self._send(chunk)

    def _on_engine_lost(self, detail: str) -> None:
        phase = self._phase
        _log.error("%s while %s", detail, phase)
        if self._engine is not None:
            self._engine.kill()
            self._engine = None
        if phase == "pacing":
            return
        if phase == "starting":
            self._fail_voice(detail)
        elif phase == "rendering":
            self._end("failed", clock.now_ns(), detail)
        elif phase in ("opening", "playing"):
            self._set_audible(False, detail)
            self._pace()
        elif phase == "silencing":
            self._end("interrupted", clock.now_ns())
        else:
            self._enter("off", None)
            if phase == "looking":
                self._set_audible(False, detail)

    def _on_deadline(self) -> None:
        if self._phase == "pacing":
            self._end("finished", clock.now_ns(), UNHEARD)
            return
        self._on_engine_lost(
            {
                "starting": "the voice did not start in time",
                "rendering": "turning it into sound took too long",
                "silencing": "the voice did not fall silent in time",
            }.get(self._phase, "the sound device does not answer")
        )

    def _pace(self) -> None:
        """Nobody hears it, but the session goes on as if: the rest of the utterance takes its time."""
        if self._phase == "silencing":
            self._end("interrupted", clock.now_ns())
            return
        self._report_started(clock.now_ns())
        self._enter("pacing", max(0.0, self._duration_s - self._played_s))

    def _fail_voice(self, detail: str) -> None:
        self.kill_engine()
        self._enter("off", None)
        failed, self._waiting = self._waiting, deque()
        for utterance in failed:
            self._report(utterance, "failed", clock.now_ns(), f"this computer has no voice ({detail})")
        self._report_dropped()
        self._send(
            SpeechFailed(
                Problem(
                    clock.now_ns(),
                    "error",
                    f"This computer has no voice ({detail}).",
                    "What is to be spoken on this computer stays unsaid.",
                    "Install espeak-ng (Debian, Ubuntu: apt install espeak-ng), then say it again.",
                    until="voice",
                )
            )
        )

    def _set_audible(self, audible: bool, detail: str) -> None:
        if audible == self._audible:
            return
        self._audible = audible
        self._send(SpeechReady(self._voice, audible))
        if not audible:
            self._send(
                Problem(
                    clock.now_ns(),
                    "warning",
                    f"This computer has no sound output ({detail}).",
                    "Nobody hears what it says; utterances still take their time and are recorded.",
                    "Connect loudspeakers or start the sound server; the next utterance tries again.",
                    until="voice",
                )
            )

    def _report_started(self, at_ns: int) -> None:
        if self._now is not None and not self._started:
            self._started = True
            self._report(self._now, "started", at_ns)

    def _end(self, state: UtteranceState, at_ns: int, detail: str = "") -> None:
        ended, self._now = self._now, None
        self._enter("idle" if self._engine is not None else "off", None)
        if ended is not None:
            self._report(ended, state, at_ns, detail)
        self._report_dropped()

    def _report_dropped(self) -> None:
        dropped, self._dropped = self._dropped, []
        for utterance in dropped:
            self._report(utterance, "interrupted", clock.now_ns())

    def _report(self, utterance: Speak, state: UtteranceState, at_ns: int, detail: str = "") -> None:
        self._send(
            UtteranceChanged(
                at_ns,
                utterance.utterance_id,
                "robot",
                utterance.text,
                utterance.origin,
                state,
                voice="computer",
                detail=detail,
                actor=self._silenced_by if state == "interrupted" else utterance.actor,
                person_id=utterance.person_id,
            )
        )

    def _send(self, message: object) -> None:
        self._connection.send(message)

    def _enter(self, phase: _Phase, within_s: float | None) -> None:
        self._phase = phase
        self._deadline_ns = None if within_s is None else clock.now_ns() + int(within_s * 1e9)

    def _seconds_left(self) -> float | None:
        if self._deadline_ns is None:
            return None
        return max(0.0, (self._deadline_ns - clock.now_ns()) / 1e9)
