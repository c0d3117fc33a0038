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
    """The robot link changed its state; ``detail`` says why, in words for the wizard."""

    stamp_ns: int
    link: str
    state: LinkState
    address: str
    detail: str = ""


@dataclass(frozen=True, slots=True)
class LinkQuality:
    """Measured by ping: round trip time, and robot clock minus session clock with its uncertainty."""

    stamp_ns: int
    round_trip_ms: float
    clock_offset_ms: float | None = None
    clock_uncertainty_ms: float | None = None


@dataclass(frozen=True, slots=True)
class CommandSent:
    """One velocity command that was handed to the socket, exactly as sent. ``actor`` held it, let go, or stopped."""

    stamp_ns: int
    sequence: int
    twist: Twist2D
    source: CommandSource
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class DriveEnded:
    """Direct driving ended by itself rather than by the wizard letting go, or as ``actor`` set a goal.

    ``drive_id`` is that of the drive that ended; 0 in recordings from before drives had one.
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
    """A navigation goal changed its state. ``actor`` set it, and where it is cancelled, cancelled it."""

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
    """What the robot's navigation keeps to on its way to goals; None: it drives as fast as it is set up to."""

    stamp_ns: int
    limit_mps: float | None
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class GuardChanged:
    """The obstacle guard limits motion differently from now on.

    ``absent``: the profile names no LIDAR; ``blind``: no fresh scan, so the speed is capped; ``overridden``: the
    wizard switched it off. ``distance_m`` is the free way between footprint and obstacle in the direction of motion.
    ``detail`` says in words why it is blind. ``actor`` is who switched it, else the console.
    """

    stamp_ns: int
    state: GuardState
    distance_m: float | None = None
    detail: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class MovementChanged:
    """The robot's odometry agrees differently with what this console commands from now on.

    ``unknown``: it has no odometry, or none has come yet; ``silent``: none comes any more; ``standing``; ``moving``, as
    commanded from here; ``not_following``: it does not do what is commanded; ``uncommanded``: it moves though nothing
    here tells it to; ``commanded_elsewhere``: somebody else sends it velocities. ``stopped``: under a stop or the
    emergency stop. ``publishers`` are the nodes that publish velocities, where the robot tells them.
    """

    stamp_ns: int
    state: MovementState
    stopped: bool = False
    publishers: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class InitialPoseSet:
    """The wizard told the localization where the robot is."""

    stamp_ns: int
    pose_in_map: Pose2D
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class MapRequestChanged:
    """A map was to be saved or loaded, or mapping to be switched. The same ``request_id`` returns with each state."""

    stamp_ns: int
    request_id: str
    operation: MapOperation
    name: str
    state: RequestState
    detail: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class MappingChanged:
    """Whether the robot builds its map (True) or only finds its place in it; None: it does not tell.

    Comes with each connection too, and says which operations the robot offers.
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
    """The wizard turned the head: where it was asked to look, pan left and tilt down positive."""

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
    """How one topic fared in the last second. ``age_ms`` is how old its newest message was on arrival by the robot's
    own stamp and the estimated clock offset; None where it carries no stamp. ``encoding`` is empty while nothing came.
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
    """The topics of one link, once a second. ``refused`` counts all messages that could not be used so far."""

    stamp_ns: int
    link: str
    encoding: Literal["cbor", "json", "both"]
    refused: int
    topics: tuple[TopicTraffic, ...]


@dataclass(frozen=True, slots=True)
class GamepadChanged:
    """A gamepad was plugged in or out; ``device`` is its hardware id."""

    stamp_ns: int
    device: str
    name: str
    connected: bool
