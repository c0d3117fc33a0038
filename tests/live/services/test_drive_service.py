"""Hold-to-drive: commands to the link."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.actor import SCRIPT, WIZARD
from caris_desktop.domain.events import DriveEnded, GuardChanged, NavigationSpeedChanged
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.link_commands import (
    Drive,
    LimitGoals,
    Release,
    RenewLease,
    RobotCommand,
    SetEmergencyStop,
    SetGuard,
    StopMotion,
)
from caris_desktop.domain.sensing import FrameRef, LaserScan
from caris_desktop.live.services.drive_service import STALE_CAP_FRACTION, DriveService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import LinkStatus
from caris_desktop.robot.profile_model import CameraTopic, MotionLimits, RobotProfile, TopicSource, VelocityTopic
from caris_desktop.scenario.scenario_model import DrivingLimits, PanelLeaf, Permissions, Scenario


class RecordingRobot:
    """Records commands while ``connected``."""

    def __init__(self) -> None:
        self.sent: list[RobotCommand] = []
        self.connected = True

    def send(self, command: RobotCommand) -> bool:
        if self.connected:
            self.sent.append(command)
        return self.connected

    def of(self, kind: type) -> list[RobotCommand]:
        return [command for command in self.sent if isinstance(command, kind)]


def _scenario(**permissions: bool) -> Scenario:
    return Scenario(
        "Test",
        PanelLeaf("drive"),
        driving=DrivingLimits(max_forward_mps=1.0, max_turn_radps=2.0),
        permissions=Permissions(**permissions),
    )


def _feed_sensors(state: LiveState) -> None:
    now_ns = clock.now_ns()
    state.add(LaserScan(now_ns, None, "laser", 0.0, 0.1, 0.0, 9.0, np.ones(8, np.float32), Pose2D(0, 0, 0)))
    state.add(FrameRef(now_ns, None, "front", "r", 0, 1, 4, 3))


@pytest.fixture
def robot() -> RecordingRobot:
    return RecordingRobot()


@pytest.fixture
def state(qtbot: QtBot) -> Iterator[LiveState]:
    state = LiveState()
    state.link.set(LinkStatus(state="connected"))
    _feed_sensors(state)
    yield state
    state.deleteLater()


def _not_told(severity: str, what: str, meaning: str, advice: str, *, until: str = "") -> None:
    raise AssertionError(what)


@pytest.fixture
def driving(state: LiveState, robot: RecordingRobot) -> DriveService:
    driving = DriveService(state, robot, _scenario(), state, publish=state.add, problem=_not_told)
    driving.set_speed_fraction(0.5)
    robot.sent.clear()
    return driving


def test_each_change_is_sent_at_once_and_the_lease_is_renewed_until_release(
    qtbot: QtBot, driving: DriveService, robot: RecordingRobot
) -> None:
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    assert [command.target for command in robot.of(Drive)] == [Twist2D(0.5, 0, 0)]
    driving.drive(forward=1, left=0, turn=-1, source="keyboard")
    assert robot.of(Drive)[-1].target == Twist2D(0.5, 0, -1.0)
    qtbot.waitUntil(lambda: len(robot.of(RenewLease)) >= 3)
    driving.release()
    assert isinstance(robot.sent[-1], Release)
    renewals = len(robot.of(RenewLease))
    qtbot.wait(150)  # three renewal periods in which nothing may be sent
    assert len(robot.of(RenewLease)) == renewals


def test_the_holder_is_notified_and_only_they_this_wizard_or_a_stop_release(
    driving: DriveService, state: LiveState, robot: RecordingRobot
) -> None:
    driving.drive(forward=1, left=0, turn=0, source="keyboard", actor="wizard:b")
    assert state.drive.value.driver == "wizard:b"
    driving.drive(forward=0, left=0, turn=0, source="keyboard", actor="wizard:a")
    driving.let_go("", SCRIPT)
    assert robot.of(Release) == [] and state.drive.value.driver == "wizard:b"
    driving.drive(forward=-1, left=0, turn=0, source="keyboard", actor=WIZARD)
    assert state.drive.value.driver == WIZARD
    driving.let_go("", "wizard:b")  # its key is released only now
    assert robot.of(Release) == [] and state.drive.value.driver == WIZARD
    driving.halt("wizard:b")
    assert len(robot.of(Release)) == len(robot.of(StopMotion)) == 1 and state.drive.value.driver == ""


def test_nothing_is_sent_while_the_link_is_down_and_old_keys_do_not_drive_when_it_is_back(
    driving: DriveService, state: LiveState, robot: RecordingRobot
) -> None:
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    state.link.set(LinkStatus(state="lost"))
    assert isinstance(robot.sent[-1], Release)
    assert not state.drive.value.allowed and "connected" in state.drive.value.reason
    robot.sent.clear()
    driving.drive(forward=1, left=0, turn=1, source="keyboard")
    assert not robot.sent
    state.link.set(LinkStatus(state="connected"))
    assert not robot.of(Drive), "only a new key press drives"


def test_speed_is_capped_without_fresh_sensors_and_the_reason_is_reported(
    driving: DriveService, state: LiveState, robot: RecordingRobot
) -> None:
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    state.scan.clear()
    assert robot.of(Drive)[-1].target == Twist2D(0.5 * STALE_CAP_FRACTION, 0, 0)
    assert "LIDAR" in state.drive.value.cap_reason
    _feed_sensors(state)
    assert robot.of(Drive)[-1].target == Twist2D(0.5, 0, 0)
    assert state.drive.value.cap_reason == ""


def test_emergency_stop_latches_until_it_is_cleared(
    driving: DriveService, state: LiveState, robot: RecordingRobot
) -> None:
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    assert driving.set_emergency_stop(latched=True)
    assert [type(command) for command in robot.sent[-2:]] == [Release, SetEmergencyStop]
    robot.sent.clear()
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    assert not robot.of(Drive)
    driving.set_emergency_stop(latched=False)
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    assert robot.of(Drive)


def test_emergency_stop_latches_here_even_when_nobody_hears_it(
    driving: DriveService, state: LiveState, robot: RecordingRobot
) -> None:
    robot.connected = False
    assert not driving.set_emergency_stop(latched=True)
    assert state.drive.value.emergency_stop and not state.drive.value.allowed


def test_stop_is_sent_even_when_nothing_is_held(driving: DriveService, robot: RecordingRobot) -> None:
    driving.halt()
    assert [type(command) for command in robot.sent] == [StopMotion]


def test_a_lease_that_ended_at_the_robot_needs_a_new_key_press(
    qtbot: QtBot, driving: DriveService, robot: RecordingRobot, state: LiveState
) -> None:
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    driving.on_robot_event(DriveEnded(clock.now_ns(), "no renewal"))
    robot.sent.clear()
    qtbot.wait(120)
    assert not robot.sent
    assert state.drive.value.target_forward_mps == 0


def test_the_end_of_a_drive_before_does_not_end_the_present_one(
    driving: DriveService, robot: RecordingRobot, state: LiveState
) -> None:
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    driving.release()
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    first, second = (command.drive_id for command in robot.of(Drive) if isinstance(command, Drive))
    assert first != second
    driving.on_robot_event(DriveEnded(clock.now_ns(), "no renewal", drive_id=first))
    assert state.drive.value.target_forward_mps > 0, "it came late"
    driving.drive(forward=0.5, left=0, turn=0, source="keyboard")
    assert robot.of(Drive)[-1].drive_id == second, "a change is the same drive"  # type: ignore[attr-defined]
    driving.on_robot_event(DriveEnded(clock.now_ns(), "no renewal", drive_id=second))
    assert state.drive.value.target_forward_mps == 0


def test_the_lease_is_renewed_before_work_that_may_take_a_while(
    driving: DriveService, robot: RecordingRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_ns = clock.now_ns()

    def at(ms: int) -> None:
        monkeypatch.setattr(clock, "now_ns", lambda: now_ns + ms * 1_000_000)

    at(0)
    driving.renew_before_work()
    assert robot.of(RenewLease) == [], "nothing is held"
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    driving.renew_before_work()
    assert robot.of(RenewLease) == [], "it was taken just now"
    at(30)  # less than the timer's period
    driving.renew_before_work()
    assert len(robot.of(RenewLease)) == 1
    at(230)
    driving.renew_before_work()
    assert len(robot.of(RenewLease)) == 1, "after a stall it is gone, whoever comes first"
    assert len(robot.of(Release)) == 1


def test_after_a_stall_only_a_new_key_press_drives(
    driving: DriveService, state: LiveState, robot: RecordingRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    late_ns = clock.now_ns() + 200_000_000
    monkeypatch.setattr(clock, "now_ns", lambda: late_ns)
    robot.sent.clear()
    state.scan.clear()  # the first event after the stall requests another speed
    assert [type(command) for command in robot.sent] == [Release]
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    assert robot.of(Drive)


def test_a_scenario_without_driving_cannot_drive(
    driving: DriveService, state: LiveState, robot: RecordingRobot
) -> None:
    driving.use_scenario(_scenario(driving=False))
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    assert not robot.of(Drive)
    assert not state.drive.value.allowed


def test_the_speed_setting_applies_while_driving(
    driving: DriveService, state: LiveState, robot: RecordingRobot
) -> None:
    driving.drive(forward=-1, left=0, turn=0, source="keyboard")
    driving.set_speed_fraction(0.8)
    assert robot.of(Drive)[-1].target == Twist2D(-0.8, 0, 0)
    assert state.drive.value == replace(state.drive.value, target_forward_mps=-0.8)


PROFILE = RobotProfile(
    "r",
    "R",
    velocity=VelocityTopic(timeout_s=0.5, timeout_source="its manual"),
    scan=TopicSource("/scan"),
    limits=MotionLimits(forward_mps=0.6, backward_mps=0.2, left_mps=0.4, turn_radps=1.5),
)


def test_a_base_that_may_not_stop_automatically_is_driven_at_half_speed(
    driving: DriveService, state: LiveState
) -> None:
    state.robot.set(replace(PROFILE, velocity=VelocityTopic()))
    assert state.drive.value.max_forward_mps == 0.3
    assert state.drive.value.max_turn_radps == 0.75


def test_the_robots_own_limits_hold_where_the_scenario_allows_more(
    driving: DriveService, state: LiveState, robot: RecordingRobot
) -> None:
    assert state.drive.value.max_left_mps == 0.0, "as long as nothing is known of the robot"
    state.robot.set(PROFILE)
    drive = state.drive.value
    assert (drive.max_forward_mps, drive.max_left_mps, drive.max_turn_radps) == (0.6, 0.4, 1.5)
    driving.set_speed_fraction(1.0)
    driving.drive(forward=1, left=-1, turn=1, source="keyboard")
    assert robot.of(Drive)[-1].target == Twist2D(0.6, -0.4, 1.5)
    assert state.drive.value.target_left_mps == -0.4
    driving.drive(forward=-1, left=0, turn=0, source="keyboard")
    assert robot.of(Drive)[-1].target == Twist2D(-0.2, 0, 0)


def test_another_robot_is_not_driven_by_what_was_held_for_the_one_before(
    driving: DriveService, state: LiveState, robot: RecordingRobot
) -> None:
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    state.robot.set(PROFILE)
    assert [type(command) for command in robot.sent if not isinstance(command, LimitGoals)][-1] is Release


def test_limits_of_driving_limit_goals_too(driving: DriveService, state: LiveState, robot: RecordingRobot) -> None:
    def limits() -> list[float]:
        return [command.forward_mps for command in robot.of(LimitGoals) if isinstance(command, LimitGoals)]

    driving.set_speed_fraction(1.0)
    assert limits()[-1] == pytest.approx(1.0), "as the scenario says"
    driving.set_speed_fraction(0.3)
    assert limits()[-1] == pytest.approx(0.3)
    told = len(limits())
    driving.set_speed_fraction(0.3)
    state.frame.clear()
    assert len(limits()) == told, "once for each change"
    state.robot.set(PROFILE)
    assert limits()[-1] == pytest.approx(0.3 * min(1.0, PROFILE.limits.forward_mps))
    driving.on_robot_event(NavigationSpeedChanged(1, 0.3))
    assert state.drive.value.goal_limit_mps == 0.3
    state.link.set(LinkStatus(state="lost"))
    driving.on_robot_event(NavigationSpeedChanged(1, 0.3))
    assert state.drive.value.goal_limit_mps is None, "what comes late is of the link before"
    told = len(limits())
    state.link.set(LinkStatus(state="connected"))
    assert len(limits()) == told + 1, "a new connection is told anew"


def test_the_state_of_the_guard_is_shown_and_dropped_with_the_link(driving: DriveService, state: LiveState) -> None:
    driving.on_robot_event(GuardChanged(clock.now_ns(), "slowing", 0.4))
    assert (state.drive.value.guard, state.drive.value.guard_distance_m) == ("slowing", 0.4)
    driving.on_robot_event(GuardChanged(clock.now_ns(), "blind", None, "no fresh scan from the LIDAR"))
    assert state.drive.value.guard_detail == "no fresh scan from the LIDAR"
    state.link.set(LinkStatus(state="lost"))
    assert (state.drive.value.guard, state.drive.value.guard_distance_m) == ("absent", None)
    driving.on_robot_event(GuardChanged(clock.now_ns(), "clear", 1.0))
    assert state.drive.value.guard == "absent", "what comes late is of the link before"


def test_the_guard_is_switched_at_the_link_and_comes_back_with_another_scenario(
    driving: DriveService, robot: RecordingRobot
) -> None:
    driving.use_scenario(_scenario())
    assert not robot.of(SetGuard), "it is on already"
    driving.set_guard(on=False)
    driving.use_scenario(_scenario())
    assert [command.on for command in robot.of(SetGuard)] == [False, True]
    driving.use_scenario(_scenario())
    assert len(robot.of(SetGuard)) == 2


def test_after_a_lost_link_there_is_nothing_to_switch_back(
    driving: DriveService, state: LiveState, robot: RecordingRobot
) -> None:
    driving.set_guard(on=False)
    driving.on_robot_event(GuardChanged(clock.now_ns(), "overridden"))
    state.link.set(LinkStatus(state="trouble"))
    state.link.set(LinkStatus(state="connected"))
    assert state.drive.value.guard == "overridden", "a moment of trouble changes nothing"
    state.link.set(LinkStatus(state="lost"))
    state.link.set(LinkStatus(state="connected"))
    driving.use_scenario(_scenario())
    assert [command.on for command in robot.of(SetGuard)] == [False]


def test_the_reason_of_the_cap_says_for_how_long(
    qtbot: QtBot, driving: DriveService, state: LiveState, robot: RecordingRobot
) -> None:
    now_ns = clock.now_ns()
    state.add(FrameRef(now_ns - 1_200_000_000, None, "front", "r", 0, 1, 4, 3))
    assert state.drive.value.cap_reason == "no fresh video for 1.2 s"
    qtbot.waitUntil(lambda: state.drive.value.cap_reason not in ("", "no fresh video for 1.2 s"))
    state.add(FrameRef(clock.now_ns(), None, "front", "r", 0, 2, 4, 3))
    state.add(LaserScan(clock.now_ns(), None, "l", 0.0, 0.1, 0.0, 9.0, np.ones(8, np.float32), Pose2D(0, 0, 0)))
    assert (state.drive.value.cap_reason, state.drive.value.cap_fraction) == ("", 1.0)


def test_a_robot_without_a_lidar_or_a_camera_is_not_capped_for_lack_of_one(
    driving: DriveService, state: LiveState
) -> None:
    state.scan.clear()
    assert "LIDAR" in state.drive.value.cap_reason
    blind = replace(PROFILE, scan=None)
    state.robot.set(blind)
    assert state.drive.value.cap_reason == ""
    state.frame.clear()
    assert "video" in state.drive.value.cap_reason, "the pictures that came are missing"
    state.robot.set(replace(blind, name="another"))
    assert state.drive.value.cap_reason == ""
    state.robot.set(replace(blind, cameras=(CameraTopic("front", "/camera"),)))
    assert "video" in state.drive.value.cap_reason


def test_a_link_that_does_not_answer_refuses(driving: DriveService, state: LiveState, robot: RecordingRobot) -> None:
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    state.link.set(LinkStatus(state="trouble"))
    assert isinstance(robot.sent[-1], Release)
    robot.sent.clear()
    driving.drive(forward=1, left=0, turn=0, source="keyboard")
    assert not robot.sent
    assert not state.drive.value.allowed and "not respond" in state.drive.value.reason
