"""Definitions of the simulated robot's ROS types, as reported by rosapi.

Those that the console ships, and those of ``resources/simulator/ros-types.yaml``; types that differ between ROS 1 and
ROS 2 have both. ``rosbags``' type store knows 65 of these 117, no service and no action, uses the ROS 2 name for
ROS 1's time, and takes 0.2 s to load.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

from caris_desktop.ros.definitions import (
    DEFINITION_TEXTS,
    FLOATS,
    INTEGER_RANGES,
    TEXTS,
    TRUTHS,
    FieldType,
    parse_fields,
)
from caris_desktop.ros.dialect import Dialect, plain_name
from caris_desktop.simulator.shipped_data import shipped_data

_TIMES = ("time", "duration")
_PRIMITIVES = frozenset({*INTEGER_RANGES, *FLOATS, *TRUTHS, *TEXTS, *_TIMES})


@lru_cache
def _definitions(dialect: Dialect) -> dict[str, list[tuple[FieldType, ...]]]:
    """Parts of each type; the name of a constant is followed by ``=`` and its value."""
    shipped = shipped_data("ros-types.yaml")
    texts = DEFINITION_TEXTS | shipped["both"] | shipped[dialect.name.lower()]
    if dialect is Dialect.ROS1:
        header = "std_msgs/Header header; actionlib_msgs/"
        for name in [type_.removesuffix("Goal") for type_ in texts if type_.endswith("Goal")]:
            texts[f"{name}ActionGoal"] = f"{header}GoalID goal_id; {name}Goal goal"
            texts[f"{name}ActionFeedback"] = f"{header}GoalStatus status; {name}Feedback feedback"
            texts[f"{name}ActionResult"] = f"{header}GoalStatus status; {name}Result result"
    return {name: [parse_fields(part) for part in text.split("---")] for name, text in texts.items()}


def typedefs_of(dialect: Dialect, type_: str, part: int = 0) -> list[dict[str, Any]]:
    """rosapi's TypeDefs of a type and its nested types; empty if unknown.

    ``part``: of a service, request (0) or response (1); of an action, goal, result and feedback.
    """
    typedefs: list[dict[str, Any]] = []
    waiting, seen = [(plain_name(type_), part)], {plain_name(type_)}
    while waiting:
        name, which = waiting.pop(0)
        definition = _part_of(dialect, name, which)
        if definition is None:
            continue
        fields = _fields_of(definition)
        constants = [entry.name.partition("=") for entry in definition if "=" in entry.name]
        typedefs.append({
            "type": name,
            "fieldnames": [entry.name for entry in fields],
            "fieldtypes": [entry.type for entry in fields],
            # as in rosapi: -1 is no array, 0 one of any length
            "fieldarraylen": [-1 if entry.length is None else entry.length for entry in fields],
            "examples": [_example(entry) for entry in fields],
            "constnames": [constant for constant, _, _ in constants],
            "constvalues": [value for _, _, value in constants],
        })  # fmt: skip
        for entry in definition:
            if entry.type not in _PRIMITIVES and entry.type not in seen:
                seen.add(entry.type)
                waiting.append((entry.type, 0))
    return typedefs


def misfit(dialect: Dialect, type_: str, message: Any) -> str | None:
    """Mismatch of ``message`` with its type, for which rosbridge would refuse it; None if there is none.

    ROS fills omitted fields with zero. A type without a definition permits everything.
    """
    return _misfit(dialect, plain_name(type_), message, "")


def cbor_refusal(dialect: Dialect, type_: str, message: dict[str, Any]) -> str | None:
    """Reason why rosbridge cannot encode ``message`` as CBOR; None if it can.

    Its encoder recognises number lists by names such as ``float64[]``. Other names count as messages or lists of
    messages: fixed-length lists, and in ROS 1 also non-empty lists of texts and times.
    """
    for entry in _fields_of(_part_of(dialect, type_)):
        values = message.get(entry.name)
        if entry.length is None:
            items: Sequence[Any] = [values if isinstance(values, dict) else {}]
        else:
            items = values if isinstance(values, (list, tuple)) else []
        if entry.type not in _PRIMITIVES:
            found = (cbor_refusal(dialect, entry.type, item) for item in items if isinstance(item, dict))
            problem = next((refusal for refusal in found if refusal is not None), None)
            if problem is not None:
                return problem
        elif entry.length or (
            entry.length == 0 and items and dialect is Dialect.ROS1 and entry.type in ("string", *_TIMES)
        ):
            return f"{type_}: {entry.name} is a {entry.type}[{entry.length or ''}], and an item of it has no __slots__"
    return None


def is_known(dialect: Dialect, type_: str) -> bool:
    """True if the robot has this type installed."""
    return _part_of(dialect, type_) is not None


def field_names(dialect: Dialect, type_: str) -> list[str]:
    """Field names in order; empty if the type is unknown."""
    return [entry.name for entry in _fields_of(_part_of(dialect, type_))]


def with_defaults(dialect: Dialect, type_: str, message: dict[str, Any]) -> dict[str, Any]:
    """``message`` as ROS passes it on: with zeros in omitted fields."""
    values = blank(dialect, type_) | message
    for entry in _fields_of(_part_of(dialect, type_)):
        value = values[entry.name]
        if entry.length is None and entry.type not in _PRIMITIVES and isinstance(value, dict):
            values[entry.name] = with_defaults(dialect, entry.type, value)
    return values


def blank(dialect: Dialect, type_: str, *, part: int = 0) -> dict[str, Any]:
    """Message with every field zero, false or empty."""
    return {entry.name: _blank(dialect, entry) for entry in _fields_of(_part_of(dialect, type_, part))}


def _blank(dialect: Dialect, entry: FieldType) -> Any:
    if entry.length is not None:
        return []
    if entry.type in _TIMES:
        return {"secs": 0, "nsecs": 0}
    if entry.type not in _PRIMITIVES:
        return blank(dialect, entry.type)
    return {"string": "", "bool": False}.get(entry.type, 0)


def _misfit(dialect: Dialect, name: str, message: Any, where: str) -> str | None:
    definition = _part_of(dialect, name)
    if definition is None:
        return None
    if not isinstance(message, dict):
        return f"{where or name} must be a {name}"
    fields = {entry.name: entry for entry in _fields_of(definition)}
    for key, value in message.items():
        path = f"{where}.{key}" if where else key
        if key not in fields:
            return f"Message type {name} does not have a field {key}"
        entry = fields[key]
        if entry.length is None:
            problem = _misfit_of_one(dialect, entry.type, value, path)
        elif isinstance(value, (bytes, np.ndarray)) or (isinstance(value, str) and entry.type in ("uint8", "char")):
            problem = None  # blobs and typed arrays have their type on the wire
        elif not isinstance(value, (list, tuple)):
            problem = f"{path} must be a list of {entry.type}"
        else:
            problems = (_misfit_of_one(dialect, entry.type, item, f"{path}[{i}]") for i, item in enumerate(value))
            problem = next((found for found in problems if found is not None), None)
        if problem is not None:
            return problem
    return None


def _misfit_of_one(dialect: Dialect, type_: str, value: Any, where: str) -> str | None:
    if type_ in _TIMES:
        fits = isinstance(value, dict) and set(value) <= {"secs", "nsecs"}
    elif type_ == "bool":
        fits = isinstance(value, (bool, np.bool_))
    elif type_ == "string":
        fits = isinstance(value, str)
    elif type_ in FLOATS:
        # rosbridge writes infinity as null, and does not accept null
        fits = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
    elif type_ in _PRIMITIVES:
        fits = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    else:
        return _misfit(dialect, type_, value, where)
    return None if fits else f"{where} must be a {type_}"


def _part_of(dialect: Dialect, type_: str, part: int = 0) -> tuple[FieldType, ...] | None:
    """One part of a definition; None if there is none of that type or number."""
    parts = _definitions(dialect).get(plain_name(type_), [])
    return parts[part] if part < len(parts) else None


def _fields_of(definition: tuple[FieldType, ...] | None) -> list[FieldType]:
    """Fields without constants."""
    return [entry for entry in definition or () if "=" not in entry.name]


def _example(entry: FieldType) -> str:
    if entry.length is not None:
        return "[]"
    if entry.type in FLOATS:
        return "0.0"
    return {"string": "", "bool": "False"}.get(entry.type, "0" if entry.type in _PRIMITIVES else "{}")
