"""The wizard's working copy of how the panels are arranged: kept, saved, reverted, undone, locked, recorded."""

from collections.abc import Callable
from dataclasses import field

from PySide6.QtCore import QObject, QTimer, Signal
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import intents
from caris_desktop.domain.events import Problem
from caris_desktop.domain.intents import SizeClass
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import dataclass
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.layout import layout_text, own_layout
from caris_desktop.scenario.model import LayoutNode, Scenario
from caris_desktop.ui.dock_host import LOCKED, DockHost
from caris_desktop.ui.layout import arrangement as edits
from caris_desktop.ui.layout.arrangement import Arrangement, arrangement_of
from caris_desktop.ui.layout.fitting import fitted, size_class
from caris_desktop.ui.layout.history import History
from caris_desktop.ui.layout.kept import KeptLayouts
from caris_desktop.ui.layout.tree import differs, panels_in, permitted, tidy, with_the_panels_of
from caris_desktop.ui.panel_board import PanelBoard
from caris_desktop.ui.wizard_profiles import WizardProfiles

LAYOUT_AT_REST_MS = 1000
_SAME_WEIGHT = 0.01  # a pixel here or there is no other arrangement
_NARROW_REPLAY_PX, _LOW_REPLAY_PX = 860, 300


@dataclass(frozen=True, slots=True)
class LayoutCommand:
    """What can be asked for, and whether it can be done now. ``action`` is the row of the table that does it too;
    ``id`` is the same in every language, and whatever it would undo.
    """

    text: str
    icon: str
    do: Callable[[], None]
    possible: bool = True
    action: str = ""
    id: str = field(kw_only=True)


class LayoutKeeper(QObject):
    """The wizard's working copy of an arrangement, apart from what the scenario's file says.

    There is one for each size of screen. It is kept with every change and comes back with the scenario; only saving
    puts it into the file. ``show_scenario`` shows the panels of a scenario as they are to be now.
    """

    title_wanted = Signal()  # whoever asks the wizard for one calls ``save_as`` with it
    noticed = Signal(object)  # Problem, to be told to the wizard
    changed = Signal()  # what can be saved, undone, ... is another thing now

    def __init__(
        self,
        docks: DockHost,
        board: PanelBoard,
        console: WizardConsole,
        wizards: WizardProfiles,
        show_scenario: Callable[[Scenario], None],
    ) -> None:
        super().__init__(docks)
        self._docks = docks
        self._board = board
        self._console = console
        self._kept = KeptLayouts(wizards)
        self._show_scenario = show_scenario
        self._told: LayoutNode | None = None
        self._of_scenario: LayoutNode | None = None
        self._in_replay = False
        self._borrowers: tuple[QWidget, ...] = ()
        self._kind: SizeClass = "usual"
        self._name = ""
        self._trees: dict[SizeClass, LayoutNode] = {}
        self._baseline: LayoutNode | None = None
        self._touched = False
        self._histories: dict[SizeClass, History] = {}
        self.rest = QTimer(self, singleShot=True, interval=LAYOUT_AT_REST_MS)
        self.rest.timeout.connect(self.tell)
        docks.layout_changed.connect(self.rest.start)
        docks.layout_changed.connect(self._on_layout_changed)
        docks.edited.connect(self._on_edited)
        docks.refused.connect(lambda why: self._notice(why, ""))
        docks.room_changed.connect(self._fit)
        wizards.changed.connect(self._on_wizard_changed)

    def lend_room_to(self, *strips: QWidget) -> None:
        """These come and go above the panels, which give way for them but are not arranged anew."""
        self._borrowers = strips

    @property
    def _height(self) -> int:
        """What the panels have of the screen, whatever stands above them for a while."""
        borrowed, width = 0, self._docks.window().width()
        for strip in self._borrowers:
            if not strip.isHidden():  # one that just comes has its size after the panels have theirs
                wraps = strip.hasHeightForWidth()
                borrowed += strip.heightForWidth(width) if wraps else strip.sizeHint().height()
        return self._docks.height() + borrowed

    def use_replay(self) -> None:
        """What is arranged in a replay is of no study, and its room is no screen's."""
        self._in_replay = True
        self._docks.set_locked(False)

    # ---- the working copy

    def begin(self, tree: LayoutNode) -> Arrangement:
        """The scenario's file says ``tree``; gives how the panels are to be arranged: as the wizard had them."""
        scenario = self._console.scenario
        name = scenario.path.name if scenario.path is not None else scenario.title
        trees = self._trees_of(scenario, tree)
        if (name, trees) != (self._name, self._trees):
            self._histories = {}
        self._name, self._trees = name, trees
        self._docks.set_locked(not self._in_replay and self._kept.is_locked(name))
        return self._load(self._kind_now())

    def _trees_of(self, scenario: Scenario, tree: LayoutNode) -> dict[SizeClass, LayoutNode]:
        """What the file says for each size of screen, of the same panels as its usual layout."""
        trees: dict[SizeClass, LayoutNode] = {"usual": tree}
        for kind in ("compact", "large"):
            own = own_layout(scenario, kind)
            if own is not None:
                trees[kind] = with_the_panels_of(tree, own)
        return trees

    def _kind_now(self) -> SizeClass:
        if self._in_replay:
            return "compact" if self._docks.width() < _NARROW_REPLAY_PX else "usual"
        if not self._kept.adapts or not self._docks.isVisible():
            return "usual"
        return size_class(self._docks.width(), self._height)

    def _baseline_of(self, kind: SizeClass) -> LayoutNode:
        """What the file says, as it is shown where the wizard has changed nothing."""
        if kind in self._trees:
            return tidy(self._trees[kind])
        # The panels of a replay are as high as the picture in them asks for, which depends on how they are arranged.
        height = _LOW_REPLAY_PX if self._in_replay and kind == "compact" else self._height
        return fitted(self._trees["usual"], self._docks.width(), height)

    def _file_tree(self, kind: SizeClass) -> LayoutNode:
        return self._trees.get(kind, self._trees["usual"])

    def _load(self, kind: SizeClass) -> Arrangement:
        self._kind, self._touched = kind, False
        self._baseline = baseline = self._baseline_of(kind)
        kept = None
        if not self._in_replay:
            try:
                kept = self._kept.working(self._name, kind, self._file_tree(kind))
            except ValueError:
                self._notice(
                    tr("Your arrangement of the panels could not be read."),
                    tr("They are arranged as the scenario says. A copy of what was kept is in the settings."),
                )
        mine = None if kept is None else self._possible(kept.arrangement)
        if kept is None or mine is None:
            return arrangement_of(baseline)
        if kept.of_another:
            self._kept.keep(self._name, kind, self._file_tree(kind), None)
            self._history.note(tr("The scenario’s new layout"), mine)
            self._notice(
                tr("The scenario has another layout than last time."),
                tr("Your own arrangement is not lost: Undo in the menu Layout brings it back."),
            )
            return arrangement_of(baseline)
        self._touched = True
        return mine

    def _possible(self, arrangement: Arrangement) -> Arrangement | None:
        """Without panels that the scenario does not offer; those that it shows and that are missing come along."""
        possible = self._board.possible()
        left = edits.remove(arrangement, [name for name in arrangement.panels if name not in possible])
        for name in panels_in(self._trees["usual"]):
            if left is not None and name not in left.panels:
                left = edits.add(left, name, ())
        return left

    def _fit(self) -> None:
        """The room is another one: so may be the arrangement, as long as the wizard made none for it."""
        if not self._trees or not self._docks.isVisible() or self._board.building:
            return  # once they stand, what is told of begins with another look
        kind = self._kind_now()
        if kind != self._kind:
            self._board.show(self._load(kind))
            self._begin_telling()
        elif not self._touched and kind not in self._trees:
            baseline = self._baseline_of(kind)
            if self._baseline is None or differs(baseline, self._baseline, by=_SAME_WEIGHT):
                self._baseline = baseline
                self._board.show(arrangement_of(baseline))
                self._begin_telling()

    def _on_edited(self, what: str, before: Arrangement) -> None:
        self._history.note(what, before)
        self._touched = True

    def _on_layout_changed(self) -> None:
        self._keep()
        self.changed.emit()

    def _keep(self) -> None:
        """With each change, so that no crash and no power cut takes it away."""
        arrangement = self._docks.arrangement
        if self._in_replay or not self._touched or arrangement is None or self._board.building:
            return
        own = self.is_unsaved or bool(arrangement.floating or arrangement.hidden)
        self._kept.keep(self._name, self._kind, self._file_tree(self._kind), arrangement if own else None)
        self._touched = own

    def follow(self, scenario: Scenario) -> None:
        """The scenario's file says something else now, and the panels stay as they are."""
        self._of_scenario = scenario.layout
        if self._trees:
            self._trees = self._trees_of(scenario, permitted(scenario.layout, self._board.possible()))
            self._baseline = self._baseline_of(self._kind)
            self._touched = True
            self._keep()
            self.changed.emit()

    def _on_wizard_changed(self) -> None:
        if self._trees and not self._in_replay:
            self._histories = {}
            self._docks.set_locked(self._kept.is_locked(self._name))
            self._board.show(self._load(self._kind_now()))

    # ---- what the menu offers

    @property
    def is_unsaved(self) -> bool:
        """Whether saving would change the file."""
        tree = self._docks.tree
        if tree is None or self._baseline is None:
            return False
        return differs(tree, self._baseline, by=_SAME_WEIGHT)

    @property
    def is_own(self) -> bool:
        """Whether the wizard arranged anything, be it for the file or not."""
        arrangement = self._docks.arrangement
        return self.is_unsaved or (arrangement is not None and bool(arrangement.floating or arrangement.hidden))

    @property
    def locked(self) -> bool:
        return self._docks.locked

    def set_locked(self, locked: bool) -> None:
        """For a study: nothing is moved, closed or floated until it is unlocked."""
        self._kept.set_locked(self._name, locked)
        self._docks.set_locked(locked)
        self.changed.emit()

    @property
    def adapts(self) -> bool:
        return self._kept.adapts

    def set_adapts(self, adapts: bool) -> None:
        """Whether a small or a large screen gets an arrangement of its own."""
        self._kept.set_adapts(adapts)
        self._fit()

    @property
    def kind(self) -> SizeClass:
        return self._kind

    @property
    def _history(self) -> History:
        return self._histories.setdefault(self._kind, History())

    def commands(self) -> tuple[LayoutCommand, ...]:
        """For menu and palette alike."""
        undo = tr("Undo: {what}").format(what=self._history.undoes) if self._history.undoes else tr("Undo")
        redo = tr("Redo: {what}").format(what=self._history.redoes) if self._history.redoes else tr("Redo")
        free, live = not self.locked, not self._in_replay
        return (
            LayoutCommand(
                undo, "arrow-u-up-left", self.undo, bool(self._history.undoes) and free, "layout_undo", id="Undo"
            ),
            LayoutCommand(redo, "arrow-u-up-right", self.redo, bool(self._history.redoes) and free, id="Redo"),
            *(
                LayoutCommand(tr(text), icon, do, possible, id=text)
                for text, icon, do, possible in (
                    (QT_TR_NOOP("Save into the scenario"), "floppy-disk", self.save, self.is_unsaved and live),
                    (QT_TR_NOOP("Save as another scenario…"), "floppy-disk", self.title_wanted.emit, live),
                    (
                        QT_TR_NOOP("Revert to the scenario’s layout"),
                        "arrow-counter-clockwise",
                        self.revert,
                        self.is_own,
                    ),
                    (QT_TR_NOOP("Reset: as the scenario came"), "layout", self.put_back, True),
                )
            ),
        )

    def undo(self) -> None:
        self._step(self._history.undo)

    def redo(self) -> None:
        self._step(self._history.redo)

    def _step(self, step: Callable[[Arrangement], Arrangement | None]) -> None:
        present = self._docks.arrangement
        if self.locked:
            self._notice(tr(LOCKED), "")
        elif present is not None and (before := step(present)) is not None:
            self._touched = True
            self._board.show(self._possible(before) or before)

    def save(self) -> None:
        """Ask for the present arrangement to be saved as the scenario's."""
        tree = self._docks.tree
        if tree is not None:
            self._console.do(intents.SaveLayout(layout_text(tree), self._kind))

    def save_as(self, title: str) -> None:
        """Ask for another scenario, which has the present arrangement."""
        tree = self._docks.tree
        if tree is not None:
            self._console.do(intents.SaveLayout(layout_text(tree), self._kind, title))

    def revert(self) -> None:
        """The panels lie as the scenario's file says. This can be undone."""
        present = self._docks.arrangement
        if present is None or self._baseline is None:
            return
        self._history.note(tr("Revert"), present)
        self._kept.keep(self._name, self._kind, self._file_tree(self._kind), None)
        self._touched = False
        self._board.show(arrangement_of(self._baseline_of(self._kind)))

    def put_back(self) -> None:
        """The scenario gets its own arrangement back, where another one was saved in its place."""
        present = self._docks.arrangement
        if present is not None:
            self._history.note(tr("Reset"), present)
        self._kept.forget(self._name)
        self._console.do(intents.ResetLayout())
        self._show_scenario(self._console.scenario)
        self._console.do(intents.KeepLayout(layout_text(self._console.scenario.layout)))

    def soon(self, do: Callable[[], None]) -> Callable[[], None]:
        """After the menu has closed: its own actions belong to what goes away."""
        return lambda: QTimer.singleShot(0, self, do)

    def _notice(self, what: str, meaning: str) -> None:
        self.noticed.emit(Problem(self._console.state.present.now_ns(), "info", what, meaning, ""))

    # ---- for the record

    def begin_with(self, tree: LayoutNode) -> None:
        """The scenario's file arranges the panels like this.

        How much room each panel really gets is seen once they are at rest; that is not the wizard's doing.
        """
        self._of_scenario = tree
        self._begin_telling()
        self._fit()

    def _begin_telling(self) -> None:
        self._told = None
        self.rest.start()

    def tell(self) -> None:
        """For the record: how the wizard has arranged the panels, once they are at rest."""
        if not self._docks.isVisible():
            self.rest.start()
            return
        tree, before = self._docks.tree, self._told
        self._told = tree
        if tree is None:
            return
        if before is None and self._of_scenario is not None:
            arranged = differs(tree, self._of_scenario, by=None)
        else:
            arranged = before is None or tree != before
        if arranged:
            self._console.do(intents.KeepLayout(layout_text(tree)))
