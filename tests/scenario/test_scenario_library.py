"""List of available scenarios."""

from pathlib import Path

import pytest

from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.scenario.scenario_file import ScenarioError, find_scenario, list_scenarios, own_file_called, title_of


def test_the_library_lists_shipped_and_own_scenarios(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("title: Mine\nlayout: {panel: video}\n")
    (tmp_path / "broken.yaml").write_text("title: Broken\n")
    (tmp_path / "tour-guide.yaml").write_text("title: My tour\nlayout: {panel: video}\n")
    (tmp_path / "notes.txt").write_text("not a scenario")
    assert {choice.path: choice.title for choice in list_scenarios(user_dir=tmp_path)} == {
        layouts_dir() / "blank.yaml": "Blank",
        layouts_dir() / "mental-health-check.yaml": "Mental health check",
        layouts_dir() / "practice.yaml": "Practice",
        layouts_dir() / "reception.yaml": "Reception",
        tmp_path / "tour-guide.yaml": "My tour",
        tmp_path / "mine.yaml": "Mine",
        tmp_path / "broken.yaml": "broken",
    }


def test_those_with_the_same_title_are_distinguished_by_their_files(tmp_path: Path) -> None:
    (tmp_path / "mine.yaml").write_text("title: Reception\nlayout: {panel: video}\n")
    titles = [choice.title for choice in list_scenarios(user_dir=tmp_path)]
    assert titles == ["Blank", "Mental health check", "Practice", "Reception", "Tour guide", "Reception (mine)"]


def test_a_scenario_of_ones_own_is_retained_by_its_title() -> None:
    stems = [own_file_called(title).stem for title in ("Second study", "Führung, 2. Teil", "../..", "a" * 80, "日本")]
    assert stems == ["second-study", "führung-2-teil", "scenario", "a" * 60, "日本"]


def test_scenarios_are_found_by_name_and_by_path(tmp_path: Path) -> None:
    own = tmp_path / "mine.yaml"
    own.write_text("title: Mine\nlayout: {panel: video}\n")
    assert find_scenario("tour-guide", user_dir=tmp_path) == layouts_dir() / "tour-guide.yaml"
    assert find_scenario("mine.yaml", user_dir=tmp_path) == own
    assert find_scenario(own, user_dir=tmp_path / "empty") == own
    with pytest.raises(ScenarioError, match=r"There is no scenario 'tuor'.*mental-health-check, mine, .*tour-guide"):
        find_scenario("tuor", user_dir=tmp_path)
    with pytest.raises(ScenarioError):
        find_scenario("../mine", user_dir=tmp_path)


def test_a_title_is_read_again_where_the_file_changed(tmp_path: Path) -> None:
    own = tmp_path / "mine.yaml"
    for title in ("Mine", "Still mine"):
        own.write_text(f"title: {title}\nlayout: {{panel: video}}\n")
        assert title_of(own) == title
    own.unlink()
    assert title_of(own) == "mine"
