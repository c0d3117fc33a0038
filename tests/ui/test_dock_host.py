"""Docks from a layout tree, and the same tree read back from the docks."""

import dataclasses

import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, SplitNode, TabNode, panels_in
from caris_desktop.ui.dock_layout import with_tab, without
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.theme import Theme
from tests.ui import samples
from tests.ui.fake_console import FakeConsole
from tests.ui.layout.lying import Placed, seen_in, tree_from_rectangles

DEEP = SplitNode(
    "vertical",
    (
        SplitNode(
            "horizontal",
            (
                PanelLeaf("video"),
                SplitNode(
                    "vertical", (PanelLeaf("map"), TabNode(("people", "session", "drive"), "session")), (0.5, 0.5)
                ),
            ),
            (0.6, 0.4),
        ),
        SplitNode("horizontal", (PanelLeaf("speak"), PanelLeaf("assistant")), (0.5, 0.5)),
    ),
    (0.6, 0.4),
)


def shape(node: LayoutNode | None) -> object:
    """The tree without its weights."""
    if isinstance(node, SplitNode):
        return (node.split, tuple(shape(child) for child in node.children))
    return node


def weights(node: LayoutNode | None) -> list[float]:
    if not isinstance(node, SplitNode):
        return []
    total = sum(node.weights)
    own = [weight / total for weight in node.weights]
    return own + [weight for child in node.children for weight in weights(child)]


@pytest.mark.parametrize("tree", [samples.TOUR_LAYOUT, samples.MENTAL_LAYOUT, DEEP], ids=["tour", "mental", "deep"])
def test_a_layout_survives_the_docks(qtbot: QtBot, theme: Theme, tree: LayoutNode) -> None:
    console = FakeConsole(dataclasses.replace(samples.TOUR, layout=tree))
    window = MainWindow(console, theme=theme)
    qtbot.addWidget(window)
    window.resize(1920, 1080)
    window.show()
    qtbot.waitUntil(lambda: shape(seen_in(window.dock_host)) == shape(tree))
    qtbot.waitUntil(lambda: weights(seen_in(window.dock_host)) == pytest.approx(weights(tree), abs=0.05))


def test_the_weights_stay_when_the_window_grows(qtbot: QtBot, theme: Theme) -> None:
    window = MainWindow(FakeConsole(samples.TOUR), theme=theme)
    qtbot.addWidget(window)
    window.layout_keeper.set_adapts(False)
    window.resize(1500, 1000)
    window.show()
    for size in ((1920, 1080), (1400, 980)):
        window.resize(*size)
        qtbot.waitUntil(
            lambda: weights(seen_in(window.dock_host)) == pytest.approx(weights(samples.TOUR_LAYOUT), abs=0.06)
        )


def test_a_closed_panel_leaves_the_tree_and_comes_back(qtbot: QtBot, window: MainWindow) -> None:
    host = window.dock_host
    with qtbot.waitSignal(host.layout_changed):
        host.close_panel("map")
    tree = window.dock_host.tree
    assert tree is not None
    assert "map" not in panels_in(tree)
    with qtbot.waitSignal(host.layout_changed):
        host.show_panel("map")
    tree = window.dock_host.tree
    assert tree is not None
    assert "map" in panels_in(tree)


def test_rectangles_are_cut_where_a_line_passes() -> None:
    placed = [
        Placed(PanelLeaf("video"), 0, 0, 599, 399),
        Placed(PanelLeaf("speak"), 0, 408, 599, 599),
        Placed(PanelLeaf("map"), 608, 0, 999, 599),
    ]
    tree = tree_from_rectangles(placed)
    assert shape(tree) == (
        "horizontal",
        (("vertical", (PanelLeaf("video"), PanelLeaf("speak"))), PanelLeaf("map")),
    )


def test_nothing_placed_is_no_tree() -> None:
    assert tree_from_rectangles([]) is None


def test_absent_panels_close_their_gap() -> None:
    smaller = without(DEEP, frozenset({"map", "session", "drive"}))
    assert shape(smaller) == (
        "vertical",
        (
            ("horizontal", (PanelLeaf("video"), PanelLeaf("people"))),
            ("horizontal", (PanelLeaf("speak"), PanelLeaf("assistant"))),
        ),
    )
    assert without(PanelLeaf("map"), frozenset({"map"})) is None


def test_a_tab_is_put_next_to_a_panel_wherever_that_is() -> None:
    assert with_tab(PanelLeaf("map"), "map", "robot") == TabNode(("map", "robot"), "robot")
    tree = with_tab(DEEP, "session", "diagnostics")
    assert TabNode(("people", "session", "drive", "diagnostics"), "diagnostics") in _leaves(tree)
    assert with_tab(DEEP, "robot", "diagnostics") == DEEP


def _leaves(node: LayoutNode) -> list[LayoutNode]:
    return [leaf for child in node.children for leaf in _leaves(child)] if isinstance(node, SplitNode) else [node]
