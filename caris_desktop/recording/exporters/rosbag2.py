"""ROS bag export: ``ros2/`` for ROS 2 (MCAP) and ``session.bag`` for ROS 1, with the same standard messages.

Only images differ: ROS 2 gets every encoded video frame, ROS 1 a subset as JPEG.

Long because both kinds of bags are written in one pass.
"""

import json
import math
import struct
from bisect import bisect_left
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, Literal

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import CommandSent, GoalChanged, LinkQuality, RobotChosen, UtteranceChanged
from caris_desktop.domain.foxglove import BASE, MAP, optical_frame
from caris_desktop.domain.free_names import free_name
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.media_checks import jpeg_of
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.domain.sensing import (
    BatteryState,
    CameraLens,
    FrameRef,
    LaserScan,
    OccupancyGrid,
    Odometry,
    PeopleInMap,
    PlannedPath,
    RobotPose,
)
from caris_desktop.domain.streams import BY_TYPE, StreamSpec
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.exporters.exported_pictures import Pace, info_of, picture_of
from caris_desktop.recording.exporters.templates import write_page
from caris_desktop.recording.foreign.bag_messages import Ros, typed, typestore
from caris_desktop.recording.replay.video_reader import RecordedFrame, VideoReader
from caris_desktop.recording.session.robot_clock_mapping import RobotClock, clock_summary, robot_clock
from caris_desktop.recording.session.session_protocol import parsed_yaml
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session_export import ExportContext
from caris_desktop.ros import message_conversion
from caris_desktop.ros.dialect import Dialect, encode_time
from caris_desktop.ros.message_fields import Message, encode_header, encode_pose

ODOM = "odom"
SESSION_TOPIC, VALUE_TOPICS = "/caris/session", "/caris/"
IMAGE_HZ = 5.0
_JPEG_QUALITY = 90
_PLAIN = Dialect.ROS2  # dialect of the plain messages here; bag_messages.typed maps ROS 1 spellings
_KEPT_ODOMETRY, _WAITING_POSES = 100, 50
_PERSON_HEIGHT_M, _PERSON_SHOWN_S = 1.7, 1.0
# Fully covered by a standard message; everything else is also written as JSON with its own schema.
_WHOLE = (LaserScan, Odometry, RobotPose, OccupancyGrid, PlannedPath, BatteryState, FrameRef)


class RosTopic(Value):
    """``latched``: late subscribers receive the newest message. ``ros``: the bags that contain the topic."""

    name: str
    type: str
    latched: bool = False
    ros: tuple[Ros, ...] = (1, 2)


SCAN = RosTopic("/scan", "sensor_msgs/msg/LaserScan")
ODOMETRY = RosTopic("/odom", "nav_msgs/msg/Odometry")
POSE = RosTopic("/robot_pose", "geometry_msgs/msg/PoseStamped")
GRID = RosTopic("/map", "nav_msgs/msg/OccupancyGrid", latched=True)
PATH = RosTopic("/plan", "nav_msgs/msg/Path")
GOAL = RosTopic("/goal_pose", "geometry_msgs/msg/PoseStamped")
COMMAND = "/cmd_vel"
BATTERY = RosTopic("/battery_state", "sensor_msgs/msg/BatteryState")
PEOPLE = RosTopic("/people", "visualization_msgs/msg/MarkerArray")
CLOCK = RosTopic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray")
TF = RosTopic("/tf", "tf2_msgs/msg/TFMessage")
TF_STATIC = RosTopic("/tf_static", "tf2_msgs/msg/TFMessage", latched=True)
SESSION = RosTopic(SESSION_TOPIC, "std_msgs/msg/String", latched=True)

_Out = Iterator[tuple[RosTopic, Message]]


def write_rosbag2(
    session: Session, out: Path, context: ExportContext, *, image_hz: float | None = IMAGE_HZ
) -> list[Path]:
    """Fill the folder ``out``. ``image_hz`` limits the JPEG images per camera; None: every frame.

    Raises OSError, SessionError.
    """
    clock = robot_clock(session)
    moments = _Moments(session, clock)
    with ExitStack() as stack:
        bags = stack.enter_context(_Bags(out))
        videos = stack.enter_context(VideoReader(session))
        has_odometry = next(session.values("odometry"), None) is not None
        translator = _Translator(
            moments,
            videos,
            has_odometry=has_odometry,
            velocity_type=_imported_velocity_type(session),
            image_hz=image_hz,
        )
        fields = ("format", "format_version", "program_version", "scenario", "trial", "clock", "started_ns", "ended_ns")
        header = session.header.to_json()
        head = {name: header[name] for name in fields if name in header}
        bags.write(
            SESSION,
            session.clock.anchor.utc_ns_at(session.started_ns),
            {"data": json.dumps({**head, "folder": session.folder.name}, ensure_ascii=False)},
        )
        duration_ns = max(1, session.ended_ns - session.started_ns)
        for number, (arrival_ns, spec, value) in enumerate(session.arrivals()):
            at_utc_ns = session.clock.anchor.utc_ns_at(arrival_ns)
            try:
                translated = list(translator.messages(spec, value, arrival_ns))
            except (ValueError, OverflowError):
                # For example an infinite angle: recordings may come from any source.
                bags.left_out += 1
                continue
            for topic, message in translated:
                bags.write(topic, at_utc_ns, message)
            if not number % 200:
                context.progress(min(1.0, max(0.0, (arrival_ns - session.started_ns) / duration_ns)))
        for at_utc_ns, topic, message in translator.rest_of_videos():
            bags.write(topic, at_utc_ns, message)
    if bags.left_out:
        warning = QT_TR_NOOP(
            "%n message(s) were skipped: their times or numbers are out of range for ROS.", "", bags.left_out
        )
        context.warn(warning)
    topics = dict(sorted(bags.counts.items(), key=lambda item: item[0].name))
    readme = write_page(
        out / "README.md", "rosbag2.md.j2", session=session, robot_clock=clock_summary(session), topics=topics,
        moments=moments, image_hz=image_hz,
    )  # fmt: skip
    return [readme, out / "session.bag", out / "ros2" / "metadata.yaml", out / "ros2" / "ros2.mcap"]


class _Moments:
    """Measurement times of values in UTC, and their uncertainty."""

    def __init__(self, session: Session, clock: RobotClock) -> None:
        self._anchor = session.clock.anchor
        self._clock = clock
        self.worst_uncertainty_ns = 0
        self.mapped = self.as_arrived = 0

    def utc_ns(self, value: Any, arrival_ns: int) -> int:
        """Measurement time from the robot's stamp if it can be mapped, else from the value's own stamp."""
        robot_stamp_ns = getattr(value, "robot_stamp_ns", None)
        if robot_stamp_ns is not None:
            measured = self._clock.measured(robot_stamp_ns, arrival_ns=arrival_ns)
            if measured is not None:
                self.mapped += 1
                self.worst_uncertainty_ns = max(self.worst_uncertainty_ns, measured.uncertainty_ns)
                return self._anchor.utc_ns_at(measured.stamp_ns)
            self.as_arrived += 1
        return self._anchor.utc_ns_at(value.stamp_ns)


VelocityType = Literal["Twist", "TwistStamped"]


class _Translator:
    """Converts recorded values, in order of arrival, to messages."""

    def __init__(
        self,
        moments: _Moments,
        videos: VideoReader,
        *,
        has_odometry: bool,
        velocity_type: VelocityType,
        image_hz: float | None,
    ) -> None:
        self._moments = moments
        self._videos = videos
        self._has_odometry = has_odometry
        self._pace = Pace(image_hz)
        self._packets: dict[str, _Packets] = {camera: _Packets(videos.packets(camera)) for camera in videos.cameras}
        self._odometry: deque[tuple[int, Pose2D]] = deque(maxlen=_KEPT_ODOMETRY)
        self._poses: deque[tuple[int, Pose2D]] = deque()
        self._static: dict[str, Message] = {}
        self._speaking: set[str] = set()
        self._names: dict[str, str] = {}
        self._velocity_type = velocity_type
        self._commands: dict[VelocityType, RosTopic] = {}
        self._by_type: dict[type[Any], Callable[[Any, int], _Out]] = {
            LaserScan: self._scan,
            Odometry: self._odometry_and_tf,
            RobotPose: self._pose,
            OccupancyGrid: lambda grid, at_ns: iter(
                ((GRID, message_conversion.encode_occupancy_grid(_PLAIN, grid, stamp_ns=at_ns, frame_id=MAP)),)
            ),
            PlannedPath: lambda path, at_ns: iter(
                ((PATH, message_conversion.encode_path(_PLAIN, path.points_in_map, stamp_ns=at_ns, frame_id=MAP)),)
            ),
            BatteryState: self._battery,
            CommandSent: self._command,
            GoalChanged: self._goal,
            CameraLens: self._lens,
            FrameRef: self._image,
            PeopleInMap: self._people,
            LinkQuality: self._link_quality,
            UtteranceChanged: self._utterance,
        }

    def messages(self, spec: StreamSpec, value: Any, arrival_ns: int) -> _Out:
        if isinstance(value, RobotChosen):
            # From the recorded robot profile, which need not be installed any more.
            profile = parsed_yaml(value.profile, "robot profile")
            velocity = profile.get("velocity") if isinstance(profile, dict) else None
            stamped = isinstance(velocity, dict) and velocity.get("type") == "TwistStamped"
            self._velocity_type = "TwistStamped" if stamped else "Twist"
        translate = self._by_type.get(type(value))
        if translate is not None:
            yield from translate(value, self._moments.utc_ns(value, arrival_ns))
        if not isinstance(value, _WHOLE):
            data = json.dumps(to_jsonable(value), ensure_ascii=False, separators=(",", ":"), allow_nan=False)
            yield RosTopic(f"{VALUE_TOPICS}{spec.name}", "std_msgs/msg/String"), {"data": data}

    def _scan(self, scan: LaserScan, at_ns: int) -> _Out:
        frame = scan.frame_id.lstrip("/") or "laser"
        if frame != BASE and scan.robot_from_laser is not None:
            (transform,) = message_conversion.encode_tf_message(
                _PLAIN, [(BASE, frame, scan.robot_from_laser)], stamp_ns=at_ns
            )["transforms"]
            yield from self._fixed(frame, dict(transform))
        message = message_conversion.encode_laser_scan(_PLAIN, scan, stamp_ns=at_ns, scan_time_s=0.0)
        message["header"]["frame_id"] = frame
        yield SCAN, message

    def _odometry_and_tf(self, odometry: Odometry, at_ns: int) -> _Out:
        self._odometry.append((at_ns, odometry.pose_in_odom))
        yield (
            ODOMETRY,
            message_conversion.encode_odometry(_PLAIN, odometry, stamp_ns=at_ns, frame_id=ODOM, child_frame_id=BASE),
        )
        yield TF, message_conversion.encode_tf_message(_PLAIN, [(ODOM, BASE, odometry.pose_in_odom)], stamp_ns=at_ns)
        while self._poses and (self._poses[0][0] <= at_ns or len(self._poses) > _WAITING_POSES):
            # The pose of odom in map is known once the odometry of that time is.
            pose_ns, pose_in_map = self._poses.popleft()
            map_from_odom = pose_in_map @ _interpolated(self._odometry, pose_ns).inverse()
            yield TF, message_conversion.encode_tf_message(_PLAIN, [(MAP, ODOM, map_from_odom)], stamp_ns=pose_ns)

    def _pose(self, pose: RobotPose, at_ns: int) -> _Out:
        yield POSE, message_conversion.encode_pose_stamped(_PLAIN, pose.pose_in_map, stamp_ns=at_ns, frame_id=MAP)
        if self._has_odometry:
            self._poses.append((at_ns, pose.pose_in_map))
        else:
            yield TF, message_conversion.encode_tf_message(_PLAIN, [(MAP, BASE, pose.pose_in_map)], stamp_ns=at_ns)

    def _battery(self, battery: BatteryState, at_ns: int) -> _Out:
        message = message_conversion.encode_battery_state(_PLAIN, battery, stamp_ns=at_ns, voltage_v=math.nan)
        unknown = {"power_supply_status": 0, "power_supply_health": 0, "power_supply_technology": 0}
        yield BATTERY, {**message, **unknown, "temperature": math.nan}

    def _command(self, command: CommandSent, at_ns: int) -> _Out:
        """Command in the robot's message type. Two types on one topic break its playback, so that a second type gets
        its own topic.
        """
        kind = self._velocity_type
        name = f"{COMMAND}_{kind.lower()}" if self._commands and kind not in self._commands else COMMAND
        topic = self._commands.setdefault(kind, RosTopic(name, f"geometry_msgs/msg/{kind}"))
        if kind == "TwistStamped":
            yield topic, message_conversion.encode_twist_stamped(_PLAIN, command.twist, stamp_ns=at_ns, frame_id=BASE)
        else:
            yield topic, message_conversion.encode_twist(command.twist)

    def _goal(self, goal: GoalChanged, at_ns: int) -> _Out:
        if goal.state == "requested":
            yield GOAL, message_conversion.encode_pose_stamped(_PLAIN, goal.target_in_map, stamp_ns=at_ns, frame_id=MAP)

    def _lens(self, lens: CameraLens, at_ns: int) -> _Out:
        model, frame = lens.model, optical_frame(self._name_of(lens.camera))
        if not model.on_head:
            yield from self._fixed(frame, _camera_transform(model, frame, at_ns=at_ns))
        yield (
            RosTopic(f"/camera/{self._name_of(lens.camera)}/camera_info", "sensor_msgs/msg/CameraInfo", latched=True),
            message_conversion.encode_camera_info(_PLAIN, model, stamp_ns=at_ns, frame_id=frame),
        )

    def _image(self, ref: FrameRef, at_ns: int) -> _Out:
        packets = self._packets.get(ref.camera)
        if packets is None:
            return
        encoded = packets.exist
        if encoded:
            info = info_of(self._videos, ref.camera, ref.stamp_ns)
            for frame, data in packets.until(-1 if info is None else info.number):
                here = info is not None and frame.number == info.number
                yield self._video_message(frame, data, at_ns if here else self._moments.utc_ns(frame, frame.stamp_ns))
        if not self._pace.is_due(ref.camera, ref.stamp_ns):
            return
        picture = picture_of(self._videos, ref.camera, ref.stamp_ns)
        if picture is None:
            return
        self._pace.take(ref.camera, ref.stamp_ns)
        name = self._name_of(ref.camera)
        topic = RosTopic(f"/camera/{name}/image/compressed", "sensor_msgs/msg/CompressedImage")
        jpeg = jpeg_of(picture.image_bgr, quality=_JPEG_QUALITY)
        yield (
            replace(topic, ros=(1,)) if encoded else topic,
            message_conversion.encode_compressed_image(
                _PLAIN, jpeg, stamp_ns=at_ns, encoding="jpeg", frame_id=optical_frame(name)
            ),
        )

    def rest_of_videos(self) -> Iterator[tuple[int, RosTopic, Message]]:
        """Frames without a (remaining) record in the log, each with its time in UTC."""
        for packets in self._packets.values():
            for frame, data in packets.until(None):
                at_ns = self._moments.utc_ns(frame, frame.stamp_ns)
                yield at_ns, *self._video_message(frame, data, at_ns)

    def _video_message(self, frame: RecordedFrame, data: bytes, at_ns: int) -> tuple[RosTopic, Message]:
        name = self._name_of(frame.camera)
        # Topic name that image_transport expects for this encoding of /camera/NAME/image.
        topic = RosTopic(f"/camera/{name}/image/foxglove", "foxglove_msgs/msg/CompressedVideo", ros=(2,))
        stamp = encode_time(_PLAIN, at_ns)
        return topic, {"timestamp": stamp, "frame_id": optical_frame(name), "data": data, "format": "h264"}

    def _people(self, people: PeopleInMap, at_ns: int) -> _Out:
        header = encode_header(_PLAIN, stamp_ns=at_ns, frame_id=MAP)
        lifetime = encode_time(_PLAIN, round(_PERSON_SHOWN_S * 1e9))
        markers = []
        for number, person in enumerate(people.people):
            shared = {"header": header, "id": number, "action": 0, "lifetime": lifetime, "frame_locked": False}
            wide_m = max(0.3, 2.0 * person.spread_m)
            markers.append(
                {
                    **shared,
                    "ns": "people",
                    "type": 3,  # a cylinder
                    "pose": _upright(person.x_m, person.y_m, _PERSON_HEIGHT_M / 2),
                    "scale": {"x": wide_m, "y": wide_m, "z": _PERSON_HEIGHT_M},
                    "color": {"r": 0.2, "g": 0.6, "b": 1.0, "a": 0.6},
                }
            )
            markers.append(
                {
                    **shared,
                    "ns": "person_ids",
                    "type": 9,  # text that faces the viewer
                    "pose": _upright(person.x_m, person.y_m, _PERSON_HEIGHT_M + 0.2),
                    "scale": {"x": 0.0, "y": 0.0, "z": 0.25},
                    "color": {"r": 1.0, "g": 1.0, "b": 1.0, "a": 1.0},
                    "text": person.person_id,
                }
            )
        yield PEOPLE, {"markers": markers}

    def _link_quality(self, quality: LinkQuality, at_ns: int) -> _Out:
        known = {
            "round_trip_ms": quality.round_trip_ms,
            "robot_clock_minus_session_clock_ms": quality.clock_offset_ms,
            "uncertainty_ms": quality.clock_uncertainty_ms,
        }
        values = [{"key": key, "value": repr(value)} for key, value in known.items() if value is not None]
        status = {"level": 0, "name": "robot clock", "message": "as measured by the link", "hardware_id": "link"}
        yield (
            CLOCK,
            {"header": encode_header(_PLAIN, stamp_ns=at_ns, frame_id=""), "status": [{**status, "values": values}]},
        )

    def _utterance(self, utterance: UtteranceChanged, _at_ns: int) -> _Out:
        """Text of an utterance, once, at its start; recognised speech at its end."""
        if utterance.utterance_id in self._speaking or utterance.state not in ("started", "finished"):
            return
        if utterance.speaker == "participant" and utterance.state == "started":
            return
        self._speaking.add(utterance.utterance_id)
        yield RosTopic(f"/speech/{utterance.speaker}", "std_msgs/msg/String"), {"data": utterance.text}

    def _name_of(self, camera: str) -> str:
        """Unique topic name of the camera."""
        if camera not in self._names:
            taken = set(self._names.values())
            self._names[camera] = free_name(_ros_name(camera), "", taken.__contains__, number_as="_{}")
        return self._names[camera]

    def _fixed(self, frame: str, transform: Message) -> _Out:
        """Static transform, at its first value and at each change."""
        if self._static.get(frame) != transform["transform"]:
            self._static[frame] = transform["transform"]
            yield TF_STATIC, {"transforms": [transform]}


class _Packets:
    """Encoded frames of a camera's videos in sequence."""

    def __init__(self, frames: Iterator[tuple[RecordedFrame, bytes]]) -> None:
        self._frames = frames
        self._next: tuple[RecordedFrame, bytes] | None = None

    @cached_property
    def exist(self) -> bool:
        """True if there is or was any frame."""
        self._next = next(self._frames, None)
        return self._next is not None

    def until(self, number: int | None) -> Iterator[tuple[RecordedFrame, bytes]]:
        """Frames up to that number, or all remaining ones: a decoder needs each of them."""
        while self.exist and self._next is not None and (number is None or self._next[0].number <= number):
            yield self._next
            self._next = next(self._frames, None)


class _Bags:
    """Writes both bags in parallel; a context manager."""

    def __init__(self, out: Path) -> None:
        import lz4.frame
        from rosbags.rosbag1 import Writer as Writer1
        from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
        from rosbags.rosbag2 import Writer as Writer2

        self._ros1: Writer1 = Writer1(out / "session.bag")
        self._ros1.set_compression(Writer1.CompressionFormat.LZ4)
        # ROS 1's profile of an LZ4 frame: independent blocks, content checksum, no content size
        options = {"block_linked": False, "content_checksum": True, "store_size": False}
        self._ros1.compressor = partial(lz4.frame.compress, **options)
        # Version 8: the newest metadata version that ROS 2 Humble reads.
        self._ros2: Writer2 = Writer2(out / "ros2", version=8, storage_plugin=StoragePlugin.MCAP)
        self._ros2.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        self._connections: dict[tuple[RosTopic, Ros], Any] = {}
        self.counts: dict[RosTopic, int] = {}
        self.left_out = 0
        self._chunks = 0

    def __enter__(self) -> "_Bags":
        self._ros1.open()
        try:
            self._ros2.open()
        except BaseException:
            self._ros1.abort()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self._ros2.close()
            self._ros1.close()
        else:
            self._ros2.abort()
            self._ros1.abort()

    def write(self, topic: RosTopic, at_utc_ns: int, message: Message) -> None:
        try:
            try:
                serialized = _serialized(topic, message)
            except UnicodeEncodeError:
                # A lone surrogate from an input method.
                serialized = _serialized(topic, _encodable(message))
        except (struct.error, OverflowError, ValueError):
            serialized = {}
        if not serialized or not 0 <= at_utc_ns < _ROS1_ENDS_NS:
            self.left_out += 1
            return
        for ros, content in serialized.items():
            if (topic, ros) not in self._connections:
                self._connections[topic, ros] = self._connect(topic, ros)
            (self._ros1 if ros == 1 else self._ros2).write(self._connections[topic, ros], at_utc_ns, content)
        self.counts[topic] = self.counts.get(topic, 0) + 1
        if len(self._ros1.chunks) > self._chunks + 1:
            # Drop the message offsets of written chunks, of which the writer needs only the counts.
            for chunk in self._ros1.chunks[self._chunks : -1]:
                chunk.connections = {number: range(len(places)) for number, places in chunk.connections.items()}  # type: ignore[misc]
            self._chunks = len(self._ros1.chunks) - 1

    def _connect(self, topic: RosTopic, ros: Ros) -> Any:
        if ros == 1:
            latching = 1 if topic.latched else None
            return self._ros1.add_connection(topic.name, topic.type, typestore=typestore(1), latching=latching)
        from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

        forever = QosTime(0, 0)
        quality = [
            Qos(
                history=QosHistory.KEEP_LAST,
                depth=1 if topic.latched else 10,
                reliability=QosReliability.RELIABLE,
                durability=QosDurability.TRANSIENT_LOCAL if topic.latched else QosDurability.VOLATILE,
                deadline=forever,
                lifespan=forever,
                liveliness=QosLiveliness.AUTOMATIC,
                liveliness_lease_duration=forever,
                avoid_ros_namespace_conventions=False,
            )
        ]
        return self._ros2.add_connection(topic.name, topic.type, typestore=typestore(2), offered_qos_profiles=quality)


# ROS 1 stamps have 32-bit seconds.
_ROS1_ENDS_NS = 2**32 * 1_000_000_000


def _serialized(topic: RosTopic, message: Message) -> dict[Ros, Any]:
    typed_for = {ros: typed(ros, topic.type, message) for ros in topic.ros}
    return {
        ros: typestore(1).serialize_ros1(made, topic.type) if ros == 1 else typestore(2).serialize_cdr(made, topic.type)
        for ros, made in typed_for.items()
    }


def _encodable(value: Any) -> Any:
    if isinstance(value, str):
        return value.encode("utf-8", "replace").decode("utf-8")
    if isinstance(value, dict):
        return {key: _encodable(item) for key, item in value.items()}
    return [_encodable(item) for item in value] if isinstance(value, (list, tuple)) else value


def _imported_velocity_type(session: Session) -> VelocityType:
    """Velocity type of the bag that the session was imported from; sessions of a robot have it in the profile."""
    topics = session.header.source.get("topics")
    stamped = any(
        isinstance(topic, dict)
        and topic.get("became") == BY_TYPE[CommandSent].name
        and str(topic.get("type")).endswith("/TwistStamped")
        for topic in (topics if isinstance(topics, list) else ())
    )
    return "TwistStamped" if stamped else "Twist"


def _interpolated(poses: deque[tuple[int, Pose2D]], at_ns: int) -> Pose2D:
    """Pose at a time: interpolated, or the nearest outside the range. At least one pose."""
    known = list(poses)
    index = bisect_left([stamp_ns for stamp_ns, _ in known], at_ns)
    if index == 0 or index == len(known):
        return known[min(index, len(known) - 1)][1]
    (before_ns, before), (after_ns, after) = known[index - 1], known[index]
    share = (at_ns - before_ns) / max(1, after_ns - before_ns)
    return Pose2D(
        before.x_m + share * (after.x_m - before.x_m),
        before.y_m + share * (after.y_m - before.y_m),
        before.heading_rad + share * math.remainder(after.heading_rad - before.heading_rad, 2.0 * math.pi),
    )


def _camera_transform(model: CameraModel, frame: str, *, at_ns: int) -> Message:
    """Transform of the optical frame (REP 103: z forward, x right, y down)."""
    x, y, z, w = model.optical_rotation()
    return {
        "header": encode_header(_PLAIN, stamp_ns=at_ns, frame_id=BASE),
        "child_frame_id": frame,
        "transform": {
            "translation": {"x": model.x_m, "y": model.y_m, "z": model.z_m},
            "rotation": {"x": x, "y": y, "z": z, "w": w},
        },
    }


def _upright(x_m: float, y_m: float, z_m: float) -> Message:
    pose = encode_pose(Pose2D(x_m, y_m, 0.0))
    pose["position"]["z"] = z_m
    return pose


def _ros_name(camera: str) -> str:
    """Part of a topic name: letters, digits and underscores, no leading digit."""
    plain = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in camera).strip("_")
    return plain if plain and not plain[0].isdigit() else f"camera_{plain}"
