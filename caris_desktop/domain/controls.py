"""Buttons, toggles, sliders and readouts that a robot profile or a scenario binds to the robot's own interfaces.

Plain data: ``$value`` in a template stands for what the wizard chose, and nothing is ever evaluated.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

ControlKind = Literal["button", "toggle", "slider", "choice", "text", "readout"]
ControlValue = bool | float | str

VALUE = "$value"
_VELOCITY_TYPES = ("Twist", "TwistStamped")


@dataclass(frozen=True, slots=True)
class PublishMessage:
    """Publish ``message`` on ``topic``."""

    topic: str
    type: str
    message: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class CallService:
    """Call ``service`` with ``request``."""

    service: str
    type: str
    request: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class SendActionGoal:
    """Send ``goal`` to the action server ``action`` (actionlib in ROS 1)."""

    action: str
    type: str
    goal: Mapping[str, Any]


ControlEffect = PublishMessage | CallService | SendActionGoal


@dataclass(frozen=True, slots=True)
class Reading:
    """What of a topic is shown: ``field`` is a path such as ``data`` or ``status[0].level``; shown times ``scale``."""

    topic: str
    type: str
    field: str
    scale: float = 1.0
    throttle_ms: int = 200


@dataclass(frozen=True, slots=True)
class Choice:
    """One line of a ``choice``."""

    title: str
    value: ControlValue


@dataclass(frozen=True, slots=True)
class RobotControl:
    """One control. ``effect`` is None for a readout; ``reading`` is None where the robot does not tell the state.

    ``lowest``, ``highest`` and ``step`` belong to a slider, ``choices`` to a choice. ``confirm`` asks first.
    Unless its file says ``moves: false`` (a light, a volume), using it counts as motion.
    """

    id: str
    title: str
    kind: ControlKind
    effect: ControlEffect | None = None
    reading: Reading | None = None
    group: str = ""
    unit: str = ""
    lowest: float = 0.0
    highest: float = 1.0
    step: float = 0.0
    choices: tuple[Choice, ...] = ()
    confirm: bool = False
    moves: bool = True

    @property
    def is_motion(self) -> bool:
        """Whether the emergency stop and the permission to drive hold for it; a readout only tells."""
        return self.moves and self.effect is not None


def is_velocity(topic: str, type_name: str, velocity_topic: str | None) -> bool:
    """Whether what is published there drives the base, which only driving may do: under its lease, stop and guard."""
    if type_name.rpartition("/")[2] in _VELOCITY_TYPES:
        return True
    return velocity_topic is not None and topic.strip("/") == velocity_topic.strip("/")


def filled(template: Any, value: ControlValue) -> Any:
    """``template`` with every ``$value`` replaced: alone it becomes the value itself, within a text its text."""
    if isinstance(template, Mapping):
        return {key: filled(item, value) for key, item in template.items()}
    if isinstance(template, (list, tuple)):
        return [filled(item, value) for item in template]
    if template == VALUE:
        return value
    if isinstance(template, str) and VALUE in template:
        return template.replace(VALUE, str(value))
    return template


def control_from_data(data: Mapping[str, Any]) -> RobotControl:
    """One control from a YAML mapping that ``robot-control.schema.json`` has accepted."""
    effect: ControlEffect | None = None
    if "publish" in data:
        publish = data["publish"]
        effect = PublishMessage(publish["topic"], publish["type"], publish.get("message", {}))
    elif "call" in data:
        call = data["call"]
        effect = CallService(call["service"], call["type"], call.get("request", {}))
    elif "action" in data:
        action = data["action"]
        effect = SendActionGoal(action["name"], action["type"], action.get("goal", {}))
    lowest, highest = data.get("range", (0.0, 1.0))
    return RobotControl(
        id=data["id"],
        title=data["title"],
        kind=data["kind"],
        effect=effect,
        reading=Reading(**data["shows"]) if "shows" in data else None,
        group=data.get("group", ""),
        unit=data.get("unit", ""),
        lowest=float(lowest),
        highest=float(highest),
        step=float(data.get("step", 0.0)),
        choices=tuple(Choice(choice["title"], choice["value"]) for choice in data.get("choices", ())),
        confirm=data.get("confirm", False),
        moves=data.get("moves", True),
    )


def control_data(control: RobotControl) -> dict[str, Any]:
    """The reverse of :func:`control_from_data`, without what has its default."""
    data: dict[str, Any] = {"id": control.id, "title": control.title, "kind": control.kind}
    if control.group:
        data["group"] = control.group
    if control.unit:
        data["unit"] = control.unit
    if control.kind == "slider":
        data["range"] = [control.lowest, control.highest]
        if control.step:
            data["step"] = control.step
    if control.choices:
        data["choices"] = [{"title": choice.title, "value": choice.value} for choice in control.choices]
    if control.confirm:
        data["confirm"] = True
    if not control.moves:
        data["moves"] = False
    match control.effect:
        case PublishMessage(topic, type_name, message):
            data["publish"] = {"topic": topic, "type": type_name, "message": dict(message)}
        case CallService(service, type_name, request):
            data["call"] = {"service": service, "type": type_name, "request": dict(request)}
        case SendActionGoal(action, type_name, goal):
            data["action"] = {"name": action, "type": type_name, "goal": dict(goal)}
    if control.reading is not None:
        reading = control.reading
        data["shows"] = {"topic": reading.topic, "type": reading.type, "field": reading.field}
        if reading.scale != 1.0:
            data["shows"]["scale"] = reading.scale
        if reading.throttle_ms != 200:
            data["shows"]["throttle_ms"] = reading.throttle_ms
    return data


def mentions_value(template: Any) -> bool:
    """Whether ``$value`` stands anywhere in the template."""
    if isinstance(template, Mapping):
        return any(mentions_value(item) for item in template.values())
    if isinstance(template, (list, tuple)):
        return any(mentions_value(item) for item in template)
    return isinstance(template, str) and VALUE in template


def control_problems(
    controls: Sequence[Mapping[str, Any]], velocity_topic: Callable[[], str | None] = lambda: None
) -> Iterator[tuple[int, str]]:
    """What the schema cannot say of a list of controls: (its number, a sentence) for each mistake.

    ``velocity_topic`` gives where the robot takes velocities, as far as that is known; asked only where it matters.
    """
    seen: set[str] = set()
    for index, control in enumerate(controls):
        name, kind = f"'{control['id']}'", control["kind"]
        if control["id"] in seen:
            yield index, f"the control {name} is listed twice."
        seen.add(control["id"])
        lowest, highest = control.get("range", (0.0, 1.0))
        if not lowest < highest:
            yield index, f"the range of {name} is from {lowest} to {highest}. Allowed: the lower number first."
        elif control.get("step", 0.0) > highest - lowest:
            yield index, f"the step of {name} is larger than its range from {lowest} to {highest}."
        for key, owner in (("range", "slider"), ("step", "slider"), ("choices", "choice")):
            if key in control and kind != owner:
                yield index, f"{name} is a {kind}; '{key}' belongs to a {owner}."
        publish = control.get("publish")
        if publish is not None and is_velocity(publish["topic"], publish["type"], velocity_topic()):
            yield (
                index,
                f"{name} publishes velocities ({publish['type']} on {publish['topic']}). Only driving sends those, so "
                "that the stop, the obstacle guard and letting go of the key hold for them. Leave this control out.",
            )
        if kind not in ("button", "readout") and not _sends_value(control):
            yield index, f"what {name} sends nowhere holds {VALUE}, so what the wizard chooses has no effect."


def _sends_value(control: Mapping[str, Any]) -> bool:
    parts = (("publish", "message"), ("call", "request"), ("action", "goal"))
    return any(mentions_value(control[part].get(template, {})) for part, template in parts if part in control)
