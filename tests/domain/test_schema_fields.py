"""Declared files: validation, documentation, reading and writing follow from the declaration."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, make_dataclass
from typing import Annotated, Any, Literal

import jsonschema
import pytest

from caris_desktop.domain.schema_fields import (
    Excluded,
    FieldSpec,
    Flattened,
    KeyPath,
    Problem,
    StoredAs,
    ValueForm,
    data_of,
    replaced,
    value_from,
)
from caris_desktop.domain.schema_json import file_schema, reference, with_tables
from caris_desktop.domain.schema_validation import problems
from caris_desktop.domain.value_class import setting


@dataclass(frozen=True, slots=True)
class Lamp:
    """One lamp of ``a shelf``."""

    name: str = setting(shortest=1, longest=20)
    """How it is called."""
    brightness: float = setting(default=50.0, unit="percent", at_least=0, at_most=100)
    """How bright it is."""


@dataclass(frozen=True, slots=True)
class _SizeKeys:
    width_cm: Annotated[float, FieldSpec("From left to right.", more_than=0)]


@dataclass(frozen=True, slots=True)
class Book:
    """One book."""

    book: Annotated[str, FieldSpec("Its title.")]


@dataclass(frozen=True, slots=True)
class Box:
    """Things in a box."""

    things: Annotated[tuple["Thing", ...], FieldSpec("What is in it.", shortest=1, order=1)]
    lid: Annotated[bool, FieldSpec("Whether it is closed.")] = False


Thing = Annotated[
    Book | Box, FieldSpec("A book, or a box of things.", noun="thing", needs="a thing is a book or a box.")
]


@dataclass(frozen=True, slots=True)
class Shelf:
    """A shelf."""

    boards: Annotated[int, FieldSpec("How many boards it has.", at_least=1)]
    width_m: Annotated[float, Flattened(_SizeKeys, lambda keys: keys.width_cm / 100, lambda m: _SizeKeys(m * 100))]
    wood: Annotated[Literal["oak", "pine"], FieldSpec("What it is made of.")] = "oak"
    lamps: Annotated[tuple[Lamp, ...], FieldSpec("Its lamps.", longest=2, quiet=True)] = ()
    colours: Annotated[tuple[str, ...], FieldSpec("Its colours.", unique=True)] = ()
    number: Annotated[str, FieldSpec("Where it stands.", pattern="^[A-Z][0-9]$", allowed="a letter and a digit.")] = (
        "A1"
    )
    top: Annotated[Thing | None, FieldSpec("What stands on it.")] = None
    light: Lamp = field(default_factory=lambda: Lamp("top"))
    seen: Annotated[bool, Excluded()] = False


LEAST = {"boards": 3, "width_cm": 80}


def told(data: Any, declaration: Any = Shelf) -> list[Problem]:
    return list(problems(declaration, data))


def test_a_declared_setting_is_checked_reported_read_written_and_explained() -> None:
    colour = Annotated[Literal["red", "green"], FieldSpec("Its colour.")]
    coloured = make_dataclass("Lamp", [("colour", colour, "red")], bases=(Lamp,), frozen=True)
    for text_of in (lambda of: json.dumps(file_schema(of, schema_id="x", title="x")), reference):
        assert "colour" not in text_of(Lamp)
        assert "colour" in text_of(coloured)
    properties = file_schema(coloured, schema_id="x", title="x")["properties"]
    assert properties["colour"] == {"enum": ["red", "green"], "default": "red", "description": "Its colour."}
    assert "| `colour` | `red` or `green`, `red` | Its colour. |" in reference(coloured)

    lamp = {"name": "a", "colour": "green"}
    assert told(lamp, Lamp) == [(("colour",), "unknown key 'colour'. Allowed: brightness, name.")]
    assert told(lamp, coloured) == []
    assert told({"name": "a", "colour": "gren"}, coloured) == [
        (("colour",), "unknown colour 'gren'. Allowed: red, green. Did you mean 'green'?")
    ]
    assert told({"name": "a", "color": "red"}, coloured) == [
        (("color",), "unknown key 'color'. Allowed: brightness, colour, name. Did you mean 'colour'?")
    ]
    value = value_from(coloured, lamp)
    assert value.colour == "green"
    assert data_of(coloured, value) == {"name": "a", "brightness": 50, "colour": "green"}


@pytest.mark.parametrize(
    ("wrong", "path", "sentence"),
    [
        ({"boards": 0}, ("boards",), "'boards' is 0. Allowed: at least 1."),
        ({"boards": 1.5}, ("boards",), "'boards' must be a whole number, found 1.5."),
        ({"boards": True}, ("boards",), "'boards' must be a whole number, found true."),
        ({"boards": None}, ("boards",), "'boards' must be a whole number, found nothing."),
        ({"width_cm": 0}, ("width_cm",), "'width_cm' is 0. Allowed: more than 0."),
        ({"width_cm": float("nan")}, ("width_cm",), "'width_cm' is nan. Allowed: more than 0."),
        ({"width_cm": "wide"}, ("width_cm",), "'width_cm' must be a number, found 'wide'."),
        ({"wood": "pin"}, ("wood",), "unknown wood 'pin'. Allowed: oak, pine. Did you mean 'pine'?"),
        ({"wood": ["oak"]}, ("wood",), "unknown wood ['oak']. Allowed: oak, pine. Did you mean 'oak'?"),
        ({"number": "a1"}, ("number",), "'number' is 'a1'. Allowed: a letter and a digit."),
        ({"lamps": "two"}, ("lamps",), "'lamps' must be a list, found 'two'."),
        ({"lamps": [{"name": "a"}] * 3}, ("lamps",), "'lamps' has 3 entries. Allowed: at most 2."),
        ({"lamps": ["a"]}, ("lamps", 0), "'lamps[1]' must be a group of 'key: value' lines, found 'a'."),
        ({"lamps": [{"name": ""}]}, ("lamps", 0, "name"), "'lamps[1].name' is empty."),
        ({"lamps": [{}]}, ("lamps", 0), "'name' is missing in 'lamps[1]'."),
        ({"light": {"name": "a" * 21}}, ("light", "name"), "'light.name' has 21 characters. Allowed: at most 20."),
        (
            {"light": {"name": "a", "brightness": 101}},
            ("light", "brightness"),
            "'light.brightness' is 101. Allowed: at most 100.",
        ),
        ({"colours": ["red", "blue", "red"]}, ("colours", 2), "'colours': duplicate entry 'red'."),
        ({"top": {}}, ("top",), "a thing is a book or a box."),
        (
            {"top": {"boook": "x"}},
            ("top", "boook"),
            "unknown key 'boook' in 'top'. Allowed: book, lid, things. Did you mean 'book'?",
        ),
        (
            {"top": {"thigs": [], "lid": True}},
            ("top", "thigs"),
            "unknown key 'thigs' in 'top'. Allowed: lid, things. Did you mean 'things'?",
        ),
        ({"top": {"things": []}}, ("top", "things"), "'top.things' is empty."),
        (
            {"top": {"things": [{"book": 1}]}},
            ("top", "things", 0, "book"),
            "'top.things[1].book' must be text, found 1.",
        ),
        (
            {"seen": True},
            ("seen",),
            "unknown key 'seen'. Allowed: boards, colours, lamps, light, number, top, width_cm, wood.",
        ),
    ],
)
def test_a_mistake_is_reported_once_with_its_place_and_what_is_allowed(
    wrong: dict[str, Any], path: tuple[str | int, ...], sentence: str
) -> None:
    assert told(LEAST | wrong) == [(path, sentence)]


def test_every_mistake_is_reported() -> None:
    assert told({"boards": 0, "wood": "elm"}) == [
        ((), "'width_cm' is missing."),
        (("boards",), "'boards' is 0. Allowed: at least 1."),
        (("wood",), "unknown wood 'elm'. Allowed: oak, pine."),
    ]


def test_a_key_that_is_near_two_is_taken_for_the_one_that_is_not_given_yet() -> None:
    pair = make_dataclass("Pair", [("x_m", float), ("y_m", float)], frozen=True)
    assert told({"y_m": 1.0, "_m": 2.0}, pair) == [
        (("_m",), "unknown key '_m'. Allowed: x_m, y_m. Did you mean 'x_m'?")
    ]


def test_a_written_value_reads_back_the_same() -> None:
    for shelf in (
        Shelf(3, 0.8),
        Shelf(1, 1.25, "pine", (Lamp("a", 1.5), Lamp("b")), ("red",), "B2", Book("Zen")),
        Shelf(2, 1.0, top=Box((Book("Zen"), Box((Book("a"),), lid=True)))),
    ):
        data = data_of(Shelf, shelf)
        assert told(data) == []
        assert value_from(Shelf, data) == shelf
        assert json.loads(json.dumps(data)) == data
    assert value_from(Shelf, LEAST) == Shelf(3, 0.8)
    assert data_of(Shelf, Shelf(3, 0.8)) == {
        "boards": 3,
        "width_cm": 80,
        "wood": "oak",
        "colours": [],
        "number": "A1",
        "light": {"name": "top", "brightness": 50},
    }
    assert list(data_of(Shelf, Shelf(1, 1.0, top=Box((Book("a"),))))["top"]) == ["lid", "things"]


def test_editors_refuse_what_the_program_refuses() -> None:
    schema = file_schema(Shelf, schema_id="test:shelf", title="A shelf")
    jsonschema.Draft202012Validator.check_schema(schema)
    validator = jsonschema.Draft202012Validator(schema)
    for data in (
        LEAST,
        {},
        LEAST | {"boards": 0},
        LEAST | {"lamps": [{"name": "a"}, {"name": ""}]},
        LEAST | {"colours": ["a", "a"]},
        LEAST | {"number": "b"},
        LEAST | {"top": {}},
        LEAST | {"top": {"book": "a"}},
        LEAST | {"top": {"book": "a", "lid": True}},
        LEAST | {"top": {"lid": True, "things": [{"things": [{"book": "a"}]}]}},
        LEAST | {"top": {"things": [{"things": []}]}},
        LEAST | {"light": {"name": "a", "brightness": -1}},
    ):
        assert validator.is_valid(data) == (not told(data)), data
    assert schema["$defs"]["thing"]["title"] == "thing"
    assert schema["properties"]["light"]["description"] == "One lamp of `a shelf`."


def test_the_page_has_a_section_for_each_group() -> None:
    page = reference(Shelf)
    assert "| `boards` | whole number, at least 1, required | How many boards it has. |" in page
    assert "| `width_cm` | number, more than 0, required | From left to right. |" in page
    assert "| `number` | a letter and a digit, `A1` | Where it stands. |" in page
    assert "| `lamps` | list of up to 2 entries: a group, see below, none | Its lamps. |" in page
    assert "\n## `lamps`\n\nIts lamps.\n\n| key |" in page
    assert "| `brightness` | number in percent, at least 0, at most 100, `50` | How bright it is. |" in page
    assert "\n## `top`\n\nWhat stands on it.\n\nOne book.\n\n| key |" in page
    assert "| `things` | list of at least 1 entry: a thing, required | What is in it. |" in page


@dataclass(frozen=True, slots=True)
class _CornerKeys:
    """A corner, in centimetres."""

    at_cm: Annotated[tuple[float, float], FieldSpec("Across and down.")]


@dataclass(frozen=True, slots=True)
class Plug:
    """Power supply of the lamp."""

    kind: Annotated[Literal["wall", "battery", "none"], FieldSpec("Which.")] = "wall"
    volts: Annotated[float | None, FieldSpec("Of the wall.", beside=("kind", "wall"), needed=("kind", "wall"))] = None
    cells: Annotated[int | None, FieldSpec("Of the battery.", beside=("kind", "battery"))] = None
    fuse_a: Annotated[float | None, FieldSpec("Its fuse.", beside=("volts",))] = None


@dataclass(frozen=True, slots=True)
class Bulb:
    """A bulb."""

    watts: Annotated[float | None, FieldSpec("Power.")] = None
    lumens: Annotated[float | None, FieldSpec("Light.", instead_of=("watts",))] = None


@dataclass(frozen=True, slots=True)
class Fitting:
    """A fitting on the wall."""

    corner_m: Annotated[
        tuple[float, float],
        StoredAs(
            _CornerKeys,
            lambda keys: tuple(cm / 100 for cm in keys.at_cm),
            lambda corner_m: _CornerKeys((corner_m[0] * 100, corner_m[1] * 100)),
        ),
        FieldSpec("Where it is.", key="corner"),
    ]
    bulb: Annotated[Bulb, FieldSpec("The bulb.", some_of=("watts", "lumens"), needs="a bulb has watts or lumens.")]
    plug: Annotated[Plug | None, FieldSpec("Its plug.")] = None
    told: Annotated[Mapping[str, Any], FieldSpec("What its makers say.", quiet=True)] = field(default_factory=dict)
    label: Annotated[bool | float | str, FieldSpec("What is written on it.", wanted=True)] = ""


FITTING: dict[str, Any] = {"corner": {"at_cm": [50, 20]}, "bulb": {"watts": 5}, "label": 7}


@pytest.mark.parametrize(
    ("wrong", "path", "sentence"),
    [
        ({"plug": {"kind": "wall"}}, ("plug", "kind"), "'plug.kind': 'wall' also requires 'volts'."),
        (
            {"plug": {"kind": "battery", "volts": 1}},
            ("plug", "volts"),
            "'plug.volts' is allowed only with 'kind: wall', found 'battery'.",
        ),
        (
            {"plug": {"kind": "battery", "fuse_a": 1}},
            ("plug", "fuse_a"),
            "'plug.fuse_a' is allowed only with 'volts', which is missing.",
        ),
        (
            {"plug": {"kind": "battery", "fuse_a": 1, "vols": 1}},
            ("plug", "vols"),
            "unknown key 'vols' in 'plug'. Allowed: cells, fuse_a, kind, volts. Did you mean 'volts'?",
        ),
        ({"plug": {"kind": "sun", "cells": 2}}, ("plug", "kind"), "unknown kind 'sun'. Allowed: wall, battery, none."),
        ({"bulb": {}}, ("bulb",), "a bulb has watts or lumens."),
        (
            {"bulb": {"lumen": 1}},
            ("bulb", "lumen"),
            "unknown key 'lumen' in 'bulb'. Allowed: lumens, watts. Did you mean 'lumens'?",
        ),
        (
            {"bulb": {"lumens": 1, "watts": 1}},
            ("bulb", "lumens"),
            "'bulb.lumens' cannot be combined with 'watts': remove one of the two.",
        ),
        ({"corner": {"at_cm": [1, 2, 3]}}, ("corner", "at_cm"), "'corner.at_cm' has 3 entries. Allowed: 2."),
        ({"corner": {"at_cm": []}}, ("corner", "at_cm"), "'corner.at_cm' is empty. Allowed: 2."),
        ({"told": []}, ("told",), "'told' must be a group of 'key: value' lines, found []."),
        ({"label": None}, ("label",), "'label' must be true or false, a number or text, found nothing."),
    ],
)
def test_constraints_between_keys_are_declared_too(
    wrong: dict[str, Any], path: tuple[str | int, ...], sentence: str
) -> None:
    data = FITTING | wrong
    assert told(data, Fitting) == [(path, sentence)]
    assert not jsonschema.Draft202012Validator(file_schema(Fitting, title="A fitting")).is_valid(data)


def test_a_key_that_is_wanted_must_be_given() -> None:
    assert told({"corner": {"at_cm": [1, 2]}, "bulb": {"watts": 1}}, Fitting) == [((), "'label' is missing.")]


def test_a_value_may_be_written_as_another_declaration_and_under_another_word() -> None:
    data = FITTING | {"plug": {"kind": "wall", "volts": 230}, "told": {"year": 1.0, "by": ["a"]}}
    assert told(data, Fitting) == []
    assert jsonschema.Draft202012Validator(file_schema(Fitting, title="A fitting")).is_valid(data)
    fitting = value_from(Fitting, data)
    assert fitting == Fitting((0.5, 0.2), Bulb(5), Plug("wall", 230), {"year": 1.0, "by": ["a"]}, 7)
    # Undeclared data is not changed: 1.0 does not become 1.
    assert json.dumps(data_of(Fitting, fitting)["told"]) == json.dumps(data["told"])
    assert data_of(Fitting, fitting) == data
    assert data_of(Fitting, Fitting((0.0, 0.0), Bulb(1), label=True)) == {
        "corner": {"at_cm": [0, 0]},
        "bulb": {"watts": 1},
        "label": True,
    }


def test_each_single_value_can_be_replaced_by_what_it_is() -> None:
    seen: list[KeyPath] = []

    def doubled(form: ValueForm, value: Any, path: KeyPath) -> Any:
        seen.append(path)
        return value * 2 if form.kind is float else value

    assert replaced(Fitting, FITTING | {"told": {"x": 1}}, doubled) == {
        "corner": {"at_cm": [100, 40]},
        "bulb": {"watts": 10},
        "label": 7,
        "told": {"x": 1},
    }
    assert seen == [("corner", "at_cm", 0), ("corner", "at_cm", 1), ("bulb", "watts"), ("label",), ("told",)]


def test_tables_are_written_between_their_marks() -> None:
    page = "Before\n<!-- keys of fitting.plug: fuse_a volts -->\nold\n<!-- end of keys -->\nAfter\n"
    written = with_tables(page, {"fitting": Fitting})
    assert written == (
        "Before\n<!-- keys of fitting.plug: fuse_a volts -->\n\n"
        "| key | values, default | meaning |\n| --- | --- | --- |\n"
        "| `fuse_a` | number, only with `volts`, none | Its fuse. |\n"
        "| `volts` | number, required and only with `kind: wall` | Of the wall. |\n"
        "\n<!-- end of keys -->\nAfter\n"
    )
    assert with_tables(written, {"fitting": Fitting}) == written
    page = reference(Fitting)
    assert "| `corner` | a group, see below, required | Where it is. |" in page
    assert "| `at_cm` | list of 2 entries: number, required | Across and down. |" in page
    assert "| `lumens` | number, instead of `watts` | Light. |" in page
    assert "| `label` | `true` or `false` or number or text, required | What is written on it. |" in page


def test_a_password_in_an_address_is_not_repeated() -> None:
    number = {"boards": 1, "width_cm": 1, "number": "ws://me:secret@host"}
    assert told(number) == [(("number",), "'number' is 'ws://...@host'. Allowed: a letter and a digit.")]
