"""Layout store: the wizard's copy, separate from the file, saved, undone, locked, and fitted to the screen."""

import dataclasses
import json
import re
from pathlib import Path

import pytest
import yaml
from PySide6.QtCore import QRect, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QDialogButtonBox, QLineEdit, QMenu, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import intents
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.scenario.scenario_model import (
    LayoutNode,
    PanelLeaf,
    SplitNode,
    TabNode,
    checked_layout,
    layout_data,
    layout_from_data,
    layout_text,
    panels_in,
)
from caris_desktop.ui.dock_layout import DockLayout, arrangement_of, tidy
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.window_menus import TitleDialog
from tests.ui import samples
from tests.ui.conftest import MemorySettings, click, find
from tests.ui.fake_console import FakeConsole

WORKING = "wizards/*/layout/working"
PLACE = QRect(100, 120, 480, 360)


@pytest.fixture
def told(window: MainWindow) -> list[str]:
    told: list[str] = []
    window.layout_keeper.noticed.connect(lambda problem: told.append(problem.what))
    return told


def arranged(window: MainWindow) -> DockLayout:
    arrangement = window.dock_host.arrangement
    assert arrangement is not None
    return arrangement


def again(
    qtbot: QtBot, settings: MemorySettings, theme: Theme, scenario: samples.Scenario = samples.TOUR
) -> MainWindow:
    """Start the program again."""
    window = MainWindow(FakeConsole(scenario), settings=settings, theme=theme)
    qtbot.addWidget(window)
    window.resize(1366, 768)
    window.show()
    return window


def test_another_scenario_is_made_of_the_layout_by_the_menu_and_its_title(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    window.dock_host.float_panel("map", PLACE)
    click(qtbot, find(window, "window_menu_button"))
    menu = window.findChild(QMenu, "layout_menu")
    assert menu is not None
    save_as = next(line for line in menu.actions() if line.text() == "Save as another scenario…")
    menu.popup(window.mapToGlobal(window.rect().center()))
    QTest.mouseClick(menu, Qt.MouseButton.LeftButton, pos=menu.actionGeometry(save_as).center())
    window.findChild(QMenu, "window_menu").close()  # type: ignore[union-attr]
    qtbot.waitUntil(lambda: window.findChild(TitleDialog) is not None)
    dialog = window.findChild(TitleDialog)
    save = dialog.findChild(QDialogButtonBox).button(QDialogButtonBox.StandardButton.Save)
    assert not save.isEnabled(), "without a title there is none"
    QTest.keyClicks(dialog.findChild(QLineEdit, "layout_title_field"), " My  tour ")
    click(qtbot, save)
    tree = window.dock_host.tree
    assert tree is not None
    assert console.named("SaveLayout") == [intents.SaveLayout(layout_text(tree), "usual", "My tour")]
    qtbot.waitUntil(lambda: window.findChild(TitleDialog) is None)
    # No question after closing the dialog.
    window.layout_keeper.title_requested.emit()
    dialog = window.findChild(TitleDialog)
    QTest.keyClicks(dialog.findChild(QLineEdit, "layout_title_field"), "Other")
    click(qtbot, dialog.findChild(QDialogButtonBox).button(QDialogButtonBox.StandardButton.Cancel))
    assert len(console.named("SaveLayout")) == 1


def test_changes_of_the_layout_are_temporary_until_saved(
    qtbot: QtBot, window: MainWindow, settings: MemorySettings, theme: Theme
) -> None:
    keeper, host = window.layout_keeper, window.dock_host
    assert not keeper.is_unsaved
    assert WORKING not in settings.values
    host.move_panel("map", "video", "right")
    host.float_panel("people", PLACE)
    host.close_panel("drive")
    mine = arranged(window)
    assert keeper.is_unsaved
    assert window.menus.layout_title() == "Layout (changed, not saved)"
    assert "unsaved changes" in window._top_bar.window_button.accessibleName()
    other = again(qtbot, settings, theme)
    assert arranged(other) == mine, "it comes back, and so does the window of its own"
    assert other.dock_host.docks["people"].window() is not other
    other.layout_keeper.revert()
    assert arranged(other) == arrangement_of(samples.TOUR_LAYOUT)
    assert arranged(again(qtbot, settings, theme)) == arrangement_of(samples.TOUR_LAYOUT)
    other.layout_keeper.undo()
    assert arranged(other) == mine, "a revert can be undone"


def test_a_key_undoes_the_last_change_also_from_a_field(window: MainWindow, qtbot: QtBot) -> None:
    before = arranged(window)
    window.dock_host.move_panel("map", "video", "right")
    assert arranged(window) != before
    qtbot.keyClick(window, Qt.Key.Key_L, Qt.KeyboardModifier.ControlModifier)
    field = QApplication.focusWidget()
    assert field is not None
    qtbot.keyClick(field, Qt.Key.Key_D, Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier)
    qtbot.waitUntil(lambda: arranged(window) == before)


def test_each_change_is_undone_exactly_and_done_again(window: MainWindow) -> None:
    keeper, host = window.layout_keeper, window.dock_host
    seen = [arranged(window)]
    for change in (
        lambda: host.move_panel("map", "video", "right"),
        lambda: host.float_panel("people", PLACE),
        lambda: window.open_panel("diagnostics"),
        lambda: host.close_panel("drive"),
        lambda: window.close_panel("diagnostics"),
        lambda: host.dock_panel("people"),
    ):
        change()
        seen.append(arranged(window))
    for expected in reversed(seen[:-1]):
        keeper.undo()
        assert arranged(window) == expected
        assert set(window.panels) == set(expected.panels) == set(host.docks) - set(window.board._aside)
    assert not keeper.is_unsaved
    for expected in seen[1:]:
        keeper.redo()
        assert arranged(window) == expected


def test_saving_makes_it_the_files_and_takes_the_mark_away(window: MainWindow, console: FakeConsole) -> None:
    window.dock_host.move_panel("map", "video", "right")
    window.layout_keeper.save()
    (saved,) = console.named("SaveLayout")
    tree = layout_from_data(json.loads(saved.layout))
    assert (saved.size_class, saved.title) == ("usual", "")
    copy = dataclasses.replace(samples.TOUR, layout=tree, path=Path("/own/tour_guide.yaml"), sha256="other")
    console._others[Path("/own/tour_guide.yaml")] = copy
    console.open_scenario(Path("/own/tour_guide.yaml"))
    assert not window.layout_keeper.is_unsaved
    assert arranged(window).for_file == tidy(tree)


def test_the_first_reset_after_saving_brings_the_original_layout_back(window: MainWindow, console: FakeConsole) -> None:
    own = Path("/own/tour_guide.yaml")

    def opened(layout: LayoutNode, sha256: str) -> None:
        console._others[own] = dataclasses.replace(samples.TOUR, layout=layout, path=own, sha256=sha256)
        console.open_scenario(own)

    window.dock_host.move_panel("map", "video", "right")
    window.layout_keeper.save()
    (saved,) = console.named("SaveLayout")
    mine = layout_from_data(json.loads(saved.layout))
    opened(mine, "saved")
    window.layout_keeper.put_back()
    assert console.named("ResetLayout")
    opened(samples.TOUR_LAYOUT, "reset")  # the file is written in the background
    window.board.complete()
    assert arranged(window) == arrangement_of(samples.TOUR_LAYOUT)
    assert not window.layout_keeper.is_unsaved


@pytest.mark.long
def test_locked_nothing_is_moved_closed_or_floated_and_it_is_reported(
    window: MainWindow, told: list[str], settings: MemorySettings, qtbot: QtBot, theme: Theme
) -> None:
    host, keeper = window.dock_host, window.layout_keeper
    host.move_panel("map", "video", "right")
    keeper.set_locked(True)
    before = arranged(window)
    host.close_panel("drive")
    host.float_panel("video")
    host.move_panel("speak", "video", "left")
    handle = host._handles[0]
    assert not handle.isEnabled()
    handle.moved.emit(host.placing.handles[0], 80, True)
    keeper.undo()
    assert arranged(window) == before
    assert len(told) == 4 and set(told) == {"The layout is locked, so nothing was moved. Unlock it in the Layout menu."}
    assert all(dock._float.isHidden() for dock in host.docks.values())
    host.show_panel("session")
    assert host.docks["session"].isVisible(), "tabs are still chosen"
    other = again(qtbot, settings, theme)
    assert other.layout_keeper.locked, "a study goes on tomorrow"
    other.layout_keeper.put_back()
    assert arranged(other) == arrangement_of(samples.TOUR_LAYOUT), "reset is always there"
    keeper.set_locked(False)
    host.close_panel("drive")
    assert not host.is_open("drive")


@pytest.mark.logs(r"ui\.layout_store: ")
@pytest.mark.parametrize(
    "kept",
    [
        "no JSON",
        "[]",
        '{"tour_guide.yaml": {"usual": 3}}',
        '{"tour_guide.yaml": {"usual": {"of": OF, "arrangement": {"tree": {"panel": "nonsense"}}}}}',
        '{"tour_guide.yaml": {"usual": {"of": OF, "arrangement": {"tree": {"tabs": ["map", "map"]}}}}}',
        '{"tour_guide.yaml": []}',
    ],
)
def test_a_broken_layout_is_put_aside_and_the_one_of_the_file_shown(
    qtbot: QtBot, theme: Theme, settings: MemorySettings, kept: str
) -> None:
    kept = kept.replace("OF", json.dumps(layout_data(tidy(samples.TOUR_LAYOUT))))
    settings.setValue("wizards/*/layout/adapts", "no")
    settings.setValue(WORKING, kept)
    window = again(qtbot, settings, theme)
    assert "could not be read" in window.problems.cards[0].problem.what
    assert arranged(window) == arrangement_of(samples.TOUR_LAYOUT)
    window.dock_host.move_panel("map", "video", "right")
    assert json.loads(str(settings.values[WORKING]))["tour_guide.yaml"]["usual"]
    aside = str(settings.values["wizards/*/layout/working_aside"])
    assert aside in kept or json.loads(aside) == json.loads(kept), "nothing is lost"


@pytest.mark.long
def test_another_layout_in_the_file_is_shown_and_the_wizards_own_comes_back_with_undo(
    qtbot: QtBot, window: MainWindow, settings: MemorySettings, theme: Theme
) -> None:
    window.dock_host.move_panel("map", "video", "right")
    mine = arranged(window)
    changed = dataclasses.replace(samples.TOUR, layout=samples.MENTAL_LAYOUT)
    other = again(qtbot, settings, theme, changed)
    assert panels_in(arranged(other).tree) == panels_in(samples.MENTAL_LAYOUT)
    other.layout_keeper.undo()
    assert panels_in(arranged(other).tree)[:3] == panels_in(mine.tree)[:3]


@pytest.mark.long
def test_panels_that_the_scenario_no_longer_offers_leave_the_working_copy(
    qtbot: QtBot, window: MainWindow, settings: MemorySettings, theme: Theme
) -> None:
    window.open_panel("photos")
    assert "photos" in arranged(window).panels
    strict = dataclasses.replace(samples.TOUR, permissions=dataclasses.replace(samples.TOUR.permissions, photos=False))
    other = again(qtbot, settings, theme, strict)
    assert "photos" not in other.panels
    assert set(arranged(other).panels) == set(panels_in(samples.TOUR_LAYOUT))


@pytest.mark.parametrize("name", ["tour-guide", "mental-health-check"])
def test_small_and_large_screens_get_a_layout_of_their_own(qtbot: QtBot, theme: Theme, name: str) -> None:
    scenario = load_scenario(layouts_dir() / f"{name}.yaml")
    window = MainWindow(FakeConsole(scenario), theme=theme)
    qtbot.addWidget(window)
    window.show()
    shown = {}
    for size in ((1366, 768), (1920, 1080), (2560, 1440)):
        window.resize(*size)
        QApplication.processEvents()
        shown[size[0]] = arranged(window)
        for group in window.dock_host.placing.groups:
            panel = window.panels[group.current]
            assert panel.parentWidget().rect().contains(panel.geometry()), "no panel is cut off"
    assert shown[1920] == arrangement_of(scenario.layout)
    assert {*shown[1366].panels} == {*shown[1920].panels} == {*shown[2560].panels}
    count = {width: tabs_in(arrangement.tree) for width, arrangement in shown.items()}
    assert count[1366] >= count[1920] > count[2560]
    window.resize(1366, 768)
    QApplication.processEvents()
    window.dock_host.move_panel("speak", "video", "right")
    mine = arranged(window)
    window.resize(1920, 1080)
    QApplication.processEvents()
    assert arranged(window) == shown[1920], "what is arranged on a small screen is for that"
    window.resize(1366, 768)
    QApplication.processEvents()
    assert arranged(window) == mine


@pytest.mark.parametrize("strip", ["drive_hint", "practice_strip"])
def test_a_line_that_comes_and_goes_above_the_panels_arranges_nothing_again(
    qtbot: QtBot, theme: Theme, strip: str
) -> None:
    """The hint about driving disappears with the first metre: the layout must not change during driving.

    It takes no height from the panels; the practice, which is there for minutes, does.
    """
    scenario = load_scenario(layouts_dir() / "tour-guide.yaml")
    window = MainWindow(FakeConsole(scenario), theme=theme)
    qtbot.addWidget(window)
    window.resize(1366, 768)
    window.show()
    QApplication.processEvents()
    for height in (768, 860):
        window.resize(1366, height)
        QApplication.processEvents()
        before, room = arranged(window), window.dock_host.height()
        line = window.first_use.hint if strip == "drive_hint" else window.practice
        for shown in (True, False):
            line.setVisible(shown)
            QApplication.processEvents()
            assert (window.dock_host.height() < room) is (shown and strip == "practice_strip")
            assert arranged(window) == before


def tabs_in(node: LayoutNode) -> int:
    if isinstance(node, SplitNode):
        return sum(tabs_in(child) for child in node.children)
    return len(node.tabs) if isinstance(node, TabNode) else 0


def test_a_scenario_can_say_itself_how_it_is_on_a_small_screen(qtbot: QtBot, theme: Theme) -> None:
    own = SplitNode("horizontal", (PanelLeaf("video"), TabNode(("speak", "people"), "speak")), (0.5, 0.5))
    scenario = dataclasses.replace(samples.TOUR, layout_compact=own)
    window = MainWindow(FakeConsole(scenario), theme=theme)
    qtbot.addWidget(window)
    window.resize(1366, 768)
    window.show()
    QApplication.processEvents()
    tree = arranged(window).tree
    assert isinstance(tree, SplitNode)
    assert tree.children[0] == PanelLeaf("video")
    assert panels_in(tree.children[1])[:2] == ("speak", "people")
    assert set(panels_in(tree)) == set(panels_in(samples.TOUR_LAYOUT)), "and what it does not name is behind a tab"


def test_the_example_of_the_guide_is_a_layout() -> None:
    guide = (layouts_dir().parent / "resources" / "guide" / "layouts.md").read_text("utf-8")
    (example,) = re.findall(r"```yaml\n(.*?)```", guide, re.DOTALL)
    tree = checked_layout(yaml.safe_load(example)["layout_compact"])
    assert panels_in(tree)[:2] == ("video", "speak")


def test_the_window_menu_fits_a_small_screen(window: MainWindow) -> None:
    window.menus.open_window_menu()
    menu = window.findChild(QMenu, "window_menu")
    assert menu is not None
    assert menu.sizeHint().height() <= 680
    menu.close()


def test_one_menu_has_it_all(window: MainWindow, settings: MemorySettings) -> None:
    window.dock_host.move_panel("map", "video", "right")
    menu = QMenu(window)
    window.menus.fill_layout_menu(menu)
    texts = {action.text(): action.isEnabled() for action in menu.actions()}
    assert {
        "Undo: Move Map\t⇧Ctrl D": True, "Redo": False,
        "Save to the scenario": True, "Save as another scenario…": True,
        "Revert to the scenario’s layout": True, "Reset to the original layout": True, "Lock for a study": True,
    }.items() <= texts.items()  # fmt: skip


def test_a_panel_that_another_scenario_has_just_the_same_stays_and_keeps_its_keys(
    window: MainWindow, console: FakeConsole
) -> None:
    before = dict(window.panels)
    console.scenario = dataclasses.replace(samples.TOUR, filler="Well, well.", sha256="other")
    console.state.scenario.set(console.scenario)
    assert window.panels == before
    window.focus_driving()
    video = window.panels["video"].focus_target()
    QTest.keyClick(video, Qt.Key.Key_P)
    assert console.named("take_photo") == [None], "once, not once for each scenario"
    console.scenario = dataclasses.replace(
        console.scenario, permissions=dataclasses.replace(samples.TOUR.permissions, photos=False)
    )
    console.state.scenario.set(console.scenario)
    assert window.panels["video"] is before["video"]
    assert not any(button.isVisible() for button in window.findChildren(QWidget, "photo_button"))
    console.scenario = samples.TOUR
    console.state.scenario.set(console.scenario)
    window.board.complete()
    QTest.qWait(0)
    (button,) = (each for each in window.findChildren(QWidget, "photo_button") if each.isVisible())
    QTest.mouseClick(button, Qt.MouseButton.LeftButton)
    assert console.named("take_photo") == [None, None]


def test_each_scenario_and_each_wizard_has_a_layout_of_their_own(window: MainWindow, console: FakeConsole) -> None:
    window.dock_host.move_panel("map", "video", "right")
    mine = arranged(window)
    console.open_scenario(Path("/layouts/mental_health_check.yaml"))
    window.board.complete()
    assert arranged(window) == arrangement_of(samples.MENTAL_LAYOUT)
    console.open_scenario(Path("/layouts/tour_guide.yaml"))
    window.board.complete()
    assert arranged(window) == mine
    window.wizards.choose("Ana")
    assert arranged(window) == mine, "whoever gives a name keeps what was set before"
    window.layout_keeper.revert()
    window.wizards.choose("")
    assert arranged(window) == mine, "and what Ana does is hers"
