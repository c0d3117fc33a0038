"""Head control: MoveHead commands to the link."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.link_commands import MoveHead, RobotCommand
from caris_desktop.domain.sensing import HeadState
from caris_desktop.live.services.drive_service import HeadService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import LinkStatus
from caris_desktop.robot.profile_model import HeadInterface, RobotProfile

HEAD = HeadInterface(
    "joint_trajectory",
    "/head",
    "pan",
    "tilt",
    pan_range_rad=(-1.0, 1.0),
    tilt_range_rad=(-0.5, 0.2),
    speed_radps=0.8,
)
PROFILE = RobotProfile("r", "R", head=HEAD)


class RecordingRobot:
    """RobotPort that records every command while it is connected."""

    def __init__(self) -> None:
        self.sent: list[MoveHead] = []
        self.connected = True

    def send(self, command: RobotCommand) -> bool:
        if self.connected and isinstance(command, MoveHead):
            self.sent.append(command)
        return self.connected


@pytest.fixture
def robot() -> RecordingRobot:
    return RecordingRobot()


@pytest.fixture
def state(qtbot: QtBot) -> Iterator[LiveState]:
    state = LiveState()
    state.link.set(LinkStatus(state="connected"))
    state.robot.set(PROFILE)
    yield state
    state.deleteLater()


@pytest.fixture
def head(state: LiveState, robot: RecordingRobot) -> HeadService:
    return HeadService(state, robot, state)


def test_looking_somewhere_stays_within_what_the_neck_can_do(
    head: HeadService, state: LiveState, robot: RecordingRobot
) -> None:
    head.turn_to(pan_rad=3.0, tilt_rad=-0.1)
    [sent] = robot.sent
    assert (sent.pan_rad, sent.tilt_rad) == (1.0, -0.1)
    assert (state.look.value.pan_rad, state.look.value.tilt_rad) == (1.0, -0.1)


def test_a_nod_goes_down_and_back_to_where_it_looked(qtbot: QtBot, head: HeadService, robot: RecordingRobot) -> None:
    head.turn_to(pan_rad=0.3, tilt_rad=-0.1)
    robot.sent.clear()
    head.nod()
    head.nod()
    qtbot.waitUntil(lambda: len(robot.sent) == 2)
    assert [(sent.pan_rad, sent.tilt_rad) for sent in robot.sent] == [(0.3, pytest.approx(0.15)), (0.3, -0.1)]


def test_head_commands_end_a_nod(qtbot: QtBot, head: HeadService, robot: RecordingRobot) -> None:
    head.nod()
    head.turn_to(pan_rad=0.5, tilt_rad=0.0)
    qtbot.wait(600)
    assert (robot.sent[-1].pan_rad, len(robot.sent)) == (0.5, 2)


def test_it_turns_at_its_speed_while_held_and_not_longer(
    qtbot: QtBot, head: HeadService, robot: RecordingRobot
) -> None:
    begun_ns = clock.now_ns()
    head.turn_head(pan=-1.0, tilt=0.5)
    assert len(robot.sent) == 1, "the first step goes out at once"
    qtbot.waitUntil(lambda: len(robot.sent) >= 6)
    head.release()
    took_s = (clock.now_ns() - begun_ns) / 1e9
    last = robot.sent[-1]
    pans = [sent.pan_rad for sent in robot.sent]
    assert pans == sorted(pans, reverse=True)
    assert -0.8 * (took_s + 0.06) <= last.pan_rad < -0.1
    assert last.tilt_rad == pytest.approx(min(-last.pan_rad / 2, 0.2))
    qtbot.wait(120)
    assert robot.sent[-1] is last


def test_it_turns_to_the_end_of_the_range_and_no_further(
    qtbot: QtBot, head: HeadService, robot: RecordingRobot
) -> None:
    head.turn_to(pan_rad=0.95, tilt_rad=0.0)
    head.turn_head(pan=1.0, tilt=0.0)
    qtbot.waitUntil(lambda: len(robot.sent) >= 5)
    head.release()
    assert max(sent.pan_rad for sent in robot.sent) == 1.0


def test_a_turn_begins_where_the_head_is(head: HeadService, state: LiveState, robot: RecordingRobot) -> None:
    state.add(HeadState(clock.now_ns(), None, 0.5, 0.1))
    head.turn_head(pan=1.0, tilt=0.0)
    head.release()
    assert 0.5 < robot.sent[0].pan_rad < 0.6
    assert robot.sent[0].tilt_rad == 0.1


@pytest.mark.parametrize("ending", ["emergency stop", "link lost", "another robot", "not taken"])
def test_events_that_end_a_turn(
    qtbot: QtBot, head: HeadService, state: LiveState, robot: RecordingRobot, ending: str
) -> None:
    head.turn_head(pan=0.2, tilt=0.0)
    if ending == "emergency stop":
        state.drive.set(replace(state.drive.value, emergency_stop=True))
    elif ending == "link lost":
        state.link.set(LinkStatus(state="lost"))
    elif ending == "another robot":
        state.robot.set(replace(PROFILE, name="other"))
    else:
        robot.connected = False
        qtbot.wait(60)
        robot.connected = True
    sent = len(robot.sent)
    qtbot.wait(120)  # more than two periods in which nothing may be sent
    assert len(robot.sent) == sent
    if ending in ("emergency stop", "link lost"):
        head.turn_head(pan=1.0, tilt=0.0)
        head.turn_to(pan_rad=0.1, tilt_rad=0.0)
        assert len(robot.sent) == sent, "nothing moves it meanwhile"


def test_a_robot_without_a_head_has_none_to_turn(head: HeadService, state: LiveState, robot: RecordingRobot) -> None:
    assert state.look.value.present
    state.robot.set(replace(PROFILE, head=None))
    head.turn_to(pan_rad=0.1, tilt_rad=0.0)
    head.turn_head(pan=1.0, tilt=0.0)
    assert not state.look.value.present
    assert robot.sent == []
