"""Robot models of the simulated robot: interface names, types and frames, from ``resources/simulator/robots.yaml``."""

from dataclasses import replace
from functools import lru_cache
from typing import Literal

from caris_desktop.domain.value_class import Value
from caris_desktop.ros.dialect import Dialect
from caris_desktop.simulator.robot_simulation import Body
from caris_desktop.simulator.shipped_data import built, shipped_data
from caris_desktop.simulator.simulated_base import HOLONOMIC


class VelocityInput(Value):
    """Topic that moves the base. ``either``: TwistStamped is accepted as well, on a topic of type Twist."""

    topic: str
    type: Literal["Twist", "TwistStamped", "either"] = "Twist"


class BatteryTopic(Value):
    """Battery state: sensor_msgs/BatteryState of 0..1 or of 0..100, or std_msgs/Float32 of 0..100."""

    topic: str
    kind: Literal["BatteryState", "BatteryState percent", "Float32 percent"] = "BatteryState"


class CameraTopics(Value):
    """Camera: sensor_msgs/CompressedImage on ``image``, sensor_msgs/CameraInfo on ``info``."""

    image: str
    info: str
    frame: str


class HeadTopics(Value):
    """Head, moved by trajectory_msgs/JointTrajectory or naoqi_bridge_msgs/JointAnglesWithSpeed on ``topic``.

    ``tilt_sign`` is -1 where the joint's positive direction is up.
    """

    kind: Literal["JointTrajectory", "JointAnglesWithSpeed"]
    topic: str
    pan_joint: str
    tilt_joint: str
    tilt_sign: Literal[1, -1] = 1
    frames: tuple[str, str] = ("head_1_link", "head_2_link")


class SpeechTopics(Value):
    """Speech by std_msgs/String on ``topic``. ``speaking`` is Bool, ``stop`` is Empty."""

    topic: str
    speaking: str | None = None
    stop: str | None = None


class SpeechAction(Value):
    """Speech by PAL's text-to-speech action (pal_interaction_msgs/TtsAction)."""

    name: str


class AudioTopics(Value):
    """audio_common_msgs/AudioData of microphone and loudspeaker."""

    microphone: str
    speaker: str


class Navigation(Value):
    """Navigation: an action named ``name`` (None: only the simple goal topic), and the path topic.

    ``speed_limit`` is a topic of nav2_msgs/SpeedLimit, ``planner`` the node of a local planner whose
    dynamic_reconfigure sets its speed.
    """

    name: str | None
    simple_goal: str
    path: str | None = None
    speed_limit: str | None = None
    planner: str | None = None


class StopService(Value):
    """Service that cuts and restores motor power: ``field`` of the request is ``stopping`` to stop."""

    name: str
    package: str
    type: str
    field: str
    stopping: bool = True


class StubCapability(Value):
    """Further capability of the robot, which the simulation only records."""

    kind: Literal["topic", "service", "action"]
    name: str
    package: str
    type: str


class RobotInterface(Value):
    """Complete interface. Names without a leading slash are in the robot's namespace."""

    name: str
    dialect: Dialect
    body: Body
    velocity: tuple[VelocityInput, ...]
    odometry: str
    tf: str
    tf_static: str
    camera: CameraTopics | None = None
    map_frame: str = "map"
    odom_frame: str = "odom"
    base_frame: str = "base_link"
    odometry_frame: str = "base_link"
    same_as_base: tuple[str, ...] = ()
    namespace: str = ""
    scan: str | None = None
    pose: str | None = None
    map: str | None = None
    map_updates: str | None = None
    initial_pose: str | None = None
    battery: BatteryTopic | None = None
    joint_states: str | None = None
    head: HeadTopics | None = None
    speech: SpeechTopics | SpeechAction | None = None
    audio: AudioTopics | None = None
    navigation: Navigation | None = None
    stop_state: str | None = None
    stop_service: StopService | None = None
    slam_toolbox: str | None = None
    map_server: str | None = None
    map_saver: str | None = None
    demo_controls: bool = False
    stub_capabilities: tuple[StubCapability, ...] = ()

    def absolute(self, name: str) -> str:
        """Absolute name."""
        if name.startswith("/"):
            return name
        return f"/{self.namespace}/{name}" if self.namespace else f"/{name}"


DEFAULT = "generic"


class UnknownRobotModel(ValueError):  # noqa: N818 - the user asked for what is not there; nothing is broken
    """Unknown robot model, or not for this ROS; the text lists the available ones."""


@lru_cache
def _models() -> dict[str, dict[int, RobotInterface]]:
    """Models by name and ROS version."""
    models: dict[str, dict[int, RobotInterface]] = {}
    for data in shipped_data("robots.yaml"):
        models.setdefault(data["name"], {})[data["dialect"]] = built(RobotInterface, data)
    return models


def robot_model_named(
    name: str, ros: int | None = None, *, namespace: str | None = None, holonomic: bool = False
) -> RobotInterface:
    """Robot model by name, for ROS 1 or 2 if it exists for both.

    Parameters
    ----------
    namespace
        Put before the names that are relative; None takes what the robot usually has.
    holonomic
        Also for robots whose wheels do not allow it, to practise.

    Raises UnknownRobotModel otherwise.
    """
    cut = _models().get(name)
    if cut is None:
        available = ", ".join(robot_model_names())
        raise UnknownRobotModel(f"Unknown robot model '{name}'. Available models: {available}.")
    if ros is not None and ros not in cut:
        (only,) = cut
        raise UnknownRobotModel(f"The robot model '{name}' requires ROS {only}: omit --ros, or choose another model.")
    model = cut[ros if ros is not None else min(cut)]
    if namespace is not None:
        model = replace(model, namespace=namespace.strip("/"))
    if holonomic and not model.body.base.left_mps:
        base = replace(model.body.base, left_mps=HOLONOMIC.left_mps)
        model = replace(model, body=replace(model.body, base=base))
    return model


def robot_model_names() -> tuple[str, ...]:
    """Names of all models."""
    return tuple(sorted(_models()))
