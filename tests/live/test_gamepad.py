"""Gamepads with SDL's virtual joystick, and the functions that map their axes and buttons."""

import math
import time
from collections.abc import Callable, Iterator

import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.domain.events import GamepadChanged
from caris_desktop.live import gamepad as gamepad_module
from caris_desktop.live.gamepad import (
    AT_REST,
    GamepadMapping,
    Gamepads,
    MappingError,
    RawInputs,
    TeleopCommand,
    axis_value,
    binding_words,
    default_mapping,
    let_go_since,
    mappings_from_text,
    mappings_text,
    moved_input,
    part_names,
    pressed_actions,
    shaped,
    speed_share,
    stick_command,
    trigger_value,
    with_rests,
)
from caris_desktop.live.state import LiveState
from tests.support.polling import wait_for
from tests.support.virtual_gamepad import VirtualGamepad

XBOX = {
    "leftx": "a0", "lefty": "a1", "lefttrigger": "a2", "rightx": "a3", "righty": "a4", "righttrigger": "a5",
    "a": "b0", "b": "b1", "x": "b2", "y": "b3", "leftshoulder": "b4", "rightshoulder": "b5", "back": "b6",
    "start": "b7", "dpup": "h0.1", "dpright": "h0.2", "dpdown": "h0.4", "dpleft": "h0.8",
}  # fmt: skip
REST = RawInputs((0.0, 0.0, -1.0, 0.0, 0.0, -1.0), (False,) * 11, (0,))


def xbox() -> GamepadMapping:
    return default_mapping(XBOX, axis_count=6, button_count=11, hat_count=1)


def with_axes(**values: float) -> RawInputs:
    axes = list(REST.axes)
    for name, value in values.items():
        axes[int(name.removeprefix("a"))] = value
    return RawInputs(tuple(axes), REST.buttons, REST.hats)


# Mapping


def test_the_dead_zone_is_round_and_motion_begins_at_zero() -> None:
    assert shaped(0.1, 0.06, 0.12, 1.0) == (0.0, 0.0)
    assert math.hypot(*shaped(0.09, 0.09, 0.12, 1.0)) == pytest.approx(0.00828, abs=1e-4)
    assert shaped(0.0, -1.0, 0.12, 1.6) == (0.0, -1.0)
    x, y = shaped(0.5, 0.5, 0.12, 1.0)
    assert x == y, "the direction stays"
    slow, _ = shaped(0.5, 0.0, 0.12, 2.0)
    assert 0 < slow < shaped(0.5, 0.0, 0.12, 1.0)[0], "the curve is finer in the middle"


def test_a_known_controller_drives_with_its_left_stick() -> None:
    mapping = xbox()
    assert stick_command(mapping, REST) == AT_REST
    assert stick_command(mapping, with_axes(a1=-1.0)) == TeleopCommand(forward=0.6)
    assert stick_command(mapping, with_axes(a0=-1.0)) == TeleopCommand(turn=0.6)
    assert stick_command(mapping, with_axes(a3=1.0)) == TeleopCommand(pan=-1.0)
    assert stick_command(mapping, with_axes(a4=1.0)) == TeleopCommand(tilt=1.0)
    both = RawInputs(REST.axes, tuple(index in (4, 5) for index in range(11)), (0,))
    shoulder = RawInputs(REST.axes, tuple(index == 4 for index in range(11)), (0,))
    assert stick_command(mapping, shoulder) == TeleopCommand(left=0.6)
    assert stick_command(mapping, both) == AT_REST, "opposite ones cancel"


def test_the_triggers_change_the_speed() -> None:
    mapping = xbox()
    assert stick_command(mapping, with_axes(a1=-1.0, a5=1.0)) == TeleopCommand(forward=1.0)
    assert stick_command(mapping, with_axes(a1=-1.0, a5=0.0)) == TeleopCommand(forward=0.8)
    assert stick_command(mapping, with_axes(a1=-1.0, a2=1.0)) == TeleopCommand(forward=0.25)
    silent = RawInputs((0.0, -1.0, None, 0.0, 0.0, None), REST.buttons, REST.hats)
    assert speed_share(mapping, silent) == 0.6, "a trigger that has not been heard of rests"
    assert trigger_value("+a2", RawInputs((0.0, 0.0, 0.5))) == 0.5


def test_buttons_stop_speak_and_mark() -> None:
    mapping = xbox()

    def down(*buttons: int, hat: int = 0) -> frozenset[str]:
        return pressed_actions(mapping, RawInputs(REST.axes, tuple(i in buttons for i in range(11)), (hat,)))

    assert down() == frozenset()
    assert down(1) == {"stop"}
    assert down(6) == down(7) == down(6, 7) == {"emergency_stop"}
    assert down(hat=1) == {"phrase_1"}
    assert down(hat=3) == {"phrase_1", "phrase_2"}
    assert (down(2), down(3), down(0)) == ({"silence"}, {"photo"}, {"mark"})


def test_an_unknown_device_gets_what_it_has_of_the_usual_layout() -> None:
    mapping = default_mapping(None, axis_count=2, button_count=4, hat_count=0)
    assert mapping.axes == {"forward": "a1~", "turn": "a0~"}
    assert set(mapping.buttons) == {"stop", "mark", "silence", "photo"}
    assert default_mapping({}, axis_count=0, button_count=7, hat_count=0).bound("emergency_stop") == "b6"


def test_mappings_are_retained_as_text() -> None:
    mappings = {"03000": xbox(), "05000": GamepadMapping({"forward": "a1"}, {"stop": "b1|b2"}, dead_zone=0.2)}
    assert mappings_from_text(mappings_text(mappings)) == mappings
    assert mappings_from_text("") == {}


@pytest.mark.parametrize(
    "text",
    [
        "{", "[]", '{"version": 2, "devices": {}}', '{"version": 1, "devices": {"x": []}}',
        '{"version": 1, "devices": {"x": {"axes": {"fly": "a0"}}}}',
        '{"version": 1, "devices": {"x": {"axes": {"forward": "__import__"}}}}',
        '{"version": 1, "devices": {"x": {"axes": [1]}}}',
        '{"version": 1, "devices": {"x": {"dead_zone": 2}}}', '{"version": 1, "devices": {"x": {"curve": true}}}',
    ],
)  # fmt: skip
def test_a_text_that_is_no_mapping_is_refused(text: str) -> None:
    with pytest.raises(MappingError):
        mappings_from_text(text)


def test_a_pressed_button_is_found() -> None:
    pressed = RawInputs(REST.axes, (False, False, True), (4,))
    assert moved_input(REST, pressed, buttons=True) == "b2"
    assert moved_input(pressed, pressed, buttons=True) == ""
    assert moved_input(REST, RawInputs(REST.axes, REST.buttons, (4,)), buttons=True) == "h0.4"
    assert moved_input(REST, with_axes(a1=-0.9), buttons=False) == "a1~"
    assert moved_input(REST, with_axes(a1=0.9), buttons=False) == "a1"
    assert moved_input(REST, with_axes(a2=0.2), buttons=False) == "a2", "a trigger pulled half way"
    assert moved_input(REST, with_axes(a1=0.3), buttons=False) == ""


def test_a_held_button_has_to_be_released_before_learning() -> None:
    rests = with_rests(RawInputs(), REST)
    held = RawInputs(with_axes(a0=-1.0).axes, (True, False), (1,))
    before = let_go_since(RawInputs((), held.buttons, held.hats), held, rests)
    assert moved_input(before, held, buttons=False) == ""
    assert moved_input(before, with_axes(a0=1.0), buttons=False) == "", "straight to the other side"
    before = let_go_since(before, RawInputs(REST.axes, (False, False), (0,)), rests)
    assert moved_input(before, held, buttons=False) == "a0~"
    assert moved_input(before, held, buttons=True) == "b0"


def test_a_new_binding_takes_its_input_from_the_old_one() -> None:
    mapping = xbox().with_binding("mark", "b1")
    assert mapping.bound("mark") == "b1"
    assert mapping.bound("stop") == ""
    assert xbox().with_binding("photo", "b6").bound("emergency_stop") == "b7"
    assert xbox().with_binding("turn", "a3").bound("pan") == ""
    assert xbox().with_binding("mark", "").bound("mark") == ""
    assert axis_value("", REST) == 0.0


def test_bindings_have_words() -> None:
    names = part_names(XBOX)
    assert binding_words("b6|b7", names) == "Back or Start"
    assert binding_words("a1~", names) == "Left stick up and down"
    assert binding_words("b9") == "Button 10"
    assert binding_words("h0.8") == "Pad left"
    assert binding_words("a3~") == "Axis 4"
    assert binding_words("") == "none"


# A device, through SDL


class Heard:
    """Records all signals of the gamepads."""

    def __init__(self, gamepads: Gamepads) -> None:
        self.moved: list[TeleopCommand] = []
        self.pressed: list[str] = []
        self.lost: list[str] = []
        gamepads.moved.connect(self.moved.append)
        gamepads.pressed.connect(self.pressed.append)
        gamepads.lost.connect(self.lost.append)


@pytest.fixture
def state() -> Iterator[LiveState]:
    state = LiveState()
    yield state
    state.close()


@pytest.fixture
def published() -> list[GamepadChanged]:
    return []


@pytest.fixture
def gamepads(state: LiveState, published: list[GamepadChanged]) -> Iterator[Gamepads]:
    gamepads = Gamepads(state, published.append)
    gamepads.start()
    yield gamepads
    gamepads.stop()


@pytest.fixture
def heard(gamepads: Gamepads) -> Heard:
    return Heard(gamepads)


@pytest.fixture
def plug(qtbot: QtBot, gamepads: Gamepads) -> Iterator[Callable[[], VirtualGamepad]]:
    plugged: list[VirtualGamepad] = []

    def plug_in() -> VirtualGamepad:
        def attached() -> bool:
            # SDL may still be starting in its thread.
            try:
                plugged.append(VirtualGamepad())
            except RuntimeError:
                return False
            return True

        qtbot.waitUntil(attached)
        qtbot.waitUntil(lambda: gamepads.device is not None and bool(gamepads.sample.raw.axes))
        return plugged[-1]

    yield plug_in
    for pad in plugged:
        pad.unplug()


Plug = Callable[[], VirtualGamepad]


def test_a_stick_drives_and_a_button_stops(
    qtbot: QtBot, heard: Heard, plug: Plug, state: LiveState, published: list[GamepadChanged]
) -> None:
    pad = plug()
    status = state.gamepad.value
    assert status.name == "Virtual Controller"
    assert [(event.connected, event.device) for event in published] == [(True, status.device)]
    pad.push(1, -1.0)
    qtbot.waitUntil(lambda: heard.moved[-1:] == [TeleopCommand(forward=0.6)])
    pad.push(5, 1.0)
    qtbot.waitUntil(lambda: heard.moved[-1:] == [TeleopCommand(forward=1.0)])
    pad.press(1)
    qtbot.waitUntil(lambda: heard.pressed == ["stop"])
    pad.push(1, 0.0)
    qtbot.waitUntil(lambda: heard.moved[-1:] == [AT_REST])
    assert heard.lost == []


def test_a_button_that_drives_releases_automatically(
    qtbot: QtBot, gamepads: Gamepads, heard: Heard, plug: Plug
) -> None:
    pad = plug()
    gamepads.set_mapping(gamepads.mapping.with_binding("turn", "b2|b3"))
    pad.press(3)
    qtbot.waitUntil(lambda: heard.moved[-1:] != [] and heard.moved[-1].turn != 0.0)
    pad.release(3)
    qtbot.waitUntil(lambda: heard.moved[-1:] == [AT_REST])
    assert heard.lost == [], "let go, not given up for silent"


def test_no_button_is_lost_while_the_console_is_busy(qtbot: QtBot, heard: Heard, plug: Plug) -> None:
    pad = plug()
    for _ in range(20):
        pad.press(0)
        wait_for(lambda: pad.has_been_read(0, held=True), "the press is read")
        pad.release(0)
        wait_for(lambda: pad.has_been_read(0, held=False), "the release is read")
    qtbot.waitUntil(lambda: heard.pressed == ["mark"] * 20)


@pytest.mark.logs("gamepad mappings were not used")
def test_pulling_the_plug_releases_and_the_mapping_comes_back_with_the_device(
    qtbot: QtBot, gamepads: Gamepads, heard: Heard, plug: Plug, published: list[GamepadChanged]
) -> None:
    pad = plug()
    kept: list[str] = []
    gamepads.mappings_changed.connect(kept.append)
    gamepads.set_mapping(gamepads.mapping.with_binding("photo", "b0"))
    pad.push(0, 1.0)
    qtbot.waitUntil(lambda: heard.moved[-1:] == [TeleopCommand(turn=-0.6)])
    pad.unplug()
    qtbot.waitUntil(lambda: heard.lost == ["The gamepad was unplugged"] or heard.moved[-1] == AT_REST)
    qtbot.waitUntil(lambda: gamepads.device is None)
    assert gamepads.command == AT_REST
    again = plug()
    assert [event.connected for event in published] == [True, False, True]
    assert gamepads.mapping.bound("photo") == "b0"
    again.press(0)
    qtbot.waitUntil(lambda: heard.pressed == ["photo"])
    # And after a restart, from the saved mapping.
    gamepads.use_mappings_text(kept[-1])
    assert gamepads.mapping.bound("photo") == "b0"
    gamepads.use_mappings_text('{"version": 99}')
    assert gamepads.mapping.bound("photo") == "b0"
    gamepads.reset_mapping()
    assert gamepads.mapping.bound("mark") == "b0"


def test_a_stalled_console_does_not_continue_with_an_old_stick(qtbot: QtBot, heard: Heard, plug: Plug) -> None:
    pad = plug()
    pad.push(1, -1.0)
    qtbot.waitUntil(lambda: heard.moved[-1:] == [TeleopCommand(forward=0.6)])
    time.sleep(0.4)  # the GUI thread hangs while the stick is held
    qtbot.waitUntil(lambda: heard.lost == ["The program stalled"])
    moves = len(heard.moved)
    pad.push(1, -0.8)
    qtbot.wait(100)
    assert heard.moved[moves:] == [], "it has to be let go first"
    pad.push(1, 0.0)
    qtbot.wait(60)
    pad.push(1, -1.0)
    qtbot.waitUntil(lambda: heard.moved[moves:] == [TeleopCommand(forward=0.6)])


def test_a_gamepad_that_falls_silent_moves_nothing(
    qtbot: QtBot, gamepads: Gamepads, heard: Heard, plug: Plug, monkeypatch: pytest.MonkeyPatch
) -> None:
    pad = plug()
    pad.push(1, -1.0)
    qtbot.waitUntil(lambda: heard.moved[-1:] == [TeleopCommand(forward=0.6)])
    monkeypatch.setattr(gamepad_module, "_HEARTBEAT_NS", 10**12)
    gamepads.stop()
    gamepads._watch.start()
    qtbot.waitUntil(lambda: heard.lost == ["The gamepad stopped responding"])


@pytest.mark.logs("gamepads cannot be used")
def test_without_sdl_the_console_says_so(qtbot: QtBot, state: LiveState, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ImportError(f"no module named {name}")

    monkeypatch.setattr(gamepad_module.importlib, "import_module", missing)
    gamepads = Gamepads(state, lambda _event: None)
    gamepads.start()
    qtbot.waitUntil(lambda: state.gamepad.value.detail == "Gamepads cannot be used: no module named pygame")
    gamepads.stop()
