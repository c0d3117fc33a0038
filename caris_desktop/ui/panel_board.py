"""The panels on show: made from the table for each scenario, opened, closed and given the focus.

Another scenario's panels are made one at a time, and keys, the stop among them, and pictures get their turns in
between: those that are seen first, then their arrangement, and then those behind other tabs, whose places are kept so
far. Whoever asks for a panel meanwhile gets it: then the rest is made at once.
"""

import time
from collections import deque
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, QSize, Qt, QTimer, Signal
from PySide6.QtWidgets import QApplication, QMenu, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import dataclass
from caris_desktop.scenario.model import LayoutNode, PanelName, Scenario
from caris_desktop.scenario.panel_settings import PanelSettings
from caris_desktop.ui.dock_host import DockHost
from caris_desktop.ui.give_keys import give_keys
from caris_desktop.ui.layout.arrangement import Arrangement, arrangement_of
from caris_desktop.ui.layout.panel_size import RESIZE_PX, resized, resizer
from caris_desktop.ui.layout.tree import panels_in, permitted
from caris_desktop.ui.panel import PAUSE_MS, Panel, PanelContext
from caris_desktop.ui.panel_table import PANELS, possible_panels

TURN_S = 0.012
"""No further piece of work is begun in a turn after that: one that began with the last of it, a key still waits for no
longer than a picture takes to be painted.
"""


@dataclass(frozen=True, slots=True)
class _Building:
    """How the panels are arranged once they are made, and who is told then."""

    arrangement: Arrangement
    arranged: Callable[[], None]


class _KeptPlace(Panel):
    """Stands behind a tab until its panel is made, and needs the room that the last one of its kind did."""

    def __init__(self, context: PanelContext, name: PanelName, least: QSize) -> None:
        super().__init__(context)
        self._least = least
        self.title = tr(PANELS[name].title)
        self.show_title(self.title)

    def minimumSizeHint(self) -> QSize:
        return self._least


class PanelBoard(QObject):
    """Knows every panel by its name and none by its class."""

    window_wanted = Signal(str)  # WindowName: a panel asks for a window of its own
    moment_wanted = Signal(object)  # as of a panel
    made = Signal(str, object)  # PanelName, Panel
    completed = Signal()  # every panel of the scenario is there
    opened = Signal(str, object)  # PanelName, Panel: it is as the file of the scenario has it

    def __init__(self, context: PanelContext, docks: DockHost) -> None:
        super().__init__(docks)
        context.hold.escape_pressed.connect(docks.give_up)
        self._context = context
        self._docks = docks
        self._panels: dict[PanelName, Panel] = {}
        # Permitted, but without a place in the arrangement: not seen, and there when the next scenario wants them.
        self._aside: dict[PanelName, Panel] = {}
        self._lasting: dict[PanelName, Any] = {}
        self._least: dict[PanelName, QSize] = {}
        self._opened: tuple[Path | None, PanelSettings] | None = None
        self._opened_in: set[PanelName] = set()
        self._has_library = False
        self._building: _Building | None = None
        self._had_keys: PanelName | None = None
        self._outdated: deque[PanelName] = deque()  # they go on, and show what the scenario before said
        self._missing: deque[PanelName] = deque()
        self._behind: deque[PanelName] = deque()
        self._without_room: PanelName | None = None
        self._turn = QTimer(self, singleShot=True, interval=PAUSE_MS)
        self._turn.timeout.connect(self._build_for_a_turn)
        app = QApplication.instance()
        if isinstance(app, QApplication):
            app.focusChanged.connect(self._on_focus_changed)

    @property
    def panels(self) -> dict[PanelName, Panel]:
        """The panels of the current scenario."""
        self.complete()
        return self._panels

    @property
    def made_so_far(self) -> dict[PanelName, Panel]:
        """Those of them that are there; of each that follows ``made`` and ``opened`` tell."""
        return dict(self._panels)

    def possible(self) -> tuple[PanelName, ...]:
        """Every panel that this scenario offers, whether its layout has it or not."""
        return possible_panels(self._context.console.scenario)

    def is_open(self, name: PanelName) -> bool:
        return self._docks.is_open(name)

    def begin(
        self,
        scenario: Scenario,
        arranged: Callable[[LayoutNode], None],
        arrange: Callable[[LayoutNode], Arrangement] = arrangement_of,
    ) -> None:
        """Show the panels of ``scenario`` with its actions and shortcuts, in a few turns of the event loop.

        ``arrange`` makes the arrangement of the tree of its file, without what it does not allow; ``arranged`` gets
        that tree when all stands. Panels that go on with the scenario stay.
        """
        self._stop_building()
        self._had_keys = self._docks.panel_with_keys()
        actions, hold = self._context.actions, self._context.hold
        hold.release_all(QT_TR_NOOP("The scenario was changed"))
        actions.bind_driving_panels(())
        kept, possible = {**self._panels, **self._aside}, self.possible()
        for name, panel in tuple(kept.items()):
            if name not in possible or not panel.follow(scenario):
                self._keep(name, kept.pop(name))
        self._open_scenario(scenario)
        tree = permitted(scenario.layout, possible)
        arrangement = arrange(tree)
        self._panels, self._aside = kept, {}
        self._put_aside_all_but(arrangement.panels)
        self._docks.leave_gaps({**self._panels, **self._aside}, self._panels)
        actions.rebuild(scenario)
        self._bind_driving()
        self._outdated.extend(self._panels)
        missing, seen = [name for name in arrangement.panels if name not in self._panels], arrangement.in_front
        self._missing.extend(name for name in missing if name in seen)
        self._behind.extend(name for name in missing if name not in seen)
        self._building = _Building(arrangement, lambda: arranged(tree))
        self._turn.start()

    @property
    def building(self) -> bool:
        """Whether panels that will be seen are still to come."""
        return self._building is not None

    @property
    def whole(self) -> bool:
        """Whether every panel is there, also those behind other tabs."""
        return self._building is None and not (self._outdated or self._behind or self._without_room)

    def complete(self) -> None:
        """Make what is still missing, now."""
        missing = not self.whole
        while not self.whole:
            self._build_next()
        for panel in self._panels.values():
            panel.complete()
        if missing:
            self.completed.emit()

    def complete_seen(self) -> None:
        """Make what will be seen, now; those behind other tabs are made from :meth:`go_on` on."""
        while self.building:
            self._build_next()
        self._turn.stop()

    def go_on(self) -> None:
        """Make what is still missing, in a few turns of the event loop."""
        self._turn.start()

    def _build_next(self) -> None:
        """One panel that goes on, or one that is seen, or its room, or the arrangement of all, or at last one of the
        others.
        """
        if self._without_room is not None:
            self._give_room()
        elif self._outdated:
            name = self._outdated.popleft()
            self._panels[name].show_scenario()
            self._open_in(name, self._panels[name])
        elif self._missing:
            self._make_next(self._missing)
        elif self._building is not None:
            building, self._building = self._building, None
            self._put_aside_all_but(building.arrangement.panels)
            self._docks.show_arrangement({**self._panels, **self._aside, **self._kept_places()}, building.arrangement)
            self._bind_driving()
            self._keep_keys()
            building.arranged()
        elif self._behind:
            self._make_next(self._behind)

    def _keep_keys(self) -> None:
        """Where another scenario has the panel too, it goes on having the keys; else nobody has them."""
        had, self._had_keys = self._had_keys, None
        panel = None if had is None else self._panels.get(had)
        if panel is not None and panel.isVisible() and self._docks.panel_with_keys() is None:
            panel.focus_target().setFocus(Qt.FocusReason.OtherFocusReason)

    @property
    def _arranges_next(self) -> bool:
        """Whether the next step is the arrangement of all: the dearest, as the whole window is painted after it."""
        return self.building and not (self._without_room or self._outdated or self._missing)

    def _kept_places(self) -> dict[PanelName, Panel]:
        return {name: _KeptPlace(self._context, name, self._least.get(name, QSize(0, 0))) for name in self._behind}

    def _build_for_a_turn(self) -> None:
        """Several that are quickly done, or a single one: between any two the window would paint itself."""
        until_s = time.perf_counter() + TURN_S
        while not self.whole:
            arranging = self._arranges_next
            self._build_next()
            if time.perf_counter() >= until_s or arranging or self._arranges_next:
                break
        if self._without_room is not None:
            # Unseen, and gone with the window. One that gets its room at once does without: each change of what holds
            # it has all of its parts styled anew.
            self._panels[self._without_room].setParent(self._docks)
        if self.whole:
            self.completed.emit()
        else:
            self._turn.start()

    def _make_next(self, names: deque[PanelName]) -> None:
        name = self._without_room = names.popleft()
        self._make(name)

    def _give_room(self) -> None:
        name, self._without_room = self._without_room, None
        if name is not None:
            self._docks.make_room(name, self._panels[name])
            if self.whole:
                self._bind_driving()

    def _stop_building(self) -> None:
        self._turn.stop()
        self._give_room()
        self._outdated.clear()
        self._missing.clear()
        self._behind.clear()
        self._building = None

    def show(self, arrangement: Arrangement) -> None:
        """Arrange the panels like this: those that are there stay, and what is seen and missing is made; what is still
        to come and lies behind other tabs here too keeps its turn.
        """
        while self.building:
            self._build_next()
        self._give_room()
        self._put_aside_all_but(arrangement.panels)
        behind = [name for name in self._behind if name in arrangement.panels and name not in arrangement.in_front]
        self._behind = deque(behind)
        for name in arrangement.panels:
            if name not in self._panels and name not in behind:
                self._bring(name)
        self._docks.show_arrangement({**self._panels, **self._aside, **self._kept_places()}, arrangement)
        self._bind_driving()

    def open(self, name: PanelName) -> None:
        """Bring the panel to the front; one that the scenario does not have is added in a tab."""
        self.complete()
        if name not in self.possible():
            return
        if name not in self._panels:
            self._docks.add_panel(name, self._bring(name), PANELS[name].neighbours)
            self._bind_driving()
        self._docks.show_panel(name)

    def close(self, name: PanelName) -> None:
        """Close the panel; one that was added goes away altogether."""
        self.complete()
        if name not in self._panels:
            return
        if name in panels_in(self._context.console.scenario.layout):
            self._docks.close_panel(name)
            return
        if self._docks.remove_panel(name):
            self._keep(name, self._panels.pop(name))
            self._bind_driving()

    def fill_panel_menu(self, menu: QMenu, name: PanelName) -> None:
        """What can be done with where the panel lies."""
        self._docks.fill_menu(menu, name)

    def opener(self, name: PanelName) -> Callable[[], None]:
        """Opens the panel and gives it the focus."""
        return lambda: self.open_and_focus(name)

    def closer(self, name: PanelName) -> Callable[[], None]:
        return lambda: self.close(name)

    def floater(self, name: PanelName) -> Callable[[], None]:
        """Gives the panel a window of its own, or puts it back."""
        return lambda: self._docks.toggle_floating(name)

    def resizers(self, name: PanelName) -> list[tuple[int, Callable[[], None]]]:
        """By how many pixels the panel can be made larger, or smaller, and what does it."""
        docks = self._docks
        steps = [by_px for by_px in (RESIZE_PX, -RESIZE_PX) if resized(docks, name, by_px) is not None]
        return [(by_px, resizer(docks, name, by_px)) for by_px in steps]

    def toggler(self, name: PanelName) -> Callable[[bool], None]:
        """Opens or closes the panel after the menu has closed, so that it gets its size and the focus can go there."""

        def toggle(shown: bool) -> None:
            QTimer.singleShot(0, self, lambda: self.open(name) if shown else self.close(name))

        return toggle

    def open_and_focus(self, name: PanelName) -> None:
        self.open(name)
        self.focus(name)

    def focus(self, name: PanelName) -> None:
        """Give the focus to the panel, if it is there."""
        panel = self.panels.get(name)
        if panel is not None:
            self.open(name)
            give_keys(panel.focus_target())

    def focus_driving(self) -> bool:
        """Put the focus where the bare keys drive; False where the scenario has no such panel."""
        if self._context.actions.spec("drive_forward") is None:
            return False
        driving: tuple[PanelName, ...] = ("video", "drive", "map")
        if not any(name in self._panels for name in driving):
            self.complete()
        for name in driving:
            panel = self._panels.get(name)
            if panel is not None:
                self._docks.show_panel(name)
                give_keys(panel.focus_target())
                return True
        return False

    def use_library(self) -> None:
        """There is a list of all sessions to open."""
        self._has_library = True
        for panel in (*self._panels.values(), *self._aside.values()):
            panel.use_library(present=True)

    def _make(self, name: PanelName) -> Panel:
        panel: Panel = PANELS[name].load()(self._context)
        self._panels[name] = panel
        self._least[name] = panel.minimumSizeHint()
        panel.window_wanted.connect(self.window_wanted)
        panel.moment_wanted.connect(self.moment_wanted)
        panel.use_library(present=self._has_library)
        self.made.emit(name, panel)
        if name in self._opened_in:
            self._use_settings(name, panel)
        if name in self._lasting:
            panel.take_over(self._lasting[name])
        self._open_in(name, panel)
        return panel

    def _open_scenario(self, scenario: Scenario) -> None:
        """Panels are as its file has them at first, once: then as the wizard has them, for as long as it is open, also
        where something else in it is changed meanwhile.
        """
        if (scenario.path, scenario.panels) != self._opened:
            self._opened = scenario.path, scenario.panels
            self._opened_in.clear()
            self._context.console.state.prefer_camera(scenario.panels.video.camera)

    def _open_in(self, name: PanelName, panel: Panel) -> None:
        if name not in self._opened_in:
            self._opened_in.add(name)
            self._use_settings(name, panel)

    def _use_settings(self, name: PanelName, panel: Panel) -> None:
        with panel.by_itself():
            panel.use_settings(self._context.console.scenario.panels)
        self.opened.emit(name, panel)

    def _bring(self, name: PanelName) -> Panel:
        """The panel that was put aside, which shows the present scenario again; else a new one."""
        panel = self._aside.pop(name, None)
        if panel is None:
            return self._make(name)
        self._panels[name] = panel
        panel.show_scenario()
        self._open_in(name, panel)
        return panel

    def _put_aside_all_but(self, names: Collection[PanelName]) -> None:
        for name in tuple(self._panels):
            if name not in names:
                self._aside[name] = self._panels.pop(name)

    def _keep(self, name: PanelName, panel: Panel) -> None:
        """It goes; what it leaves to the next of its kind stays."""
        lasting = panel.what_lasts()
        if lasting is not None:
            self._lasting[name] = lasting

    def _bind_driving(self) -> None:
        driving = [panel for panel in self._panels.values() if panel.drives]
        self._context.actions.bind_driving_panels(driving)
        self._context.hold.set_driving_panels(driving)

    def _on_focus_changed(self, _old: QWidget | None, new: QWidget | None) -> None:
        for panel in (*self._panels.values(), *self._aside.values()):
            panel.set_active(new is not None and (panel is new or panel.isAncestorOf(new)))
