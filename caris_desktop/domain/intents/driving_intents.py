"""Intents of manual driving, stops and the head."""

import math

from caris_desktop.domain.events import CommandSource
from caris_desktop.domain.intents.base_intents import Bounds, Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class Drive(Intent):
    """Hold to drive: each of -1..1 of the speed setting, all zero releases. Sent on each change only."""

    forward: float
    left: float
    turn: float
    source: CommandSource

    @property
    def reduces_motion(self) -> bool:
        return not (self.forward or self.left or self.turn)


@dataclass(frozen=True, slots=True)
class ReleaseDrive(Intent):
    """Release all controls: zero at once."""

    reason: str = ""

    @property
    def reduces_motion(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class SetSpeed(Intent):
    """Set the speed, 0.1..1 of the scenario's limits."""

    fraction: float


@dataclass(frozen=True, slots=True)
class Stop(Intent):
    """Halt motion and cancel goals, always."""

    @property
    def reduces_motion(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class EmergencyStop(Intent):
    """Latch the emergency stop."""

    @property
    def reduces_motion(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class ReleaseEmergencyStop(Intent):
    """Release the latched emergency stop."""


@dataclass(frozen=True, slots=True)
class SetGuard(Intent):
    """Turn the obstacle guard on or off; off lasts until link loss, a change of scenario, or turning it on."""

    on: bool

    @property
    def reduces_motion(self) -> bool:
        return self.on


@dataclass(frozen=True, slots=True)
class LookAt(Intent):
    """Point the head: pan left positive, tilt down positive."""

    pan_rad: float
    tilt_rad: float


@dataclass(frozen=True, slots=True)
class TurnHead(Intent):
    """Turn the head while a control is held: each of -1..1 of its speed, zero stops. Sent on each change only."""

    pan: float
    tilt: float

    @property
    def reduces_motion(self) -> bool:
        return not (self.pan or self.tilt)


@dataclass(frozen=True, slots=True)
class Nod(Intent):
    """Nod once: a brief yes while somebody speaks."""


_SHARE: Bounds = (-1.0, 1.0)

DRIVING: IntentTable = {
    Drive: IntentSpec(
        QT_TR_NOOP("Driving"), "driving", moves="base", needs_link=True, quiet=True,
        bounds={"forward": _SHARE, "left": _SHARE, "turn": _SHARE},
    ),
    ReleaseDrive: IntentSpec(QT_TR_NOOP("Releasing the drive controls"), in_replay=True),
    SetSpeed: IntentSpec(QT_TR_NOOP("Setting the speed"), "driving", bounds={"fraction": (0.0, 1.0)}),
    Stop: IntentSpec(QT_TR_NOOP("Stopping"), in_replay=True),
    EmergencyStop: IntentSpec(QT_TR_NOOP("Activating the emergency stop"), in_replay=True),
    ReleaseEmergencyStop: IntentSpec(QT_TR_NOOP("Releasing the emergency stop")),
    SetGuard: IntentSpec(QT_TR_NOOP("Turning off the obstacle guard"), "driving", needs_link=True),
    LookAt: IntentSpec(
        QT_TR_NOOP("Aiming the head"), "driving", moves="head", needs_link=True, proposable=True,
        bounds={"pan_rad": (-math.tau, math.tau), "tilt_rad": (-math.tau, math.tau)},
    ),
    TurnHead: IntentSpec(
        QT_TR_NOOP("Turning the head"), "driving", moves="head", needs_link=True, quiet=True,
        bounds={"pan": _SHARE, "tilt": _SHARE},
    ),
    Nod: IntentSpec(QT_TR_NOOP("Nodding"), "driving", moves="head", needs_link=True, proposable=True),
}  # fmt: skip
