"""Dock area widget: shows a layout tree as docks, tab bars and split handles."""

from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from PySide6.QtCore import QPoint, QRect, QSize, Qt, Signal
from PySide6.QtGui import QContextMenuEvent, QMouseEvent, QResizeEvent
from PySide6.QtWidgets import QMenu, QPushButton, QTabBar, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.scenario.scenario_model import LayoutNode, PanelName
from caris_desktop.ui.focus_widget import Bar
from caris_desktop.ui.layout.dock import Dock, DockRequests
from caris_desktop.ui.layout.dock_geometry import DockGeometry, GroupPlace, Handle, dragged, place
from caris_desktop.ui.layout.layout_rect import Rect

_Part = TypeVar("_Part", bound=QWidget)
_LEAST = QSize(320, 200)
_MORE_PX = 34
_TAB_DRAG_FACTOR = 2  # a click on a tab that slips is not a drag


class DockArea(QWidget):
    """Lays out ``docks``; reports the wizard's edits to the owner of the whole layout."""

    laid_out = Signal()
    resized_by_hand = Signal(object, object, bool)  # path, weights, whether the handle was released

    def __init__(
        self, docks: Mapping[PanelName, Dock], requests: DockRequests | None, parent: QWidget | None = None
    ) -> None:
        super().__init__(parent)
        self.docks = docks
        self.requests = requests if requests is not None else DockRequests(self)
        self.whole_tree: LayoutNode | None = None
        self.locked = False
        self._visible: frozenset[PanelName] = frozenset()
        self.placing = DockGeometry()
        self._bars: list[PanelTabs] = []
        self._handles: list[SplitHandle] = []

    def minimumSizeHint(self) -> QSize:
        return _LEAST

    def show_tree(self, tree: LayoutNode | None, visible: frozenset[PanelName]) -> None:
        """Show the ``visible`` panels of the tree; each has a dock."""
        for name in visible:
            dock = self.docks[name]
            if dock.parentWidget() is not self:
                self._adopt(dock)
        self.whole_tree, self._visible = tree, visible
        self.lay_out()

    def _adopt(self, dock: Dock) -> None:
        """Take a dock from another window."""
        dock.setParent(self)
        dock.lower()  # below popups

    def lay_out(self) -> None:
        tree = self.whole_tree
        rect = Rect(0, 0, self.width(), self.height())
        self.placing = DockGeometry() if tree is None else place(tree, rect, self._visible, self._least)
        tabbed = [group for group in self.placing.groups if group.tabbed]
        _match(self._bars, len(tabbed), self._new_bar)
        for bar, group in zip(self._bars, tabbed, strict=True):
            bar.show_group(group, [self.docks[name].windowTitle() for name in group.panels])
        _match(self._handles, len(self.placing.handles), self._new_handle)
        for widget, handle in zip(self._handles, self.placing.handles, strict=True):
            widget.show_handle(handle, locked=self.locked)
        for group in self.placing.groups:
            for name in group.panels:
                dock = self.docks[name]
                dock.titleBarWidget().set_tabbed(group.tabbed)
                if name == group.current:
                    dock.setGeometry(qrect(group.body))
                    dock.fit()  # its minimum may have changed
                dock.set_shown(name == group.current)
        self.laid_out.emit()

    def leave_room(self, tree: LayoutNode | None, visible: frozenset[PanelName]) -> None:
        """Like :meth:`show_tree` for a reduced tree, but deferred to the next layout: nothing moves yet, and only the
        tabs of removed panels disappear.
        """
        self.whole_tree, self._visible = tree, visible
        for bar in [bar for bar in self._bars if not visible.issuperset(bar.panels)]:
            self._bars.remove(bar)
            bar.hide()
            bar.deleteLater()

    def _least(self, name: PanelName) -> tuple[int, int]:
        return self.docks[name].least()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.lay_out()

    def retitle(self) -> None:
        """Update the tab titles."""
        for bar in self._bars:
            bar.show_titles([self.docks[name].windowTitle() for name in bar.panels])

    # ---- tabs and split handles

    def _new_bar(self) -> "PanelTabs":
        bar = PanelTabs(self.requests, self)
        bar.show()
        bar.lower()
        return bar

    def _new_handle(self) -> "SplitHandle":
        handle = SplitHandle(self)
        handle.moved.connect(self._on_handle_moved)
        handle.show()
        handle.lower()
        return handle

    def _on_handle_moved(self, handle: Handle, moved_px: int, let_go: bool) -> None:
        if self.whole_tree is not None:
            self.resized_by_hand.emit(handle.path, dragged(self.whole_tree, handle, moved_px), let_go)

    @property
    def bars(self) -> Sequence["PanelTabs"]:
        return self._bars


def _match(parts: list[_Part], count: int, new: Callable[[], _Part]) -> None:
    """Adjust the number of widgets, reusing existing ones."""
    while len(parts) > count:
        part = parts.pop()
        part.hide()
        part.deleteLater()
    while len(parts) < count:
        parts.append(new())


def qrect(rect: Rect) -> QRect:
    return QRect(rect.left, rect.top, rect.width, rect.height)


class PanelTabs(Bar, QTabBar):
    """Tab bar of a group. Dragging a tab moves that panel only."""

    def __init__(self, requests: DockRequests, parent: QWidget) -> None:
        super().__init__(parent)
        self._requests = requests
        self.panels: tuple[PanelName, ...] = ()
        self.setExpanding(False)
        self.setDrawBase(False)
        # Tabs that do not fit are in a list at the end: "D…" or half a tab identifies no panel.
        self.setElideMode(Qt.TextElideMode.ElideNone)
        self.setUsesScrollButtons(False)
        self._more = QPushButton("»", self)
        self._more.setObjectName("more_tabs")
        self._more.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        self._more.clicked.connect(self._open_more)
        self._more.hide()
        self.setAccessibleName(tr("Panels in tabs"))
        self.currentChanged.connect(self._on_current_changed)

    def show_group(self, group: GroupPlace, titles: Sequence[str]) -> None:
        blocked = self.blockSignals(True)
        if group.panels != self.panels:
            self.panels = group.panels
            while self.count():
                self.removeTab(0)
            for title in titles:
                self.addTab(title)
        self.show_titles(titles)
        self.setCurrentIndex(group.panels.index(group.current))
        self.setGeometry(qrect(group.tab_bar))
        self._show_what_fits()
        self.blockSignals(blocked)

    def _show_what_fits(self) -> None:
        """Show as many whole tabs as fit, always including the current one; the list has the others."""
        for index in range(self.count()):
            self.setTabVisible(index, True)
        widths = [self.tabSizeHint(index).width() for index in range(self.count())]
        if sum(widths) <= self.width():
            self._more.hide()
            return
        room = self.width() - _MORE_PX - widths[self.currentIndex()]
        for index in (index for index in range(self.count()) if index != self.currentIndex()):
            room -= widths[index]
            self.setTabVisible(index, room >= 0)
        self._more.setGeometry(self.width() - _MORE_PX, 2, _MORE_PX, self.height() - 6)
        words = tr("More tabs: {names}").format(names=", ".join(self.tabText(index) for index in self._in_list()))
        self._more.setToolTip(words)
        self._more.setAccessibleName(words)
        self._more.show()

    def _in_list(self) -> list[int]:
        return [index for index in range(self.count()) if not self.isTabVisible(index)]

    def _open_more(self) -> None:
        menu = QMenu(self)
        menu.setObjectName("more_tabs_menu")
        menu.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        for index in self._in_list():
            # By name: this bar may show other panels once the menu has closed.
            menu.addAction(self.tabText(index)).triggered.connect(
                lambda _checked, name=self.panels[index]: self._requests.tab_clicked.emit(name)
            )
        menu.popup(self._more.mapToGlobal(self._more.rect().bottomLeft()))

    def minimumTabSizeHint(self, index: int) -> QSize:
        return self.tabSizeHint(index)

    def show_titles(self, titles: Sequence[str]) -> None:
        for index, title in enumerate(titles):
            if self.tabText(index) != title:
                self.setTabText(index, title)

    def place_of(self, at: QPoint, panel: PanelName) -> int:
        """Tab index for a drop at this point, not counting the panel itself."""
        others = [i for i, name in enumerate(self.panels) if name != panel and self.isTabVisible(i)]
        return sum(self.tabRect(index).center().x() < at.x() for index in others)

    def _on_current_changed(self, index: int) -> None:
        if 0 <= index < len(self.panels):
            self._requests.tab_chosen.emit(self.panels[index])

    def mousePressEvent(self, event: QMouseEvent) -> None:
        index = self.tabAt(event.position().toPoint())
        pressed = self.panels[index] if event.button() == Qt.MouseButton.LeftButton and index >= 0 else None
        super().mousePressEvent(event)
        if pressed is not None:
            self._requests.press(pressed, event, times_start_distance=_TAB_DRAG_FACTOR)
            self._requests.tab_clicked.emit(pressed)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        self._requests.move(event)

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        super().mouseReleaseEvent(event)
        self._requests.release(event)

    def contextMenuEvent(self, event: QContextMenuEvent) -> None:
        index = self.tabAt(event.pos())
        if index >= 0:
            self._requests.menu_requested.emit(self.panels[index], event.globalPos())


class SplitHandle(QWidget):
    """Split handle between two parts."""

    moved = Signal(object, int, bool)  # Handle at the press, offset in px, whether it was released

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self.setObjectName("split_handle")
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self._handle: Handle | None = None
        self._from: tuple[Handle, int] | None = None

    def show_handle(self, handle: Handle, *, locked: bool) -> None:
        self._handle = handle
        self.setGeometry(qrect(handle.rect))
        self.setEnabled(not locked)
        shape = Qt.CursorShape.SplitHCursor if handle.split == "horizontal" else Qt.CursorShape.SplitVCursor
        self.setCursor(Qt.CursorShape.ArrowCursor if locked else shape)

    def _position(self, event: QMouseEvent, handle: Handle) -> int:
        at = event.globalPosition()
        return round(at.x() if handle.split == "horizontal" else at.y())

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and self._handle is not None:
            self._from = (self._handle, self._position(event, self._handle))

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        if self._from is not None:
            handle, start = self._from
            self.moved.emit(handle, self._position(event, handle) - start, False)

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if self._from is not None:
            (handle, start), self._from = self._from, None
            self.moved.emit(handle, self._position(event, handle) - start, True)
