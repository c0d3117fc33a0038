"""Panel settings of a scenario: applied when it is opened, then changed by the wizard."""

from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QPointF
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import Odometry, RobotPose
from caris_desktop.live.status import AssistantSetup, ContextPartStatus
from caris_desktop.scenario.scenario_file import ScenarioError, parse_scenario
from caris_desktop.scenario.scenario_model import (
    DriveSettings,
    LogSettings,
    MapSettings,
    PanelName,
    PanelSettings,
    QuestionSettings,
    Scenario,
    TabNode,
    VideoSettings,
)
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.scenario_editor.editor_window import ScenarioEditor
from caris_desktop.ui.scenario_editor.saving import opened_file
from caris_desktop.ui.theme import Theme
from tests.ui import samples
from tests.ui.conftest import MemorySettings, open_window
from tests.ui.fake_console import FakeConsole

PARTS = (ContextPartStatus("conversation", "Conversation", 6, 124), ContextPartStatus("notes", "Notes", 1, 1))


def with_panels(*names: PanelName, path: str = "/layouts/set.yaml", **settings: Any) -> Scenario:
    return replace(samples.TOUR, layout=TabNode(names or ("map",)), panels=PanelSettings(**settings), path=Path(path))


PLAIN = with_panels("map", "video", "drive", "session", "assistant", path="/layouts/plain.yaml")
SET = with_panels(
    "map", "video", "drive", "session", "assistant",
    map=MapSettings(follow=True, up="robot", trail=False), video=VideoSettings("desk"), drive=DriveSettings("stick"),
    session=LogSettings("problems"), assistant=QuestionSettings(("notes",)),
)  # fmt: skip


@pytest.fixture
def console() -> FakeConsole:
    return FakeConsole(SET)


def switch(window: MainWindow, console: FakeConsole, scenario: Scenario) -> None:
    console.scenario = scenario
    console.state.scenario.reset_value(scenario)
    window.board.complete()


def panel(window: MainWindow, name: PanelName) -> Any:
    window.open_panel(name)
    return window.panels[name]


def pictures_of(console: FakeConsole, camera: str) -> None:
    image_bgr = np.zeros((48, 64, 3), np.uint8)
    console.state.add(console.frames.add(image_bgr, camera=camera))


def seen(window: MainWindow, console: FakeConsole) -> dict[str, object]:
    """Displayed settings of each panel."""
    the_map, session, assistant = (panel(window, name) for name in ("map", "session", "assistant"))
    console.state.assistant_setup.set(AssistantSetup(parts=PARTS))
    lines = {action.text().split("\t")[0]: action.isChecked() for action in the_map.fill_menu().actions()}
    drive = panel(window, "drive")
    drive.resize(260, 150)
    return {
        "follows": lines["Follow the robot"],
        "turns": lines["Rotate with the robot"],
        "trail": lines["Show the driven path"],
        "camera": console.state.camera.value,
        "stick": drive._stick.isVisible() and not drive._pad.isVisible(),
        "log": session._filter.text(),
        "left out": [chip.text() for chip in assistant.along.chips if not chip.isChecked()],
    }


OF_SET = {
    "follows": True, "turns": True, "trail": False, "camera": "desk", "stick": True, "log": "Problems",
    "left out": ["Notes · 1 word"],
}  # fmt: skip
AS_USUAL = {
    "follows": False, "turns": False, "trail": True, "camera": "front", "stick": False, "log": "Everything",
    "left out": [],
}  # fmt: skip


def test_each_setting_is_seen_in_its_panel_and_the_next_scenario_has_its_own(
    window: MainWindow, console: FakeConsole
) -> None:
    pictures_of(console, "desk")
    assert {each.name for each in fields(PanelSettings)} == {"map", "video", "drive", "session", "assistant"}
    assert seen(window, console) == OF_SET
    switch(window, console, PLAIN)
    assert seen(window, console) == AS_USUAL
    switch(window, console, SET)
    assert seen(window, console) == OF_SET


def test_the_wizard_changes_them_until_the_next_scenario(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    pictures_of(console, "desk")
    the_map = panel(window, "map")
    next(action for action in the_map.fill_menu().actions() if action.objectName() == "map_follow").trigger()
    the_map.view.set_rotate(False)
    the_map.view.show_layer("trail", True)
    console.state.choose_camera("front")
    panel(window, "session").show_category("")
    drive = panel(window, "drive")
    drive.resize(260, 150)
    while drive._pad.isHidden():
        drive._other.click()
    panel(window, "assistant").along.restore((), ())
    assert seen(window, console) == AS_USUAL
    # Another part of the file was changed in the editor meanwhile.
    switch(window, console, replace(SET, filler="Let me see."))
    assert seen(window, console) == AS_USUAL
    switch(window, console, replace(SET, path=Path("/layouts/other.yaml")))
    assert seen(window, console) == OF_SET


def test_removed_context_comes_back_with_a_rebuilt_panel(window: MainWindow, console: FakeConsole) -> None:
    assistant = panel(window, "assistant")
    assistant.along.restore(("conversation",), ())
    assistant.field.setText("What")
    window.show_scenario(SET)  # the same scenario again: all panels are rebuilt
    again = panel(window, "assistant")
    assert again is not assistant
    assert (again.field.text(), again.along.left_out) == ("What", ("conversation",))


def test_a_camera_that_comes_late_is_on_show_then_unless_another_was_chosen(
    window: MainWindow, console: FakeConsole
) -> None:
    assert console.state.camera.value == "front"
    pictures_of(console, "desk")
    assert console.state.camera.value == "desk"
    console.state.choose_camera("front")
    pictures_of(console, "door")
    assert console.state.camera.value == "front"


def test_a_camera_that_the_wizard_chose_stays_where_the_next_scenario_names_none(
    window: MainWindow, console: FakeConsole
) -> None:
    pictures_of(console, "desk")
    pictures_of(console, "door")
    console.state.choose_camera("door")
    switch(window, console, PLAIN)
    assert console.state.camera.value == "door"


def test_a_map_that_follows_is_seen_from_near_though_its_first_map_comes_later(
    qtbot: QtBot, settings: MemorySettings, theme: Theme
) -> None:
    scenario = replace(samples.TOUR, panels=PanelSettings(MapSettings(follow=True)))
    console = FakeConsole(scenario)
    view = panel(open_window(qtbot, console, settings, theme), "map").view
    view.show_map(None)
    console.state.add(samples.floor_plan())
    qtbot.waitUntil(lambda: view.grid.raster is not None)
    pose = view.map_state.pose
    assert pose is not None
    middle = view.to_map(QPointF(view.width() / 2, view.height() / 2))
    assert (middle - QPointF(pose.x_m, pose.y_m)).manhattanLength() < 0.2
    near = view.px_per_m
    view.set_follow(False)
    view.fit()
    assert view.px_per_m < near, "the whole map is farther away"


def test_a_map_continues_following_after_it_was_drawn_by_odometry(
    qtbot: QtBot, settings: MemorySettings, theme: Theme
) -> None:
    """Without a map the robot is always followed."""
    for follow in (True, False):
        console = FakeConsole(with_panels("map", map=MapSettings(follow=follow)))
        window = open_window(qtbot, console, settings, theme)
        console.state.pose.clear()
        console.state.map.clear()
        for second in range(5):
            here = Pose2D(0.0, 0.0, 0.0)
            console.state.add(Odometry(clock.now_ns() + second * 1_000_000_000, None, here, Twist2D()))
        view = panel(window, "map").view
        assert view.follow
        console.state.add(RobotPose(clock.now_ns(), None, Pose2D(1.0, 1.0, 0.0)))
        assert view.follow is follow


def test_a_wrong_one_is_reported_with_its_line() -> None:
    text = (
        "version: 1\ntitle: Mine\nlayout: {panel: map}\npanels:\n  map:\n    up: south\n  session: {shows: nothing}\n"
    )
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text, path=Path("mine.yaml"))
    up, shows = str(caught.value).splitlines()
    assert up.startswith("mine.yaml, line 6: ") and "north" in up and "robot" in up
    assert shows.startswith("mine.yaml, line 7: ") and "problems" in shows


def test_the_form_of_the_scenario_changes_its_line_alone(qtbot: QtBot, theme: Theme, tmp_path: Path) -> None:
    text = (
        "version: 1\ntitle: Mine\nlayout: {panel: map}\npanels:  # as we agreed\n"
        "  map: {follow: true}\n  session:\n    shows: said   # no more\n"
    )
    path = tmp_path / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    editor = ScenarioEditor(theme, FakeConsole(parse_scenario(text, path=path)), opened_file(path))
    qtbot.addWidget(editor)
    editor.show()
    field: Any = editor.reveal(("panels", "session", "shows"))
    assert field is not None
    field.enter("problems")
    assert editor.document.text == text.replace("shows: said ", "shows: problems ")
