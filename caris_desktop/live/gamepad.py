"""Gamepads: reader thread over SDL, and mapping to commands in the GUI thread."""

import importlib
import itertools
import json
import logging
import math
import os
import re
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, field, replace
from functools import reduce
from typing import Any, Final, Literal, get_args

from PySide6.QtCore import QObject, Qt, Signal

from caris_desktop.domain import clock
from caris_desktop.domain.events import GamepadChanged
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.translation import QT_TR_NOOP, localized, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.background_worker import new_timer
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import GamepadStatus

# Teleoperation command for base and head, and merging of several sources. Plain functions.


class TeleopCommand(Value):
    """Components of -1..1: forward, left and counter-clockwise positive for the base, pan left and tilt down for the
    head.
    """

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0
    pan: float = 0.0
    tilt: float = 0.0

    @property
    def moving(self) -> bool:
        return self != AT_REST

    @property
    def base(self) -> tuple[float, float, float]:
        """(forward, left, turn)."""
        return self.forward, self.left, self.turn

    @property
    def head(self) -> tuple[float, float]:
        """(pan, tilt)."""
        return self.pan, self.tilt

    def limited_to(self, *, sideways: bool, head: bool) -> "TeleopCommand":
        """Without motions that the robot lacks."""
        limited = self if sideways else replace(self, left=0.0)
        return limited if head else replace(limited, pan=0.0, tilt=0.0)


AT_REST = TeleopCommand()


def merged(wishes: Iterable[TeleopCommand]) -> TeleopCommand:
    """Sum of commands, clamped to full speed; opposite ones cancel."""
    forward = left = turn = pan = tilt = 0.0
    for command in wishes:
        forward, left, turn = forward + command.forward, left + command.left, turn + command.turn
        pan, tilt = pan + command.pan, tilt + command.tilt
    return TeleopCommand(*(max(-1.0, min(1.0, total)) for total in (forward, left, turn, pan, tilt)))


# Gamepad mapping: bindings, dead zone, response curve, serialisation. Plain functions.
#
# Bindings use SDL's notation: ``a0`` is an axis, ``a0~`` the inverted axis, ``+a2`` and ``-a2`` its halves, ``b3`` a
# button, ``h0.1`` a hat direction (1 up, 2 right, 4 down, 8 left). ``b9|b10`` combines two: for an axis the first
# means +1 and the second -1, for a button either one.

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

_LIMITS = (("dead_zone", 0.0, 0.6), ("curve", 0.5, 4.0), ("speed", 0.1, 1.0), ("slow_speed", 0.05, 1.0))

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
        taken = {part.strip("+-~") for part in binding.split("|")}

        def freed(bindings: Mapping[Any, str]) -> dict[Any, str]:
            remaining = {}
            for other, old in bindings.items():
                parts = [part for part in old.split("|") if part.strip("+-~") not in taken]
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
        rest if known is None and value is not None and rest is not None and abs(value - rest) < 0.3 else known
        for known, value, rest in itertools.zip_longest(before.axes, now.axes, rests.axes)
    )
    buttons = tuple(was and still for was, still in zip(before.buttons, now.buttons, strict=False))
    hats = tuple(was & still for was, still in zip(before.hats, now.hats, strict=False))
    return RawInputs(axes, buttons, hats)


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
    devices = {device: asdict(mapping) for device, mapping in mappings.items()}
    return json.dumps({"version": MAPPINGS_VERSION, "devices": devices}, sort_keys=True)


def mappings_from_text(text: str) -> dict[str, GamepadMapping]:
    """Inverse of :func:`mappings_text`. Raises MappingError for invalid text or a newer version."""
    if not text:
        return {}
    try:
        data = parse_json(text)
        version = data["version"]
        devices = data["devices"] if version == MAPPINGS_VERSION else {}
        mappings = {device: _checked_mapping(**entry) for device, entry in devices.items()}
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        raise MappingError(f"{type(error).__name__}: {error}") from error
    if version != MAPPINGS_VERSION:
        raise MappingError(f"they have version {version!r}; this program reads {MAPPINGS_VERSION}")
    return mappings


def _checked_mapping(**entry: Any) -> GamepadMapping:
    mapping = GamepadMapping(**entry)
    for actions, bindings in ((AXIS_ACTIONS, mapping.axes), (BUTTON_ACTIONS, mapping.buttons)):
        for action, binding in bindings.items():
            if action not in actions or not is_binding(binding):
                raise ValueError(f"an invalid binding of {action!r} to {binding!r}")
    for name, lowest, highest in _LIMITS:
        value = entry.get(name, lowest)
        if type(value) not in (int, float) or not lowest <= value <= highest:
            raise ValueError(f"an invalid {name} of {value!r}")
    return mapping


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


_log = logging.getLogger(__name__)

STALE_NS = 150_000_000
"""Age from which a stick position no longer moves anything."""

_HEARTBEAT_NS = 40_000_000
_CHECK_MS = 50
_WAIT_MS = 100
_POLL_DEVICES_S = 0.25
_TRIGGER_RESTS_BELOW = -0.9
# SDL without a window: otherwise it would open one, receive nothing in the background, or handle Ctrl+C.
_ENVIRONMENT = {
    "SDL_VIDEODRIVER": "dummy",
    "SDL_JOYSTICK_ALLOW_BACKGROUND_EVENTS": "1",
    "SDL_NO_SIGNAL_HANDLERS": "1",
    "PYGAME_HIDE_SUPPORT_PROMPT": "1",
}


class GamepadDevice(Value):
    """Connected gamepad; ``controller`` is SDL's mapping for it, empty if unknown."""

    device: str
    name: str
    axis_count: int
    button_count: int
    hat_count: int
    controller: dict[str, str] = field(default_factory=dict)


class GamepadSample(Value):
    """Input state at ``stamp_ns`` of the session clock."""

    stamp_ns: int
    raw: RawInputs


_Message = GamepadDevice | GamepadSample | str | None
"""Device that was plugged in, None for one that was unplugged; its input; or why gamepads cannot be used."""


class Gamepads(QObject):
    """Gamepad in use. GUI thread; the console calls ``start()`` and ``stop()``.

    ``device`` is the first connected gamepad, or the next one after it is unplugged. No button event is lost; of stick
    positions only the newest counts. Signals carry input mapped by the device's mapping; the owner of the settings
    loads mappings with ``use_mappings_text`` and saves them on ``mappings_changed``.

    ``state.gamepad`` is maintained; ``publish`` receives GamepadChanged for record and panels.
    """

    moved = Signal(object)  # TeleopCommand, on each change
    lost = Signal(str)  # reason why input was released
    pressed = Signal(str)  # button action
    released = Signal(str)  # button action
    sampled = Signal(object)  # GamepadSample, for display of the device
    mapping_changed = Signal()
    mappings_changed = Signal(str)  # text to save
    _woken = Signal()

    def __init__(
        self, state: LiveState, publish: Callable[[GamepadChanged], None], parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._publish = publish
        self._mappings: dict[str, GamepadMapping] = {}
        self.device: GamepadDevice | None = None
        self.mapping = GamepadMapping()
        self.command = AT_REST
        self.sample = GamepadSample(0, RawInputs())
        """Newest input state."""
        self._taken_ns = 0
        self._down: frozenset[str] = frozenset()
        self._blocked = False
        self._learning = False
        self._inbox = _Inbox(self._woken.emit)
        self._reader: _Reader | None = None
        self._woken.connect(self._process, Qt.ConnectionType.QueuedConnection)
        self._watch = new_timer(self, self._check_age, _CHECK_MS)

    def start(self) -> None:
        """Start the reader thread; returns at once."""
        if self._reader is None:
            self._reader = _Reader(self._inbox)
            self._reader.start()

    def stop(self) -> None:
        """End the thread; blocks half a second at most."""
        reader, self._reader = self._reader, None
        self._watch.stop()
        if reader is not None and not reader.stop(timeout_s=0.5):
            _log.error("the gamepad thread did not end")

    # Mapping

    def set_mapping(self, mapping: GamepadMapping) -> None:
        """Set and save a mapping for the gamepad in use."""
        if self.device is None or mapping == self.mapping:
            return
        self.mapping = mapping
        self._mappings[self.device.device] = mapping
        # A button still down was pressed under its old binding.
        self._hold_down(pressed_actions(mapping, self.sample.raw))
        self._lose(QT_TR_NOOP("The gamepad settings changed"))
        self.mapping_changed.emit()
        self.mappings_changed.emit(mappings_text(self._mappings))

    def set_learning(self, *, learning: bool) -> None:
        """While a binding is being set, only stop buttons act."""
        self._learning = learning

    def reset_mapping(self) -> None:
        """Restore the device's default mapping."""
        if self.device is not None:
            self.set_mapping(_default_for(self.device))

    def use_mappings_text(self, text: str) -> None:
        """Load saved mappings. Invalid text is logged, and default mappings apply."""
        try:
            self._mappings = mappings_from_text(text)
        except MappingError as error:
            _log.warning("gamepad mappings were not used: %s", error)
            return
        if self.device is not None:
            self.mapping = self._mappings.get(self.device.device, self.mapping)
            self.mapping_changed.emit()

    # Input from the reader thread

    def _process(self) -> None:
        messages, newest = self._inbox.drain()
        now_ns = clock.now_ns()
        # The stick may have moved anywhere during a stall: it must return to centre first.
        if self.command.moving and now_ns - self._taken_ns > STALE_NS:
            self._lose(QT_TR_NOOP("The program stalled"))
        self._taken_ns = now_ns
        for message in messages:
            if message is None or isinstance(message, GamepadDevice):
                self._on_plugged(message)
            elif isinstance(message, str):
                self._state.gamepad.set(GamepadStatus(detail=message))
            elif self.device is not None:
                self._process_buttons(message)
        if newest is not None and self.device is not None:
            self.sample = newest
            self._process_buttons(newest)
            self.sampled.emit(newest)
            command = stick_command(self.mapping, newest.raw)
            if self._blocked or clock.now_ns() - newest.stamp_ns > STALE_NS:
                self._blocked = self._blocked and command.moving
                command = AT_REST
            if command != self.command:
                self.command = command
                if command.moving:
                    self._watch.start()
                else:
                    self._watch.stop()
                self.moved.emit(command)

    def _process_buttons(self, sample: GamepadSample) -> None:
        down = pressed_actions(self.mapping, sample.raw)
        new = down - self._down
        self._hold_down(down)
        # Stops come first, whatever else was pressed.
        for action in sorted(new, key=lambda name: (name not in ("emergency_stop", "stop"), name)):
            if not self._learning or action in ("stop", "emergency_stop"):
                self.pressed.emit(action)

    def _hold_down(self, down: frozenset[str]) -> None:
        up, self._down = self._down - down, down
        for action in sorted(up):
            self.released.emit(action)

    def _check_age(self) -> None:
        if self.command.moving and clock.now_ns() - self.sample.stamp_ns > STALE_NS:
            self._lose(QT_TR_NOOP("The gamepad stopped responding"))

    def _lose(self, reason: str) -> None:
        """Release all input; sticks work again after they were centred."""
        self._watch.stop()
        self._blocked = stick_command(self.mapping, self.sample.raw).moving
        if self.command.moving:
            self.command = AT_REST
            self.lost.emit(reason)

    def _on_plugged(self, device: GamepadDevice | None) -> None:
        former, self.device = self.device, device
        self._hold_down(frozenset())
        self.sample = GamepadSample(clock.now_ns(), RawInputs())
        if former is not None:
            self._lose(QT_TR_NOOP("The gamepad was unplugged"))
            self._publish(GamepadChanged(clock.now_ns(), former.device, former.name, False))
        self._blocked = True
        if device is None:
            self.mapping = GamepadMapping()
            self._state.gamepad.set(GamepadStatus())
        else:
            self.mapping = self._mappings.get(device.device) or _default_for(device)
            self._publish(GamepadChanged(clock.now_ns(), device.device, device.name, True))
            known = device.controller or device.device in self._mappings
            detail = "" if known else QT_TR_NOOP("unknown gamepad: check its buttons")
            self._state.gamepad.set(GamepadStatus(device.device, device.name, detail))
        self.mapping_changed.emit()


def _default_for(device: GamepadDevice) -> GamepadMapping:
    return default_mapping(
        device.controller, axis_count=device.axis_count, button_count=device.button_count, hat_count=device.hat_count
    )


class _Inbox:
    """Queue from reader to GUI thread: button and device events in order, only the newest stick position."""

    def __init__(self, wake: Callable[[], None]) -> None:
        self._wake = wake
        self._lock = threading.Lock()
        self._messages: deque[_Message] = deque()
        self._newest: GamepadSample | None = None

    def put(self, message: _Message, *, position_only: bool = False) -> None:
        """Add a message. A sample is also the newest position, with ``position_only`` nothing else."""
        with self._lock:
            was_empty = not self._messages and self._newest is None
            if not position_only:
                self._messages.append(message)
            # The position of a device that was exchanged does not count.
            self._newest = message if isinstance(message, GamepadSample) else None
        if was_empty:
            self._wake()

    def drain(self) -> tuple[list[_Message], GamepadSample | None]:
        with self._lock:
            messages, newest = list(self._messages), self._newest
            self._messages.clear()
            self._newest = None
        return messages, newest


class _Reader:
    """Reader thread. Waits in SDL, which polls the devices every millisecond without the GIL."""

    def __init__(self, inbox: _Inbox) -> None:
        self._inbox = inbox
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="gamepad", daemon=True)
        self._pygame: Any = None
        self._controller: Any = None
        self._joystick: Any = None
        self._instance = -1
        self._rest: dict[int, float] = {}
        self._last = GamepadSample(0, RawInputs())

    def start(self) -> None:
        self._thread.start()

    def stop(self, *, timeout_s: float) -> bool:
        self._ending.set()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        for name, value in _ENVIRONMENT.items():
            os.environ.setdefault(name, value)
        try:
            pygame = self._pygame = importlib.import_module("pygame")
            self._controller = importlib.import_module("pygame._sdl2.controller")
            pygame.display.init()
            pygame.joystick.init()
            self._controller.init()
        except Exception as error:  # the console works without gamepads, whatever fails in SDL
            _log.exception("gamepads cannot be used")
            self._inbox.put(localized(QT_TR_NOOP("Gamepads cannot be used: {error}"), error=error))
            return
        try:
            self._listen()
        except Exception:
            _log.exception("the gamepad thread failed")
            self._inbox.put(None)
            self._inbox.put(QT_TR_NOOP("The gamepad stopped working: restart the program to use it"))
        finally:
            self._joystick = None
            self._controller.quit()
            pygame.joystick.quit()
            pygame.display.quit()

    def _listen(self) -> None:
        self._open_first()
        while not self._ending.is_set():
            if self._joystick is None:
                # SDL detects new devices only when polled.
                self._ending.wait(_POLL_DEVICES_S)
                events = self._pygame.event.get()
            else:
                first = self._pygame.event.wait(_WAIT_MS if not self._deflected() else _HEARTBEAT_NS // 1_000_000)
                events = [first, *self._pygame.event.get()]
            for event in events:
                self._on_event(event)
            if self._joystick is not None:
                self._report()

    def _on_event(self, event: Any) -> None:
        pygame = self._pygame
        if event.type == pygame.JOYDEVICEREMOVED and event.instance_id == self._instance:
            self._joystick = None
            self._instance = -1
            self._inbox.put(None)
            self._open_first()
        elif event.type == pygame.JOYDEVICEADDED and self._joystick is None:
            self._open_first()
        elif event.type == pygame.JOYAXISMOTION and event.instance_id == self._instance:
            if event.axis not in self._rest:
                self._rest[event.axis] = -1.0 if event.value < _TRIGGER_RESTS_BELOW else 0.0
        elif (
            event.type in (pygame.JOYBUTTONDOWN, pygame.JOYBUTTONUP, pygame.JOYHATMOTION)
            and event.instance_id == self._instance
        ):
            # A batch may hold two changes of a button: each is passed on. The sample is also the newest position, so
            # that releasing a button takes effect at once.
            self._inbox.put(GamepadSample(clock.now_ns(), self._after(event)))

    def _open_first(self) -> None:
        for index in range(self._pygame.joystick.get_count()):
            try:
                joystick = self._pygame.joystick.Joystick(index)
                known = self._controller.is_controller(index)
                names = self._controller.Controller(index).get_mapping() if known else {}
            except self._pygame.error as error:
                _log.warning("gamepad %d cannot be opened: %s", index, error)
                continue
            self._joystick, self._instance = joystick, joystick.get_instance_id()
            self._rest.clear()
            device = GamepadDevice(
                joystick.get_guid(),
                joystick.get_name(),
                joystick.get_numaxes(),
                joystick.get_numbuttons(),
                joystick.get_numhats(),
                {name: text for name, text in names.items() if name not in ("platform", "crc")},
            )
            self._last = GamepadSample(0, RawInputs())
            self._inbox.put(device)
            return

    def _after(self, event: Any) -> RawInputs:
        """Input state after one button or hat event."""
        raw, pygame = self._last.raw, self._pygame
        buttons, hats = list(raw.buttons), list(raw.hats)
        if event.type == pygame.JOYHATMOTION:
            if event.hat < len(hats):
                hats[event.hat] = _hat_bits(event.value)
        elif event.button < len(buttons):
            buttons[event.button] = event.type == pygame.JOYBUTTONDOWN
        changed = RawInputs(raw.axes, tuple(buttons), tuple(hats))
        self._last = GamepadSample(clock.now_ns(), changed)
        return changed

    def _read(self) -> RawInputs:
        joystick = self._joystick
        axes = []
        for index in range(joystick.get_numaxes()):
            value = float(joystick.get_axis(index))
            # SDL reports 0 for an axis without an event so far; a trigger would appear half pressed.
            axes.append(None if value == 0.0 and index not in self._rest else value)
        return RawInputs(
            tuple(axes),
            tuple(bool(joystick.get_button(index)) for index in range(joystick.get_numbuttons())),
            tuple(_hat_bits(joystick.get_hat(index)) for index in range(joystick.get_numhats())),
        )

    def _report(self) -> None:
        now_ns, raw = clock.now_ns(), self._read()
        if raw != self._last.raw or (self._deflected() and now_ns - self._last.stamp_ns > _HEARTBEAT_NS * 3 // 4):
            self._last = GamepadSample(now_ns, raw)
            self._inbox.put(self._last, position_only=True)

    def _deflected(self) -> bool:
        # Whether some input may command motion, so that the console needs repeated samples.
        raw = self._last.raw
        return any(raw.buttons) or any(
            value is not None and abs(value - self._rest.get(index, 0.0)) > 0.05 for index, value in enumerate(raw.axes)
        )


def _hat_bits(value: tuple[int, int]) -> int:
    across, up = value
    return (1 if up > 0 else 0) | (2 if across > 0 else 0) | (4 if up < 0 else 0) | (8 if across < 0 else 0)
