"""Keyboard resizing of panels in steps."""

from collections.abc import Callable, Mapping
from typing import Protocol

from caris_desktop.domain.translation import tr
from caris_desktop.scenario.scenario_model import PanelName
from caris_desktop.ui.layout import dock_layout as edits
from caris_desktop.ui.layout.dock import Dock
from caris_desktop.ui.layout.dock_area import DockArea
from caris_desktop.ui.layout.dock_geometry import grown
from caris_desktop.ui.layout.dock_layout import DockLayout
from caris_desktop.ui.layout.layout_tree import panels_in

RESIZE_PX = 48
"""Step in px."""


class Arranged(Protocol):
    """A dock area with its layout, as needed for resizing."""

    docks: Mapping[PanelName, Dock]

    @property
    def arrangement(self) -> DockLayout | None: ...

    def edit(self, description: str, after: DockLayout | None) -> bool:
        """Apply the wizard's edit ``description``; returns whether it was applied."""


def resized(docks: Arranged, name: PanelName, by_px: int) -> DockLayout | None:
    """Layout with the panel larger by this much, or smaller if negative; None if its neighbours leave no room."""
    arrangement = docks.arrangement
    area = docks.docks[name].parentWidget() if name in docks.docks else None
    if arrangement is None or not arrangement.is_shown(name) or not isinstance(area, DockArea):
        return None
    found = None if area.whole_tree is None else grown(area.whole_tree, area.placing, name, by_px)
    if found is None:
        return None
    floating = enumerate(arrangement.floating)
    window = next((index for index, window in floating if name in panels_in(window.tree)), None)
    return edits.resize(arrangement, window, *found)


def resizer(docks: Arranged, name: PanelName, by_px: int) -> Callable[[], None]:
    def resize() -> None:
        description = tr("Make {panel} larger") if by_px > 0 else tr("Make {panel} smaller")
        docks.edit(description.format(panel=docks.docks[name].widget().title), resized(docks, name, by_px))

    return resize
