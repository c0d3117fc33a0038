"""The recogniser runs only if permitted and if a microphone is on, and nothing blocks on it."""

import pickle
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.conversation.listening.recogniser_messages import (
    EndTurns,
    RecogniserAway,
    RecogniserFailed,
    RecogniserReady,
    SpokenBy,
    UseSilence,
)
from caris_desktop.domain.events import Gap, Problem, UtteranceChanged, UtteranceCorrected
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import MICROPHONE, ROBOT_VOICE, WIZARD_MICROPHONE, PlayedSound
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.services.listening_service import TRANSCRIPTION_STREAM, ListeningFeed, ListeningService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import ListeningStatus, MicrophoneStatus, RecordingStatus, SoundStatus
from caris_desktop.scenario.scenario_model import ListeningSettings, PanelLeaf, Permissions, Scenario
from tests.live.bodies import echo
from tests.support.service_context import context_of

READY = RecogniserReady("tiny.en", "en", 0.5)
OPEN = MicrophoneStatus("on")
_PROBLEM = Problem(1, "warning", "It cannot.", "No text.", "Nothing to do.", until="transcription")


class FakeChild:
    """Recogniser double that records messages; ``stuck`` while it reads nothing."""

    def __init__(self, body: ProcessSpec) -> None:
        self.body = body
        self.got: list[Any] = []
        self.silences: list[UseSilence] = []
        self.reads = threading.Event()
        self.reads.set()
        self.asked_to_end = self.stopped = False

    def send_raw_waiting(self, raw: bytes) -> bool:
        self.reads.wait(5)
        message = pickle.loads(raw)  # noqa: S301 - written by this test
        (self.silences if isinstance(message, UseSilence) else self.got).append(message)
        return not self.asked_to_end

    def ask_to_end(self) -> None:
        self.asked_to_end = True
        self.reads.set()

    def stop(self, *, grace_s: float) -> None:
        self.stopped = True


class FakeChildren:
    def __init__(self) -> None:
        self.started: list[FakeChild] = []

    def start(self, body: ProcessSpec, **_told: object) -> FakeChild:
        self.started.append(FakeChild(body))
        return self.started[-1]

    def dismiss(self, child: FakeChild, *, grace_s: float, then: Callable[[], None]) -> None:
        child.ask_to_end()
        child.stop(grace_s=grace_s)
        then()


class Bench:
    def __init__(self) -> None:
        self.owner = QObject()
        self.state = LiveState(self.owner)
        self.bus = Bus(self.state, self.owner)
        self.children = FakeChildren()
        self.told: list[Any] = []
        self.bus.tap(lambda value, _raw: self.told.append(value), (Problem, Gap))
        self.service = ListeningService(
            context_of(self.state, self.bus, self.owner, children=self.children),
            lambda scenario: ProcessSpec("recogniser", echo, (scenario.listening.language,)),
        )

    @property
    def child(self) -> FakeChild:
        return self.children.started[-1]

    @property
    def status(self) -> ListeningStatus:
        status: ListeningStatus = self.state.listening.value
        return status

    def close(self) -> None:
        self.service.stop()
        self.service.end()
        self.state.close()


def scenario(*, transcription: bool = True, language: str = "en", silence_s: float = 0.3) -> Scenario:
    return Scenario(
        "Test", PanelLeaf("video"),
        permissions=Permissions(transcription=transcription),
        listening=ListeningSettings(language, silence_at_least_s=silence_s),
    )  # fmt: skip


def sound(source: str = MICROPHONE) -> AudioChunk:
    return AudioChunk(1, source, 16_000, np.zeros((1600, 1), np.int16))


@pytest.fixture
def bench(qapp: QApplication) -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.close()


def _listening(bench: Bench) -> FakeChild:
    bench.service.use_scenario(scenario())
    bench.service.start()
    bench.state.microphone.set(OPEN)
    bench.service.on_heard(READY)
    return bench.child


def test_it_is_started_only_where_it_is_permitted_and_a_microphone_is_open(bench: Bench, qtbot: QtBot) -> None:
    bench.service.use_scenario(scenario(transcription=False))
    bench.service.start()
    bench.state.microphone.set(OPEN)
    bench.bus.publish(sound())
    assert bench.children.started == []
    bench.state.microphone.set(MicrophoneStatus())
    bench.service.use_scenario(scenario())
    assert bench.children.started == []
    assert bench.status.state == "off"
    bench.state.microphone.set(OPEN)
    qtbot.waitUntil(lambda: len(bench.children.started) == 1)
    assert bench.status.state == "loading"
    bench.service.on_heard(READY)
    assert bench.status == ListeningStatus("ready", "tiny.en", "en")


def test_the_participants_sound_what_is_played_and_what_the_robot_says_reach_it(bench: Bench, qtbot: QtBot) -> None:
    child = _listening(bench)
    utterance = UtteranceChanged(5, "u-1", "robot", "Hello.", "typed", "started")
    bench.bus.publish(sound())
    bench.bus.publish(sound(ROBOT_VOICE))
    bench.bus.publish(PlayedSound(3, "u-1", "Hello.", 16_000, np.zeros((4, 1), np.int16)))
    bench.bus.publish(utterance)
    bench.bus.publish(replace(utterance, speaker="participant", utterance_id="h-1", origin="heard"))
    qtbot.waitUntil(lambda: len(child.got) == 3)
    assert [type(each) for each in child.got] == [AudioChunk, PlayedSound, UtteranceChanged]
    assert child.got[0].source == MICROPHONE


def test_the_wizard_is_heard_to_dictate_and_not_while_they_speak_through_the_robot(bench: Bench, qtbot: QtBot) -> None:
    child = _listening(bench)
    bench.state.sound.set(SoundStatus(talking="robot"))
    bench.bus.publish(sound(WIZARD_MICROPHONE))
    bench.state.sound.set(SoundStatus(talking="dictation"))
    bench.bus.publish(sound(WIZARD_MICROPHONE))
    bench.bus.publish(sound())
    qtbot.waitUntil(lambda: len(child.got) == 2)
    assert [each.source for each in child.got] == [WIZARD_MICROPHONE, MICROPHONE]


def test_it_is_reported_who_it_was_that_spoke(bench: Bench, qtbot: QtBot) -> None:
    child = _listening(bench)
    bench.service.follows()[UtteranceCorrected](UtteranceCorrected(7, "h-1", person_id="p-2"))
    qtbot.waitUntil(lambda: bool(child.got))
    assert child.got == [SpokenBy("h-1", "p-2")]


def test_turns_end_with_the_recording_and_with_a_pause_of_it(bench: Bench, qtbot: QtBot) -> None:
    child = _listening(bench)
    for state in ("starting", "recording", "paused", "recording", "stopping", "idle"):
        bench.state.recording.set(RecordingStatus(state))
    bench.bus.publish(sound())
    qtbot.waitUntil(lambda: bool(child.got) and isinstance(child.got[-1], AudioChunk))
    assert child.got[:-1] == [EndTurns(), EndTurns()]


def test_a_recogniser_that_does_not_read_holds_nobody_up_and_what_is_left_out_is_reported(
    bench: Bench, qtbot: QtBot
) -> None:
    child = _listening(bench)
    child.reads.clear()
    for _ in range(60):
        bench.bus.publish(sound())
    child.reads.set()
    qtbot.waitUntil(lambda: any(isinstance(each, Gap) for each in bench.told))
    (gap,) = (each for each in bench.told if isinstance(each, Gap))
    assert gap.stream == TRANSCRIPTION_STREAM
    qtbot.waitUntil(lambda: gap.count + len(child.got) == 60)


def test_other_pauses_are_sent_to_the_same_recogniser(bench: Bench, qtbot: QtBot) -> None:
    child = _listening(bench)
    bench.service.use_scenario(scenario(silence_s=0.6))
    qtbot.waitUntil(lambda: child.silences == [UseSilence(0.3, 3.0), UseSilence(0.6, 3.0)])
    assert bench.children.started == [child] and not child.asked_to_end


def test_another_language_is_another_recogniser_and_the_same_scenario_is_not(bench: Bench, qtbot: QtBot) -> None:
    first = _listening(bench)
    bench.service.use_scenario(scenario())
    assert bench.children.started == [first]
    bench.service.use_scenario(scenario(language="es"))
    assert first.stopped
    bench.state.microphone.set(MicrophoneStatus("on", level=0.5))
    assert bench.children.started == [first], "the window shows the other scenario first"
    qtbot.waitUntil(lambda: len(bench.children.started) == 2)
    bench.service.use_scenario(scenario(transcription=False))
    assert bench.child.stopped
    assert bench.status.state == "off"
    assert bench.service.processes() == {}


def test_one_that_cannot_says_so_and_is_not_started_again(bench: Bench) -> None:
    _listening(bench)
    bench.service.on_heard(RecogniserFailed(_PROBLEM))
    bench.state.microphone.set(MicrophoneStatus("on", level=0.5))
    assert bench.status == ListeningStatus("failed", detail="It cannot.")
    assert len(bench.children.started) == 1
    assert bench.told == [_PROBLEM]


def test_a_server_that_is_away_is_reported_and_then_that_it_is_back(bench: Bench) -> None:
    _listening(bench)
    bench.service.on_heard(RecogniserAway(_PROBLEM))
    assert bench.status.state == "failed"
    bench.service.on_heard(READY)
    assert bench.status.state == "ready"


@pytest.mark.logs("stopped unexpectedly")
def test_one_that_ends_automatically_is_started_again_three_times(bench: Bench) -> None:
    _listening(bench)
    for _ in range(5):
        bench.service._process.on_ended(bench.child)  # type: ignore[arg-type]
    assert len(bench.children.started) == 4
    assert bench.status.state == "failed"
    assert "restart the program" in bench.told[-1].advice


def test_the_feed_ends_while_its_reader_is_stuck() -> None:
    child = FakeChild(ProcessSpec("recogniser", echo))
    child.reads.clear()
    feed = ListeningFeed(child, lambda _gap: None)  # type: ignore[arg-type]
    feed.put(pickle.dumps(1))
    feed.end()
    child.ask_to_end()
    feed.join()
    assert not feed._thread.is_alive()
