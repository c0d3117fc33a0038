"""Intents to select a robot and use its controls."""

from caris_desktop.domain.control_definitions import ControlValue
from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class UseControl(Intent):
    """Use a Robot panel control; a button's value is True."""

    control: str
    value: ControlValue


@dataclass(frozen=True, slots=True)
class UseRobot(Intent):
    """Connect to another robot instead of the current one."""

    robot: str


@dataclass(frozen=True, slots=True)
class UseSimulatedRobot(Intent):
    """Connect to the simulated robot of this computer; start it if needed."""


ROBOT: IntentTable = {
    # Whether it moves the robot is decided for each control.
    UseControl: IntentSpec(QT_TR_NOOP("Using the control"), "robot_controls", needs_link=True, proposable=True),
    UseRobot: IntentSpec(QT_TR_NOOP("Connecting to another robot")),
    UseSimulatedRobot: IntentSpec(QT_TR_NOOP("Connecting to the simulated robot")),
}
