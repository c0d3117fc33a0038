"""JSON form of the domain dataclasses, and the JSON Schema that describes it.

Arrays become lists; values that JSON cannot hold (``inf``, ``nan``) become null, which for scans reads
"nothing returned". Reading null back into a float array gives ``inf``.
"""

import dataclasses
import math
import types
import typing
from enum import Enum
from typing import Any, Literal, TypeVar, get_args, get_origin

import numpy as np

T = TypeVar("T")


def to_jsonable(value: Any) -> Any:
    """Plain dicts, lists, strings and numbers for a domain value."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_jsonable(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        if value.dtype.kind != "f" or bool(np.isfinite(value).all()):
            return value.tolist()
        flat = [item if math.isfinite(item) else None for item in value.ravel().tolist()]
        return flat if value.ndim == 1 else np.array(flat, dtype=object).reshape(value.shape).tolist()
    if isinstance(value, (list, tuple)):
        return [to_jsonable(item) for item in value]
    if isinstance(value, dict):
        return {str(key): to_jsonable(item) for key, item in value.items()}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def from_jsonable(value_type: type[T], data: Any) -> T:
    """The reverse of :func:`to_jsonable`.

    Unknown keys are ignored and missing ones take their defaults, so recordings of neighbouring versions load.

    Raises
    ------
    ValueError
        If the data cannot be a ``value_type``.
    """
    try:
        return typing.cast(T, _build(value_type, data))
    except (TypeError, KeyError) as error:
        raise ValueError(f"not a {getattr(value_type, '__name__', value_type)}: {error}") from error


def json_schema(value_type: type[Any]) -> dict[str, Any]:
    """JSON Schema of one dataclass, self-contained."""
    schema = _schema(value_type)
    schema["title"] = value_type.__name__
    if value_type.__doc__:
        schema["description"] = value_type.__doc__
    return schema


def _build(kind: Any, data: Any) -> Any:
    if kind is Any or kind is type(None):
        return data
    origin = get_origin(kind)
    if origin is Literal:
        if data not in get_args(kind):
            raise ValueError(f"{data!r} is not one of {get_args(kind)}")
        return data
    if origin in (types.UnionType, typing.Union):
        members = [member for member in get_args(kind) if member is not type(None)]
        if data is None:
            return None
        if len(members) == 1:
            return _build(members[0], data)
        return data
    if origin is tuple:
        return tuple(_build(get_args(kind)[0], item) for item in data)
    if origin is list:
        return [_build(get_args(kind)[0], item) for item in data]
    if origin is dict:
        return {key: _build(get_args(kind)[1], item) for key, item in data.items()}
    if origin is np.ndarray:
        dtype = np.dtype(get_args(get_args(kind)[1])[0])
        if dtype.kind == "f":
            return np.array(
                [math.inf if item is None else item for item in data] if None in data else data, dtype=dtype
            )
        return np.array(data, dtype=dtype)
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        if not isinstance(data, dict):
            raise ValueError(f"expected an object, found {type(data).__name__}")
        hints = typing.get_type_hints(kind)
        return kind(**{f.name: _build(hints[f.name], data[f.name]) for f in dataclasses.fields(kind) if f.name in data})
    if kind is float and data is None:
        return math.inf
    if kind is float:
        return float(data)
    return data


_PRIMITIVES = {int: "integer", float: "number", str: "string", bool: "boolean"}


def _schema(kind: Any) -> dict[str, Any]:
    origin = get_origin(kind)
    if kind in _PRIMITIVES:
        return {"type": _PRIMITIVES[kind]}
    if kind is type(None):
        return {"type": "null"}
    if origin is Literal:
        return {"type": "string", "enum": list(get_args(kind))}
    if origin in (types.UnionType, typing.Union):
        return {"anyOf": [_schema(member) for member in get_args(kind)]}
    if origin in (tuple, list):
        return {"type": "array", "items": _schema(get_args(kind)[0])}
    if origin is dict:
        return {"type": "object", "additionalProperties": _schema(get_args(kind)[1])}
    if origin is np.ndarray:
        number = "number" if np.dtype(get_args(get_args(kind)[1])[0]).kind == "f" else "integer"
        return {"type": "array", "items": {"type": [number, "null"] if number == "number" else number}}
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        fields = dataclasses.fields(kind)
        return {
            "type": "object",
            "properties": {field.name: _schema(hints[field.name]) for field in fields},
            "required": [
                field.name
                for field in fields
                if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
            ],
        }
    return {}
