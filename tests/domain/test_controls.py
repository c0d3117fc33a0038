"""Controls as data: templates, their YAML form, and what a schema cannot say."""

from caris_desktop.domain.controls import (
    CallService,
    Choice,
    PublishMessage,
    Reading,
    RobotControl,
    SendActionGoal,
    control_data,
    control_from_data,
    control_problems,
    filled,
)
from caris_desktop.domain.shipped import schema_validator

CONTROLS = (
    RobotControl("wave", "Wave", "button", CallService("/wave", "std_srvs/Trigger", {}), confirm=True),
    RobotControl(
        "volume", "Volume", "slider", PublishMessage("/volume", "std_msgs/Float32", {"data": "$value"}),
        Reading("/volume/state", "std_msgs/Float32", "data", scale=100.0), "Voice", "%", 0.0, 100.0, 5.0,
    ),
    RobotControl(
        "look", "Look", "choice", SendActionGoal("/look", "pkg/Look", {"to": {"name": "$value"}}),
        choices=(Choice("Left", "left"), Choice("Right", "right")), moves=False,
    ),
    RobotControl("heat", "Heat", "readout", None, Reading("/heat", "pkg/msg/Heat", "motors[0].degrees")),
)  # fmt: skip


def test_a_value_alone_keeps_its_type_and_within_a_text_becomes_text() -> None:
    template = {"data": "$value", "text": "at $value %", "list": ["$value", 1], "other": 2}
    assert filled(template, 0.5) == {"data": 0.5, "text": "at 0.5 %", "list": [0.5, 1], "other": 2}


def test_what_is_written_is_accepted_and_reads_back_the_same() -> None:
    validator = schema_validator("robot-control.schema.json")
    for control in CONTROLS:
        data = control_data(control)
        assert list(validator.iter_errors(data)) == []
        assert control_from_data(data) == control


def test_a_readout_does_nothing_and_a_button_does_one_thing() -> None:
    validator = schema_validator("robot-control.schema.json")
    shows = {"topic": "/t", "type": "a/B", "field": "data"}
    call = {"service": "/s", "type": "a/B"}
    publish = {"topic": "/t", "type": "a/B"}
    assert not validator.is_valid({"id": "a", "title": "A", "kind": "readout"})
    assert not validator.is_valid({"id": "a", "title": "A", "kind": "readout", "shows": shows, "call": call})
    assert not validator.is_valid({"id": "a", "title": "A", "kind": "button"})
    assert not validator.is_valid({"id": "a", "title": "A", "kind": "button", "call": call, "publish": publish})
    assert not validator.is_valid(
        {"id": "a", "title": "A", "kind": "readout", "shows": {**shows, "field": "__import__('os')"}}
    )


def test_a_control_counts_as_motion_unless_its_file_says_otherwise() -> None:
    wave, *_, heat = CONTROLS
    assert wave.is_motion
    assert not heat.is_motion
    assert not control_from_data({**control_data(wave), "moves": False}).is_motion


def test_velocities_are_no_matter_of_a_control() -> None:
    wave = control_data(CONTROLS[0])
    del wave["call"]
    stamped = {**wave, "publish": {"topic": "/base", "type": "geometry_msgs/msg/TwistStamped"}, "moves": False}
    other = {**wave, "id": "b", "publish": {"topic": "base/cmd", "type": "std_msgs/String"}}
    assert [index for index, _sentence in control_problems([stamped, other])] == [0]
    ((index, sentence),) = control_problems([other], lambda: "/base/cmd")
    assert (index, "Only driving sends those" in sentence) == (0, True)


def test_two_controls_of_one_name_and_an_upside_down_range_are_told() -> None:
    one = control_data(CONTROLS[1])
    problems = list(control_problems([one, {**one, "range": [1, 0]}]))
    assert [index for index, _sentence in problems] == [1, 1]
