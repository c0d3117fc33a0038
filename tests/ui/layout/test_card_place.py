"""Cards lie where least is missed: never on a title while there is room, and never on speaking or driving."""

import pytest

from caris_desktop.domain.events import Problem
from caris_desktop.scenario.model import LayoutNode, PanelLeaf, PanelName, SplitNode, TabNode
from caris_desktop.ui.layout.card_place import card_place, in_the_corner
from caris_desktop.ui.layout.placing import TITLE_PX, GroupPlace, place
from caris_desktop.ui.layout.rect import Rect
from caris_desktop.ui.main_window import MainWindow
from tests.ui.conftest import click
from tests.ui.fake_console import FakeConsole

AREA = Rect(0, 0, 1300, 600)


def groups_of(tree: LayoutNode, *shown: PanelName) -> tuple[GroupPlace, ...]:
    return place(tree, AREA, frozenset(shown), lambda _panel: (200, 100)).groups


def across(*names: PanelName) -> tuple[GroupPlace, ...]:
    share = 1 / len(names)
    tree = SplitNode("horizontal", tuple(PanelLeaf(name) for name in names), (share,) * len(names))
    return groups_of(tree, *names)


def _inside(inner: Rect, outer: Rect) -> bool:
    return outer.contains(inner.left, inner.top) and outer.contains(inner.right - 1, inner.bottom - 1)


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
    assert _inside(found, room) and found.top >= room.top + TITLE_PX
    assert (found.top - room.top < room.bottom - found.bottom) is upper


def test_speaking_and_driving_are_never_covered_and_too_tall_ones_go_to_the_corner() -> None:
    assert card_place(across("speak", "drive"), lambda _width: 40) is None
    assert card_place(across("map", "speak"), lambda _width: 500) is None
    corner = in_the_corner(AREA, lambda _width: 900)
    assert (corner.top, corner.right) == (0, AREA.right - 20)


def test_behind_a_tab_nothing_is_covered() -> None:
    tree = SplitNode("horizontal", (PanelLeaf("speak"), TabNode(("map", "session"), "map")), (0.5, 0.5))
    groups = groups_of(tree, "speak", "map", "session")
    found = card_place(groups, lambda _width: 150)
    assert found is not None and found.left > 650
    assert found.top > groups[1].tab_bar.bottom + TITLE_PX


def test_cards_are_on_no_title_and_older_ones_say_only_what_it_is(window: MainWindow, console: FakeConsole) -> None:
    for number, severity in enumerate(("warning", "error")):
        problem = Problem(1, severity, f"Problem {number}", "It means this.", "Do that.")
        console.state.take(problem)
    first, second = window.problems.cards
    shown = window.problems.geometry()
    for dock in window.dock_host.docks.values():
        title = dock.titleBarWidget()
        at = title.mapTo(window.dock_host, title.rect().topLeft())
        assert not title.isVisible() or not shown.intersects(title.rect().translated(at)), dock.name
    assert (first.height() < second.height()) and "Do that." in first.toolTip() and not second.toolTip()
    assert "Do that." in first.accessibleName()


def test_a_click_shows_an_older_one_whole(window: MainWindow, console: FakeConsole, qtbot: object) -> None:
    for number in range(2):
        console.state.take(Problem(1, "error", f"Problem {number}", "It means this.", "Do that."))
    first, second = window.problems.cards
    click(qtbot, first)  # type: ignore[arg-type]
    assert first.height() > second.height() and "Do that." in second.toolTip()
