"""Gamepads: reader thread over SDL, and mapping to commands in the GUI thread."""

import importlib
import logging
import os
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import field
from typing import Any

from PySide6.QtCore import QObject, Qt, QTimer, Signal

from caris_desktop.domain import clock
from caris_desktop.domain.events import GamepadChanged
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.live.gamepad_mapping import (
    GamepadMapping,
    MappingError,
    RawInputs,
    default_mapping,
    mappings_from_text,
    mappings_text,
    pressed_actions,
    stick_command,
)
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import GamepadStatus
from caris_desktop.live.teleop_command import AT_REST, TeleopCommand

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


class _Plugged(Value):
    device: GamepadDevice | None  # None: unplugged


class _Failed(Value):
    detail: str


class Gamepads(QObject):
    """Gamepad in use. GUI thread; the console calls ``start()`` and ``stop()``.

    The first connected gamepad is used, the next one after it is unplugged. No button event is lost; of stick positions
    only the newest counts. Signals carry input mapped by the device's mapping; the owner of the settings loads mappings
    with ``use_mappings_text`` and saves them on ``mappings_changed``.

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
        self._device: GamepadDevice | None = None
        self._mapping = GamepadMapping()
        self._command = AT_REST
        self._newest = GamepadSample(0, RawInputs())
        self._taken_ns = 0
        self._down: frozenset[str] = frozenset()
        self._blocked = False
        self._learning = False
        self._inbox = _Inbox(self._woken.emit)
        self._reader: _Reader | None = None
        self._woken.connect(self._process, Qt.ConnectionType.QueuedConnection)
        self._watch = QTimer(self)
        self._watch.setInterval(_CHECK_MS)
        self._watch.timeout.connect(self._check_age)

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

    # Device

    @property
    def device(self) -> GamepadDevice | None:
        """Gamepad in use."""
        return self._device

    @property
    def sample(self) -> GamepadSample:
        """Newest input state."""
        return self._newest

    @property
    def command(self) -> TeleopCommand:
        """Command of the sticks."""
        return self._command

    # Mapping

    @property
    def mapping(self) -> GamepadMapping:
        return self._mapping

    def set_mapping(self, mapping: GamepadMapping) -> None:
        """Set and save a mapping for the gamepad in use."""
        if self._device is None or mapping == self._mapping:
            return
        self._mapping = mapping
        self._mappings[self._device.device] = mapping
        # A button still down was pressed under its old binding.
        self._hold_down(pressed_actions(mapping, self._newest.raw))
        self._lose(QT_TR_NOOP("The gamepad settings changed"))
        self.mapping_changed.emit()
        self.mappings_changed.emit(mappings_text(self._mappings))

    def set_learning(self, *, learning: bool) -> None:
        """While a binding is being set, only stop buttons act."""
        self._learning = learning

    def reset_mapping(self) -> None:
        """Restore the device's default mapping."""
        if self._device is not None:
            self.set_mapping(_default_for(self._device))

    def use_mappings_text(self, text: str) -> None:
        """Load saved mappings. Invalid text is logged, and default mappings apply."""
        try:
            self._mappings = mappings_from_text(text)
        except MappingError as error:
            _log.warning("gamepad mappings were not used: %s", error)
            return
        if self._device is not None:
            self._mapping = self._mappings.get(self._device.device, self._mapping)
            self.mapping_changed.emit()

    # Input from the reader thread

    def _process(self) -> None:
        messages, newest = self._inbox.drain()
        now_ns = clock.now_ns()
        # The stick may have moved anywhere during a stall: it must return to centre first.
        if self._command.moving and now_ns - self._taken_ns > STALE_NS:
            self._lose(QT_TR_NOOP("The program stalled"))
        self._taken_ns = now_ns
        for message in messages:
            if isinstance(message, _Plugged):
                self._on_plugged(message.device)
            elif isinstance(message, _Failed):
                self._state.gamepad.set(GamepadStatus(detail=message.detail))
            elif self._device is not None:
                self._process_buttons(message)
        if newest is not None and self._device is not None:
            self._process_sticks(newest)

    def _process_buttons(self, sample: GamepadSample) -> None:
        down = pressed_actions(self._mapping, sample.raw)
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

    def _process_sticks(self, sample: GamepadSample) -> None:
        self._newest = sample
        self._process_buttons(sample)
        self.sampled.emit(sample)
        command = stick_command(self._mapping, sample.raw)
        if self._blocked or clock.now_ns() - sample.stamp_ns > STALE_NS:
            self._blocked = self._blocked and command.moving
            command = AT_REST
        if command != self._command:
            self._command = command
            if command.moving:
                self._watch.start()
            else:
                self._watch.stop()
            self.moved.emit(command)

    def _check_age(self) -> None:
        if self._command.moving and clock.now_ns() - self._newest.stamp_ns > STALE_NS:
            self._lose(QT_TR_NOOP("The gamepad stopped responding"))

    def _lose(self, reason: str) -> None:
        """Release all input; sticks work again after they were centred."""
        self._watch.stop()
        self._blocked = stick_command(self._mapping, self._newest.raw).moving
        if self._command.moving:
            self._command = AT_REST
            self.lost.emit(reason)

    def _on_plugged(self, device: GamepadDevice | None) -> None:
        former, self._device = self._device, device
        self._hold_down(frozenset())
        self._newest = GamepadSample(clock.now_ns(), RawInputs())
        if former is not None:
            self._lose(QT_TR_NOOP("The gamepad was unplugged"))
            self._publish(GamepadChanged(clock.now_ns(), former.device, former.name, False))
        self._blocked = True
        if device is None:
            self._mapping = GamepadMapping()
            self._state.gamepad.set(GamepadStatus())
        else:
            self._mapping = self._mappings.get(device.device) or _default_for(device)
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
        self._messages: deque[_Plugged | _Failed | GamepadSample] = deque()
        self._newest: GamepadSample | None = None

    def put(self, message: "_Plugged | _Failed | GamepadSample") -> None:
        with self._lock:
            was_empty = not self._messages and self._newest is None
            self._messages.append(message)
            if isinstance(message, _Plugged):
                self._newest = None  # from another device
        if was_empty:
            self._wake()

    def put_newest(self, sample: GamepadSample) -> None:
        with self._lock:
            was_empty = not self._messages and self._newest is None
            self._newest = sample
        if was_empty:
            self._wake()

    def drain(self) -> "tuple[list[_Plugged | _Failed | GamepadSample], GamepadSample | None]":
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
            self._inbox.put(_Failed(localized(QT_TR_NOOP("Gamepads cannot be used: {error}"), error=error)))
            return
        try:
            self._listen()
        except Exception:
            _log.exception("the gamepad thread failed")
            self._inbox.put(_Plugged(None))
            self._inbox.put(_Failed(QT_TR_NOOP("The gamepad stopped working: restart the program to use it")))
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
            self._inbox.put(_Plugged(None))
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
            sample = GamepadSample(clock.now_ns(), self._after(event))
            self._inbox.put(sample)
            self._inbox.put_newest(sample)

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
            self._inbox.put(_Plugged(device))
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
            self._inbox.put_newest(self._last)

    def _deflected(self) -> bool:
        # Whether some input may command motion, so that the console needs repeated samples.
        raw = self._last.raw
        return any(raw.buttons) or any(
            value is not None and abs(value - self._rest.get(index, 0.0)) > 0.05 for index, value in enumerate(raw.axes)
        )


def _hat_bits(value: tuple[int, int]) -> int:
    across, up = value
    return (1 if up > 0 else 0) | (2 if across > 0 else 0) | (4 if up < 0 else 0) | (8 if across < 0 else 0)
