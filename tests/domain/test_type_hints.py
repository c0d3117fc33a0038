"""Type hints of libraries: direct ones, and type aliases of newer versions."""

import dataclasses
from collections.abc import Mapping
from enum import Enum
from pathlib import PurePath
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

from caris_desktop.domain import schema_fields, schema_validation
from caris_desktop.domain.schema import array_dtype, from_jsonable, json_schema, require_recordable, to_jsonable
from caris_desktop.domain.schema_fields import union_members, without_alias
from caris_desktop.domain.streams import Delivery, StreamSpec
from caris_desktop.recording.tables.catalog import tables_of

Scalar = TypeVar("Scalar", bound=np.generic)
# As declared by numpy 2.5.
AnyShape = TypeAliasType("AnyShape", tuple[Any, ...])
Array = TypeAliasType("Array", np.ndarray[AnyShape, np.dtype[Scalar]], type_params=(Scalar,))
Cells = TypeAliasType("Cells", Array[np.int8])
Word = TypeAliasType("Word", Literal["near", "far"])
Item = TypeVar("Item")
Several = TypeAliasType("Several", tuple[Item, ...], type_params=(Item,))
Maybe = TypeAliasType("Maybe", Item | None, type_params=(Item,))
Number = TypeAliasType("Number", int | float)


@dataclasses.dataclass
class Point:
    x_m: float


@dataclasses.dataclass
class Aliased:
    """One value of every kind, by alias."""

    stamp_ns: int
    ranges_m: Array[np.float32]
    cells: Cells
    depths_mm: Maybe[Array[np.uint16]]
    word: Maybe[Word]
    points: Several[Point]
    number: Maybe[Number]
    texts: TypeAliasType("Texts", dict[str, Word])


@dataclasses.dataclass
class Plain:
    """One value of every kind, by alias."""

    stamp_ns: int
    ranges_m: NDArray[np.float32]
    cells: np.ndarray[tuple[int, int], np.dtype[np.int8]]
    depths_mm: NDArray[np.uint16] | None
    word: Literal["near", "far"] | None
    points: tuple[Point, ...]
    number: int | float | None
    texts: dict[str, Literal["near", "far"]]


VALUE: dict[str, Any] = {
    "stamp_ns": 5, "ranges_m": np.array([1.5, np.inf, np.nan], np.float32), "cells": np.array([[-1, 100]], np.int8),
    "depths_mm": None, "word": "far", "points": (Point(1.0), Point(2.0)), "number": 2.5, "texts": {"a": "near"},
}  # fmt: skip


@pytest.mark.parametrize("kind", [Aliased, Plain])
def test_a_value_declared_by_aliases_comes_back_as_it_was(kind: Any) -> None:
    again = from_jsonable(kind, to_jsonable(kind(**VALUE)))
    assert again.ranges_m.dtype == np.float32
    np.testing.assert_array_equal(again.ranges_m, VALUE["ranges_m"])
    assert again.cells.dtype == np.int8
    np.testing.assert_array_equal(again.cells, VALUE["cells"])
    assert (again.depths_mm, again.word, again.number) == (None, "far", 2.5)
    assert again.points == VALUE["points"]
    assert again.texts == VALUE["texts"]


@pytest.mark.parametrize("field", ["ranges_m", "cells", "depths_mm", "word", "points", "number", "texts"])
@pytest.mark.parametrize("kind", [Aliased, Plain])
def test_a_value_that_does_not_fit_an_alias_is_refused(kind: Any, field: str) -> None:
    plain = to_jsonable(kind(**VALUE))
    from_jsonable(kind, plain)
    with pytest.raises(ValueError, match=r"expected|not one of"):
        from_jsonable(kind, {**plain, field: {"a": {}} if field == "texts" else {"a": 1} if field == "points" else "x"})


def test_an_alias_has_the_schema_and_the_columns_of_what_it_stands_for() -> None:
    assert {**json_schema(Aliased), "title": "Plain"} == json_schema(Plain)
    aliased, plain = (tables_of(StreamSpec("one", kind, Delivery.LATEST)) for kind in (Aliased, Plain))
    assert [(column.name, column.kind, column.description) for table in aliased for column in table.columns] == [
        (column.name, column.kind, column.description) for table in plain for column in table.columns
    ]
    assert [table.name for table in aliased] == ["one", "one_points"]


def test_the_installed_numpy_says_what_its_arrays_are() -> None:
    assert array_dtype(NDArray[np.float32]) == np.float32
    assert array_dtype(NDArray[np.int8] | None) is None
    assert array_dtype(tuple[int, ...]) is None
    assert union_members(NDArray[np.int8] | None) == (without_alias(NDArray[np.int8]), type(None))
    assert union_members(Maybe[Number]) == (int, float, type(None))
    assert union_members(int) == ()


class Colour(Enum):
    RED = "red"


UNION = Point | Plain
UNKNOWN: tuple[Any, ...] = (
    np.ndarray, NDArray[Any], NDArray[np.floating], NDArray[np.str_], NDArray[np.bool_], Array, object, bytes, complex,
    PurePath, Colour, set[int], Mapping[str, int], tuple[int, str], tuple, dict, dict[int, str], UNION,
    TypeAliasType("Thing", object),
)  # fmt: skip


@pytest.mark.parametrize("kind", UNKNOWN, ids=str)
@pytest.mark.parametrize("within", [lambda kind: kind, lambda kind: list[kind], lambda kind: dict[str, kind]])
def test_a_type_of_which_no_form_is_known_is_an_error_and_no_guess(kind: Any, within: Any) -> None:
    holder = dataclasses.make_dataclass("Holder", [("stamp_ns", int), ("what", within(kind))])
    with pytest.raises(TypeError):
        require_recordable(holder)
    with pytest.raises(TypeError):
        from_jsonable(holder, {"stamp_ns": 1, "what": []})
    if kind != UNION:  # it can be described, but the type of a value is ambiguous
        with pytest.raises(TypeError):
            json_schema(holder)


def test_the_error_says_which_field_it_is() -> None:
    holder = dataclasses.make_dataclass("Holder", [("points", tuple[Point, ...]), ("what", object)])
    with pytest.raises(TypeError, match=r"Holder\.what: .*object"):
        require_recordable(holder)


# Files written by people


@dataclasses.dataclass(frozen=True)
class AliasedFile:
    """A file."""

    word: Annotated[Word, schema_fields.FieldSpec("Which.")] = "near"
    numbers: TypeAliasType("Numbers", tuple[Annotated[Number, schema_fields.FieldSpec(at_least=0)], ...]) = ()
    point: TypeAliasType("Where", Point | None) = None


def test_a_file_declared_by_aliases_is_checked_and_read() -> None:
    data = {"word": "far", "numbers": [1, 2.5], "point": {"x_m": 1.5}}
    assert list(schema_validation.problems(AliasedFile, data)) == []
    assert schema_fields.value_from(AliasedFile, data) == AliasedFile("far", (1, 2.5), Point(1.5))
    wrong = {"word": "fra", "numbers": [-1], "point": {"x_m": "there"}}
    assert [path for path, _ in schema_validation.problems(AliasedFile, wrong)] == [
        ("word",), ("numbers", 0), ("point", "x_m"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    "kind", [object, bytes, set[int], tuple[int, str], dict[str, int], NDArray[np.float32], Colour]
)
def test_a_key_whose_form_is_unknown_is_an_error(kind: Any) -> None:
    group = dataclasses.make_dataclass("Group", [("what", kind)])
    with pytest.raises(TypeError, match=r"Group\.what"):
        list(schema_validation.problems(group, {"what": 1}))
