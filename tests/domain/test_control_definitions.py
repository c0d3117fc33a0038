"""Controls as data: templates, YAML form, and limits of their declaration."""

from dataclasses import replace
from typing import Any

import pytest

from caris_desktop.domain.control_definitions import (
    CallService,
    Choice,
    PublishMessage,
    Reading,
    RobotControl,
    SendActionGoal,
    control_problems,
    fill_template,
)
from caris_desktop.domain.schema_fields import data_of, value_from
from caris_desktop.domain.schema_validation import problems

CONTROLS = (
    RobotControl("wave", "Wave", "button", CallService("/wave", "std_srvs/Trigger", {}), confirm=True),
    RobotControl(
        "volume", "Volume", "slider", PublishMessage("/volume", "std_msgs/Float32", {"data": "$value"}),
        Reading("/volume/state", "std_msgs/Float32", "data", scale=100.0), "Voice", "%", (0.0, 100.0), 5.0,
    ),
    RobotControl(
        "look", "Look", "choice", SendActionGoal("/look", "pkg/Look", {"to": {"name": "$value"}}),
        choices=(Choice("Left", "left"), Choice("Right", "right")), moves=False,
    ),
    RobotControl("heat", "Heat", "readout", None, Reading("/heat", "pkg/msg/Heat", "motors[0].degrees")),
)  # fmt: skip


def test_a_value_alone_keeps_its_type_and_within_a_text_becomes_text() -> None:
    template = {"data": "$value", "text": "at $value %", "list": ["$value", 1], "other": 2}
    assert fill_template(template, 0.5) == {"data": 0.5, "text": "at 0.5 %", "list": [0.5, 1], "other": 2}


def test_a_written_definition_is_accepted_and_reads_back_the_same() -> None:
    for control in CONTROLS:
        data = data_of(RobotControl, control)
        assert list(problems(RobotControl, data)) == []
        assert value_from(RobotControl, data) == control


SHOWS = {"topic": "/t", "type": "a/B", "field": "data"}
CALL = {"service": "/s", "type": "a/B"}
PUBLISH = {"topic": "/t", "type": "a/B"}
SENDS = "'publish', 'call' or 'action'"


@pytest.mark.parametrize(
    ("control", "path", "sentence"),
    [
        ({"kind": "readout"}, ("kind",), "'kind': 'readout' also requires 'shows'."),
        (
            {"kind": "readout", "shows": SHOWS, "call": CALL},
            ("call",),
            "'call' is allowed only with 'kind: button, toggle, slider, choice or text', found 'readout'.",
        ),
        ({"kind": "button"}, ("kind",), f"'kind': 'button' also requires {SENDS}."),
        (
            {"kind": "button", "cal": CALL},
            ("cal",),
            "unknown key 'cal'. Allowed: action, call, choices, confirm, group, id, kind, moves, publish, range, "
            "shows, step, title, unit. Did you mean 'call'?",
        ),
        (
            {"kind": "button", "call": CALL, "publish": PUBLISH},
            ("call",),
            "'call' cannot be combined with 'publish': remove one of the two.",
        ),
        ({"kind": "slider", "call": CALL}, ("kind",), "'kind': 'slider' also requires 'range'."),
        (
            {"kind": "slider", "call": CALL, "range": [1]},
            ("range",),
            "'range' has 1 entries. Allowed: 2.",
        ),
        (
            {"kind": "button", "call": CALL, "range": [0, 1]},
            ("range",),
            "'range' is allowed only with 'kind: slider', found 'button'.",
        ),
        ({"kind": "choice", "call": CALL}, ("kind",), "'kind': 'choice' also requires 'choices'."),
        (
            {"kind": "knob", "call": CALL},
            ("kind",),
            "unknown kind 'knob'. Allowed: button, toggle, slider, choice, text, readout.",
        ),
        (
            {"kind": "choice", "call": CALL, "choices": [{"title": "A", "value": [1]}]},
            ("choices", 0, "value"),
            "'choices[1].value' must be true or false, a number or text, found [1].",
        ),
        (
            {"kind": "readout", "shows": {**SHOWS, "field": "__import__('os')"}},
            ("shows", "field"),
            "'shows.field' is \"__import__('os')\". Allowed: a path such as data or status[0].level.",
        ),
        (
            {"kind": "button", "call": {**CALL, "request": "data"}},
            ("call", "request"),
            "'call.request' must be a group of 'key: value' lines, found 'data'.",
        ),
    ],
)
def test_a_readout_only_shows_and_others_do_one_thing(
    control: dict[str, Any], path: tuple[str | int, ...], sentence: str
) -> None:
    assert list(problems(RobotControl, {"id": "a", "title": "A", **control})) == [(path, sentence)]


def test_a_control_counts_as_motion_unless_its_file_says_otherwise() -> None:
    wave, *_, heat = CONTROLS
    assert wave.is_motion
    assert not heat.is_motion
    lamp = RobotControl("lamp", "Lamp", "toggle", PublishMessage("/lamp", "std_msgs/Bool", {"data": "$value"}))
    assert lamp.is_motion
    assert not replace(lamp, moves=False).is_motion
    assert not replace(lamp, moves=False).is_held_by_stop
    assert replace(wave, moves=False).is_motion  # a gesture is motion, whatever the file claims


def test_velocities_are_no_matter_of_a_control() -> None:
    wave = data_of(RobotControl, CONTROLS[0])
    del wave["call"]
    stamped = {**wave, "publish": {"topic": "/base", "type": "geometry_msgs/msg/TwistStamped"}, "moves": False}
    other = {**wave, "id": "b", "publish": {"topic": "base/cmd", "type": "std_msgs/String"}}
    assert [index for index, _sentence in control_problems([stamped, other])] == [0]
    ((index, sentence),) = control_problems([other], lambda: "/base/cmd")
    assert (index, "Only driving may send them" in sentence) == (0, True)


def test_two_controls_of_one_name_and_an_upside_down_range_are_reported() -> None:
    one = data_of(RobotControl, CONTROLS[1])
    found = list(control_problems([one, {**one, "range": [1, 0]}]))
    assert [index for index, _sentence in found] == [1, 1]
