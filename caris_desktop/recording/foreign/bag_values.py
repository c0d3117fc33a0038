"""Mapping of a foreign bag's topics to streams, and conversion of their messages to domain values."""

import json
import logging
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import (
    CommandSent,
    GoalChanged,
    InitialPoseSet,
    LinkQuality,
    SessionEnded,
    SessionStarted,
    Speaker,
    UtteranceChanged,
)
from caris_desktop.domain.geometry import Pose2D, Pose3D, Twist2D, moved_by
from caris_desktop.domain.media_checks import PictureError, decoded
from caris_desktop.domain.schema import from_jsonable
from caris_desktop.domain.sensing import (
    AudioBlock,
    CameraLens,
    LaserScan,
    Odometry,
    PlannedPath,
    RobotPose,
    lidar_mounting,
)
from caris_desktop.domain.streams import BY_NAME
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.recording.foreign.bag_files import BagChannel
from caris_desktop.recording.session.session_header import SessionHeader
from caris_desktop.ros import message_conversion
from caris_desktop.ros.dialect import plain_name
from caris_desktop.ros.message_conversion import MOST_PIXELS, decode_image
from caris_desktop.ros.message_fields import Message, MessageError, frame_of

_log = logging.getLogger(__name__)
MAP_FRAME, BASE_FRAMES = "map", ("base_link", "base_footprint")
SESSION_TOPIC, VALUE_TOPICS = "/caris/session", "/caris/"
_MAX_FRAMES, _MAX_DEPTH = 2000, 50
_TF_POSE_EVERY_NS = 50_000_000
# A value from our own export belongs to its log time; values of another clock must not be mixed in.
_SAME_SESSION_NS = 24 * 3600 * 1_000_000_000
_IMAGE_WORDS = (
    "image", "image_raw", "image_color", "image_rect", "image_rect_color", "image_mono", "compressed", "theora",
    "foxglove", "camera_info",
)  # fmt: skip
# A depth camera has colour images, too: /depth_camera/image_raw.
_DEPTH = re.compile(r"(?:^|[/_])depth(?!_cam)(?:$|[/_])")
_SPEECH_WORDS = ("speech", "speak", "say", "tts", "utter", "transcript", "voice", "asr", "stt", "heard", "recogni")
_HEARD_WORDS = ("asr", "stt", "transcript", "recogni", "heard", "participant", "speech_to_text")


class BagPicture(Value):
    """One camera image. ``image_bgr`` is uint8, shape (height, width, 3)."""

    camera: str
    robot_stamp_ns: int | None
    image_bgr: NDArray[np.uint8]


class TopicRole(Value):
    """Use of a channel. ``stream`` is its stream, or frames; ``camera`` if it belongs to one."""

    stream: str
    kind: str
    camera: str = ""


class TopicMapping(Value):
    """Role per channel, and reasons for the unused ones."""

    roles: dict[BagChannel, TopicRole]
    reasons: dict[BagChannel, str]

    def use_only(self, best: BagChannel, channels: Iterable[BagChannel], reason: str) -> None:
        """Use ``best``, and none of the other ``channels`` for this ``reason``."""
        for channel in channels:
            if channel is not best:
                del self.roles[channel]
                self.reasons[channel] = reason


def has_mountings(channel: BagChannel) -> bool:
    """True if the channel's transforms hold for the whole bag."""
    return plain_name(channel.type) in ("tf2_msgs/TFMessage", "tf/tfMessage") and channel.topic.endswith("static")


def map_bag_topics(
    counts: Mapping[BagChannel, int], unreadable: Mapping[BagChannel, str], *, from_caris: bool
) -> TopicMapping:
    """Choose the channel for each stream.

    ``counts`` are messages per channel; ``unreadable`` gives reasons why channels cannot be read; ``from_caris``:
    exported by this program.
    """
    casting = TopicMapping({}, {})
    wishes: dict[TopicRole, list[BagChannel]] = {}
    streams_as_json = {
        channel.topic.removeprefix(VALUE_TOPICS)
        for channel in counts
        if from_caris and channel.topic.startswith(VALUE_TOPICS)
    }
    for channel in counts:
        wish = _own_role(channel) if from_caris and channel.topic.startswith(VALUE_TOPICS) else _role(channel)
        if isinstance(wish, str):
            casting.reasons[channel] = wish
        elif channel in unreadable:
            casting.reasons[channel] = unreadable[channel]
        elif wish.kind != "value" and wish.stream in streams_as_json:
            casting.reasons[channel] = f"the same data is in {VALUE_TOPICS}{wish.stream}"
        elif from_caris and wish.kind in ("tf", "utterance") and channel.topic != "/tf_static":
            casting.reasons[channel] = "the same data is in other topics"
        else:
            wishes.setdefault(wish, []).append(channel)
    for role, channels in wishes.items():
        several = role.kind in ("tf", "utterance", "initial_pose", "goal", "value")
        casting.roles.update(dict.fromkeys(channels, role))
        if not several:
            best = min(channels, key=lambda item: _preference(role, item, counts[item]))
            casting.use_only(best, channels, f"{best.topic} is used for {role.stream}")
    _merge_poses(casting, counts)
    _merge_cameras(casting, counts)
    return casting


def _role(channel: BagChannel) -> TopicRole | str:
    """Possible role of a channel, or the reason why it has none."""
    topic, words = channel.topic.lower(), re.split(r"[/_]+", channel.topic.lower())
    match plain_name(channel.type):
        case "sensor_msgs/LaserScan":
            return TopicRole("scan", "scan")
        case "nav_msgs/Odometry":
            return TopicRole("odometry", "odometry")
        case "nav_msgs/OccupancyGrid":
            return "it is a costmap, not the map" if "costmap" in topic else TopicRole("map", "map")
        case "nav_msgs/Path":
            return TopicRole("path", "path")
        case "sensor_msgs/BatteryState":
            return TopicRole("battery", "battery")
        case "geometry_msgs/PoseWithCovarianceStamped":
            if "initialpose" in topic.replace("_", ""):
                return TopicRole("event/initial_pose_set", "initial_pose")
            return TopicRole("pose", "pose_with_covariance")
        case "geometry_msgs/PoseStamped":
            return TopicRole("event/goal_changed", "goal") if "goal" in words else TopicRole("pose", "pose")
        case "tf2_msgs/TFMessage" | "tf/tfMessage":
            return TopicRole("frames of reference", "tf")
        case "geometry_msgs/Twist" | "geometry_msgs/TwistStamped" as name:
            if "cmd_vel" not in topic and "cmdvel" not in topic:
                return "its name does not indicate that these velocities drive the robot"
            return TopicRole("event/command_sent", "twist" if name.endswith("Twist") else "twist_stamped")
        case "sensor_msgs/CompressedImage" | "sensor_msgs/Image" as name:
            if _DEPTH.search(topic):
                return "it is a depth image"
            kind = "image" if name.endswith("/Image") else "compressed_image"
            return TopicRole("frame", kind, camera_name(channel.topic))
        case "foxglove_msgs/CompressedVideo":
            return TopicRole("frame", "compressed_video", camera_name(channel.topic))
        case "sensor_msgs/CameraInfo":
            return TopicRole("lens", "camera_info", camera_name(channel.topic))
        case "std_msgs/String":
            if any(word in topic for word in _SPEECH_WORDS):
                return TopicRole("event/utterance_changed", "utterance")
            return "its name does not indicate that these texts are speech"
        case name:
            return f"{name or 'its type'} has no equivalent in this program"


def _own_role(channel: BagChannel) -> TopicRole | str:
    name = channel.topic.removeprefix(VALUE_TOPICS)
    if channel.topic == SESSION_TOPIC:
        return TopicRole("session.json", "session")
    spec = BY_NAME.get(name)
    if spec is None:
        return "a stream that is unknown to this version"
    if spec.value_type in (SessionStarted, SessionEnded):
        return "the import has its own start and end"
    if spec.value_type is AudioBlock:
        return "its audio is not in the bag"
    return TopicRole(name, "value", name)


_PREFERRED = {
    "scan": ("scan", "base_scan", "scan_filtered"),
    "odometry": ("odom", "odometry"),
    "map": ("map",),
    "path": ("plan", "global_plan", "path"),
    "battery": ("battery_state", "battery"),
    "pose": ("amcl_pose", "robot_pose", "pose"),
    "event/command_sent": ("cmd_vel",),
}


def _preference(role: TopicRole, channel: BagChannel, messages_of_it: int) -> tuple[int, int, int, str]:
    """Sort key, smaller is better: by last name part, number of messages, and depth."""
    parts = channel.topic.strip("/").split("/")
    preferred = _PREFERRED.get(role.stream, ())
    rank = preferred.index(parts[-1]) if parts[-1] in preferred else len(preferred)
    return rank, -messages_of_it, len(parts), channel.topic


def _merge_poses(casting: TopicMapping, counts: Mapping[BagChannel, int]) -> None:
    """Keep one topic for the pose, whatever its types; likewise for the velocity."""
    for stream in ("pose", "event/command_sent"):
        channels = [
            channel for channel, role in casting.roles.items() if role.stream == stream and role.kind != "value"
        ]
        if len(channels) < 2:
            continue
        best = min(channels, key=lambda item: _preference(casting.roles[item], item, counts[item]))
        casting.use_only(best, channels, f"{best.topic} is used for {stream}")


def _merge_cameras(casting: TopicMapping, counts: Mapping[BagChannel, int]) -> None:
    """Of a camera with raw and compressed topics, keep the one with more images."""
    cameras: dict[str, list[BagChannel]] = {}
    for channel, role in casting.roles.items():
        if role.kind in ("image", "compressed_image", "compressed_video"):
            cameras.setdefault(role.camera, []).append(channel)
    for channels in cameras.values():
        best = max(channels, key=lambda item: (counts[item], item.type))
        casting.use_only(best, channels, f"the same images are in {best.topic}")


def camera_name(topic: str) -> str:
    """Camera name: ``front`` of ``/camera/front/image/compressed``, ``rgb`` of ``/camera/rgb/image_raw``."""
    parts = [part for part in topic.strip("/").split("/") if part and part not in _IMAGE_WORDS]
    if len(parts) > 1 and parts[0] == "camera":
        parts = parts[1:]
    return "-".join(parts) or "camera"


@dataclass(slots=True)
class FrameTree:
    """Tree of reference frames: parent and newest transform of each."""

    parents: dict[str, tuple[str, Pose3D]] = field(default_factory=dict)

    def put(self, transform: message_conversion.Transform) -> None:
        if len(self.parents) < _MAX_FRAMES or transform.child_frame in self.parents:
            pose = transform.parent_from_child
            pose = pose if isinstance(pose, Pose3D) else Pose3D.on_floor(pose)
            self.parents[transform.child_frame] = (transform.parent_frame, pose)

    def chain(self, frame: str) -> list[str]:
        """``frame`` and all its ancestors."""
        names = [frame]
        while names[-1] in self.parents and len(names) < _MAX_DEPTH:
            names.append(self.parents[names[-1]][0])
        return names

    def pose_in(self, above: str, frame: str) -> Pose3D | None:
        """Pose of ``frame`` in its ancestor ``above``; None if it is not an ancestor."""
        names = self.chain(frame)
        if above not in names:
            return None
        pose = Pose3D.on_floor(Pose2D(0.0, 0.0, 0.0))
        for name in names[: names.index(above)]:
            pose = self.parents[name][1] @ pose
        return pose

    def base(self, frame: str | None = None) -> str | None:
        """The robot's base frame; of two, the ancestor of ``frame``."""
        candidates = [name for name in BASE_FRAMES if frame is None or name in self.chain(frame)]
        return next((name for name in candidates if name in self.parents or frame is not None), None)


class MessageConverter:
    """Converts messages to domain values in sequence. ``stamp_ns`` is bag time as session time."""

    def __init__(self, roles: Iterable[TopicRole], origin: SessionHeader | None) -> None:
        self._origin = origin
        self._tree = FrameTree()
        self._pose_from_tf = not any(role.stream == "pose" for role in roles)
        self._tf_pose_ns = -_TF_POSE_EVERY_NS
        self._moving: set[str] = set()
        self._commands = self._goals = self._utterances = 0
        self._lenses: dict[str, CameraModel] = {}
        self._decoders: dict[str, Any] = {}
        self.lasers_without_place: set[str] = set()
        self.tilted_lasers: dict[str, float] = {}
        self.unusable_transforms: set[str] = set()
        self.odometry_without_pose = 0
        self._odometry: Odometry | None = None

    def take_mounts(self, message: Message) -> None:
        """Add static transforms, which also hold before the bag's message. Raises MessageError."""
        for transform in message_conversion.decode_tf_message(message, unusable=self._note_unusable):
            self._tree.put(transform)

    def _note_unusable(self, parent: str, child: str, _reason: str) -> None:
        self.unusable_transforms.add(f"{parent} to {child}")

    def make(self, role: TopicRole, message: Message, stamp_ns: int, channel: BagChannel) -> Iterator[Any]:
        """Domain values and images of a message. Raises MessageError if it is unusable."""
        decode = message_conversion
        match role.kind:
            case "image":
                raw = decode_image(message)
                yield BagPicture(role.camera, raw.robot_stamp_ns, raw.image_bgr)
            case "compressed_image":
                image = decode.decode_compressed_image(message)
                yield BagPicture(role.camera, image.robot_stamp_ns, _decoded_image(image.content))
            case "compressed_video":
                yield from self._video_frames(role.camera, message)
            case "camera_info":
                yield from self._lens(role.camera, message, stamp_ns)
            case "value":
                yield from self._own_value(role.camera, message, stamp_ns)
            case "scan":
                yield self._scan(message, stamp_ns)
            case "odometry":
                yield self._take_odometry(message, stamp_ns)
            case "map":
                yield decode.decode_occupancy_grid(message, stamp_ns=stamp_ns)
            case "path":
                path = message_conversion.decode_path(message)
                points, place = path.points_m, self._place_of(path.frame_id)
                if place.heading_rad or place.x_m or place.y_m:
                    cos, sin = np.cos(place.heading_rad), np.sin(place.heading_rad)
                    points = (points @ np.array([[cos, sin], [-sin, cos]]) + (place.x_m, place.y_m)).astype(np.float32)
                yield PlannedPath(stamp_ns, path.robot_stamp_ns, points)
            case "battery":
                yield decode.decode_battery_state(message, stamp_ns=stamp_ns)
            case "pose":
                yield self._in_map(message, decode.decode_pose_stamped(message, stamp_ns=stamp_ns))
            case "pose_with_covariance":
                yield self._in_map(message, decode.decode_pose_with_covariance_stamped(message, stamp_ns=stamp_ns))
            case "initial_pose":
                pose = self._in_map(message, decode.decode_pose_with_covariance_stamped(message, stamp_ns=stamp_ns))
                yield InitialPoseSet(stamp_ns, pose.pose_in_map)
            case "goal":
                target = self._in_map(message, decode.decode_pose_stamped(message, stamp_ns=stamp_ns), "PoseStamped")
                self._goals += 1
                yield GoalChanged(stamp_ns, f"bag-{self._goals}", "requested", target.pose_in_map)
            case "tf":
                yield from self._transforms(message, stamp_ns, channel)
            case "twist" | "twist_stamped" as kind:
                twist = decode.decode_twist(message) if kind == "twist" else decode.decode_twist_stamped(message)[0]
                self._commands += 1
                yield CommandSent(stamp_ns, self._commands, twist, "none")
            case "utterance":
                yield from self._utterance(message, stamp_ns, channel)

    def _scan(self, message: Message, at_ns: int) -> LaserScan:
        scan = message_conversion.decode_laser_scan(message, stamp_ns=at_ns)
        frame = scan.frame_id.lstrip("/")
        base = self._tree.base(frame)
        place = None if base is None else self._tree.pose_in(base, frame)
        if place is None:
            self.lasers_without_place.add(frame)
            return scan
        self.lasers_without_place.discard(frame)
        mounting = lidar_mounting(place)
        if mounting == "tilted":
            self.tilted_lasers[frame] = place.tilt_rad
            return scan
        self.tilted_lasers.pop(frame, None)
        return scan.mounted(place.floor, upside_down=mounting == "upside_down")

    def _take_odometry(self, message: Message, at_ns: int) -> Odometry:
        def reckoned(twist: Twist2D) -> Pose2D:
            """Carried on with its speed, as it is live."""
            self.odometry_without_pose += 1
            if self._odometry is None:
                return Pose2D(0.0, 0.0, 0.0)
            elapsed_s = min(max((at_ns - self._odometry.stamp_ns) / 1e9, 0.0), 1.0)
            return self._odometry.pose_in_odom @ moved_by(twist, elapsed_s)

        self._odometry = message_conversion.decode_odometry(message, stamp_ns=at_ns, pose_of=reckoned)
        return self._odometry

    def _in_map(self, message: Message, pose: RobotPose, what: str = "Pose") -> RobotPose:
        place = self._place_of(frame_of(message, what).lstrip("/"))
        return replace(pose, pose_in_map=place @ pose.pose_in_map)

    def _transforms(self, message: Message, at_ns: int, channel: BagChannel) -> Iterator[RobotPose]:
        transforms = message_conversion.decode_tf_message(message, unusable=self._note_unusable)
        for transform in transforms:
            self._tree.put(transform)
        base = self._tree.base()
        if not self._pose_from_tf or base is None or channel.topic.endswith("static"):
            return
        self._moving.update(transform.child_frame for transform in transforms)
        # The joint nearest to the robot moves most often; those above only correct it.
        joint = next((frame for frame in self._tree.chain(base) if frame in self._moving), None)
        moved = [transform for transform in transforms if transform.child_frame == joint]
        if moved and at_ns - self._tf_pose_ns >= _TF_POSE_EVERY_NS:
            pose = self._tree.pose_in(MAP_FRAME, base)
            if pose is not None:
                self._tf_pose_ns = at_ns
                yield RobotPose(at_ns, moved[-1].robot_stamp_ns, pose.floor)

    def _lens(self, camera: str, message: Message, at_ns: int) -> Iterator[CameraLens]:
        decoded_info = message_conversion.decode_camera_info(message)
        if decoded_info is None:
            return
        model, robot_stamp_ns = decoded_info
        if self._lenses.get(camera) != model:
            self._lenses[camera] = model
            yield CameraLens(at_ns, robot_stamp_ns, camera, model)

    def _utterance(self, message: Message, at_ns: int, channel: BagChannel) -> Iterator[UtteranceChanged]:
        sentence = message_conversion.decode_string(message).strip()
        if not sentence:
            return
        self._utterances += 1
        from_participant = any(word in channel.topic.lower() for word in _HEARD_WORDS)
        speaker: Speaker = "participant" if from_participant else "robot"
        # Bags have no start and end of speech: only a time at which it was heard.
        yield UtteranceChanged(
            at_ns, f"bag-{self._utterances}", speaker, sentence, "heard", "finished", detail=f"from {channel.topic}"
        )

    def _video_frames(self, camera: str, message: Message) -> Iterator[BagPicture]:
        """Decode a video packet, given all previous ones. One decoder per camera."""
        import av

        video = message_conversion.decode_compressed_image({**message, "header": {"stamp": message.get("timestamp")}})
        if video.encoding != "h264":
            raise MessageError(f"video with the unsupported encoding '{video.encoding}'")
        if camera not in self._decoders:
            decoder = self._decoders[camera] = av.CodecContext.create("h264", "r")
            decoder.options = {"max_pixels": str(MOST_PIXELS)}
            # Show a frame by its own packet, without delay.
            decoder.flags |= av.codec.context.Flags.low_delay
            decoder.thread_type = "NONE"
        try:
            frames = self._decoders[camera].decode(av.Packet(video.content))
        except av.error.FFmpegError as error:
            raise MessageError(f"video that cannot be decoded ({error})") from error
        for frame in frames:
            yield BagPicture(camera, video.robot_stamp_ns, frame.to_ndarray(format="bgr24"))

    def _own_value(self, stream: str, message: Message, at_ns: int) -> Iterator[Any]:
        try:
            value = from_jsonable(BY_NAME[stream].value_type, json.loads(message_conversion.decode_string(message)))
        except (ValueError, RecursionError) as error:
            raise MessageError(f"not a value of {stream}: {error}") from error
        if not isinstance(value.stamp_ns, int) or abs(value.stamp_ns - at_ns) > _SAME_SESSION_NS:
            raise MessageError(f"a value of {stream} from another time")
        if isinstance(value, LinkQuality) and value.clock_offset_ms is not None and self._origin is not None:
            # The export mapped the robot's stamps to UTC, which is their clock from here on.
            utc_minus_session_ns = self._origin.clock.utc_ns - self._origin.clock.monotonic_ns
            value = replace(value, clock_offset_ms=utc_minus_session_ns / 1e6)
        yield value

    def _place_of(self, frame: str) -> Pose2D:
        """Pose of a reference frame in the map. Raises MessageError if unknown."""
        if frame in ("", MAP_FRAME):
            return Pose2D(0.0, 0.0, 0.0)
        place = self._tree.pose_in(MAP_FRAME, frame)
        if place is None:
            raise MessageError(f"it is in the frame '{frame}', and the pose of this frame in the map is unknown")
        return place.floor


def _decoded_image(content: bytes) -> NDArray[np.uint8]:
    try:
        return np.asarray(decoded(content), np.uint8)
    except PictureError as error:
        raise MessageError(f"an image that {error}") from error
