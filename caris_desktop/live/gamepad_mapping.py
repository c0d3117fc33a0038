"""Gamepad mapping: bindings, dead zone, response curve, serialisation. Plain functions.

Bindings use SDL's notation: ``a0`` is an axis, ``a0~`` the inverted axis, ``+a2`` and ``-a2`` its halves, ``b3`` a
button, ``h0.1`` a hat direction (1 up, 2 right, 4 down, 8 left). ``b9|b10`` combines two: for an axis the first means
+1 and the second -1, for a button either one.
"""

import itertools
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import reduce
from typing import Any, Final, Literal, get_args

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.teleop_command import TeleopCommand

MAPPINGS_VERSION: Final = 1

AxisAction = Literal["forward", "left", "turn", "pan", "tilt", "boost", "slow"]
ButtonAction = Literal[
    "stop", "emergency_stop", "phrase_1", "phrase_2", "phrase_3", "phrase_4", "filler", "silence", "photo", "mark",
    "slower", "faster", "look_ahead", "push_to_talk",
]  # fmt: skip
AXIS_ACTIONS: tuple[AxisAction, ...] = get_args(AxisAction)
BUTTON_ACTIONS: tuple[ButtonAction, ...] = get_args(ButtonAction)
TRIGGERS: tuple[AxisAction, ...] = ("boost", "slow")
_STICKS: tuple[tuple[AxisAction, ...], ...] = (("forward", "turn"), ("pan", "tilt"))

_PART = re.compile(r"([+-]?)(?:a(\d+)(~?)|b(\d+)|h(\d+)\.([1248]))")
_PRESSED_AT = 0.5
_MOVED_BY = 0.6
_TRIGGER_RESTS_BELOW = -0.9

# By SDL's names of controller parts. Push-to-talk has no default button.
_ON_A_CONTROLLER: dict[str, tuple[str, ...]] = {
    "forward": ("lefty~",), "turn": ("leftx~",), "left": ("leftshoulder", "rightshoulder"),
    "pan": ("rightx~",), "tilt": ("righty",), "boost": ("righttrigger",), "slow": ("lefttrigger",),
    "stop": ("b",), "emergency_stop": ("back", "start"), "phrase_1": ("dpup",), "phrase_2": ("dpright",),
    "phrase_3": ("dpdown",), "phrase_4": ("dpleft",), "silence": ("x",), "photo": ("y",), "mark": ("a",),
    "look_ahead": ("rightstick",), "filler": ("leftstick",),
}  # fmt: skip
_ON_ANY_DEVICE: dict[str, str] = {
    "forward": "a1~", "turn": "a0~", "pan": "a2~", "tilt": "a3", "stop": "b1", "mark": "b0", "silence": "b2",
    "photo": "b3", "emergency_stop": "b6|b7", "phrase_1": "h0.1", "phrase_2": "h0.2", "phrase_3": "h0.4",
    "phrase_4": "h0.8",
}  # fmt: skip


class MappingError(ValueError):
    """Invalid saved mappings, with the reason."""


class RawInputs(Value):
    """Raw input of a device: axes -1..1 (None: not reported yet), buttons, hats as bits (1 up, 2 right, 4 down, 8
    left).
    """

    axes: tuple[float | None, ...] = ()
    buttons: tuple[bool, ...] = ()
    hats: tuple[int, ...] = ()


class GamepadMapping(Value):
    """Bindings of a device by action; ``speed``: share of the speed setting without triggers."""

    axes: Mapping[AxisAction, str] = field(default_factory=dict)
    buttons: Mapping[ButtonAction, str] = field(default_factory=dict)
    dead_zone: float = 0.12
    curve: float = 1.6
    speed: float = 0.6
    slow_speed: float = 0.25

    def bound(self, action: str) -> str:
        """Binding of an action; empty if none."""
        return next((binding for name, binding in self.bindings() if name == action), "")

    def bindings(self) -> list[tuple[AxisAction | ButtonAction, str]]:
        """All actions with a binding."""
        return [*self.axes.items(), *self.buttons.items()]

    def with_binding(self, action: AxisAction | ButtonAction, binding: str) -> "GamepadMapping":
        """Copy with one binding changed; empty removes it. Other actions lose these inputs."""
        taken = set(binding.split("|")) if binding else set()

        def freed(bindings: Mapping[Any, str]) -> dict[Any, str]:
            remaining = {}
            for other, old in bindings.items():
                parts = [part for part in old.split("|") if not any(_same_input(part, new) for new in taken)]
                if other != action and parts:
                    remaining[other] = "|".join(parts)
            return remaining

        axes, buttons = freed(self.axes), freed(self.buttons)
        if binding and action in AXIS_ACTIONS:
            axes[action] = binding
        elif binding:
            buttons[action] = binding
        return replace(self, axes=axes, buttons=buttons)


def default_mapping(
    controller: Mapping[str, str] | None, *, axis_count: int, button_count: int, hat_count: int
) -> GamepadMapping:
    """Default mapping of a device.

    ``controller``: SDL's mapping (``{"leftx": "a0", "b": "b1", ...}``); without one, a layout common to most devices.
    Missing parts are left out.
    """
    if controller:
        bindings = {
            action: "|".join(_turned(controller[name.rstrip("~")], name.endswith("~")) for name in names)
            for action, names in _ON_A_CONTROLLER.items()
            if all(name.rstrip("~") in controller for name in names)
        }
    else:
        bindings = dict(_ON_ANY_DEVICE)
    present = {}
    for action, binding in bindings.items():
        parts = [part for part in binding.split("|") if _is_there(part, axis_count, button_count, hat_count)]
        complete = len(parts) == len(binding.split("|"))
        if parts and (complete or action in BUTTON_ACTIONS):
            present[action] = "|".join(parts)
    return GamepadMapping(
        axes={action: present[action] for action in AXIS_ACTIONS if action in present},
        buttons={action: present[action] for action in BUTTON_ACTIONS if action in present},
    )


def stick_command(mapping: GamepadMapping, raw: RawInputs) -> TeleopCommand:
    """Command from ``raw`` after dead zone, response curve and triggers."""
    actions: tuple[AxisAction, ...] = ("forward", "left", "turn", "pan", "tilt")
    values = {action: axis_value(mapping.bound(action), raw) for action in actions}
    for first, second in _STICKS:
        values[first], values[second] = shaped(values[first], values[second], mapping.dead_zone, mapping.curve)
    values["left"], _ = shaped(values["left"], 0.0, mapping.dead_zone, mapping.curve)
    speed = speed_share(mapping, raw)
    return TeleopCommand(
        forward=_rounded(values["forward"] * speed),
        left=_rounded(values["left"] * speed),
        turn=_rounded(values["turn"] * speed),
        pan=_rounded(values["pan"]),
        tilt=_rounded(values["tilt"]),
    )


def speed_share(mapping: GamepadMapping, raw: RawInputs) -> float:
    """Share of the speed setting at full deflection: the right trigger raises it to 1, the left one lowers it."""
    boost = trigger_value(mapping.bound("boost"), raw)
    slow = trigger_value(mapping.bound("slow"), raw)
    faster = mapping.speed + (1.0 - mapping.speed) * boost
    return faster + (min(mapping.slow_speed, faster) - faster) * slow


def pressed_actions(mapping: GamepadMapping, raw: RawInputs) -> frozenset[ButtonAction]:
    """Button actions whose buttons are down."""
    return frozenset(
        action
        for action, binding in mapping.buttons.items()
        if any(_part_value(part, raw) > _PRESSED_AT for part in binding.split("|"))
    )


def shaped(x: float, y: float, dead_zone: float, curve: float) -> tuple[float, float]:
    """Stick after a round dead zone, rescaled to start at 0, with an exponent for fine control."""
    reach = math.hypot(x, y)
    if reach <= dead_zone:
        return 0.0, 0.0
    target = min(1.0, (reach - dead_zone) / (1.0 - dead_zone)) ** curve
    scale = target / reach
    return max(-1.0, min(1.0, x * scale)), max(-1.0, min(1.0, y * scale))


def axis_value(binding: str, raw: RawInputs) -> float:
    """Value -1..1 of an axis, or of two opposed inputs; 0 without a binding."""
    if not binding:
        return 0.0
    parts = binding.split("|")
    value = _part_value(parts[0], raw)
    return value - _part_value(parts[1], raw) if len(parts) > 1 else value


def trigger_value(binding: str, raw: RawInputs) -> float:
    """Value 0..1 of a trigger; a full-axis trigger rests at -1."""
    if not binding:
        return 0.0
    match = _PART.fullmatch(binding)
    if match is not None and match[2] is not None and not match[1]:
        index = int(match[2])
        if index >= len(raw.axes) or raw.axes[index] is None:
            return 0.0
        value = (_part_value(binding, raw) + 1.0) / 2.0
    else:
        value = max(0.0, _part_value(binding, raw))
    return 0.0 if value < 0.05 else min(1.0, value)


def moved_input(before: RawInputs, now: RawInputs, *, buttons: bool) -> str:
    """Binding of the input that the user has just pressed (``buttons``) or pushed; empty if none.

    An axis is returned with the pushed direction positive. Values of None in ``before`` are ignored.
    """
    if buttons:
        for index, down in enumerate(now.buttons):
            if down and not (index < len(before.buttons) and before.buttons[index]):
                return f"b{index}"
        for index, bits in enumerate(now.hats):
            new = bits & ~(before.hats[index] if index < len(before.hats) else 0)
            for bit in (1, 2, 4, 8):
                if new & bit:
                    return f"h{index}.{bit}"
        return ""
    for index, value in enumerate(now.axes):
        rest = before.axes[index] if index < len(before.axes) else None
        if value is None or rest is None:
            continue
        moved = value - rest
        if rest < _TRIGGER_RESTS_BELOW:
            # A trigger rests at its end, and its full range counts.
            if moved > _MOVED_BY:
                return f"a{index}"
        elif abs(moved) > _MOVED_BY:
            return f"a{index}" if moved > 0 else f"a{index}~"
    return ""


def with_rests(rests: RawInputs, now: RawInputs) -> RawInputs:
    """Rest position of each axis from its first value: at its end (a trigger), else the centre."""
    axes = list(rests.axes) + [None] * (len(now.axes) - len(rests.axes))
    for index, value in enumerate(now.axes):
        if axes[index] is None and value is not None:
            axes[index] = value if value < _TRIGGER_RESTS_BELOW else 0.0
    return RawInputs(axes=tuple(axes))


def let_go_since(before: RawInputs, now: RawInputs, rests: RawInputs) -> RawInputs:
    """``before`` for :func:`moved_input`: inputs held at the start count once released."""
    axes = tuple(
        rest if _held_nowhere(known, value, rest) else known
        for known, value, rest in itertools.zip_longest(before.axes, now.axes, rests.axes)
    )
    buttons = tuple(was and still for was, still in zip(before.buttons, now.buttons, strict=False))
    hats = tuple(was & still for was, still in zip(before.hats, now.hats, strict=False))
    return RawInputs(axes, buttons, hats)


def _held_nowhere(known: float | None, value: float | None, rest: float | None) -> bool:
    return known is None and value is not None and rest is not None and abs(value - rest) < 0.3


_HAT_WORDS = {1: QT_TR_NOOP("Pad up"), 2: QT_TR_NOOP("Pad right"), 4: QT_TR_NOOP("Pad down"), 8: QT_TR_NOOP("Pad left")}
_NUMBERED_HAT_WORDS = {
    1: QT_TR_NOOP("Pad {number} up"),
    2: QT_TR_NOOP("Pad {number} right"),
    4: QT_TR_NOOP("Pad {number} down"),
    8: QT_TR_NOOP("Pad {number} left"),
}


def binding_words(binding: str, names: Mapping[str, str] | None = None) -> str:
    """Binding as text: ``Button 2``, ``Stick axis 1``; ``names``: the device's own names."""
    if not binding:
        return tr("none")
    first, *others = (_part_words(part, names or {}) for part in binding.split("|"))
    return reduce(lambda known, other: tr("{one} or {other}").format(one=known, other=other), others, first)


def part_names(controller: Mapping[str, str] | None) -> dict[str, str]:
    """Names of a device's inputs, for devices that SDL knows."""
    words = {
        "a": "A",
        "b": "B",
        "x": "X",
        "y": "Y",
        "back": tr("Back"),
        "start": tr("Start"),
        "guide": tr("Guide"),
        "leftstick": tr("Left stick pressed"),
        "rightstick": tr("Right stick pressed"),
        "leftshoulder": tr("Left shoulder"),
        "rightshoulder": tr("Right shoulder"),
        "dpup": tr("Pad up"),
        "dpdown": tr("Pad down"),
        "dpleft": tr("Pad left"),
        "dpright": tr("Pad right"),
        "leftx": tr("Left stick sideways"),
        "lefty": tr("Left stick up and down"),
        "rightx": tr("Right stick sideways"),
        "righty": tr("Right stick up and down"),
        "lefttrigger": tr("Left trigger"),
        "righttrigger": tr("Right trigger"),
    }
    return {value.strip("+-~"): words[name] for name, value in (controller or {}).items() if name in words}


def mappings_text(mappings: Mapping[str, GamepadMapping]) -> str:
    """JSON text of all mappings by device id, for the settings."""
    devices = {
        device: {
            "axes": dict(mapping.axes), "buttons": dict(mapping.buttons), "dead_zone": mapping.dead_zone,
            "curve": mapping.curve, "speed": mapping.speed, "slow_speed": mapping.slow_speed,
        }
        for device, mapping in sorted(mappings.items())
    }  # fmt: skip
    return json.dumps({"version": MAPPINGS_VERSION, "devices": devices}, sort_keys=True)


def mappings_from_text(text: str) -> dict[str, GamepadMapping]:
    """Inverse of :func:`mappings_text`. Raises MappingError for invalid text or a newer version."""
    if not text:
        return {}
    try:
        data = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise MappingError(tr("The stored gamepad mappings are not JSON: {error}.").format(error=error)) from error
    if not isinstance(data, dict) or not isinstance(data.get("devices"), dict):
        raise MappingError(tr("The stored gamepad mappings have an unknown format."))
    if data.get("version") != MAPPINGS_VERSION:
        raise MappingError(
            tr("The stored gamepad mappings have version {found}; this program reads {known}.").format(
                found=repr(data.get("version")), known=MAPPINGS_VERSION
            )
        )
    return {str(device): _mapping_from_data(entry) for device, entry in data["devices"].items()}


def _mapping_from_data(entry: Any) -> GamepadMapping:
    if not isinstance(entry, dict):
        raise MappingError(tr("A stored gamepad mapping is not a list of settings."))
    bindings: dict[str, dict[Any, str]] = {}
    for kind, actions in (("axes", AXIS_ACTIONS), ("buttons", BUTTON_ACTIONS)):
        stored = entry.get(kind, {})
        if not isinstance(stored, dict):
            raise MappingError(tr("The {parts} of a stored gamepad mapping are not a list.").format(parts=kind))
        bindings[kind] = {}
        for action, binding in stored.items():
            if action not in actions or not is_binding(binding):
                raise MappingError(
                    tr("A stored gamepad mapping has an invalid binding: {action} to {binding}.").format(
                        action=repr(action), binding=repr(binding)
                    )
                )
            bindings[kind][action] = binding
    numbers = {}
    for name, lowest, highest in (
        ("dead_zone", 0.0, 0.6), ("curve", 0.5, 4.0), ("speed", 0.1, 1.0), ("slow_speed", 0.05, 1.0),
    ):  # fmt: skip
        value = entry.get(name, getattr(GamepadMapping(), name))
        if not isinstance(value, (int, float)) or isinstance(value, bool) or not lowest <= value <= highest:
            raise MappingError(
                tr("A stored gamepad mapping has an invalid {name}: {value}.").format(name=name, value=repr(value))
            )
        numbers[name] = float(value)
    return GamepadMapping(axes=bindings["axes"], buttons=bindings["buttons"], **numbers)


def is_binding(text: object) -> bool:
    """Whether ``text`` is one or two bindings in the notation of this module."""
    return (
        isinstance(text, str)
        and 1 <= len(text.split("|")) <= 2
        and all(_PART.fullmatch(part) for part in text.split("|"))
    )


def _part_value(part: str, raw: RawInputs) -> float:
    match = _PART.fullmatch(part)
    if match is None:
        return 0.0
    half, axis, inverted, button, hat, direction = match.groups()
    if axis is not None:
        value = (raw.axes[int(axis)] if int(axis) < len(raw.axes) else None) or 0.0
        if half:
            value = max(0.0, value if half == "+" else -value)
        return -value if inverted else value
    if button is not None:
        return 1.0 if int(button) < len(raw.buttons) and raw.buttons[int(button)] else 0.0
    return 1.0 if int(hat) < len(raw.hats) and raw.hats[int(hat)] & int(direction) else 0.0


def _part_words(part: str, names: Mapping[str, str]) -> str:
    match = _PART.fullmatch(part)
    if match is None:
        return part
    bare = part.strip("+-~")
    if bare in names:
        return names[bare]
    _half, axis, _inverted, button, hat, direction = match.groups()
    if axis is not None:
        return tr("Axis {number}").format(number=int(axis) + 1)
    if button is not None:
        return tr("Button {number}").format(number=int(button) + 1)
    if hat == "0":
        return tr(_HAT_WORDS[int(direction)])
    return tr(_NUMBERED_HAT_WORDS[int(direction)]).format(number=int(hat) + 1)


def _same_input(first: str, second: str) -> bool:
    return first.strip("+-~") == second.strip("+-~")


def _turned(part: str, inverted: bool) -> str:
    if not inverted:
        return part
    return part[:-1] if part.endswith("~") else part + ("~" if "a" in part else "")


def _is_there(part: str, axis_count: int, button_count: int, hat_count: int) -> bool:
    match = _PART.fullmatch(part)
    if match is None:
        return False
    _half, axis, _inverted, button, hat, _direction = match.groups()
    counts: Sequence[tuple[str | None, int]] = ((axis, axis_count), (button, button_count), (hat, hat_count))
    return all(index is None or int(index) < count for index, count in counts)


def _rounded(value: float) -> float:
    # Jitter in the last bits must not cause commands.
    return round(value, 2) + 0.0
