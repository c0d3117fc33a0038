"""Commands to the robot: messages from the console to the link process.

None is queued while the link is down: what cannot be sent now is refused and reported. ``actor`` requested it; the
events that report the outcome carry it as well. This computer's voice gets the same commands as the robot's.
"""

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.control_definitions import ControlValue, RobotControl
from caris_desktop.domain.events import (
    CommandSource,
    MapOperation,
    UtteranceChanged,
    UtteranceOrigin,
    UtteranceState,
    VoiceOutput,
)
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.value_class import Value


class RobotCommand(Value, eq=False):
    """Base class of commands."""

    stamp_ns: int


class Drive(RobotCommand):
    """Take or change the motion lease: ramp to ``target`` and hold it. Also renews the lease.

    ``drive_id`` counts the drives of the console: a drive after a release is a new one.
    """

    target: Twist2D
    source: CommandSource
    actor: Actor = ""
    drive_id: int = 0


class RenewLease(RobotCommand):
    """Sent every 50 ms while a drive key is held; 150 ms without one ends the motion."""


class Release(RobotCommand):
    """Release the motion lease: zero at once, repeated for 0.5 s, then silence."""

    reason: str = ""
    actor: Actor = ""


class StopMotion(RobotCommand):
    """Zero at once, and cancel every navigation goal and every action of a control."""

    actor: Actor = ""


class SetEmergencyStop(RobotCommand):
    """Latch or clear the emergency stop. While latched nothing moves; goals and controls that move are refused."""

    latched: bool
    actor: Actor = ""


class GoTo(RobotCommand):
    """Start a navigation goal; it replaces one in progress."""

    goal_id: str
    target_in_map: Pose2D
    place: str | None = None
    actor: Actor = ""


class LimitGoals(RobotCommand):
    """Limit the speed to goals from now on, if the robot's navigation supports it."""

    forward_mps: float
    actor: Actor = ""


class CancelGoal(RobotCommand):
    """Cancel the navigation goal in any state."""

    actor: Actor = ""


class SetGuard(RobotCommand):
    """Turn the obstacle guard on, or off on the wizard's own responsibility. Each connection starts with it on."""

    on: bool
    actor: Actor = ""


class SetInitialPose(RobotCommand):
    """Set the pose for localization, with one standard deviation of position and heading."""

    pose_in_map: Pose2D
    spread_m: float = 0.5
    spread_rad: float = 0.26
    actor: Actor = ""


class RequestMap(RobotCommand):
    """Save or load a map by ``name``, or switch between mapping and localization (``name`` is then unused)."""

    request_id: str
    operation: MapOperation
    name: str = ""
    actor: Actor = ""


class MoveHead(RobotCommand):
    """Turn the head to these angles: pan left positive, tilt down positive. Newer ones replace older ones."""

    pan_rad: float
    tilt_rad: float
    actor: Actor = ""


class OfferControls(RobotCommand):
    """Add the scenario's controls to the profile's own, so that their readings are received.

    If it does not permit driving, no control moves the robot, the profile's own included.
    """

    controls: tuple[RobotControl, ...]
    driving_permitted: bool = True


class UseControl(RobotCommand):
    """Use a control of the profile or the scenario; a button's ``value`` is True."""

    request_id: str
    control: str
    value: ControlValue
    actor: Actor = ""


class Say(RobotCommand):
    """Speak ``text`` after the utterances requested before.

    ``recorded`` (empty: ``text`` itself), ``origin`` and ``person_id`` return in the reports: names are spoken, and
    never recorded. ``language``, if known, serves to estimate the duration.
    """

    utterance_id: str
    text: str
    actor: Actor = ""
    origin: UtteranceOrigin = "typed"
    person_id: str = ""
    recorded: str = ""
    language: str = ""

    def reported(
        self,
        stamp_ns: int,
        state: UtteranceState,
        voice: VoiceOutput,
        *,
        detail: str = "",
        actor: Actor | None = None,
        estimated: bool = False,
    ) -> UtteranceChanged:
        """Report of that voice on this utterance. ``actor`` caused it; None: the requester."""
        return UtteranceChanged(
            stamp_ns, self.utterance_id, "robot", self.recorded or self.text, self.origin, state,
            voice=voice, detail=detail, actor=self.actor if actor is None else actor, person_id=self.person_id,
            estimated=estimated,
        )  # fmt: skip


class Silence(RobotCommand):
    """Stop the present utterance and drop those after it; not all robots support that."""

    actor: Actor = ""


class ListenToRobot(RobotCommand):
    """Start or stop the sound of the robot's microphone. For the media link."""

    on: bool


class PlayOnRobot(RobotCommand, eq=False):
    """Sound for the robot's loudspeaker, now or not at all. For the media link.

    ``samples`` is int16, shape (samples, 1), at the rate that the profile gives.
    """

    samples: NDArray[np.int16]


class CloseLink(RobotCommand):
    """Zero, cancel goals, close the socket and end the link process."""
