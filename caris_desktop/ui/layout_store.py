"""Layout store of the window: the wizard's working copy of the dock layout, with save, revert, undo,
lock and record.
"""

import json
import logging
from collections import defaultdict
from collections.abc import Callable
from dataclasses import field
from functools import partial
from typing import Any

from PySide6.QtCore import QObject, QTimer, Signal
from PySide6.QtGui import QUndoCommand, QUndoStack
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import Problem
from caris_desktop.domain.intents import SizeClass
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.scenario_model import LayoutNode, Scenario, layout_data, layout_text, own_layout, panels_in
from caris_desktop.ui import dock_layout as edits
from caris_desktop.ui.dock_geometry import fitted, size_class
from caris_desktop.ui.dock_host import LOCKED, DockHost
from caris_desktop.ui.dock_layout import (
    DockLayout,
    arrangement_data,
    arrangement_from,
    arrangement_of,
    differs,
    permitted,
    tidy,
    with_the_panels_of,
)
from caris_desktop.ui.panel_manager import PanelManager
from caris_desktop.ui.preferences import WizardProfiles, from_json

LAYOUT_AT_REST_MS = 1000
_SAME_WEIGHT = 0.01  # a difference of a pixel is not another layout
_FITTING_WEIGHT = 0.002  # a bar of two pixels beside the picture is not seen
_NARROW_REPLAY_PX, _LOW_REPLAY_PX = 860, 300


class LayoutCommand(Value):
    """Layout command with its availability. ``action``: the row of the action table that does the same; ``id`` does not
    depend on language or on what would be undone.
    """

    text: str
    icon: str
    do: Callable[[], None]
    possible: bool = True
    action: str = ""
    id: str = field(kw_only=True)


MOST_UNDO_STEPS = 200


class LayoutEdit(QUndoCommand):
    """Edit of the dock layout that is applied already. ``exchange`` shows a layout and returns the one shown before."""

    def __init__(self, description: str, before: DockLayout, exchange: Callable[[DockLayout], DockLayout]) -> None:
        super().__init__(description)
        self._other: DockLayout | None = None
        self._before = before
        self._exchange = exchange

    def undo(self) -> None:
        self._other = self._exchange(self._before)

    def redo(self) -> None:
        if self._other is not None:  # not when it is pushed
            self._before = self._exchange(self._other)


class LayoutStore(QObject):
    """The wizard's working copy of the dock layout, apart from the scenario file.

    One per screen size class. Each change is persisted and restored with the scenario; only saving writes it to the
    scenario file. ``show_scenario`` shows the panels of a scenario in their current layout.
    """

    title_requested = Signal()  # the receiver asks the wizard for a title and calls ``save_as``
    noticed = Signal(object)  # Problem, for a notification
    changed = Signal()  # availability of the commands changed

    def __init__(
        self,
        docks: DockHost,
        board: PanelManager,
        console: WizardConsole,
        wizards: WizardProfiles,
        show_scenario: Callable[[Scenario], None],
    ) -> None:
        super().__init__(docks)
        self._docks = docks
        self._board = board
        self._console = console
        self._file = LayoutFile(wizards)
        self._show_scenario = show_scenario
        self._recorded: LayoutNode | None = None
        self._of_scenario: LayoutNode | None = None
        self._in_replay = False
        self._borrower: QWidget | None = None
        self._aspect = 4 / 3
        self._aspect_known = False
        self._kind: SizeClass = "usual"
        self._name = ""
        self._trees: dict[SizeClass, LayoutNode] = {}
        self._baseline: LayoutNode | None = None
        self._touched = self._resetting = False
        self._histories = defaultdict[SizeClass, QUndoStack](partial(QUndoStack, undoLimit=MOST_UNDO_STEPS))
        self.rest = QTimer(self, singleShot=True, interval=LAYOUT_AT_REST_MS)
        self.rest.timeout.connect(self.record_layout)
        docks.layout_changed.connect(self.rest.start)
        docks.layout_changed.connect(self._on_layout_changed)
        docks.edited.connect(self._on_edited)
        docks.refused.connect(lambda reason: self._notice(reason, ""))
        docks.room_changed.connect(self._fit)
        wizards.changed.connect(self._on_wizard_changed)
        console.state.frame.changed.connect(self._on_frame)
        console.state.robot.changed.connect(self._on_robot)

    def lend_room_to(self, strip: QWidget) -> None:
        """Set the strip above the panels, whose appearance does not count as another window size."""
        self._borrower = strip

    @property
    def _height(self) -> int:
        """Height available to the panels, without counting the strip."""
        strip = self._borrower
        if strip is None or strip.isHidden():
            return self._docks.height()
        # A strip that just appears gets its size after the panels.
        wraps, width = strip.hasHeightForWidth(), self._docks.window().width()
        return self._docks.height() + (strip.heightForWidth(width) if wraps else strip.sizeHint().height())

    def _on_robot(self, _robot: object) -> None:
        self._aspect_known = False

    def _on_frame(self, frame: FrameRef) -> None:
        """Fit the layout to the first picture of a robot. Later ones, of other cameras, move nothing."""
        if not self._aspect_known:
            self._aspect_known = True
            self._aspect = min(max(frame.width_px / max(1, frame.height_px), 1.0), 2.0)
            self._fit()

    def use_replay(self) -> None:
        """Switch to a replay: its layout belongs to no study and its height to no screen size class."""
        self._in_replay = True
        self._docks.set_locked(False)

    # ---- the working copy

    def begin(self, tree: LayoutNode) -> DockLayout:
        """Start with the layout ``tree`` of the scenario file; returns the wizard's layout."""
        scenario = self._console.scenario
        name = scenario.path.name if scenario.path is not None else scenario.title
        trees = self._trees_of(scenario, tree)
        if (name, trees) != (self._name, self._trees):
            self._histories.clear()
        self._name, self._trees = name, trees
        self._docks.set_locked(not self._in_replay and self._file.is_locked(name))
        return self._load(self._kind_now())

    def _trees_of(self, scenario: Scenario, tree: LayoutNode) -> dict[SizeClass, LayoutNode]:
        """The file's layout for each screen size class, all with the panels of the usual layout."""
        trees: dict[SizeClass, LayoutNode] = {"usual": tree}
        for kind in ("compact", "large"):
            if (layout := own_layout(scenario, kind)) is not None:
                trees[kind] = with_the_panels_of(tree, layout)
        return trees

    def _kind_now(self) -> SizeClass:
        if self._in_replay:
            return "compact" if self._docks.width() < _NARROW_REPLAY_PX else "usual"
        return size_class(self._docks.width(), self._height) if self._adapts_now else "usual"

    @property
    def _adapts_now(self) -> bool:
        return self._file.adapts and self._docks.isVisible() and not self._in_replay

    def _baseline_of(self, kind: SizeClass) -> LayoutNode:
        """The layout from the file as shown before any change by the wizard."""
        if kind in self._trees and not (kind == "usual" and self._adapts_now and self._aspect_known):
            return tidy(self._trees[kind])
        # In a replay, panel height follows from the video in it, which depends on the layout.
        if self._in_replay:
            height = _LOW_REPLAY_PX if kind == "compact" else self._height
            return fitted(self._trees["usual"], self._docks.width(), height)
        return fitted(self._trees["usual"], self._docks.width(), self._height, self._aspect)

    def _file_tree(self, kind: SizeClass) -> LayoutNode:
        return self._trees.get(kind, self._trees["usual"])

    def _load(self, kind: SizeClass) -> DockLayout:
        self._kind, self._touched = kind, False
        self._baseline = baseline = self._baseline_of(kind)
        stored = None
        if not self._in_replay:
            try:
                stored = self._file.working(self._name, kind)
            except ValueError:
                self._notice(
                    tr("Your panel layout could not be read."),
                    tr("The layout of the scenario is used instead. A copy of your saved layout is in the settings."),
                )
        mine = None if stored is None else self._possible(stored[0])
        if stored is None or mine is None:
            return arrangement_of(baseline)
        if stored[1] != layout_data(self._file_tree(kind)):
            self._file.save_working_copy(self._name, kind, self._file_tree(kind), None)
            self._note(tr("The scenario’s new layout"), mine)
            self._notice(
                tr("The scenario’s layout has changed since last time."),
                tr("Your own layout is not lost: choose Undo in the Layout menu to restore it."),
            )
            return arrangement_of(baseline)
        self._touched = True
        return mine

    def _possible(self, arrangement: DockLayout) -> DockLayout | None:
        """The layout without panels that the scenario does not offer, and with missing panels that it shows."""
        possible = self._board.possible()
        left = edits.remove(arrangement, [name for name in arrangement.panels if name not in possible])
        for name in panels_in(self._trees["usual"]):
            if left is not None and name not in left.panels:
                left = edits.add(left, name, ())
        return left

    def _fit(self) -> None:
        """Switch the layout to the current window size, unless the wizard has changed it for that size."""
        if not self._trees or not self._docks.isVisible() or self._board.building:
            return  # completion triggers another check
        kind = self._kind_now()
        if kind != self._kind:
            self._board.show(self._load(kind))
            self._begin_reporting()
        elif not self._touched:
            baseline = self._baseline_of(kind)
            if self._baseline is None or differs(baseline, self._baseline, by=_FITTING_WEIGHT):
                self._baseline = baseline
                self._board.show(arrangement_of(baseline))
                self._begin_reporting()

    def _on_edited(self, description: str, before: DockLayout) -> None:
        self._note(description, before)
        self._touched = True

    def _note(self, description: str, before: DockLayout) -> None:
        self._history.push(LayoutEdit(description, before, self._exchange))

    def _exchange(self, layout: DockLayout) -> DockLayout:
        present = self._docks.arrangement
        self._touched = True
        self._board.show(self._possible(layout) or layout)
        return layout if present is None else present

    def _on_layout_changed(self) -> None:
        """Persist each change, in case of a crash or power cut."""
        arrangement = self._docks.arrangement
        if self._touched and arrangement is not None and not (self._in_replay or self._board.building):
            self._touched = self.is_own
            self._file.save_working_copy(
                self._name, self._kind, self._file_tree(self._kind), arrangement if self._touched else None
            )
        self.changed.emit()

    def takes_reset(self) -> bool:
        """Whether the next file of the scenario is that of a reset, whose layout is shown; asked once."""
        resetting, self._resetting = self._resetting, False
        return resetting

    def follow(self, scenario: Scenario) -> None:
        """Adopt a changed layout of the scenario file without moving the panels."""
        self._of_scenario = scenario.layout
        if self._trees:
            self._trees = self._trees_of(scenario, permitted(scenario.layout, self._board.possible()))
            self._baseline = self._baseline_of(self._kind)
            self._touched = True
            self._on_layout_changed()

    def _on_wizard_changed(self) -> None:
        if self._trees and not self._in_replay:
            self._histories.clear()
            self._docks.set_locked(self._file.is_locked(self._name))
            self._board.show(self._load(self._kind_now()))

    # ---- menu commands

    @property
    def is_unsaved(self) -> bool:
        """Whether saving would change the file."""
        tree, saved = self._docks.tree, self._trees.get(self._kind)
        if tree is None or self._baseline is None:
            return False
        # The file's own layout is shown without bars beside the picture.
        return all(differs(tree, each, by=_SAME_WEIGHT) for each in (self._baseline, saved) if each is not None)

    @property
    def is_own(self) -> bool:
        """Whether the wizard has changed the layout in any way, saved or not."""
        arrangement = self._docks.arrangement
        return self.is_unsaved or (arrangement is not None and bool(arrangement.floating or arrangement.hidden))

    @property
    def locked(self) -> bool:
        return self._docks.locked

    def set_locked(self, locked: bool) -> None:
        """Lock the layout for a study: no panel can be moved, closed or floated."""
        self._file.set_locked(self._name, locked)
        self._docks.set_locked(locked)
        self.changed.emit()

    @property
    def adapts(self) -> bool:
        return self._file.adapts

    def set_adapts(self, adapts: bool) -> None:
        """Set whether small and large screens get a layout of their own."""
        self._file.set_adapts(adapts)
        self._fit()

    @property
    def kind(self) -> SizeClass:
        return self._kind

    @property
    def _history(self) -> QUndoStack:
        return self._histories[self._kind]

    def commands(self) -> tuple[LayoutCommand, ...]:
        """Commands for menu and palette."""
        undoes, redoes = self._history.undoText(), self._history.redoText()
        undo = tr("Undo: {what}").format(what=undoes) if undoes else tr("Undo")
        redo = tr("Redo: {what}").format(what=redoes) if redoes else tr("Redo")
        free, live, saves = not self.locked, not self._in_replay, tr("Save to the scenario")
        saves_as, reverts = tr("Save as another scenario…"), tr("Revert to the scenario’s layout")
        return (
            LayoutCommand(undo, "arrow-u-up-left", self.undo, bool(undoes) and free, "layout_undo", id="Undo"),
            LayoutCommand(redo, "arrow-u-up-right", self.redo, bool(redoes) and free, id="Redo"),
            LayoutCommand(saves, "floppy-disk", self.save, self.is_unsaved and live, id="Save into the scenario"),
            LayoutCommand(saves_as, "floppy-disk", self.title_requested.emit, live, id="Save as another scenario…"),
            LayoutCommand(
                reverts, "arrow-counter-clockwise", self.revert, self.is_own, id="Revert to the scenario’s layout"
            ),
            LayoutCommand(
                tr("Reset to the original layout"), "layout", self.put_back, id="Reset: as the scenario came"
            ),
        )

    def undo(self) -> None:
        self._unless_locked(self._history.undo)

    def redo(self) -> None:
        self._unless_locked(self._history.redo)

    def _unless_locked(self, step: Callable[[], None]) -> None:
        if self.locked:
            self._notice(tr(LOCKED), "")
        else:
            step()

    def save(self) -> None:
        """Request saving the current layout to the scenario file."""
        self._resetting = False
        tree = self._docks.tree
        if tree is not None:
            self._console.do(intents.SaveLayout(layout_text(tree), self._kind))

    def save_as(self, title: str) -> None:
        """Request a new scenario with the current layout."""
        tree = self._docks.tree
        if tree is not None:
            self._console.do(intents.SaveLayout(layout_text(tree), self._kind, title))

    def revert(self) -> None:
        """Restore the layout of the scenario file. Can be undone."""
        present = self._docks.arrangement
        if present is None or self._baseline is None:
            return
        self._note(tr("Revert"), present)
        self._file.save_working_copy(self._name, self._kind, self._file_tree(self._kind), None)
        self._touched = False
        self._board.show(arrangement_of(self._baseline_of(self._kind)))

    def put_back(self) -> None:
        """Restore the scenario's original layout, after another one was saved over it."""
        self._resetting = True
        present = self._docks.arrangement
        if present is not None:
            self._note(tr("Reset"), present)
        self._file.forget(self._name)
        self._console.do(intents.ResetLayout())
        self._show_scenario(self._console.scenario)
        self._console.do(intents.KeepLayout(layout_text(self._console.scenario.layout)))

    def soon(self, do: Callable[[], None]) -> Callable[[], None]:
        """Defer until the menu has closed: its actions belong to widgets that may be deleted."""
        return lambda: QTimer.singleShot(0, self, do)

    def _notice(self, what: str, meaning: str) -> None:
        self.noticed.emit(Problem(self._console.state.present.now_ns(), "info", what, meaning, ""))

    # ---- recording

    def begin_with(self, tree: LayoutNode) -> None:
        """Start recording from the layout of the scenario file.

        Actual panel sizes settle later and are not the wizard's edits.
        """
        self._of_scenario = tree
        self._begin_reporting()
        self._fit()

    def _begin_reporting(self) -> None:
        self._recorded = None
        self.rest.start()

    def record_layout(self) -> None:
        """Record the wizard's layout once it is idle."""
        if not self._docks.isVisible():
            self.rest.start()
            return
        tree, before = self._docks.tree, self._recorded
        self._recorded = tree
        if tree is None:
            return
        if before is None and self._of_scenario is not None:
            arranged = differs(tree, self._of_scenario, by=None)
        else:
            arranged = before is None or tree != before
        if arranged:
            self._console.do(intents.KeepLayout(layout_text(tree)))


_WORKING, _ASIDE, _LOCKED, _ADAPTS = "layout/working", "layout/working_aside", "layout/locked", "layout/adapts"
_log = logging.getLogger(__name__)


class LayoutFile:
    """Saved layouts of the current wizard, by scenario file and screen size class."""

    def __init__(self, values: WizardProfiles) -> None:
        self._values = values

    def working(self, scenario: str, kind: SizeClass) -> tuple[DockLayout, Any] | None:
        """The working copy and the layout of the file from which it was made, as data; None if there is none.

        Raises ValueError if it is unreadable; all saved layouts are then copied to another key for inspection.
        """
        text = str(self._values.value(_WORKING, "{}"))
        try:
            entry = _object(_object(json.loads(text)).get(scenario, {})).get(kind)
            return None if entry is None else (arrangement_from(_object(entry).get("arrangement")), entry.get("of"))
        except (ValueError, RecursionError) as error:
            _log.warning("the saved layouts of %s cannot be read, and are copied to %s", scenario, _ASIDE)
            self._values.set_value(_ASIDE, text)
            self._write(scenario, self._of_other_sizes(scenario, kind))
            raise ValueError(str(error)) from error

    def save_working_copy(
        self, scenario: str, kind: SizeClass, file_tree: LayoutNode, arrangement: DockLayout | None
    ) -> None:
        """Save a working copy; None if the layout equals the file's."""
        entries = self._of_other_sizes(scenario, kind)
        if arrangement is not None:
            entries[kind] = {"of": layout_data(file_tree), "arrangement": arrangement_data(arrangement)}
        if self._all().get(scenario, {}) != entries:
            self._write(scenario, entries)

    def forget(self, scenario: str) -> None:
        self._write(scenario, {})

    def _write(self, scenario: str, entries: dict[str, Any]) -> None:
        self._values.set_value(_WORKING, json.dumps(self._all() | {scenario: entries}))

    @property
    def adapts(self) -> bool:
        """Whether small and large screens get a layout of their own."""
        return str(self._values.value(_ADAPTS, "yes")) != "no"

    def set_adapts(self, adapts: bool) -> None:
        self._values.set_value(_ADAPTS, "yes" if adapts else "no")

    def is_locked(self, scenario: str) -> bool:
        return scenario in self._locked()

    def set_locked(self, scenario: str, locked: bool) -> None:
        names = [name for name in self._locked() if name != scenario]
        self._values.set_value(_LOCKED, json.dumps([*names, scenario] if locked else names))

    def _locked(self) -> list[str]:
        names = from_json(self._values.value(_LOCKED, "[]"))
        return [name for name in names if isinstance(name, str)] if isinstance(names, list) else []

    def _of_other_sizes(self, scenario: str, kind: SizeClass) -> dict[str, Any]:
        entries = self._all().get(scenario)
        return {name: each for name, each in entries.items() if name != kind} if isinstance(entries, dict) else {}

    def _all(self) -> dict[str, Any]:
        known = from_json(self._values.value(_WORKING, "{}"))
        return known if isinstance(known, dict) else {}


def _object(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError("it is not a JSON object")  # noqa: TRY004  (the caller expects one kind)
    return value
