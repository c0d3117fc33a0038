"""Random edits of a dock layout."""

from typing import Any

from hypothesis import strategies as st
from PySide6.QtCore import QRect

from caris_desktop.scenario.scenario_model import PanelName
from caris_desktop.ui import dock_layout as edits
from caris_desktop.ui.dock_geometry import dragged, place
from caris_desktop.ui.dock_layout import DockLayout

WINDOW = QRect(0, 0, 1900, 920)
SIDES = ("tab", "left", "right", "above", "below")
KINDS = ("move", "move", "edge", "float", "dock", "hide", "show", "select", "resize", "place", "add", "remove")


def room(_panel: PanelName) -> tuple[int, int]:
    return (200, 100)


EDIT = st.tuples(
    st.sampled_from(KINDS), st.integers(0, 99), st.integers(0, 99), st.integers(0, 4), st.integers(-600, 1200)
)


def edited(arrangement: DockLayout, edit: tuple[str, int, int, int, int], spare: list[PanelName]) -> DockLayout:
    """The layout after the edit; the numbers select from its panels. ``spare`` are panels that can be added."""
    kind, first, second, side, pixels = edit
    panel = arrangement.panels[first % len(arrangement.panels)]
    other = arrangement.panels[second % len(arrangement.panels)]
    where: Any = SIDES[side]
    if kind == "move":
        return edits.move(arrangement, panel, other, where, at=pixels % 3)
    if kind == "edge":
        return edits.move_to_edge(arrangement, panel, where)
    if kind == "float":
        return edits.float_panel(arrangement, panel, QRect(pixels, first, 300 + first, 200 + second))
    if kind == "place" and arrangement.floating:
        return edits.place_window(arrangement, first % len(arrangement.floating), QRect(pixels, 5, 400, 300))
    if kind == "resize":
        handles = place(arrangement.tree, WINDOW, arrangement.docked, room).handles
        if handles:
            handle = handles[first % len(handles)]
            weights = dragged(arrangement.tree, handle, pixels)
            return edits.resize(arrangement, None, handle.path, weights)
    if kind == "add" and spare:
        return edits.add(arrangement, spare[first % len(spare)], (panel, other))
    if kind == "remove" and len(arrangement.panels) > 3:
        return edits.remove(arrangement, (panel,)) or arrangement
    simple = {"dock": edits.dock, "hide": edits.hide, "show": edits.show, "select": edits.select}
    return simple[kind](arrangement, panel) if kind in simple else arrangement
