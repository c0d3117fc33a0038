"""Control link against a rosbridge double: operations sent and not sent."""

import itertools
import json
import os
import signal
import socket
import struct
import time
from collections.abc import Iterator
from multiprocessing.reduction import ForkingPickler
from pathlib import Path

import pytest

from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.events import (
    CommandSent,
    DriveEnded,
    EmergencyStopChanged,
    GoalChanged,
    LinkChanged,
    LinkQuality,
    Problem,
    UtteranceChanged,
)
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.link_commands import (
    CloseLink,
    Drive,
    GoTo,
    Release,
    RenewLease,
    Say,
    SetEmergencyStop,
    StopMotion,
)
from caris_desktop.domain.sensing import BatteryState, LaserScan, Odometry
from caris_desktop.robot.control_link import ZERO_AGAIN_S
from caris_desktop.robot.unread import MOST_UNREAD
from tests.robot.link_bench import BridgeDouble, LinkProcess
from tests.support.polling import wait_for

pytestmark = pytest.mark.alone


@pytest.fixture
def own_bridge() -> Iterator[BridgeDouble]:
    """Bridge for tests that stop or disturb it."""
    double = BridgeDouble()
    yield double
    double.kill()


@pytest.fixture
def own_link(own_bridge: BridgeDouble) -> Iterator[LinkProcess]:
    process = LinkProcess(own_bridge.address)
    process.wait_for_state("connected")
    yield process
    process.close()


@pytest.fixture(scope="module")
def shared_bridge() -> Iterator[BridgeDouble]:
    double = BridgeDouble()
    yield double
    double.kill()


@pytest.fixture(scope="module")
def shared_link(shared_bridge: BridgeDouble) -> Iterator[LinkProcess]:
    process = LinkProcess(shared_bridge.address)
    process.wait_for_state("connected")
    yield process
    process.close()


@pytest.fixture
def bridge(shared_bridge: BridgeDouble, shared_link: LinkProcess) -> BridgeDouble:
    """The shared bridge, after the zero commands of the previous test and of the new connection."""
    wait_for(
        lambda: (
            time.monotonic() - shared_bridge.connected_s > ZERO_AGAIN_S[-1] + 0.1
            and (not shared_bridge.twists() or time.monotonic() - shared_bridge.twists()[-1][0] > 0.3)
            # On a busy machine the link may report them later.
            and len(shared_link.of(CommandSent)) >= len(shared_bridge.twists())
        ),
        "silence, and a report of all that was sent",
    )
    shared_bridge.lines.clear()
    shared_link.values.clear()
    return shared_bridge


@pytest.fixture
def link(bridge: BridgeDouble, shared_link: LinkProcess) -> LinkProcess:
    return shared_link


def moving(bridge: BridgeDouble) -> list[tuple[float, float, float]]:
    return [twist for twist in bridge.twists() if twist[1] or twist[2]]


def test_a_drive_moves_a_release_stops_and_every_twist_is_reported_exactly(
    bridge: BridgeDouble, link: LinkProcess
) -> None:
    link.drive(0.3, 0.7)
    link.hold(lambda: len(moving(bridge)) >= 8, "eight velocity commands")
    link.send(Release(now_ns()))
    wait_for(lambda: len(bridge.twists()) - len(moving(bridge)) >= 11, "zeros for half a second")
    wait_for(lambda: len(link.of(CommandSent)) == len(bridge.twists()), "a report of each")
    reported = [(sent.twist.forward_mps, sent.twist.turn_radps) for sent in link.of(CommandSent)]
    assert reported == [(forward, turn) for _, forward, turn in bridge.twists()]
    sequences = [sent.sequence for sent in link.of(CommandSent)]
    assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))
    zeros = bridge.twists()[len(moving(bridge)) :]
    assert 0.4 <= zeros[-1][0] - zeros[0][0] <= 0.7
    # No further command.
    with pytest.raises(AssertionError):
        wait_for(lambda: len(bridge.twists()) > len(reported), "more", timeout_s=0.3)


def test_without_renewal_the_robot_is_stopped(bridge: BridgeDouble, link: LinkProcess) -> None:
    link.drive()
    wait_for(lambda: bridge.twists() and not bridge.twists()[-1][1], "zero")
    twists = bridge.twists()
    first_zero_s = next(at_s for at_s, forward, _ in twists if not forward)
    assert first_zero_s - twists[0][0] <= 0.3
    # Reported on another path than the zero command, and possibly later.
    wait_for(lambda: link.of(DriveEnded), "why it ended")
    assert [ended.reason for ended in link.of(DriveEnded)] == ["The console stopped responding for a moment"]


def test_a_console_that_has_stopped_reading_cannot_keep_the_robot_moving(
    own_bridge: BridgeDouble, own_link: LinkProcess
) -> None:
    own_link.reading.clear()
    scan = {
        "angle_min": 0.0,
        "angle_increment": 0.0001,
        "range_min": 0.1,
        "range_max": 10.0,
        "ranges": [1.0] * 50_000,
    }
    # More than the pipe to the console holds.
    for _ in range(12):
        own_bridge.publish("/scan", scan)
    # A slow machine may read too slowly for the first key presses.
    wait_for(lambda: own_link.drive() or len(moving(own_bridge)) >= 5, "some velocity commands")
    wait_for(lambda: own_bridge.twists()[-1][1] == 0.0, "zero")
    last_s = moving(own_bridge)[-1][0]
    first_zero_s = next(at_s for at_s, forward, _ in own_bridge.twists() if not forward and at_s > last_s)
    assert first_zero_s - last_s < 0.3
    own_link.reading.set()
    wait_for(lambda: len(own_link.of(CommandSent)) >= len(own_bridge.twists()), "every command is reported in the end")


def test_the_death_of_the_console_stops_the_robot(own_bridge: BridgeDouble, own_link: LinkProcess) -> None:
    own_link.drive()
    own_link.hold(lambda: len(moving(own_bridge)) >= 5, "some velocity commands")
    died_s = time.monotonic()
    own_link.disappear()
    own_link.process.join(5)
    assert own_link.process.exitcode == 0
    zeros = [at_s for at_s, forward, _ in own_bridge.twists() if not forward and at_s > moving(own_bridge)[0][0]]
    assert zeros
    assert zeros[0] - died_s < 0.2
    assert moving(own_bridge)[-1][0] <= zeros[0]


def test_ctrl_c_in_the_terminal_does_not_end_the_link(own_bridge: BridgeDouble, own_link: LinkProcess) -> None:
    os.kill(own_link.process.pid or 0, signal.SIGINT)
    own_link.drive()
    wait_for(lambda: moving(own_bridge), "it still drives")
    own_link.send(CloseLink(now_ns()))
    own_link.process.join(5)
    assert own_link.process.exitcode == 0
    assert own_link.wait_for_state("closed")


def test_a_killed_robot_is_reported_and_found_again_with_everything_subscribed_and_no_old_command(
    own_bridge: BridgeDouble, own_link: LinkProcess
) -> None:
    wait_for(lambda: own_link.of(LaserScan), "scans")
    subscribed = {line["topic"] for line in own_bridge.operations("subscribe")}
    assert {"/scan", "/odom", "/tf", "/battery_state"} <= subscribed
    own_link.drive()
    own_link.hold(lambda: len(moving(own_bridge)) >= 5, "some velocity commands")
    changes = len(own_link.states())
    killed_s = time.monotonic()
    own_bridge.kill()
    own_link.wait_for_state("lost", after=changes)
    assert time.monotonic() - killed_s < 1.0
    ended = len(own_link.of(DriveEnded))
    assert ended == 1
    # The wizard keeps holding the key and presses it again while the robot is gone.
    own_link.hold(lambda: time.monotonic() - killed_s > 1.5, "a while without the robot")
    own_link.drive()
    wait_for(lambda: len(own_link.of(DriveEnded)) == ended + 1, "the refusal")
    own_bridge.lines.clear()
    scans = len(own_link.of(LaserScan))
    own_bridge.start()
    back_s = time.monotonic()
    own_link.wait_for_state("connected", after=changes)
    assert time.monotonic() - back_s < 3.0
    own_link.hold(lambda: len(own_link.of(LaserScan)) > scans + 5, "scans again")
    assert {line["topic"] for line in own_bridge.operations("subscribe")} == subscribed
    assert moving(own_bridge) == []
    # Zero comes before any subscription: the robot may still execute the last command.
    first = [line for line in own_bridge.lines if line.get("op")][:2]
    assert [(line["op"], line["topic"]) for line in first] == [("advertise", "/cmd_vel"), ("publish", "/cmd_vel")]
    own_link.drive()
    wait_for(lambda: moving(own_bridge), "a new key press moves it")


def test_a_robot_that_stops_answering_is_noticed_within_a_second(
    own_bridge: BridgeDouble, own_link: LinkProcess
) -> None:
    own_link.drive()
    own_link.hold(lambda: len(moving(own_bridge)) >= 5, "some velocity commands")
    changes = len(own_link.states())
    own_bridge.signal(signal.SIGSTOP)
    stopped_s = time.monotonic()
    own_link.hold(lambda: "lost" in own_link.states()[changes:], "the loss")
    assert time.monotonic() - stopped_s < 1.3
    assert own_link.states()[changes : changes + 2] == ["trouble", "lost"]
    assert own_link.of(DriveEnded)
    own_link.hold(lambda: time.monotonic() - stopped_s > 2.0, "two seconds")
    own_bridge.signal(signal.SIGCONT)
    continued_s = time.monotonic()
    own_link.wait_for_state("connected", after=changes)
    assert time.monotonic() - continued_s < 3.0
    scans = len(own_link.of(LaserScan))
    own_link.hold(lambda: len(own_link.of(LaserScan)) > scans + 5, "scans again")
    read = [twist for twist in own_bridge.twists() if twist[0] > continued_s - 0.01]
    old = [twist for twist in read if twist[1]]
    assert len(old) <= MOST_UNREAD, "what lay in its socket when trouble was seen, and nothing of later"
    assert read[len(old)][1] == 0.0 and not any(forward for _, forward, _ in read[len(old) :])
    assert read[len(old)][0] - continued_s < 0.2


def test_a_long_hiccup_without_loss_ends_the_drive_but_not_the_link(
    own_bridge: BridgeDouble, own_link: LinkProcess
) -> None:
    own_link.drive()
    own_link.hold(lambda: len(moving(own_bridge)) >= 3, "some velocity commands")
    changes = len(own_link.states())
    own_bridge.signal(signal.SIGSTOP)
    own_link.hold(lambda: "trouble" in own_link.states()[changes:], "trouble")
    own_bridge.signal(signal.SIGCONT)
    own_link.wait_for_state("connected", after=changes)
    assert "lost" not in own_link.states()
    wait_for(lambda: len(own_bridge.twists()) > 8 and own_bridge.twists()[-1][1] == 0.0, "zeros")
    count = len(moving(own_bridge))
    own_link.hold(lambda: len(own_link.of(LaserScan)) > 5, "the key still held moves nothing")
    assert len(moving(own_bridge)) == count


def test_a_short_stop_leaves_four_velocities_and_a_zero_and_the_drive_continues(
    own_bridge: BridgeDouble, own_link: LinkProcess
) -> None:
    own_link.drive()
    own_link.hold(lambda: moving(own_bridge) and moving(own_bridge)[-1][1] == 0.3, "full speed")
    own_bridge.signal(signal.SIGSTOP)
    stopped_s = time.monotonic()
    own_link.hold(lambda: time.monotonic() - stopped_s > 0.35, "less than trouble takes")
    own_bridge.signal(signal.SIGCONT)
    continued_s = time.monotonic()

    def after_it() -> list[float]:
        return [twist[1] for twist in own_bridge.twists() if twist[0] > continued_s - 0.005]

    # The first commands read may be older.
    own_link.hold(lambda: 0.0 in (read := after_it()) and read[-1] == 0.3, "full speed again, after a zero")
    read = after_it()
    zero = read.index(0.0)
    assert zero <= MOST_UNREAD
    assert set(read[:zero]) <= {0.3}
    # Acceleration from standstill, as after a new key press.
    after = [forward for forward in read[zero:] if forward]
    assert after[0] < 0.1
    # Monotonic apart from rounding errors.
    assert all(later > earlier - 1e-9 for earlier, later in itertools.pairwise(after))
    assert "trouble" not in own_link.states()
    assert own_link.of(DriveEnded) == []


def test_a_new_link_sends_zero_first(own_bridge: BridgeDouble, own_link: LinkProcess) -> None:
    own_link.drive()
    own_link.hold(lambda: len(moving(own_bridge)) >= 5, "some velocity commands")
    own_link.process.kill()
    own_link.process.join(5)
    own_bridge.lines.clear()
    link = LinkProcess(own_bridge.address)
    try:
        link.wait_for_state("connected")
        wait_for(lambda: len(own_bridge.twists()) >= 5, "zeros")
        began = next(at for at, line in enumerate(own_bridge.lines) if line.get("event") == "connected")
        first = [(line["op"], line.get("topic")) for line in own_bridge.lines[began:] if line.get("op")][:2]
        assert first == [("advertise", "/cmd_vel"), ("publish", "/cmd_vel")]
        assert moving(own_bridge) == []
        wait_for(lambda: time.monotonic() - own_bridge.connected_s > ZERO_AGAIN_S[-1] + 0.2, "the end of them")
        count = len(own_bridge.twists())
        assert count <= 14, "a short burst, and not something that fights navigation"
        own_bridge.tell(drop=True)
        link.wait_for_state("connected", after=len(link.states()))
        wait_for(lambda: [line for line in own_bridge.lines if line.get("event") == "connected"][1:], "it comes back")
        wait_for(lambda: len(own_bridge.operations("subscribe", "/scan")) == 2, "everything is asked for again")
        assert len(own_bridge.twists()) == count, "it is known to stand, so nothing has to be said"
    finally:
        link.close()


def test_malformed_and_huge_messages_are_refused_and_everything_continues(
    bridge: BridgeDouble, link: LinkProcess
) -> None:
    wait_for(lambda: link.of(LaserScan), "scans")
    for text in (
        "",
        "{",
        "[]",
        "null",
        "[" * 100_000,
        '{"op": 5}',
        '{"op": "dance"}',
        '{"op": "publish"}',
        '{"op": "publish", "topic": {}, "msg": 1}',
        '{"op": "publish", "topic": "/scan", "msg": {"ranges": "x"}}',
        '{"op": "publish", "topic": "/odom", "msg": null}',
        '{"op": "service_response", "id": ["x"], "result": false}',
        '{"op": "action_result", "id": "x", "values": "no"}',
        '{"op": "action_feedback", "id": 3}',
        '{"op": "fragment", "id": "a", "num": -1, "total": 2, "data": ""}',
        '{"op": "status", "level": "warning", "msg": ["odd"]}',
    ):
        bridge.tell(text=text)
    bridge.tell(hex="ff")
    bridge.tell(hex="00112233")
    bridge.tell(size=20_000_000)
    scans = len(link.of(LaserScan))
    wait_for(lambda: len(link.of(LaserScan)) > scans + 8, "scans go on")
    assert link.states() == []
    link.drive()
    wait_for(lambda: moving(bridge), "it drives")
    problems = [problem for problem in link.of(Problem) if "cannot be used" in problem.what]
    assert len(problems) == 1


def test_when_binary_messages_cannot_be_read_json_is_requested(own_bridge: BridgeDouble, own_link: LinkProcess) -> None:
    wait_for(lambda: own_bridge.operations("subscribe", "/scan"), "the subscription")
    assert {line["compression"] for line in own_bridge.operations("subscribe", "/scan")} == {"cbor"}
    for _ in range(3):
        own_bridge.tell(hex="c1ffff")
    wait_for(
        lambda: {"none"} == {line["compression"] for line in own_bridge.operations("subscribe", "/scan")[1:]},
        "a subscription in JSON",
    )


def test_a_message_in_fragments_is_put_together(bridge: BridgeDouble, link: LinkProcess) -> None:
    whole = '{"op":"publish","topic":"/battery_state","msg":{"percentage":0.25}}'
    for number, piece in enumerate((whole[:30], whole[30:])):
        bridge.tell(text=json.dumps({"op": "fragment", "id": "f", "num": number, "total": 1.6, "data": piece}))
    wait_for(lambda: [state.charge_fraction for state in link.of(BatteryState)] == [0.25], "the battery")


def test_an_old_order_moves_nothing(bridge: BridgeDouble, link: LinkProcess) -> None:
    link.send(Drive(now_ns() - 400_000_000, Twist2D(0.3), "keyboard"))
    wait_for(lambda: link.of(DriveEnded), "the refusal")
    assert moving(bridge) == []


def test_a_stop_says_zero_and_cancels_every_goal(bridge: BridgeDouble, link: LinkProcess) -> None:
    link.send(StopMotion(now_ns()))
    wait_for(bridge.twists, "zero")
    [cancel] = wait_for(lambda: bridge.operations("publish", "/move_base/cancel"), "cancel")
    assert cancel["msg"] == {"stamp": {"secs": 0, "nsecs": 0}, "id": ""}
    assert {sent.source for sent in wait_for(lambda: link.of(CommandSent), "the report")} == {"stop"}


def goal_status(goal_id: str, status: int) -> dict[str, object]:
    return {"goal_id": {"stamp": {"secs": 0, "nsecs": 0}, "id": goal_id}, "status": status, "text": ""}


def test_a_goal_is_followed_and_taking_the_wheel_cancels_it(bridge: BridgeDouble, link: LinkProcess) -> None:
    link.send(GoTo(now_ns(), "g1", Pose2D(3.0, 4.0, 0.0), "kitchen"))
    [goal] = wait_for(lambda: bridge.operations("publish", "/move_base/goal"), "the goal")
    goal_id = goal["msg"]["goal_id"]["id"]
    position = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    bridge.publish("/move_base/status", {"status_list": [goal_status(goal_id, 1)]})
    wait_for(lambda: [change.state for change in link.of(GoalChanged)] == ["requested", "active"], "active")
    feedback = {"base_position": {"header": {}, "pose": position}}

    def distance_is_told() -> bool:
        # Progress is reported twice a second, independently of the robot's rate.
        bridge.publish("/move_base/feedback", {"status": goal_status(goal_id, 1), "feedback": feedback})
        return bool(link.of(GoalChanged)[-1].distance_left_m == 5.0)

    wait_for(distance_is_told, "the distance left", every_s=0.1)
    link.drive()
    wait_for(lambda: bridge.operations("publish", "/move_base/cancel"), "the cancellation")
    bridge.publish("/move_base/result", {"status": goal_status(goal_id, 2), "result": {}})
    last = wait_for(lambda: [c for c in link.of(GoalChanged) if c.state == "cancelled"], "cancelled")[0]
    assert (last.goal_id, last.place, last.detail) == ("g1", "kitchen", "the wizard is driving")


def test_a_goal_that_waited_too_long_is_refused(bridge: BridgeDouble, link: LinkProcess) -> None:
    link.send(GoTo(now_ns() - 1_000_000_000, "old", Pose2D(3.0, 4.0, 0.0)))
    [refused] = wait_for(lambda: [c for c in link.of(GoalChanged) if c.goal_id == "old"], "the refusal")
    assert (refused.state, refused.detail) == ("failed", "The command arrived too late; send it again")
    assert not bridge.operations("publish", "/move_base/goal")


def test_a_goal_does_not_outlive_the_link(own_bridge: BridgeDouble, own_link: LinkProcess) -> None:
    own_link.send(GoTo(now_ns(), "g1", Pose2D(3.0, 4.0, 0.0)))
    wait_for(lambda: own_bridge.operations("publish", "/move_base/goal"), "the goal")
    own_bridge.kill()
    wait_for(lambda: own_link.of(GoalChanged)[-1].state == "failed", "failed", timeout_s=20.0)
    own_bridge.lines.clear()
    own_bridge.start()
    wait_for(
        lambda: "" in [line["msg"]["id"] for line in own_bridge.operations("publish", "/move_base/cancel")],
        "cancel of everything",
    )
    assert own_bridge.operations("publish", "/move_base/goal") == []


def test_the_emergency_stop_latches_and_clears_only_by_asking(bridge: BridgeDouble, link: LinkProcess) -> None:
    link.drive()
    link.hold(lambda: len(moving(bridge)) >= 3, "motion")
    link.send(SetEmergencyStop(now_ns(), True))
    [call] = wait_for(
        lambda: [c for c in bridge.operations("call_service") if c["service"] == "/emergency_stop/set"], ""
    )
    assert call["args"] == {"data": True}
    count = len(moving(bridge))
    link.drive()
    wait_for(lambda: [ended.reason for ended in link.of(DriveEnded)] == ["The emergency stop is active"], "refused")
    link.send(SetEmergencyStop(now_ns(), False))
    wait_for(lambda: [change.latched for change in link.of(EmergencyStopChanged)] == [False], "cleared")
    assert len(moving(bridge)) == count
    link.drive()
    wait_for(lambda: len(moving(bridge)) > count, "it drives again")


def test_an_emergency_stop_without_a_robot_is_sent_when_it_is_back(
    own_bridge: BridgeDouble, own_link: LinkProcess
) -> None:
    own_bridge.kill()
    own_link.wait_for_state("lost")
    own_link.send(SetEmergencyStop(now_ns(), True))
    wait_for(lambda: [p for p in own_link.of(Problem) if "did not reach the robot" in p.what], "a warning")
    own_bridge.lines.clear()
    own_bridge.start()
    wait_for(lambda: [c for c in own_bridge.operations("call_service") if c.get("args") == {"data": True}], "the stop")
    own_link.drive()
    wait_for(lambda: own_link.of(DriveEnded), "the refusal")
    assert moving(own_bridge) == []


def test_the_robots_own_emergency_stop_ends_the_drive(bridge: BridgeDouble, link: LinkProcess) -> None:
    link.drive()
    link.hold(lambda: len(moving(bridge)) >= 3, "motion")
    bridge.publish("/emergency_stop", {"data": True})
    [change] = link.hold(lambda: link.of(EmergencyStopChanged), "latched")
    assert (change.latched, change.by) == (True, "robot")
    wait_for(lambda: bridge.twists()[-1][1] == 0.0, "zero")
    bridge.publish("/emergency_stop", {"data": False})
    wait_for(lambda: [change.latched for change in link.of(EmergencyStopChanged)] == [True, False], "released")


def test_the_robot_speaks_and_says_when_it_is_done(bridge: BridgeDouble, link: LinkProcess) -> None:
    link.send(Say(now_ns(), "u1", "Hello"))
    [operation] = wait_for(lambda: bridge.operations("publish", "/tts"), "the sentence")
    assert operation["msg"] == {"data": "Hello"}
    bridge.publish("/tts/speaking", {"data": True})
    bridge.publish("/tts/speaking", {"data": False})
    wait_for(
        lambda: (
            [(u.utterance_id, u.state) for u in link.of(UtteranceChanged)] == [("u1", "started"), ("u1", "finished")]
        ),
        "started and finished",
    )


def test_the_round_trip_and_the_robots_clock_are_measured(bridge: BridgeDouble, link: LinkProcess) -> None:
    [quality, *_] = wait_for(lambda: link.of(LinkQuality), "a measurement")
    assert 0.0 < quality.round_trip_ms < 500.0
    assert quality.clock_offset_ms is not None
    assert quality.clock_uncertainty_ms is not None
    assert abs(quality.clock_offset_ms - 1_700_000_000_000.0) <= quality.clock_uncertainty_ms + 0.01


def test_sensor_streams_arrive_stamped(bridge: BridgeDouble, link: LinkProcess) -> None:
    scan = wait_for(lambda: link.of(LaserScan), "a scan")[0]
    assert scan.robot_stamp_ns == 12_000_000_005
    assert abs(now_ns() - scan.stamp_ns) < 10_000_000_000
    assert scan.ranges_m.tolist()[2] == float("inf")
    assert wait_for(lambda: link.of(Odometry), "odometry")[0].pose_in_odom == Pose2D(1.0, 2.0, 0.0)


def test_a_robot_that_wants_stamped_velocities_gets_them(bridge: BridgeDouble, tmp_path: Path) -> None:
    profile = tmp_path / "stamped.yaml"
    profile.write_text("version: 1\nros: 2\nvelocity: {topic: /cmd_vel, type: TwistStamped, frame_id: base}\n")
    process = LinkProcess(bridge.address, str(profile))
    try:
        process.wait_for_state("connected")
        process.drive(0.3)
        wait_for(
            lambda: [
                sent
                for sent in bridge.operations("publish", "/cmd_vel")
                if sent["msg"]["header"]["frame_id"] == "base" and sent["msg"]["twist"]["linear"]["x"] > 0.0
            ],
            "a velocity",
        )
        first = bridge.operations("publish", "/cmd_vel")[0]
        assert set(first["msg"]["header"]["stamp"]) == {"sec", "nanosec"}
        [advertised] = bridge.operations("advertise", "/cmd_vel")
        assert advertised["type"] == "geometry_msgs/msg/TwistStamped"
    finally:
        process.close()


def test_an_unreachable_robot_is_one_problem_and_not_one_per_attempt() -> None:
    with socket.create_server(("127.0.0.1", 0)) as nobody:
        port = nobody.getsockname()[1]
        nobody.settimeout(20.0)
        process = LinkProcess(f"ws://wizard:secret@127.0.0.1:{port}/?token=secret")
        try:
            for _ in range(4):
                nobody.accept()[0].close()
            process.drive()
            process.send(RenewLease(now_ns()))
            wait_for(lambda: process.of(DriveEnded), "the refusal")
            [problem] = process.of(Problem)
            assert f"The server at ws://127.0.0.1:{port}/ is not a rosbridge server" in problem.what
            assert "default port of rosbridge is 9090" in problem.advice
            assert {change.address for change in process.of(LinkChanged)} == {f"ws://127.0.0.1:{port}/"}
        finally:
            process.close()


def test_a_console_that_is_stopped_in_the_middle_of_a_long_message_cannot_keep_the_robot_moving(
    own_bridge: BridgeDouble, own_link: LinkProcess
) -> None:
    say = ForkingPickler.dumps(Say(now_ns(), "u", "A long story. " * 10_000))
    message = struct.pack("!i", len(say)) + bytes(say)
    wait_for(lambda: own_link.drive() or len(moving(own_bridge)) >= 5, "some velocity commands")
    own_link.send_bytes(message[:30_000])
    wait_for(lambda: own_bridge.twists()[-1][1] == 0.0, "zero")
    # Continue the interrupted message.
    own_link.send_bytes(message[30_000:])
    wait_for(lambda: own_link.of(UtteranceChanged), "the message")
    wait_for(lambda: own_link.drive() or own_bridge.twists()[-1][1] > 0.0, "driving again")
