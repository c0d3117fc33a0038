"""A session as tidy tables: one CSV for each stream and kind of event, and a dictionary of all columns."""

import csv
import dataclasses
import json
import math
import types
import typing
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import numpy as np

from caris_desktop.domain.streams import STREAMS, StreamSpec
from caris_desktop.recording.export import ExportContext
from caris_desktop.recording.session_clock import SessionClock
from caris_desktop.recording.session_reader import Session

_UNITS = {
    "ns": "nanoseconds",
    "ms": "milliseconds",
    "s": "seconds",
    "m": "metres",
    "mps": "metres per second",
    "rad": "radians",
    "radps": "radians per second",
    "px": "pixels",
    "hz": "hertz",
    "bytes": "bytes",
    "fraction": "0 to 1",
}


@dataclass(frozen=True, slots=True)
class Column:
    """One column; ``read`` takes the row's dataclass."""

    name: str
    unit: str
    kind: str
    description: str
    read: Callable[[Any], Any]


@dataclass(frozen=True, slots=True)
class Table:
    """One CSV file. ``rows`` gives the row values of one recorded value, which ``stamp`` columns precede."""

    name: str
    description: str
    columns: tuple[Column, ...]
    rows: Callable[[Any], Iterator[list[Any]]]


_TIME_COLUMNS = (
    ("session_s", "seconds", "number", "Time since the session began, by the session clock; negative: known before."),
    ("utc", "", "text", "The same moment in UTC, by the clock of this computer when the session began."),
    ("stamp_ns", "nanoseconds", "integer", "The same moment on the session's monotonic clock, for joining tables."),
)


def write_csv(session: Session, out: Path, context: ExportContext) -> list[Path]:
    """Fill the folder ``out`` (it exists and is empty). Raises OSError."""
    tables = {spec.name: tables_of(spec) for spec in STREAMS}
    paths = [_write_session(session, out / "session.csv"), _write_dictionary(tables, out / "data_dictionary.csv")]
    with ExitStack() as files:
        writers: dict[str, list[tuple[Table, Any]]] = {}
        for name, its_tables in tables.items():
            for table in its_tables:
                path = out / f"{table.name}.csv"
                file = files.enter_context(path.open("w", encoding="utf-8", newline=""))
                writer = csv.writer(file)
                writer.writerow([column[0] for column in _TIME_COLUMNS] + [column.name for column in table.columns])
                writers.setdefault(name, []).append((table, writer))
                paths.append(path)
        session_s_of = _session_seconds(session.clock)
        for spec, value in session.values():
            times = [_cell(session_s_of(value.stamp_ns)), session.clock.utc(value.stamp_ns), value.stamp_ns]
            for table, writer in writers[spec.name]:
                for row in table.rows(value):
                    writer.writerow([*times, *(_cell(_in_session(item, session_s_of)) for item in row)])
    return paths


def tables_of(spec: StreamSpec) -> tuple[Table, ...]:
    """The table of one stream, and one for each of its fields that holds a list of records."""
    name = spec.name.replace("/", "_")
    columns = tuple(_columns(spec.value_type))
    description = " ".join((spec.value_type.__doc__ or "").split())

    def one_row(value: Any) -> Iterator[list[Any]]:
        yield [column.read(value) for column in columns]

    tables = [Table(name, description, columns, one_row)]
    for field, hint in _fields(spec.value_type):
        item_type = _record_list(hint)
        if item_type is not None:
            tables.append(_list_table(name, field, item_type))
    return tuple(tables)


def _list_table(parent: str, field: str, item_type: type[Any]) -> Table:
    columns = tuple(_columns(item_type))
    index = Column("number", "", "integer", f"Which of the {field} of this moment, from 1.", lambda row: row)

    def rows(value: Any) -> Iterator[list[Any]]:
        for number, item in enumerate(getattr(value, field), start=1):
            yield [number, *(column.read(item) for column in columns)]

    description = f"The {field} of {parent}, one row each. " + " ".join((item_type.__doc__ or "").split())
    return Table(f"{parent}_{field}", description, (index, *columns), rows)


@dataclass(frozen=True, slots=True)
class _SessionMoment:
    """A stamp of the session clock that is to be shown in seconds of the session."""

    stamp_ns: int | None


def _columns(value_type: type[Any], path: tuple[str, ...] = ()) -> Iterator[Column]:
    for name, hint in _fields(value_type):
        if not path and name == "stamp_ns":
            continue
        yield from _columns_of_field((*path, name), hint)


def _columns_of_field(path: tuple[str, ...], hint: Any) -> Iterator[Column]:
    name = "_".join(path)
    read = _reader(path)
    hint = _record_or_nothing(hint)
    unit = _unit(path[-1])
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        yield from _columns(hint, path)
    elif _record_list(hint) is not None:
        yield Column(
            f"{name}_count", "", "integer", f"How many; each is a row of the table of {name}.", lambda v: len(read(v))
        )
    elif get_origin(hint) is np.ndarray:
        yield Column(
            f"{name}_shape", "", "text", "Number of values; height x width for a grid.", lambda v: _shape(read(v))
        )
        yield Column(f"{name}_min", unit, "number", "The smallest finite value.", lambda v: _smallest(read(v)))
        yield Column(
            name,
            unit,
            "list",
            "The values, separated by semicolons (of points: x y); inf: nothing was returned. "
            "Grids are only in events.mcap.",
            lambda v: _joined(read(v)),
        )
    else:
        kind, description = _kind(hint)
        description = f"{_in_words(name, unit)} {description}".strip()
        if name == "robot_stamp_ns":
            description = "The robot's own stamp, on the robot's clock; empty where it sent none."
        yield Column(name, unit, kind, description, read)
        if name.endswith("_ns") and not name.startswith("robot_"):
            yield Column(
                f"{name.removesuffix('_ns')}_session_s",
                "seconds",
                "number",
                f"{name} as time since the session began.",
                lambda v: _SessionMoment(read(v)),
            )


def _fields(value_type: type[Any]) -> list[tuple[str, Any]]:
    hints = typing.get_type_hints(value_type)
    return [(field.name, hints[field.name]) for field in dataclasses.fields(value_type)]


def _record_list(hint: Any) -> type[Any] | None:
    if get_origin(hint) not in (tuple, list):
        return None
    item = get_args(hint)[0]
    return item if isinstance(item, type) and dataclasses.is_dataclass(item) else None


def _record_or_nothing(hint: Any) -> Any:
    """A record that may be missing has the columns of the record; they are empty then."""
    if get_origin(hint) in (types.UnionType, typing.Union):
        members = [member for member in get_args(hint) if member is not type(None)]
        if len(members) == 1 and isinstance(members[0], type) and dataclasses.is_dataclass(members[0]):
            return members[0]
    return hint


def _reader(path: tuple[str, ...]) -> Callable[[Any], Any]:
    def read(value: Any) -> Any:
        for name in path:
            if value is None:
                return None
            value = getattr(value, name)
        return value

    return read


def _unit(name: str) -> str:
    return _UNITS.get(name.rpartition("_")[2], "") if "_" in name else ""


def _in_words(name: str, unit: str) -> str:
    """``pose_in_map_x_m`` as ``Pose in map, x.``"""
    words = name.rpartition("_")[0] if unit else name
    frame = words.find("_in_")
    if frame > 0:
        end = words.find("_", frame + 4)
        words = words if end < 0 else f"{words[:end]},{words[end:]}"
    return f"{words.replace('_', ' ').capitalize()}."


def _kind(hint: Any) -> tuple[str, str]:
    """The kind of value in words, and what is allowed or how to read it."""
    origin = get_origin(hint)
    if origin in (types.UnionType, typing.Union):
        members = [member for member in get_args(hint) if member is not type(None)]
        kind, description = _kind(members[0])
        return kind, f"{description} Empty where it is not known.".strip()
    if origin is Literal:
        return "text", f"One of: {', '.join(map(str, get_args(hint)))}."
    if origin in (tuple, list):
        return "list", "Separated by semicolons."
    if origin is dict:
        return "json", "As JSON."
    return {int: "integer", float: "number", bool: "true or false"}.get(hint, "text"), ""


def _session_seconds(clock: SessionClock) -> Callable[[int], float]:
    return lambda stamp_ns: round(clock.session_s(stamp_ns), 6)


def _in_session(item: Any, session_s_of: Callable[[int], float]) -> Any:
    if not isinstance(item, _SessionMoment):
        return item
    return None if item.stamp_ns is None else session_s_of(item.stamp_ns)


def _shape(array: Any) -> str:
    return "x".join(map(str, array.shape))


def _smallest(array: Any) -> Any:
    finite = array[np.isfinite(array)]
    # Not through a Python number: a float32 would be shown with digits that it does not hold.
    return None if finite.size == 0 else finite.min()


def _joined(array: Any) -> str:
    if array.ndim == 1:
        return ";".join(str(item) for item in array)
    # Points: two numbers each.
    return ";".join(f"{row[0]} {row[1]}" for row in array) if array.shape[1:] == (2,) else ""


def _cell(value: Any) -> Any:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return json.dumps(value, ensure_ascii=False, sort_keys=True)
    if isinstance(value, (tuple, list)):
        return ";".join(str(_cell(item)) for item in value)
    if isinstance(value, float) and math.isfinite(value) and value == int(value) and abs(value) < 1e15:
        return f"{value:.1f}"
    return value


def _write_session(session: Session, path: Path) -> Path:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["key", "value"])
        writer.writerow(["folder", session.folder.name])
        for key, value in _flat(session.header):
            writer.writerow([key, _cell(value)])
        writer.writerow(["closed_properly", _cell(session.closed_properly)])
        writer.writerow(["recorded_s", round(session.duration_s, 3)])
    return path


def _flat(data: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in data.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        elif not isinstance(value, list):
            yield f"{prefix}{key}", value


def _write_dictionary(tables: dict[str, tuple[Table, ...]], path: Path) -> Path:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["table", "column", "unit", "type", "description"])
        for its_tables in tables.values():
            for table in its_tables:
                writer.writerow([table.name, "", "", "table", table.description])
                for column in _TIME_COLUMNS:
                    writer.writerow([table.name, *column])
                for described in table.columns:
                    writer.writerow([table.name, described.name, described.unit, described.kind, described.description])
    return path
