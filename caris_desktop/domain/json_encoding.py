"""Recorded form of values: one JSON message each, with the schema of its channel.

Fields that are None are omitted, so that each field has one type, as programs that turn schemas into columns require; a
missing field reads as None.
"""

import dataclasses
import functools
import typing
from typing import Any, NamedTuple

import numpy as np

from caris_desktop.domain.foxglove import TRANSFORMS, time_of
from caris_desktop.domain.schema import from_jsonable, json_schema, require_recordable, shape_schema, to_jsonable
from caris_desktop.domain.schema_fields import union_members
from caris_desktop.domain.streams import STREAMS, StreamSpec, spec_of_topic

TRANSFORMS_TOPIC = "/tf"
"""Channel for other programs only: its messages follow from values, from which our reader has their content."""


def to_message(spec: StreamSpec, value: Any, *, at_utc_ns: int) -> dict[str, Any]:
    """Message of a value that was measured, or happened, at that time.

    Raises TypeError or ValueError for other values, and for those that could not be read back.
    """
    known, fields = spec.well_known, _fields_of(spec)
    message: dict[str, Any] = {name: to_jsonable(getattr(value, name)) for name in fields.beside}
    _require_readable(spec, value, message)
    if known is not None:
        message = {**known.fill(value, time_of(at_utc_ns)), **message}
    for name in fields.left_out:
        if name in message and message[name] is None:
            del message[name]
    return message


def _require_readable(spec: StreamSpec, value: Any, fields: dict[str, Any]) -> None:
    """Check that the message can be read back. Arrays are checked as they are: inflating a building's map would take
    0.2 s.
    """
    arrays = {name: held for name in _fields_of(spec).every if isinstance(held := getattr(value, name), np.ndarray)}
    beside = {name: to_jsonable(getattr(value, name)) for name in _fields_of(spec).every if name not in fields | arrays}
    from_jsonable(spec.value_type, fields | beside | arrays)


def from_message(spec: StreamSpec, message: Any) -> Any:
    """Value of a message of this version or an older one. Raises ValueError if there is none."""
    if isinstance(message, dict):
        needed = _fields_of(spec).needed
        try:
            restored = {} if spec.well_known is None else spec.well_known.restore(message)
        except (TypeError, KeyError, AttributeError) as error:
            raise ValueError(f"not a message of {spec.name}: {error}") from error
        if needed or restored:
            message = {**dict.fromkeys(needed), **message, **restored}
    return from_jsonable(spec.value_type, message)


def recorded_schema(topic: str) -> tuple[str, dict[str, Any]] | None:
    """Name and JSON Schema of the messages of a topic; None for topics that this program does not write."""
    if topic == TRANSFORMS_TOPIC:
        return transforms_schema()
    spec = spec_of_topic(topic)
    return None if spec is None else schema_of(spec)


def transforms_schema() -> tuple[str, dict[str, Any]]:
    """Name and JSON Schema of the messages on ``TRANSFORMS_TOPIC``."""
    name = "foxglove.FrameTransforms"
    return name, {"title": name, **shape_schema(TRANSFORMS)}


def schema_of(spec: StreamSpec) -> tuple[str, dict[str, Any]]:
    """Name and JSON Schema of a stream's messages."""
    schema, fields = json_schema(spec.value_type), _fields_of(spec)
    properties = dict(schema["properties"])
    for name in fields.left_out:
        kinds = [kind for kind in properties[name].get("anyOf", ()) if kind.get("type") != "null"]
        if kinds:
            properties[name] = kinds[0] if len(kinds) == 1 else {"anyOf": kinds}
    required = [name for name in schema["required"] if name not in fields.left_out]
    name = f"caris.{spec.value_type.__name__}"
    if spec.well_known is not None:
        name, shape = spec.well_known.name, shape_schema(spec.well_known.shape)
        properties = {**shape["properties"], **{field: properties[field] for field in fields.beside}}
        required = [*shape["required"], *(field for field in required if field in fields.beside)]
    return name, _for_viewers({**schema, "title": name, "properties": properties, "required": required})


_PLAIN_TYPES = ("boolean", "string", "number", "integer", "object")


def _for_viewers(schema: dict[str, Any]) -> dict[str, Any]:
    """Equivalent schema with only fields of one type under ``properties``: viewers reject a channel with others.

    Fields of several types and nested lists are under ``patternProperties``.
    """
    if schema.get("type") == "array":
        return {**schema, "items": _for_viewers(schema["items"])} if "items" in schema else schema
    if schema.get("type") != "object":
        return schema
    fields = {name: _for_viewers(field) for name, field in schema.get("properties", {}).items()}
    others = {f"^{name}$": field for name, field in fields.items() if not _has_one_type(field)}
    plain = {name: field for name, field in fields.items() if _has_one_type(field)}
    return {**schema, "properties": plain, **({"patternProperties": others} if others else {})}


def _has_one_type(schema: dict[str, Any]) -> bool:
    kind = schema.get("items", {}).get("type") if schema.get("type") == "array" else schema.get("type")
    return kind in _PLAIN_TYPES


class _Fields(NamedTuple):
    """Our fields: ``every`` one; the ``beside`` ones in addition to a well-known schema; the ``left_out`` ones if None;
    and of these those without a default, ``needed`` to construct a value.
    """

    every: tuple[str, ...]
    beside: tuple[str, ...]
    left_out: tuple[str, ...]
    needed: tuple[str, ...]


def _fields_of(spec: StreamSpec) -> _Fields:
    kind: Any = spec.value_type
    return _found_fields(kind, frozenset() if spec.well_known is None else spec.well_known.holds)


@functools.cache
def _found_fields(kind: Any, held: frozenset[str]) -> _Fields:
    hints, missing = typing.get_type_hints(kind), dataclasses.MISSING
    fields = dataclasses.fields(kind)
    needed = [field.name for field in fields if field.default is missing and field.default_factory is missing]
    left_out = [
        field.name
        for field in fields
        if _may_be_none(hints[field.name]) and (field.default is None or field.name in needed)
    ]
    every = tuple(field.name for field in fields)
    return _Fields(
        every,
        tuple(name for name in every if name not in held),
        tuple(left_out),
        tuple(name for name in left_out if name in needed),
    )


def _may_be_none(kind: Any) -> bool:
    return kind is Any or type(None) in union_members(kind)


# Checked at the start, not at the first value: a library update may declare its types differently.
require_recordable(*(spec.value_type for spec in STREAMS))
