"""Resetting the panels undoes a saved layout, in the window and in the file."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from PySide6.QtCore import QSettings
from pytestqt.qtbot import QtBot

from caris_desktop.app import user_settings
from caris_desktop.app.console_command import ConsoleRun, default_arguments
from caris_desktop.domain import intents
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.status import PracticeStatus
from caris_desktop.scenario.scenario_file import load_scenario, user_scenarios_dir
from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, Scenario, SplitNode, layout_text, panels_in

ARRANGED: LayoutNode = SplitNode("horizontal", (PanelLeaf("video"), PanelLeaf("speak")), (0.7, 0.3))


@pytest.fixture
def settings(tmp_path: Path) -> QSettings:
    return QSettings(str(tmp_path / "settings.ini"), QSettings.Format.IniFormat)


@pytest.fixture
def run(qtbot: QtBot, tmp_path: Path, settings: QSettings) -> Iterator[ConsoleRun]:
    run = ConsoleRun(default_arguments(scenario="tour-guide", study=tmp_path / "study"), settings=settings)
    qtbot.addWidget(run.window)
    yield run
    run.close()


def _save(qtbot: QtBot, run: ConsoleRun, layout: LayoutNode) -> None:
    assert run.console.do(intents.SaveLayout(layout_text(layout), "usual")) == ""
    qtbot.waitUntil(lambda: run.console.scenario.layout == layout, timeout=20_000)


def test_a_saved_layout_is_undone_in_the_window_and_in_the_file(run: ConsoleRun, qtbot: QtBot) -> None:
    shipped = run.console.scenario.layout
    _save(qtbot, run, ARRANGED)
    own = user_scenarios_dir() / "tour-guide.yaml"
    assert load_scenario(own).layout == ARRANGED
    _save(qtbot, run, PanelLeaf("map"))
    run.window.layout_keeper.put_back()
    qtbot.waitUntil(lambda: run.console.scenario.layout == shipped, timeout=20_000)
    assert load_scenario(own).layout == shipped
    # The window follows the console in a later turn of the event loop.
    qtbot.waitUntil(lambda: set(run.window.panels) == set(panels_in(shipped)), timeout=20_000)
    run.window.layout_keeper.put_back()
    run.close()
    assert load_scenario(own).layout == shipped, "there is nothing more to undo"


def test_a_layout_that_is_saved_while_the_window_closes_is_there_the_next_time(
    run: ConsoleRun, settings: QSettings
) -> None:
    assert run.console.do(intents.SaveLayout(layout_text(ARRANGED), "usual")) == ""
    run.close()
    own = user_scenarios_dir() / "tour-guide.yaml"
    assert load_scenario(own).layout == ARRANGED
    assert settings.value("scenario/last") == str(own)


def test_the_scenario_to_practise_in_is_not_that_of_the_next_start(run: ConsoleRun, qtbot: QtBot) -> None:
    practice = layouts_dir() / "practice.yaml"
    run.console.state.practice.set(PracticeStatus("preparing"))
    told: list[Scenario] = []
    run.console.state.scenario.changed.connect(told.append)  # after the console's handler, which saves it
    run.console.do(intents.OpenScenario(practice))
    qtbot.waitUntil(lambda: bool(told) and told[-1].path == practice, timeout=20_000)
    assert run.settings.value("scenario/last") != str(practice)
    run.console.state.practice.set(PracticeStatus())
    run.console.do(intents.OpenScenario(layouts_dir() / "blank.yaml"))
    qtbot.waitUntil(lambda: run.settings.value("scenario/last") == str(layouts_dir() / "blank.yaml"), timeout=20_000)


def test_text_added_to_the_file_by_hand_is_left_alone(run: ConsoleRun, qtbot: QtBot) -> None:
    _save(qtbot, run, ARRANGED)
    own = user_scenarios_dir() / "tour-guide.yaml"
    own.write_text(own.read_text("utf-8").replace("speak", "session"), "utf-8")
    run.console.do(intents.OpenScenario(own))
    qtbot.waitUntil(lambda: panels_in(run.console.scenario.layout) == ("video", "session"), timeout=20_000)
    run.window.layout_keeper.put_back()
    run.close()
    assert panels_in(load_scenario(own).layout) == ("video", "session")


@pytest.mark.logs(r"app\.user_settings: ")
@pytest.mark.parametrize("kept", ["no JSON", "[]", '{"PATH": 3}', '{"PATH": {"saved": SAVED, "before": {"panel": 1}}}'])
@pytest.mark.long
def test_broken_settings_undo_nothing(run: ConsoleRun, qtbot: QtBot, kept: str) -> None:
    own = user_scenarios_dir() / "tour-guide.yaml"
    _save(qtbot, run, PanelLeaf("map"))
    run.settings.setValue("layout/before_saving", kept.replace("PATH", str(own)).replace("SAVED", '{"panel": "map"}'))
    run.window.layout_keeper.put_back()
    run.close()
    assert load_scenario(own).layout == PanelLeaf("map")


def test_a_layout_for_small_screens_is_saved_and_undone_with_the_rest(run: ConsoleRun, qtbot: QtBot) -> None:
    shipped = run.console.scenario
    assert run.console.do(intents.SaveLayout(layout_text(ARRANGED), "compact")) == ""
    qtbot.waitUntil(lambda: run.console.scenario.layout_compact == ARRANGED, timeout=20_000)
    own = load_scenario(user_scenarios_dir() / "tour-guide.yaml")
    assert (own.layout, own.layout_compact) == (shipped.layout, ARRANGED)
    run.window.layout_keeper.put_back()
    qtbot.waitUntil(lambda: run.console.scenario.layout_compact is None, timeout=20_000)
    assert load_scenario(user_scenarios_dir() / "tour-guide.yaml").layout_compact is None


def test_saving_as_another_scenario_leaves_this_one_and_writes_over_nothing(run: ConsoleRun, qtbot: QtBot) -> None:
    before = run.console.scenario
    for file_name in ("my-tour.yaml", "my-tour-2.yaml"):
        assert run.console.do(intents.SaveLayout(layout_text(ARRANGED), "usual", "My tour!")) == ""
        qtbot.waitUntil(lambda name=file_name: run.console.scenario.path.name == name, timeout=20_000)  # type: ignore[misc]
        saved = load_scenario(user_scenarios_dir() / file_name)
        assert (saved.title, saved.layout, saved.phrases) == ("My tour!", ARRANGED, before.phrases)
    assert not (user_scenarios_dir() / "tour-guide.yaml").exists()


def test_the_reason_of_a_failed_save_is_reported_without_a_number() -> None:
    told = user_settings._not_saved(Path("tour.yaml"), PermissionError(13, "Permission denied", "/place/tour.yaml"))
    assert told.meaning == "tour.yaml cannot be written (Permission denied)."
