"""The JSON Schema of the scenario file agrees with its declaration."""

import random
from collections.abc import Iterator
from typing import Any

import pytest

from caris_desktop.domain.schema_fields import data_of
from caris_desktop.domain.schema_validation import problems
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.scenario.scenario_model import Scenario
from tests.support.invalid_data import with_mistake
from tests.support.schemas import schema_validator


def shipped() -> Iterator[dict[str, Any]]:
    for path in sorted(layouts_dir().glob("*.yaml")):
        yield data_of(Scenario, load_scenario(path))


@pytest.mark.long
def test_editors_and_the_program_refuse_the_same() -> None:
    validator = schema_validator("scenario.schema.json")
    chance = random.Random(9)  # noqa: S311 - a test, not cryptography
    refused = 0
    files = list(shipped())
    for data in files:
        assert validator.is_valid(data)
        for _ in range(80):
            tried = with_mistake(data, chance, ["unknown", "panel", "tabs", "weights", "name"])
            wrong = list(problems(Scenario, tried))
            assert validator.is_valid(tried) == (not wrong), (tried, wrong)
            refused += bool(wrong)
    assert 20 < refused / len(files) < 80


def test_an_editor_explains_each_key() -> None:
    schema = schema_validator("scenario.schema.json").schema
    groups = [schema, *(value for value in schema["properties"].values() if "properties" in value)]
    assert len(groups) > 4
    for group in groups:
        for name, key in group["properties"].items():
            assert key.get("description"), name
