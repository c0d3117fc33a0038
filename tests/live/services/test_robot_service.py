"""Robot service: requests to the link, displayed state and refusals, with process doubles."""

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import shiboken6
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.domain import link_commands
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.control_definitions import CallService, RobotControl
from caris_desktop.domain.events import (
    ControlUsed,
    GoalChanged,
    LinkChanged,
    LinkQuality,
    MappingChanged,
    MapRequestChanged,
    TrafficMeasured,
)
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import BatteryState, FrameRef, OccupancyGrid, RobotPose
from caris_desktop.live.background_worker import AsyncioThread, BackgroundWorker
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.live.services.cameras_service import CameraSelection, OwnCamera
from caris_desktop.live.services.robot_service import RobotConnection, RobotService
from caris_desktop.live.state import LiveState
from caris_desktop.robot.link import LinkSettings
from caris_desktop.robot.profile_model import CameraTopic, RobotProfile, VelocityTopic
from caris_desktop.scenario.scenario_model import PanelLeaf, Place, Scenario
from tests.support.service_context import context_of

KITCHEN = Place("Kitchen", Pose2D(4.0, 2.0, 0.0))
WAVE = RobotControl("wave", "Wave", "button", CallService("/wave", "std_srvs/Trigger", {}))
LIGHT = RobotControl("light", "Light", "toggle", CallService("/light", "std_srvs/SetBool", {"data": "$value"}))
STOPS_BY_ITSELF = VelocityTopic(timeout_s=0.5, timeout_source="its manual")


class Child:
    """Double of a link process that records messages."""

    def __init__(self, body: ProcessSpec) -> None:
        self.body = body
        self.sent: list[Any] = []
        self.stopped = False
        self.asked_to_end = False
        self.others: list[Child] = []
        self.others_asked: list[bool] = []

    def send(self, command: Any) -> bool:
        self.sent.append(command)
        return True

    def ask_to_end(self) -> None:
        self.asked_to_end = True

    def stop(self, *, grace_s: float) -> None:
        self.others_asked = [child.asked_to_end for child in self.others]
        self.stopped = True


class Bench:
    def __init__(self) -> None:
        self.owner = QObject()
        self.state = LiveState(self.owner)
        self.ring = FrameRing.create()
        self.children: list[Child] = []
        self.published: list[Any] = []
        self.problems: list[str] = []
        self.goals_begun = 0
        self.asyncio = AsyncioThread()
        self.slow_work = BackgroundWorker(self.owner)
        self.wanted = CameraSelection()
        bus = SimpleNamespace(
            publish=self.published.append,
            answer=None,
            problem=lambda _severity, *words, **_: self.problems.append(" ".join(words)),
        )
        self.robot = RobotService(
            context_of(self.state, bus, self.owner, slow_work=self.slow_work),  # type: ignore[arg-type]
            self.ring,
            new_child=self._new_child,  # type: ignore[arg-type]
            before_goal=self._before_goal,
            selected_cameras=lambda _scenario: self.wanted,
            asyncio_thread=self.asyncio,
        )

    def _new_child(self, body: ProcessSpec) -> Child:
        child = Child(body)
        child.others = list(self.children)
        self.children.append(child)
        for other in child.others:
            other.others.append(child)
        return child

    def _before_goal(self) -> None:
        self.goals_begun += 1

    def connect(self, profile: RobotProfile | None = None) -> None:
        profile = profile or RobotProfile("r", "R", velocity=STOPS_BY_ITSELF, controls=(WAVE,))
        bodies = ProcessSpec("control", print), ProcessSpec("media", print)
        self.robot.connect_robot(RobotConnection("R", "ws://r:9090", profile, *bodies))
        self.robot.on_event(LinkChanged(1, "control", "connected", "ws://r:9090"))
        self.state.drive.set(replace(self.state.drive.value, allowed=True, reason=""))

    @property
    def control(self) -> Child:
        return [child for child in self.children if child.body.name == "control"][-1]

    def asked(self, kind: type[Any]) -> list[Any]:
        return [command for command in self.control.sent if isinstance(command, kind)]


@pytest.fixture
def bench(qtbot: QtBot) -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.robot.stop()
    bench.slow_work.finish(lambda _what, work: work())
    bench.asyncio.stop()
    bench.ring.close()
    # Not left to the garbage collector, which may run in another thread.
    shiboken6.delete(bench.owner)


def test_a_place_and_a_point_are_driven_to(bench: Bench) -> None:
    bench.state.places.set((KITCHEN,))
    bench.connect()
    bench.robot.go_to_place("Kitchen")
    bench.robot.go_to(Pose2D(1.0, 1.0, 0.5))
    assert [(goal.target_in_map, goal.place) for goal in bench.asked(link_commands.GoTo)] == [
        (KITCHEN.pose_in_map, "Kitchen"),
        (Pose2D(1.0, 1.0, 0.5), None),
    ]
    assert bench.goals_begun == 2
    assert bench.problems == []


def test_a_forbidden_drive_is_not_sent_and_the_wizard_knows_the_reason(bench: Bench) -> None:
    bench.state.places.set((KITCHEN,))
    bench.connect()
    bench.state.drive.set(replace(bench.state.drive.value, allowed=False, reason="Emergency stop active"))
    bench.robot.go_to_place("Kitchen")
    bench.robot.go_to_place("Cellar")
    assert bench.asked(link_commands.GoTo) == []
    assert "No goal was sent. Emergency stop active. Send the goal again when this has changed." in bench.problems[0]
    assert "no such place" in bench.problems[1]


def test_maps_and_the_initial_pose_are_requested(bench: Bench) -> None:
    bench.connect()
    bench.robot.set_initial_pose(Pose2D(1.0, 2.0, 3.0))
    bench.robot.request_map("save", "lab")
    assert bench.asked(link_commands.SetInitialPose)[0].pose_in_map == Pose2D(1.0, 2.0, 3.0)
    (request,) = bench.asked(link_commands.RequestMap)
    assert (request.operation, request.name) == ("save", "lab")
    bench.robot.on_event(MapRequestChanged(1, request.request_id, "save", "lab", "requested"))
    assert bench.state.mapping.value.busy == "save"
    bench.robot.on_event(MapRequestChanged(1, request.request_id, "save", "lab", "failed", "the disk is full"))
    assert bench.state.mapping.value.busy == ""
    assert "the disk is full" in bench.problems[0]
    bench.robot.on_event(MappingChanged(1, mapping=True, can_save=True))
    assert (bench.state.mapping.value.mapping, bench.state.mapping.value.can_save) == (True, True)
    assert not bench.state.mapping.value.can_load


def test_without_a_link_nothing_is_asked_and_that_is_reported(bench: Bench) -> None:
    bench.connect()
    bench.robot.on_event(LinkChanged(1, "control", "lost", "ws://r:9090"))
    bench.robot.set_initial_pose(Pose2D(1.0, 2.0, 3.0))
    bench.robot.request_map("load", "lab")
    bench.robot.use_control("wave", True)
    assert not bench.asked(link_commands.SetInitialPose) and not bench.asked(link_commands.RequestMap)
    assert not bench.asked(link_commands.UseControl)
    assert len(bench.problems) == 3


def test_controls_of_the_scenario_join_those_of_the_profile(bench: Bench) -> None:
    bench.connect()
    bench.robot.offer_controls((LIGHT,), driving_permitted=True)
    assert bench.state.controls.value == (WAVE, LIGHT)
    assert bench.asked(link_commands.OfferControls)[-1].controls == (LIGHT,)
    louder = replace(WAVE, title="Wave twice")
    bench.robot.offer_controls((louder,), driving_permitted=True)
    assert bench.state.controls.value == (louder,)


def test_without_driving_there_is_no_control_that_moves_the_robot(bench: Bench) -> None:
    bench.connect()
    lamp = replace(LIGHT, id="lamp", moves=False)
    bench.robot.offer_controls((LIGHT, lamp), driving_permitted=False)
    assert bench.state.controls.value == (lamp,)
    assert bench.asked(link_commands.OfferControls)[-1].driving_permitted is False
    bench.robot.use_control("wave", True)
    assert bench.asked(link_commands.UseControl) == []


def test_a_new_connection_hears_of_the_scenarios_controls_again(bench: Bench) -> None:
    bench.connect()
    bench.robot.offer_controls((LIGHT,), driving_permitted=True)
    bench.robot.on_event(LinkChanged(1, "control", "lost", "ws://r:9090"))
    bench.robot.on_event(LinkChanged(2, "control", "connected", "ws://r:9090"))
    assert [command.controls for command in bench.asked(link_commands.OfferControls)][-2:] == [(LIGHT,), (LIGHT,)]


def test_a_robot_that_may_not_stop_automatically_is_reported_once(bench: Bench) -> None:
    bench.connect(RobotProfile("r", "R"))
    assert len(bench.problems) == 1
    assert "half speed" in bench.problems[0]
    bench.robot.on_event(LinkChanged(1, "control", "lost", "ws://r:9090"))
    bench.robot.on_event(LinkChanged(2, "control", "connected", "ws://r:9090"))
    bench.connect()
    assert len(bench.problems) == 1


def test_a_robot_that_may_not_stop_is_reported_again_after_another(
    bench: Bench,
) -> None:
    profile = RobotProfile("r", "R")
    bench.connect(profile)
    bench.robot.leave_for(RobotConnection("O", "ws://o:9090", RobotProfile("o", "O"), bench.control.body, None))()
    bench.connect(profile)
    assert ["half speed" in problem for problem in bench.problems] == [True, True]


def test_the_emergency_stop_outlives_the_link_process_and_the_robot(bench: Bench, qtbot: QtBot) -> None:
    bench.connect()
    assert not bench.asked(link_commands.SetEmergencyStop)
    bench.state.drive.set(replace(bench.state.drive.value, emergency_stop=True))
    bench.connect()
    assert isinstance(bench.control.sent[0], link_commands.SetEmergencyStop)
    assert [command.latched for command in bench.asked(link_commands.SetEmergencyStop)] == [True]
    bench.robot.on_child_ended(bench.control)  # type: ignore[arg-type]
    bench.robot.on_event(LinkChanged(3, "control", "lost", "ws://r:9090"))
    children = len(bench.children)
    qtbot.waitUntil(lambda: len(bench.children) > children)
    bench.robot.on_event(LinkChanged(4, "control", "connected", "ws://r:9090"))
    assert [command.latched for command in bench.asked(link_commands.SetEmergencyStop)] == [True]
    # The process itself remembers the origin of the latch.
    bench.robot.on_event(LinkChanged(5, "control", "lost", "ws://r:9090"))
    bench.robot.on_event(LinkChanged(6, "control", "connected", "ws://r:9090"))
    assert len(bench.asked(link_commands.SetEmergencyStop)) == 1


def test_a_control_link_that_had_worked_is_started_again_at_once(bench: Bench) -> None:
    bench.connect()
    bench.robot._control_since_ns -= 10_000_000_000
    bench.robot.on_child_ended(bench.control)  # type: ignore[arg-type]
    children = len(bench.children)
    for _ in range(3):
        QApplication.processEvents()
    assert len(bench.children) == children + 1


def test_both_links_of_the_robot_before_end_side_by_side(bench: Bench) -> None:
    bench.connect()
    control, media = bench.children
    bench.connect()
    assert control.stopped
    assert media.stopped
    assert control.others_asked == [True]


def test_a_robot_is_left_without_waiting_for_its_links(bench: Bench, qtbot: QtBot) -> None:
    bench.connect()
    links = list(bench.children)
    bench.robot.on_child_ended(bench.control)  # type: ignore[arg-type]
    wait = bench.robot.leave_for(RobotConnection("Other", "ws://o:9090", RobotProfile("o", "O"), links[0].body, None))
    assert (bench.state.link.value.state, bench.state.link.value.robot) == ("connecting", "Other")
    assert links[1].asked_to_end and not links[1].stopped
    bench.robot._restart_link("control")
    assert (bench.robot.links, bench.children) == ({}, links), "nor is one of them made again"
    assert not bench.robot.send(link_commands.StopMotion(now_ns()))
    wait()
    assert links[1].stopped


def test_the_use_of_a_control_and_its_outcome_are_shown(bench: Bench) -> None:
    bench.connect()
    bench.robot.use_control("wave", True)
    bench.robot.use_control("unknown", True)
    (used,) = bench.asked(link_commands.UseControl)
    bench.robot.on_event(ControlUsed(1, used.request_id, "wave", True, "failed", "the arm is folded"))
    status = bench.state.control_states.value["wave"]
    assert (status.state, status.detail) == ("failed", "the arm is folded")


def test_another_robot_leaves_nothing_of_the_first_on_show(bench: Bench) -> None:
    bench.connect()
    first = bench.control
    bench.robot.on_event(GoalChanged(1, "g", "active", Pose2D(1.0, 1.0, 0.0)))
    bench.robot.on_event(TrafficMeasured(1, "control", "cbor", 0, ()))
    bench.robot.on_event(LinkQuality(1, 3.0, 12.0, 1.0))
    assert bench.state.link.value.clock_offset_ms == 12.0
    bench.connect(RobotProfile("other", "Other"))
    assert first.stopped
    assert bench.state.robot.value.name == "other"
    assert bench.state.goal.value is None
    assert bench.state.traffic.value == {}
    assert bench.state.controls.value == ()


def test_a_link_that_dies_is_started_again_and_the_other_continues(bench: Bench, qtbot: QtBot) -> None:
    bench.connect()
    control, media = bench.children
    bench.robot.on_child_ended(control)  # type: ignore[arg-type]
    lost = [event.state for event in bench.published if isinstance(event, LinkChanged)]
    assert lost == ["lost"]
    qtbot.waitUntil(lambda: len(bench.children) == 3)
    assert bench.children[2].body.name == "control"
    assert not media.stopped
    bench.robot.on_child_ended(control)  # type: ignore[arg-type]  # old news
    assert len([event for event in bench.published if isinstance(event, LinkChanged)]) == 1


def test_an_active_goal_ends_with_its_link_process_and_the_next_one_cancels_it(bench: Bench, qtbot: QtBot) -> None:
    settings = LinkSettings(RobotProfile("r", "R"), "ws://r:9090")
    bodies = ProcessSpec("control", print, (settings,)), ProcessSpec("media", print, (settings,))
    bench.robot.connect_robot(RobotConnection("R", "ws://r:9090", settings.profile, *bodies))
    control = bench.children[0]
    assert control.body.arguments[0].follows_crash is False
    under_way = GoalChanged(now_ns(), "g", "active", Pose2D(4.0, 2.0, 0.0), "Kitchen")
    bench.robot.on_event(under_way)
    bench.robot.on_child_ended(control)  # type: ignore[arg-type]
    [ended] = [event for event in bench.published if isinstance(event, GoalChanged)]
    assert (ended.goal_id, ended.state, ended.place) == ("g", "failed", "Kitchen")
    qtbot.waitUntil(lambda: len(bench.children) == 3)
    assert bench.children[2].body.arguments[0].follows_crash is True


def _told_of_the_robot(bench: Bench) -> None:
    """Values of both links in normal operation."""
    now = now_ns()
    bench.state.add(OccupancyGrid(now, None, 0.05, Pose2D(0.0, 0.0, 0.0), np.zeros((2, 3), np.int8)))
    bench.state.add(RobotPose(now, None, Pose2D(1.0, 2.0, 0.0)))
    bench.state.add(BatteryState(now, 0.5))
    bench.robot.on_event(MappingChanged(now, mapping=True, can_save=True))


def test_neither_connecting_nor_trouble_takes_anything_away_and_loss_only_what_came_over_that_link(
    bench: Bench,
) -> None:
    bench.connect()
    _told_of_the_robot(bench)
    state = bench.state
    # The media link may connect first: the connection of the control link must not clear the map.
    for link, state_ in (("control", "connecting"), ("control", "connected"), ("media", "connecting")):
        bench.robot.on_event(LinkChanged(1, link, state_, "ws://r:9090"))  # type: ignore[arg-type]
    for link in ("control", "media"):
        bench.robot.on_event(LinkChanged(2, link, "trouble", "ws://r:9090"))
        bench.robot.on_event(LinkChanged(3, link, "connected", "ws://r:9090"))
    assert None not in (state.map.value, state.pose.value, state.battery.value)
    assert state.mapping.value.can_save
    offered = len(bench.asked(link_commands.OfferControls))
    bench.robot.on_event(LinkChanged(4, "control", "lost", "ws://r:9090"))
    assert (state.pose.value, state.battery.value, state.mapping.value.can_save) == (None, None, False)
    assert state.map.value is not None
    bench.robot.on_event(LinkChanged(5, "control", "connected", "ws://r:9090"))
    assert len(bench.asked(link_commands.OfferControls)) == offered + 1
    bench.robot.on_event(LinkChanged(6, "media", "lost", "ws://r:9090"))
    assert state.map.value is None


def test_a_robot_whose_ros_is_open_is_asked_until_it_answers(bench: Bench, qtbot: QtBot) -> None:
    bodies = ProcessSpec("control", print), ProcessSpec("media", print)
    settled = RobotConnection("R2", "ws://r:9090", RobotProfile("r2", "R2", ros=2), *bodies)
    asked = []

    async def settle() -> RobotConnection:
        asked.append(1)
        if len(asked) == 1:
            raise UserFacingError("Nobody answers.", "There is no robot.", "Start it.")
        return settled

    bench.robot.connect_robot(RobotConnection("R", "ws://r:9090", RobotProfile("r", "R"), *bodies, settle))
    assert bench.children == []
    qtbot.waitUntil(lambda: len(bench.children) == 2)
    assert bench.robot.connection is settled
    assert bench.problems == ["Nobody answers. There is no robot. Start it."]


def test_another_scenarios_choice_of_cameras_reaches_the_link_for_pictures_alone(bench: Bench, qtbot: QtBot) -> None:
    cameras = (CameraTopic("front", "/front"), CameraTopic("rear", "/rear"))
    profile = RobotProfile("r", "R", velocity=STOPS_BY_ITSELF, cameras=cameras)
    settings = LinkSettings(profile, "ws://r:9090")
    bodies = ProcessSpec("control", print, (settings,)), ProcessSpec("media", print, (settings,))
    scenario = Scenario("Test", PanelLeaf("video"))
    bench.wanted = CameraSelection(of_robot=("rear",))
    bench.robot.use_scenario(scenario)
    bench.robot.connect_robot(RobotConnection("R", "ws://r:9090", profile, *bodies))
    control, media = bench.children
    assert [camera.name for camera in bench.state.robot.value.cameras] == ["rear"]
    assert media.body.arguments[0].profile.cameras == cameras[1:]
    bench.robot.use_scenario(scenario)
    assert not media.asked_to_end
    bench.wanted = CameraSelection((OwnCamera("front", ProcessSpec("camera front", print)),))
    bench.robot.use_scenario(scenario)
    qtbot.waitUntil(lambda: len(bench.children) == 3)
    assert (control.asked_to_end, media.stopped) == (False, True)
    assert [camera.name for camera in bench.children[2].body.arguments[0].profile.cameras] == ["robot-front", "rear"]
    assert [camera.name for camera in bench.state.robot.value.cameras] == ["robot-front", "rear"]


def test_a_lost_link_takes_the_robots_picture_and_leaves_that_of_this_computer(bench: Bench) -> None:
    bench.connect()
    bench.state.own_cameras.set({"desk": None})
    for camera, kept in (("front", False), ("desk", True)):
        bench.state.add(FrameRef(now_ns(), None, camera, "ring", 0, 1, 64, 48))
        bench.state.choose_camera(camera)
        bench.state.add(FrameRef(now_ns(), None, camera, "ring", 0, 1, 64, 48))
        bench.robot.on_event(LinkChanged(2, "media", "lost", "ws://r:9090"))
        assert (bench.state.frame.value is not None) is kept
        assert (bench.state.frame_of(camera).value is not None) is kept
