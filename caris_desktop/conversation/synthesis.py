"""Speech synthesis process: queues utterances, reports their progress, and paces them without sound output."""

import contextlib
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
from collections.abc import Iterator
from dataclasses import asdict, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.speech_plugins import PLUGIN
from caris_desktop.conversation.synthesis_messages import (
    Draft,
    Prepare,
    SynthesisReady,
    SynthesisSettings,
    UseVoice,
    VoicesFound,
)
from caris_desktop.conversation.voices.voice_selection import GET_PIPER_VOICES
from caris_desktop.domain import clock
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import Problem, UtteranceState
from caris_desktop.domain.link_commands import Say, Silence
from caris_desktop.domain.plugins import switched_off
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import ROBOT_VOICE, PlayedSound, PlayedSoundEnded
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

_log = logging.getLogger(__name__)
_PACKAGE_PARENT = Path(__file__).resolve().parents[2]

VOICE_FOLDER = "caris-voice-"
"""How the names of temporary folders begin in which a voice renders sound."""
EngineInbox = queue.SimpleQueue[tuple[int, Any]]


class VoiceEngine:
    """Engine process. Events arrive in ``inbox`` as (number, dict), with audio under ``sound``; None at its end."""

    def __init__(self, settings: SynthesisSettings, inbox: EngineInbox, *, number: int, look: bool) -> None:
        search_path = [str(_PACKAGE_PARENT), *filter(None, [os.environ.get("PYTHONPATH")])]
        self.number = number
        self._inbox = inbox
        self._folder = tempfile.mkdtemp(prefix=VOICE_FOLDER)
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "caris_desktop.conversation.voice_engine"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(search_path), "PYTHONIOENCODING": "utf-8"},
        )
        for stream, read in ((self._process.stdout, self._read_events), (self._process.stderr, self._log_noise)):
            threading.Thread(target=read, args=(stream,), name=f"engine-{number}", daemon=True).start()
        self._send({**asdict(settings), "look": look, "files_folder": self._folder})

    def send(self, do: str, **values: Any) -> None:
        """Send a command: say (its ``number`` returns with the audio, maybe after cancellation), tune, silence, prepare
        or draft.
        """
        self._send({"do": do, **values})

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        shutil.rmtree(self._folder, ignore_errors=True)

    def close(self, *, grace_s: float = 0.5) -> None:
        """Let it clean up, then kill it."""
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

    def _send(self, command: dict[str, Any]) -> None:
        """Send a command; a dead engine is noticed in the inbox, not here."""
        stdin = self._process.stdin
        assert stdin is not None  # noqa: S101 - asked for above
        try:
            stdin.write(json.dumps(command).encode() + b"\n")
            stdin.flush()
        except (BrokenPipeError, ValueError):
            _log.info("the voice engine takes no more commands")

    def _read_events(self, stdout: IO[bytes]) -> None:
        for line in stdout:
            if not line.endswith(b"\n"):
                break
            event = json.loads(line)
            sound = stdout.read(event["bytes"])
            if len(sound) < event["bytes"]:
                break
            self._inbox.put((self.number, {**event, "sound": sound}))
        self._inbox.put((self.number, None))

    def _log_noise(self, stderr: IO[bytes]) -> None:
        for line in stderr:
            if not line.startswith(b"Audio saved to"):
                _log.info("voice engine: %s", line.decode("utf-8", "replace").rstrip())


MAX_UTTERANCE_CHARACTERS = 1000
UNHEARD = QT_TR_NOOP("not heard: this computer has no sound output")
_RENDER_S_PER_CHARACTER = 0.02
# Fits into a pipe at once, even if the engine does not read.
_PREPARED_CHARACTERS = 15_000

_Phase = Literal["off", "starting", "looking", "idle", "rendering", "opening", "playing", "silencing", "pacing"]


class SynthesisDeadlines(Value):
    """Deadlines per step, after which the voice engine counts as hung. ``render_s`` grows with the text."""

    start_s: float = 30.0
    look_s: float = 3.0
    render_s: float = 3.0
    open_s: float = 3.0
    heartbeat_s: float = 3.0
    silence_s: float = 0.3


def run_synthesis(connection: Connection, deadlines: SynthesisDeadlines = SynthesisDeadlines()) -> None:
    """Process entry point: speak requests until the connection closes.

    Receives UseVoice, Prepare, Draft, Say and Silence. Sends SynthesisReady (at each change), VoicesFound, Problem,
    UtteranceChanged with the states started, finished, interrupted and failed, AudioChunk of played audio, PlayedSound
    and PlayedSoundEnded.
    """
    inbox: EngineInbox = queue.SimpleQueue()
    threading.Thread(target=_read_console, args=(connection, inbox), name="console", daemon=True).start()
    desk = _Synthesis(connection, deadlines, inbox)
    try:
        desk.run()
    except (BrokenPipeError, ConnectionResetError):
        _log.info("the console is gone")
    finally:
        desk.kill_engine()


def speakable(text: str) -> str:
    """One line without control characters; empty if nothing speakable is left."""
    visible = "".join(
        character if unicodedata.category(character) not in ("Cc", "Cf", "Cs", "Co", "Cn") else " "
        for character in text
    )
    return " ".join(visible.split())


_CONSOLE = 0


def _read_console(connection: Connection, inbox: EngineInbox) -> None:
    with contextlib.suppress(EOFError, OSError):
        while True:
            inbox.put((_CONSOLE, connection.recv()))
    inbox.put((_CONSOLE, None))


class _SynthesisedSound:
    """Synthesised audio of one utterance so far. ``started_ns`` is 0 until playback."""

    def __init__(self, utterance: Say) -> None:
        self._utterance = utterance
        self._parts: list[tuple[int, NDArray[np.int16]]] = []
        self._rate_hz = 1
        self._recorded = self._reported = 0
        self.started_ns = 0

    @property
    def duration_s(self) -> float:
        return max((at + len(samples) for at, samples in self._parts), default=0) / self._rate_hz

    def add(self, at: int, pcm: bytes, rate_hz: int) -> None:
        """Add audio played from frame ``at`` on."""
        self._rate_hz = rate_hz
        self._parts.append((at, np.frombuffer(pcm, dtype="<i2").astype(np.int16, copy=False)))

    def played(self) -> Iterator[PlayedSound]:
        """Parts whose playback times are known by now, each once."""
        while self.started_ns and self._reported < len(self._parts):
            at, samples = self._parts[self._reported]
            self._reported += 1
            said = self._utterance
            yield PlayedSound(self._stamp_ns(at), said.utterance_id, said.text, self._rate_hz, samples[:, None])

    def recorded(self, played_s: float) -> Iterator[AudioChunk]:
        """Audio played since the last call, joined where there was no silence."""
        until = round(max(0.0, played_s) * self._rate_hz) if self.started_ns else 0
        pieces: list[tuple[int, NDArray[np.int16]]] = []
        for at, samples in self._parts:
            first, end = max(self._recorded, at), min(until, at + len(samples))
            if first < end:
                piece = samples[first - at : end - at]
                if pieces and pieces[-1][0] + len(pieces[-1][1]) == first:
                    pieces[-1] = (pieces[-1][0], np.concatenate([pieces[-1][1], piece]))
                else:
                    pieces.append((first, piece))
        self._recorded = max(self._recorded, until)
        for first, piece in pieces:
            yield AudioChunk(self._stamp_ns(first), ROBOT_VOICE, self._rate_hz, piece[:, None].copy())

    def _stamp_ns(self, frame: int) -> int:
        return self.started_ns + frame * 1_000_000_000 // self._rate_hz


class _Synthesis:
    """One utterance at a time through an untrusted engine: every phase has a deadline."""

    def __init__(self, connection: Connection, deadlines: SynthesisDeadlines, inbox: EngineInbox) -> None:
        self._send = connection.send
        self._settings = SynthesisSettings()
        self._deadlines = deadlines
        self._inbox = inbox
        self._engine: VoiceEngine | None = None
        self._engines = _CONSOLE
        self._phase: _Phase = "off"
        self._deadline_ns: int | None = None
        self._waiting: deque[Say] = deque()
        self._dropped: list[Say] = []
        self._now: Say | None = None
        self._started = False
        self._number = 0
        self._played_s = 0.0
        self._sound = _SynthesisedSound(Say(0, "", ""))
        self._to_prepare: tuple[str, ...] = ()
        self._voice = ""
        self._audible: bool | None = None
        self._silenced_by: Actor = CONSOLE
        self._closed = False
        self._outdated = False
        self._plugins_off: set[str] = set()
        self._looks = False

    def run(self) -> None:
        while not self._closed:
            if self._phase in ("off", "idle"):
                self._go_on()
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
            case Say():
                self._take(command)
            case Silence():
                self._silenced_by = command.actor
                self._silence()
            case UseVoice(settings):
                self._use(settings)
            case Prepare(texts):
                self._prepare(texts)
            case Draft(text):
                spoken = speakable(text)
                if self._engine is not None and len(spoken) <= MAX_UTTERANCE_CHARACTERS:
                    self._engine.send("draft", text=spoken)
            case None:  # the console is gone
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

    def _use(self, settings: SynthesisSettings) -> None:
        before, self._settings = self._settings, settings
        if self._engine is not None and settings.tunes(before):
            self._engine.send("tune", rate=settings.rate, volume=settings.volume)
        elif self._now is not None:
            self._outdated = True
        else:
            self._start_engine()

    def _prepare(self, texts: tuple[str, ...]) -> None:
        chosen, characters = [], 0
        for text in dict.fromkeys(map(speakable, texts)):
            characters += len(text)
            if characters > _PREPARED_CHARACTERS:
                break
            if 0 < len(text) <= MAX_UTTERANCE_CHARACTERS:
                chosen.append(text)
        self._to_prepare = tuple(chosen)
        if self._engine is not None:
            self._engine.send("prepare", texts=self._to_prepare)

    def _take(self, command: Say) -> None:
        text = speakable(command.text)
        if not text:
            self._report(command, "failed", clock.now_ns(), QT_TR_NOOP("the text contains nothing to say"))
        elif len(text) > MAX_UTTERANCE_CHARACTERS:
            too_long = localized(
                QT_TR_NOOP("the text is longer than {most} characters: say it in parts"), most=MAX_UTTERANCE_CHARACTERS
            )
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
            self._engine.send("silence")
            self._enter("silencing", self._deadlines.silence_s)

    def _start_engine(self, *, look: bool = True) -> None:
        self.kill_engine()
        self._outdated = False
        self._looks = look
        self._engines += 1
        settings = self._settings
        if settings.voice in self._plugins_off:
            settings = replace(settings, voice="")
        self._engine = VoiceEngine(settings, self._inbox, number=self._engines, look=look)
        self._engine.send("prepare", texts=self._to_prepare)
        self._enter("starting", self._deadlines.start_s)

    def _go_on(self) -> None:
        """When idle: load another voice, or begin the next utterance."""
        if self._outdated:
            self._start_engine()
        elif self._waiting and self._engine is not None:
            self._begin(self._engine)
        elif self._waiting:
            # The output device is probed with the utterance: it may have hung the last engine.
            self._start_engine(look=False)

    def _begin(self, engine: VoiceEngine) -> None:
        self._now = self._waiting.popleft()
        self._started = False
        self._played_s = 0.0
        self._sound = _SynthesisedSound(self._now)
        text = speakable(self._now.text)
        self._number += 1
        engine.send("say", text=text, number=self._number)
        self._enter("rendering", self._deadlines.render_s + _RENDER_S_PER_CHARACTER * len(text))

    def _on_engine(self, event: dict[str, Any] | None) -> None:
        match event:
            case None:
                self._on_engine_lost(QT_TR_NOOP("the voice stopped unexpectedly"))
            case {"event": "broken", "detail": str(detail)}:
                self._fail_voice(detail)
            case {"event": "ready", "voice": str(voice), "why_not": str(why_not)}:
                self._voice = voice
                # Report that another voice than the requested one is used.
                if why_not:
                    self._send(
                        Problem(
                            clock.now_ns(),
                            "warning",
                            localized(QT_TR_NOOP("This computer uses another voice: {why_not}."), why_not=why_not),
                            localized(QT_TR_NOOP("Utterances are spoken with the voice {voice}."), voice=self._voice),
                            GET_PIPER_VOICES,
                        )
                    )
                if self._looks:
                    self._enter("looking", self._deadlines.look_s)
                else:
                    self._enter("idle", None)
            case {"event": "device", "audible": bool(audible), "detail": str(detail)}:
                self._set_audible(audible, detail)
                if self._phase == "looking":
                    self._enter("idle", None)
            case {"event": "unrendered", "detail": str(detail)}:
                self._report_cut_off(clock.now_ns())
                why_not = localized(QT_TR_NOOP("speech synthesis failed ({why})"), why=detail)
                self._end("failed", clock.now_ns(), why_not)
            case {"event": "switched_off", "plugin": str(name), "package": str(package), "reason": str(reason)}:
                self._send(switched_off(clock.now_ns(), name, package, reason))
                self._plugins_off.add(f"{PLUGIN}{name}")
                # While it starts, the engine opens another voice.
                self._outdated = self._phase != "starting"
            case {"event": "voices", "voices": list(voices)}:
                self._send(VoicesFound(tuple((str(name), str(language)) for name, language in voices)))
            case {"event": "part", "number": int(number)} if number != self._number:
                _log.debug("a part of what was silenced came late")
            case {"event": "part", "sound": bytes(pcm), "at": int(at), "rate_hz": int(rate_hz)}:
                self._sound.add(at, pcm, rate_hz)
                self._report_played()
                if self._phase == "rendering":
                    self._enter("opening", self._deadlines.open_s)
            case {"event": "started", "at_ns": int(at_ns)}:
                self._sound.started_ns = at_ns
                self._report_started(at_ns)
                self._report_played()
                # Two engine threads report the first part and the start, in either order.
                if self._phase in ("rendering", "opening"):
                    self._enter("playing", self._deadlines.heartbeat_s)
            case {"event": "playing", "played_s": float(played_s)}:
                self._played_s = played_s
                self._send_heard(played_s)
                if self._phase == "playing":
                    self._enter("playing", self._deadlines.heartbeat_s)
            case {"event": "inaudible", "played_s": float(played_s)}:
                self._report_cut_off(clock.now_ns())
                self._played_s = played_s
                self._pace()
            case {"event": "finished", "at_ns": int(at_ns)}:
                self._send_heard(self._sound.duration_s)
                self._end("finished", at_ns)
            case {"event": "silenced", "at_ns": int(at_ns)}:
                self._send_heard((at_ns - self._sound.started_ns) / 1e9)
                self._end("interrupted", at_ns)
            case _:
                _log.error("the voice engine sent %r", event)

    def _send_heard(self, until_s: float) -> None:
        """Send the audio played since the last call, for the recording."""
        for chunk in self._sound.recorded(until_s):
            self._send(chunk)

    def _report_played(self) -> None:
        for sound in self._sound.played():
            self._send(sound)

    def _report_cut_off(self, at_ns: int) -> None:
        if self._now is not None and self._sound.started_ns:
            self._send(PlayedSoundEnded(at_ns, self._now.utterance_id))
            self._sound.started_ns = 0

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
            self._report_cut_off(clock.now_ns())
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
                "starting": QT_TR_NOOP("the voice did not start in time"),
                "rendering": QT_TR_NOOP("speech synthesis timed out"),
                "silencing": QT_TR_NOOP("the voice did not stop in time"),
            }.get(self._phase, QT_TR_NOOP("the sound device does not respond"))
        )

    def _pace(self) -> None:
        """Without sound output the session continues as if there were: wait for the utterance's duration."""
        if self._phase == "silencing":
            self._end("interrupted", clock.now_ns())
            return
        self._report_started(clock.now_ns())
        self._enter("pacing", max(0.0, self._sound.duration_s - self._played_s))

    def _fail_voice(self, detail: str) -> None:
        self.kill_engine()
        self._enter("off", None)
        failed, self._waiting = self._waiting, deque()
        for utterance in failed:
            no_voice = localized(QT_TR_NOOP("no voice is available on this computer ({why})"), why=detail)
            self._report(utterance, "failed", clock.now_ns(), no_voice)
        self._report_dropped()
        self._send(
            Problem(
                clock.now_ns(),
                "error",
                localized(QT_TR_NOOP("No voice is available on this computer ({detail})."), detail=detail),
                QT_TR_NOOP("Utterances for this computer are not spoken."),
                QT_TR_NOOP("Install espeak-ng (Debian, Ubuntu: apt install espeak-ng), then say the text again."),
                until="voice",
            )
        )

    def _set_audible(self, audible: bool, detail: str) -> None:
        same, self._audible = audible == self._audible, audible
        if not same or self._phase == "looking":
            self._send(SynthesisReady(self._voice, audible))
        if not (audible or same):
            self._send(
                Problem(
                    clock.now_ns(),
                    "warning",
                    localized(QT_TR_NOOP("This computer has no sound output ({detail})."), detail=detail),
                    QT_TR_NOOP("Utterances cannot be heard; they still take their usual time and are recorded."),
                    QT_TR_NOOP(
                        "Connect loudspeakers or start the sound server. The console tries again with the next "
                        "utterance."
                    ),
                    until="voice",
                )
            )

    def _report_started(self, at_ns: int) -> None:
        if self._now is not None and not self._started:
            self._started = True
            self._report(self._now, "started", at_ns)

    def _end(self, state: UtteranceState, at_ns: int, detail: str = "") -> None:
        if state == "interrupted":
            self._report_cut_off(at_ns)
        ended, self._now = self._now, None
        self._enter("idle" if self._engine is not None else "off", None)
        if ended is not None:
            self._report(ended, state, at_ns, detail)
        self._report_dropped()

    def _report_dropped(self) -> None:
        dropped, self._dropped = self._dropped, []
        for utterance in dropped:
            self._report(utterance, "interrupted", clock.now_ns())

    def _report(self, utterance: Say, state: UtteranceState, at_ns: int, detail: str = "") -> None:
        actor = self._silenced_by if state == "interrupted" else None
        self._send(utterance.reported(at_ns, state, "computer", detail=detail, actor=actor))

    def _enter(self, phase: _Phase, within_s: float | None) -> None:
        self._phase = phase
        self._deadline_ns = None if within_s is None else clock.now_ns() + int(within_s * 1e9)

    def _seconds_left(self) -> float | None:
        if self._deadline_ns is None:
            return None
        return max(0.0, (self._deadline_ns - clock.now_ns()) / 1e9)
