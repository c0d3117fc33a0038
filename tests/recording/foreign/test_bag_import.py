"""Import of foreign bags as sessions: complete values, reports of unknown data, no files of a failed import."""

import bz2
import io
import json
import math
import shutil
import sqlite3
import struct
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import zstandard
from mcap.writer import Writer as McapWriter
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import CommandSent, GoalChanged, InitialPoseSet, UtteranceChanged
from caris_desktop.domain.geometry import Pose2D, Pose3D, Twist2D
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.sensing import (
    BatteryState,
    CameraLens,
    FrameRef,
    LaserScan,
    OccupancyGrid,
    Odometry,
    People,
    PlannedPath,
    RobotPose,
)
from caris_desktop.recording.foreign import bag_files
from caris_desktop.recording.foreign.bag_files import BagError, is_probably_bag
from caris_desktop.recording.foreign.bag_import import ImportReport, import_bag
from caris_desktop.recording.foreign.bag_messages import Ros, typed, typestore
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.manifest import verify_manifest
from caris_desktop.recording.session.robot_clock_mapping import robot_clock
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.session_export import FORMATS, export_session
from caris_desktop.ros import message_conversion
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ros.message_fields import Message, encode_header
from tests.recording.driving import scan
from tests.support.recorded_session import RecordedSession, make_session, number_in, picture_of

LEGS = Path(__file__).parents[4] / "shared" / "data" / "legs_demo_stationary.bag"
T0_NS = 1_600_000_000_000_000_000
MS = 1_000_000
ROS2 = Dialect.ROS2
Written = tuple[str, str, int, Message]


class Near:
    """Compares equal to nearly the same pose."""

    def __init__(self, pose: Pose2D) -> None:
        self.pose = pose

    def __eq__(self, other: object) -> bool:
        assert isinstance(other, Pose2D)
        return to_jsonable(other) == pytest.approx(to_jsonable(self.pose))

    __hash__ = None  # type: ignore[assignment]


def values(session: Session, kind: type[Any]) -> list[Any]:
    return [value for _, value in session.values() if isinstance(value, kind)]


def topics(report: ImportReport) -> dict[str, tuple[str, str]]:
    return {topic.topic: (topic.became, topic.reason) for topic in report.topics}


# Bags of third-party writers


def robot_messages() -> Iterator[Written]:
    """A second of a robot: topic, type, milliseconds, plain message."""

    def tf(*transforms: tuple[str, str, Pose2D], at: int) -> Message:
        return message_conversion.encode_tf_message(ROS2, list(transforms), stamp_ns=T0_NS + at * MS)

    stamp: Callable[[int], int] = lambda at: T0_NS + at * MS - 5 * MS  # noqa: E731 - measured 5 ms before
    yield "/tf_static", "tf2_msgs/msg/TFMessage", 0, tf(("base_link", "laser_link", Pose2D(0.2, 0.0, 0.5)), at=0)
    grid = OccupancyGrid(0, None, 0.05, Pose2D(-1, -2, 0), np.arange(12, dtype=np.int8).reshape(3, 4))
    yield (
        "/map",
        "nav_msgs/msg/OccupancyGrid",
        1,
        message_conversion.encode_occupancy_grid(ROS2, grid, stamp_ns=stamp(1)),
    )
    for number in range(4):
        costmap = message_conversion.encode_occupancy_grid(ROS2, grid, stamp_ns=stamp(2))
        yield "/local_costmap/costmap", "nav_msgs/msg/OccupancyGrid", 2 + number, costmap
    for at in range(10, 1000, 100):
        x_m = at / 1000
        yield "/tf", "tf2_msgs/msg/TFMessage", at, tf(("map", "odom", Pose2D(1.0, 0.0, 0.0)), at=at)
        yield "/tf", "tf2_msgs/msg/TFMessage", at + 1, tf(("odom", "base_link", Pose2D(x_m, 2.0, 0.0)), at=at + 1)
        odometry = Odometry(0, None, Pose2D(x_m, 2.0, 0.0), Twist2D(1.0, 0.0, 0.0))
        yield (
            "/odom",
            "nav_msgs/msg/Odometry",
            at + 2,
            message_conversion.encode_odometry(ROS2, odometry, stamp_ns=stamp(at)),
        )
        for topic, beams in (("/scan", 30), ("/rear/scan_raw", 20)):
            message = message_conversion.encode_laser_scan(ROS2, scan(beams, stamp_ns=0), stamp_ns=stamp(at + 3))
            message["header"]["frame_id"] = "/laser_link"
            yield topic, "sensor_msgs/msg/LaserScan", at + 3, message
        yield "/cmd_vel", "geometry_msgs/msg/Twist", at + 4, message_conversion.encode_twist(Twist2D(x_m, 0.0, -0.2))
        yield "/camera/rgb/image_raw", "sensor_msgs/msg/Image", at + 5, raw_image(at // 100, stamp(at + 5))
        yield "/head/image/compressed", "sensor_msgs/msg/CompressedImage", at + 6, jpeg_image(at // 100, stamp(at + 6))
        lens = CameraModel(160, 90, 100.0, 101.0, 80.0, 45.0)
        info = message_conversion.encode_camera_info(ROS2, lens, stamp_ns=stamp(at + 7))
        yield "/camera/rgb/camera_info", "sensor_msgs/msg/CameraInfo", at + 7, info
    path = message_conversion.encode_path(ROS2, np.array([[0, 0], [1, 1]], np.float32), stamp_ns=1, frame_id="odom")
    yield "/plan", "nav_msgs/msg/Path", 991, path
    goal = message_conversion.encode_pose_stamped(ROS2, Pose2D(3.0, 4.0, 0.0), stamp_ns=stamp(992))
    yield "/goal_pose", "geometry_msgs/msg/PoseStamped", 992, goal
    start = message_conversion.encode_pose_with_covariance_stamped(ROS2, Pose2D(5.0, 6.0, 1.0), stamp_ns=stamp(993))
    yield "/initialpose", "geometry_msgs/msg/PoseWithCovarianceStamped", 993, start
    yield "/tts", "std_msgs/msg/String", 994, {"data": "Hello there"}
    yield "/asr/result", "std_msgs/msg/String", 995, {"data": "Hi robot"}
    yield "/chatter", "std_msgs/msg/String", 996, {"data": "42"}
    yield "/imu", "sensor_msgs/msg/Imu", 997, {}


def raw_image(number: int, stamp_ns: int) -> Message:
    image_bgr = picture_of(0, number, (160, 90))
    return {
        "header": encode_header(ROS2, stamp_ns=stamp_ns, frame_id="camera"),
        "height": 90, "width": 160, "encoding": "rgb8", "step": 160 * 3,
        "data": np.ascontiguousarray(image_bgr[:, :, ::-1]).ravel(),
    }  # fmt: skip


def jpeg_image(number: int, stamp_ns: int) -> Message:
    # The camera changes its resolution halfway.
    size = (160, 90) if number < 5 else (320, 180)
    _, jpeg = cv2.imencode(".jpg", picture_of(1, number, size))
    return message_conversion.encode_compressed_image(ROS2, jpeg.tobytes(), stamp_ns=stamp_ns)


def write_ros1(path: Path, written: Iterator[Written]) -> Path:
    with Writer1(path) as writer:
        _write(writer, 1, written)
    return path


def write_ros2(path: Path, written: Iterator[Written], *, storage: StoragePlugin, mode: CompressionMode) -> Path:
    writer = Writer2(path, version=8, storage_plugin=storage)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        _write(writer, 2, written)
    return path


def _write(writer: Any, ros: Ros, written: Iterator[Written]) -> None:
    store, connections = typestore(ros), {}
    for topic, kind, at_ms, message in written:
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, kind, typestore=store)
        serialize = store.serialize_ros1 if ros == 1 else store.serialize_cdr
        writer.write(connections[topic], T0_NS + at_ms * MS, serialize(typed(ros, kind, message), kind))


SQLITE, MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP
BAGS: dict[str, Callable[[Path], Path]] = {
    "ros1": lambda folder: write_ros1(folder / "robot.bag", robot_messages()),
    "sqlite": lambda folder: write_ros2(folder / "b", robot_messages(), storage=SQLITE, mode=CompressionMode.NONE),
    "folded": lambda folder: write_ros2(folder / "b", robot_messages(), storage=SQLITE, mode=CompressionMode.MESSAGE),
    "packed": lambda folder: write_ros2(folder / "b", robot_messages(), storage=MCAP, mode=CompressionMode.FILE),
    "mcap": lambda folder: write_ros2(folder / "b", robot_messages(), storage=MCAP, mode=CompressionMode.STORAGE),
}


@pytest.mark.parametrize("kind", BAGS)
@pytest.mark.long("sqlite", "ros1")
def test_topics_are_known_by_their_types(kind: str, tmp_path: Path) -> None:
    place = tmp_path / "bags"
    place.mkdir()
    bag = BAGS[kind](place)
    assert is_probably_bag(bag)
    before = {path: path.stat().st_mtime_ns for path in place.rglob("*")}
    fractions: list[float] = []
    report = import_bag(bag, tmp_path / "session", fractions.append)
    assert {path: path.stat().st_mtime_ns for path in place.rglob("*")} == before
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0

    session = open_session(tmp_path / "session")
    assert (session.closed_properly, session.reason, session.notices) == (True, "imported", ())
    assert verify_manifest(session.folder) == []
    assert session.duration_s == pytest.approx(0.997)
    assert session.clock.utc(session.started_ns) == report.started_utc == "2020-09-13T12:26:40.000000Z"

    scans = values(session, LaserScan)
    assert len(scans) == 10
    np.testing.assert_array_equal(scans[0].ranges_m, scan(30, stamp_ns=0).ranges_m)
    assert scans[0].robot_from_laser == Near(Pose2D(0.2, 0.0, 0.5))
    assert scans[0].stamp_ns - session.started_ns == 13 * MS
    assert scans[0].robot_stamp_ns == T0_NS + 8 * MS
    poses = values(session, RobotPose)
    assert [pose.pose_in_map.x_m for pose in poses] == pytest.approx([1.0 + at / 1000 for at in range(10, 1000, 100)])
    assert len(values(session, Odometry)) == 10
    assert [command.twist.forward_mps for command in values(session, CommandSent)][:2] == [0.01, 0.11]
    assert {command.source for command in values(session, CommandSent)} == {"none"}
    (grid,) = values(session, OccupancyGrid)
    assert grid.cells.tolist() == np.arange(12).reshape(3, 4).tolist()
    (path,) = values(session, PlannedPath)
    np.testing.assert_allclose(path.points_in_map, [[1, 0], [2, 1]])
    assert [goal.target_in_map for goal in values(session, GoalChanged)] == [Near(Pose2D(3, 4, 0))]
    assert [value.pose_in_map for value in values(session, InitialPoseSet)] == [Near(Pose2D(5, 6, 1))]
    texts = [(utterance.speaker, utterance.text) for utterance in values(session, UtteranceChanged)]
    assert texts == [("robot", "Hello there"), ("participant", "Hi robot")]
    (lens,) = values(session, CameraLens)
    assert (lens.camera, lens.model.fy_px) == ("rgb", 101.0)

    frames = values(session, FrameRef)
    assert {frame.camera for frame in frames} == {"rgb", "head"}
    with VideoReader(session) as videos:
        assert not videos.problems
        for camera in ("rgb", "head"):
            stamps = [frame.stamp_ns for frame in frames if frame.camera == camera]
            assert videos.frame_times_ns(camera) == stamps
            numbers = [videos.frame(camera, number) for number in range(10)]
            assert [number_in(picture.image_bgr) for picture in numbers if picture] == list(range(10))
    assert [video.width_px for video in session.header.videos if video.camera == "head"] == [
        160,
        320,
    ]

    told = topics(report)
    assert told["/local_costmap/costmap"] == ("", "it is a costmap, not the map")
    assert told["/rear/scan_raw"] == ("", "/scan is used for scan")
    assert told["/imu"] == ("", "sensor_msgs/Imu has no equivalent in this program")
    assert told["/chatter"] == ("", "its name does not indicate that these texts are speech")
    assert told["/scan"] == ("scan", "")
    assert {topic.topic for topic in report.not_understood} == {
        "/local_costmap/costmap", "/rear/scan_raw", "/imu", "/chatter"
    }  # fmt: skip
    assert session.header.to_json()["source"]["not_understood"] == [topic.topic for topic in report.not_understood]
    assert session.header.to_json()["source"]["name"] == bag.name
    assert "Hello there" in (session.folder / "speech.txt").read_text()


def scans_before_the_mount(*, mounted_ms: int | None) -> Iterator[Written]:
    """Scans from the beginning; the transform of the laser comes later, or never."""
    for at in range(0, 500, 100):
        message = message_conversion.encode_laser_scan(ROS2, scan(30, stamp_ns=0), stamp_ns=T0_NS + at * MS)
        message["header"]["frame_id"] = "laser_link"
        yield "/scan", "sensor_msgs/msg/LaserScan", at, message
        pose = message_conversion.encode_pose_stamped(ROS2, Pose2D(1.0, 2.0, 0.0), stamp_ns=T0_NS + at * MS)
        yield "/robot_pose", "geometry_msgs/msg/PoseStamped", at + 1, pose
        if at == mounted_ms:
            mount = message_conversion.encode_tf_message(
                ROS2, [("base_link", "laser_link", Pose2D(0.2, 0.0, 3.1))], stamp_ns=1
            )
            yield "/tf_static", "tf2_msgs/msg/TFMessage", at + 2, mount


def test_the_mounting_of_a_laser_holds_before_it_is_reported(tmp_path: Path) -> None:
    report = import_bag(write_ros1(tmp_path / "r.bag", scans_before_the_mount(mounted_ms=300)), tmp_path / "s")
    scans = values(open_session(report.folder), LaserScan)
    assert [found.robot_from_laser for found in scans] == [Near(Pose2D(0.2, 0.0, 3.1))] * 5
    assert not any("sits" in note for note in report.notes)


@pytest.mark.parametrize(("roll_deg", "upside_down"), [(0, False), (180, True), (178, True), (30, None)])
def test_a_laser_that_hangs_is_not_mirrored_and_a_tilted_one_is_not_drawn(
    tmp_path: Path, roll_deg: float, upside_down: bool | None
) -> None:
    half_rad = math.radians(roll_deg) / 2
    mount = ("base_link", "laser_link", Pose3D(0.2, 0, 0.3, math.sin(half_rad), 0, 0, math.cos(half_rad)))
    rows = [
        (*row[:3], message_conversion.encode_tf_message(ROS2, [mount], stamp_ns=1)) if row[0] == "/tf_static" else row
        for row in scans_before_the_mount(mounted_ms=0)
    ]
    report = import_bag(write_ros1(tmp_path / "r.bag", iter(rows)), tmp_path / "s")
    found = values(open_session(report.folder), LaserScan)
    told = scan(30, stamp_ns=0)
    ranges_m = told.ranges_m[::-1] if upside_down else told.ranges_m
    assert [one.ranges_m.tolist() for one in found] == [ranges_m.tolist()] * 5
    assert {one.robot_from_laser is None for one in found} == {upside_down is None}
    assert any("tilted by 30 degrees" in note for note in report.notes) == (upside_down is None)


def test_a_laser_that_is_nobody_knows_where_gets_no_place(tmp_path: Path) -> None:
    report = import_bag(write_ros1(tmp_path / "r.bag", scans_before_the_mount(mounted_ms=None)), tmp_path / "s")
    scans = values(open_session(report.folder), LaserScan)
    assert [found.robot_from_laser for found in scans] == [None] * 5
    assert any("laser 'laser_link' on the robot is unknown" in note for note in report.notes)
    export_session(report.folder, "rosbag2", tmp_path / "out")
    with Reader1(tmp_path / "out" / "session.bag") as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
    assert counts["/scan"] == 5
    assert "/tf_static" not in counts
    for fmt in ("csv", "frames"):
        export_session(report.folder, fmt, tmp_path / fmt)


@pytest.mark.skipif(not LEGS.exists(), reason="the recorded laser of ../shared/data is not there")
@pytest.mark.long
def test_a_recording_of_a_real_robot(tmp_path: Path) -> None:
    report = import_bag(LEGS, tmp_path / "legs")
    session = open_session(tmp_path / "legs")
    imported = list(session.arrivals("scan"))
    store = typestore(1)
    with Reader1(LEGS) as reader:
        recorded = [(at_ns, store.deserialize_ros1(raw, c.msgtype)) for c, at_ns, raw in reader.messages()]
    assert len(imported) == len(recorded) == report.values["scan"] == 1265
    for (arrived_ns, _, value), (at_ns, message) in zip(imported, recorded, strict=True):
        assert session.clock.anchor.utc_ns_at(arrived_ns) == at_ns
        np.testing.assert_array_equal(value.ranges_m, message.ranges)
        assert value.angle_min_rad == message.angle_min
        stamp = message.header.stamp
        assert value.robot_stamp_ns == stamp.sec * 1_000_000_000 + stamp.nanosec
    assert any("laser 'laser' on the robot is unknown" in note for note in report.notes)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> RecordedSession:
    folder = tmp_path_factory.mktemp("sessions") / "one"
    return make_session(folder, seconds=7.0, utterance_every_s=1.0, mark_every_s=1.0, keep=True)


@pytest.fixture(scope="module")
def exported(made: RecordedSession, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bags") / "out"
    export_session(made.folder, "rosbag2", out)
    return out


@pytest.mark.parametrize("name", ["ros2", "session.bag"])
@pytest.mark.long("ros2")
def test_an_export_of_this_program_comes_back(made: RecordedSession, exported: Path, name: str, tmp_path: Path) -> None:
    import_bag(exported / name, tmp_path / "again")
    session, original = open_session(tmp_path / "again"), open_session(made.folder)
    assert session.trial == original.trial
    assert (session.started_ns, session.ended_ns) == (original.started_ns, original.ended_ns)
    for kind in (CommandSent, UtteranceChanged, People):
        recorded = [(arrived_ns, value) for arrived_ns, value in made.values if isinstance(value, kind)]
        again = [(arrived_ns, value) for arrived_ns, _, value in session.arrivals() if isinstance(value, kind)]
        assert again == recorded
        assert recorded
    scans = [value for _, value in made.values if isinstance(value, LaserScan)]
    for one, other in zip(values(session, LaserScan), scans, strict=True):
        np.testing.assert_array_equal(one.ranges_m, other.ranges_m)
        assert one.robot_from_laser == Near(other.robot_from_laser)
    poses = [value for _, value in made.values if isinstance(value, RobotPose)]
    assert [pose.pose_in_map for pose in values(session, RobotPose)] == [Near(pose.pose_in_map) for pose in poses]
    # The robot's stamps are UTC, as the link quality states: both map to the same time.
    clocks = robot_clock(session), robot_clock(original)
    for one, other in zip(session.arrivals("scan"), original.arrivals("scan"), strict=True):
        moments = [
            c.measured(v.robot_stamp_ns, arrival_ns=a) for c, (a, _, v) in zip(clocks, (one, other), strict=True)
        ]
        assert all(moments)
        assert moments[0].stamp_ns == pytest.approx(moments[1].stamp_ns, abs=20_000)  # type: ignore[union-attr]


def mcap(
    path: Path, *, profile: str = "ros2", library: str = "test", **channels: tuple[str, str, str, bytes, bytes]
) -> Path:
    """Schema name and encoding, message encoding, schema text and message of each topic."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile=profile, library=library)
        for topic, (name, form, encoding, text, data) in channels.items():
            schema = writer.register_schema(name=name, encoding=form, data=text)
            channel = writer.register_channel(topic=f"/{topic}", message_encoding=encoding, schema_id=schema)
            writer.add_message(channel, log_time=T0_NS, publish_time=T0_NS, data=data)
        writer.finish()
    return path


def test_an_imported_bag_can_be_exported_again(tmp_path: Path) -> None:
    import_bag(BAGS["mcap"](tmp_path), tmp_path / "session")
    export_session(tmp_path / "session", "rosbag2", tmp_path / "out")
    read: dict[str, list[Any]] = {}
    with AnyReader([tmp_path / "out" / "ros2"]) as reader:
        for connection, _, raw in reader.messages():
            read.setdefault(connection.topic, []).append(reader.deserialize(raw, connection.msgtype))
    (lens,) = read["/camera/rgb/camera_info"]
    assert lens.k.tolist() == [100.0, 0.0, 80.0, 0.0, 101.0, 45.0, 0.0, 0.0, 1.0]
    assert lens.p.reshape(3, 4)[:, :3].ravel().tolist() == lens.k.tolist()
    (path,) = read["/plan"]
    assert [(pose.pose.position.x, pose.pose.position.y) for pose in path.poses] == [(1.0, 0.0), (2.0, 1.0)]
    assert [(goal.pose.position.x, goal.pose.position.y) for goal in read["/goal_pose"]] == [(3.0, 4.0)]
    assert [message.data for message in read["/speech/participant"]] == ["Hi robot"]
    assert {"/camera/rgb/image/foxglove", "/camera/head/image/foxglove", "/cmd_vel", "/map"} <= set(read)


def test_messages_of_ros1_and_json_in_an_mcap(tmp_path: Path) -> None:
    message = message_conversion.encode_laser_scan(ROS2, scan(8, stamp_ns=0), stamp_ns=T0_NS)
    store, kind = typestore(1), "sensor_msgs/msg/LaserScan"
    text = store.generate_msgdef(kind)[0].encode()
    ros1 = store.serialize_ros1(typed(1, kind, message), kind)
    pose = json.dumps(message_conversion.encode_pose_stamped(Dialect.ROS1, Pose2D(1, 2, 0.5), stamp_ns=T0_NS)).encode()
    bag = mcap(
        tmp_path / "mixed.mcap",
        scan=("sensor_msgs/LaserScan", "ros1msg", "ros1", text, bytes(ros1)),
        pose=("geometry_msgs/PoseStamped", "jsonschema", "json", b"{}", pose),
        other=("sensor_msgs/BatteryState", "protobuf", "protobuf", b"", b"\x08\x01"),
        changed=("sensor_msgs/BatteryState", "ros2msg", "cdr", b"float32 percent", b"\x00\x01\x00\x00\x00\x00\x00\x00"),
    )
    report = import_bag(bag, tmp_path / "session")
    assert report.values["scan"] == report.values["pose"] == 1
    assert "battery" not in report.values
    reasons = {topic.topic: topic.reason for topic in report.topics}
    assert reasons["/other"] == "its messages are encoded as 'protobuf'"
    assert reasons["/changed"] == "its definition of sensor_msgs/msg/BatteryState differs from the standard"


def test_the_battery_of_an_older_ros(tmp_path: Path) -> None:
    """ROS 1 until Melodic has no temperatures; bzip2 is a compression of rosbag."""
    text = (
        "Header header\nfloat32 voltage\nfloat32 current\nfloat32 charge\nfloat32 capacity\nfloat32 design_capacity\n"
        "float32 percentage\nuint8 power_supply_status\nuint8 power_supply_health\nuint8 power_supply_technology\n"
        "bool present\nfloat32[] cell_voltage\nstring location\nstring serial_number\n"
    )
    newer, kind = typestore(1), "sensor_msgs/msg/BatteryState"
    header = f"{'=' * 80}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    data = struct.pack("<III", 1, 2, 3) + struct.pack("<I", 0) + struct.pack("<6f", 24, 1, 1, 1, 1, 0.5)
    data += bytes([2, 1, 3, 1]) + struct.pack("<III", 0, 0, 0)
    writer = Writer1(tmp_path / "old.bag")
    writer.set_compression(Writer1.CompressionFormat.BZ2)
    with writer:
        old = writer.add_connection(
            "/battery", kind, msgdef=text + header, md5sum="476f837fa6771f6e16e3bf4ef96f8770", typestore=newer
        )
        writer.write(old, T0_NS, data)
    import_bag(tmp_path / "old.bag", tmp_path / "session")
    (battery,) = values(open_session(tmp_path / "session"), BatteryState)
    assert battery.charge_fraction == 0.5


# Bad input


def nothing_remains(tmp_path: Path, bag: Path, *, match: str) -> None:
    place = tmp_path / "study" / "sessions"
    place.mkdir(parents=True)
    with pytest.raises(BagError, match=match):
        import_bag(bag, place / "session")
    assert list(place.iterdir()) == []


def only_unknown(folder: Path) -> Path:
    written = [("/imu", "sensor_msgs/msg/Imu", 1, {}), ("/text", "std_msgs/msg/String", 2, {"data": "x"})]
    return write_ros1(folder / "unknown.bag", iter(written))


def zstd_bomb(folder: Path) -> Path:
    """A chunk of a few kilobytes that claims 100 bytes, and expands to one gigabyte."""
    out = io.BytesIO()
    with zstandard.ZstdCompressor(level=1).stream_writer(out, closefd=False) as writer:
        for _ in range(64):
            writer.write(bytes(1 << 24))
    return _mcap_with_chunk(folder / "bomb.mcap", out.getvalue(), claimed=100)


def huge_message(folder: Path) -> Path:
    return _mcap_with_chunk(folder / "huge.mcap", b"x" * 100, claimed=1 << 40)


def ros1_bomb(folder: Path) -> Path:
    """Sixteen megabytes compressed to a few bytes, declared as 50."""

    def record(data: bytes, **fields: bytes) -> bytes:
        head = b"".join(struct.pack("<I", len(k) + 1 + len(v)) + k.encode() + b"=" + v for k, v in fields.items())
        return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data

    chunk = record(bz2.compress(bytes(1 << 24)), op=b"\x05", compression=b"bz2", size=struct.pack("<I", 50))
    (folder / "bomb.bag").write_bytes(b"#ROSBAG V2.0\n" + chunk)
    return folder / "bomb.bag"


def _mcap_with_chunk(path: Path, data: bytes, *, claimed: int) -> Path:
    def record(opcode: int, body: bytes) -> bytes:
        return struct.pack("<BQ", opcode, len(body)) + body

    def text(value: bytes) -> bytes:
        return struct.pack("<I", len(value)) + value

    chunk = struct.pack("<QQQI", T0_NS, T0_NS, claimed, 0) + text(b"zstd") + struct.pack("<Q", len(data)) + data
    path.write_bytes(b"\x89MCAP0\r\n" + record(1, text(b"ros2") + text(b"test")) + record(6, chunk))
    return path


def with_content(name: str, content: bytes) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return write


def empty_folder(folder: Path) -> Path:
    (folder / "empty").mkdir()
    return folder / "empty"


def evil_metadata(folder: Path) -> Path:
    (folder / "evil").mkdir()
    (folder / "evil" / "metadata.yaml").write_text("!!python/object/apply:os.system ['true']\n")
    return folder / "evil"


BAD: dict[str, tuple[Callable[[Path], Path], str]] = {
    "missing": (lambda folder: folder / "nowhere.bag", "does not exist"),
    "empty file": (with_content("a.bag", b""), "is empty"),
    "text": (with_content("a.bag", b"just some text, 126 s of it\n"), "is not a ROS 1 bag"),
    "old bag": (with_content("a.bag", b"#ROSBAG V1.2\n"), "in an old format"),
    "no messages": (lambda folder: write_ros1(folder / "none.bag", iter(())), "contains no messages"),
    "cut at once": (with_content("a.mcap", b"\x89MCAP0\r\n\x01\x10\x00"), "contains no messages.*truncated"),
    "rubbish": (with_content("a.bag", b"#ROSBAG V2.0\n" + bytes(range(256)) * 20), "contains no messages.*damaged"),
    "unknown types": (only_unknown, "contains no supported data.*sensor_msgs/msg/Imu"),
    "bomb": (zstd_bomb, "contains no messages.*far too large"),
    "bomb in ROS 1": (ros1_bomb, "contains no messages.*larger than its declared size"),
    "huge": (huge_message, "contains no messages.*far too large"),
    "empty folder": (empty_folder, "not a rosbag2"),
    "evil metadata": (evil_metadata, "does not contain bag metadata"),
    "database": (with_content("a.db3", b"SQLite format 3\x00" + bytes(200)), "contains no messages.*damaged"),
    "own log": (
        lambda folder: mcap(
            folder / "events.mcap", profile="", library="caris-desktop",
            scan=("caris.LaserScan", "jsonschema", "json", b"{}", b"{}"),
        ),
        "belongs to a CARIS Desktop session",
    ),
    "another program's": (
        lambda folder: mcap(folder / "a.mcap", x=("foxglove.Log", "protobuf", "protobuf", b"", b"\x00")),
        "contains no supported data",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD)
def test_a_useless_file_is_reported_and_leaves_nothing(kind: str, tmp_path: Path) -> None:
    write, match = BAD[kind]
    nothing_remains(tmp_path, write(tmp_path), match=match)


def long_bag(folder: Path, kind: str) -> bytes:
    """Six seconds of the robot in several chunks."""
    written = (replaced(written, 1000 * turn) for turn in range(6) for written in robot_messages())
    if kind == "ros1":
        return write_ros1(folder / "long.bag", written).read_bytes()
    bag = write_ros2(folder / "long", written, storage=MCAP, mode=CompressionMode.STORAGE)
    return next(bag.glob("*.mcap")).read_bytes()


@pytest.mark.parametrize("kind", ["ros1", "mcap"])
def test_a_cut_or_damaged_bag_gives_what_is_complete(kind: str, tmp_path: Path) -> None:
    content = long_bag(tmp_path, kind)
    broken = tmp_path / f"broken.{'bag' if kind == 'ros1' else 'mcap'}"
    broken.write_bytes(content[: len(content) * 2 // 3])
    report = import_bag(broken, tmp_path / "cut")
    assert any("truncated" in note for note in report.notes)
    before_the_cut = len(values(open_session(tmp_path / "cut"), LaserScan))
    assert 5 < before_the_cut < 60

    middle = len(content) // 2
    broken.write_bytes(content[:middle] + bytes(200) + content[middle + 200 :])
    report = import_bag(broken, tmp_path / "damaged")
    session = open_session(tmp_path / "damaged")
    scans = values(session, LaserScan)
    assert any("damaged" in note for note in report.notes)
    assert 5 < len(scans) < 60
    assert session.clock.session_s(scans[-1].stamp_ns) > 5.8


def replaced(written: Written, later_ms: int) -> Written:
    topic, kind, at_ms, message = written
    return topic, kind, at_ms + later_ms, message


def test_nothing_is_overwritten_and_an_import_can_be_stopped(tmp_path: Path) -> None:
    bag = BAGS["ros1"](tmp_path)
    (tmp_path / "there").mkdir()
    with pytest.raises(BagError, match="already exists"):
        import_bag(bag, tmp_path / "there")
    folder = shutil.copytree(tmp_path / "there", tmp_path / "bag folder")
    with pytest.raises(BagError, match="inside the bag"):
        import_bag(folder, folder / "session")

    class StoppedError(Exception):
        pass

    def stop(fraction: float) -> None:
        if fraction > 0.3:
            raise StoppedError

    before = sorted(tmp_path.iterdir())
    with pytest.raises(StoppedError):
        import_bag(bag, tmp_path / "session", stop)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    "header",
    [
        "no JSON",
        "[]",
        json.dumps({"clock": {"monotonic_ns": 10**40, "utc_ns": 10**40}, "started_ns": 10**40}),
        json.dumps({"clock": {"monotonic_ns": 0, "utc_ns": 0}, "started_ns": 5}),
    ],
)
def test_a_bag_that_only_pretends_to_be_ours(header: str, tmp_path: Path) -> None:
    laser = message_conversion.encode_laser_scan(ROS2, scan(8, stamp_ns=0), stamp_ns=T0_NS)
    text = "std_msgs/msg/String"
    written = [
        ("/caris/session", text, 1, {"data": header}),
        ("/caris/event/marked", text, 2, {"data": '{"stamp_ns": 1, "label": "x"}'}),
        ("/scan", "sensor_msgs/msg/LaserScan", 3, laser),
    ]
    report = import_bag(write_ros1(tmp_path / "a.bag", iter(written)), tmp_path / "session")
    assert report.values["scan"] == 1
    assert "event/marked" not in report.values
    assert report.started_utc == "2020-09-13T12:26:40.001000Z"


def test_malformed_messages_are_counted_and_the_rest_is_used(tmp_path: Path) -> None:
    good = message_conversion.encode_laser_scan(ROS2, scan(8, stamp_ns=0), stamp_ns=T0_NS)
    bad = {**good, "angle_increment": float("nan")}
    written = [("/scan", "sensor_msgs/msg/LaserScan", at, good if at % 2 else bad) for at in range(1, 7)]
    picture: NDArray[np.uint8] = np.zeros((2, 2, 3), np.uint8)
    tiny = {**raw_image(0, T0_NS), "width": 60000, "height": 60000, "data": picture.ravel()}
    written.append(("/image", "sensor_msgs/msg/Image", 8, tiny))
    report = import_bag(write_ros1(tmp_path / "a.bag", iter(written)), tmp_path / "session")
    (image, scans) = report.topics
    assert (scans.messages, scans.used, scans.became) == (6, 3, "scan")
    assert "angle_increment" in scans.reason
    assert (image.used, image.became) == (0, "")
    assert "pixels" in image.reason


def test_odometry_without_a_rotation_keeps_its_speed_and_is_counted(tmp_path: Path) -> None:
    written = []
    for number in range(1, 7):
        odometry = Odometry(0, None, Pose2D(7.0, 7.0, 0.0), Twist2D(0.5, 0.0, 0.1))
        message = message_conversion.encode_odometry(ROS2, odometry, stamp_ns=T0_NS)
        message["pose"]["pose"]["orientation"] = dict.fromkeys("xyzw", 0.0)
        written.append(("/odom", "nav_msgs/msg/Odometry", 100 * number, message))
    report = import_bag(write_ros1(tmp_path / "a.bag", iter(written)), tmp_path / "session")
    (topic,) = report.topics
    assert (topic.used, topic.became) == (6, "odometry")
    assert any("6 odometry messages have no rotation" in note for note in report.notes)
    found = values(open_session(report.folder), Odometry)
    assert {one.twist for one in found} == {Twist2D(0.5, 0.0, 0.1)}
    assert [round(one.pose_in_odom.heading_rad, 3) for one in found] == [0.0, 0.01, 0.02, 0.03, 0.04, 0.05]
    assert found[-1].pose_in_odom.x_m == pytest.approx(0.25, abs=0.01)


_TRUE_NS = 1_790_000_000 * 10**9
_Spoken = tuple[int, str]


def _driven(from_ns: int, count: int) -> list[_Spoken]:
    return [(from_ns + number * 100_000_000, f"said {number}") for number in range(count)]


def _speech(path: Path, spoken: list[_Spoken]) -> Path:
    """A bag of robot speech, in this order in the file."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros2", library="test")
        schema = writer.register_schema(name="std_msgs/msg/String", encoding="ros2msg", data=b"string data")
        channel = writer.register_channel(topic="/tts", message_encoding="cdr", schema_id=schema)
        for at_ns, text in spoken:
            content = text.encode() + b"\0"
            data = b"\0\1\0\0" + struct.pack("<I", len(content)) + content
            writer.add_message(channel, log_time=at_ns, publish_time=at_ns, data=data)
        writer.finish()
    return path


@pytest.mark.parametrize("forward", [True, False])
def test_a_clock_that_was_set_makes_no_session_of_years(tmp_path: Path, forward: bool) -> None:
    early_ns = 946_684_820 * 10**9
    first, then = (early_ns, _TRUE_NS) if forward else (_TRUE_NS, early_ns)
    counts = (30, 50) if forward else (50, 30)
    bag = _speech(tmp_path / "a.mcap", [*_driven(first, counts[0]), *_driven(then, counts[1])])
    report = import_bag(bag, tmp_path / "s")
    assert report.duration_s == pytest.approx(4.9 + 2.9 + 1.0, abs=0.01)
    assert sum("the gap of" in note and "was removed" in note for note in report.notes) == 1
    session = open_session(tmp_path / "s")
    texts = [value.text for value in values(session, UtteranceChanged)]
    assert texts == [f"said {number}" for count in counts for number in range(count)], "as in the file"
    assert session.clock.utc(session.ended_ns)[:4] == "2026"
    for fmt in FORMATS:
        export_session(tmp_path / "s", fmt.name, tmp_path / fmt.name)
        written = [path.stat().st_size for path in (tmp_path / fmt.name).rglob("*") if path.is_file()]
        assert 0 < sum(written) < 1_000_000, fmt.name


def test_stray_stamps_are_counted_and_left_out(tmp_path: Path) -> None:
    spoken = [(20 * 10**9, "stray"), *_driven(_TRUE_NS, 50), (_TRUE_NS + 10**17, "stray")]
    report = import_bag(_speech(tmp_path / "a.mcap", spoken), tmp_path / "s")
    assert report.duration_s == pytest.approx(4.9, abs=0.01)
    strays = [note for note in report.notes if "hours from all others" in note]
    assert [note.split()[:2] for note in strays] == [["1", "message"]] * 2
    assert "stray" not in [value.text for value in values(open_session(tmp_path / "s"), UtteranceChanged)]


def _odometry(at_ms: int, x_m: float, topic: str = "/odom") -> Written:
    odometry = Odometry(0, None, Pose2D(x_m, 0.0, 0.0), Twist2D(1.0, 0.0, 0.0))
    return topic, "nav_msgs/msg/Odometry", at_ms, message_conversion.encode_odometry(ROS2, odometry, stamp_ns=T0_NS)


def _pose(at_ms: int, x_m: float) -> Written:
    transform = ("map", "base_link", Pose2D(x_m, 0.0, 0.0))
    return (
        "/tf",
        "tf2_msgs/msg/TFMessage",
        at_ms,
        message_conversion.encode_tf_message(ROS2, [transform], stamp_ns=T0_NS),
    )


def test_positions_alone_are_a_recording(tmp_path: Path) -> None:
    bag = write_ros1(tmp_path / "r.bag", (_pose(at_ms, at_ms / 1000) for at_ms in range(0, 1000, 100)))
    report = import_bag(bag, tmp_path / "s")
    assert report.values["pose"] == 10
    unknown = message_conversion.encode_tf_message(ROS2, [("a", "b", Pose2D(0.0, 0.0, 0.0))], stamp_ns=T0_NS)
    bag = write_ros1(tmp_path / "a.bag", iter([("/tf", "tf2_msgs/msg/TFMessage", 0, unknown)]))
    with pytest.raises(BagError, match="Nothing was written"):
        import_bag(bag, tmp_path / "a")


def _set_back(by_ms: int) -> Iterator[Written]:
    """Robot that drives on for 10 s while the clock is set back in the middle."""
    for number in range(100):
        at_ms = number * 100 - (by_ms if number >= 50 else 0)
        if number in (0, 50):
            mount = message_conversion.encode_tf_message(
                ROS2, [("base_link", "laser_link", Pose2D(0.2, 0.0, 0.0))], stamp_ns=T0_NS
            )
            yield "/tf_static", "tf2_msgs/msg/TFMessage", at_ms, mount
        yield _odometry(at_ms, float(number))
        yield _pose(at_ms, float(number))


@pytest.mark.parametrize("kind", ["ros1", "sqlite", "mcap"])
@pytest.mark.parametrize("by_ms", [3_000, 1_800_000, 86_400_000])
def test_a_clock_that_was_set_back_mixes_no_times(kind: str, by_ms: int, tmp_path: Path) -> None:
    if kind == "ros1":
        bag = write_ros1(tmp_path / "r.bag", _set_back(by_ms))
    else:
        storage = SQLITE if kind == "sqlite" else MCAP
        bag = write_ros2(tmp_path / "b", _set_back(by_ms), storage=storage, mode=CompressionMode.NONE)
    report = import_bag(bag, tmp_path / "s")
    assert report.duration_s == pytest.approx(4.9 + 1.0 + 4.9, abs=0.01)
    session = open_session(report.folder)
    assert [one.pose_in_odom.x_m for one in values(session, Odometry)] == list(range(100)), "as it was recorded"
    assert len(values(session, RobotPose)) == 100
    assert sum("The clock was set" in note or "the clock was set" in note for note in report.notes) == 1
    assert any("101 messages" in note or "100 messages" in note for note in report.notes)


@pytest.mark.parametrize("storage", [SQLITE, MCAP])
def test_a_bag_that_was_written_topic_by_topic_is_in_order_of_time(storage: StoragePlugin, tmp_path: Path) -> None:
    one_by_one = sorted(_set_back(0), key=lambda written: written[0])
    bag = write_ros2(tmp_path / "b", iter(one_by_one), storage=storage, mode=CompressionMode.NONE)
    report = import_bag(bag, tmp_path / "s")
    session = open_session(report.folder)
    stamps = [value.stamp_ns for _, value in session.values()]
    assert stamps == sorted(stamps) and len(values(session, RobotPose)) == 100
    assert report.duration_s == pytest.approx(9.9, abs=0.01)


def test_a_wrong_stamp_within_the_hour_moves_nothing_else(tmp_path: Path) -> None:
    written = [*_set_back(0)]
    written[60:60] = [_odometry(-1_000_000, -1.0)]
    written[90:90] = [_odometry(20_000, -1.0)]
    report = import_bag(write_ros1(tmp_path / "r.bag", iter(written)), tmp_path / "s")
    assert not any("clock was set" in note for note in report.notes)
    found = [one for one in values(open_session(report.folder), Odometry) if one.pose_in_odom.x_m >= 0]
    assert [one.pose_in_odom.x_m for one in found] == list(range(100))
    assert found[-1].stamp_ns - found[0].stamp_ns == pytest.approx(9.9e9, abs=1e7)


def test_messages_without_a_time_are_counted_and_a_mounting_needs_none(tmp_path: Path) -> None:
    written = [
        (topic, kind, -T0_NS // MS if topic == "/tf_static" or number < 3 else at_ms, message)
        for number, (topic, kind, at_ms, message) in enumerate(scans_before_the_mount(mounted_ms=0))
    ]
    report = import_bag(write_ros1(tmp_path / "r.bag", iter(written)), tmp_path / "s")
    without = sum(at_ms < 0 for _, _, at_ms, _ in written)
    assert f"{without} messages with a zero or invalid time were skipped." in report.notes
    scans = values(open_session(report.folder), LaserScan)
    assert scans and all(found.robot_from_laser == Near(Pose2D(0.2, 0.0, 3.1)) for found in scans)


@pytest.mark.parametrize("metadata", [None, ""])
@pytest.mark.parametrize("mode", [CompressionMode.NONE, CompressionMode.MESSAGE, CompressionMode.FILE])
def test_a_folder_that_was_not_closed_is_read(mode: CompressionMode, metadata: str | None, tmp_path: Path) -> None:
    folder = write_ros2(tmp_path / "b", _set_back(0), storage=SQLITE, mode=mode)
    (folder / "metadata.yaml").unlink()
    if metadata is not None:
        (folder / "metadata.yaml").write_text(metadata)
    report = import_bag(folder, tmp_path / "s")
    assert report.values["odometry"] == 100
    assert any("was not closed properly" in note for note in report.notes)


def test_files_that_the_metadata_omits_are_named(tmp_path: Path) -> None:
    folder = write_ros2(tmp_path / "b", _set_back(0), storage=MCAP, mode=CompressionMode.NONE)
    shutil.copy(folder / "b.mcap", folder / "b_1.mcap")
    assert any("b_1.mcap" in note for note in import_bag(folder, tmp_path / "s").notes)


def test_a_file_that_lies_there_twice_is_read_once(tmp_path: Path) -> None:
    folder = write_ros2(tmp_path / "b", _set_back(0), storage=MCAP, mode=CompressionMode.NONE)
    (folder / "metadata.yaml").unlink()
    shutil.copy(folder / "b.mcap", folder / "b (copy).mcap")
    (folder / "b.mcap.zstd").write_bytes(zstandard.compress((folder / "b.mcap").read_bytes()))
    report = import_bag(folder, tmp_path / "s")
    assert report.values["odometry"] == 100
    assert sum("the same as another file" in note for note in report.notes) == 2


@pytest.mark.parametrize("name", ["messages", "topics", "message_definitions"])
def test_a_database_whose_rows_are_computed_without_end_is_no_bag(name: str, tmp_path: Path) -> None:
    folder = write_ros2(tmp_path / "b", _set_back(0), storage=SQLITE, mode=CompressionMode.NONE)
    endless = "WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) SELECT 1, x, x, x FROM c"
    with closing(sqlite3.connect(next(folder.glob("*.db3")))) as database:
        database.execute(f"DROP TABLE {name}")
        database.execute(f"CREATE VIEW {name} (id, topic_id, timestamp, data) AS {endless}")
        database.commit()
    with pytest.raises(BagError, match=f"{name} is a view"):
        import_bag(folder, tmp_path / "s")


def test_the_colour_images_of_a_depth_camera_are_shown(tmp_path: Path) -> None:
    topics_of_it = (
        "/depth_camera/image_raw", "/depth_camera/depth/image_raw", "/camera/aligned_depth_to_color/image_raw",
        "/camera/depth/image_rect_raw", "/head/depth_registered/image",
    )  # fmt: skip
    written = [(topic, "sensor_msgs/msg/Image", 10 + at, raw_image(at, T0_NS)) for at, topic in enumerate(topics_of_it)]
    report = import_bag(write_ros1(tmp_path / "r.bag", iter(written)), tmp_path / "s")
    assert {topic for topic, (became, _) in topics(report).items() if became} == {"/depth_camera/image_raw"}


def test_only_a_bag_out_of_order_is_sorted_on_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_arguments: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(bag_files.sqlite3, "connect", full)
    spoken = [
        (20 * 10**9, "stray"),
        *_driven(_TRUE_NS, 30),
        (_TRUE_NS + 10**17, "stray"),
        *_driven(_TRUE_NS + 10**10, 30),
    ]
    assert import_bag(_speech(tmp_path / "a.mcap", spoken), tmp_path / "s").values
    one_by_one = sorted(_set_back(0), key=lambda written: written[0])
    with pytest.raises(BagError, match="could not be sorted by time"):
        import_bag(write_ros1(tmp_path / "r.bag", iter(one_by_one)), tmp_path / "r")
    assert not (tmp_path / "r").exists()
