"""A recording counts as running only with microphone data, and the wait for them has a timeout."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.conversation.sound_devices import (
    CloseMicrophone,
    MicrophoneFailed,
    MicrophoneList,
    MicrophoneOpened,
    OpenMicrophone,
)
from caris_desktop.domain import clock
from caris_desktop.domain.events import LinkChanged, Problem
from caris_desktop.domain.intents import TryMicrophone, UseMicrophone
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import Role
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.services import microphone_service
from caris_desktop.live.services.microphone_service import MicrophoneAdapters, MicrophoneChoice, MicrophoneService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import LinkStatus, MicrophoneStatus, RecordingStatus
from caris_desktop.robot.profile_model import AudioInterface, RobotProfile
from caris_desktop.scenario.scenario_model import PanelLeaf, Permissions, Scenario, SoundSettings
from tests.live.bodies import echo
from tests.support.service_context import context_of

HEADSET = MicrophoneOpened("Headset", 16000)


class FakeChild:
    """Double of the microphone process that records requests."""

    def __init__(self, body: ProcessSpec) -> None:
        self.body = body
        self.asked: list[object] = []
        self.send = self.asked.append
        self.killed = False
        self.dismissed = False

    def kill(self) -> None:
        self.killed = True


class FakeChildren:
    def __init__(self) -> None:
        self.started: list[FakeChild] = []
        self.of_wizard: list[FakeChild] = []
        self.told: list[dict[str, Callable[[Any], None]]] = []

    def start(self, body: ProcessSpec, **told: Any) -> FakeChild:
        child = FakeChild(body)
        if body.name == "participant":
            self.started.append(child)
            self.told.append(told)
        else:
            self.of_wizard.append(child)
        return child

    def dismiss(self, child: FakeChild, *, grace_s: float, **_then: object) -> None:
        child.dismissed = True


class Bench:
    def __init__(self, chosen: str | None, **permissions: bool) -> None:
        self.children = FakeChildren()
        self.kept: list[tuple[Role, str | None]] = []
        self.asked_robot: list[bool] = []
        self.asked_camera: list[tuple[str, bool]] = []
        self.told: list[str] = []
        self.begun = 0
        self.owner = QObject()
        state = self.state = LiveState(self.owner)
        bus = self.bus = Bus(state, self.owner)
        state.robot.set(RobotProfile("deaf", "Deaf"))
        bus.tap(lambda value, _raw: self.told.append(value.what), (Problem,))
        self.service = MicrophoneService(
            context_of(state, bus, self.owner, children=self.children),
            MicrophoneAdapters(self._choice("participant", chosen), self._choice("wizard", "Headset")),
            to_robot=lambda asked: self.asked_robot.append(asked.on),
            hear_camera=lambda camera, on: self.asked_camera.append((camera, on)),
        )
        self.permit(**permissions)

    def _choice(self, role: Role, chosen: str | None) -> MicrophoneChoice:
        body = ProcessSpec(role, echo)
        return MicrophoneChoice(body, chosen=lambda: chosen, keep=lambda name: self.kept.append((role, name)))

    def permit(self, *, ear: str = "auto", **permissions: bool) -> None:
        permitted = Permissions(**permissions)
        self.service.use_scenario(
            Scenario("A study", PanelLeaf("video"), permissions=permitted, sound=SoundSettings(ear))
        )

    @property
    def child(self) -> FakeChild:
        """The newest process."""
        return self.children.started[-1]

    def hear(self, message: object) -> None:
        """Deliver a message of the newest process."""
        self.children.told[-1]["on_message"](message)

    def begin(self) -> None:
        self.begun += 1


@pytest.fixture
def bench(qapp: QApplication) -> Iterator[Bench]:
    bench = Bench(chosen="", audio_recording=True)
    yield bench
    bench.service.close()


def test_work_that_waits_for_the_sound_runs_when_it_comes(bench: Bench) -> None:
    bench.service.open_and_then(bench.begin)
    bench.hear(MicrophoneList(("Headset",)))
    assert bench.child.asked == [OpenMicrophone("")]
    assert bench.begun == 0
    bench.hear(HEADSET)
    assert bench.begun == 1
    assert bench.told == []
    bench.service.close()
    bench.hear(HEADSET)
    assert bench.begun == 1


def test_a_microphone_that_fails_keeps_nobody_waiting(bench: Bench) -> None:
    bench.service.open_and_then(bench.begin)
    bench.hear(MicrophoneFailed(None))
    assert bench.begun == 1


def test_without_a_microphone_nothing_waits(qapp: QApplication) -> None:
    bench = Bench(chosen=None)
    bench.service.open_and_then(bench.begin)
    assert bench.begun == 1
    assert bench.children.started == []


def test_a_changed_mind_starts_nothing(bench: Bench) -> None:
    bench.service.open_and_then(bench.begin)
    bench.service.close()
    bench.hear(HEADSET)
    assert bench.begun == 0
    assert bench.child.asked[-1] == CloseMicrophone()


def test_sound_that_comes_too_late_is_reported_with_what_is_missing(
    qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(microphone_service, "_OPENS_WITHIN_MS", 10)
    bench = Bench(chosen="")
    bench.service.open_and_then(bench.begin)
    qtbot.waitUntil(lambda: bench.begun == 1)
    assert bench.told == []
    bench.hear(HEADSET)
    bench.hear(HEADSET)
    assert bench.begun == 1
    assert len(bench.told) == 1
    assert "s after the recording." in bench.told[0]
    bench.service.close()


def test_it_is_open_as_long_as_something_permitted_needs_it(qapp: QApplication) -> None:
    bench = Bench(chosen="", audio_recording=True, transcription=True)
    assert bench.children.started == [], "nothing before the window stands"
    bench.service.start()
    assert bench.child.asked == [OpenMicrophone("")]
    bench.hear(HEADSET)
    bench.service.open_and_then(bench.begin)
    assert bench.begun == 1, "it is heard already"
    bench.service.close()
    assert bench.state.microphone.value.state == "on", "the recording is over, speech is still turned into text"
    assert bench.child.asked == [OpenMicrophone("")]
    bench.permit(audio_recording=True)
    assert bench.child.asked[-1] == CloseMicrophone()
    assert bench.state.microphone.value.state == "off"
    bench.permit()
    assert bench.child.dismissed, "nothing permitted needs its process"


def test_without_a_permission_that_needs_it_no_process_is_started(qtbot: QtBot) -> None:
    bench = Bench(chosen="")
    bench.service.start()
    assert bench.children.started == []
    bench.permit(audio_recording=True)
    assert bench.children.started == [], "the other scenario is to be seen first"
    qtbot.waitUntil(lambda: bool(bench.children.started))
    assert bench.child.asked == [], "which there are is all that is found out"
    assert bench.children.of_wizard == []


def test_the_wizards_microphone_is_open_only_while_the_key_is_held(qapp: QApplication) -> None:
    bench = Bench(chosen=None, own_voice=True)
    bench.service.start()
    (child,) = bench.children.of_wizard
    assert child.asked == [], "its process is there, so that a key is heard soon"
    bench.service.open_wizards()
    assert child.asked == [OpenMicrophone("Headset")]
    assert bench.state.wizard_microphone.value.state == "starting"
    bench.service.close_wizards()
    assert child.asked[-1] == CloseMicrophone()
    bench.service.open_wizards()
    bench.permit()
    assert child.asked[-1] == CloseMicrophone(), "nothing permits it any more"


def test_another_scenario_opens_it_for_a_recording_that_runs_but_not_in_a_pause(bench: Bench) -> None:
    bench.state.recording.set(RecordingStatus("paused"))
    bench.permit(audio_recording=True)
    assert bench.children.started == []
    bench.state.recording.set(RecordingStatus("recording"))
    bench.permit(audio_recording=True)
    assert bench.child.asked == [OpenMicrophone("")]


def test_a_process_for_it_is_started_once_another_scenario_is_seen(qtbot: QtBot) -> None:
    bench = Bench(chosen="")
    bench.service.start()
    bench.state.recording.set(RecordingStatus("recording"))
    bench.permit(audio_recording=True)
    assert bench.children.started == []
    qtbot.waitUntil(lambda: bool(bench.children.started))
    assert bench.child.asked == [OpenMicrophone("")]
    bench.service.close()
    bench.permit(audio_recording=True)
    assert bench.child.asked == [OpenMicrophone(""), CloseMicrophone(), OpenMicrophone("")], "it is there: at once"
    bench.service.close()
    bench.state.recording.set(RecordingStatus("idle"))
    bench.service._soon.timeout.emit()
    assert bench.child.asked[-1] == CloseMicrophone(), "nothing is recorded any more"


def test_each_role_has_a_choice_of_its_own_that_is_retained(bench: Bench) -> None:
    use = bench.service.handlers()[UseMicrophone]
    use(UseMicrophone("Desk", "participant"))
    use(UseMicrophone(None, "wizard"))
    use(UseMicrophone(None, "wizard"))
    assert bench.kept == [("participant", "Desk"), ("wizard", None)]
    bench.service.open()
    assert bench.child.asked == [OpenMicrophone("Desk")]


def test_it_is_tried_for_a_little_while_and_then_closes_automatically(
    qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(microphone_service, "_TRIED_FOR_MS", 10)
    bench = Bench(chosen="", audio_recording=True)
    bench.service.handlers()[TryMicrophone](TryMicrophone())
    assert bench.child.asked == [OpenMicrophone("")]
    qtbot.waitUntil(lambda: bench.child.asked[-1] == CloseMicrophone())
    assert not bench.service.records


@pytest.mark.logs(r"live\.bus: ")
def test_a_process_that_got_stuck_is_killed_and_another_one_listens(
    qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(microphone_service, "_STARTS_WITHIN_MS", 10)
    bench = Bench(chosen="", audio_recording=True)
    bench.service.open()
    stuck, told = bench.children.started[0], bench.children.told[0]
    qtbot.waitUntil(lambda: stuck.killed)
    told["ended"](stuck)
    assert len(bench.children.started) == 2
    assert bench.child.asked == [OpenMicrophone("")]
    assert bench.state.microphone.value.state == "starting"
    assert bench.told == ["The microphone stopped unexpectedly."]
    bench.service.close()


EARED = RobotProfile("eared", "Eared", audio=AudioInterface("/audio"))
PIECE = np.full((1600, 1), 8192, np.int16)


def hear_robot(bench: Bench) -> None:
    bench.bus.publish(AudioChunk(clock.now_ns(), "robot microphone", 16000, PIECE))
    bench.service._distant.update_status()


def test_the_robots_microphone_is_requested_where_it_has_one(qapp: QApplication) -> None:
    bench = Bench(chosen="", transcription=True, audio_recording=True)
    bench.state.robot.set(EARED)
    bench.service.start()
    assert bench.asked_robot == [True] and bench.children.started == [], "no microphone of this computer"
    assert bench.state.microphone.value.state == "starting"
    bench.service.open_and_then(bench.begin)
    assert bench.begun == 0
    hear_robot(bench)
    assert bench.begun == 1
    assert bench.state.microphone.value == MicrophoneStatus(
        "on", "the robot's microphone", 0.25, source="robot microphone"
    )
    media = LinkChanged(1, "media", "connecting", "ws://")
    bench.service.follows()[LinkChanged](media)
    assert bench.asked_robot == [True, True], "a new link process knows nothing of it"
    bench.service.close()
    bench.state.robot.set(RobotProfile("deaf", "Deaf"))
    assert bench.asked_robot == [True, True, False]
    assert bench.child.asked == [OpenMicrophone("")], "another robot has none: this computer listens"
    bench.permit()
    assert bench.state.microphone.value.state == "off"


def test_the_microphone_of_a_camera_is_requested_by_its_name(qapp: QApplication) -> None:
    bench = Bench(chosen="")
    bench.service.start()
    bench.permit(ear="camera:desk", transcription=True)
    assert bench.asked_camera == [("desk", True)] and bench.asked_robot == []
    assert bench.state.microphone.value.name == "the microphone of the camera desk"
    bench.permit(ear="none", transcription=True)
    assert bench.asked_camera == [("desk", True), ("desk", False)]
    assert bench.state.microphone.value.state == "off"


def test_until_the_robot_is_known_nothing_listens_but_for_a_recording(qapp: QApplication) -> None:
    bench = Bench(chosen="", transcription=True, audio_recording=True)
    bench.state.robot.set(None)
    bench.service.start()
    assert bench.state.microphone.value.state == "off"
    bench.service.open()
    assert bench.state.microphone.value.state == "starting"
    bench.service.close()


@pytest.mark.logs(r"live\.bus: ")
def test_a_robot_that_sends_no_sound_is_reported_once_and_keeps_nobody_waiting(
    qapp: QApplication, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench = Bench(chosen="", audio_recording=True)
    bench.state.robot.set(EARED)
    bench.service.open_and_then(bench.begin)
    monkeypatch.setattr(microphone_service, "_SILENT_NS", 0)
    bench.service._distant.update_status()
    assert bench.begun == 1
    assert bench.state.microphone.value.state == "failed"
    assert bench.told == [], "a robot that is not there yet sends nothing, and that is no news"
    bench.state.link.set(LinkStatus("connected"))
    bench.service._distant.update_status()
    bench.service._distant.update_status()
    assert bench.begun == 1
    assert bench.told == ["An open microphone sends no sound: the robot's microphone."]
    monkeypatch.undo()
    hear_robot(bench)
    assert bench.state.microphone.value.state == "on"
    bench.service.close()
