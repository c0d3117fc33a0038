"""Edits of a dock layout without a window."""

import json
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PySide6.QtCore import QRect
from PySide6.QtGui import QUndoStack

from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.scenario.scenario_file import LAYOUTS, load_scenario, save_scenario
from caris_desktop.scenario.scenario_model import PanelLeaf, PanelName, SplitNode, TabNode, layout_data, panels_in
from caris_desktop.ui import dock_layout as edits
from caris_desktop.ui.dock_geometry import place
from caris_desktop.ui.dock_layout import DockLayout, arrangement_data, arrangement_from, arrangement_of, tidy
from caris_desktop.ui.layout_store import LayoutEdit
from caris_desktop.ui.panel_table import PANELS
from tests.ui.layout.edits import EDIT, WINDOW, edited, room
from tests.ui.samples import MENTAL_LAYOUT, TOUR_LAYOUT

TOUR = arrangement_of(TOUR_LAYOUT)
PLACE = QRect(100, 100, 420, 300)


def through_json(arrangement: DockLayout) -> DockLayout:
    return arrangement_from(json.loads(json.dumps(arrangement_data(arrangement))))


@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(EDIT, min_size=50, max_size=50), st.sampled_from([TOUR_LAYOUT, MENTAL_LAYOUT]))
@pytest.mark.long
def test_500_edits_are_saved_undone_and_done_again(made: list[Any], layout: Any) -> None:
    """Ten times fifty edits, each saved and loaded, placed with every panel, and all undone at the end."""
    arrangement, history = arrangement_of(layout), QUndoStack()
    present = [arrangement]

    def exchange(layout: DockLayout) -> DockLayout:
        before, present[0] = present[0], layout
        return before

    began, seen = arrangement, []
    for edit in made:
        spare: list[PanelName] = [name for name in PANELS if name not in arrangement.panels]
        after = edited(arrangement, edit, spare)
        assert through_json(after) == after
        assert len(set(after.panels)) == len(after.panels), "no panel is there twice"
        if edit[0] not in ("add", "remove"):
            assert set(after.panels) == set(arrangement.panels), "and none is lost"
        assert tidy(after.tree) == after.tree
        placing = place(after.tree, WINDOW, after.docked, room)
        assert {panel for group in placing.groups for panel in group.panels} == after.docked
        rects = [group.rect for group in placing.groups]
        assert not any(one.intersects(other) for i, one in enumerate(rects) for other in rects[i + 1 :])
        history.push(LayoutEdit(edit[0], arrangement, exchange))
        seen.append(after)
        present[0] = arrangement = after
    last = arrangement
    for expected in [*reversed(seen[:-1]), began]:
        history.undo()
        assert present[0] == expected
    for expected in seen:
        history.redo()
        assert present[0] == expected
    assert present[0] == last


@settings(max_examples=3, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.lists(EDIT, min_size=30, max_size=30))
def test_a_layout_that_was_edited_at_random_is_the_same_from_a_scenario_file(
    tmp_path_factory: pytest.TempPathFactory, made: list[Any]
) -> None:
    scenario = load_scenario(layouts_dir() / "tour-guide.yaml")
    arrangement = arrangement_of(scenario.layout)
    for edit in made:
        arrangement = edited(arrangement, edit, [])
    tree = arrangement.for_file
    if tree is None:
        return
    path = tmp_path_factory.mktemp("own") / "own.yaml"
    save_scenario(replace(scenario, layout=tree), path, only=LAYOUTS)
    assert load_scenario(path).layout == tree


def test_a_panel_leaves_its_tabs_alone_and_goes_next_to_another() -> None:
    moved = edits.move(TOUR, "session", "video", "right")
    assert [panels_in(node) for node in _leaves(moved.tree)] == [
        ("video",), ("session",), ("speak",), ("map",), ("drive",), ("assistant",), ("people",),
    ]  # fmt: skip
    assert edits.move(TOUR, "video", "video", "left") == TOUR


def test_a_panel_goes_between_the_tabs_where_it_is_dropped() -> None:
    moved = edits.move(TOUR, "map", "session", "tab", at=1)
    assert TabNode(("assistant", "map", "session"), "map") in _leaves(moved.tree)


def test_floating_and_hidden_panels_come_back_where_they_were() -> None:
    for panel in TOUR.panels:
        floating = edits.float_panel(TOUR, panel, PLACE)
        assert panel not in floating.docked
        assert floating.for_file is not None
        assert panel in panels_in(floating.for_file), "a file knows of no windows, and loses no panel by them"
        assert panels_in(edits.dock(floating, panel).tree) == TOUR.panels
        hidden = edits.hide(TOUR, panel)
        assert not hidden.is_shown(panel)
        assert panels_in(edits.show(hidden, panel).tree) == TOUR.panels
    assert edits.dock(edits.float_panel(TOUR, "video", PLACE), "video") == TOUR


def test_panels_can_share_a_window_of_their_own_and_leave_it_one_by_one() -> None:
    two = edits.move(edits.float_panel(TOUR, "video", PLACE), "map", "video", "below")
    (window,) = two.floating
    assert window.tree == SplitNode("vertical", (PanelLeaf("video"), PanelLeaf("map")), (0.5, 0.5))
    one = edits.dock(two, "video")
    assert [window.tree for window in one.floating] == [PanelLeaf("map")]
    assert edits.dock(one, "map").floating == ()


def test_windows_of_a_screen_that_is_not_there_come_onto_one_that_is() -> None:
    """Arranged on two screens, opened on one."""
    left, right = QRect(0, 0, 1920, 1080), QRect(1920, 0, 2560, 1440)
    two = edits.float_panel(
        edits.float_panel(TOUR, "map", QRect(2500, 300, 900, 700)), "people", QRect(60, 80, 400, 300)
    )
    two = edits.move(two, "session", "map", "tab")
    assert edits.clamped(two, (left, right)) == two, "with both screens nothing moves"
    on_one = edits.clamped(two, (left,))
    places = [window.place for window in on_one.floating]
    assert all(left.contains(place) for place in places)
    assert places[1] == QRect(60, 80, 400, 300), "what fits stays"
    assert [window.tree for window in on_one.floating] == [window.tree for window in two.floating]
    assert set(on_one.panels) == set(two.panels)
    small = edits.clamped(two, (QRect(0, 0, 640, 400),))
    assert all(QRect(0, 0, 640, 400).contains(w.place) for w in small.floating)


@pytest.mark.parametrize(
    "data",
    [
        None, [], {}, {"tree": None}, {"tree": {"panel": "nonsense"}}, {"tree": {"tabs": ["map", "map"]}},
        {"tree": {"split": "horizontal", "children": [{"panel": "map"}, {"panel": "map"}]}},
        {"tree": {"panel": "map"}, "hidden": ["video"]}, {"tree": {"panel": "map"}, "hidden": 3},
        {"tree": {"panel": "map"}, "floating": [3]},
        {"tree": {"panel": "map"}, "floating": [{"tree": {"panel": "video"}, "place": [0, 0, 9, 9]}]},
        {"tree": {"panel": "map"}, "floating": [{"tree": {"panel": "map"}, "place": [0, 0, 9]}]},
        {"tree": {"panel": "map"}, "floating": [{"tree": {"panel": "map"}, "place": [0, 0, True, 9]}]},
        {"tree": {"panel": "map"}, "floating": [{"tree": {"panel": "map"}, "place": [0, 0, -5, 9]}]},
        {"tree": {"panel": "map"}, "floating": [{"tree": {"panel": "map"}, "place": [1e99, 0, 5, 9]}]},
    ],
)  # fmt: skip
def test_an_invalid_layout_is_refused(data: Any) -> None:
    with pytest.raises(ValueError, match=r"panel|window|layout"):
        arrangement_from(data)


def test_shares_of_a_file_in_percent_are_the_same_layout() -> None:
    file = SplitNode("horizontal", (PanelLeaf("video"), PanelLeaf("map")), (61, 39))
    assert tidy(file) == SplitNode("horizontal", file.children, (0.61, 0.39))
    assert layout_data(tidy(tidy(file))) == layout_data(tidy(file))


def _leaves(node: Any) -> list[Any]:
    return [leaf for child in node.children for leaf in _leaves(child)] if isinstance(node, SplitNode) else [node]


def test_in_front_is_what_can_be_seen() -> None:
    tabs = TabNode(("map", "people", "notes"), "people")
    whole = arrangement_of(SplitNode("horizontal", (PanelLeaf("video"), tabs, PanelLeaf("speak")), (1, 1, 1)))
    assert whole.in_front == {"video", "people", "speak"}
    assert replace(whole, hidden=frozenset({"people", "speak"})).in_front == {"video", "map"}
    afloat = edits.float_panel(whole, "people", PLACE)
    assert afloat is not None and afloat.in_front == {"video", "map", "people", "speak"}
