"""How the panels are arranged and where the window lies: told to the record, saved, put back, restored."""

from collections.abc import Callable
from typing import Any, Protocol

from PySide6.QtCore import QObject, QSize, QTimer, Signal
from PySide6.QtWidgets import QWidget

from caris_desktop.domain import intents
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.scenario.layout import layout_text
from caris_desktop.scenario.model import LayoutNode, Scenario, SplitNode
from caris_desktop.ui.dock_host import DockHost

LAYOUT_AT_REST_MS = 1000
WINDOW_FRAME = QSize(16, 48)  # what a window manager may put around a window
_SAME_WEIGHT = 0.01  # a pixel here or there is no other arrangement
_ROOMY = QSize(1680, 1000)


class Settings(Protocol):
    """What the window needs of QSettings."""

    def value(self, key: str, defaultValue: Any = None) -> Any: ...  # noqa: N803

    def setValue(self, key: str, value: Any) -> None: ...


class LayoutKeeper(QObject):
    """Tells how the wizard arranged the panels, and saves an arrangement or gives the scenario its own one back.

    ``show_scenario`` builds the panels of a scenario anew.
    """

    save_requested = Signal(object)  # LayoutNode
    reset_requested = Signal()

    def __init__(self, docks: DockHost, console: WizardConsole, show_scenario: Callable[[Scenario], None]) -> None:
        super().__init__(docks)
        self._docks = docks
        self._console = console
        self._show_scenario = show_scenario
        self._told: LayoutNode | None = None
        self._of_scenario: LayoutNode | None = None
        self.rest = QTimer(self, singleShot=True, interval=LAYOUT_AT_REST_MS)
        self.rest.timeout.connect(self.tell)
        docks.layout_changed.connect(self.rest.start)

    def begin_with(self, tree: LayoutNode) -> None:
        """The scenario arranged the panels like this.

        How much room each panel really gets is seen once they are at rest; that is not the wizard's doing.
        """
        self._told, self._of_scenario = None, tree
        self.rest.start()

    def tell(self) -> None:
        """For the record: how the wizard has arranged the panels, once they are at rest."""
        if not self._docks.isVisible():
            self.rest.start()
            return
        tree, before = self._docks.read_layout(), self._told
        self._told = tree
        if tree is None:
            return
        if before is None and self._of_scenario is not None:
            arranged = _differs(tree, self._of_scenario, by=None)
        else:
            arranged = before is None or _differs(tree, before, by=_SAME_WEIGHT)
        if arranged:
            self._console.do(intents.KeepLayout(layout_text(tree)))

    def save(self) -> None:
        """Ask for the present arrangement to be saved as the scenario's."""
        tree = self._docks.tree
        if tree is not None:
            self.save_requested.emit(tree)

    def put_back(self) -> None:
        """Whoever listens gives the scenario its own arrangement back, where another one was saved in its place."""
        self.reset_requested.emit()
        self._show_scenario(self._console.scenario)
        self._console.do(intents.KeepLayout(layout_text(self._console.scenario.layout)))

    def put_back_soon(self) -> None:
        """After the menu has closed: its own actions belong to the docks that go away."""
        QTimer.singleShot(0, self, self.put_back)


class WindowPlace:
    """Where the window lies on the screen, from one run to the next."""

    def __init__(self, window: QWidget, settings: Settings | None) -> None:
        self._window = window
        self._settings = settings
        self._key = "window/geometry"
        self._fills_screen = False

    def use_replay(self) -> None:
        """A replay has a place of its own."""
        self._key = "replay/geometry"
        if self._settings is not None:
            self.restore()

    def restore(self) -> None:
        window = self._window
        geometry = self._settings.value(self._key) if self._settings is not None else None
        if geometry:
            window.restoreGeometry(geometry)
        else:
            window.resize(_ROOMY)
        room = window.screen().availableSize() - WINDOW_FRAME
        # A window taller than its screen hides the status bar below the edge, title bar included.
        window.resize(window.size().boundedTo(room))
        self._fills_screen = not geometry and window.size() != _ROOMY

    def show(self) -> None:
        """Show it where it was last time. The first time it fills a small screen, where every pixel is needed."""
        if self._fills_screen:
            self._window.showMaximized()
        else:
            self._window.show()

    def keep(self) -> None:
        if self._settings is not None:
            self._settings.setValue(self._key, self._window.saveGeometry())


def _differs(tree: LayoutNode, other: LayoutNode, *, by: float | None) -> bool:
    """Whether panels lie elsewhere, or have a share of the window that is another one ``by`` more than this."""
    if isinstance(tree, SplitNode) and isinstance(other, SplitNode):
        if (tree.split, len(tree.children)) != (other.split, len(other.children)):
            return True
        shares = zip(_shares(tree), _shares(other), strict=True)
        if by is not None and any(abs(before - after) > by for before, after in shares):
            return True
        return any(_differs(*children, by=by) for children in zip(tree.children, other.children, strict=True))
    return tree != other


def _shares(node: SplitNode) -> list[float]:
    return [weight / sum(node.weights) for weight in node.weights]
