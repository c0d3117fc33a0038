"""Floating window with one or more panels, on any screen."""

from collections.abc import Mapping

from PySide6.QtCore import Qt, QTimer, Signal
from PySide6.QtGui import QCloseEvent, QMoveEvent, QPainter, QPaintEvent, QResizeEvent
from PySide6.QtWidgets import QWidget

from caris_desktop.scenario.scenario_model import LayoutNode, PanelName
from caris_desktop.ui import layouts
from caris_desktop.ui.layout.dock import Dock
from caris_desktop.ui.layout.dock_area import DockArea, qrect
from caris_desktop.ui.layout.layout_rect import Rect
from caris_desktop.ui.tab_order import PanelWindow
from caris_desktop.ui.window_above import WindowAbove

_MARGIN_PX = 8
_SETTLES_MS = 400  # time for a window manager to add its frame


class FloatingWindow(PanelWindow, WindowAbove):
    """Tool window: stays above the main window and shares its key bindings."""

    moved_by_hand = Signal(object)  # Rect
    close_wanted = Signal()

    def __init__(self, docks: Mapping[PanelName, Dock], parent: QWidget) -> None:
        super().__init__(parent, Qt.WindowType.Tool)
        self.setObjectName("floating_panels")
        # Shown without activation when a popup closes or the scenario changes; a click activates it.
        self.setAttribute(Qt.WidgetAttribute.WA_ShowWithoutActivating)
        self.area = DockArea(docks, self)
        column = layouts.vbox(self, margins_px=_MARGIN_PX)
        column.addWidget(self.area)
        self._placed: Rect | None = None
        self._shown = False
        self._settling = QTimer(self, singleShot=True, interval=_SETTLES_MS)
        self._rest = QTimer(self, singleShot=True, interval=200)
        self._rest.timeout.connect(self._notify)

    def show_panels(self, tree: LayoutNode, shown: frozenset[PanelName], place: Rect) -> None:
        self.area.show_tree(tree, shown)
        self.setWindowTitle(
            " · ".join(self.area.docks[group.current].windowTitle() for group in self.area.placing.groups)
        )
        if place != self._placed:
            self._placed = place
            self._settling.start()
            self.setGeometry(qrect(place))
        self._shown = bool(shown)
        self.setVisible(self._shown and not self.is_back)

    def step_back(self, *, back: bool) -> None:
        super().step_back(back=back)
        self._settling.start()  # geometry changes by the window manager are not the wizard's
        if not back and self._placed is not None:
            self.setGeometry(qrect(self._placed))
        self.setVisible(self._shown and not back)

    def _on_geometry(self) -> None:
        if self.isVisible() and not self._settling.isActive():
            self._rest.start()

    def _notify(self) -> None:
        now = self.geometry()
        self._placed = Rect(now.x(), now.y(), now.width(), now.height())
        self.moved_by_hand.emit(self._placed)

    def moveEvent(self, event: QMoveEvent) -> None:
        super().moveEvent(event)
        self._on_geometry()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._on_geometry()

    def closeEvent(self, event: QCloseEvent) -> None:
        """The close button docks the panels. When the program quits, the window stays in the saved layout."""
        if event.spontaneous():
            event.ignore()
            self.close_wanted.emit()

    def paintEvent(self, _event: QPaintEvent) -> None:
        QPainter(self).fillRect(self.rect(), self.palette().window())
