"""Check of control messages against their message type."""

from typing import Any

import pytest

from caris_desktop.domain.control_definitions import fill_template
from caris_desktop.domain.translation import tr, use_translator
from caris_desktop.ros.definitions import (
    MessageMismatchError,
    coerce_to_definition,
    definition_from_rosapi,
    shipped_definition,
    shipped_definitions,
)


def check(type_: str, message: dict[str, Any], *, rounds: bool = False) -> dict[str, Any]:
    return coerce_to_definition(message, shipped_definition(type_), rounds=rounds)


def test_every_shipped_type_explains_itself() -> None:
    known = shipped_definitions()
    primitive = {"string", "bool", "time", "duration", "byte", "char", "float32", "float64"}
    for name, fields in known.items():
        for field in fields:
            assert field.type in primitive or "int" in field.type or field.type in known, f"{name}.{field.name}"


@pytest.mark.parametrize(
    ("type_", "message", "sent"),
    [
        ("std_msgs/UInt8", {"data": 255.0}, {"data": 255}),
        ("std_msgs/msg/Float32", {"data": 3}, {"data": 3.0}),
        ("std_msgs/ColorRGBA", {"r": 1, "a": 0.5}, {"r": 1.0, "a": 0.5}),
        ("std_msgs/Bool", {"data": True}, {"data": True}),
        ("std_srvs/srv/Trigger", {}, {}),
        ("geometry_msgs/Twist", {"linear": {"x": 1}}, {"linear": {"x": 1.0}}),
        ("std_msgs/Header", {"stamp": "now"}, {"stamp": "now"}),
        ("std_msgs/Header", {"stamp": {"sec": 1, "nanosec": 2}}, {"stamp": {"sec": 1, "nanosec": 2}}),
        (
            "trajectory_msgs/JointTrajectory",
            {"joint_names": ["arm"], "points": [{"positions": [1], "time_from_start": {"secs": 2}}]},
            {"joint_names": ["arm"], "points": [{"positions": [1.0], "time_from_start": {"secs": 2}}]},
        ),
    ],
)
def test_a_valid_message_is_sent_as_its_type_requires(
    type_: str, message: dict[str, Any], sent: dict[str, Any]
) -> None:
    fit = check(type_, message)
    assert fit == sent
    assert [type(value) for value in fit.values()] == [type(value) for value in sent.values()]


@pytest.mark.parametrize(
    ("type_", "message", "sentence"),
    [
        ("std_msgs/UInt8", {"data": 300}, "the field 'data' must be a whole number from 0 to 255, but it is 300"),
        ("std_msgs/UInt8", {"data": 2.5}, "the field 'data' must be a whole number from 0 to 255, but it is 2.5"),
        ("std_msgs/Int8", {"data": True}, "must be a whole number from -128 to 127, but it is true"),
        ("std_msgs/Float32", {"data": "loud"}, "the field 'data' must be a number, but it is the text 'loud'"),
        ("std_msgs/Float32", {"data": 1e39}, "must be a finite number"),
        ("std_msgs/Float64", {"data": float("nan")}, "must be a finite number"),
        ("std_msgs/Float64", {"data": 10**400}, "is too large"),
        ("std_msgs/Bool", {"data": 1}, "must be true or false, but it is 1"),
        ("std_msgs/String", {"data": 1.0}, "must be text, but it is 1.0"),
        ("std_msgs/String", {"text": "hi"}, "unknown field 'text'; known fields: data"),
        ("std_srvs/Trigger", {"data": True}, "unknown field 'data'; known fields: none"),
        ("geometry_msgs/Twist", {"linear": {"w": 1.0}}, "unknown field 'linear.w'; known fields: x, y, z"),
        ("geometry_msgs/Twist", {"linear": 1.0}, "the field 'linear' must be a group of fields, but it is 1.0"),
        ("sensor_msgs/JointState", {"name": "arm"}, "the field 'name' must be a list, but it is the text 'arm'"),
        ("sensor_msgs/JointState", {"position": [1.0, "x"]}, "the field 'position[1]' must be a number"),
        ("std_msgs/Header", {"stamp": {"secs": 1.5}}, "must be a time in whole seconds"),
    ],
)
def test_an_invalid_message_is_explained(type_: str, message: dict[str, Any], sentence: str) -> None:
    with pytest.raises(MessageMismatchError) as refusal:
        check(type_, message)
    assert sentence in str(refusal.value)


def test_a_slider_finds_the_nearest_whole_number() -> None:
    assert check("std_msgs/UInt8", {"data": 54.6}, rounds=True) == {"data": 55}
    with pytest.raises(MessageMismatchError, match="300"):
        check("std_msgs/UInt8", {"data": 299.6}, rounds=True)


def test_a_type_that_nobody_knows_is_sent_as_it_is_if_it_can_be() -> None:
    message = {"mode": "wave", "parts": [1, 2.5, None, {"deep": True}]}
    assert coerce_to_definition(message, None) == message
    with pytest.raises(MessageMismatchError, match="not finite"):
        coerce_to_definition({"x": [float("inf")]}, None)
    deep: dict[str, Any] = {}
    for _ in range(60):
        deep = {"deeper": deep}
    with pytest.raises(MessageMismatchError, match="too deep"):
        coerce_to_definition(deep, None)


def test_a_text_is_never_more_than_text() -> None:
    template = {"data": "say: $value"}
    value = "$value {1+1} __import__('os')"
    assert check("std_msgs/String", fill_template(template, value)) == {"data": f"say: {value}"}


ROSAPI = [
    {
        "type": "robot_msgs/Light",
        "fieldnames": ["colour", "levels", "stamp", "raw", "odd"],
        "fieldtypes": ["std_msgs/msg/ColorRGBA", "uint8", "builtin_interfaces/Time", "uint8", "other_msgs/Odd"],
        "fieldarraylen": [-1, 3, -1, 0, -1],
        "examples": [],
    },
    {
        "type": "std_msgs/ColorRGBA",
        "fieldnames": ["r", "g", "b", "a"],
        "fieldtypes": ["float", "float", "float", "float"],
        "fieldarraylen": [-1, -1, -1, -1],
    },
]


def test_the_robot_explains_its_own_types() -> None:
    light = definition_from_rosapi(ROSAPI)
    message = {"colour": {"r": 1}, "levels": [1, 2, 255], "stamp": {"sec": 0}, "raw": "AAA=", "odd": {"x": 1}}
    assert coerce_to_definition(message, light)["colour"] == {"r": 1.0}
    for wrong, sentence in (
        ({"levels": [1, 2]}, "the field 'levels' must have 3 entries, but it has 2"),
        ({"levels": [1, 2, 256]}, "the field 'levels[2]' must be a whole number from 0 to 255"),
        ({"colour": {"x": 1}}, "unknown field 'colour.x'"),
    ):
        with pytest.raises(MessageMismatchError) as refusal:
            coerce_to_definition(wrong, light)
        assert sentence in str(refusal.value)


@pytest.mark.parametrize(
    "typedefs",
    [None, [], "x", [1], [{"type": 5}], [{"type": "a/B"}], [{**ROSAPI[0], "fieldarraylen": [1]}],
     [{**ROSAPI[0], "fieldarraylen": [None] * 5}], [ROSAPI[0]] * 1000],
)  # fmt: skip
def test_answers_of_rosapi_that_explain_nothing(typedefs: Any) -> None:
    with pytest.raises((ValueError, TypeError)):
        definition_from_rosapi(typedefs)


def test_an_invalid_message_is_explained_in_the_wizards_language() -> None:
    german = {
        "{where} must be text, but it is {value}": "{where} muss ein Text sein, ist aber {value}",
        "the field {field}": "das Feld {field}",
        "a list": "eine Liste",
    }
    with pytest.raises(MessageMismatchError) as raised:
        check("std_msgs/String", {"data": []})
    use_translator(lambda text, _meant, _number: german.get(text, text))
    try:
        assert tr(str(raised.value)) == "das Feld 'data' muss ein Text sein, ist aber eine Liste"
    finally:
        use_translator(None)
