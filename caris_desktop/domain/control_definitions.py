"""Controls bound to the robot's own interfaces by a robot profile or scenario: buttons, toggles, sliders, readouts.

Plain data: ``$value`` in a template stands for the wizard's choice; nothing is ever evaluated.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, field, replace
from typing import Annotated, Any, Literal

from caris_desktop.domain.control_effects import NO_NAMES, ControlClass, RobotInterfaceNames, control_class
from caris_desktop.domain.schema_fields import Excluded, ExternalSchema, FieldSpec, Flattened
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value

ControlKind = Literal["button", "toggle", "slider", "choice", "text", "readout"]
ControlValue = bool | float | str

VALUE = "$value"
ROS_NAME = "ROS name"
RosName = Annotated[
    str,
    FieldSpec(
        noun=ROS_NAME,
        longest=255,
        pattern="^/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*$",
        allowed="a ROS name such as /cmd_vel.",
    ),
]
RosType = Annotated[
    str,
    FieldSpec(
        noun="ROS type",
        longest=255,
        pattern="^[A-Za-z][A-Za-z0-9_]*(/(msg|srv|action))?/[A-Za-z][A-Za-z0-9_]*$",
        allowed="a ROS type such as std_msgs/String or std_msgs/msg/String.",
    ),
]
_Template = Mapping[str, Any]
_VELOCITY_TYPES = ("Twist", "TwistStamped")
_SENDING = ("kind", "button", "toggle", "slider", "choice", "text")
_SLIDER = ("kind", "slider")
_CHOICE = ("kind", "choice")


class PublishMessage(Value):
    """Publish ``message`` on ``topic``."""

    topic: Annotated[RosName, FieldSpec("Name of the topic.")]
    type: Annotated[RosType, FieldSpec("Message type of the topic.")]
    message: Annotated[_Template, FieldSpec("The message; `$value` stands for the wizard's choice.")] = field(
        default_factory=dict
    )


class CallService(Value):
    """Call ``service`` with ``request``."""

    service: Annotated[RosName, FieldSpec("Name of the service.")]
    type: Annotated[RosType, FieldSpec("Its ROS type.")]
    request: Annotated[_Template, FieldSpec("The request; `$value` stands for the wizard's choice.")] = field(
        default_factory=dict
    )


class SendActionGoal(Value):
    """Send ``goal`` to an action server (actionlib in ROS 1)."""

    action: Annotated[RosName, FieldSpec("Name of the action.", key="name")]
    type: Annotated[RosType, FieldSpec("Its ROS type.")]
    goal: Annotated[_Template, FieldSpec("The goal; `$value` stands for the wizard's choice.")] = field(
        default_factory=dict
    )


ControlEffect = PublishMessage | CallService | SendActionGoal


class _EffectKeys(Value):
    """What a control does, under the key of its kind."""

    publish: Annotated[PublishMessage | None, FieldSpec("Publish a message.", beside=_SENDING, needed=_SENDING)] = None
    call: Annotated[CallService | None, FieldSpec("Call a service.", beside=_SENDING, instead_of=("publish",))] = None
    action: Annotated[
        SendActionGoal | None, FieldSpec("Send a goal to an action.", beside=_SENDING, instead_of=("publish", "call"))
    ] = None

    def effect(self) -> ControlEffect | None:
        return self.publish or self.call or self.action


def _effect_keys(effect: ControlEffect | None) -> _EffectKeys:
    kinds = {"publish": PublishMessage, "call": CallService, "action": SendActionGoal}
    given: dict[str, Any] = {key: effect for key, kind in kinds.items() if isinstance(effect, kind)}
    return _EffectKeys(**given)


class Reading(Value):
    """What of a topic is shown."""

    topic: Annotated[RosName, FieldSpec("Topic on which the robot reports the state.")]
    type: Annotated[RosType, FieldSpec("Message type of the topic.")]
    field: Annotated[
        str,
        FieldSpec(
            "One value of the message.",
            pattern="^[A-Za-z_][A-Za-z0-9_]*(\\[[0-9]+\\])*(\\.[A-Za-z_][A-Za-z0-9_]*(\\[[0-9]+\\])*)*$",
            allowed="a path such as data or status[0].level.",
        ),
    ]
    scale: Annotated[float, FieldSpec("Factor by which the shown value is multiplied.", quiet=True)] = 1.0
    throttle_ms: Annotated[
        int, FieldSpec("At most one message per interval.", unit="milliseconds", at_least=0, at_most=60_000, quiet=True)
    ] = 200


class Choice(Value):
    """One line of a ``choice``."""

    title: Annotated[str, FieldSpec("Text shown to the wizard.")]
    value: Annotated[ControlValue, FieldSpec("Value of `$value` for this option.")]


class RobotControl(Value):
    """A button, toggle, slider, choice, text field or readout bound to a topic, service or action of the robot."""

    id: Annotated[
        str,
        FieldSpec(
            "Unique among the controls; the name used in the recording.",
            pattern="^[a-z][a-z0-9_]*$",
            allowed="a short lower-case name of letters, digits and _.",
        ),
    ]
    title: Annotated[str, FieldSpec("Text shown to the wizard.", shortest=1, longest=60)]
    kind: Annotated[ControlKind, FieldSpec("Type of control.", noun="kind")]
    effect: Annotated[
        ControlEffect | None, Flattened(_EffectKeys, _EffectKeys.effect, _effect_keys), FieldSpec(order=1)
    ] = None
    reading: Annotated[
        Reading | None, FieldSpec("The state reported by the robot.", key="shows", needed=("kind", "readout"), order=2)
    ] = None
    group: Annotated[
        str, FieldSpec("Controls of one group are shown together under this heading.", longest=40, quiet=True)
    ] = ""
    unit: Annotated[str, FieldSpec("Shown after the number.", longest=12, quiet=True)] = ""
    range: Annotated[
        tuple[float, float] | None, FieldSpec("Lowest and highest value of a slider.", beside=_SLIDER, needed=_SLIDER)
    ] = None
    step: Annotated[float, FieldSpec("Step of a slider; 0: continuous.", at_least=0, beside=_SLIDER, quiet=True)] = 0.0
    choices: Annotated[
        tuple[Choice, ...],
        FieldSpec("Options to choose from.", shortest=1, longest=40, beside=_CHOICE, needed=_CHOICE, quiet=True),
    ] = ()
    confirm: Annotated[bool, FieldSpec("The wizard is asked to confirm before it is carried out.", quiet=True)] = False
    moves: Annotated[
        bool,
        FieldSpec(
            "`false` for a control that moves nothing (a light, a volume, a screen). It also works where "
            "driving is not permitted, and during an emergency stop if the console knows that kind. Anything "
            "that ROS or the profile uses for motion still counts as motion.",
            quiet=True,
        ),
    ] = True
    decided: Annotated[ControlClass | None, Excluded()] = field(default=None, compare=False)

    @property
    def lowest(self) -> float:
        """Minimum of a slider."""
        return self.range[0] if self.range else 0.0

    @property
    def highest(self) -> float:
        """Maximum of a slider."""
        return self.range[1] if self.range else 1.0

    @property
    def control_class(self) -> ControlClass:
        """Effect class as the program decides it; with the robot's own names after :func:`decided`."""
        return self.decided or _class_of(self.effect, NO_NAMES)

    @property
    def is_motion(self) -> bool:
        """Whether it requires the permission to drive; a readout does not."""
        if self.effect is None or self.control_class == "stop":
            return False
        return self.moves or self.control_class in ("motion", "stop_release")

    @property
    def is_held_by_stop(self) -> bool:
        """Whether a latched emergency stop blocks it: all but a stop and what is known to be harmless."""
        if self.effect is None or self.control_class == "stop":
            return False
        return self.is_motion or self.control_class != "harmless"

    @property
    def releases_stop(self) -> bool:
        """Whether it would release the robot's emergency stop, which only the wizard's own release may do."""
        return self.effect is not None and self.control_class == "stop_release"


CONTROL = Annotated[
    RobotControl,
    FieldSpec(noun="control"),
    ExternalSchema("robot-control.schema.json", "robot-profiles.md#the-robot-panel"),
]
"""One control in a file."""


def decided(control: RobotControl, robot: RobotInterfaceNames) -> RobotControl:
    """Control with the effect class that the program decides for a robot with these names."""
    return control if control.effect is None else replace(control, decided=_class_of(control.effect, robot))


def _class_of(effect: ControlEffect | None, robot: RobotInterfaceNames) -> ControlClass:
    if effect is None:
        return "harmless"
    name, type_name, message = astuple(effect)
    return control_class(name, type_name, message, robot)


def is_velocity(topic: str, type_name: str, velocity_topic: str | None) -> bool:
    """Whether the topic drives the base, which only the drive function may do, with its lease, stop and guard."""
    if type_name.rpartition("/")[2] in _VELOCITY_TYPES:
        return True
    return velocity_topic is not None and topic.strip("/") == velocity_topic.strip("/")


def fill_template(template: Any, value: ControlValue) -> Any:
    """``template`` with every ``$value`` replaced: alone by the value itself, within a text by its text."""
    if isinstance(template, Mapping):
        return {key: fill_template(item, value) for key, item in template.items()}
    if isinstance(template, (list, tuple)):
        return [fill_template(item, value) for item in template]
    if template == VALUE:
        return value
    if isinstance(template, str) and VALUE in template:
        return template.replace(VALUE, str(value))
    return template


def mentions_value(template: Any) -> bool:
    """Whether ``$value`` occurs anywhere in the template."""
    if isinstance(template, Mapping):
        return any(mentions_value(item) for item in template.values())
    if isinstance(template, (list, tuple)):
        return any(mentions_value(item) for item in template)
    return isinstance(template, str) and VALUE in template


def control_problems(
    controls: Sequence[Mapping[str, Any]], velocity_topic: Callable[[], str | None] = lambda: None
) -> Iterator[tuple[int, str]]:
    """Problems of a list of controls beyond their declaration: (index, sentence) for each.

    ``velocity_topic`` returns the robot's velocity topic if known; called only when needed.
    """
    seen: set[str] = set()
    for index, control in enumerate(controls):
        name, kind = f"'{control['id']}'", control["kind"]
        if control["id"] in seen:
            yield index, tr("duplicate control {name}.").format(name=name)
        seen.add(control["id"])
        lowest, highest = control.get("range", (0.0, 1.0))
        if not lowest < highest:
            upside_down = tr("invalid range of {name}: {lowest} to {highest}. Allowed: the lower number first.")
            yield index, upside_down.format(name=name, lowest=lowest, highest=highest)
        elif control.get("step", 0.0) > highest - lowest:
            too_large = tr("the step of {name} is larger than its range from {lowest} to {highest}.")
            yield index, too_large.format(name=name, lowest=lowest, highest=highest)
        publish = control.get("publish")
        if publish is not None and is_velocity(publish["topic"], publish["type"], velocity_topic()):
            velocities = tr(
                "{name} publishes velocities ({type} on {topic}). Only driving may send them, so that Stop, "
                "the obstacle guard and releasing the key always apply. Remove this control."
            )
            yield index, velocities.format(name=name, type=publish["type"], topic=publish["topic"])
        sent = [control.get(part, {}).get(template) for part, template in _TEMPLATES]
        if kind not in ("button", "readout") and not mentions_value(sent):
            fixed = tr("the data that {name} sends does not contain {value}, so the wizard's choice has no effect.")
            yield index, fixed.format(name=name, value=VALUE)


_TEMPLATES = (("publish", "message"), ("call", "request"), ("action", "goal"))
