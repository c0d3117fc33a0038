"""Events of the robot and its link."""

from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.control_definitions import ControlValue
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.value_class import dataclass

LinkState = Literal["connecting", "connected", "trouble", "lost", "closed"]
CommandSource = Literal["keyboard", "gamepad", "onscreen", "rehearsal", "stop", "lease", "none"]
GoalState = Literal["requested", "active", "reached", "cancelled", "failed"]
GuardState = Literal["absent", "clear", "slowing", "blocked", "blind", "overridden"]
MovementState = Literal[
    "unknown", "silent", "standing", "moving", "not_following", "uncommanded", "commanded_elsewhere"
]
MapOperation = Literal["save", "load", "start_mapping", "start_localization"]
RequestState = Literal["requested", "succeeded", "failed"]


@dataclass(frozen=True, slots=True)
class LinkChanged:
    """The robot link changed state; ``detail`` gives the reason in words."""

    stamp_ns: int
    link: str
    state: LinkState
    address: str
    detail: str = ""


@dataclass(frozen=True, slots=True)
class LinkQuality:
    """Ping result: round trip time, and robot clock minus session clock with its uncertainty."""

    stamp_ns: int
    round_trip_ms: float
    clock_offset_ms: float | None = None
    clock_uncertainty_ms: float | None = None


@dataclass(frozen=True, slots=True)
class CommandSent:
    """One velocity command exactly as handed to the socket. ``actor`` held or released it, or stopped."""

    stamp_ns: int
    sequence: int
    twist: Twist2D
    source: CommandSource
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class DriveEnded:
    """Manual driving ended without a release by the wizard, or because ``actor`` set a goal.

    ``drive_id`` is the id of the drive that ended; 0 in recordings before drives had ids.
    """

    stamp_ns: int
    reason: str
    actor: Actor = ""
    drive_id: int = 0


@dataclass(frozen=True, slots=True)
class StopRequested:
    """The wizard pressed stop."""

    stamp_ns: int
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class EmergencyStopChanged:
    """The latched emergency stop was set or cleared. ``by`` is wizard or robot."""

    stamp_ns: int
    latched: bool
    by: Literal["wizard", "robot"]
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class GoalChanged:
    """A navigation goal changed state. ``actor`` set it, or cancelled it if it is cancelled."""

    stamp_ns: int
    goal_id: str
    state: GoalState
    target_in_map: Pose2D
    place: str | None = None
    distance_left_m: float | None = None
    detail: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class NavigationSpeedChanged:
    """Speed limit of the robot's navigation to goals; None: as configured on the robot."""

    stamp_ns: int
    limit_mps: float | None
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class GuardChanged:
    """The obstacle guard changed its limits on motion.

    ``absent``: the profile names no LIDAR. ``blind``: no fresh scan, so the speed is capped; ``detail`` gives the
    reason. ``overridden``: the wizard turned it off. ``distance_m`` is the clearance between footprint and obstacle in
    the direction of motion. ``actor`` turned it on or off, else the console.
    """

    stamp_ns: int
    state: GuardState
    distance_m: float | None = None
    detail: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class MovementChanged:
    """The agreement of the robot's odometry with this console's commands changed.

    ``unknown``: no odometry, or none yet. ``silent``: odometry no longer arrives. ``standing``: at rest. ``moving``: as
    commanded from here. ``not_following``: not as commanded. ``uncommanded``: moving without a command from here.
    ``commanded_elsewhere``: another source sends velocities. ``stopped``: under a stop or the emergency stop.
    ``publishers`` are the nodes that publish velocities, if the robot reports them.
    """

    stamp_ns: int
    state: MovementState
    stopped: bool = False
    publishers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class InitialPoseSet:
    """The wizard set the robot's pose for localization."""

    stamp_ns: int
    pose_in_map: Pose2D
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class MapRequestChanged:
    """State of a request to save or load a map, or switch mapping. ``request_id`` is the same in each state."""

    stamp_ns: int
    request_id: str
    operation: MapOperation
    name: str
    state: RequestState
    detail: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class MappingChanged:
    """Mapping state: the robot builds its map (True) or only localizes in it; None: not reported.

    Also sent with each connection; includes the operations that the robot offers.
    """

    stamp_ns: int
    mapping: bool | None
    can_save: bool = False
    can_load: bool = False
    can_switch: bool = False


@dataclass(frozen=True, slots=True)
class PlacesChanged:
    """A named place was added to the scenario, moved, or removed (``pose_in_map`` None)."""

    stamp_ns: int
    name: str
    pose_in_map: Pose2D | None
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class HeadMoved:
    """The wizard turned the head to these angles, pan left and tilt down positive."""

    stamp_ns: int
    pan_rad: float
    tilt_rad: float
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class ControlUsed:
    """A control of the Robot panel was used. The same ``request_id`` returns with each state."""

    stamp_ns: int
    request_id: str
    control: str
    value: ControlValue
    state: RequestState
    detail: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class TopicTraffic:
    """Traffic of one topic in the last second. ``age_ms`` is the age of its newest message on arrival, from the robot's
    timestamp and the estimated clock offset; None without a timestamp. ``encoding`` is empty before the first message.
    """

    topic: str
    type: str
    rate_hz: float
    bytes_per_s: float
    last_heard_s: float | None
    age_ms: float | None
    refused: int
    encoding: Literal["", "cbor", "json"] = ""


@dataclass(frozen=True, slots=True)
class TrafficMeasured:
    """The topics of one link, once a second. ``refused`` counts all unusable messages so far."""

    stamp_ns: int
    link: str
    encoding: Literal["cbor", "json", "both"]
    refused: int
    topics: tuple[TopicTraffic, ...]


@dataclass(frozen=True, slots=True)
class GamepadChanged:
    """A gamepad was connected or removed; ``device`` is its hardware id."""

    stamp_ns: int
    device: str
    name: str
    connected: bool
