"""What is shipped about the scenario file is what its declaration says."""

import copy
import random
from collections.abc import Iterator
from typing import Any

import jsonschema
import pytest

from caris_desktop.domain.declared import data_of
from caris_desktop.domain.declared_check import problems
from caris_desktop.domain.shipped import layouts_dir, schema_validator
from caris_desktop.scenario import reference
from caris_desktop.scenario.file import load_scenario, schema_path
from caris_desktop.scenario.model import Scenario

WRITE_ANEW = "run: python -m caris_desktop.scenario.reference"
ODD: tuple[Any, ...] = (
    None, True, 0, -1, 1.5, 1e9, "", "robot", "x" * 9000, [], ["a"], ["a", "a"], ["a"] * 200, {}, {"panel": "map"},
    {"tabs": ["map"], "current": "map"}, {"name": "a", "x_m": 0, "y_m": 0},
)  # fmt: skip


def test_the_shipped_schema_and_page_are_the_declared_ones() -> None:
    assert schema_path().read_text(encoding="utf-8") == reference.schema_text(), WRITE_ANEW
    assert reference.page_path().read_text(encoding="utf-8") == reference.page_text(), WRITE_ANEW


def test_the_command_writes_both(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reference, "schema_path", lambda: tmp_path / "schema.json")
    monkeypatch.setattr(reference, "page_path", lambda: tmp_path / "page.md")
    reference.main()
    assert (tmp_path / "schema.json").read_text(encoding="utf-8") == reference.schema_text()
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == reference.page_text()


def changed(data: dict[str, Any], chance: random.Random) -> dict[str, Any]:
    """``data`` with one odd value, one key more or one less somewhere."""
    data = copy.deepcopy(data)
    place: Any = data
    while True:
        key = chance.choice([*place]) if isinstance(place, dict) else chance.randrange(len(place))
        inner = place[key]
        if not isinstance(inner, (dict, list)) or not inner or chance.random() < 0.3:
            break
        place = inner
    # Version 0, which does not say its version, is raised to 1 before it is checked.
    what = chance.choice(["odd", "odd", "less", "more"]) if key != "version" else "more"
    if what == "odd":
        place[key] = chance.choice(ODD)
    elif what == "less":
        del place[key]
    elif isinstance(place, dict):
        place[chance.choice(["unknown", "panel", "tabs", "weights", "name"])] = chance.choice(ODD)
    return data


def shipped() -> Iterator[dict[str, Any]]:
    for path in sorted(layouts_dir().glob("*.yaml")):
        yield data_of(Scenario, load_scenario(path))


def test_editors_and_the_program_refuse_the_same() -> None:
    validator = schema_validator("scenario.schema.json")
    chance = random.Random(9)  # noqa: S311 - which of many mistakes is tried
    refused = 0
    for data in shipped():
        assert validator.is_valid(data)
        for _ in range(200):
            tried = changed(data, chance)
            wrong = list(problems(Scenario, tried))
            assert validator.is_valid(tried) == (not wrong), (tried, wrong)
            refused += bool(wrong)
    assert 100 < refused < 400


def test_an_editor_explains_each_key() -> None:
    schema = jsonschema.Draft202012Validator(schema_validator("scenario.schema.json").schema).schema
    groups = [schema, *(value for value in schema["properties"].values() if "properties" in value)]
    assert len(groups) > 4
    for group in groups:
        for name, key in group["properties"].items():
            assert key.get("description"), name
