"""Cameras of this computer: processes, their failures, and a change of scenario."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import pytest
import shiboken6
from PySide6.QtCore import QObject
from pytestqt.qtbot import QtBot

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.sensing import CameraState, FrameRef
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ChildProcess, ProcessSpec, RingToWrite
from caris_desktop.live.frame_ring import FrameRings
from caris_desktop.live.services import cameras_service
from caris_desktop.live.services.cameras_service import CameraSelection, CamerasService, OwnCamera
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import PerceptionStatus
from caris_desktop.perception.cameras.camera_process import PlayVideo
from caris_desktop.robot.profile_model import CameraTopic
from caris_desktop.scenario.scenario_model import PanelLeaf, Scenario
from tests.support.service_context import context_of

DESK = OwnCamera("desk", ProcessSpec("camera desk", print, ("0",)))
DOOR = OwnCamera("door", ProcessSpec("camera door", print, ("1",)), CameraModel(640, 480, 500.0, 500.0, 320.0, 240.0))
SCENARIO = Scenario("Test", PanelLeaf("video"))


class Child:
    """Double of a camera process."""

    def __init__(self, body: ProcessSpec, ended: Callable[[ChildProcess], None]) -> None:
        self.body = body
        self.ended = ended
        self.sent: list[Any] = []
        self.asked_to_end = self.stopped = False

    def send(self, message: Any) -> bool:
        self.sent.append(message)
        return True

    def ask_to_end(self) -> None:
        self.asked_to_end = True

    def stop(self, *, grace_s: float) -> None:
        assert grace_s > 0.0
        self.stopped = True


class Bench:
    """The service with process doubles that only record messages."""

    def __init__(self) -> None:
        self.owner = QObject()
        self.state = LiveState(self.owner)
        self.bus = Bus(self.state, self.owner)
        self.told: list[Any] = []
        self.bus.tap(lambda value, _raw: self.told.append(value))
        self.children: list[Child] = []
        self.slow_work = BackgroundWorker(self.owner)
        self.frames = FrameRings([])
        self.wanted = CameraSelection((DESK, DOOR))
        self.service = CamerasService(
            context_of(self.state, self.bus, self.owner, children=self, slow_work=self.slow_work),
            lambda _scenario: self.wanted,
            frames=self.frames,
        )

    def start(self, body: ProcessSpec, *, ended: Callable[[ChildProcess], None], **_: object) -> Child:
        self.children.append(Child(body, ended))
        return self.children[-1]

    def end(self, child: Child) -> None:
        child.ended(child)  # type: ignore[arg-type]

    def use(self, *own: OwnCamera) -> None:
        self.wanted = CameraSelection(own)
        self.service.use_scenario(SCENARIO)

    def named(self, name: str) -> Child:
        return [child for child in self.children if child.body.name == f"camera {name}"][-1]

    def problems(self) -> list[str]:
        return [value.what for value in self.told if hasattr(value, "what")]


@pytest.fixture
def bench(qtbot: QtBot, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(cameras_service, "_RESTART_AFTER_MS", 1)
    bench = Bench()
    yield bench
    bench.service.stop()
    bench.service.end()
    bench.slow_work.finish(lambda _what, work: work())
    bench.frames.close()
    bench.state.close()
    bench.bus.end()
    shiboken6.delete(bench.owner)


def test_each_writes_to_a_ring_of_its_own_and_ends_with_the_program(bench: Bench) -> None:
    bench.service.use_scenario(SCENARIO)
    assert bench.children == [], "the window comes first"
    bench.service.start()
    rings = [child.body.arguments[-1] for child in bench.children]
    assert [child.body.arguments[:-1] for child in bench.children] == [("0",), ("1",)]
    assert all(isinstance(ring, RingToWrite) for ring in rings)
    assert len({ring.name for ring in rings}) == 2
    assert sorted(bench.service.processes()) == ["camera desk", "camera door"]
    assert bench.state.own_cameras.value == {"desk": None, "door": DOOR.model}
    bench.service.stop()
    assert all(child.asked_to_end for child in bench.children)


def test_videos_play_once_a_person_watches(bench: Bench) -> None:
    bench.use(DESK)
    bench.service.start()
    bench.state.perception.set(PerceptionStatus(state="loading"))
    assert bench.named("desk").sent == []
    bench.state.perception.set(PerceptionStatus(state="ready"))
    bench.state.perception.set(PerceptionStatus(state="ready", inference_ms=3.0))
    bench.use(DESK, DOOR)
    assert [bench.named(name).sent for name in ("desk", "door")] == [[PlayVideo()], [PlayVideo()]]


@pytest.mark.logs("services.cameras|bus")
def test_one_that_crashes_is_started_again_three_times_and_its_picture_says_so(bench: Bench, qtbot: QtBot) -> None:
    bench.use(DESK, DOOR)
    bench.service.start()
    for starts in (2, 3, 4):
        bench.end(bench.named("desk"))
        qtbot.waitUntil(lambda starts=starts: len(bench.children) == starts + 1)
    bench.end(bench.named("desk"))
    states = [value for value in bench.told if isinstance(value, CameraState)]
    assert [(state.camera, state.state) for state in states] == [("desk", "lost")] * 4
    assert "being restarted" in states[0].advice and "restart the program" in states[-1].advice
    assert bench.problems() == ["The camera desk stopped unexpectedly."] * 4
    assert len(bench.children) == 5, "and then it is left alone; the other one goes on"
    desk_rings = {child.body.arguments[-1].name for child in bench.children if child.body.name == "camera desk"}
    assert len(desk_rings) == 1


@pytest.mark.logs("services.cameras|bus")
def test_a_video_that_was_played_to_its_end_is_not_started_again(bench: Bench, qtbot: QtBot) -> None:
    bench.use(DESK)
    bench.service.start()
    bench.bus.publish(CameraState(1, "desk", "ended"))
    bench.end(bench.named("desk"))
    qtbot.wait(20)
    assert len(bench.children) == 1
    assert bench.problems() == ["The video from the camera desk has ended."]


def test_another_scenario_ends_what_it_does_without_and_begins_what_it_wants(bench: Bench, qtbot: QtBot) -> None:
    bench.use(DESK)
    bench.service.start()
    desk = bench.named("desk")
    bench.state.add(FrameRef(1, None, "desk", "ring", 0, 1, 64, 48))
    assert (bench.state.cameras.value, bench.state.camera.value) == (("desk",), "desk")
    bench.use(DESK)
    assert not desk.asked_to_end, "what stays is not touched"
    bench.use(DOOR)
    assert desk.asked_to_end
    assert (bench.state.cameras.value, bench.state.camera.value, bench.state.frame.value) == ((), "", None)
    bench.bus.publish(FrameRef(2, None, "desk", "ring", 0, 2, 64, 48))  # the last one of a process that exits
    qtbot.waitUntil(lambda: bool(bench.service._free_rings))
    assert (desk.stopped, bench.state.cameras.value) == (True, ()), "it does not come back with it"
    assert list(bench.service.processes()) == ["camera door"]
    bench.end(desk)
    assert bench.problems() == []
    qtbot.waitUntil(lambda: bool(bench.service._free_rings))
    bench.use(DOOR, DESK)
    assert bench.named("desk").body.arguments[-1] == desk.body.arguments[-1], "the ring is used again"
    bench.use(DOOR, replace(DESK, body=replace(DESK.body, arguments=("7",))))
    assert bench.named("desk").body.arguments[0] == "7"


@pytest.mark.logs("bus")
def test_an_unusable_camera_is_reported_and_the_others_run(bench: Bench) -> None:
    bench.wanted = CameraSelection((DESK,), failures=(UserFacingError("No such camera.", "Not used.", "Correct it."),))
    bench.service.use_scenario(SCENARIO)
    bench.service.start()
    assert bench.problems() == ["No such camera."]
    assert len(bench.children) == 1


def test_of_the_robots_cameras_those_that_are_named_are_used() -> None:
    front, rear = CameraTopic("front", "/front"), CameraTopic("rear", "/rear")
    assert CameraSelection().among((front, rear)) == (front, rear)
    assert CameraSelection(of_robot=()).among((front, rear)) == ()
    assert CameraSelection(of_robot=("rear",)).among((front, rear)) == (rear,)
    own_front = OwnCamera("front", DESK.body)
    assert [each.name for each in CameraSelection((own_front,)).among((front, rear))] == ["robot-front", "rear"]
