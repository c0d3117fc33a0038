"""What the wizard wants of the robot: the messages that the console sends to the link.

None of these is ever queued while the link is down: what cannot be sent now is refused and reported.
"""

from dataclasses import dataclass

from caris_desktop.domain.events import CommandSource
from caris_desktop.domain.geometry import Pose2D, Twist2D


@dataclass(frozen=True, slots=True)
class Drive:
    """Take or change the motion lease: ramp to ``target`` and hold it. Also renews the lease."""

    stamp_ns: int
    target: Twist2D
    source: CommandSource


@dataclass(frozen=True, slots=True)
class RenewLease:
    """Sent every 50 ms while a drive key is held; 150 ms without one ends the motion."""

    stamp_ns: int


@dataclass(frozen=True, slots=True)
class Release:
    """Nothing holds the lease any more: zero at once, repeated for 0.5 s, then silence."""

    stamp_ns: int
    reason: str = ""


@dataclass(frozen=True, slots=True)
class StopMotion:
    """Zero at once and cancel every navigation goal."""

    stamp_ns: int


@dataclass(frozen=True, slots=True)
class SetEmergencyStop:
    """Latch or clear the emergency stop. While latched nothing moves and goals are refused."""

    stamp_ns: int
    latched: bool


@dataclass(frozen=True, slots=True)
class GoTo:
    """Start a navigation goal; one that is under way is replaced."""

    stamp_ns: int
    goal_id: str
    target_in_map: Pose2D
    place: str | None = None


@dataclass(frozen=True, slots=True)
class CancelGoal:
    """Cancel the navigation goal, wherever it stands."""

    stamp_ns: int


@dataclass(frozen=True, slots=True)
class Say:
    """Speak through the robot's own voice."""

    stamp_ns: int
    utterance_id: str
    text: str


@dataclass(frozen=True, slots=True)
class Silence:
    """Stop the robot's own voice, where the robot offers that."""

    stamp_ns: int


@dataclass(frozen=True, slots=True)
class CloseLink:
    """Zero, cancel goals, close the socket and end the link process."""

    stamp_ns: int


RobotCommand = (
    Drive | RenewLease | Release | StopMotion | SetEmergencyStop | GoTo | CancelGoal | Say | Silence | CloseLink
)
