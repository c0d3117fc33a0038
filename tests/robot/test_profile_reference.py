"""The JSON Schema and the reference of robot profiles agree with the declaration."""

import random
from collections.abc import Iterator
from typing import Any

import pytest

from caris_desktop.domain.control_definitions import RobotControl
from caris_desktop.domain.schema_fields import Group, keys_of
from caris_desktop.domain.schema_json import with_tables
from caris_desktop.domain.schema_validation import problems
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.yaml_files import parse_yaml
from caris_desktop.robot.profile_model import ProfileFile, RobotProfile
from tests.support.invalid_data import with_mistake
from tests.support.schemas import schema_validator

PATHS = sorted((resources_dir() / "robots").glob("*.yaml"))
# Keys that depend on one another, and an unknown one.
MORE = (
    "unknown", "action", "call", "choices", "clear_service", "command_topic", "cx_px", "footprint_radius_m", "fx_px",
    "heading_rad", "inverted", "parameters", "polygon_m", "publish", "range", "reconfigure", "service_type",
    "set_service", "shows", "speaking", "timeout_source", "topic",
)  # fmt: skip


def with_data() -> Iterator[tuple[str, Group, dict[str, Any]]]:
    for path in PATHS:
        data = parse_yaml(path.read_text(encoding="utf-8")).data
        yield "robot-profile.schema.json", ProfileFile, data
        for control in data.get("controls", []):
            yield "robot-control.schema.json", RobotControl, control


@pytest.mark.long
def test_editors_and_the_program_refuse_the_same() -> None:
    chance = random.Random(9)  # noqa: S311 - a test, not cryptography
    tried = refused = 0
    for schema, declaration, data in with_data():
        validator = schema_validator(schema)
        assert validator.is_valid(data)
        assert list(problems(declaration, data)) == []
        for _ in range(60 if declaration is ProfileFile else 20):
            odd = with_mistake(data, chance, MORE)
            wrong = list(problems(declaration, odd))
            assert validator.is_valid(odd) == (not wrong), (odd, wrong)
            tried += 1
            refused += bool(wrong)
    assert tried / 3 < refused < tried


def groups_within(group: Group) -> Iterator[Group]:
    yield group
    for key in keys_of(group):
        for inner in (key.form.item or key.form).groups:
            yield from groups_within(inner)


@pytest.mark.parametrize("group", dict.fromkeys(groups_within(ProfileFile)), ids=lambda group: group.__name__)
def test_every_key_says_what_it_means(group: Group) -> None:
    table = with_tables("<!-- keys of x -->\n\n<!-- end of keys -->", {"x": group})
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in table.splitlines() if "| `" in line]
    assert [row[0] for row in rows] == [f"`{key.name}`" for key in keys_of(group)]
    for name, allowed, meaning in rows:
        assert allowed, name
        assert meaning, name


def test_few_keys_are_in_the_file_alone() -> None:
    in_file = {key.name for key in keys_of(ProfileFile)}
    assert in_file - {key.name for key in keys_of(RobotProfile)} == {"version", "namespace", "footprint_radius_m"}
