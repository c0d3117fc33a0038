"""Placement of one layout on screens of different sizes."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PySide6.QtCore import QRect

from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, SplitNode, TabNode, panels_in
from caris_desktop.ui.dock_geometry import (
    COMFORT,
    GAP_PX,
    IMPORTANCE,
    TAB_BAR_PX,
    dragged,
    drop_at,
    fitted,
    lengths,
    place,
    size_class,
)
from caris_desktop.ui.dock_layout import groups_in, tidy
from caris_desktop.ui.panel_table import PANELS
from tests.ui.samples import TOUR_LAYOUT

SMALL, LARGE = (1350, 628), (2544, 1300)


def comfort(panel: str) -> tuple[int, int]:
    return COMFORT[panel]  # type: ignore[index]


def test_every_panel_has_its_importance_and_its_room() -> None:
    assert set(IMPORTANCE) == set(COMFORT) == set(PANELS)


def shipped() -> list[LayoutNode]:
    return [load_scenario(path).layout for path in sorted(layouts_dir().glob("*.yaml"))]


@pytest.mark.parametrize("tree", shipped())
def test_on_a_small_screen_what_is_shown_has_the_room_that_it_needs(tree: LayoutNode) -> None:
    small = fitted(tree, *SMALL)
    assert set(panels_in(small)) == set(panels_in(tree)), "nothing is lost"
    groups = place(small, QRect(0, 0, *SMALL), panels_in(small), lambda _panel: (100, 60)).groups
    for group in groups:
        width, height = comfort(group.current)
        assert group.body.width() >= width - GAP_PX and group.body.height() >= height - GAP_PX, group
    fronts = {group.current for group in groups}
    assert {"video", "speak", "conversation"} & set(panels_in(tree)) <= fronts


@pytest.mark.parametrize("tree", shipped())
def test_a_large_screen_shows_at_least_as_many_panels_at_once(tree: LayoutNode) -> None:
    large = fitted(tree, *LARGE)
    assert set(panels_in(large)) == set(panels_in(tree))
    assert len(list(groups_in(large))) >= len(list(groups_in(tidy(tree))))
    for group in place(large, QRect(0, 0, *LARGE), panels_in(large), lambda _panel: (100, 60)).groups:
        assert group.body.width() >= comfort(group.current)[0] - GAP_PX


def test_between_the_two_the_file_is_taken_at_its_word() -> None:
    assert size_class(1904, 930) == "usual"
    assert fitted(TOUR_LAYOUT, 1904, 930) == tidy(TOUR_LAYOUT)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 4000), st.lists(st.tuples(st.floats(0.01, 9), st.integers(0, 900)), min_size=1, max_size=6))
def test_room_is_shared_to_the_last_pixel(whole: int, parts: list[tuple[float, int]]) -> None:
    least = [each for _, each in parts]
    given_px = lengths(whole, [weight for weight, _ in parts], least, 140)
    assert sum(given_px) == whole and min(given_px) >= 0
    if sum(least) < whole:
        assert all(got >= need - 1 for got, need in zip(given_px, least, strict=True))


def test_a_handle_moves_only_what_lies_next_to_it() -> None:
    tree = tidy(SplitNode("horizontal", (PanelLeaf("video"), PanelLeaf("map"), PanelLeaf("speak"), PanelLeaf("drive"))))
    shown = frozenset({"video", "map", "drive"})  # Speak is hidden, but keeps its share
    rect = QRect(0, 0, 1216, 500)
    handle = place(tree, rect, shown, lambda _panel: (100, 60)).handles[0]
    weights = dragged(tree, handle, 120)
    assert weights[2] == pytest.approx(0.25)
    moved = place(
        SplitNode("horizontal", tree.children, weights),
        rect,
        shown,
        lambda _panel: (100, 60),  # type: ignore[union-attr]
    )
    assert [group.rect.width() for group in moved.groups] == [520, 280, 400]
    assert dragged(tree, handle, -2000)[0] == pytest.approx(0.25 * 3 * 100 / 1200), "nobody is squeezed away"


def test_the_place_of_a_panel() -> None:
    tree = SplitNode("horizontal", (PanelLeaf("video"), TabNode(("map", "people"), "map")), (0.5, 0.5))
    rect = QRect(0, 0, 1008, 600)
    placing = place(tree, rect, panels_in(tree), lambda _panel: (100, 60))

    def drop(x: int, y: int, panel: str) -> tuple[object, object] | None:
        found = drop_at(placing, rect, x, y, panel)  # type: ignore[arg-type]
        return None if found is None else (found.beside, found.side)

    assert drop(250, 300, "map") == ("video", "tab")
    assert drop(60, 300, "map") == ("video", "left")
    assert drop(250, 560, "map") == ("video", "below")
    assert drop(700, TAB_BAR_PX // 2, "video") == ("map", "tab")
    assert drop(540, 300, "people") == ("map", "left"), "a tab leaves its group towards a side of it"
    assert drop(750, 300, "people") is None, "in the middle of its own group it stays"
    assert drop(3, 300, "map") == (None, "left")
    assert drop(250, 300, "video") is None
    assert drop(1200, 300, "video") is None
