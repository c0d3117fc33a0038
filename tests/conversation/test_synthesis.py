"""Speech on this computer end to end: real voice, real sound server, real processes that hang and die."""

import multiprocessing
import os
import queue
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import psutil
import pytest

from caris_desktop.conversation.speech_checks import probe_sound
from caris_desktop.conversation.synthesis import (
    MAX_UTTERANCE_CHARACTERS,
    SynthesisDeadlines,
    _Synthesis,
    run_synthesis,
    speakable,
)
from caris_desktop.conversation.synthesis_messages import (
    SynthesisReady,
    SynthesisSettings,
    UseVoice,
    VoicesFound,
)
from caris_desktop.domain import clock
from caris_desktop.domain.events import Problem, UtteranceChanged
from caris_desktop.domain.link_commands import Say, Silence
from caris_desktop.domain.sound_values import PlayedSound, PlayedSoundEnded
from tests.conversation.sound_server import SoundServer, require_pulseaudio
from tests.support.examples import examples
from tests.support.plugins import install
from tests.support.polling import wait_for

_CONTEXT = multiprocessing.get_context("spawn")
SENTENCE = "Welcome to the robot laboratory."
LONG_SENTENCE = (
    "Welcome to the robot laboratory, where we build, measure, break and mend all kinds of robots every day."
)
NOWHERE = "unix:/nonexistent/no-sound-server"


class Speech:
    """The speech process as started by the console."""

    def __init__(self, deadlines: SynthesisDeadlines) -> None:
        self._connection, theirs = _CONTEXT.Pipe()
        self.process = _CONTEXT.Process(target=run_synthesis, args=(theirs, deadlines), daemon=True)
        self.process.start()
        theirs.close()
        self._connection.send(UseVoice(SynthesisSettings(rate=1.8, at_hand=True)))
        self.heard: list[Any] = []

    @property
    def connection(self) -> Connection:
        return self._connection

    def say(self, utterance_id: str, text: str = SENTENCE) -> None:
        self._connection.send(Say(clock.now_ns(), utterance_id, text, "wizard:a"))

    def silence(self) -> int:
        self._connection.send(Silence(clock.now_ns(), "wizard:b"))
        return clock.now_ns()

    def wait(self, matches: Callable[[Any], bool], what: str, *, timeout_s: float = 30.0) -> Any:
        """The next message that ``matches``; earlier ones are stored in ``heard``."""
        until_s = time.monotonic() + timeout_s
        while self._connection.poll(max(0.0, until_s - time.monotonic())):
            message = self._connection.recv()
            self.heard.append(message)
            if matches(message):
                return message
        raise AssertionError(f"not within {timeout_s:.0f} s: {what}; heard {self.heard}")

    def wait_ready(self) -> SynthesisReady:
        ready: SynthesisReady = self.wait(lambda message: isinstance(message, SynthesisReady), "speech is ready")
        return ready

    def wait_state(self, utterance_id: str, state: str) -> UtteranceChanged:
        event: UtteranceChanged = self.wait(
            lambda message: (
                isinstance(message, UtteranceChanged) and (message.utterance_id, message.state) == (utterance_id, state)
            ),
            f"{utterance_id} {state}",
        )
        return event

    @property
    def states(self) -> list[tuple[str, str]]:
        return [(event.utterance_id, event.state) for event in self.heard if isinstance(event, UtteranceChanged)]

    @property
    def actors(self) -> set[tuple[str, str]]:
        """State and actor of all utterance events."""
        return {(event.state, event.actor) for event in self.heard if isinstance(event, UtteranceChanged)}

    @property
    def problems(self) -> list[Problem]:
        return [message for message in self.heard if isinstance(message, Problem)]

    def engine(self) -> psutil.Process:
        def found() -> psutil.Process | None:
            children = psutil.Process(self.process.pid).children()
            return next((child for child in children if child.cmdline()[:1] == ["caris: voice"]), None)

        engine = wait_for(found, "the voice engine runs")
        assert engine is not None
        return engine


StartSpeech = Callable[..., Speech]


@pytest.fixture
def start_speech(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[StartSpeech]:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    started: list[Speech] = []

    def start(sound: SoundServer | None, **deadlines: float) -> Speech:
        monkeypatch.setenv("PULSE_SERVER", NOWHERE if sound is None else sound.address)
        started.append(Speech(SynthesisDeadlines(**deadlines)))
        return started[-1]

    yield start
    for speech in started:
        speech.connection.close()
        speech.process.join(10)
        assert speech.process.exitcode is not None, "the speech process outlived its console"
    wait_for(lambda: not list(tmp_path.glob("caris-voice-*")), "no sound file is left behind")


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SoundServer]:
    require_pulseaudio()
    server = SoundServer(tmp_path_factory.mktemp("sound") / "server")
    yield server
    server.kill()


@pytest.fixture
def own_sound(tmp_path: Path) -> Iterator[SoundServer]:
    require_pulseaudio()
    server = SoundServer(tmp_path / "server")
    yield server
    server.kill()


def _seconds(start: UtteranceChanged, end: UtteranceChanged) -> float:
    return (end.stamp_ns - start.stamp_ns) / 1e9


@pytest.mark.long
def test_a_sentence_is_heard_for_as_long_as_the_events_say(sound: SoundServer, start_speech: StartSpeech) -> None:
    speech = start_speech(sound)
    assert speech.wait_ready().audible
    listening = sound.listen()
    speech.say("u1")
    speech.say("u2", "Please follow me.")
    start, end = speech.wait_state("u1", "started"), speech.wait_state("u1", "finished")
    speech.wait_state("u2", "finished")
    wait_for(lambda: listening.loud_total_s() > 1.2, "both sentences reach the loudspeaker")
    assert speech.states == [("u1", "started"), ("u1", "finished"), ("u2", "started"), ("u2", "finished")]
    assert (start.speaker, start.text, start.origin, start.detail) == ("robot", SENTENCE, "typed", "")
    assert 0.8 < _seconds(start, end) < 4.0
    assert speech.problems == []


@pytest.mark.long
def test_the_events_come_when_the_sound_begins_and_ends(sound: SoundServer, start_speech: StartSpeech) -> None:
    """20 ms is the resolution given by the loudness threshold and the blocks of a sound server."""
    speech = start_speech(sound)
    assert speech.wait_ready().audible
    late_ms: list[float] = []
    with sound.stamped() as recording:
        for number in range(examples(20)):
            name = f"u{number}"
            speech.say(name, ("Yes.", "Please follow me.", "What happens next?", "Stop here!")[number % 4])
            start, end = speech.wait_state(name, "started"), speech.wait_state(name, "finished")
            until_ns = end.stamp_ns + 250_000_000
            wait_for(lambda until_ns=until_ns: time.monotonic_ns() > until_ns, "silence again")
            began_ns, ended_ns = recording.loud_between(start.stamp_ns - 250_000_000, until_ns, least=60)
            late_ms += [(start.stamp_ns - began_ns) / 1e6, (end.stamp_ns - ended_ns) / 1e6]
    print("late by ms:", [round(each) for each in late_ms])
    # A busy machine may delay the playback thread, and its clock reading, now and then.
    assert sorted(map(abs, late_ms))[-4] < 20.0


@pytest.mark.long
def test_silence_is_heard_at_once_and_drops_what_waits(sound: SoundServer, start_speech: StartSpeech) -> None:
    speech = start_speech(sound)
    speech.wait_ready()
    listening = sound.listen()
    for name in ("u1", "u2", "u3"):
        speech.say(name, LONG_SENTENCE)
    start = speech.wait_state("u1", "started")
    wait_for(lambda: listening.loud_span_s() > 0.8, "the sentence is under way")
    silenced_ns, recorded_until_s = speech.silence(), listening.length_s
    end = speech.wait_state("u1", "interrupted")
    speech.wait_state("u3", "interrupted")
    wait_for(lambda: listening.length_s > recorded_until_s + 1.0, "another second is recorded")
    assert speech.states == [("u1", "started"), ("u1", "interrupted"), ("u2", "interrupted"), ("u3", "interrupted")]
    # At once compared with the remaining three seconds.
    assert (end.stamp_ns - silenced_ns) / 1e9 < 1.0
    assert listening.loud_span_s(from_s=recorded_until_s) < 1.0
    assert 0.8 < _seconds(start, end) < 4.0
    speech.say("u4")
    speech.wait_state("u4", "finished")


@pytest.mark.long
def test_playback_is_reported_as_it_begins_and_when_it_is_cut_off(
    sound: SoundServer, start_speech: StartSpeech
) -> None:
    speech = start_speech(sound)
    speech.wait_ready()
    speech.connection.send(Say(clock.now_ns(), "u1", "Yes, Ada.", "wizard:a", recorded="Yes, {p-1}."))
    start = speech.wait_state("u1", "started")
    end = speech.wait_state("u1", "finished")
    assert (start.text, end.text) == ("Yes, {p-1}.",) * 2, "a name is spoken and its id recorded"
    played: list[PlayedSound] = [message for message in speech.heard if isinstance(message, PlayedSound)]
    assert {(one.utterance_id, one.text) for one in played} == {("u1", "Yes, Ada.")}
    assert played[0].stamp_ns == start.stamp_ns
    length_s = sum(len(one.samples) / one.sample_rate_hz for one in played)
    assert length_s == pytest.approx(_seconds(start, end), abs=0.02)
    assert not [message for message in speech.heard if isinstance(message, PlayedSoundEnded)]
    speech.say("u2", LONG_SENTENCE)
    speech.wait(lambda message: isinstance(message, PlayedSound), "the second one")
    speech.silence()
    ended = speech.wait(lambda message: isinstance(message, PlayedSoundEnded), "it is cut off")
    assert (ended.utterance_id, ended.stamp_ns) == ("u2", speech.wait_state("u2", "interrupted").stamp_ns)


@pytest.mark.long
def test_a_voice_that_is_not_here_is_replaced_by_one_that_is_and_the_wizard_is_notified(
    start_speech: StartSpeech,
) -> None:
    speech = start_speech(None)
    speech.wait_ready()
    speech.connection.send(UseVoice(SynthesisSettings("piper:de_DE-nobody-low", rate=1.8, at_hand=True)))
    told = speech.wait(lambda message: isinstance(message, Problem) and "another voice" in message.what, "a warning")
    assert "the voice de_DE-nobody-low is not on this computer" in told.what
    assert (told.severity, "models folder" in told.advice) == ("warning", True)
    assert speech.wait_ready().voice == "espeak:gmw/de", "of the same language"
    found: VoicesFound = speech.wait(lambda message: isinstance(message, VoicesFound), "the voices that there are")
    assert ("espeak:gmw/de", "de") in found.voices
    assert not [name for name, _ in found.voices if name.startswith("espeak:") and name != "espeak:gmw/de"]
    speech.say("u1", "Ja, das ist gut.")
    engine, usual_s = (
        speech.engine().pid,
        _seconds(speech.wait_state("u1", "started"), speech.wait_state("u1", "finished")),
    )
    speech.connection.send(UseVoice(SynthesisSettings("piper:de_DE-nobody-low", rate=0.9, at_hand=True)))
    speech.say("u2", "Ja, das ist gut.")
    slow_s = _seconds(speech.wait_state("u2", "started"), speech.wait_state("u2", "finished"))
    assert slow_s > 1.4 * usual_s, "it is tuned without a word"
    assert speech.engine().pid == engine


class ToldEngine:
    """Engine with scripted speech."""

    number = 1

    def send(self, do: str, **values: object) -> None: ...

    def close(self, *, grace_s: float) -> None: ...


@pytest.mark.parametrize("order", [("part", "started"), ("started", "part")])
def test_a_start_that_is_reported_before_its_sound_is_a_start(order: tuple[str, ...]) -> None:
    ours, theirs = _CONTEXT.Pipe()
    desk = _Synthesis(theirs, SynthesisDeadlines(open_s=0.0, heartbeat_s=60.0), queue.SimpleQueue())
    desk._engine = ToldEngine()  # type: ignore[assignment]
    desk._enter("idle", None)
    desk._on_command(Say(clock.now_ns(), "u1", "Yes."))
    desk._go_on()
    events = {
        "part": {"event": "part", "number": 1, "at": 0, "rate_hz": 1000, "sound": bytes(2000)},
        "started": {"event": "started", "at_ns": 5},
    }
    desk._on_engine({**events["part"], "number": 0})
    for name in order:
        desk._on_engine(events[name])
    assert desk._seconds_left() > 10.0, "it plays, and nobody waits for it to begin any more"  # type: ignore[operator]
    told = [ours.recv() for _ in range(2)]
    assert {type(message) for message in told} == {UtteranceChanged, PlayedSound}
    assert {message.stamp_ns for message in told} == {5}
    ours.close()
    theirs.close()


@pytest.mark.long
def test_another_voice_waits_for_the_end_of_the_sentence_and_is_then_loaded_at_once(start_speech: StartSpeech) -> None:
    speech = start_speech(None)
    speech.wait_ready()
    speech.say("u1")
    speech.wait_state("u1", "started")
    speech.connection.send(UseVoice(SynthesisSettings("espeak:gmw/de", rate=1.8, at_hand=True)))
    assert speech.wait_ready().voice == "espeak:gmw/de"
    assert speech.states == [("u1", "started"), ("u1", "finished")]


@pytest.mark.long
def test_without_an_output_utterances_take_their_time_and_one_warning_says_so(start_speech: StartSpeech) -> None:
    speech = start_speech(None)
    assert not speech.wait_ready().audible
    speech.say("u1")
    speech.say("u2", LONG_SENTENCE)
    start, end = speech.wait_state("u1", "started"), speech.wait_state("u1", "finished")
    assert 0.8 < _seconds(start, end) < 4.0
    assert "not heard" in end.detail
    speech.wait_state("u2", "started")
    speech.say("u3")
    silenced_ns = speech.silence()
    assert (speech.wait_state("u2", "interrupted").stamp_ns - silenced_ns) / 1e9 < 1.0
    speech.wait_state("u3", "interrupted")
    assert speech.actors == {("started", "wizard:a"), ("finished", "wizard:a"), ("interrupted", "wizard:b")}
    assert [problem.severity for problem in speech.problems] == ["warning"]
    assert "Utterances cannot be heard" in speech.problems[0].meaning


def test_a_sound_server_that_dies_and_returns(own_sound: SoundServer, start_speech: StartSpeech) -> None:
    speech = start_speech(own_sound)
    assert speech.wait_ready().audible
    listening = own_sound.listen()
    speech.say("u1", LONG_SENTENCE)
    start = speech.wait_state("u1", "started")
    wait_for(lambda: listening.loud_span_s() > 0.5, "the sentence is under way")
    own_sound.kill()
    assert not speech.wait_ready().audible
    end = speech.wait_state("u1", "finished")
    assert 2.0 < _seconds(start, end) < 10.0, "the rest of it takes its time, unheard"
    assert "not heard" in end.detail
    assert len(speech.problems) == 1
    own_sound.start()
    listening = own_sound.listen()
    speech.say("u2")
    assert speech.wait_ready().audible
    assert speech.wait_state("u2", "finished").detail == ""
    wait_for(lambda: listening.loud_span_s() > 0.5, "it is heard again")


@pytest.mark.long
def test_a_sound_server_that_hangs_is_abandoned(own_sound: SoundServer, start_speech: StartSpeech) -> None:
    speech = start_speech(own_sound, open_s=1.5)
    assert speech.wait_ready().audible
    own_sound.signal(signal.SIGSTOP)
    speech.say("u1")
    assert "not heard" in speech.wait_state("u1", "finished").detail
    assert len(speech.problems) == 1
    own_sound.signal(signal.SIGCONT)
    speech.say("u2")
    assert speech.wait_state("u2", "finished").detail == ""


@pytest.mark.long
def test_a_voice_that_hangs_is_replaced(start_speech: StartSpeech) -> None:
    speech = start_speech(None, render_s=1.0)
    speech.wait_ready()
    hung = speech.engine()
    hung.suspend()
    speech.say("u1")
    failed = speech.wait_state("u1", "failed")
    assert "timed out" in failed.detail
    speech.say("u2")
    speech.wait_state("u2", "finished")
    assert not hung.is_running()
    assert speech.engine().pid != hung.pid


@pytest.mark.long
def test_a_hanging_voice_is_silenced_all_the_same(sound: SoundServer, start_speech: StartSpeech) -> None:
    speech = start_speech(sound)
    speech.wait_ready()
    listening = sound.listen()
    speech.say("u1", LONG_SENTENCE)
    speech.wait_state("u1", "started")
    wait_for(lambda: listening.loud_span_s() > 0.3, "the sentence is under way")
    speech.engine().suspend()
    silenced_ns = speech.silence()
    end = speech.wait_state("u1", "interrupted")
    assert (end.stamp_ns - silenced_ns) / 1e9 < 1.5
    speech.say("u2", "Yes.")
    speech.wait_state("u2", "finished")


def test_a_voice_that_crashes_costs_the_sound_not_the_utterance(sound: SoundServer, start_speech: StartSpeech) -> None:
    speech = start_speech(sound)
    speech.wait_ready()
    speech.say("u1", LONG_SENTENCE)
    start = speech.wait_state("u1", "started")
    speech.engine().kill()
    end = speech.wait_state("u1", "finished")
    assert "not heard" in end.detail
    assert 2.0 < _seconds(start, end) < 10.0
    speech.say("u2", "Yes.")
    assert speech.wait_state("u2", "finished").detail == ""


def test_a_computer_without_a_voice_says_what_to_install(
    start_speech: StartSpeech, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "pyttsx3.py"
    broken.write_text("def init():\n    raise OSError('libespeak-ng.so.1: cannot open shared object file')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    speech = start_speech(None)
    failed: Problem = speech.wait(lambda message: isinstance(message, Problem), "the failure is told")
    assert "libespeak-ng.so.1" in failed.what
    assert "apt install espeak-ng" in failed.advice
    speech.say("u1")
    assert "no voice" in speech.wait_state("u1", "failed").detail
    broken.unlink()
    speech.say("u2", "Yes.")
    speech.wait_state("u2", "finished")


def test_an_unspeakable_text_is_refused_with_the_reason(start_speech: StartSpeech) -> None:
    speech = start_speech(None)
    speech.wait_ready()
    speech.say("u1", "word " * MAX_UTTERANCE_CHARACTERS)
    speech.say("u2", "\x00\x1b\n ")
    assert "longer than 1000" in speech.wait_state("u1", "failed").detail
    assert "nothing to say" in speech.wait_state("u2", "failed").detail
    speech.say("u3", "Y\x07es.\n")
    assert speech.wait_state("u3", "finished").text == "Y\x07es.\n", "what was asked comes back as it was"


def test_closing_interrupts_and_ends_both_processes(start_speech: StartSpeech) -> None:
    speech = start_speech(None)
    speech.wait_ready()
    engine = speech.engine()
    speech.say("u1", LONG_SENTENCE)
    speech.say("u2")
    speech.wait_state("u1", "started")
    with socket.socket(fileno=os.dup(speech.connection.fileno())) as half:
        half.shutdown(socket.SHUT_WR)  # as the console ends its children
    speech.wait_state("u2", "interrupted")
    assert speech.states == [("u1", "started"), ("u1", "interrupted"), ("u2", "interrupted")]
    speech.process.join(10)
    assert speech.process.exitcode == 0
    wait_for(lambda: not engine.is_running(), "the voice engine ended")


@pytest.mark.parametrize("end", ["console", "speech"])
def test_nothing_outlives_its_parent(start_speech: StartSpeech, end: str) -> None:
    speech = start_speech(None)
    speech.wait_ready()
    engine = speech.engine()
    speech.say("u1", LONG_SENTENCE)
    speech.wait_state("u1", "started")
    if end == "console":
        speech.connection.close()
    else:
        speech.process.kill()
    wait_for(lambda: not engine.is_running(), "the voice engine ended")
    speech.process.join(10)
    assert speech.process.exitcode is not None


def test_preflight_finds_the_sound_or_says_what_is_missing(sound: SoundServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PULSE_SERVER", sound.address)
    assert probe_sound().ok
    monkeypatch.setenv("PULSE_SERVER", NOWHERE)
    unheard = probe_sound()
    assert not unheard.ok
    assert "no sound output" in unheard.text
    assert "libasound2-plugins" in unheard.advice


def test_a_voice_that_cancels_itself_is_asked_again(tmp_path: Path) -> None:
    # pyttsx3 does this at random if espeak has not ended the last utterance; here it always happens.
    script = (
        "import pathlib, sys\n"
        "from caris_desktop.conversation.voices.voice_selection import EspeakVoice\n"
        "from caris_desktop.conversation.voices.utterance_sound import Stop\n"
        "voice = EspeakVoice('', '', rate=1.8, volume=1.0, folder=pathlib.Path(sys.argv[1]))\n"
        "for _ in range(4):\n"
        "    voice._engine.proxy._driver._stopping = True\n"
        "    (sound,) = voice.parts('Welcome to the robot laboratory.', Stop())\n"
        "    print('rendered', len(sound) / voice.rate_hz)\n"
    )
    ran = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path)], capture_output=True, text=True, timeout=60, check=True
    )
    lengths_s = [float(line.split()[1]) for line in ran.stdout.splitlines() if line.startswith("rendered")]
    assert len(lengths_s) == 4
    assert max(lengths_s) - min(lengths_s) < 0.01


@pytest.mark.parametrize(
    ("text", "spoken"),
    [(" Hello,\n\tyou\u200b \u202etwo. ", "Hello, you two."), ("Grüße, 你好!", "Grüße, 你好!"), ("\ud800\x00", "")],
)
def test_only_what_can_be_spoken_is_spoken(text: str, spoken: str) -> None:
    assert speakable(text) == spoken


@pytest.mark.logs("the plug-in lab of lab-lab failed")
def test_a_voice_of_the_program_replaces_a_plug_in_that_fails(
    start_speech: StartSpeech, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugin = """
import numpy as np

class Plugin:
    caris_interface = 1
    rate_hz = 16000

    def __init__(self, *, language):
        pass

    def speak(self, text, *, rate, volume):
        if "again" in text:
            raise KeyError("no such word")
        return np.full(8000, 1000, np.int16)
"""
    install(tmp_path / "packages", "speech", "lab", plugin, monkeypatch)
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(tmp_path / "packages"), os.environ.get("PYTHONPATH", ""))))
    speech = start_speech(None)
    speech.wait_ready()
    speech.connection.send(UseVoice(SynthesisSettings("plugin:lab", "en", at_hand=True)))
    speech.wait(lambda message: isinstance(message, SynthesisReady) and message.voice == "plugin:lab", "the plug-in")
    speech.say("u1", "Hello.")
    assert _seconds(speech.wait_state("u1", "started"), speech.wait_state("u1", "finished")) == pytest.approx(0.5, 0.3)
    speech.say("u2", "And again.")
    assert "no such word" in speech.wait_state("u2", "failed").detail
    assert any(problem.what.startswith("The plug-in lab (lab-lab 2.1) was switched off") for problem in speech.problems)
    speech.say("u3", "And again.")
    speech.wait_state("u3", "finished")
    speech.connection.send(UseVoice(SynthesisSettings("plugin:lab", "en", rate=1.1, at_hand=False)))
    speech.say("u4", "And again.")
    speech.wait_state("u4", "finished")
