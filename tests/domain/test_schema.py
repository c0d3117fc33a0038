"""Domain values as JSON and back, with compressed grids and errors for wrong types."""

import dataclasses
import json
import math
import types
import typing
from collections.abc import Iterator
from typing import Any, Literal, get_args, get_origin

import jsonschema
import numpy as np
import pytest

from caris_desktop.domain.events import Gap, LlmExchange
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.schema import array_dtype, from_jsonable, json_schema, to_jsonable
from caris_desktop.domain.schema_fields import without_alias
from caris_desktop.domain.sensing import BatteryState, LaserScan, OccupancyGrid, PlannedPath
from caris_desktop.domain.streams import BY_TYPE


def grid(cells: Any) -> OccupancyGrid:
    return OccupancyGrid(1, None, 0.05, Pose2D(0.0, 0.0, 0.0), np.asarray(cells, np.int8))


@pytest.mark.parametrize("cells", [[[-1, 0, 100]], np.zeros((0, 0)), np.tile([-1, 100], (50, 20))])
def test_a_grid_reads_back_as_it_was_and_fits_its_schema(cells: Any) -> None:
    value = grid(cells)
    data = json.loads(json.dumps(to_jsonable(value)))
    jsonschema.validate(data, json_schema(OccupancyGrid))
    again = from_jsonable(OccupancyGrid, data)
    assert again.cells.dtype == np.int8
    assert np.array_equal(again.cells, value.cells)


def test_a_large_map_is_not_tens_of_megabytes() -> None:
    assert len(json.dumps(to_jsonable(grid(np.zeros((4000, 4000)))))) < 200_000


def test_a_grid_written_as_rows_is_read_too() -> None:
    data = {**to_jsonable(grid([[0]])), "cells": [[1, 2], [3, 4]]}
    assert from_jsonable(OccupancyGrid, data).cells.tolist() == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    "broken",
    [{"shape": [2, 2]}, {"shape": [40_000, 40_000]}, {"shape": [-1, -3]}, {"dtype": "int64"}, {"data": "?"},
     {"data": "AAAA"}, {"encoding": "pickle"}],
)  # fmt: skip
def test_a_grid_that_is_not_what_it_says_is_refused(broken: dict[str, Any]) -> None:
    data = to_jsonable(grid([[-1, 0, 100]]))
    data["cells"] = {**data["cells"], **broken}
    with pytest.raises(ValueError, match=r"grid|bytes"):
        from_jsonable(OccupancyGrid, data)


@pytest.mark.parametrize("stamp", ["5", 5.0, True, None, [5]])
def test_a_whole_number_is_nothing_else(stamp: object) -> None:
    with pytest.raises(ValueError, match="integer"):
        from_jsonable(Gap, {"stamp_ns": stamp, "stream": "scan", "count": 1, "reason": ""})


def test_nothing_returned_and_invalid_stay_apart() -> None:
    ranges_m = np.array([1.5, np.inf, np.nan, 0.25], np.float32)
    scan = LaserScan(1, None, "laser", 0.0, 0.1, 0.1, 9.0, ranges_m, Pose2D(0.0, 0.0, 0.0))
    data = json.loads(json.dumps(to_jsonable(scan), allow_nan=False))
    jsonschema.validate(data, json_schema(LaserScan))
    np.testing.assert_array_equal(from_jsonable(LaserScan, data).ranges_m, ranges_m)
    # As in older recordings.
    del data["intensities"]
    assert from_jsonable(LaserScan, data).intensities.shape == (0,)


# Every stream, with every wrong type in every place

WRONG: tuple[Any, ...] = (
    None, True, "x", "5", "", 5, -1.5, 10**30, 10**400, math.nan, math.inf, [], [1], ["x"], [[]], [[1], [2, 3]],
    [10**400], [math.nan], {}, {"a": 1}, {"a": [1]},
    {"encoding": "zlib+base64", "dtype": "int8", "shape": [math.inf], "data": ""},
    {"encoding": "zlib+base64", "dtype": "int8", "shape": "12", "data": 5},
)  # fmt: skip


def example(kind: Any) -> Any:
    """Plain form of an example value of this type."""
    kind = without_alias(kind)
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Literal:
        return arguments[0]
    if origin in (types.UnionType, typing.Union):
        return example(next(one for one in arguments if one is not type(None)))
    if origin in (tuple, list):
        return [example(arguments[0])]
    if origin is dict:
        return {"a": example(arguments[1])}
    if array_dtype(kind):
        return [[1, 2]]
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        plain = {field.name: example(hints[field.name]) for field in dataclasses.fields(kind)}
        return plain | {"ranges_m": [1.5, None], "intensities": [7.0]} if kind is LaserScan else plain
    return {int: 1, float: 1.5, str: "a", bool: True}.get(kind, 1)


def changed_everywhere(plain: Any) -> Iterator[Any]:
    yield from WRONG
    if isinstance(plain, dict):
        for key, item in plain.items():
            yield from ({**plain, key: other} for other in changed_everywhere(item))
    elif isinstance(plain, list):
        for number, item in enumerate(plain):
            yield from ([*plain[:number], other, *plain[number + 1 :]] for other in changed_everywhere(item))


def is_a(kind: Any, value: Any) -> bool:
    kind = without_alias(kind)
    origin, arguments = get_origin(kind), get_args(kind)
    if kind is Any:
        return True
    if origin is Literal:
        return value in arguments
    if origin in (types.UnionType, typing.Union):
        return any(is_a(one, value) for one in arguments)
    if origin in (tuple, list):
        return type(value) is origin and all(is_a(arguments[0], item) for item in value)
    if origin is dict:
        return type(value) is dict and all(is_a(arguments[1], item) for item in value.values())
    if dtype := array_dtype(kind):
        return isinstance(value, np.ndarray) and value.dtype == dtype
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind)
        return isinstance(value, kind) and all(is_a(hint, getattr(value, name)) for name, hint in hints.items())
    if kind is int:
        return type(value) is int and abs(value) < 2**63
    if kind is float:
        return type(value) is float and not math.isnan(value)
    return type(value) is kind


@pytest.mark.parametrize("kind", BY_TYPE, ids=lambda kind: kind.__name__)
def test_any_content_of_a_record_becomes_a_value_or_a_value_error(kind: Any) -> None:
    plain = example(kind)
    assert is_a(kind, from_jsonable(kind, plain))
    refused = 0
    for other in changed_everywhere(plain):
        try:
            value = from_jsonable(kind, other)
        except ValueError:
            refused += 1
        else:
            assert is_a(kind, value), other
    assert refused >= len(WRONG)


@pytest.mark.parametrize(
    ("kind", "field", "wrong"),
    [
        (LlmExchange, "messages", "a text, letter by letter"),
        (LlmExchange, "parameters", "x"),
        (LlmExchange, "parameters", {"temperature": [1]}),
        (BatteryState, "charge_fraction", "0.5"),
        (BatteryState, "charge_fraction", 10**400),
        (LaserScan, "ranges_m", [[1.0], [2.0]]),
        (LaserScan, "ranges_m", ["1.5"]),
        (PlannedPath, "points_in_map", [[1.0, 2.0, 3.0]]),
        (OccupancyGrid, "cells", [[1000]]),
        (OccupancyGrid, "cells", [[0.5]]),
    ],
)
def test_nothing_is_bent_until_it_fits(kind: Any, field: str, wrong: Any) -> None:
    plain = example(kind) | ({"points_in_map": [[1.0, 2.0]]} if kind is PlannedPath else {})
    from_jsonable(kind, plain)
    with pytest.raises(ValueError, match=r".+"):
        from_jsonable(kind, {**plain, field: wrong})


def test_a_path_without_points_has_its_shape_and_gaps_in_it_stay() -> None:
    path = {"stamp_ns": 1, "robot_stamp_ns": None, "points_in_map": []}
    assert from_jsonable(PlannedPath, path).points_in_map.shape == (0, 2)
    points = from_jsonable(PlannedPath, {**path, "points_in_map": [[1, None], ["nan", 2]]}).points_in_map
    np.testing.assert_array_equal(points, np.array([[1, np.inf], [np.nan, 2]], np.float32))
