"""A thousand malformed rosbridge messages through the real links: no crash, no stall, and a notification."""

import asyncio
import json
import logging
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.clock import now_ns
from caris_desktop.domain.control_definitions import Reading, RobotControl, SendActionGoal
from caris_desktop.domain.events import LinkChanged, Problem
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.link_commands import GoTo, RequestMap, Say, UseControl
from caris_desktop.domain.sensing import BatteryState, LaserScan, OccupancyGrid, Odometry
from caris_desktop.robot.control_link import ControlLink
from caris_desktop.robot.media_link import MediaLink
from caris_desktop.robot.profile_model import (
    CameraTopic,
    EmergencyStopInterface,
    HeadInterface,
    MapServices,
    NavigationServer,
    RobotProfile,
    SpeechAction,
    SpeechInterface,
    TopicSource,
)
from caris_desktop.ros import action_messages, message_conversion
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.rosbridge import encode_cbor, encode_json
from tests.robot.loop_bench import Bridge, LoopBench, NoFrames, Outbox
from tests.support.examples import examples

ROBOT = RobotProfile(
    "test",
    "Test",
    simulation_time=True,
    scan=TopicSource("/scan"),
    odometry=TopicSource("/odom"),
    pose=TopicSource("/amcl_pose"),
    tf=TopicSource("/tf"),
    tf_static=TopicSource("/tf_static"),
    map=TopicSource("/map"),
    map_updates=TopicSource("/map_updates"),
    path=TopicSource("/plan"),
    battery=TopicSource("/battery"),
    cameras=(CameraTopic("front", "/camera", info="/info"),),
    navigation=NavigationServer("move_base", "/move_base"),
    initial_pose="/initialpose",
    maps=MapServices(slam_toolbox="/slam_toolbox", map_server="/map_server"),
    speech=SpeechInterface(action=SpeechAction("/tts", "a_msgs/TtsAction", {"text": "$value"})),
    emergency_stop=EmergencyStopInterface(topic="/stop", service="/stop/set"),
    head=HeadInterface("joint_trajectory", "/head", "pan", "tilt"),
    controls=(
        RobotControl("wave", "Wave", "button", SendActionGoal("/play", "a_msgs/PlayAction", {"name": "wave"})),
        RobotControl("light", "Light", "readout", None, Reading("/light", "a_msgs/Light", "levels[0].value")),
    ),
)
UNANSWERED = "/slam_toolbox/serialize_map"
AT = Pose2D(1.0, 2.0, 0.5)
ROS1 = Dialect.ROS1
STATUS = action_messages.GoalStatus("goal", action_messages.ACTIVE)
SCAN = LaserScan(0, None, "laser", 0.0, 0.1, 0.1, 10.0, np.ones(4, np.float32), AT)
GRID = OccupancyGrid(0, None, 0.05, AT, np.zeros((2, 3), np.int8))
STAMP_NS = 9_000_000_000
GOOD: dict[str, dict[str, Any]] = {
    "/scan": message_conversion.encode_laser_scan(ROS1, SCAN, stamp_ns=STAMP_NS),
    "/odom": message_conversion.encode_odometry(ROS1, Odometry(0, None, AT, Twist2D()), stamp_ns=STAMP_NS),
    "/amcl_pose": message_conversion.encode_pose_with_covariance_stamped(ROS1, AT, stamp_ns=STAMP_NS),
    "/tf": message_conversion.encode_tf_message(
        ROS1, [("map", "odom", AT), ("odom", "base_link", AT)], stamp_ns=STAMP_NS
    ),
    "/tf_static": message_conversion.encode_tf_message(ROS1, [("base_link", "laser", AT)], stamp_ns=STAMP_NS),
    "/map": message_conversion.encode_occupancy_grid(ROS1, GRID, stamp_ns=STAMP_NS),
    "/map_updates": message_conversion.encode_occupancy_grid_update(ROS1, GRID.cells, x=0, y=0, stamp_ns=STAMP_NS),
    "/plan": message_conversion.encode_path(ROS1, np.ones((3, 2), np.float32), stamp_ns=STAMP_NS),
    "/battery": message_conversion.encode_battery_state(ROS1, BatteryState(0, 0.5), stamp_ns=STAMP_NS),
    "/camera": message_conversion.encode_compressed_image(ROS1, b"\xff\xd8\xff", stamp_ns=STAMP_NS),
    "/info": message_conversion.encode_camera_info(ROS1, CameraModel(4, 3, 2.0, 2.0, 2.0, 1.5), stamp_ns=STAMP_NS),
    "/clock": message_conversion.encode_clock(ROS1, STAMP_NS),
    "/stop": {"data": False},
    "/joint_states": message_conversion.encode_joint_state(ROS1, {"pan": 0.1, "tilt": 0.2}, stamp_ns=STAMP_NS),
    "/light": {"levels": [{"value": 1.5}]},
    "/move_base/status": action_messages.encode_goal_status_array([STATUS], stamp_ns=STAMP_NS),
    "/move_base/feedback": action_messages.encode_action_feedback(
        STATUS,
        {"base_position": message_conversion.encode_pose_stamped(ROS1, AT, stamp_ns=STAMP_NS)},
        stamp_ns=STAMP_NS,
    ),
    "/move_base/result": action_messages.encode_action_result(STATUS, {}, stamp_ns=STAMP_NS),
    "/tts/result": action_messages.encode_action_result(STATUS, {"text": ""}, stamp_ns=STAMP_NS),
    "/play/feedback": action_messages.encode_action_feedback(STATUS, {"part": 1}, stamp_ns=STAMP_NS),
}


def nested(depth: int) -> Any:
    value: Any = 1
    for level in range(depth):
        value = [value] if level % 2 else {"x": value}
    return value


JUNK = st.one_of(
    st.sampled_from([None, True, -1, 2**31, 2**64, 10**400, -0.0, 1e308, 1e-320, "", "nan", [], {}, [[]], [None] * 5]),
    st.sampled_from([float("nan"), float("inf"), -float("inf"), "x" * 5000, "/", "..", "map", "ä\ud800"[:1]]),
    st.sampled_from([[0] * 20_000, [{}] * 2_000, ["a"] * 2_000, {str(n): n for n in range(2_000)}]),
    st.integers(1, 90).map(nested),
    st.text(max_size=8),
    st.floats(),
    st.integers(),
    st.binary(max_size=20),
)


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """All places in a message that may be replaced."""
    yield path
    if isinstance(value, dict):
        for key, item in value.items():
            yield from places(item, (*path, key))
    elif isinstance(value, list):
        for index, item in enumerate(value[:3]):
            yield from places(item, (*path, index))


def changed(value: Any, path: tuple[Any, ...], junk: Any, *, remove: bool) -> Any:
    if not path:
        return junk
    key, rest = path[0], path[1:]
    if isinstance(value, dict):
        if remove and not rest:
            return {name: item for name, item in value.items() if name != key}
        return {**value, key: changed(value[key], rest, junk, remove=remove)}
    return [changed(item, rest, junk, remove=remove) if index == key else item for index, item in enumerate(value)]


# The complete message as often as one of its parts.
PLACES = {topic: (*((),) * 3, *places(message)) for topic, message in GOOD.items()}


@st.composite
def published(draw: st.DrawFn) -> dict[str, Any]:
    """A valid message with one or two mistakes."""
    topic = draw(st.sampled_from(sorted(GOOD)))
    message = changed(GOOD[topic], draw(st.sampled_from(PLACES[topic])), draw(JUNK), remove=draw(st.booleans()))
    return {"op": "publish", "topic": topic, "msg": message}


# Replaced by the identifiers of a goal and a call in progress.
IDS = st.sampled_from(["goal", "call"]) | st.text(max_size=4)
OPERATIONS = st.one_of(
    published(),
    published(),
    published(),
    st.fixed_dictionaries({"op": st.just("publish"), "topic": JUNK, "msg": JUNK}),
    st.fixed_dictionaries(
        {"op": st.sampled_from(["service_response", "action_result", "action_feedback"]), "id": IDS},
        optional={"values": JUNK, "result": JUNK, "status": JUNK, "service": JUNK},
    ),
    st.fixed_dictionaries(
        {"op": st.just("fragment"), "id": IDS | JUNK, "num": st.integers(-1, 4) | JUNK, "data": st.text(max_size=9)},
        optional={"total": st.floats(0, 5) | JUNK},
    ),
    st.fixed_dictionaries({"op": st.just("status"), "level": JUNK, "msg": JUNK}),
    st.fixed_dictionaries({"op": st.sampled_from(["png", "call_service", "subscribe", "set_level", ""])}),
    st.fixed_dictionaries({"op": JUNK}),
)


def as_json(operation: dict[str, Any]) -> str | bytes:
    # As written by Python: with NaN and Infinity, which are not valid JSON.
    return json.dumps(json.loads(encode_json(operation)) if _has_arrays(operation) else operation, default=str)


def _has_arrays(value: Any) -> bool:
    if isinstance(value, dict):
        return any(_has_arrays(item) for item in value.values())
    return isinstance(value, (np.ndarray, bytes)) or (isinstance(value, list) and any(map(_has_arrays, value)))


def as_cbor(operation: dict[str, Any]) -> str | bytes:
    return encode_cbor(operation)


@st.composite
def truncated(draw: st.DrawFn) -> bytes:
    content = encode_cbor(draw(published()))
    cut = draw(st.integers(1, max(1, len(content) - 1)))
    return content[:cut] if draw(st.booleans()) else content[:cut] + b"\xff" + content[cut + 1 :]


PAYLOADS = st.one_of(
    st.tuples(st.sampled_from([as_json, as_cbor]), OPERATIONS),
    st.tuples(st.just(bytes), truncated() | st.binary(max_size=60)),
    st.tuples(st.just(str), st.text(max_size=40) | st.sampled_from(["[" * 90_000, '{"op":' * 300, "null", "1e999"])),
)


class Alarm(logging.Handler):
    """Collects log records with a traceback or of level error."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.records: list[logging.LogRecord] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info or (record.levelno >= logging.ERROR and "rosbridge says" not in record.msg):
            self.records.append(record)


class Target:
    """Link and bridge on a separate loop, shared by many examples."""

    def __init__(self, *, media: bool) -> None:
        self.media = media
        self.loop = asyncio.new_event_loop()
        self.alarm = Alarm()
        self.count = 0
        logging.getLogger("caris_desktop").addHandler(self.alarm)
        self.bench = self.loop.run_until_complete(self._begin())

    async def _begin(self) -> LoopBench:
        bridge = Bridge()
        bridge.answers[UNANSWERED] = lambda _: None
        await bridge.open()
        address = f"ws://127.0.0.1:{bridge.port}"
        outbox: Any = Outbox()
        frames: Any = NoFrames()
        link = MediaLink(ROBOT, address, outbox, frames) if self.media else ControlLink(ROBOT, address, outbox)
        bench = LoopBench(bridge, link, outbox)
        link.start()
        await bench.until(lambda: bench.of(LinkChanged) and bench.state == "connected", "a link")
        await bench.until(lambda: bridge.clients, "the server knows it")
        return bench

    def hit(self, payload: str | bytes) -> None:
        self.loop.run_until_complete(self._hit(payload))

    async def _hit(self, payload: str | bytes) -> None:
        """Send the payload, and check that the next message is still processed."""
        bench, kept = self.bench, [value for value in self.bench.outbox.values if isinstance(value, Problem)]
        bench.outbox.values[:] = [*bench.of(LinkChanged)[-1:], *kept]
        if not self.media and self.count % 50 == 0:
            # Keep a goal and a call in progress for the payload to disturb.
            at_ns = now_ns()
            bench.send(
                GoTo(at_ns, "goal", AT), Say(at_ns, "u", "Hello"), UseControl(at_ns, "r", "wave", True),
                RequestMap(at_ns, "m", "save", "lab"),
            )  # fmt: skip
            await bench.until(lambda: bench.bridge.published("/move_base/goal"), "a goal")
        self.count += 1
        await bench.bridge.send(self._aimed(payload))
        if self.media:
            origin = Pose2D(float(self.count), 0.0, 0.0)
            marker = OccupancyGrid(0, None, 0.05, origin, np.zeros((1, 1), np.int8))
            await bench.bridge.publish("/map", message_conversion.encode_occupancy_grid(ROS1, marker, stamp_ns=1))
            await bench.until(
                lambda: [g for g in bench.of(OccupancyGrid) if g.origin_in_map == origin], "a map after it"
            )
        else:
            charge = 0.1 + self.count % 1000 / 2000
            marker_message = {"percentage": charge}
            await bench.bridge.publish("/battery", marker_message)
            await bench.until(lambda: BatteryState(0, charge).charge_fraction in self._charges(), "a battery after it")
        assert bench.state == "connected"
        assert self.alarm.records == [], self.alarm.records[0].getMessage()

    def _aimed(self, payload: str | bytes) -> str | bytes:
        goals = self.bench.bridge.published("/move_base/goal")
        calls = self.bench.bridge.operations("call_service", UNANSWERED)
        if isinstance(payload, str) and goals and calls:
            payload = payload.replace('"goal"', json.dumps(goals[-1]["goal_id"]["id"]))
            payload = payload.replace('"call"', json.dumps(calls[-1]["id"]))
        return payload

    def _charges(self) -> list[float | None]:
        return [state.charge_fraction for state in self.bench.of(BatteryState)]

    def end(self) -> None:
        logging.getLogger("caris_desktop").removeHandler(self.alarm)

        async def finish() -> None:
            await self.bench.link.finish()
            await self.bench.bridge.close()

        self.loop.run_until_complete(finish())
        self.loop.close()


@pytest.fixture(scope="module")
def control() -> Iterator[Target]:
    target = Target(media=False)
    yield target
    target.end()


@pytest.fixture(scope="module")
def media() -> Iterator[Target]:
    target = Target(media=True)
    yield target
    target.end()


def encoded(payload: tuple[Callable[[Any], str | bytes], Any]) -> str | bytes:
    write, content = payload
    try:
        return write(content)
    except (ValueError, TypeError, OverflowError, RecursionError):
        return str(content)[:1000]


fuzzing = settings(
    derandomize=True,
    deadline=None,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example],
)


@pytest.mark.logs(r"robot\.(transport|bridge_socket): ")
@settings(fuzzing, max_examples=examples(700))
@given(PAYLOADS)
@example((as_json, {"op": "publish", "topic": "/scan", "msg": None}))
def test_the_control_link_survives(control: Target, payload: tuple[Any, Any]) -> None:
    control.hit(encoded(payload))


def test_the_wizard_is_notified_of_it_in_words(control: Target) -> None:
    told = [problem for problem in control.bench.of(Problem) if "cannot be used" in problem.what]
    assert told
    assert control.bench.link._ros.factory.refused > 100  # type: ignore[union-attr]
    for problem in control.bench.of(Problem):
        assert "Traceback" not in problem.what
        assert len(problem.what) < 2_000


@settings(fuzzing, max_examples=examples(300))
@given(PAYLOADS)
def test_the_media_link_survives(media: Target, payload: tuple[Any, Any]) -> None:
    media.hit(encoded(payload))
