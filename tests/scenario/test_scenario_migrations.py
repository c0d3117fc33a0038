"""Scenario files of older versions."""

from pathlib import Path
from typing import Any

import pytest

from caris_desktop.scenario.scenario_file import MIGRATIONS, load_scenario, migrate
from caris_desktop.scenario.scenario_model import SCENARIO_VERSION


def test_there_is_a_step_from_every_older_version() -> None:
    assert set(MIGRATIONS) == set(range(SCENARIO_VERSION))


def test_steps_are_taken_in_order_and_leave_the_original_alone() -> None:
    def rename(data: dict[str, Any]) -> dict[str, Any]:
        data["title"] = data.pop("name")
        return data

    def shout(data: dict[str, Any]) -> dict[str, Any]:
        return {**data, "title": data["title"].upper()}

    old = {"version": 1, "name": "tour"}
    assert migrate(old, migrations={1: rename, 2: shout}, newest=3) == {"version": 3, "title": "TOUR"}
    assert old == {"version": 1, "name": "tour"}
    assert migrate({"version": 2, "title": "a"}, migrations={1: rename, 2: shout}, newest=3)["title"] == "A"


def test_a_file_from_before_versions_loads(tmp_path: Path) -> None:
    path = tmp_path / "old.yaml"
    path.write_text("title: Old\nlayout: {panel: video}\n")
    assert load_scenario(path).title == "Old"


@pytest.mark.parametrize("version", [2, -1, "1", True, 1.0])
def test_versions_that_are_not_ours_are_refused(version: object) -> None:
    with pytest.raises(ValueError, match="version"):
        migrate({"version": version})
