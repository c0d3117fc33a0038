"""Value classes equal standard dataclasses, but are created faster."""

import copy
import dataclasses
import importlib
import inspect
import pickle
import pkgutil
from dataclasses import field
from typing import Any, ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import caris_desktop.domain
from caris_desktop.domain.value_class import Value, dataclass


class Ours(Value):
    """Fields of both classes."""

    x: int
    names: tuple[str, ...] = ()
    note: str = field(default="", compare=False)
    hidden: int = field(default=3, repr=False)
    KIND: ClassVar[str] = "kind"


@dataclasses.dataclass(frozen=True, slots=True)
class Theirs:
    """Fields of both classes."""

    x: int
    names: tuple[str, ...] = ()
    note: str = field(default="", compare=False)
    hidden: int = field(default=3, repr=False)
    KIND: ClassVar[str] = "kind"


class Longer(Ours):
    more: list[int] = field(default_factory=list)
    made: int = field(default=7, init=False)
    by_name: str = field(kw_only=True)

    def __post_init__(self) -> None:
        if self.x < 0:
            raise ValueError("below nothing")


class ByName(Value, kw_only=True):
    x: int
    y: int = 2


@dataclass(slots=True)
class Changing:
    x: int
    items: list[int] = field(default_factory=list)


class Itself(Value, eq=False):
    x: int


@dataclass(frozen=True)
class Empty:
    pass


_VALUES = st.tuples(st.integers(-3, 3), st.lists(st.text(max_size=2), max_size=2).map(tuple), st.text(max_size=1))


@given(_VALUES, _VALUES)
@pytest.mark.long
def test_values_compare_hash_and_show_as_those_of_the_library(one: Any, other: Any) -> None:
    ours, theirs = (Ours(*one), Ours(*other)), (Theirs(*one), Theirs(*other))
    assert (ours[0] == ours[1]) == (theirs[0] == theirs[1])
    assert hash(ours[0]) == hash(theirs[0])
    assert repr(ours[0]) == repr(theirs[0]).replace("Theirs", "Ours")
    assert ours[0] != theirs[0]


@given(_VALUES)
@pytest.mark.long
def test_values_go_through_a_pipe_and_are_copied(values: Any) -> None:
    for value in (Ours(*values), Longer(3, *values[1:], by_name="n"), Changing(3, [1]), Empty(), ByName(x=1)):
        for protocol in range(2, pickle.HIGHEST_PROTOCOL + 1):
            assert pickle.loads(pickle.dumps(value, protocol)) == value  # noqa: S301 - written by this test
        assert copy.copy(value) == value
        assert copy.deepcopy(value) == value


def test_a_frozen_value_is_neither_set_nor_deleted() -> None:
    value = Ours(1)
    for change in (lambda: setattr(value, "x", 2), lambda: setattr(value, "other", 2), lambda: delattr(value, "x")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            change()
    assert value.x == 1
    changing = Changing(1)
    changing.x = 2
    assert changing == Changing(2)
    with pytest.raises(TypeError, match="unhashable"):
        hash(changing)


def test_a_default_factory_runs_each_time() -> None:
    assert Longer(1, by_name="").more is not Longer(1, by_name="").more
    given_list = [1]
    assert Changing(1, given_list).items is given_list
    with pytest.raises(ValueError, match="mutable default"):

        @dataclass
        class _Shared:
            items: list[int] = []  # noqa: RUF012 - tests the refusal


def test_a_wrong_value_is_refused() -> None:
    for wrong in (Ours, lambda: Ours(1, (), "", 3, 4), lambda: Ours(y=1), lambda: ByName(1), lambda: Longer(1)):
        with pytest.raises(TypeError):
            wrong()  # type: ignore[operator]
    with pytest.raises(ValueError, match="below"):
        Longer(-1, by_name="")


def test_two_that_are_themselves_differ() -> None:
    value = Itself(1)
    assert value == value  # noqa: PLR0124 - tests equality
    assert value != Itself(1)
    assert len({value, Itself(1)}) == 2


def test_the_library_knows_them() -> None:
    value = Longer(1, ("a",), by_name="n")
    assert dataclasses.is_dataclass(value)
    assert [each.name for each in dataclasses.fields(Longer)] == [
        "x", "names", "note", "hidden", "more", "made", "by_name",
    ]  # fmt: skip
    assert dataclasses.replace(value, x=2) == Longer(2, ("a",), by_name="n")
    assert dataclasses.asdict(value)["names"] == ("a",)
    match value:
        case Longer(1, names):
            assert names == ("a",)
        case _:
            pytest.fail("positions are not known")


def test_one_that_holds_itself_can_be_shown() -> None:
    value = Changing(1)
    value.items.append(value)  # type: ignore[arg-type]
    assert "..." in repr(value)


def test_values_without_fields_and_with_arrays() -> None:
    assert Empty() == Empty()
    assert hash(Empty()) == hash(())
    array = np.zeros(3)
    assert Ours(1, array) == Ours(1, array)  # type: ignore[arg-type]  # the same array, as tuples have it


def _declared() -> list[type[Any]]:
    """All value classes of the domain."""
    found = []
    for module in pkgutil.walk_packages(caris_desktop.domain.__path__, "caris_desktop.domain."):
        for each in vars(importlib.import_module(module.name)).values():
            if isinstance(each, type) and dataclasses.is_dataclass(each) and each.__module__ == module.name:
                found.append(each)
    return found


@pytest.mark.parametrize("cls", _declared(), ids=lambda cls: cls.__name__)
@pytest.mark.long
def test_each_is_made_with_the_parameters_that_the_library_would_give_it(cls: type[Any]) -> None:
    twin = dataclasses.make_dataclass(
        cls.__name__,
        [
            (
                each.name,
                each.type,
                field(default=each.default, default_factory=each.default_factory, init=each.init, kw_only=each.kw_only),  # type: ignore[call-overload]
            )
            for each in dataclasses.fields(cls)
        ],
    )

    def parameters(of: type[Any]) -> list[Any]:
        listed = inspect.signature(of).parameters.values()
        return [(each.name, each.kind, repr(each.default), each.annotation) for each in listed]

    assert parameters(cls) == parameters(twin)
