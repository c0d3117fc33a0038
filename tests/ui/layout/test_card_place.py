"""Placement of cards: over titles only without alternative, never over speech and driving controls."""

import pytest
from PySide6.QtCore import QPoint, QRect
from PySide6.QtWidgets import QAbstractButton, QApplication, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.events import Problem
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.status import FaceStatus
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, PanelName, SplitNode, TabNode
from caris_desktop.ui.dock_geometry import GroupPlace, place
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.notifications import card_place, in_the_corner
from caris_desktop.ui.panel import TITLE_HEIGHT_PX
from tests.support.window_check import text_flaws
from tests.ui.conftest import click, find, freshen
from tests.ui.fake_console import FakeConsole

AREA = QRect(0, 0, 1300, 600)


def groups_of(tree: LayoutNode, *shown: PanelName) -> tuple[GroupPlace, ...]:
    return place(tree, AREA, frozenset(shown), lambda _panel: (200, 100)).groups


def across(*names: PanelName) -> tuple[GroupPlace, ...]:
    share = 1 / len(names)
    tree = SplitNode("horizontal", tuple(PanelLeaf(name) for name in names), (share,) * len(names))
    return groups_of(tree, *names)


def _inside(inner: QRect, outer: QRect) -> bool:
    return outer.contains(inner.left(), inner.top()) and outer.contains(inner.right(), inner.bottom())


@pytest.mark.parametrize(
    ("names", "chosen", "upper"),
    [
        (("video", "speak", "session"), "session", False),
        (("conversation", "map", "drive"), "map", False),
        (("speak", "video", "drive"), "video", True),
        (("speak", "conversation", "drive"), "conversation", True),
    ],
)
def test_the_least_missed_panel_has_them_below_its_title(
    names: tuple[PanelName, ...], chosen: PanelName, upper: bool
) -> None:
    groups = across(*names)
    found = card_place(groups, lambda _width: 150)
    assert found is not None
    room = next(group.body for group in groups if group.current == chosen)
    assert _inside(found, room) and found.top() >= room.top() + TITLE_HEIGHT_PX
    assert (found.top() - room.top() < room.bottom() - found.bottom()) is upper


def test_speaking_and_driving_are_never_covered_and_too_tall_ones_go_to_the_corner() -> None:
    assert card_place(across("speak", "drive"), lambda _width: 40) is None
    assert card_place(across("map", "speak"), lambda _width: 500) is None
    corner = in_the_corner(AREA, lambda _width: 900)
    assert (corner.top(), corner.right()) == (0, AREA.right() - 20)


def test_buttons_and_fields_are_not_covered() -> None:
    groups = across("face", "speak")
    room = groups[0].body
    buttons = [QRect(20, 540, 120, 30), QRect(150, 540, 120, 30)]
    found = card_place(groups, lambda _width: 150, controls=buttons)
    assert found is not None and room.contains(found) and found.bottom() < 540
    assert card_place(groups, lambda _width: 450, controls=buttons) is not None
    assert card_place(groups, lambda _width: 450, controls=[QRect(20, 300, 120, 30)]) is None


def test_the_expressions_of_the_face_stay_at_hand(window: MainWindow, console: FakeConsole) -> None:
    console.scenario = load_scenario(layouts_dir() / "mental-health-check.yaml")
    console.state.scenario.reset_value(console.scenario)
    window.board.complete()
    console.state.face.set(FaceStatus("calm", "Calm", "calm", ("calm", "happy", "surprised", "thinking"), "face"))
    QApplication.processEvents()
    no_sound = Problem(1, "warning", "This computer has no sound output", "It means this.", "Do that.")
    console.state.add(no_sound)
    QApplication.processEvents()
    cards = window.problems
    assert cards.isVisible()
    shown = _place_of(cards, window)
    assert shown.intersects(_place_of(window.panels["face"], window))
    buttons = [part for part in window.panels["face"].findChildren(QAbstractButton) if part.isVisible()]
    assert len(buttons) >= 4
    assert not any(shown.intersects(_place_of(button, window)) for button in buttons)


def test_nothing_comes_over_what_requests_an_answer() -> None:
    groups = across("video", "map", "speak")
    first = card_place(groups, lambda _width: 150)
    assert first is not None
    other = card_place(groups, lambda _width: 150, [first])
    assert other is not None and not other.intersects(first)
    assert card_place(groups, lambda _width: 150, [AREA]) is None


def test_behind_a_tab_nothing_is_covered() -> None:
    tree = SplitNode("horizontal", (PanelLeaf("speak"), TabNode(("map", "session"), "map")), (0.5, 0.5))
    groups = groups_of(tree, "speak", "map", "session")
    found = card_place(groups, lambda _width: 150)
    assert found is not None and found.left() > 650
    assert found.top() > groups[1].tab_bar.bottom() + TITLE_HEIGHT_PX


def test_cards_are_on_no_title_and_older_ones_say_only_what_it_is(window: MainWindow, console: FakeConsole) -> None:
    for number, severity in enumerate(("warning", "error")):
        problem = Problem(1, severity, f"Problem {number}", "It means this.", "Do that.")
        console.state.add(problem)
    first, second = window.problems.cards
    shown = window.problems.geometry()
    for dock in window.dock_host.docks.values():
        title = dock.title_bar
        at = title.mapTo(window.dock_host, title.rect().topLeft())
        assert not title.isVisible() or not shown.intersects(title.rect().translated(at)), dock.name
    assert (first.height() < second.height()) and "Do that." in first.toolTip() and not second.toolTip()
    assert "Do that." in first.accessibleName()


def test_a_click_shows_an_older_one_whole(window: MainWindow, console: FakeConsole, qtbot: object) -> None:
    for number in range(2):
        console.state.add(Problem(1, "error", f"Problem {number}", "It means this.", "Do that."))
    first, second = window.problems.cards
    click(qtbot, first)  # type: ignore[arg-type]
    assert first.height() > second.height() and "Do that." in second.toolTip()


def _place_of(part: QWidget, window: QWidget) -> QRect:
    return QRect(part.mapTo(window, QPoint()), part.size())


def _taken(window: MainWindow) -> dict[str, QRect]:
    """Areas that no problem may cover: titles, tabs, the panels for input, and the emergency stop button."""
    taken = {"emergency stop": _place_of(find(window, "emergency_stop"), window)}
    for name, dock in window.dock_host.docks.items():
        title, panel = dock.title_bar, dock.panel
        if title.isVisible():
            taken[f"title of {name}"] = _place_of(title, window)
        if panel is not None and panel.isVisible() and name in ("speak", "drive"):
            taken[name] = _place_of(panel, window)
        if dock.isVisible() and name not in ("speak", "drive"):
            for part in dock.findChildren(QAbstractButton):
                if part.isVisible() and _place_of(dock, window).contains(_place_of(part, window)):
                    taken[f"{part.accessibleName()} in {name}"] = _place_of(part, window)
    for number, bar in enumerate(window.dock_host.bars):
        taken[f"tabs {number}"] = _place_of(bar, window)
    return taken


@pytest.mark.parametrize("scenario", sorted(path.stem for path in layouts_dir().glob("*.yaml")))
@pytest.mark.long("tour-guide", "practice", "reception")
def test_on_small_screens_problems_cover_nothing_that_is_needed(
    window: MainWindow, console: FakeConsole, scenario: str
) -> None:
    console.scenario = load_scenario(layouts_dir() / f"{scenario}.yaml")
    console.state.scenario.reset_value(console.scenario)
    for number in range(3):
        console.state.add(
            Problem(1, "error", f"The camera of the robot sends no picture {number}", "It means this.", "Do that.")
        )
    told = set()
    for size in ((683, 384), (911, 512), (1366, 768), (683, 384)):
        window.resize(*size)
        freshen(console)  # a stream that has become old meanwhile takes room from the line
        for _ in range(10):
            QApplication.processEvents()
        cards, line = window.problems, window.problems.line
        assert cards.isVisible() is not line.isVisible(), "one of the two tells of them"
        told.add(line.isVisible())
        if cards.isVisible():
            shown = _place_of(cards, window)
            assert [name for name, place in _taken(window).items() if place.intersects(shown)] == []
        else:
            assert line.text().startswith("3 · The camera of the robot")
            assert line.width() >= 120 and "Do that." in line.toolTip()
        assert [flaw for flaw in text_flaws(window) if "The camera of the robot" in flaw] == []
    assert True in told


def test_the_line_opens_the_cards_and_goes_with_the_last_of_them(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    window.resize(683, 384)
    QApplication.processEvents()
    console.state.add(Problem(1, "error", "It stopped", "It means this.", "Do that."))
    line = find(window, "problem_line")
    assert (line.property("text"), line.accessibleName()) == ("It stopped", "Serious problem: It stopped")
    assert not window.problems.isVisible()
    click(qtbot, line)
    (card,) = window.problems.cards
    assert card.isVisible() and window.problems.isVisible()
    assert not _place_of(window.problems, window).intersects(_place_of(find(window, "emergency_stop"), window))
    click(qtbot, line)
    assert not window.problems.isVisible()
    click(qtbot, line)
    click(qtbot, find(card, "problem_dismiss"))
    assert window.problems.cards == () and not line.isVisible() and not window.problems.isVisible()
    console.state.add(Problem(1, "error", "It stopped again", "", ""))
    assert line.isVisible() and not window.problems.isVisible(), "each one begins as a line"
