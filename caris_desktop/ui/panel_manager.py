"""Panel manager: creates the panels of a scenario, opens, closes and focuses them.

Panels are created one at a time, so that keys (the stop among them) and video are handled in between: visible panels
first, then the layout, then those behind other tabs and those whose library is imported in the background meanwhile;
placeholders stand in for them. A request for a panel creates all remaining ones at once.
"""

import importlib
import time
from collections import deque
from collections.abc import Callable, Collection, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from PySide6.QtCore import QObject, QSize, Qt, QTimer, Signal
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.scenario.scenario_model import LayoutNode, PanelName, PanelSettings, Scenario, panels_in
from caris_desktop.ui.dock_host import DockHost
from caris_desktop.ui.dock_layout import DockLayout, arrangement_of, permitted
from caris_desktop.ui.focus_widget import application, existing, focus_widget
from caris_desktop.ui.panel import PAUSE_MS, Panel, PanelContext
from caris_desktop.ui.panel_table import PANELS, possible_panels

TURN_S = 0.012
"""Time budget in seconds of a turn; no further step begins after it. A step begun just before it delays a key by no
more than one repaint.
"""


class _ReservedPlace(Panel):
    """Placeholder behind a tab until its panel is created, with the minimum size of its predecessor."""

    def __init__(self, context: PanelContext, name: PanelName, least: QSize) -> None:
        super().__init__(context)
        self.least_size = least
        self.title = tr(PANELS[name].title)
        self.show_title(self.title)


class PanelManager(QObject):
    """Manages all panels by name, without knowing their classes."""

    window_requested = Signal(str)  # WindowName: a panel requests a window
    moment_requested = Signal(object)  # forwarded from a panel
    made = Signal(str, object)  # PanelName, Panel
    completed = Signal()  # all panels of the scenario exist
    opened = Signal(str, object)  # PanelName, Panel, in the state given by the scenario file

    def __init__(self, context: PanelContext, docks: DockHost) -> None:
        super().__init__(docks)
        context.hold.escape_pressed.connect(docks.give_up)
        self._context = context
        self.docks = docks
        self._panels: dict[PanelName, Panel] = {}
        # Permitted but not in the layout: hidden, and reused when a later scenario shows them.
        self._aside: dict[PanelName, Panel] = {}
        self._lasting: dict[PanelName, Any] = {}
        self._least: dict[PanelName, QSize] = {}
        self._opened: tuple[Path | None, PanelSettings] | None = None
        self._opened_in: set[PanelName] = set()
        self._has_library = False
        # Refresh of reused panels, creation of visible ones, and the layout, which ends them.
        self._steps: deque[Callable[[], object]] = deque()
        self._had_keys: PanelName | None = None
        self._behind: deque[PanelName] = deque()
        self._without_room: PanelName | None = None
        self._importing = False
        self._turn = QTimer(self, singleShot=True, interval=PAUSE_MS)
        self._turn.timeout.connect(self._build_for_a_turn)
        application().focusChanged.connect(self._on_focus_changed)

    @property
    def panels(self) -> dict[PanelName, Panel]:
        """Panels of the current scenario; creates missing ones."""
        self.complete()
        return self._panels

    @property
    def made_so_far(self) -> dict[PanelName, Panel]:
        """Panels created so far; ``made`` and ``opened`` report the others."""
        return dict(self._panels)

    def possible(self) -> tuple[PanelName, ...]:
        """All panels that this scenario offers, in its layout or not."""
        console = self._context.console
        possible = possible_panels(console.scenario)
        # Nobody has confirmed what a recorded scenario names.
        return possible if console.state.present.live else tuple(name for name in possible if name in PANELS)

    def is_open(self, name: PanelName) -> bool:
        return self.docks.is_open(name)

    def begin(
        self,
        scenario: Scenario,
        arranged: Callable[[LayoutNode], None],
        arrange: Callable[[LayoutNode], DockLayout] = arrangement_of,
    ) -> None:
        """Show the panels of ``scenario`` with its actions and shortcuts, over several turns of the event loop.

        ``arrange`` computes the layout from the permitted tree of its file; ``arranged`` receives that tree on
        completion. Reusable panels stay.
        """
        self._turn.stop()
        self._give_room()
        self._steps.clear()
        self._behind.clear()
        self._had_keys = self.docks.panel_with_keys()
        actions, hold = self._context.actions, self._context.hold
        hold.release_all(QT_TR_NOOP("The scenario was changed"))
        actions.bind_driving_panels(())
        remaining, possible = {**self._panels, **self._aside}, self.possible()
        for name, panel in tuple(remaining.items()):
            if name not in possible or not panel.can_reuse(scenario):
                self._persist(name, remaining.pop(name))
        # The file's panel settings apply when it is opened or when they change; other changes of the file do not
        # override the wizard.
        if (scenario.path, scenario.panels) != self._opened:
            self._opened = scenario.path, scenario.panels
            self._opened_in.clear()
            self._context.console.state.prefer_camera(scenario.panels.video.camera)
        tree = permitted(scenario.layout, possible)
        arrangement = arrange(tree)
        self._panels, self._aside = remaining, {}
        self._put_aside_all_but(arrangement.panels)
        self.docks.leave_gaps({**self._panels, **self._aside}, self._panels)
        actions.rebuild(scenario)
        self._bind_driving()
        missing, front_panels = [name for name in arrangement.panels if name not in self._panels], arrangement.in_front
        now = [name for name in missing if name in front_panels and PANELS[name].ready]
        self._behind.extend(name for name in missing if name not in now)
        self._steps.extend(partial(self._refresh, name) for name in self._panels)
        self._steps.extend(partial(self._make_without_room, name) for name in now)
        self._steps.append(partial(self._arrange, arrangement, partial(arranged, tree)))
        self._turn.start()

    @property
    def building(self) -> bool:
        """Whether visible panels are still missing."""
        return bool(self._steps)

    @property
    def whole(self) -> bool:
        """Whether all panels exist, also those behind other tabs."""
        return not (self._steps or self._behind or self._without_room)

    def complete(self) -> None:
        """Create all missing panels now."""
        missing = not self.whole
        while not self.whole:
            self._build_next()
        for panel in self._panels.values():
            panel.complete()
        if missing:
            self.completed.emit()

    def complete_seen(self) -> None:
        """Create all visible panels now; :meth:`go_on` creates those behind other tabs."""
        while self.building:
            self._build_next()
        self._turn.stop()

    def go_on(self) -> None:
        """Create missing panels over several turns of the event loop."""
        self._turn.start()

    def _build_next(self) -> None:
        """Run one step: place a new panel, the next of the steps, or create a hidden panel."""
        if self._without_room is not None:
            self._give_room()
        elif self._steps:
            self._steps.popleft()()
        elif self._behind:
            self._make_without_room(self._behind.popleft())

    def _refresh(self, name: PanelName) -> None:
        self._panels[name].show_scenario()
        self._open_in(name, self._panels[name])

    def _arrange(self, arrangement: DockLayout, arranged: Callable[[], None]) -> None:
        self._put_aside_all_but(arrangement.panels)
        self._show_arrangement(arrangement)
        # A panel that the new scenario also has keeps the focus; otherwise nothing is focused.
        had, self._had_keys = self._had_keys, None
        panel = None if had is None else self._panels.get(had)
        if panel is not None and panel.isVisible() and self.docks.panel_with_keys() is None:
            panel.focus_target().setFocus(Qt.FocusReason.OtherFocusReason)
        arranged()

    def _show_arrangement(self, arrangement: DockLayout) -> None:
        places = {
            name: _ReservedPlace(self._context, name, self._least.get(name, QSize(0, 0))) for name in self._behind
        }
        self.docks.show_arrangement({**self._panels, **self._aside, **places}, arrangement)
        self._bind_driving()

    @property
    def _arranges_next(self) -> bool:
        """Whether the next step applies the layout: the slowest step, as it repaints the whole window."""
        return len(self._steps) == 1 and self._without_room is None

    def _build_for_a_turn(self) -> None:
        """Run several short steps or a single long one; the window repaints between turns."""
        until_s = time.perf_counter() + TURN_S
        while not self.whole:
            if self._waits_for_library():
                return
            arranging = self._arranges_next
            self._build_next()
            if time.perf_counter() >= until_s or arranging or self._arranges_next:
                break
        if self._without_room is not None:
            # A hidden child, deleted with the window. A panel that is placed at once needs no parent: each reparenting
            # restyles all its children.
            self._panels[self._without_room].setParent(self.docks)
        if self.whole:
            self.completed.emit()
        else:
            self._turn.start()

    def _waits_for_library(self) -> bool:
        """Whether all missing panels wait for a library, which is imported meanwhile; the others come first."""
        late = [name for name in self._behind if not PANELS[name].ready]
        if late and not self.building and not self._importing:
            self._importing = True
            self._context.console.run_in_background(PANELS[late[0]].import_library, self._on_imported)
        self._behind = deque(sorted(self._behind, key=lambda name: not PANELS[name].ready))
        left = self.building or self._without_room or len(late) < len(self._behind)
        return bool(late) and not left

    def _on_imported(self, _nothing: None) -> None:
        self._importing = False
        self._turn.start()

    def _make_without_room(self, name: PanelName) -> None:
        self._without_room = name
        self._make(name)

    def _give_room(self) -> None:
        name, self._without_room = self._without_room, None
        if name is not None:
            self.docks.make_room(name, self._panels[name])
            if self.whole:
                self._bind_driving()

    def show(self, arrangement: DockLayout) -> None:
        """Apply a layout: existing panels stay, visible missing ones are created, and hidden missing ones keep their
        turn.
        """
        while self.building:
            self._build_next()
        self._give_room()
        self._put_aside_all_but(arrangement.panels)
        ready = {name for name in arrangement.in_front if PANELS[name].ready}
        self._behind = deque(name for name in self._behind if name in arrangement.panels and name not in ready)
        for name in arrangement.panels:
            if name not in self._panels and name not in self._behind:
                self._bring(name)
        self._show_arrangement(arrangement)

    def open(self, name: PanelName) -> None:
        """Raise the panel; one that the scenario does not have is added in a tab."""
        self.complete()
        if name not in self.possible():
            return
        if name not in self._panels:
            self.docks.add_panel(name, self._bring(name), PANELS[name].neighbours)
            self._bind_driving()
        self.docks.show_panel(name)

    def close(self, name: PanelName) -> None:
        """Close the panel; an added one is removed."""
        self.complete()
        if name not in self._panels:
            return
        added = name not in panels_in(self._context.console.scenario.layout)
        if self.docks.close_panel(name, remove=added) and added:
            self._persist(name, self._panels.pop(name))
            self._bind_driving()

    def set_open(self, name: PanelName, opened: bool) -> None:
        """Open or close the panel after the menu has closed, so that size and focus can be set."""
        QTimer.singleShot(0, self, partial(self.open_and_focus if opened else self.close, name))

    def open_and_focus(self, name: PanelName) -> None:
        self.open(name)
        self.focus(name)

    def focus(self, name: PanelName) -> None:
        """Focus the panel, if it exists."""
        panel = self.panels.get(name)
        if panel is not None:
            self.open(name)
            focus_widget(panel.focus_target())

    def focus_driving(self) -> bool:
        """Focus a panel where the bare keys drive; False if the scenario has none."""
        if self._context.actions.spec("drive_forward") is None:
            return False
        driving: tuple[PanelName, ...] = ("video", "drive", "map")
        if not any(name in self._panels for name in driving):
            self.complete()
        name = next((name for name in driving if name in self._panels), None)
        if name is not None:
            self.docks.show_panel(name)
            focus_widget(self._panels[name].focus_target())
        return name is not None

    def use_library(self) -> None:
        """Enable the session library."""
        self._has_library = True
        for panel in (*self._panels.values(), *self._aside.values()):
            panel.use_library(present=True)

    def _make(self, name: PanelName) -> Panel:
        panel: Panel = PANELS[name].load()(self._context)
        self._panels[name] = panel
        self._least[name] = panel.minimumSizeHint()
        panel.window_requested.connect(self.window_requested)
        panel.moment_requested.connect(self.moment_requested)
        panel.use_library(present=self._has_library)
        self.made.emit(name, panel)
        if name in self._opened_in:
            self._use_settings(name, panel)
        if name in self._lasting:
            panel.restore_state(self._lasting[name])
        self._open_in(name, panel)
        return panel

    def _open_in(self, name: PanelName, panel: Panel) -> None:
        if name not in self._opened_in:
            self._opened_in.add(name)
            self._use_settings(name, panel)

    def _use_settings(self, name: PanelName, panel: Panel) -> None:
        with panel.preferences_blocked():
            panel.use_settings(self._context.console.scenario.panels)
        self.opened.emit(name, panel)

    def _bring(self, name: PanelName) -> Panel:
        """A hidden panel, refreshed for the present scenario; else a new one."""
        if name not in self._aside:
            return self._make(name)
        self._panels[name] = self._aside.pop(name)
        self._refresh(name)
        return self._panels[name]

    def _put_aside_all_but(self, names: Collection[PanelName]) -> None:
        for name in tuple(self._panels):
            if name not in names:
                self._aside[name] = self._panels.pop(name)

    def _persist(self, name: PanelName, panel: Panel) -> None:
        """Save the state of a removed panel for its successor."""
        lasting = panel.save_state()
        if lasting is not None:
            self._lasting[name] = lasting

    def _bind_driving(self) -> None:
        driving = [panel for panel in self._panels.values() if panel.drives]
        self._context.actions.bind_driving_panels(driving)
        self._context.hold.set_driving_panels(driving)

    def _on_focus_changed(self, _old: QWidget | None, new: QWidget | None) -> None:
        # A panel that is deleted with the focus inside no longer tells anybody.
        for panel in filter(existing, (*self._panels.values(), *self._aside.values())):
            panel.set_active(new is not None and (panel is new or panel.isAncestorOf(new)))


BEGIN_AFTER_MS = 3000
EVERY_MS = 250

MODULES: tuple[str, ...] = (
    "caris_desktop.ui.start_dialog",
    "caris_desktop.ui.set_up_page",
    "caris_desktop.ui.gamepad_dialog",
    *(f"caris_desktop.ui.panels.{spec.name}_panel" for spec in PANELS.values()),
    # Dependencies of the dialogs below, in pieces that import quickly.
    "caris_desktop.recording.session.recovery",
    "caris_desktop.recording.annotation.annotation_store",
    "caris_desktop.recording.pseudonyms",
    "caris_desktop.recording.session_export",
    "caris_desktop.robot.profile_proposal",
    "caris_desktop.ui.sessions_window",
    "caris_desktop.ui.export_dialog",
    "caris_desktop.ui.robot_dialog",
    "caris_desktop.scenario.document",
    "caris_desktop.ui.scenario_editor.form",
    "caris_desktop.ui.scenario_editor.editor_window",
)


class LateImports(QObject):
    """Imports modules in idle turns of the event loop. ``busy`` says whether a stall would be felt now: a blocked GUI
    thread ends teleoperation.
    """

    def __init__(
        self,
        busy: Callable[[], bool],
        parent: QObject,
        modules: Sequence[str] = MODULES,
        *,
        first: Sequence[Callable[[], object]] = (),
    ) -> None:
        """``first`` are called before the imports: they load menus and reopen windows."""
        super().__init__(parent)
        self._busy = busy
        self._left = deque[Callable[[], object]](
            (*first, *(partial(importlib.import_module, module) for module in modules))
        )
        self._next = QTimer(self, interval=EVERY_MS)
        self._next.timeout.connect(self.import_next)
        self._begin = QTimer(self, singleShot=True, interval=BEGIN_AFTER_MS)
        self._begin.timeout.connect(self._next.start)

    def begin(self) -> None:
        """Start after the window is shown and idle."""
        self._begin.start()

    def end(self) -> None:
        self._begin.stop()
        self._next.stop()

    def import_next(self) -> None:
        if self._busy():
            return
        if self._left:
            self._left.popleft()()
        if not self._left:
            self.end()
