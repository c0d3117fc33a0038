"""The panels on show: made from the table for each scenario, opened, closed and given the focus."""

from collections.abc import Callable
from typing import Any

from PySide6.QtCore import QObject, Qt, QTimer, Signal
from PySide6.QtWidgets import QApplication, QWidget

from caris_desktop.scenario.model import LayoutNode, PanelLeaf, PanelName, Scenario
from caris_desktop.ui.dock_host import DockHost, panels_in, without
from caris_desktop.ui.panel import Panel, PanelContext
from caris_desktop.ui.panel_table import PANELS, possible_panels


class PanelBoard(QObject):
    """Knows every panel by its name and none by its class."""

    window_wanted = Signal(str)  # WindowName: a panel asks for a window of its own

    def __init__(self, context: PanelContext, docks: DockHost) -> None:
        super().__init__(docks)
        self._context = context
        self._docks = docks
        self._panels: dict[PanelName, Panel] = {}
        self._lasting: dict[PanelName, Any] = {}
        self._has_library = False
        app = QApplication.instance()
        if isinstance(app, QApplication):
            app.focusChanged.connect(self._on_focus_changed)

    @property
    def panels(self) -> dict[PanelName, Panel]:
        """The panels of the current scenario."""
        return self._panels

    def possible(self) -> tuple[PanelName, ...]:
        """Every panel that this scenario's permissions allow, whether its layout has it or not."""
        return possible_panels(self._context.console.scenario.permissions)

    def is_open(self, name: PanelName) -> bool:
        return self._docks.is_open(name)

    def rebuild(self, scenario: Scenario) -> LayoutNode:
        """Make all panels, actions and shortcuts anew for ``scenario``; gives how the panels are arranged."""
        for name in self._panels:
            self._keep(name)
        actions, hold = self._context.actions, self._context.hold
        hold.release_all("The scenario was changed")
        actions.forget_driving_panels()
        hold.set_driving_panels(())
        self._docks.clear()
        actions.rebuild(scenario)
        absent = frozenset(panels_in(scenario.layout)) - frozenset(self.possible())
        tree = without(scenario.layout, absent) or PanelLeaf("video")
        self._panels = {}
        for name in panels_in(tree):
            self._make(name)
        self._docks.show_layout(self._panels, tree)
        self._bind_driving()
        return tree

    def open(self, name: PanelName) -> None:
        """Bring the panel to the front; one that the scenario does not have is added in a tab."""
        if name not in self.possible():
            return
        if name not in self._panels:
            self._docks.add_panel(name, self._make(name), PANELS[name].neighbours)
            self._bind_driving()
        self._docks.show_panel(name)

    def close(self, name: PanelName) -> None:
        """Close the panel; one that was added goes away altogether."""
        if name not in self._panels:
            return
        if name in panels_in(self._context.console.scenario.layout):
            self._docks.close_panel(name)
            return
        self._keep(name)
        panel = self._panels.pop(name)
        if panel.drives:
            self._bind_driving()
        self._docks.remove_panel(name)

    def opener(self, name: PanelName) -> Callable[[], None]:
        """Opens the panel and gives it the focus."""
        return lambda: self.open_and_focus(name)

    def closer(self, name: PanelName) -> Callable[[], None]:
        return lambda: self.close(name)

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
        panel = self._panels.get(name)
        if panel is not None:
            self.open(name)
            panel.focus_target().setFocus(Qt.FocusReason.ShortcutFocusReason)

    def focus_driving(self) -> bool:
        """Put the focus where the bare keys drive; False where the scenario has no such panel."""
        if self._context.actions.spec("drive_forward") is None:
            return False
        for name in ("video", "drive", "map"):
            panel = self._panels.get(name)
            if panel is not None:
                self._docks.show_panel(name)
                panel.focus_target().setFocus(Qt.FocusReason.ShortcutFocusReason)
                return True
        return False

    def use_library(self) -> None:
        """There is a list of all sessions to open."""
        self._has_library = True
        for panel in self._panels.values():
            panel.use_library(present=True)

    def _make(self, name: PanelName) -> Panel:
        panel = self._panels[name] = PANELS[name].load()(self._context)
        panel.window_wanted.connect(self.window_wanted)
        panel.use_library(present=self._has_library)
        if name in self._lasting:
            panel.take_over(self._lasting[name])
        return panel

    def _keep(self, name: PanelName) -> None:
        lasting = self._panels[name].what_lasts()
        if lasting is not None:
            self._lasting[name] = lasting

    def _bind_driving(self) -> None:
        driving = [panel for panel in self._panels.values() if panel.drives]
        self._context.actions.bind_driving_panels(driving)
        self._context.hold.set_driving_panels(driving)

    def _on_focus_changed(self, _old: QWidget | None, new: QWidget | None) -> None:
        for panel in self._panels.values():
            panel.set_active(new is not None and (panel is new or panel.isAncestorOf(new)))
