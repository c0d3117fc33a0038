"""The result of an utterance is recorded with its origin, even while the GUI thread is busy."""

import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import psutil
import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.conversation.synthesis_messages import Draft, Prepare
from caris_desktop.domain import clock
from caris_desktop.domain.events import (
    ANSWER,
    LinkChanged,
    LinkState,
    Problem,
    SuggestionChanged,
    UtteranceChanged,
    VoiceChanged,
)
from caris_desktop.domain.intents import DraftSpeech, SetVoice
from caris_desktop.domain.link_commands import RobotCommand
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, ProcessSpec
from caris_desktop.live.service import ProcessManager
from caris_desktop.live.services.alarms_service import AlarmsService
from caris_desktop.live.services.recording_service import ARRIVED, RecorderFeed
from caris_desktop.live.services.speech_service import SpeechService
from caris_desktop.live.speech_queue import VoiceKind
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import LinkStatus
from caris_desktop.robot.profile_model import RobotProfile, SpeechInterface
from caris_desktop.scenario.scenario_file import load_scenario
from tests.live.bodies import voice
from tests.support.service_context import context_of

WITHIN_S = 30.0


class Recorder:
    """Double of the recorder's pipe, written from any thread."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self.utterances: list[UtteranceChanged] = []

    def send_raw_waiting(self, raw: bytes) -> bool:
        assert raw[:1] == ARRIVED
        value = pickle.loads(raw[9:])  # noqa: S301 - written by this test
        if isinstance(value, UtteranceChanged):
            with self._changed:
                self.utterances.append(value)
                self._changed.notify_all()
        return True

    def wait_for(self, found: Callable[[], bool]) -> bool:
        """Wait without running the event loop."""
        with self._changed:
            return self._changed.wait_for(found, WITHIN_S)

    @property
    def told(self) -> list[tuple[str, str, str]]:
        return [(event.text, event.state, event.origin) for event in self.utterances]


class Bench:
    """The speech service with two real speech processes and a recorder."""

    def __init__(self) -> None:
        self.owner = QObject()
        self.state = LiveState(self.owner)
        self.bus = Bus(self.state, self.owner)
        self.recorder = Recorder()
        self.feed = RecorderFeed(self.recorder)  # type: ignore[arg-type]
        self.bus.tap(self.feed.put)
        self.feed.hold()
        self.feed.begin("begin")
        self.children = ProcessManager(self.bus, self.owner)
        self.speech = SpeechService(
            context_of(self.state, self.bus, self.owner, children=self.children),
            ProcessSpec("speech", voice, ("computer",)),
            robot=self,
        )
        self.bus.follow(self.speech.follows())
        self.speech.start()
        self.link = self.new_link()
        self.state.link.set(LinkStatus(state="connected"))

    def new_link(self) -> ChildProcess:
        return self.children.start(
            ProcessSpec("control", voice, ("robot",)),
            ended=lambda _child: None,
            on_message=self.speech.on_heard,
            reads=self.speech.read,
        )

    def send(self, command: RobotCommand) -> bool:
        return self.link.send(command)

    def close(self) -> None:
        self.children.close()
        self.children.end()
        self.speech.stop()
        self.speech.end()
        self.link.stop(grace_s=2.0)
        self.feed.close()
        self.state.close()


@pytest.fixture(scope="module")
def shared_bench(qapp: QApplication) -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


@pytest.fixture
def own_bench(qapp: QApplication) -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


@pytest.fixture
def bench(shared_bench: Bench) -> Bench:
    shared_bench.recorder.utterances.clear()
    return shared_bench


@pytest.mark.parametrize("kind", ["robot", "computer"])
def test_while_the_gui_thread_is_held_a_voice_comes_to_its_end_on_record(
    bench: Bench, qtbot: QtBot, kind: VoiceKind
) -> None:
    bench.speech.queue.use_voice(kind)
    bench.speech.queue.say("Hello", "phrase")
    # The event loop does not run from here on.
    assert bench.recorder.wait_for(lambda: len(bench.recorder.utterances) == 3)
    assert bench.recorder.told == [
        ("Hello", "requested", "phrase"),
        ("Hello", "started", "phrase"),
        ("Hello", "finished", "phrase"),
    ]
    assert bench.state.speech.value.now is not None, "the GUI thread has not heard of it"
    qtbot.waitUntil(lambda: bench.state.speech.value.now is None, timeout=20_000)
    assert len(bench.recorder.utterances) == 3, "and nothing of it is recorded twice"


def test_the_next_utterance_begins_once_the_gui_thread_knows_the_end(bench: Bench, qtbot: QtBot) -> None:
    events: list[Any] = []

    def note(event: object) -> None:
        events.append(event)

    bench.state.event_happened.connect(note)
    bench.speech.queue.use_voice("computer")
    bench.speech.queue.say("One", "typed")
    bench.speech.queue.say("Two", "assistant")
    qtbot.waitUntil(lambda: len(events) == 6, timeout=20_000)
    bench.state.event_happened.disconnect(note)
    assert bench.recorder.wait_for(lambda: len(bench.recorder.utterances) == 6)
    assert [told for told in bench.recorder.told if told[1] != "requested"] == [
        ("One", "started", "typed"),
        ("One", "finished", "typed"),
        ("Two", "started", "assistant"),
        ("Two", "finished", "assistant"),
    ]


def test_reports_of_a_replaced_link_are_not_recorded(bench: Bench, qtbot: QtBot) -> None:
    bench.speech.queue.use_voice("robot")
    before = bench.link
    mute = ChildProcess(ProcessSpec("control", voice, ("robot",)), on_message=lambda _value, _raw: None)
    mute.start()
    bench.link = mute  # a link that receives the sentence and dies
    bench.speech.queue.say("Hello", "typed")
    assert bench.state.speech.value.now is not None
    late = bench.state.speech.value.now
    mute.stop(grace_s=2.0)
    bench.link = before
    bench.bus.publish(LinkChanged(clock.now_ns(), "control", "connecting", "ws://r:9090"))
    qtbot.waitUntil(lambda: bench.state.speech.value.now is None, timeout=20_000)
    bench.speech.read(late, pickle.dumps(late))
    bench.bus.publish(replace(late, utterance_id="u-2", text="Good day", state="finished"))
    assert bench.recorder.wait_for(lambda: bench.recorder.told[-1:] == [("Good day", "finished", "typed")])
    assert [(event.state, event.detail) for event in bench.recorder.utterances[:-1]] == [
        ("requested", ""),
        ("failed", "the connection was lost"),
    ]


def test_a_failed_voice_does_not_fail_the_utterance_that_it_tries_next(bench: Bench, qtbot: QtBot) -> None:
    bench.speech.queue.use_voice("computer")
    pid = bench.speech.processes()["speech"].pid
    assert pid is not None
    failed = Problem(clock.now_ns(), "error", "No voice.", "Not spoken.", "Install one.", until="voice")
    os.kill(pid, signal.SIGSTOP)  # the report of the failure was sent before it received the utterance
    try:
        bench.speech.queue.say("Hello", "phrase")
        bench.speech.on_heard(failed)
    finally:
        os.kill(pid, signal.SIGCONT)
    qtbot.waitUntil(lambda: bench.state.speech.value.now is None, timeout=20_000)
    assert bench.recorder.wait_for(lambda: len(bench.recorder.utterances) == 3)
    assert [state for _, state, _ in bench.recorder.told] == ["requested", "started", "finished"]


def test_likely_texts_are_synthesised_ahead_the_likeliest_first(
    bench: Bench, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[Any] = []

    def send(message: Any) -> bool:
        sent.append(message)
        return True

    (process,) = bench.speech.supervised()
    monkeypatch.setattr(process, "send", send)
    scenario = replace(
        load_scenario(layouts_dir() / "tour-guide.yaml"), voice="robot", phrases=("Hi.",), filler="Hm.", fillers=()
    )
    bench.speech.use_scenario(scenario)
    assert [message for message in sent if isinstance(message, Prepare)] == [], "the robot speaks"
    bench.speech.use_scenario(replace(scenario, voice="computer"))
    assert not [message for message in sent if isinstance(message, Prepare)], "the other scenario is to be seen first"
    qtbot.waitUntil(lambda: sent[-1] == Prepare(("Hm.", "Hi.")))
    shown = SuggestionChanged(1, "s-1", "displayed", "u-1", 1, 1, "Yes, of course.", "embedded")
    bench.bus.publish(shown)
    bench.bus.publish(replace(shown, suggestion_id="s-2", text="Ask {p-1}."))
    qtbot.waitUntil(lambda: sent[-1] == Prepare(("Yes, of course.", "Hm.", "Hi.")))
    bench.bus.publish(replace(shown, state="dismissed"))
    qtbot.waitUntil(lambda: sent[-1] == Prepare(("Hm.", "Hi.")))
    typed = bench.speech.handlers()[DraftSpeech]
    typed(DraftSpeech("Good mor"))
    assert sent[-1] == Draft("Good mor")
    typed(DraftSpeech("Good morning {name}"))
    assert sent[-1] == Draft("Good mor"), "what it will be is not known yet"
    bench.speech.use_scenario(replace(scenario, voice="robot"))
    typed(DraftSpeech("Good morning."))
    assert sent.count(Draft("Good morning.")) == 0, "the robot makes its sound by itself"


def test_another_voice_is_used_reported_and_shown(bench: Bench, qtbot: QtBot) -> None:
    events: list[Any] = []

    def note(event: object) -> None:
        events.append(event)

    bench.state.event_happened.connect(note)
    bench.speech.handlers()[SetVoice](SetVoice("both", "espeak:de", rate=1.5, actor="wizard:b"))
    qtbot.waitUntil(lambda: any(isinstance(event, VoiceChanged) for event in events), timeout=20_000)
    bench.state.event_happened.disconnect(note)
    (changed,) = (event for event in events if isinstance(event, VoiceChanged))
    assert (changed.output, changed.name, changed.rate, changed.actor) == ("both", "espeak:de", 1.5, "wizard:b")
    shown = bench.state.voice.value
    assert (shown.output, shown.name, shown.rate) == ("both", "espeak:de", 1.5)
    bench.speech.queue.say("Hello", "typed")
    assert bench.recorder.wait_for(lambda: len(bench.recorder.utterances) == 3)
    assert [(event.state, event.voice) for event in bench.recorder.utterances] == [
        ("requested", "both"),
        ("started", "both"),
        ("finished", "both"),
    ]
    qtbot.waitUntil(lambda: bench.state.speech.value.now is None, timeout=20_000)


def test_without_speech_of_the_robot_this_computers_voice_does_not_run(own_bench: Bench, qtbot: QtBot) -> None:
    bench = own_bench
    speaks = replace(load_scenario(layouts_dir() / "tour-guide.yaml"), voice="computer")
    bench.speech.use_scenario(speaks)
    voices = bench.speech.processes
    child, pid = voices()["speech"], voices()["speech"].pid
    bench.speech.queue.say("This is cut off", "phrase")
    bench.speech.queue.say("This is never said", "phrase")
    bench.speech.use_scenario(replace(speaks, permissions=replace(speaks.permissions, speech=False)))
    assert voices() == {}
    qtbot.waitUntil(lambda: bench.state.speech.value.now is None, timeout=20_000)
    assert bench.state.speech.value.waiting == ()
    qtbot.waitUntil(lambda: not psutil.pid_exists(pid), timeout=20_000)
    bench.speech.use_scenario(speaks)
    assert voices()["speech"] is not child


def test_for_a_robot_without_speech_this_computer_speaks_and_reports_it_once(own_bench: Bench, qtbot: QtBot) -> None:
    bench, problems = own_bench, list[Problem]()
    bench.bus.follow({Problem: problems.append})
    scenario = replace(load_scenario(layouts_dir() / "tour-guide.yaml"), voice="robot")
    mute = RobotProfile("generic-ros1", "Robot with ROS 1")
    bench.state.robot.set(mute)
    bench.speech.use_scenario(scenario)
    bench.speech.queue.say("Hello", "phrase")
    assert bench.recorder.wait_for(lambda: len(bench.recorder.utterances) == 3)
    assert [(event.state, event.voice) for event in bench.recorder.utterances] == [
        ("requested", "computer"), ("started", "computer"), ("finished", "computer"),
    ]  # fmt: skip
    bench.speech.use_scenario(replace(scenario, voice="both"))
    bench.state.robot.set(replace(mute, address="ws://192.168.1.20:9090"))
    qtbot.waitUntil(lambda: bench.state.speech.value.now is None and bool(problems), timeout=20_000)
    assert ["has no voice." in problem.what for problem in problems] == [True]
    assert problems[0].severity == "info" and "This computer speaks instead" in problems[0].meaning
    assert problems[0].cause == ANSWER, "the window shows it as a note"
    assert bench.state.voice.value.output == "both", "what the scenario asks for stays"
    bench.state.robot.set(replace(mute, speech=SpeechInterface("/say")))
    assert bench.state.speech.value.voice == "both"
    bench.speech.use_scenario(scenario)
    bench.recorder.utterances.clear()
    bench.speech.queue.say("Hello again", "phrase")
    assert bench.recorder.wait_for(lambda: len(bench.recorder.utterances) == 3)
    assert {event.voice for event in bench.recorder.utterances} == {"robot"}


@pytest.mark.parametrize("link", ["lost", "connected"])
def test_failed_speech_is_an_alarm_until_the_next_utterance(
    own_bench: Bench, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch, link: LinkState
) -> None:
    bench = own_bench
    monkeypatch.setattr(bench, "send", lambda _command: False)
    alarms = AlarmsService(bench.state, bench.bus.publish, bench.owner)
    bench.bus.follow(alarms.follows())
    bench.speech.use_scenario(replace(load_scenario(layouts_dir() / "tour-guide.yaml"), voice="robot"))
    bench.state.robot.set(RobotProfile("mine", "Mine", speech=SpeechInterface("/say")))
    bench.state.link.set(LinkStatus(state=link))
    bench.speech.queue.say("Hello Ada and welcome", "phrase", recorded="Hello {p-1f} and welcome")
    qtbot.waitUntil(lambda: bool(bench.state.alarms.value), timeout=20_000)

    def told() -> str:
        return " ".join((*(alarm.what for alarm in bench.state.alarms.value),
                         *(line for alarm in bench.state.alarms.value for line in alarm.folded)))  # fmt: skip

    qtbot.waitUntil(lambda: "“Hello … and welcome” was not said." in told(), timeout=20_000)
    if link == "lost":
        assert [alarm.cause for alarm in bench.state.alarms.value] == ["link"], "one alarm says why"
        return
    monkeypatch.undo()
    bench.speech.queue.say("Hello again", "phrase")
    qtbot.waitUntil(lambda: bench.state.alarms.value == (), timeout=20_000)
