"""Columns of tidy tables, derived from value types: name, unit, type and meaning.

Long because it holds the whole mapping from types to columns.
"""

import dataclasses
import functools
import itertools
import json
import re
import typing
from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import Enum
from operator import attrgetter
from typing import Any, Literal, NamedTuple, get_args, get_origin

import numpy as np

from caris_desktop.domain.schema import array_dtype, to_jsonable
from caris_desktop.domain.schema_fields import union_members, without_alias
from caris_desktop.domain.streams import StreamSpec
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.robot_clock_mapping import Measured, RobotClock
from caris_desktop.recording.session.session_header import SessionClock
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.tables.meanings import Meaning, meaning_of, split_docstring

# Units of columns and measures, from the ends of their names.

_UNITS = {
    "ns": "ns",
    "ms": "ms",
    "s": "s",
    "m": "m",
    "mm": "mm",
    "mps": "m/s",
    "rad": "rad",
    "radps": "rad/s",
    "px": "px",
    "hz": "Hz",
    "bytes": "bytes",
    "fraction": "0-1",
    "confidence": "0-1",
}
_WHOLE_NAMES = {"confidence": "0-1", "fps": "1/s", "minutes": "min", "runner_up": "0-1", "turn_over": "0-1"}


def unit_of(name: str) -> str:
    """SI symbol, ``0-1`` for shares and probabilities; empty for counts, texts and names without a unit."""
    if name in _WHOLE_NAMES:
        return _WHOLE_NAMES[name]
    match name.split("_"):
        case [*_, "per", "10", "min"]:
            return "1/10 min"
        case [*_, "edit", "distance"]:
            return "characters"
        case [*_, amount, "per", "s"]:
            return f"{_UNITS[amount]}/s"
        case [_, *_, last]:
            return _UNITS.get(last, "")
    return ""


Kind = Literal[
    "integer",
    "number",
    "text",
    "true or false",
    "json",
    "utc",
    "integers",
    "numbers",
    "texts",
    "points",
    "cells",
    "depths",
]
"""What the values of a column are in Python: utc is nanoseconds since 1970; numbers, points, cells (int8) and depths
(uint16) are arrays.
"""
ClockName = Literal["", "session", "UTC", "robot"]
_NOT_GIVEN = "Nothing was entered."
_NOT_IN_CSV = "Left out of CSV files, because it is large."

# Columns before or after those of a value's own fields, here or in one of the formats.
_RESERVED = (
    "session",
    "participant",
    "condition",
    "trial",
    "session_s",
    "utc",
    "stamp_ns",
    "arrived_session_s",
    "number",
)
# Seconds that were computed from nanoseconds.
_COMPUTED_S = ("duration_s", "late_s", "seen_s", "stood_s", "time_s")
_HALVES = re.compile("[\ud800-\udfff]")


class RowTimes(Value):
    """Turns stamps into what columns show."""

    clock: SessionClock
    robot: RobotClock

    def session_s(self, stamps_ns: Iterable[int | None]) -> list[float | None]:
        started_ns = self.clock.started_ns
        return [None if at_ns is None else _to_microseconds_s(at_ns - started_ns) for at_ns in stamps_ns]

    def utc_ns(self, stamps_ns: Iterable[int]) -> list[int]:
        utc_minus_stamp_ns = self.clock.anchor.utc_ns_at(0)
        return [stamp_ns + utc_minus_stamp_ns for stamp_ns in stamps_ns]

    def measured_session_s(self, values: Iterable[Any]) -> list[float | None]:
        return self.session_s(None if found is None else found.stamp_ns for found in self._measured(values))

    def measured_uncertainty_s(self, values: Iterable[Any]) -> list[float | None]:
        bounds_ns = (None if found is None else found.uncertainty_ns for found in self._measured(values))
        return [None if bound_ns is None else _to_microseconds_s(bound_ns) for bound_ns in bounds_ns]

    def _measured(self, values: Iterable[Any]) -> Iterator[Measured | None]:
        return (_measured(self.robot, value.robot_stamp_ns, value.stamp_ns) for value in values)


def _to_microseconds_s(ns: int) -> float:
    """Same as ``round(ns / 1e9, 6)`` within 100 days, faster except for halves of a microsecond and negative times."""
    return round(ns / 1e9, 6) if ns % 1000 == 500 or ns < 0 else (ns + 500) // 1000 / 1e6


@functools.lru_cache(maxsize=5_000)
def _measured(robot: RobotClock, robot_stamp_ns: int | None, arrival_ns: int) -> Measured | None:
    """Remembered for a batch of rows: two columns show it."""
    return robot.measured(robot_stamp_ns, arrival_ns=arrival_ns)


class Moment(NamedTuple):
    """When the value of a row was, and when it reached the console; ``arrival_ns`` is None for derived values."""

    stamp_ns: int
    arrival_ns: int | None = None


class Column(Value):
    """One column. ``read`` takes the value of a row, in time columns its moment; ``convert`` turns the results for many
    rows into cells, where these depend on clocks. ``clock`` is the one that a time is told by. ``values`` are all that
    a text may have, ``empty`` is the meaning of an empty cell, or empty if there is none. ``field`` is the field of a
    message in events.mcap that it shows as it is.
    """

    name: str
    unit: str
    kind: Kind
    description: str
    read: Callable[[Any], Any]
    clock: ClockName = ""
    values: tuple[str, ...] = ()
    empty: str = ""
    field: str = ""
    convert: Callable[[RowTimes, list[Any]], list[Any]] | None = None

    def cells(self, rows: Iterable[Any], times: RowTimes) -> list[Any]:
        found = list(map(self.read, rows))
        return found if self.convert is None else self.convert(times, found)


class Table(Value):
    """One table. ``items`` gives the values of the rows that one recorded value makes.

    ``time_columns`` precede the others, and tell when that value was.
    """

    name: str
    description: str
    own_columns: tuple[Column, ...]
    items: Callable[[Any], Iterable[Any]] = lambda value: (value,)
    time_columns: tuple[Column, ...] = ()

    @property
    def columns(self) -> tuple[Column, ...]:
        return self.time_columns + self.own_columns

    def only(self, names: Sequence[str]) -> "Table":
        """The table with these columns."""
        own, time = (
            tuple(column for column in columns if column.name in names)
            for columns in (self.own_columns, self.time_columns)
        )
        return dataclasses.replace(self, own_columns=own, time_columns=time)

    def cells(self, rows: Sequence[tuple[Moment, Any]], times: RowTimes) -> list[list[Any]]:
        """Cells by column of rows, each given as its moment and value."""
        moments, values = zip(*rows, strict=True) if rows else ((), ())
        return [
            *(column.cells(moments, times) for column in self.time_columns),
            *(column.cells(values, times) for column in self.own_columns),
        ]


def key_columns(session: Session) -> tuple[Column, ...]:
    """Leading columns of every row, in formats whose files are joined across sessions."""
    trial = session.trial
    columns = (
        ("session", "Name of the recording's folder.", session.folder.name, ""),
        ("participant", "Code of the participant, as entered at the start.", trial.get("participant", ""), _NOT_GIVEN),
        ("condition", "Experimental condition, as entered at the start.", trial.get("condition", ""), _NOT_GIVEN),
        ("trial", "Number or name of the trial, as entered at the start.", trial.get("trial", ""), _NOT_GIVEN),
    )
    return tuple(_constant(name, text, plain_text(value), empty) for name, text, value, empty in columns)


def key_values(session: Session) -> dict[str, Any]:
    """Values of the key columns, the same in every row."""
    return {column.name: column.read(None) for column in key_columns(session)}


def _constant(name: str, description: str, value: str, empty: str) -> Column:
    return Column(name, "", "text", description, lambda _row: value, empty=empty)


TIME_COLUMNS = (
    Column(
        "session_s",
        "s",
        "number",
        "Time since the start of the session; negative: known before the start.",
        attrgetter("stamp_ns"),
        "session",
        convert=RowTimes.session_s,
    ),
    Column(
        "utc",
        "",
        "utc",
        "The same time in UTC, from the clock of this computer at the start of the session.",
        attrgetter("stamp_ns"),
        "UTC",
        convert=RowTimes.utc_ns,
    ),
    Column(
        "stamp_ns",
        "ns",
        "integer",
        "The same time on the session's monotonic clock, for joining tables.",
        attrgetter("stamp_ns"),
        "session",
    ),
)
STREAM_TIME_COLUMNS = (
    *TIME_COLUMNS,
    Column(
        "arrived_session_s",
        "s",
        "number",
        "Arrival time at the console, since the start of the session; rows are in this order.",
        attrgetter("arrival_ns"),
        "session",
        convert=RowTimes.session_s,
    ),
)


def tables_of(spec: StreamSpec) -> tuple[Table, ...]:
    """Table of one stream, and one for each of its fields that holds a list of records."""
    name = spec.name.replace("/", "_")
    columns = tuple(_columns(spec.value_type))
    held = () if spec.well_known is None else spec.well_known.holds
    columns = tuple(
        dataclasses.replace(column, field="") if column.field.partition(".")[0] in held else column
        for column in columns
    )
    tables = [Table(name, _doc(spec.value_type)[0], columns, time_columns=STREAM_TIME_COLUMNS)]
    for field, hint in _fields(spec.value_type):
        item_type = _record_list(hint)
        if item_type is not None:
            tables.append(_list_table(name, field, item_type))
    return tuple(tables)


def plain_text(text: str) -> str:
    """``text`` without lone surrogates, which JSON can hold and UTF-8 cannot."""
    return text if text.isascii() else _HALVES.sub("\N{REPLACEMENT CHARACTER}", text)


def one_line(text: str) -> str:
    """Printable characters of ``text``, with single spaces."""
    printable = "".join(character if character.isprintable() else " " for character in plain_text(text))
    return " ".join(printable.split())


# Columns from the fields of dataclasses


def derived_columns(value_type: type[Any], names: str, docs: dict[str, str]) -> tuple[Column, ...]:
    """Columns of a derived value: ``name`` of an attribute, or ``name=path`` of one that is called otherwise there.

    ``docs``: meanings that the docstring of ``value_type`` leaves out.
    """
    columns: list[Column] = []
    for entry in names.split():
        name, _, path = entry.partition("=")
        hint: Any = value_type
        for part in (path or name).split("."):
            owner, found = hint, getattr(hint, part, None)
            hints = typing.get_type_hints(found.fget if isinstance(found, property) else hint)
            hint = without_alias(hints["return" if isinstance(found, property) else part])
        meaning = meaning_of(owner.__name__, name, _doc(owner)[1] | docs) or _no_meaning(name)
        columns += _columns_of_field((name,), hint, meaning, item=False, at=path or name)
    return tuple(
        dataclasses.replace(column, field="", read=_rounded(column.read) if column.name in _COMPUTED_S else column.read)
        for column in columns
    )


def _columns(
    value_type: type[Any],
    path: tuple[str, ...] = (),
    *,
    item: bool = False,
    at: str = "",
    within: Callable[[Any], Any] | None = None,
    outer: Meaning | None = None,
) -> Iterator[Column]:
    """Columns of the fields of ``value_type``, which begin with ``path``. The fields are attributes ``at`` the value of
    a row, or at the record that ``within`` reads from it, and are empty where that is None.

    An ``item`` of a list also gets columns for its time and its own lists. ``outer``: meaning of the whole record.
    """
    docs = _doc(value_type)[1]
    for name, hint in _fields(value_type):
        if path or item or name != "stamp_ns":
            meaning = meaning_of(value_type.__name__, name, docs) or _no_meaning(name)
            if outer is not None:
                text = f"{outer.text.removesuffix('.')}: {meaning.text.removesuffix('.')}."
                meaning = Meaning(text, outer.empty or meaning.empty)
            yield from _columns_of_field((*path, name), hint, meaning, item=item, at=f"{at}{name}", within=within)


def _columns_of_field(
    path: tuple[str, ...],
    hint: Any,
    meaning: Meaning,
    *,
    item: bool,
    at: str,
    within: Callable[[Any], Any] | None = None,
) -> Iterator[Column]:
    name, field = "_".join(path), ".".join(path)
    if name in _RESERVED:
        name = f"value_{name}"
    read = _reader(at, within)
    some = [member for member in union_members(hint) if member is not type(None)]
    hint, optional = some[0] if len(some) == 1 else hint, type(None) in union_members(hint)
    unit = unit_of(name)
    may_be_empty = optional or hint in (str, Any) or str in some or "" in get_args(hint)
    if optional and not meaning.empty:
        meaning = Meaning(meaning.text, "Not recorded.")
    elif not may_be_empty and len(path) == 1:
        meaning = Meaning(meaning.text)
    text, empty = meaning
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        at, within = ("", read) if optional else (f"{at}.", within)
        yield from _columns(hint, path, item=item, at=at, within=within, outer=meaning)
    elif _record_list(hint) is not None and len(path) == 1 and not item:
        yield Column(
            f"{name}_count", "", "integer", f"Number of entries; each is a row of the table of {name}.",
            lambda row: None if (records := read(row)) is None else len(records), empty=empty,
        )  # fmt: skip
    elif dtype := array_dtype(hint):
        yield from _columns_of_array(name, unit, dtype, read, field)
    elif name == "robot_stamp_ns" and not item:
        yield from _columns_of_robot_stamp(unit, read)
    else:
        kind, values, written = _kind(hint)
        is_time = unit == "ns" and not name.endswith("_uncertainty_ns")
        clock: ClockName = "" if not is_time else "robot" if path[-1].startswith("robot_") else "session"
        of_enum = isinstance(hint, type) and issubclass(hint, Enum)
        yield Column(
            name, unit, kind, f"{text} {written}".strip(),
            (lambda row: _plain(read(row))) if of_enum else read, clock, values, empty, field,
        )  # fmt: skip
        if clock == "session":
            yield Column(
                f"{name.removesuffix('_ns')}_session_s",
                "s",
                "number",
                f"{text.removesuffix('.')}; since the start of the session.",
                read,
                clock,
                empty=empty,
                convert=RowTimes.session_s,
            )


def _no_meaning(name: str) -> Meaning:
    """Meaning of a field that nothing explains."""
    return Meaning(_in_words(name, unit_of(name)))


def _columns_of_robot_stamp(unit: str, read: Callable[[Any], Any]) -> Iterator[Column]:
    yield Column(
        "robot_stamp_ns",
        unit,
        "integer",
        "Timestamp that the robot gave to the message, on the robot's clock.",
        read,
        "robot",
        empty="The robot sent none.",
        field="robot_stamp_ns",
    )
    yield Column(
        "measured_session_s",
        "s",
        "number",
        (
            "Measurement time, since the start of the session: the robot's timestamp minus the offset of its clock. "
            "session_s gives the arrival time."
        ),
        _itself,
        "session",
        empty="The offset is unknown.",
        convert=RowTimes.measured_session_s,
    )
    yield Column(
        "measured_uncertainty_s",
        "s",
        "number",
        "Bound of the error of measured_session_s (plus or minus).",
        _itself,
        empty="The offset is unknown.",
        convert=RowTimes.measured_uncertainty_s,
    )


def _columns_of_array(
    name: str, unit: str, dtype: "np.dtype[Any]", read: Callable[[Any], Any], field: str
) -> Iterator[Column]:
    points = name.startswith("points_") or "_points_" in name
    plain_kind: Kind = "cells" if dtype.itemsize == 1 else "depths"
    kind: Kind = plain_kind if dtype.kind in "iu" else "points" if points else "numbers"
    yield Column(
        f"{name}_shape", "", "integers", f"Number of values in {name}; for a grid rows and columns, for points their "
            "number and coordinates.",
        lambda row: None if (array := read(row)) is None else list(array.shape),
    )  # fmt: skip
    yield Column(
        f"{name}_min", unit, "number", f"The smallest finite value in {name}.", lambda row: _smallest(read(row)),
        empty="There is no finite value.",
    )  # fmt: skip
    description, empty = {
        "cells": ("The grid row by row, from its origin: -1 unknown, 0 free to 100 occupied.", _NOT_IN_CSV),
        "depths": ("The depths row by row, from the upper left; 0 if unknown.", _NOT_IN_CSV),
        "points": ("The points, as x and y in metres.", "There are no points."),
        "numbers": ("One value for each beam; inf: no return, nan: invalid.", "The device sends none."),
    }[kind]
    yield Column(name, unit, kind, description, read, empty=empty, field=field)


def _fields(value_type: type[Any]) -> list[tuple[str, Any]]:
    hints = typing.get_type_hints(value_type)
    return [(field.name, without_alias(hints[field.name])) for field in dataclasses.fields(value_type)]


def _record_list(hint: Any) -> type[Any] | None:
    if get_origin(hint) not in (tuple, list):
        return None
    item = without_alias(get_args(hint)[0])
    return item if isinstance(item, type) and dataclasses.is_dataclass(item) else None


class _Entry(NamedTuple):
    """Row of the table of a list field."""

    number: int
    value: Any


def _list_table(parent: str, field: str, item_type: type[Any]) -> Table:
    columns = (
        dataclasses.replace(column, field=f"{field}[].{column.field}" if column.field else "")
        for column in _columns(item_type, item=True, at="value.")
    )
    index = Column("number", "", "integer", f"Position among the {field} of this time, from 1.", attrgetter("number"))
    return Table(
        f"{parent}_{field}",
        f"One row per entry of {field} in {parent}. {_doc(item_type)[0]}".strip(),
        (index, *columns),
        lambda value: itertools.starmap(_Entry, enumerate(getattr(value, field) or (), start=1)),
        STREAM_TIME_COLUMNS,
    )


def _itself(value: Any) -> Any:
    return value


def _rounded(read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Reader of seconds, to the microsecond."""
    return lambda value: None if (number := read(value)) is None else round(number, 6)


def _reader(at: str, within: Callable[[Any], Any] | None) -> Callable[[Any], Any]:
    """Reader of a nested field."""
    read = attrgetter(at)
    if within is None:
        return read
    return lambda value: None if (record := within(value)) is None else read(record)


def _in_words(name: str, unit: str) -> str:
    """``pose_in_map_x_m`` as ``Pose in map, x.``"""
    words = name.rpartition("_")[0] if unit else name
    frame = words.find("_in_")
    if frame > 0:
        end = words.find("_", frame + 4)
        words = words if end < 0 else f"{words[:end]},{words[end:]}"
    return f"{words.replace('_', ' ').capitalize()}."


def _kind(hint: Any) -> tuple[Kind, tuple[str, ...], str]:
    """Kind of a column, its allowed values if they are listed, and how to read it. Mappings and untyped values are
    JSON.

    Raises TypeError for types without a column kind.
    """
    origin = get_origin(hint)
    if origin is Literal:
        return "text", tuple(str(value) for value in get_args(hint) if value != ""), ""
    if isinstance(hint, type) and issubclass(hint, Enum):
        return "text", tuple(str(member.value) for member in hint), ""
    if members := set(union_members(hint)) - {type(None)}:
        if members == {int, float}:
            return "number", (), ""
        if str in members and all(get_origin(one) is Literal for one in members - {str}):
            return "text", (), ""
        if members <= {int, float, bool, str}:
            return "text", (), "A number, true or false, or text."
    if origin in (tuple, list):
        item = without_alias(get_args(hint)[0])
        kinds: dict[Any, Kind] = {int: "integers", float: "numbers", str: "texts"}
        if item in kinds:
            written = "as JSON" if item is str else "separated by semicolons"
            return kinds[item], (), f"A list; in CSV files {written}."
    if origin in (dict, tuple, list) or hint is Any:
        return "json", (), "As JSON."
    plain: dict[Any, Kind] = {int: "integer", float: "number", bool: "true or false", str: "text"}
    if hint not in plain:
        raise TypeError(f"no column type is defined for {hint}")
    return plain[hint], (), ""


def _plain(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value


def _smallest(array: Any) -> float | None:
    if array is None:
        return None
    finite = array[np.isfinite(array)]
    # By its digits: a float32 has fewer than the float it would become.
    return None if finite.size == 0 else float(str(finite.min()))


def _doc(value_type: type[Any]) -> tuple[str, dict[str, str]]:
    """General sentences of the docstring, and those that explain a field each."""
    return split_docstring(value_type.__doc__ or "", value_type.__annotations__)


def scalar_text(value: Any) -> str:
    """Number, true or false, or text, in spellings that stay distinguishable."""
    if type(value) is str:
        return plain_text(value)
    if isinstance(value, bool):
        return "true" if value else "false"
    return plain_text(str(value))


def json_text(value: Any) -> str:
    """Canonical JSON of a domain value: equal text for equal content."""
    try:
        text = _JSON.encode(value)
    except ValueError:  # a number that JSON lacks
        text = _JSON.encode(to_jsonable(value))
    return plain_text(text)


_JSON = json.JSONEncoder(ensure_ascii=False, sort_keys=True, allow_nan=False, default=to_jsonable)
