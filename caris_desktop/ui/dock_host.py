"""Dock area: shows the dock layout in the main window and in floating windows, and applies the wizard's edits.

Panels are not QDockWidgets: QMainWindow exposes dock positions only, so the layout tree had to be guessed from
rectangles, sizes drifted with each save and restore, and Qt versions differed in whether one tab or all tabs were
undocked. Here the layout value is the single source of truth, and the widgets follow from it. Nor are they in nested
QSplitters, whose parents change with each edit: moving seven docks into others blocked the GUI thread for 71 ms, as Qt
restyles all children, instead of 0.7 ms.
"""

from collections import deque
from collections.abc import Callable, Container, Mapping, Sequence
from functools import partial

from PySide6.QtCore import QEvent, QPoint, QRect, QSize, Qt, QTimer, Signal
from PySide6.QtGui import QCloseEvent, QGuiApplication, QResizeEvent, QShowEvent
from PySide6.QtWidgets import QApplication, QFrame, QLabel, QMenu, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.scenario.scenario_model import LayoutNode, PanelLeaf, PanelName, panels_in
from caris_desktop.ui import dock_layout as edits
from caris_desktop.ui import layouts
from caris_desktop.ui.dock_area import Dock, DockArea, DockRequests
from caris_desktop.ui.dock_geometry import COMFORT, Drop, drop_at, grown
from caris_desktop.ui.dock_layout import DockLayout, Side, on_a_screen
from caris_desktop.ui.focus_widget import PanelWindow, focus_widget, focused_widget
from caris_desktop.ui.panel import Panel
from caris_desktop.ui.window_place import WindowAbove

_FLOATING: tuple[int, int] = (480, 360)
_CASCADE_PX, _MARGIN_PX = 36, 8
_BESIDE_POINTER = QPoint(16, 18)
_SETTLES_MS = 400  # time for a window manager to add its frame
_LEAVE_MS = 1
RESIZE_PX = 48
"""Step in px of resizing by keyboard."""
LOCKED = QT_TR_NOOP("The layout is locked, so nothing was moved. Unlock it in the Layout menu.")


class FloatingWindow(PanelWindow, WindowAbove):
    """Floating window with one or more panels, on any screen.

    Tool window: stays above the main window and shares its key bindings.
    """

    moved_by_hand = Signal(object)  # Rect
    close_requested = Signal()

    def __init__(self, docks: dict[PanelName, Dock], requests: DockRequests, parent: QWidget) -> None:
        super().__init__(parent, Qt.WindowType.Tool)
        self.setObjectName("floating_panels")
        # Shown without activation when a popup closes or the scenario changes; a click activates it.
        self.setAttribute(Qt.WidgetAttribute.WA_ShowWithoutActivating)
        self.area = DockArea(docks, requests, self)
        layouts.vbox(self, self.area, margins_px=_MARGIN_PX)
        self._placed: QRect | None = None
        self._settling = QTimer(self, singleShot=True, interval=_SETTLES_MS)
        self._rest = QTimer(self, singleShot=True, interval=200)
        self._rest.timeout.connect(self._notify)

    def show_panels(self, tree: LayoutNode, visible: frozenset[PanelName], place: QRect) -> None:
        self.area.show_tree(tree, visible)
        titles = [self.area.docks[group.current].windowTitle() for group in self.area.placing.groups]
        self.setWindowTitle(" · ".join(titles))
        if place != self._placed:
            self._placed = place
            self._settling.start()
            self.setGeometry(place)
        self.setVisible(bool(visible) and not self.is_back)

    def step_back(self, *, back: bool) -> None:
        super().step_back(back=back)
        self._settling.start()  # geometry changes by the window manager are not the wizard's
        if not back and self._placed is not None:
            self.setGeometry(self._placed)
        self.setVisible(bool(self.area.placing.groups) and not back)

    def _notify(self) -> None:
        self._placed = self.geometry()
        self.moved_by_hand.emit(self._placed)

    def event(self, event: QEvent) -> bool:
        by_hand = self.isVisible() and not self._settling.isActive()
        if by_hand and event.type() in (QEvent.Type.Move, QEvent.Type.Resize):
            self._rest.start()
        return super().event(event)

    def closeEvent(self, event: QCloseEvent) -> None:
        """The close button docks the panels. When the program quits, the window stays in the saved layout."""
        if event.spontaneous():
            event.ignore()
            self.close_requested.emit()


class DockHost(DockArea):
    """Dock area of the main window. ``edited``: an edit by the wizard, with the layout before it; ``layout_changed``:
    any change; ``refused``: the reason for a refused edit.
    """

    edited = Signal(str, object)
    layout_changed = Signal()
    refused = Signal(str)
    room_changed = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__({}, DockRequests(), parent)
        self.setObjectName("dock_host")
        self.arrangement: DockLayout | None = None
        self._windows: list[FloatingWindow] = []
        self._drop_mark = QFrame(self)
        self._drop_mark.setObjectName("drop_mark")
        self._drop_mark.hide()
        self._drop_mark.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        self._drag_words = DragWords(self)
        self.screens: Callable[[], Sequence[QRect]] = available_screens
        self._before_resize: DockLayout | None = None
        self._leaving: deque[Dock] = deque()
        self._leave = QTimer(self, interval=_LEAVE_MS)
        self._leave.timeout.connect(self._delete_next)
        self.resized_by_hand.connect(partial(self._on_resized_by_hand, None))
        requests = self.requests
        requests.tab_chosen.connect(self._on_tab_chosen)
        requests.tab_clicked.connect(self._go_to)
        requests.float_requested.connect(self.toggle_floating)
        requests.menu_requested.connect(self._open_menu)
        requests.drag_moved.connect(self._on_drag_moved)
        requests.drag_dropped.connect(self._on_drag_dropped)
        app = QGuiApplication.instance()
        if isinstance(app, QGuiApplication):
            app.screenAdded.connect(self.show_everything)
            app.screenRemoved.connect(self.show_everything)

    # ---- display

    @property
    def tree(self) -> LayoutNode | None:
        """The layout as saved to a file, without closed panels."""
        return None if self.arrangement is None else self.arrangement.for_file

    def _delete_next(self) -> None:
        if self._leaving:
            self._leaving.popleft().deleteLater()
        else:
            self._leave.stop()

    def show_arrangement(self, panels: Mapping[PanelName, Panel], arrangement: DockLayout) -> None:
        """Show ``panels`` in this layout. Existing panels are reused, even if the layout hides them; others are
        deleted.
        """
        self.drop_all_but(panels)
        for name in arrangement.panels:
            if name not in self.docks:
                self._make_dock(name, panels[name])
        self.arrangement = arrangement
        self.show_everything()
        self.layout_changed.emit()
        self._leave.start()

    def leave_gaps(self, panels: Mapping[PanelName, Panel], visible: Container[PanelName]) -> None:
        """Like :meth:`drop_all_but`, and hide all panels but ``visible``. Hidden panels leave an empty area without a
        tab until the next layout; visible ones do not move.
        """
        unseen = [name for name in self.docks if name not in visible]
        afloat = any(self.docks[name].floating for name in unseen)
        self.drop_all_but(panels)
        if self.arrangement is not None:
            self.arrangement = edits.remove(self.arrangement, unseen)
        if self.arrangement is None or afloat:
            self.show_everything()
        else:
            self.whole_tree, self._visible = self.arrangement.tree, self.arrangement.docked
            for bar in [bar for bar in self.bars if not self._visible.issuperset(bar.panels)]:
                self.bars.remove(bar)
                layouts.discard(bar)
        for name, dock in self.docks.items():
            if name not in visible:
                dock.set_shown(False)

    def drop_all_but(self, panels: Mapping[PanelName, Panel]) -> None:
        """Delete all other panels; the layout follows afterwards. One panel is deleted per event loop turn, so that a
        scenario change does not block the GUI thread.
        """
        removed = [name for name, dock in self.docks.items() if panels.get(name) is not dock.panel]
        if self.arrangement is not None:
            self.arrangement = edits.remove(self.arrangement, removed)
        for name in removed:
            self._forget(name)

    def make_room(self, name: PanelName, panel: Panel) -> None:
        """Create a hidden dock for the next layout, or replace the placeholder of this panel."""
        old, dock = self.docks.get(name), self._make_dock(name, panel)
        if old is None:
            return
        if old.isVisible() or old.floating or dock.least() != old.least():
            self.show_everything()
        else:
            dock.set_place(floating=False, locked=self.locked)
            dock.set_shown(False)
        old.hide()
        self._leaving.append(old)
        self._leave.start()

    def add_panel(self, name: PanelName, panel: Panel, beside: Sequence[PanelName] = ()) -> None:
        """Add a panel as the front tab next to the first open panel of ``beside``, else next to any open one."""
        if self.arrangement is None:
            self.show_arrangement({name: panel}, DockLayout(PanelLeaf(name)))
            return
        if name not in self.docks:
            self._make_dock(name, panel)
        self._do(tr("Open {panel}").format(panel=panel.title), edits.add(self.arrangement, name, beside))

    def is_open(self, name: PanelName) -> bool:
        """Whether the panel is open, even if behind another tab."""
        return self.arrangement is not None and self.arrangement.is_shown(name)

    def _forget(self, name: PanelName) -> None:
        dock = self.docks.pop(name)
        dock.hide()
        if dock.floating:
            dock.setParent(self)  # its window may be deleted before
        self._leaving.append(dock)

    def _make_dock(self, name: PanelName, panel: Panel) -> Dock:
        # Created with a parent: otherwise it briefly is a top-level window and takes the activation.
        dock = self.docks[name] = Dock(name, panel, self.requests, self)
        dock.lower()
        dock.hide()
        panel.title_changed.connect(self.retitle)
        return dock

    def show_everything(self) -> None:
        """Apply the layout on the current screens. A focused widget stays focused as long as it is visible."""
        focused = focused_widget() if self._panel_of(focused_widget()) is not None else None
        self._show_arranged()
        if focused is not None and focused.isVisible() and not focused.hasFocus():
            focus_widget(focused, Qt.FocusReason.OtherFocusReason)

    def _show_arranged(self) -> None:
        arrangement = self.arrangement
        floating = () if arrangement is None else edits.clamped(arrangement, self.screens()).floating
        for window in self._windows[len(floating) :]:
            for dock in self.docks.values():
                if dock.parentWidget() is window.area:
                    self.adopt(dock)
        layouts.adjust_count(self._windows, len(floating), self._new_window)
        if arrangement is None:
            self.show_tree(None, frozenset())
            return
        for name, dock in self.docks.items():
            if name in arrangement.panels:
                dock.set_place(floating=name in arrangement.afloat, locked=self.locked)
            if not arrangement.is_shown(name):
                dock.set_shown(False)
        self.show_tree(arrangement.tree, arrangement.docked)
        # The stored layout stays unchanged: the other screen may be connected again later.
        for window, target in zip(self._windows, floating, strict=True):
            window.area.locked = self.locked
            window.show_panels(target.tree, frozenset(panels_in(target.tree)) - arrangement.hidden, target.place)

    def _new_window(self) -> FloatingWindow:
        window = FloatingWindow(self.docks, self.requests, self)
        index = len(self._windows)
        window.area.resized_by_hand.connect(partial(self._on_resized_by_hand, index))
        window.moved_by_hand.connect(partial(self._on_window_moved, index))
        window.close_requested.connect(partial(self._dock_all_of, index))
        return window

    def retitle(self) -> None:
        """Update the tab titles."""
        for bar in (bar for area in self._areas for bar in area.bars):
            bar.show_titles()

    @property
    def _areas(self) -> tuple[DockArea, ...]:
        """Floating windows first, the top one of them before the others."""
        return (*(window.area for window in reversed(self._windows)), self)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.room_changed.emit()

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        self.room_changed.emit()

    # ---- editing

    def set_locked(self, locked: bool) -> None:
        """Lock or unlock the layout: locked panels cannot be moved, closed or floated."""
        if locked != self.locked:
            self.locked = locked
            self.show_everything()

    def edit(self, description: str, after: DockLayout | None) -> bool:
        """Apply the wizard's edit ``description``; returns whether it was applied."""
        if after is None or after == self.arrangement:
            return False
        if self.locked:
            self.refused.emit(tr(LOCKED))
            return False
        self._do(description, after)
        return True

    def _change(
        self,
        description: str,
        name: PanelName,
        change: Callable[..., DockLayout | None],
        *arguments: object,
        focus: bool = False,
    ) -> bool:
        """Apply the ``change`` of one panel, whose title goes into ``description``, and focus the panel if it is to
        have the keys then. Returns whether it was applied.
        """
        if self.arrangement is None or name not in self.arrangement.panels:
            return False
        after = change(self.arrangement, name, *arguments)
        changed = self.edit(description.format(panel=self._title(name)), after)
        if changed and focus:
            self._go_to(name)
        return changed

    def panel_with_keys(self) -> PanelName | None:
        """The focused panel of the active window, else of the main window."""
        windows = [QApplication.activeWindow(), self.window()]
        found = [self._panel_of(window.focusWidget()) for window in windows if window is not None]
        return next(filter(None, found), None)

    def _panel_of(self, widget: QWidget | None) -> PanelName | None:
        """The panel whose dock has the widget inside."""
        if widget is None:
            return None
        return next((name for name, dock in self.docks.items() if dock.isAncestorOf(widget)), None)

    def _go_to(self, name: PanelName) -> None:
        """Raise the panel's tab and focus its main field."""
        self._on_tab_chosen(name)
        if self.docks[name].isVisible():
            focus_widget(self.docks[name].focus_target(), Qt.FocusReason.MouseFocusReason)

    def _do(self, description: str, after: DockLayout) -> None:
        """Show the layout; with a ``description`` as an edit that can be undone."""
        before, self.arrangement = self.arrangement, after
        self.show_everything()
        if description:
            self.edited.emit(description, before)
        self.layout_changed.emit()

    def close_panel(self, name: PanelName, *, remove: bool = False) -> bool:
        """Hide the panel, which ``show_panel`` restores at the same place, or ``remove`` and delete it; returns whether
        that was done. The focus moves from it to the panel that becomes visible in its place, unless bare keys would
        drive there.
        """
        if not remove and not self.is_open(name):
            return False
        had_focus = self._panel_of(focused_widget()) == name
        group = next((found for area in self._areas if (found := area.placing.group_of(name)) is not None), None)
        change = (lambda layout, name: edits.remove(layout, (name,))) if remove else edits.hide
        closed = self._change(tr("Close {panel}"), name, change)
        others = group.panels if closed and had_focus and group is not None else ()
        visible = next((other for other in others if other != name and self.docks[other].isVisible()), None)
        if visible is not None and not self.docks[visible].panel.drives:
            self._go_to(visible)
        if closed and remove:
            self._forget(name)
            self._leave.start()
        return closed

    def show_panel(self, name: PanelName) -> None:
        """Open the panel if it is closed, and raise its tab."""
        arrangement = self.arrangement
        if arrangement is None or name not in arrangement.panels:
            return
        if not arrangement.is_shown(name):
            self._do(tr("Open {panel}").format(panel=self._title(name)), edits.show(arrangement, name))
        else:
            self._on_tab_chosen(name)

    def float_panel(self, name: PanelName, place: QRect | None = None) -> None:
        """Float the panel in a separate window: at ``place``, or near its current position."""
        if place is None and name in self.docks:
            dock = self.docks[name]
            at = dock.mapToGlobal(QPoint(_CASCADE_PX, _CASCADE_PX))
            place = QRect(at, dock.size().expandedTo(QSize(*COMFORT.get(name, _FLOATING))))
        if place is not None:
            on_screen = on_a_screen(place, self.screens())
            self._change(tr("Float {panel}"), name, edits.float_panel, on_screen, focus=True)

    def dock_panel(self, name: PanelName) -> None:
        """Dock a floating panel where it was before."""
        self._change(tr("Dock {panel}"), name, edits.dock, focus=True)

    def toggle_floating(self, name: PanelName) -> None:
        if self.arrangement is not None and name in self.arrangement.afloat:
            self.dock_panel(name)
        else:
            self.float_panel(name)

    def move_panel(self, name: PanelName, beside: PanelName, side: Side, at: int | None = None) -> None:
        """Move the panel next to another one or into its tab group."""
        self._change(tr("Move {panel}"), name, edits.move, beside, side, at, focus=True)

    def resized(self, name: PanelName, by_px: int) -> DockLayout | None:
        """Layout with the panel larger by this much, or smaller if negative; None if its neighbours leave no room."""
        arrangement, area = self.arrangement, self.docks[name].parentWidget() if name in self.docks else None
        if arrangement is None or not arrangement.is_shown(name) or not isinstance(area, DockArea):
            return None
        found = None if area.whole_tree is None else grown(area.whole_tree, area.placing, name, by_px)
        return None if found is None else edits.resize(arrangement, edits.window_of(arrangement, name), *found)

    def resize_panel(self, name: PanelName, by_px: int) -> None:
        """Make the panel larger, or smaller if negative."""
        words = tr("Make {panel} larger") if by_px > 0 else tr("Make {panel} smaller")
        self._change(words, name, lambda _layout, name: self.resized(name, by_px))

    def _title(self, name: PanelName) -> str:
        return self.docks[name].panel.title

    def _on_tab_chosen(self, name: PanelName) -> None:
        """Selecting a tab changes the layout but is not an edit that can be undone."""
        if self.arrangement is not None:
            after = edits.select(self.arrangement, name)
            if after != self.arrangement:
                self._do("", after)

    def _on_resized_by_hand(
        self, window: int | None, path: tuple[int, ...], weights: tuple[float, ...], let_go: bool
    ) -> None:
        if self.arrangement is None or self.locked:
            return
        if self._before_resize is None:
            self._before_resize = self.arrangement
        self.arrangement = edits.resize(self.arrangement, window, path, weights)
        area = self if window is None else self._windows[window].area
        area.whole_tree = (self.arrangement if window is None else self.arrangement.floating[window]).tree
        area.lay_out()
        if let_go:
            before, self._before_resize = self._before_resize, None
            if before != self.arrangement:
                self.edited.emit(tr("Resize panels"), before)
                self.layout_changed.emit()

    def _on_window_moved(self, index: int, place: QRect) -> None:
        if self.arrangement is None or index >= len(self.arrangement.floating):
            return
        if self.locked:
            self.show_everything()  # snap back
            self.refused.emit(tr(LOCKED))
            return
        self.arrangement = edits.place_window(self.arrangement, index, place)
        self.layout_changed.emit()

    def _dock_all_of(self, index: int) -> None:
        """Dock the panels of a floating window that was closed by its title bar."""
        if self.arrangement is None or index >= len(self.arrangement.floating):
            return
        after = self.arrangement
        for name in panels_in(after.floating[index].tree):
            after = edits.dock(after, name)
        self.edit(tr("Dock panels"), after)

    # ---- dragging

    def _drop_at(self, name: PanelName, at: QPoint) -> tuple[DockArea, Drop | None] | None:
        """The dock area under the pointer, floating windows first, with the drop that releasing there would cause."""
        for area in self._areas:
            inside = area.mapFromGlobal(at)
            if area.isVisible() and area.rect().contains(inside):
                drop = drop_at(area.placing, area.rect(), inside.x(), inside.y(), name)
                return area, None if drop is not None and drop.beside is None and area is not self else drop
        return None

    def _on_drag_moved(self, name: PanelName, at: QPoint) -> None:
        if self.locked:
            self._drag_words.show_at(at, tr("The layout is locked"))
            return
        found = self._drop_at(name, at)
        area, drop = found or (self, None)
        self._drop_mark.hide()
        if drop is not None:
            if self._drop_mark.parentWidget() is not area:
                self._drop_mark.setParent(area)
            self._drop_mark.setGeometry(drop.mark)
            self._drop_mark.raise_()
            self._drop_mark.show()
        words = tr("{panel}: in a separate window") if found is None else tr("{panel}: stays here")
        if drop is not None:
            words = tr(_DROP_WORDS[None if drop.beside is None else drop.side])
        other = "" if drop is None or drop.beside is None else self._title(drop.beside)
        self._drag_words.show_at(at, words.format(panel=self._title(name), other=other))

    def _on_drag_dropped(self, name: PanelName, at: QPoint) -> None:
        self._end_drag()
        found = self._drop_at(name, at)
        if found is None:
            self.float_panel(name, QRect(at.x() - 60, at.y() - 20, *COMFORT.get(name, _FLOATING)))
            return
        area, drop = found
        if drop is not None and drop.beside is None:
            self._change(tr("Move {panel}"), name, edits.move_to_edge, drop.side, focus=True)
        elif drop is not None and drop.beside is not None:
            # A group has its tab bar above the panels; a panel that is dropped on it goes between its tabs.
            bar = next((bar for bar in area.bars if bar.rect().contains(bar.mapFromGlobal(at))), None)
            index = None if bar is None or drop.side != "tab" else bar.place_of(bar.mapFromGlobal(at), name)
            self.move_panel(name, drop.beside, drop.side, index)

    def _end_drag(self) -> None:
        self._drop_mark.hide()
        self._drop_mark.setParent(self)
        self._drag_words.hide()

    def give_up(self) -> None:
        """Esc: cancel the drag."""
        if self._drag_words.isVisible():
            self.requests.cancel()
            self._end_drag()

    # ---- a panel's menu

    def _open_menu(self, name: PanelName, at: QPoint) -> None:
        menu = QMenu(self)
        menu.setObjectName("panel_menu")
        menu.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.fill_menu(menu, name)
        menu.popup(at)

    def fill_menu(self, menu: QMenu, name: PanelName) -> None:
        """Fill the panel's context menu; all entries work by keyboard."""
        arrangement = self.arrangement
        if arrangement is None:
            return
        words = tr("Dock in the main window") if name in arrangement.afloat else tr("Open in a separate window")
        floats = menu.addAction(words, partial(self.toggle_floating, name))
        for words, by_px in ((tr("Larger"), RESIZE_PX), (tr("Smaller"), -RESIZE_PX)):
            resizes = menu.addAction(words, partial(self.resize_panel, name, by_px))
            resizes.setEnabled(not self.locked and self.resized(name, by_px) is not None)
        others = [other for other in arrangement.panels if other != name and arrangement.is_shown(other)]
        for side, words in _MENU_SIDES.items():
            into = menu.addMenu(tr(words))
            into.setEnabled(not self.locked and bool(others))
            for other in others:
                into.addAction(self._title(other), partial(self.move_panel, name, other, side))
        menu.addSeparator()
        close = menu.addAction(tr("Close this panel"), partial(self.close_panel, name))
        for action in (floats, close):
            action.setEnabled(not self.locked)
        if self.locked:
            menu.addSection(tr("The layout is locked"))


_MENU_SIDES: Mapping[Side, str] = {
    "tab": QT_TR_NOOP("As a tab with"),
    "left": QT_TR_NOOP("Left of"),
    "right": QT_TR_NOOP("Right of"),
    "above": QT_TR_NOOP("Above"),
    "below": QT_TR_NOOP("Below"),
}
_DROP_WORDS: Mapping[Side | None, str] = {
    None: QT_TR_NOOP("{panel}: along the entire edge"),
    "tab": QT_TR_NOOP("{panel}: as a tab with {other}"),
    "left": QT_TR_NOOP("{panel}: left of {other}"),
    "right": QT_TR_NOOP("{panel}: right of {other}"),
    "above": QT_TR_NOOP("{panel}: above {other}"),
    "below": QT_TR_NOOP("{panel}: below {other}"),
}


def available_screens() -> Sequence[QRect]:
    """Available geometry of each screen, primary screen first."""
    return [screen.availableGeometry() for screen in QGuiApplication.screens()]


class DragWords(QLabel):
    """Label that follows the pointer."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent, Qt.WindowType.ToolTip)
        self.setObjectName("drag_words")
        self.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)

    def show_at(self, at: QPoint, text: str) -> None:
        self.setText(text)
        self.adjustSize()
        self.move(at + _BESIDE_POINTER)
        self.show()
