"""Domain values as JSON and back: grids deflated, and what does not fit refused."""

import json
from typing import Any

import jsonschema
import numpy as np
import pytest

from caris_desktop.domain.events import Gap
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.schema import from_jsonable, json_schema, to_jsonable
from caris_desktop.domain.sensing import LaserScan, OccupancyGrid


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
