"""Push-to-talk and robot microphone: playback, recording, and the end of both."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.conversation.sound_devices import (
    BeginPlaying,
    EndPlaying,
    PlaybackFailed,
    PlaybackStarted,
    PlayedOut,
    PlayThis,
    SetVolume,
)
from caris_desktop.domain import clock
from caris_desktop.domain.events import LinkChanged, Problem, UtteranceChanged
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.intents import HearRobot, PushToTalk
from caris_desktop.domain.link_commands import PlayOnRobot
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import PlayedSound
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.services import sound_service
from caris_desktop.live.services.sound_service import SoundAdapters, SoundService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import MicrophoneStatus, SpeechStatus
from caris_desktop.robot.profile_model import AudioInterface, RobotProfile
from caris_desktop.scenario.scenario_model import PanelLeaf, Permissions, Scenario, SoundSettings
from tests.live.bodies import echo
from tests.support.service_context import context_of

PIECE = np.full((640, 1), 1000, np.int16)
SPEAKING = RobotProfile("r", "R", audio=AudioInterface(speaker="/speaker"))
OTHER = "wizard:b"


class FakeChild:
    def __init__(self, body: ProcessSpec) -> None:
        self.body = body
        self.asked: list[Any] = []
        self.killed = False

    def send(self, message: Any) -> bool:
        self.asked.append(message)
        return True

    def kill(self) -> None:
        self.killed = True

    def ask_to_end(self) -> None: ...


class FakeChildren:
    def __init__(self) -> None:
        self.started: dict[str, FakeChild] = {}
        self.told: dict[str, dict[str, Callable[..., None]]] = {}

    def start(self, body: ProcessSpec, **told: Any) -> FakeChild:
        self.told[body.name] = told
        return self.started.setdefault(body.name, FakeChild(body))

    def dismiss(self, child: FakeChild, *, grace_s: float, **_then: object) -> None:
        assert grace_s > 0.0
        del self.started[child.body.name]

    def call_in_gui(self, take: Callable[[Any], None], value: Any) -> None:
        take(value)

    def pass_on(self, on_message: Callable[[Any], None], value: Any, _raw: bytes) -> None:
        on_message(value)


class FakeMicrophones:
    """Double of the service that records the activity of the wizard's microphone."""

    def __init__(self) -> None:
        self.wizards_choice: str | None = "Headset"
        self.did: list[str] = []

    def open_wizards(self) -> None:
        self.did.append("open")

    def mute_wizards(self) -> None:
        self.did.append("mute")

    def close_wizards(self) -> None:
        self.did.append("close")

    def need_hearing(self, needed: bool) -> None:
        self.did.append(f"hearing {needed}")


class FakeSpeech:
    def __init__(self) -> None:
        self.queue = self
        self.silenced: list[str] = []

    def silence(self, actor: str) -> None:
        self.silenced.append(actor)


class Bench:
    def __init__(self, **settings: Any) -> None:
        self.owner = QObject()
        self.state = LiveState(self.owner)
        self.bus = Bus(self.state, self.owner)
        self.happened: list[Any] = []
        self.bus.tap(lambda value, _raw: self.happened.append(value))
        self.children, self.microphones, self.speech = FakeChildren(), FakeMicrophones(), FakeSpeech()
        self.to_robot: list[PlayOnRobot] = []
        robot = QObject(self.owner)
        robot.send_sound = lambda command: not self.to_robot.append(command)  # type: ignore[attr-defined]
        self.service = SoundService(
            context_of(self.state, self.bus, self.owner, children=self.children),
            SoundAdapters(ProcessSpec("hearing", echo), ProcessSpec("voice", echo)),
            microphones=self.microphones,  # type: ignore[arg-type]
            robot=robot,  # type: ignore[arg-type]
            speech=self.speech,  # type: ignore[arg-type]
        )
        self.scenario = Scenario(
            "A study",
            PanelLeaf("video"),
            permissions=Permissions(own_voice=True, transcription=True),
            sound=SoundSettings(hear=True, **settings),
        )
        self.service.use_scenario(self.scenario)

    def close(self) -> None:
        self.service.stop()
        self.state.close()

    def do(self, intent: Any) -> None:
        self.service.handlers()[type(intent)](intent)

    def wizard_says(self, *, rate_hz: int = 16000) -> None:
        self.bus.publish(AudioChunk(clock.now_ns(), "wizard microphone", rate_hz, PIECE))

    def robot_hears(self) -> None:
        self.bus.publish(AudioChunk(clock.now_ns(), "robot microphone", 16000, PIECE))

    def told(self, name: str, message: Any) -> None:
        """Deliver a message of a process."""
        self.children.told[name]["reads"](message, b"")

    def utterances(self) -> list[UtteranceChanged]:
        return [value for value in self.happened if isinstance(value, UtteranceChanged)]

    def states(self) -> list[str]:
        return [utterance.state for utterance in self.utterances()]

    def asked(self, name: str, kind: type[Any]) -> list[Any]:
        return [message for message in self.children.started[name].asked if isinstance(message, kind)]


@pytest.fixture
def bench(qapp: QApplication) -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


def test_the_wizards_voice_comes_out_of_the_robot_and_is_on_record_from_its_start_to_its_end(
    bench: Bench, qtbot: QtBot
) -> None:
    bench.state.robot.set(SPEAKING)
    bench.do(PushToTalk(on=True, actor=OTHER))
    assert bench.state.sound.value.talking == "robot" and bench.microphones.did == ["open"]
    assert bench.states() == ["requested"]
    bench.wizard_says()
    bench.wizard_says()
    assert np.concatenate([each.samples for each in bench.to_robot]).shape == (1280, 1)
    requested, started = bench.utterances()
    assert (started.speaker, started.origin, started.source) == ("robot", "own_voice", "wizard microphone")
    assert started.estimated and started.actor == OTHER and started.utterance_id == requested.utterance_id
    sounds = [value for value in bench.happened if isinstance(value, PlayedSound)]
    assert len(sounds) == 2 and sounds[0].utterance_id == started.utterance_id, "for the echo canceller"
    bench.do(PushToTalk(on=False))
    assert bench.state.sound.value.talking == ""
    bench.wizard_says()
    assert len(bench.to_robot) == 3, "the last word is still on its way"
    qtbot.waitUntil(lambda: bench.states() == ["requested", "started", "finished"])
    assert bench.microphones.did == ["open", "mute"]
    bench.wizard_says()
    assert len(bench.to_robot) == 3


def test_out_of_this_computer_it_begins_and_ends_when_it_is_heard(bench: Bench, qtbot: QtBot) -> None:
    bench.do(PushToTalk(on=True))
    (begun,) = bench.asked("voice", BeginPlaying)
    bench.wizard_says()
    assert len(bench.asked("voice", PlayThis)) == 1 and bench.to_robot == []
    bench.told("voice", PlaybackStarted(begun.stream_id, 12_345, 16000, PIECE))
    assert bench.utterances()[-1].stamp_ns == 12_345 and not bench.utterances()[-1].estimated
    bench.do(PushToTalk(on=False))
    qtbot.waitUntil(lambda: bench.asked("voice", EndPlaying) == [EndPlaying()])
    assert bench.states() == ["requested", "started"], "it is still heard"
    bench.told("voice", PlayedOut(begun.stream_id, 67_890))
    assert bench.utterances()[-1].state == "finished" and bench.utterances()[-1].stamp_ns == 67_890


def test_playback_starts_once_it_will_be_needed(bench: Bench) -> None:
    bench.service.start()
    assert bench.children.started == {}, "which robot it will be is not known"
    bench.state.robot.set(SPEAKING)
    assert bench.children.started == {}, "it has a loudspeaker of its own"
    bench.state.robot.set(RobotProfile("mute", "Mute"))
    assert list(bench.children.started) == ["voice"]


def test_the_robots_own_voice_is_stopped(bench: Bench) -> None:
    utterance = UtteranceChanged(1, "u1", "robot", "Hello", "typed", "started")
    bench.state.speech.set(SpeechStatus(ready=True, now=utterance))
    bench.do(PushToTalk(on=True, actor=OTHER))
    assert bench.speech.silenced == [OTHER]


def test_dictation_opens_the_microphone_and_says_nothing(bench: Bench) -> None:
    bench.do(PushToTalk(on=True, to="dictation"))
    assert bench.state.sound.value.talking == "dictation"
    bench.wizard_says()
    assert bench.utterances() == [] and bench.to_robot == [] and bench.children.started == {}
    bench.do(PushToTalk(on=False, to="dictation"))
    assert bench.microphones.did == ["open", "mute"]


def test_a_missing_microphone_is_reported(bench: Bench) -> None:
    bench.microphones.wizards_choice = None
    with pytest.raises(UserFacingError, match="No microphone is selected"):
        bench.do(PushToTalk(on=True))
    assert bench.utterances() == []


@pytest.mark.logs(r"live\.bus: ")
def test_a_failure_is_reported_and_ends_the_utterance(bench: Bench) -> None:
    bench.state.robot.set(SPEAKING)
    bench.do(PushToTalk(on=True))
    bench.wizard_says()
    bench.service.follows()[LinkChanged](LinkChanged(1, "media", "lost", "ws://"))
    assert bench.states() == ["requested", "started", "interrupted"]
    assert bench.state.sound.value.talking == ""
    bench.do(PushToTalk(on=True))
    failed = MicrophoneStatus("failed", detail="The microphone cannot be heard.", role="wizard")
    bench.state.wizard_microphone.set(failed)
    assert bench.states()[-1] == "failed"
    problems = [value.what for value in bench.happened if isinstance(value, Problem)]
    assert problems == [
        "Your own voice was not played: the connection to the robot was lost.",
        "Your own voice was not played: the microphone is not working.",
    ]


def test_a_key_that_was_only_touched_leaves_nothing_unfinished(bench: Bench, qtbot: QtBot) -> None:
    bench.do(PushToTalk(on=True))
    bench.do(PushToTalk(on=False))
    qtbot.waitUntil(lambda: bench.states() == ["requested", "failed"])
    assert [value for value in bench.happened if isinstance(value, Problem)] == []


def test_the_microphone_is_closed_when_nobody_has_spoken_for_a_while(
    qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sound_service, "_OPEN_FOR_MS", 10)
    monkeypatch.setattr(sound_service, "_TAIL_MS", 1)
    bench = Bench()
    bench.do(PushToTalk(on=True))
    bench.do(PushToTalk(on=False))
    qtbot.waitUntil(lambda: bench.microphones.did[-1] == "close")
    bench.close()


def test_the_wizard_hears_along_but_not_their_own_voice(bench: Bench, qtbot: QtBot) -> None:
    bench.robot_hears()
    assert bench.children.started == {}
    bench.do(HearRobot(on=True, volume=0.5))
    assert bench.state.sound.value.hearing and bench.microphones.did == ["hearing True"]
    assert bench.asked("hearing", BeginPlaying) == [BeginPlaying("hearing", 0.5)]
    bench.robot_hears()
    assert len(bench.asked("hearing", PlayThis)) == 1
    bench.do(HearRobot(on=True, volume=0.2))
    assert bench.asked("hearing", SetVolume)[-1] == SetVolume(0.2)
    bench.do(PushToTalk(on=True))
    bench.robot_hears()
    bench.do(PushToTalk(on=False))
    bench.robot_hears()
    assert len(bench.asked("hearing", PlayThis)) == 1, "and a little longer: it comes back late"
    qtbot.waitUntil(lambda: not bench.service._deaf.isActive())
    bench.robot_hears()
    assert len(bench.asked("hearing", PlayThis)) == 2
    bench.do(HearRobot(on=False))
    assert bench.microphones.did[-1] == "hearing False" and bench.asked("hearing", EndPlaying) == [EndPlaying(True)]


@pytest.mark.logs(r"live\.bus: ")
def test_headphones_that_go_away_are_reported_and_a_scenario_can_forbid_it(bench: Bench) -> None:
    bench.do(HearRobot(on=True))
    bench.told("hearing", PlaybackFailed("hearing", "no output device"))
    assert not bench.state.sound.value.hearing
    assert "cannot be played to you: no output device" in next(
        value.what for value in bench.happened if isinstance(value, Problem)
    )
    bench.do(HearRobot(on=True))
    bench.service.use_scenario(replace(bench.scenario, sound=SoundSettings()))
    assert not bench.state.sound.value.hearing
    with pytest.raises(UserFacingError, match="does not allow listening to the robot"):
        bench.do(HearRobot(on=True))


def test_another_scenario_ends_what_it_does_not_permit(bench: Bench) -> None:
    bench.do(PushToTalk(on=True))
    bench.service.use_scenario(replace(bench.scenario, permissions=Permissions()))
    assert bench.state.sound.value.talking == ""
    assert not bench.children.started
