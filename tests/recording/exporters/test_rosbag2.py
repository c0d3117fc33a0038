"""Sessions as bags, read with third-party software: rosbags for both versions, the mcap reader for ROS 2."""

import json
import subprocess
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer
from scipy.spatial.transform import Rotation

from caris_desktop.domain import streams
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import CommandSent, RobotChosen
from caris_desktop.domain.geometry import Twist2D
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.sensing import (
    BatteryState,
    CameraLens,
    FrameRef,
    LaserScan,
    OccupancyGrid,
    Odometry,
    PeopleInMap,
    RobotPose,
)
from caris_desktop.recording.exporters.rosbag2 import write_rosbag2
from caris_desktop.recording.foreign.bag_import import import_bag
from caris_desktop.recording.foreign.bag_messages import typed, typestore
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import ExportContext, export_session
from caris_desktop.ros import message_conversion
from caris_desktop.ros.dialect import Dialect
from tests.recording.exporters.test_frames import rerecorded
from tests.support.recorded_session import RecordedSession, make_session, number_in

SECOND_NS = 1_000_000_000
Read = tuple[int, Any]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> RecordedSession:
    return make_session(tmp_path_factory.mktemp("sessions") / "one", seconds=5.5, utterance_every_s=0.5, keep=True)


@pytest.fixture(scope="module")
def out(made: RecordedSession, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("bags") / "out"
    written = export_session(made.folder, "rosbag2", out)
    assert {path.relative_to(out).as_posix() for path in written} == {
        "README.md", "session.bag", "ros2/metadata.yaml", "ros2/ros2.mcap"
    }  # fmt: skip
    return out


@pytest.fixture(scope="module", params=["ros2", "session.bag"])
def bag(request: pytest.FixtureRequest, out: Path) -> dict[str, list[Read]]:
    return messages_in(out / request.param)


def messages_in(path: Path) -> dict[str, list[Read]]:
    """Time and typed message of everything in a bag, by topic."""
    read: dict[str, list[Read]] = {}
    with AnyReader([path]) as reader:
        for connection, at_ns, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            read.setdefault(connection.topic, []).append((at_ns, message))
    return read


def of(made: RecordedSession, kind: type[Any]) -> list[Read]:
    return [(arrived_ns, value) for arrived_ns, value in made.values if isinstance(value, kind)]


def utc_ns(made: RecordedSession, stamp_ns: int) -> int:
    return open_session(made.folder, repair=False).clock.anchor.utc_ns_at(stamp_ns)


def stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * SECOND_NS + int(header.stamp.nanosec)


def both(made: RecordedSession, kind: type[Any], messages: list[Read]) -> Iterator[tuple[Any, Any]]:
    """Pairs of a recorded value and its message, which is stamped with the arrival."""
    values = of(made, kind)
    assert len(values) == len(messages) > 0
    offset_ns = utc_ns(made, 0)
    for (arrived_ns, value), (at_ns, message) in zip(values, messages, strict=True):
        assert at_ns == arrived_ns + offset_ns
        yield value, message


@pytest.mark.long("ros2")
def test_scans_are_equal_and_stamped_when_they_were_measured(made: RecordedSession, bag: dict[str, list[Read]]) -> None:
    offset_ns, way_ns = utc_ns(made, 0), round(made.plan.network_delay_ms * 1e6)
    wrong_ms = []
    for scan, message in both(made, LaserScan, bag["/scan"]):
        assert message.__msgtype__ == "sensor_msgs/msg/LaserScan"
        np.testing.assert_array_equal(message.ranges, scan.ranges_m)
        assert (message.angle_min, message.angle_increment) == pytest.approx(
            (scan.angle_min_rad, scan.angle_increment_rad), abs=1e-6
        )
        assert (message.range_max, message.header.frame_id) == (scan.range_max_m, "laser")
        wrong_ms.append((stamp_ns(message.header) - offset_ns - (scan.stamp_ns - way_ns)) / 1e6)
    # The robot's clock is 2 s ahead with drift, and its estimate has an error of up to 2 ms.
    assert max(map(abs, wrong_ms)) < 3.5


def test_motion_is_equal(made: RecordedSession, bag: dict[str, list[Read]]) -> None:
    for command, message in both(made, CommandSent, bag["/cmd_vel"]):
        # Message type of the robot's profile, or the default.
        assert message.__msgtype__ == "geometry_msgs/msg/Twist"
        assert (message.linear.x, message.linear.y, message.angular.z) == (
            command.twist.forward_mps, command.twist.left_mps, command.twist.turn_radps
        )  # fmt: skip
    for pose, message in both(made, RobotPose, bag["/robot_pose"]):
        assert message.header.frame_id == "map"
        assert in_plane(message.pose.position, message.pose.orientation) == pytest.approx(of_pose(pose.pose_in_map))
    for odometry, message in both(made, Odometry, bag["/odom"]):
        assert in_plane(message.pose.pose.position, message.pose.pose.orientation) == pytest.approx(
            of_pose(odometry.pose_in_odom)
        )
        assert (message.twist.twist.linear.x, message.child_frame_id) == (odometry.twist.forward_mps, "base_link")


def test_map_battery_people(made: RecordedSession, bag: dict[str, list[Read]]) -> None:
    for grid, message in both(made, OccupancyGrid, bag["/map"]):
        np.testing.assert_array_equal(message.data.reshape(message.info.height, message.info.width), grid.cells)
        assert message.info.resolution == pytest.approx(grid.resolution_m)
    for battery, message in both(made, BatteryState, bag["/battery_state"]):
        assert message.percentage == pytest.approx(battery.charge_fraction)
        assert np.isnan(message.voltage)
    for people, message in both(made, PeopleInMap, bag["/people"]):
        told = [(m.text, m.pose.position.x, m.pose.position.y) for m in message.markers if m.ns == "person_ids"]
        assert told == [(person.person_id, person.x_m, person.y_m) for person in people.people]


def test_the_frames_of_reference_lead_from_the_map_to_the_laser(
    made: RecordedSession, bag: dict[str, list[Read]]
) -> None:
    parents = {}
    for topic in ("/tf", "/tf_static"):
        for _, message in bag[topic]:
            parents |= {t.child_frame_id: t.header.frame_id for t in message.transforms}
    assert parents == {"laser": "base_link", "base_link": "odom", "odom": "map"}
    (_, (transform,)) = bag["/tf_static"][0][0], bag["/tf_static"][0][1].transforms
    assert transform.transform.translation.x == pytest.approx(0.1)
    # Odometry and localization agree here, so odom stays on the map.
    for _, message in bag["/tf"]:
        for transform in message.transforms:
            if transform.child_frame_id == "odom":
                place = in_plane(transform.transform.translation, transform.transform.rotation)
                assert place == pytest.approx((0.0, 0.0, 0.0), abs=0.02)


def test_pictures_of_ros_1_are_those_of_their_moment(made: RecordedSession, out: Path) -> None:
    bag = messages_in(out / "session.bag")
    for camera in made.plan.cameras:
        pictures = bag[f"/camera/{camera}/image/compressed"]
        stamps_ns = made.plan.frame_stamps_ns(camera).tolist()
        assert len(pictures) == pytest.approx(5.0 * made.plan.seconds, rel=0.15)
        for at_ns, message in pictures:
            image_bgr = cv2.imdecode(message.data, cv2.IMREAD_COLOR)
            assert message.format == "jpeg"
            assert number_in(image_bgr) == bisect_right(stamps_ns, at_ns - utc_ns(made, 0)) - 1


def decoded(packets: Iterable[bytes]) -> list[Any]:
    """Frames decoded only from these packets."""
    decoder = av.CodecContext.create("h264", "r")
    frames = [frame for packet in packets for frame in decoder.decode(av.Packet(packet))]
    return [*frames, *decoder.decode(None)]


@pytest.mark.long
def test_ros_2_has_the_video_as_it_was_encoded(made: RecordedSession, out: Path) -> None:
    bag, offset_ns, way_ns = messages_in(out / "ros2"), utc_ns(made, 0), round(made.plan.network_delay_ms * 1e6)
    assert not [topic for topic in bag if topic.endswith("/compressed")]
    for camera in made.plan.cameras:
        found = bag[f"/camera/{camera}/image/foxglove"]
        packets = [bytes(message.data) for _, message in found]
        assert {(message.format, message.frame_id) for _, message in found} == {("h264", f"{camera}_optical_frame")}
        with av.open(str(made.folder / f"video-{camera}.mp4")) as video:
            frames = list(video.decode(video=0))
        # Bit-identical images: nothing was encoded again.
        for shown, frame in zip(decoded(packets), frames, strict=True):
            np.testing.assert_array_equal(shown.to_ndarray(format="yuv420p"), frame.to_ndarray(format="yuv420p"))
        keys = [number for number, frame in enumerate(frames) if frame.key_frame]
        assert len(keys) > 5
        for key, following in pairwise([*keys, len(frames)]):
            # Each group starts with the data for a decoder (unit types: parameters 7 and 8, then a key frame 5).
            units = [unit[0] & 31 for unit in packets[key].replace(b"\0\0\0\1", b"\0\0\1").split(b"\0\0\1")[1:]]
            assert units.index(7) < units.index(8) < units.index(5)
            assert len(decoded(packets[key:following])) == following - key
        stamps_ns = made.plan.frame_stamps_ns(camera).tolist()
        assert len(stamps_ns) == len(frames)
        for number, (at_ns, message) in enumerate(found):
            assert number == bisect_right(stamps_ns, at_ns - offset_ns) - 1
            told_ns = int(message.timestamp.sec) * SECOND_NS + int(message.timestamp.nanosec)
            assert abs(told_ns - offset_ns - (stamps_ns[number] - way_ns)) < 3.5e6


@pytest.mark.long
def test_its_video_comes_back_with_the_bag(made: RecordedSession, out: Path, tmp_path: Path) -> None:
    import_bag(out / "ros2", tmp_path / "again")
    with VideoReader(open_session(tmp_path / "again")) as videos:
        for camera in made.plan.cameras:
            count = len(made.plan.frame_stamps_ns(camera))
            pictures = [videos.frame(camera, number) for number in range(count)]
            assert [number_in(picture.image_bgr) for picture in pictures if picture is not None] == list(range(count))


@pytest.mark.long
def test_frames_that_the_record_does_not_list_are_there_too(tmp_path: Path) -> None:
    """A decoder needs every packet, and a recording may have lost its end."""
    made = make_session(tmp_path / "s", seconds=2.0, cameras=("front",), audio=(), keep=True)
    frames = of(made, FrameRef)
    lost = {ref.sequence for _, ref in (frames[3], *frames[-5:])}
    left = [pair for pair in made.values if not (isinstance(pair[1], FrameRef) and pair[1].sequence in lost)]
    rerecorded(made, left)
    export_session(made.folder, "rosbag2", tmp_path / "out")
    found = messages_in(tmp_path / "out" / "ros2")["/camera/front/image/foxglove"]
    numbers = [number_in(frame.to_ndarray(format="bgr24")) for frame in decoded(bytes(one.data) for _, one in found)]
    assert numbers == list(range(len(frames)))
    stamps_ns = [int(one.timestamp.sec) * SECOND_NS + int(one.timestamp.nanosec) for _, one in found]
    assert stamps_ns == sorted(stamps_ns)


def test_values_without_a_standard_message_are_there_as_json(made: RecordedSession, bag: dict[str, list[Read]]) -> None:
    told = [json.loads(message.data) for _, message in bag["/caris/event/utterance_changed"]]
    recorded = [to_jsonable(value) for _, value in made.values if type(value).__name__ == "UtteranceChanged"]
    assert told == recorded
    texts = [message.data for _, message in bag["/speech/robot"]]
    assert texts == [u["text"] for u in recorded if u["speaker"] == "robot" and u["state"] == "started"]
    (_, session) = bag["/caris/session"][0]
    assert json.loads(session.data)["trial"]["participant"] == "P07"
    assert len(bag["/diagnostics"]) == int(made.plan.seconds)
    assert {json.loads(message.data)["name"] for _, message in bag["/caris/status"]} >= {"link", "drive"}


def test_the_mcap_stands_alone(out: Path) -> None:
    with (out / "ros2" / "ros2.mcap").open("rb") as file:
        reader = make_reader(file)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        schemas = {schema.name: schema for schema in summary.schemas.values()}
        assert schemas["sensor_msgs/msg/LaserScan"].encoding == "ros2msg"
        assert b"float32[] ranges" in schemas["sensor_msgs/msg/LaserScan"].data
        assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
        count = sum(1 for _ in reader.iter_messages())
    metadata = yaml.safe_load((out / "ros2" / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert count == summary.statistics.message_count == metadata["message_count"]
    assert "transient_local" in str(metadata) or "TRANSIENT_LOCAL" in str(metadata) or "durability: 1" in str(metadata)
    assert "| `/scan` | `sensor_msgs/LaserScan` | 55 |" in (out / "README.md").read_text()


@pytest.mark.long
def test_every_frame_where_that_is_requested(made: RecordedSession, tmp_path: Path) -> None:
    fractions: list[float] = []
    context = ExportContext(progress=fractions.append)
    write_rosbag2(open_session(made.folder), tmp_path, context, image_hz=None)
    with AnyReader([tmp_path / "session.bag"]) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
    for camera in made.plan.cameras:
        assert counts[f"/camera/{camera}/image/compressed"] == len(made.plan.frame_stamps_ns(camera))
    assert fractions == sorted(fractions)
    assert 0.0 <= fractions[0] < fractions[-1] <= 1.0


def test_a_camera_points_where_its_lens_does(tmp_path: Path) -> None:
    made = make_session(tmp_path / "s", seconds=1.0, cameras=(), audio=(), keep=True)
    model = CameraModel(640, 480, 500.0, 510.0, 320.0, 240.0, 0.1, -0.05, 1.2, heading_rad=0.4, tilt_rad=0.3)
    lens = CameraLens(made.plan.started_ns, None, "front door", model)
    other = replace(lens, camera="front_door")
    rerecorded(made, [(made.plan.started_ns, lens), (made.plan.started_ns, other), *made.values])
    export_session(made.folder, "rosbag2", tmp_path / "out")
    bag = messages_in(tmp_path / "out" / "session.bag")
    read = {topic: [message for _, message in found] for topic, found in bag.items()}
    (info,) = read["/camera/front_door/camera_info"]
    assert len(read["/camera/front_door_2/camera_info"]) == 1
    assert (info.K[0], info.K[4], info.width) == (500.0, 510.0, 640)
    transforms = {t.child_frame_id: t for message in read["/tf_static"] for t in message.transforms}
    place = transforms[info.header.frame_id].transform
    assert (place.translation.x, place.translation.y, place.translation.z) == (0.1, -0.05, 1.2)
    q = place.rotation
    rotation = Rotation.from_quat([q.x, q.y, q.z, q.w])
    for u_px, v_px in ((320.0, 240.0), (0.0, 100.0), (600.0, 470.0)):
        optical = [(u_px - 320.0) / 500.0, (v_px - 240.0) / 510.0, 1.0]
        np.testing.assert_allclose(rotation.apply(optical), model.ray(u_px, v_px), atol=1e-9)


STAMPED = "name: new\nvelocity: {topic: /base/cmd, type: TwistStamped}\n"


@pytest.mark.logs(r"session\.session_protocol: ")
def test_velocities_have_the_type_that_drives_the_robot(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    made = make_session(tmp_path / "s", seconds=1.0, cameras=(), audio=(), keep=True)
    began_ns = made.plan.started_ns
    stamped = RobotChosen(began_ns, "new", "New", "ws://127.0.0.1:9090", STAMPED)
    plain = replace(stamped, stamp_ns=began_ns + SECOND_NS // 2, profile="velocity: [not a profile")
    values = [(arrived_ns, value) for arrived_ns, value in made.values if not isinstance(value, RobotChosen)]
    values = sorted([*values, (began_ns, stamped), (plain.stamp_ns, plain)], key=itemgetter(0))
    rerecorded(made, values)
    export_session(made.folder, "rosbag2", tmp_path / "out")
    commands = [(arrived_ns, value) for arrived_ns, value in values if isinstance(value, CommandSent)]
    bag = messages_in(tmp_path / "out" / "session.bag")
    read = {topic: [message for _, message in found] for topic, found in bag.items()}
    assert "the recorded robot profile cannot be read" in caplog.text
    # Separate topics for the second robot: two types on one topic break a ROS 1 graph.
    assert {message.__msgtype__ for message in read["/cmd_vel"]} == {"geometry_msgs/msg/TwistStamped"}
    assert {message.__msgtype__ for message in read["/cmd_vel_twist"]} == {"geometry_msgs/msg/Twist"}
    assert len(read["/cmd_vel"]) == sum(arrived_ns < plain.stamp_ns for arrived_ns, _ in commands)
    assert len(read["/cmd_vel"]) + len(read["/cmd_vel_twist"]) == len(commands)
    assert [stamp_ns(message.header) for message in read["/cmd_vel"]] == [
        utc_ns(made, command.stamp_ns) for _, command in commands[: len(read["/cmd_vel"])]
    ]
    for name in ("session.bag", "ros2"):
        import_bag(tmp_path / "out" / name, tmp_path / f"again-{name}")
        again = [value for _, value in open_session(tmp_path / f"again-{name}").values("event/command_sent")]
        assert again == [command for _, command in commands]


def test_an_imported_bag_keeps_the_type_of_its_velocities(tmp_path: Path) -> None:
    message = message_conversion.encode_twist_stamped(Dialect.ROS2, Twist2D(0.4, 0.0, 0.1), stamp_ns=7 * SECOND_NS)
    kind = "geometry_msgs/msg/TwistStamped"
    with Writer(tmp_path / "foreign.bag") as bag:
        connection = bag.add_connection("/cmd_vel", kind, typestore=typestore(1))
        bag.write(connection, 7 * SECOND_NS, typestore(1).serialize_ros1(typed(1, kind, message), kind))
    import_bag(tmp_path / "foreign.bag", tmp_path / "s")
    export_session(tmp_path / "s", "rosbag2", tmp_path / "out")
    for _, again in messages_in(tmp_path / "out" / "ros2")["/cmd_vel"]:
        assert (again.__msgtype__, again.twist.linear.x) == (kind, 0.4)


def test_intensities_are_recorded_and_exported(tmp_path: Path) -> None:
    made = make_session(tmp_path / "s", seconds=1.0, cameras=(), audio=(), keep=True)
    bright = np.array([0.0, 47.25, 1023.5, np.nan], np.float32)
    rerecorded(
        made,
        [
            (arrived_ns, replace(value, intensities=bright) if isinstance(value, LaserScan) else value)
            for arrived_ns, value in made.values
        ],
    )
    for _, scan in open_session(made.folder).values("scan"):
        np.testing.assert_array_equal(scan.intensities, bright)
    export_session(made.folder, "rosbag2", tmp_path / "out")
    for name in ("session.bag", "ros2"):
        scans = messages_in(tmp_path / "out" / name)["/scan"]
        assert len(scans) == len(of(made, LaserScan))
        for _, message in scans:
            np.testing.assert_array_equal(message.intensities, bright)
    export_session(made.folder, "parquet", tmp_path / "tables")
    (row, *_) = pq.read_table(tmp_path / "tables" / "scan.parquet", columns=["intensities"]).to_pylist()
    np.testing.assert_array_equal(row["intensities"], bright)


READER = Path(__file__).with_name("read_by_rosbag.py")


def _isolated(*command: str) -> "subprocess.CompletedProcess[str]":
    python, *arguments = command
    return subprocess.run([python, "-I", *arguments], check=False, capture_output=True, text=True)


@cache
def python_with_rosbag() -> str | None:
    """Python of this system with ROS 1's own bag reader."""
    for name in ("python3", "python3.13", "python3.12", "python3.11"):
        path = f"/usr/bin/{name}"
        if Path(path).exists() and not _isolated(path, "-c", "import rosbag").returncode:
            return path
    return None


def test_the_reader_of_ros_1_itself_reads_the_bag(made: RecordedSession, out: Path) -> None:
    python = python_with_rosbag()
    if python is None:
        pytest.skip("needs ROS 1's own reader of bags (Debian: python3-rosbag)")
    told = _isolated(python, str(READER), str(out / "session.bag"))
    assert told.returncode == 0, told.stderr
    read, bag = json.loads(told.stdout), messages_in(out / "session.bag")
    assert read["compression"] == "lz4"
    assert {topic: len(found["messages"]) for topic, found in read["topics"].items()} == {
        topic: len(found) for topic, found in bag.items()
    }
    for topic, found in read["topics"].items():
        assert found["md5"] == found["md5_of_definition"], topic
        assert [at_ns for at_ns, _ in found["messages"]] == [at_ns for at_ns, _ in bag[topic]]
    for (at_ns, scan), (_, message) in zip(of(made, LaserScan), read["topics"]["/scan"]["messages"], strict=True):
        np.testing.assert_array_equal(np.array(message["ranges"], np.float32), scan.ranges_m, err_msg=str(at_ns))
    (_, grid), *_ = of(made, OccupancyGrid)
    assert read["topics"]["/map"]["messages"][0][1]["data"] == grid.cells.ravel().tolist()


@dataclass(frozen=True, slots=True)
class DoorOpened:
    """Event type unknown to the exporters."""

    stamp_ns: int
    door: str


def test_a_new_kind_of_event_is_exported_and_comes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    spec = streams.StreamSpec("event/door_opened", DoorOpened, streams.Delivery.LOSSLESS)
    monkeypatch.setitem(streams.BY_TYPE, DoorOpened, spec)
    monkeypatch.setitem(streams.BY_NAME, spec.name, spec)
    made = make_session(tmp_path / "s", seconds=1.0, cameras=(), audio=(), keep=True)
    opened = DoorOpened(made.plan.started_ns + 5, "kitchen")
    rerecorded(made, [(made.plan.started_ns + 7, opened), *made.values])
    export_session(made.folder, "rosbag2", tmp_path / "out")
    report = import_bag(tmp_path / "out" / "ros2", tmp_path / "again")
    assert report.values["event/door_opened"] == 1
    session = open_session(tmp_path / "again")
    assert list(session.arrivals("event/door_opened")) == [(made.plan.started_ns + 7, spec, opened)]
    export_session(made.folder, "rocrate", tmp_path / "crate")
    assert "unknown to the exporters" in (tmp_path / "crate" / "schemas" / "event.door_opened.schema.json").read_text()


def in_plane(position: Any, orientation: Any) -> tuple[float, float, float]:
    return position.x, position.y, 2.0 * float(np.arctan2(orientation.z, orientation.w))


def of_pose(pose: Any) -> tuple[float, float, float]:
    return pose.x_m, pose.y_m, pose.heading_rad
