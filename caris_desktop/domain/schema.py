"""JSON form of the domain dataclasses, and their JSON Schema.

Arrays of numbers become lists, and grids (integer arrays) an object with their deflated bytes: a building's map would
be tens of megabytes of digits. Values that JSON lacks become null, which in arrays means ``inf`` (in scans: no
return); ``nan`` in an array (in scans: invalid) is the text "nan".

msgspec writes an odometry value in 1 µs where this takes 25 and reads it in 1 where this takes 15, a scan in a third
and a sixth of the time; at some hundred values per second that is under a percent of a core. But it does not read null
as infinite, accepts whole numbers of any size, and its schemas refer to one another where these are self-contained.
"""

import base64
import binascii
import dataclasses
import functools
import inspect
import math
import typing
import zlib
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Any, Literal, NewType, TypeVar, get_args, get_origin

import numpy as np

from caris_desktop.domain.schema_fields import union_members, without_alias
from caris_desktop.domain.translation import LocalizedText

T = TypeVar("T")
_NAN = "nan"
Base64 = NewType("Base64", str)
"""Bytes as base64."""
PLAIN_BYTES = "base64"
"""Encoding of a grid whose bytes are not deflated."""


def to_jsonable(value: Any) -> Any:
    """Plain dicts, lists, strings and numbers of a domain value."""
    # Most values by far; a session's status messages alone have a thousand per minute.
    if value is None or type(value) in (str, int, bool):
        return value
    if type(value) is float:
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {str(key): to_jsonable(item) for key, item in value.items()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_jsonable(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        if value.dtype.kind in "iu":
            return _deflated(value)
        if value.dtype == np.float32:
            value = in_few_digits(value)
        if value.dtype.kind != "f" or bool(np.isfinite(value).all()):
            return value.tolist()
        flat = [item if math.isfinite(item) else _NAN if math.isnan(item) else None for item in value.ravel().tolist()]
        return flat if value.ndim == 1 else np.array(flat, dtype=object).reshape(value.shape).tolist()
    if isinstance(value, (list, tuple)):
        return [to_jsonable(item) for item in value]
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str.__str__(value) if isinstance(value, str) else value  # plain text of a translatable text


def from_jsonable(value_type: type[T], data: Any) -> T:
    """The reverse of :func:`to_jsonable`.

    Unknown keys are ignored and missing ones take their defaults, so that recordings of neighbouring versions load.
    Nothing is converted: a text is neither number nor list, whole numbers have at most 64 bits. An array whose field
    has a ``shape`` in its metadata (-1: any size) must match it.

    Raises ValueError if the data cannot be a ``value_type``. Raises TypeError if no recorded form is known for
    ``value_type``.
    """
    kind: Any = value_type
    build = _builder(kind)
    try:
        return typing.cast(T, build(data))
    except (TypeError, KeyError, AttributeError, OverflowError) as error:
        raise ValueError(f"not a {getattr(value_type, '__name__', value_type)}: {error}") from error


def require_recordable(*value_types: Any) -> None:
    """Raise TypeError, with the location, for a type without a recorded form."""
    for value_type in value_types:
        _builder(value_type)


def json_schema(value_type: type[Any]) -> dict[str, Any]:
    """JSON Schema of one dataclass, self-contained."""
    schema = shape_schema(value_type)
    schema["title"] = value_type.__name__
    if value_type.__doc__:
        # Python 3.13 removes the indentation itself; a session must not depend on the Python version.
        schema["description"] = inspect.cleandoc(value_type.__doc__)
    return schema


@functools.cache
def _builder(kind: Any) -> Callable[[Any], Any]:
    """Constructor of values of ``kind``, cached: analysing the type takes longer than building a value.

    Raises TypeError for a type without a recorded form, since anything would be accepted for it.
    """
    kind = without_alias(kind)
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return lambda data: data
    if kind is float:
        return _number
    if kind in (int, str, bool):
        return functools.partial(_plain, kind)
    if kind is Path:
        return lambda data: Path(_plain(str, data))
    if origin is Literal:
        return functools.partial(_one_of, arguments)
    if origin in (tuple, list):
        item = _builder(_only_item(kind))
        return lambda data: origin(map(item, _items(data)))
    if origin is dict and arguments[0] is str:
        item = _builder(arguments[1])
        return lambda data: {key: item(value) for key, value in _object(data).items()}
    if dtype := array_dtype(kind):
        return functools.partial(_array, dtype)
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        return _record_builder(kind)
    if members := union_members(kind):
        some = [member for member in members if member is not type(None)]
        if len(some) == 1:
            build = _builder(some[0])
        elif set(some) <= set(_PRIMITIVES):
            build = functools.partial(_plain_of_several, tuple(some))
        else:
            raise TypeError(f"a recorded value of {kind} would be ambiguous")
        return build if len(some) == len(members) else lambda data: None if data is None else build(data)
    raise TypeError(f"no encoding is defined for {kind}")


def array_dtype(hint: Any) -> "np.dtype[Any] | None":
    """Number type of an array; None for other type hints.

    Raises TypeError if the array's type is undetermined, or neither integer nor floating-point.
    """
    hint = without_alias(hint)
    if hint is not np.ndarray and get_origin(hint) is not np.ndarray:
        return None
    _, numbers = (*map(without_alias, get_args(hint)), None, None)[:2]
    scalar = without_alias(next(iter(get_args(numbers)), None))
    if get_origin(numbers) is not np.dtype or not isinstance(scalar, type) or not issubclass(scalar, np.generic):
        raise TypeError(f"{hint} does not state the type of its numbers")
    dtype = np.dtype(scalar)
    if dtype.kind not in "iuf":
        raise TypeError(f"no encoding is defined for {hint}")
    return dtype


def _only_item(kind: Any) -> Any:
    """Item type of a list or tuple; a tuple of several types has no recorded form."""
    items = {without_alias(item) for item in get_args(kind) if item is not Ellipsis}
    if len(items) != 1:
        raise TypeError(f"no encoding is defined for {kind}")
    return items.pop()


def _plain(kind: type[Any], data: Any) -> Any:
    """Checked plain value: a text as a timestamp, say, would break arithmetic."""
    if type(data) is not kind and not (kind is str and type(data) is LocalizedText):
        raise ValueError(f"expected {_PRIMITIVES[kind]}, found {type(data).__name__}")
    if kind is int and not _LEAST_WHOLE <= data <= _LARGEST_WHOLE:
        raise ValueError(f"an integer of {data.bit_length()} bits is too large")
    return data


def _number(data: Any) -> float:
    if data is None:
        return math.inf
    if type(data) is not float and type(data) is not int:
        raise ValueError(f"expected number, found {type(data).__name__}")
    number = float(data)
    if math.isnan(number):
        raise ValueError("NaN is only allowed in arrays")
    return number


def _plain_of_several(kinds: tuple[type[Any], ...], data: Any) -> Any:
    if type(data) in kinds and type(data) is not float:
        return _plain(type(data), data)
    if float in kinds:
        return _number(data)
    raise ValueError(f"expected {' or '.join(_PRIMITIVES[kind] for kind in kinds)}, found {type(data).__name__}")


def _items(data: Any) -> list[Any] | tuple[Any, ...]:
    """Checked list: a text, too, is iterable."""
    if not isinstance(data, (list, tuple)):
        raise ValueError(f"expected a list, found {type(data).__name__}")  # noqa: TRY004 - what from_jsonable raises
    return data


def _object(data: Any) -> dict[str, Any]:
    if not isinstance(data, dict):
        raise ValueError(f"expected an object, found {type(data).__name__}")  # noqa: TRY004 - likewise
    return data


def _one_of(permitted: tuple[Any, ...], data: Any) -> Any:
    if data not in permitted:
        raise ValueError(f"{data!r} is not one of {permitted}")
    return data


def _array(dtype: np.dtype[Any], data: Any) -> np.ndarray[Any, Any]:
    """Array of its JSON form, or of an array to be written."""
    if isinstance(data, dict):
        return _inflated(data, dtype)
    if isinstance(data, np.ndarray):
        if data.dtype != dtype and (data.dtype.kind, dtype.kind) != ("f", "f"):
            raise ValueError(f"expected an array of {dtype.name}, found {data.dtype.name}")
        return data
    data = _items(data)
    if not data:
        return np.array((), dtype=dtype)
    if dtype.kind == "f":
        data = _with_what_json_cannot_hold(data)
    found = np.array(data)
    if found.dtype.kind not in ("iuf" if dtype.kind == "f" else "iu"):
        raise ValueError(f"expected numbers for an array of {dtype.name}")
    if dtype.kind != "f":
        limits = np.iinfo(dtype)
        if found.size and not (limits.min <= int(found.min()) and int(found.max()) <= limits.max):
            raise ValueError(f"a number is too large for an array of {dtype.name}")
    with np.errstate(over="ignore"):
        # What overflows float32 is infinite.
        return found.astype(dtype)


def _with_what_json_cannot_hold(data: Any) -> Any:
    if isinstance(data[0], list):
        return [_with_what_json_cannot_hold(_items(row)) if row else row for row in data]
    if None in data or _NAN in data:
        return [math.inf if item is None else math.nan if item == _NAN else item for item in data]
    return data


def _of_shape(shape: tuple[int, ...], build: Callable[[Any], Any], data: Any) -> Any:
    array = build(data)
    if array is None:
        return array
    if array.shape == (0,):
        return array.reshape([max(0, size) for size in shape])
    fits = len(array.shape) == len(shape) and all(
        expected in (-1, size) for expected, size in zip(shape, array.shape, strict=True)
    )
    if not fits:
        raise ValueError(f"expected an array of shape {shape}, found {array.shape}")
    return array


# What needs no builder, by type: a recording has thousands of values per minute, most of them numbers.
_UNCHANGED = {
    float: "{0} if type({0} := data[{1!r}]) is float and {0} - {0} == 0.0",
    str: "{0} if type({0} := data[{1!r}]) is str",
    bool: "{0} if type({0} := data[{1!r}]) is bool",
    int: "{0} if type({0} := data[{1!r}]) is int and {2} <= {0} <= {3}",
}


def _record_builder(kind: Any) -> Callable[[Any], Any]:
    """Constructor of a dataclass, compiled at its first use."""
    hints, builders = typing.get_type_hints(kind), _field_builders(kind)

    @functools.cache
    def compiled() -> Callable[[Any], Any]:
        names: dict[str, Any] = {"kind": kind, "as_object": _object}
        lines = ["def build(data):", " data = data if type(data) is dict else as_object(data)", " given = {}"]
        for number, (name, build) in enumerate(builders.items()):
            names[f"b{number}"] = build
            made = f"b{number}(data[{name!r}])"
            some = [one for one in union_members(hints[name]) if one is not type(None)] or [without_alias(hints[name])]
            if len(some) == 1 and (short := _UNCHANGED.get(some[0])):
                made = f"{short.format(f'v{number}', name, _LEAST_WHOLE, _LARGEST_WHOLE)} else b{number}(v{number})"
            lines.append(f" if {name!r} in data: given[{name!r}] = {made}")
        exec("\n".join([*lines, " return kind(**given)"]), names)  # noqa: S102 - of our own fields
        build_one: Callable[[Any], Any] = names["build"]
        return build_one

    def build_when_used(data: Any) -> Any:
        return compiled()(data)

    return build_when_used


def _field_builders(kind: Any) -> dict[str, Callable[[Any], Any]]:
    hints, builders = typing.get_type_hints(kind), {}
    for field in dataclasses.fields(kind):
        try:
            build = _builder(hints[field.name])
        except TypeError as error:
            raise TypeError(f"{kind.__name__}.{field.name}: {error}") from error
        shape = field.metadata.get("shape")
        builders[field.name] = build if shape is None else functools.partial(_of_shape, shape, build)
    return builders


def in_few_digits(value: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Same numbers as float64 with the fewest decimals that identify them: 1.234 instead of 1.2339999675750732."""
    wide = value.astype(np.float64)
    for decimals in (3, 5, 8):
        short = np.round(wide, decimals)
        if np.array_equal(short.astype(np.float32), value, equal_nan=True):
            return short
    return wide


def _deflated(grid: np.ndarray[Any, Any]) -> dict[str, Any]:
    content = np.ascontiguousarray(grid)
    return {
        "encoding": _DEFLATED_BYTES,
        "dtype": content.dtype.name,
        "shape": list(content.shape),
        "data": base64.b64encode(zlib.compress(content.data, 1)).decode("ascii"),
    }


def _inflated(data: dict[str, Any], dtype: np.dtype[Any]) -> np.ndarray[Any, Any]:
    """Inflated array. Raises ValueError if the content does not match ``shape`` and ``dtype``, however large it would
    inflate.
    """
    shape = tuple(_plain(int, size) for size in _items(data["shape"]))
    encoding = data.get("encoding")
    if encoding not in _GRID_ENCODINGS or data.get("dtype") != dtype.name or min(shape, default=0) < 0:
        raise ValueError(f"expected a grid of {dtype.name} as {' or '.join(_GRID_ENCODINGS)}")
    size_bytes = math.prod(shape) * dtype.itemsize
    if size_bytes > _LARGEST_GRID_BYTES:
        raise ValueError(f"a grid of {size_bytes} bytes is too large")
    try:
        content = base64.b64decode(data["data"], validate=True)
        if encoding != PLAIN_BYTES:
            content = zlib.decompressobj().decompress(content, size_bytes + 1)
    except (binascii.Error, zlib.error) as error:
        raise ValueError(f"a grid that cannot be decompressed: {error}") from error
    if len(content) != size_bytes:
        raise ValueError(f"expected a grid of {size_bytes} bytes for its shape, found {len(content)}")
    return np.frombuffer(content, dtype=dtype).reshape(shape)


_DEFLATED_BYTES = "zlib+base64"
_GRID_ENCODINGS = (_DEFLATED_BYTES, PLAIN_BYTES)
_LARGEST_GRID_BYTES = 2**30
_LEAST_WHOLE, _LARGEST_WHOLE = -(2**63), 2**63 - 1
_GRID_SCHEMA = {
    "type": "object",
    "description": "A grid: rows of integers as little-endian bytes, compressed with zlib, in base64.",
    "properties": {
        "encoding": {"type": "string", "const": _DEFLATED_BYTES},
        "dtype": {"type": "string"},
        "shape": {"type": "array", "items": {"type": "integer"}},
        "data": {"type": "string", "contentEncoding": "base64"},
    },
    "required": ["encoding", "dtype", "shape", "data"],
}
_PRIMITIVES = {int: "integer", float: "number", str: "string", bool: "boolean"}


def shape_schema(kind: Any) -> dict[str, Any]:
    """JSON Schema of a type: a dataclass, a type of its fields, a list with one, or a dict with those of its keys."""
    if isinstance(kind, dict):
        properties = {name: shape_schema(each) for name, each in kind.items()}
        return {"type": "object", "properties": properties, "required": list(kind)}
    if isinstance(kind, list):
        return {"type": "array", "items": shape_schema(kind[0])}
    kind = without_alias(kind)
    origin, arguments = get_origin(kind), get_args(kind)
    if kind in _PRIMITIVES:
        return {"type": _PRIMITIVES[kind]}
    if kind is Path:
        return {"type": "string"}
    if kind is Any:
        return {}
    if kind is Base64:
        return {"type": "string", "contentEncoding": "base64"}
    if kind is type(None):
        return {"type": "null"}
    if origin is Literal:
        return {"type": "string", "enum": list(arguments)}
    if members := union_members(kind):
        return {"anyOf": [shape_schema(member) for member in members]}
    if origin in (tuple, list):
        return {"type": "array", "items": shape_schema(_only_item(kind))}
    if origin is dict and arguments[0] is str:
        return {"type": "object", "additionalProperties": shape_schema(arguments[1])}
    if dtype := array_dtype(kind):
        return (
            {"type": "array", "items": {"anyOf": [{"type": ["number", "null"]}, {"const": _NAN}]}}
            if dtype.kind == "f"
            else _GRID_SCHEMA
        )
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        fields = dataclasses.fields(kind)
        return {
            "type": "object",
            "properties": {field.name: _field_schema(field, hints[field.name]) for field in fields},
            "required": [
                field.name
                for field in fields
                if field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
            ],
        }
    raise TypeError(f"no encoding is defined for {kind}")


def _field_schema(field: "dataclasses.Field[Any]", kind: Any) -> dict[str, Any]:
    schema = shape_schema(kind)
    if schema.get("type") == "array":
        # Arrays of more than one dimension are nested lists.
        for _ in field.metadata.get("shape", ())[1:]:
            schema = {"type": "array", "items": schema}
    return schema
