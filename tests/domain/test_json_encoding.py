"""Recorded JSON values: lossless round trip, and shapes that other programs can read as columns."""

import dataclasses
import json
from collections.abc import Iterator
from typing import Any

import jsonschema
import numpy as np
import pytest

from caris_desktop.domain.events import EmergencyStopChanged, PlacesChanged, Problem, TopicTraffic, TrafficMeasured
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.json_encoding import (
    TRANSFORMS_TOPIC,
    from_message,
    recorded_schema,
    schema_of,
    to_message,
    transforms_schema,
)
from caris_desktop.domain.schema import from_jsonable, to_jsonable
from caris_desktop.domain.sensing import (
    BatteryState,
    LaserScan,
    OccupancyGrid,
    People,
    PersonBox,
    PlannedPath,
    StatusShown,
)
from caris_desktop.domain.streams import BY_TYPE, STREAMS, StreamSpec
from tests.domain.test_schema import example

NOON_NS = 1_790_000_000_000_000_123


def written(value: Any) -> dict[str, Any]:
    """Value as in the file."""
    message: dict[str, Any] = json.loads(
        json.dumps(to_message(BY_TYPE[type(value)], value, at_utc_ns=NOON_NS), allow_nan=False)
    )
    return message


def scan(ranges_m: list[float], **fields: Any) -> LaserScan:
    some = LaserScan(1, None, "laser", -0.5, 0.25, 0.1, 9.0, np.array(ranges_m, np.float32), Pose2D(0.1, 0.0, 0.0))
    return dataclasses.replace(some, **fields)


def grid(cells: Any) -> OccupancyGrid:
    return OccupancyGrid(1, None, 0.05, Pose2D(-1.0, 2.0, 0.5), np.asarray(cells, np.int8))


@pytest.mark.parametrize("spec", STREAMS, ids=lambda spec: spec.name)
def test_every_stream_reads_back_as_it_was_and_fits_the_schema_that_its_channel_carries(spec: StreamSpec) -> None:
    fields = {field.name: field for field in dataclasses.fields(spec.value_type)}
    plain = example(spec.value_type)
    if "points_in_map" in fields:
        plain["points_in_map"] = [[1.0, 2.0]]
    for value in (
        from_jsonable(spec.value_type, plain),
        # Only with the required fields.
        from_message(spec, {name: plain[name] for name, field in fields.items() if _is_needed(field)}),
    ):
        message = written(value)
        jsonschema.validate(message, schema_of(spec)[1])
        assert to_jsonable(from_message(spec, message)) == to_jsonable(value)


def _is_needed(field: "dataclasses.Field[Any]") -> bool:
    return field.default is field.default_factory is dataclasses.MISSING


def test_an_infinite_range_is_a_number_and_comes_back() -> None:
    numbers = [1.5, np.inf, -np.inf, np.nan, 0.25]
    for fields in ({}, {"intensities": np.array([7.0, np.nan, 1.0, np.inf, 0.0], np.float32)}):
        value = scan(numbers, **fields)
        message = written(value)
        assert all(type(number) is float for number in message["ranges"] + message["intensities"])
        again = from_message(BY_TYPE[LaserScan], message)
        np.testing.assert_array_equal(again.ranges_m, value.ranges_m)
        np.testing.assert_array_equal(again.intensities, value.intensities)
        assert again.frame_id == "laser"
        # A conversion to 32 bits, as in viewers, gives no drawable distance.
        with np.errstate(over="ignore"):
            assert np.isfinite(np.array(message["ranges"]).astype(np.float32)).tolist() == [
                True,
                False,
                False,
                False,
                True,
            ]


@pytest.mark.parametrize("cells", [[[-1, 0, 100], [5, 6, 7]], np.zeros((0, 0)), np.zeros((3, 0)), np.zeros((0, 4))])
def test_a_map_is_in_it_once_and_comes_back(cells: Any) -> None:
    value = grid(cells)
    message = written(value)
    assert not [name for name in message if name == "cells"]
    again = from_message(BY_TYPE[OccupancyGrid], message)
    assert again.cells.dtype == np.int8
    assert again.cells.shape == value.cells.shape
    np.testing.assert_array_equal(again.cells, value.cells)


@pytest.mark.parametrize(
    "broken", [{"data": "?"}, {"data": "AAAA"}, {"data": 5}, {"row_count": 2**40}, {"row_count": None},
               {"column_count": -1}, {"column_count": "3"}],
)  # fmt: skip
def test_a_map_that_is_not_what_it_says_is_refused(broken: dict[str, Any]) -> None:
    message = written(grid([[-1, 0, 100], [5, 6, 7]])) | broken
    with pytest.raises(ValueError, match=r".+"):
        from_message(BY_TYPE[OccupancyGrid], message)


@pytest.mark.parametrize(
    "broken",
    [{"ranges": None}, {"ranges": "12"}, {"ranges": [[1.0]]}, {"intensities": None}, {"laser_frame_id": 7}],
)
def test_a_scan_that_is_not_what_it_says_is_refused(broken: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r".+"):
        from_message(BY_TYPE[LaserScan], written(scan([1.0])) | broken)


def test_a_path_comes_back_with_its_gaps() -> None:
    for points in (np.array([[1.0, 2.0], [1.1, np.inf], [np.nan, -2.5]], np.float32), np.zeros((0, 2), np.float32)):
        message = written(PlannedPath(1, None, points))
        assert len(message["poses"]) == len(points)
        np.testing.assert_array_equal(from_message(BY_TYPE[PlannedPath], message).points_in_map, points)
    for broken in ([{}], [5], 5, None, [{"position": {"x": 1.0, "y": "2"}}], [{"position": {"x": 1.0}}]):
        with pytest.raises(ValueError, match=r".+"):
            from_message(BY_TYPE[PlannedPath], {**message, "poses": broken})


def test_messages_of_older_versions_are_read() -> None:
    older = [
        scan([1.5, np.inf, np.nan]),
        PlannedPath(1, None, np.array([[1.0, np.inf]], np.float32)),
        grid([[-1, 0, 100]]),
        BatteryState(1, None),
        PlacesChanged(1, "kitchen", None),
        Problem(1, "error", "a", "b", "c"),
        StatusShown(1, "link", {"reason": None}),
    ]
    for value in older:
        message = json.loads(json.dumps(to_jsonable(value), allow_nan=False))
        assert to_jsonable(from_message(BY_TYPE[type(value)], message)) == to_jsonable(value)


def test_none_is_not_written_and_reads_as_none() -> None:
    removed = PlacesChanged(1, "kitchen", None)
    assert written(removed) == {"stamp_ns": 1, "name": "kitchen", "actor": ""}
    assert from_message(BY_TYPE[PlacesChanged], written(removed)) == removed
    # None in a value without a schema is content.
    shown = StatusShown(1, "link", {"reason": None})
    assert from_message(BY_TYPE[StatusShown], written(shown)) == shown
    measured = TrafficMeasured(1, "robot", "json", 0, (TopicTraffic("/scan", "", 1.0, 2.0, None, None, 0),))
    assert from_message(BY_TYPE[TrafficMeasured], written(measured)) == measured


@dataclasses.dataclass(frozen=True, slots=True)
class WhoStopped:
    """Event type of a later version with an actor, which older recordings lack."""

    stamp_ns: int
    actor: str = ""
    person_id: str | None = None


def test_there_is_room_for_who_did_it() -> None:
    spec = dataclasses.replace(BY_TYPE[EmergencyStopChanged], value_type=WhoStopped)
    assert from_message(spec, {"stamp_ns": 5}) == WhoStopped(5)
    stopped = WhoStopped(5, "wizard:W2", "p-1")
    assert from_message(spec, to_message(spec, stopped, at_utc_ns=NOON_NS)) == stopped


def plain_properties(schema: dict[str, Any]) -> Iterator[dict[str, Any]]:
    for field in schema["properties"].values():
        yield field
        inner = field.get("items", field)
        if inner.get("type") == "object":
            yield from plain_properties(inner)


@pytest.mark.parametrize("topic", [*(f"/{spec.name}" for spec in STREAMS), TRANSFORMS_TOPIC])
def test_no_viewer_gives_up_on_a_channel(topic: str) -> None:
    """Rules of the JSON Schema readers of Foxglove and Lichtblick: each property has one plain type, an object has
    properties, a list has items of one plain type, and base64 stands for bytes.
    """
    told = recorded_schema(topic)
    assert told is not None
    _, schema = told
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["type"] == "object"
    plain = ("boolean", "string", "number", "integer", "object")
    for field in plain_properties(schema):
        assert field.get("type") in (*plain, "array"), field
        assert field.get("contentEncoding") in (None, "base64")
        if field["type"] == "array":
            assert field["items"].get("type") in plain, field
        if field["type"] == "object":
            assert "properties" in field


@pytest.mark.parametrize("spec", [spec for spec in STREAMS if spec.well_known], ids=lambda spec: spec.name)
def test_no_field_of_ours_hides_one_that_others_know(spec: StreamSpec) -> None:
    known = spec.well_known
    assert known is not None
    own = {field.name for field in dataclasses.fields(spec.value_type)}
    assert known.holds <= own
    assert not (own - known.holds) & set(known.shape)


def test_the_moment_is_that_of_the_message() -> None:
    box = PersonBox(1, "p-1", 10.0, 20.0, 30.0, 40.0, 0.9)
    message = written(People(1, "front", 1, 160, 90, (box,), 1.0))
    told = [message["timestamp"], message["points"][0]["timestamp"], message["texts"][0]["timestamp"]]
    assert told == [{"sec": 1_790_000_000, "nsec": 123}] * 3
    assert message["points"][0]["points"] == [
        {"x": 10.0, "y": 20.0}, {"x": 40.0, "y": 20.0}, {"x": 40.0, "y": 60.0}, {"x": 10.0, "y": 60.0}
    ]  # fmt: skip
    assert transforms_schema()[0] == "foxglove.FrameTransforms"


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (dataclasses.replace(scan([1.0]), ranges_m={"shape": [1]}), "a grid of float32"),
        (dataclasses.replace(scan([1.0]), ranges_m=np.array([1], np.int32)), "array of float32, found int32"),
        (scan([1.0], angle_min_rad="0.5"), "number"),
        (dataclasses.replace(grid([[0]]), cells=np.zeros((2, 2), np.uint8)), "array of int8, found uint8"),
        (PlannedPath(1, None, np.zeros((3, 3), np.float32)), r"found \(3, 3\)"),
        (BatteryState(1, "half"), "number"),  # type: ignore[arg-type]
        (Problem("soon", "warning", "", "", ""), "integer"),  # type: ignore[arg-type]
        (Problem(1, "loud", "", "", ""), "loud"),  # type: ignore[arg-type]
    ],
)
def test_an_unreadable_value_is_not_written(value: Any, said: str) -> None:
    with pytest.raises((TypeError, ValueError), match=said):
        to_message(BY_TYPE[type(value)], value, at_utc_ns=NOON_NS)
