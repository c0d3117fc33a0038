"""Classification of controls by their effect on the robot, from names, types and values; a file's own claim never
counts.

Names come from the profile (the robot's own interfaces) and from common ones of ROS, Nav2, MoveIt and robot drivers.
"""

import re
from collections.abc import Mapping
from typing import Any, Literal

from caris_desktop.domain.value_class import Value

ControlClass = Literal["stop", "stop_release", "motion", "unknown", "harmless"]
"""``stop`` always passes. ``stop_release`` never does: only the wizard's own release of the emergency stop may.
``motion`` needs the permission to drive. A latched stop blocks ``motion`` and ``unknown``; ``harmless`` is a lamp, a
sound, a display or similar."""


class StopField(Value):
    """A topic or service of the robot's emergency stop: ``field`` at ``stops`` stops it, any other value releases it.
    Without a field everything that is sent there stops the robot.
    """

    name: str
    field: str = ""
    stops: bool = True


class RobotInterfaceNames(Value):
    """The topics, services and actions of one robot that move it, stop it, and release its stop."""

    motion: tuple[str, ...] = ()
    stop: tuple[StopField, ...] = ()
    stop_release: tuple[str, ...] = ()


def _words_of(text: str) -> frozenset[str]:
    return frozenset(text.split())


NO_NAMES = RobotInterfaceNames()
"""Names for an unknown robot: only what ROS uses everywhere counts."""
_MOTION_PACKAGES = _words_of(
    "ackermann_msgs control_msgs controller_manager_msgs dynamic_reconfigure geometry_msgs joy mavros_msgs "
    "move_base_msgs moveit_msgs nav2_msgs nav_msgs play_motion_msgs play_motion2_msgs rcl_interfaces "
    "trajectory_msgs"
)
_MOTION_TYPES = _words_of(
    # Types whose words alone are inconclusive: parameters (also the base's), joysticks, generic joint commands.
    "BackUp ChangeState DriveOnHeading Joy JointState MuxSelect Reconfigure SetParam "
    "SetParameters SetParametersAtomically SpeedLimit Spin SwitchController"
)
_MOTION_WORDS = _words_of(
    "accelerate ackermann actuator animated animation arm arms base behavior behaviour bow clap dance dock docking "
    "drive driving elevator finger fingers flipper flippers follow follower following gait gaze gesture gestures goal "
    "goals grasp grip gripper hand hands head initialpose jaw joint joints joy joystick leg legs lift look motion "
    "motions motor motors move movement mover moves mux nav navigate navigation navigator neck nod pan park path pick "
    "place planner pose poses position posture rotate rotation route rpm servo servos setpoint sit spin stand steer "
    "steering swerve takeoff teleop throttle thruster thrusters tilt torque torso track tracker tracking trajectory "
    "turn twist undock vel velocity waist wake wakeup walk wave waypoint waypoints wheel wheels wrist"
)
_HARMLESS_WORDS = _words_of(
    "audio battery beep blink brightness bulb buzzer caption captions chime color colour display emoji emotion "
    "expression eye eyes face hmi horn image lamp lamps language led leds light lightring lights loudspeaker "
    "melody mood music photo picture play_sound projector rgb say screen sound sounds speak speaker speech "
    "subtitle subtitles tablet text tts utterance voice volume"
)
# A number on one of these says how much. On another, such as an eye or a face, it may say where to.
_AMOUNT_WORDS = _words_of(
    "audio beep brightness bulb buzzer chime color colour lamp lamps led leds light lightring lights loudspeaker "
    "melody music projector rgb screen sound sounds speaker volume"
)
_NUMBER_TYPES = _words_of("Float32 Float64 Int8 Int16 Int32 Int64 UInt8 UInt16 UInt32 UInt64")
# A topic with words of commands or co-motion is no loudspeaker.
_NOT_HARMLESS_WORDS = _words_of("command commands enable script tracker recognised recognized recognition")
_PLAIN_TYPES = _words_of(
    "Bool ColorRGBA Empty Float32 Float64 Int8 Int16 Int32 Int64 SetBool String Trigger UInt8 UInt16 UInt32 UInt64"
)
_STOP_ENDINGS = _words_of(
    "abort cancel e_stop emergency_stop estop halt quick_stop soft_stop stop stop_all stop_base stop_motion "
    "stop_motors stop_robot"
)
_STOP_TYPES = _words_of("Bool CancelGoal EStop Empty GoalID SetBool Trigger")
_STOP_WORDS = _words_of("bumper brake brakes emergency estop halt protective runstop safety stop")
_RELEASE_WORDS = _words_of(
    "clear continue deactivate disable disengage off override recover release reset restart resume unlatch unlock "
    "unstop"
)
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


def control_class(
    name: str, type_name: str, message: Mapping[str, Any], robot: RobotInterfaceNames = NO_NAMES
) -> ControlClass:
    """Class of sending ``message`` of this type to the topic, service or action of this name."""
    name = _plain(name)
    for field in robot.stop:
        if name == _plain(field.name):
            stops = not field.field or message.get(field.field, not field.stops) is field.stops
            return "stop" if stops else "stop_release"
    if name in map(_plain, robot.stop_release):
        return "stop_release"
    base = _package_and_base(type_name)[1]
    named, typed = _words(name), _words(base)
    if named & _STOP_WORDS or base == "EStop":
        flags = [value for value in message.values() if isinstance(value, (bool, str))]
        flagged = base in ("Bool", "SetBool", "EStop")
        if named & _RELEASE_WORDS or (flagged and flags != [True] and not named & _HARMLESS_WORDS):
            return "stop_release"
    if name.rpartition("/")[2] in _STOP_ENDINGS and base in _STOP_TYPES:
        return "stop"
    if _is_own_motion(name, robot) or _has_motion_type(type_name) or (named | typed) & _MOTION_WORDS:
        return "motion"
    plain = base in _PLAIN_TYPES or bool(typed & _HARMLESS_WORDS)
    known = _AMOUNT_WORDS if base in _NUMBER_TYPES else _HARMLESS_WORDS
    if plain and (named | typed) & known and not (named | typed) & (_NOT_HARMLESS_WORDS | _STOP_WORDS):
        return "harmless"
    return "unknown"


def moves_or_releases(name: str, type_name: str, robot: RobotInterfaceNames) -> bool:
    """Whether speech, which is no control, would move the robot or release its stop, by the robot's own names and the
    type.
    """
    name = _plain(name)
    if name in map(_plain, (*robot.stop_release, *(field.name for field in robot.stop if field.field))):
        return True
    return _is_own_motion(name, robot) or _has_motion_type(type_name)


def _is_own_motion(name: str, robot: RobotInterfaceNames) -> bool:
    return any(name == motion_name or name.startswith(f"{motion_name}/") for motion_name in map(_plain, robot.motion))


def _has_motion_type(type_name: str) -> bool:
    package, base = _package_and_base(type_name)
    # Arrays of numbers command joints and motors.
    return package in _MOTION_PACKAGES or base in _MOTION_TYPES or base.endswith("MultiArray")


def _package_and_base(type_name: str) -> tuple[str, str]:
    package, _, base = re.sub("/(msg|srv|action)/", "/", type_name).rpartition("/")
    return package, base


def _plain(name: str) -> str:
    return name.strip("/")


def _words(name: str) -> set[str]:
    """Words of a ROS name or type: ``head_controller/Look`` has head, controller and look."""
    parts = re.split(r"[/_\-]+", name)
    words = {word.lower().rstrip("0123456789") for part in parts for word in _CAMEL.split(part)}
    # Also written as one word.
    return words | {"move" for part in parts if re.search(r"cmd_?vel|move_?(base|it)", part, re.IGNORECASE)}
