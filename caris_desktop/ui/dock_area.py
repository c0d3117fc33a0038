"""Dock area widget: shows a layout tree as docks, tab bars and split handles. A dock is a panel with its title bar, by
which it is dragged, closed and floated.
"""

from collections.abc import Mapping, Sequence
from functools import partial

from PySide6.QtCore import QEvent, QObject, QPoint, QRect, QSignalBlocker, QSize, Qt, Signal
from PySide6.QtGui import (
    QContextMenuEvent,
    QEnterEvent,
    QHideEvent,
    QMouseEvent,
    QResizeEvent,
    QShowEvent,
)
from PySide6.QtWidgets import QApplication, QFrame, QMenu, QPushButton, QScrollArea, QSizePolicy, QTabBar, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.scenario.scenario_model import LayoutNode, PanelName
from caris_desktop.ui import layouts
from caris_desktop.ui.dock_geometry import DockGeometry, GroupPlace, Handle, Room, dragged, place
from caris_desktop.ui.focus_widget import Bar, KeyPlace
from caris_desktop.ui.panel import TITLE_HEIGHT_PX, Panel, show_part
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import ElidedLabel, restyle

_BUTTON_PX = 26
_LEAST_TITLE_PX, _ANY_PX = 40, 16_777_215


class PanelTitleBar(Bar, QWidget):
    """Upper part of a panel's card: title left, status text and controls right.

    When space is short, the status text is elided first, then buttons with an icon lose their text from right to left,
    and last the title is elided; tooltips show elided text. ``more``: controls of the dock area, after the panel's own.
    ``looked_at``: view-only, without controls. ``over_picture``: only the controls, the first at the left end.
    """

    def __init__(
        self, panel: Panel, more: Sequence[QWidget] = (), *, looked_at: bool = False, over_picture: bool = False
    ) -> None:
        super().__init__()
        self._over_picture = over_picture
        self._pointed = False
        self._unseen: QWidget | None = None
        if looked_at:
            self._unseen = QWidget(self)
            self._unseen.hide()
        self._panel = panel
        self.setFixedHeight(TITLE_HEIGHT_PX)
        self.setAttribute(Qt.WidgetAttribute.WA_StyledBackground)
        self.setProperty("role", "" if over_picture else "panel_title")
        self._title = ElidedLabel(role="title")
        self._title.setSizePolicy(QSizePolicy.Policy.Preferred, QSizePolicy.Policy.Preferred)
        self._title.setMinimumWidth(_LEAST_TITLE_PX)
        self._title.setText(panel.shown_title)
        self._fact = ElidedLabel(role="small", objectName="panel_fact", alignment=Qt.AlignmentFlag.AlignRight)
        self._more = tuple(more)
        self._controls: tuple[QWidget, ...] = ()
        self.row = layouts.hbox(self, self._title, (self._fact, 1), spacing_px=8)
        self._show_controls()
        self.set_tabbed(False)
        # Clicks on the labels must reach the dock, which is dragged by its title.
        for label in (self._title, self._fact):
            label.setAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
        panel.fact_changed.connect(self._show_fact)
        panel.title_changed.connect(self._title.setText)
        panel.controls_changed.connect(self._show_controls)
        panel.active_changed.connect(self._show_active)
        self._show_fact(*panel.fact)

    def _show_controls(self) -> None:
        own, before = self._panel.title_widgets(), self._controls
        # What appears under the pointer only comes first, so that the others reach the edge.
        self._controls = (*own[:1], *self._more, *own[1:]) if self._over_picture else (*self._more, *own)
        for widget in before:
            self.row.removeWidget(widget)
            if widget not in self._controls:
                layouts.discard(widget)
        if self._unseen is not None:
            for widget in self._controls:
                widget.setParent(self._unseen)
            self._controls = ()
        margins = (10, 6, 10, 2) if self._over_picture else (14, 3, 6 if self._controls else 14, 3)
        self.row.setContentsMargins(*margins)
        for number, widget in enumerate(self._controls):
            self.row.insertWidget(0 if self._over_picture and number == 0 else self.row.count(), widget)
        self.set_pointed(self._pointed)

    def set_pointed(self, pointed: bool) -> None:
        """Set whether the pointer is over the panel, which shows its quiet buttons."""
        self._pointed = pointed
        for widget in self._controls:
            if isinstance(widget, ActionButton):
                widget.set_pointed(pointed)
        self._place_fact()

    def _place_fact(self) -> None:
        """Give the status text the place of quiet buttons, as long as they are not seen."""
        seen = [
            widget
            for widget in self._controls
            if not widget.isHidden() and (self._pointed or not isinstance(widget, ActionButton) or widget.is_seen)
        ]
        place = self._fact.geometry()
        edge = self.width() - self.row.contentsMargins().right() + self.row.spacing()
        place.setRight(min((widget.x() for widget in seen), default=min(edge, self.width() - 6)) - self.row.spacing())
        self._fact.setGeometry(place)

    def event(self, event: QEvent) -> bool:
        if event.type() in (QEvent.Type.Resize, QEvent.Type.LayoutRequest):
            self._fit()
            self._place_fact()
        return super().event(event)

    def _fit(self) -> None:
        """Hide button texts as far as the title needs their space."""
        row = self.row
        visible = [widget for widget in self._controls if not widget.isHidden()]
        widths = [self._title.sizeHint().width()] if not self._title.isHidden() else []
        widths += [widget.sizeHint().width() for widget in visible]
        margins = row.contentsMargins()
        missing_px = sum(widths) + row.spacing() * len(widths) + margins.left() + margins.right() - self.width()
        for button in reversed(visible):
            if not isinstance(button, ActionButton) or not button.may_shrink:
                continue
            full_px, least_px = button.sizeHint().width(), button.minimumSizeHint().width()
            button.setMaximumWidth(least_px if missing_px > 0 else _ANY_PX)
            missing_px -= full_px - least_px if missing_px > 0 else 0
        # The title ignores the mouse because it is the drag handle.
        self.setToolTip(self._panel.shown_title if missing_px > 0 and not self._title.isHidden() else "")

    def sizeHint(self) -> QSize:
        # A dock queries only this size of its title bar.
        return QSize(160, TITLE_HEIGHT_PX)

    def set_tabbed(self, tabbed: bool) -> None:
        """Hide the title in a tab group: the tab shows it."""
        self._title.setVisible(not tabbed and not self._over_picture)

    def _show_active(self, active: bool) -> None:
        for half_of_card in (self, self._panel):
            restyle(half_of_card, active=active)

    def _show_fact(self, text: str, role: str) -> None:
        if not self._over_picture:  # the picture says it
            self._fact.lead = self._panel.fact_lead
            self._fact.setText(text)
            restyle(self._fact, tone=role or "dim")

    def mousePressEvent(self, event: QMouseEvent) -> None:
        event.ignore()  # starts dragging the dock


class DockRequests(QObject):
    """What the wizard requests at a panel's title, menu or tab, and the drag of a panel by one of them."""

    tab_chosen = Signal(object)  # PanelName
    tab_clicked = Signal(object)  # focus its panel too
    float_requested = Signal(object)  # float or dock
    menu_requested = Signal(object, object)  # PanelName, QPoint on the desktop
    drag_moved = Signal(object, object)
    drag_dropped = Signal(object, object)

    def __init__(self) -> None:
        super().__init__()
        self._pressed: PanelName | None = None
        self._pressed_at = QPoint()
        self._least_px = 0
        self._dragging = False

    def press(self, name: PanelName, event: QMouseEvent, *, times_start_distance: int = 1) -> None:
        """The panel is dragged once the pointer is this far from the press."""
        self._pressed, self._pressed_at = name, event.globalPosition().toPoint()
        self._least_px = times_start_distance * QApplication.startDragDistance()

    def move(self, event: QMouseEvent) -> None:
        at = event.globalPosition().toPoint()
        if self._pressed is not None and self._is_drag(at):
            self._dragging = True
            self.drag_moved.emit(self._pressed, at)

    def release(self, event: QMouseEvent) -> bool:
        """Drop a dragged panel; returns whether the press was a click."""
        at = event.globalPosition().toPoint()
        # A quick release can precede the first move event.
        pressed, dragged = self._pressed, self._is_drag(at)
        self.cancel()
        if pressed is not None and dragged:
            self.drag_dropped.emit(pressed, at)  # the tab bar of the press may be deleted by it
        return pressed is not None and not dragged

    def cancel(self) -> None:
        """End the drag without a drop."""
        self._pressed, self._dragging = None, False

    def _is_drag(self, at: QPoint) -> bool:
        return self._dragging or (at - self._pressed_at).manhattanLength() >= self._least_px


class _Handle(ActionButton):
    """Handle of a panel without a title bar: the dock gets its presses, for dragging. A key clicks it."""

    def mousePressEvent(self, event: QMouseEvent) -> None:
        event.ignore()


class Dock(KeyPlace):
    """Title bar and panel. In a dock that is too small the panel keeps its minimum size and scrolls."""

    def __init__(self, name: PanelName, panel: Panel, requests: DockRequests, parent: QWidget) -> None:
        super().__init__(parent)
        self.name = name
        self.setObjectName(f"dock_{name}")
        self.panel = panel
        self._requests = requests
        self.floating = False
        """Whether it is in a floating window, alone or with others."""
        self._locked = False
        self._scroll = QScrollArea(self)
        self._scroll.setObjectName("panel_scroll")
        self._scroll.setFrameShape(QFrame.Shape.NoFrame)
        self._scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._scroll.setWidget(panel)
        for part in (panel, self._scroll.viewport()):  # a panel paints its card
            part.setAutoFillBackground(False)
        picture = panel.picture()
        self._title_px = TITLE_HEIGHT_PX if picture is None else 0
        self._handle = _Handle(
            panel.theme, icon="dots-six-vertical", height_px=_BUTTON_PX, objectName="panel_handle",
            toolTip=tr("Drag to move this panel, click for its menu"), clicked=self._open_menu, parent=self,
        )  # fmt: skip
        self._handle.setHidden(picture is None)
        self._float = ActionButton(
            panel.theme, icon="arrow-square-out", role="ghost" if picture is None else "plain", height_px=_BUTTON_PX,
            objectName="float_button", clicked=partial(requests.float_requested.emit, name),
        )  # fmt: skip
        for button in (self._handle, self._float):
            button.set_quiet(True)
        if picture is None:
            self.title_bar = PanelTitleBar(panel, (self._float,))
            self.title_bar.setParent(self)
        else:
            self.title_bar = PanelTitleBar(panel, (self._float, self._handle), over_picture=True)
            self._over_picture = layouts.vbox(picture, self.title_bar, 1, margins_px=0)
        self.title_bar.show()
        panel.title_changed.connect(self._show_words)
        self._show_words()

    def focus_target(self) -> QWidget:
        return self.panel.focus_target()

    def set_place(self, *, floating: bool, locked: bool) -> None:
        if (floating, locked) != (self.floating, self._locked):
            self.floating, self._locked = floating, locked
            self._show_words()

    def _show_words(self) -> None:
        """Show the title, and what the buttons do at the present place."""
        title = self.panel.shown_title
        self.setWindowTitle(title)
        show_part(self._float, not self._locked)
        words = tr("Dock in the main window") if self.floating else tr("Open in a separate window")
        icon = "arrow-square-in" if self.floating else "arrow-square-out"
        self._float.set_label("", icon=icon, name=f"{title}: {words}", tip=words)
        self._handle.setAccessibleName(tr("{panel}: move and menu").format(panel=title))

    def set_shown(self, visible: bool) -> None:
        """Show the dock, or hide it behind another tab or entirely."""
        self.setVisible(visible)
        self.panel.set_in_view(visible)

    def least(self) -> Room:
        """Minimum size, including the title bar."""
        need = self._panel_need()
        return (max(need.width(), self.title_bar.minimumSizeHint().width()), need.height() + self._title_px)

    def _panel_need(self) -> QSize:
        """Minimum size of the panel: an explicit one overrides its size hint."""
        hint, least = self.panel.minimumSizeHint(), self.panel.minimumSize()
        return QSize(least.width() or hint.width(), least.height() or hint.height())

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.fit()

    def fit(self) -> None:
        """Lay out title bar and panel."""
        if self._title_px:
            self.title_bar.setGeometry(0, 0, self.width(), self._title_px)
        self._scroll.setGeometry(0, self._title_px, self.width(), max(0, self.height() - self._title_px))
        room, need = self._scroll.maximumViewportSize(), self._panel_need()
        # Beside a scroll bar across the other direction.
        if need.height() > room.height():
            room.setWidth(room.width() - self._scroll.verticalScrollBar().sizeHint().width())
        if need.width() > room.width():
            room.setHeight(room.height() - self._scroll.horizontalScrollBar().sizeHint().height())
        self.panel.resize(room.expandedTo(need))

    # ---- controls that appear under the pointer

    def enterEvent(self, event: QEnterEvent) -> None:
        super().enterEvent(event)
        self.title_bar.set_pointed(True)

    def leaveEvent(self, event: QEvent) -> None:
        super().leaveEvent(event)
        self.title_bar.set_pointed(False)

    @property
    def has_picture(self) -> bool:
        """Whether it is in view with a picture instead of a title bar."""
        return not self._title_px and not self.isHidden()

    def leave_clear(self, covered: QRect) -> None:
        """Keep a picture's names and controls clear of what covers its upper edge, in the coordinates of the parent."""
        if self._title_px:
            return
        self.panel.covered = covered.translated(-self.pos())
        at_left = self.panel.title_widgets()[0]
        free_px = self.width() - self.title_bar.row.sizeHint().width() if at_left.isHidden() else 0
        lower = self.panel.covered.bottom() + 1 if self.panel.covered.right() >= free_px else 0
        self._over_picture.setContentsMargins(0, max(0, lower), 0, 0)
        self.panel.fit()

    def _open_menu(self) -> None:
        self._requests.menu_requested.emit(self.name, self._handle.mapToGlobal(self._handle.rect().bottomLeft()))

    # ---- dragging

    @property
    def _title_bottom(self) -> int:
        """Lower end of the title bar, by which the panel is dragged."""
        return self.title_bar.mapTo(self, QPoint(0, TITLE_HEIGHT_PX)).y()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and event.position().y() < self._title_bottom:
            self._requests.press(self.name, event)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        self._requests.move(event)

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        at = self._handle.mapFromGlobal(event.globalPosition().toPoint())
        if self._requests.release(event) and self._handle.isVisible() and self._handle.rect().contains(at):
            self._open_menu()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        if event.position().y() < self._title_bottom:
            self._requests.float_requested.emit(self.name)

    def contextMenuEvent(self, event: QContextMenuEvent) -> None:
        if event.y() < self._title_bottom:
            self._requests.menu_requested.emit(self.name, event.globalPos())

    # ---- Qt events

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        self.panel.set_in_view(True)

    def hideEvent(self, event: QHideEvent) -> None:
        super().hideEvent(event)
        self.panel.set_in_view(False)


_MORE_PX = 34
_TAB_DRAG_FACTOR = 2  # a click on a tab that slips is not a drag


class DockArea(QWidget):
    """Lays out ``docks``; reports the wizard's edits to the owner of the whole layout."""

    laid_out = Signal()
    resized_by_hand = Signal(object, object, bool)  # path, weights, whether the handle was released

    def __init__(self, docks: dict[PanelName, Dock], requests: DockRequests, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.docks = docks
        self.requests = requests
        self.whole_tree: LayoutNode | None = None
        self.locked = False
        self._visible: frozenset[PanelName] = frozenset()
        self._reserved_px = 0
        self.placing = DockGeometry()
        self.bars: list[PanelTabs] = []
        self._handles: list[SplitHandle] = []

    def minimumSizeHint(self) -> QSize:
        return QSize(320, 200)

    def show_tree(self, tree: LayoutNode | None, visible: frozenset[PanelName]) -> None:
        """Show the ``visible`` panels of the tree; each has a dock."""
        for name in visible:
            if self.docks[name].parentWidget() is not self:
                self.adopt(self.docks[name])
        self.whole_tree, self._visible = tree, visible
        self.lay_out()

    def adopt(self, dock: Dock) -> None:
        """Take a dock from another window, below the popups."""
        dock.setParent(self)
        dock.lower()

    def lay_out(self) -> None:
        room = self.rect().adjusted(0, self._reserved_px, 0, 0)
        self.placing = DockGeometry()
        if self.whole_tree is not None:
            self.placing = place(self.whole_tree, room, self._visible, lambda name: self.docks[name].least())
        tabbed = [group for group in self.placing.groups if group.tabbed]
        layouts.adjust_count(self.bars, len(tabbed), lambda: PanelTabs(self.docks, self.requests, self))
        for bar, group in zip(self.bars, tabbed, strict=True):
            bar.show_group(group)
        layouts.adjust_count(self._handles, len(self.placing.handles), self._new_handle)
        for widget, handle in zip(self._handles, self.placing.handles, strict=True):
            widget.show_handle(handle, locked=self.locked)
        for group in self.placing.groups:
            for name in group.panels:
                dock = self.docks[name]
                dock.title_bar.set_tabbed(group.tabbed)
                if name == group.current:
                    dock.setGeometry(group.body)
                    dock.fit()  # its minimum may have changed
                dock.set_shown(name == group.current)
        self.laid_out.emit()

    def reserve(self, height_px: int) -> None:
        """Leave this height above the panels free."""
        if height_px != self._reserved_px:
            self._reserved_px = height_px
            self.lay_out()

    def picture_place(self) -> QRect:
        """Place of the picture in view; empty if there is none."""
        places = (dock.geometry() for dock in self.docks.values() if dock.parentWidget() is self and dock.has_picture)
        return next(places, QRect())

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.lay_out()

    def _new_handle(self) -> "SplitHandle":
        handle = SplitHandle(self)
        handle.moved.connect(self._on_handle_moved)
        return handle

    def _on_handle_moved(self, handle: Handle, moved_px: int, let_go: bool) -> None:
        if self.whole_tree is not None:
            self.resized_by_hand.emit(handle.path, dragged(self.whole_tree, handle, moved_px), let_go)


class PanelTabs(Bar, QTabBar):
    """Tab bar of a group. Dragging a tab moves that panel only."""

    def __init__(self, docks: Mapping[PanelName, Dock], requests: DockRequests, parent: QWidget) -> None:
        super().__init__(parent)
        self._docks = docks
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
        self.lower()  # below the popups
        self.show()

    def show_group(self, group: GroupPlace) -> None:
        with QSignalBlocker(self):
            if group.panels != self.panels:
                self.panels = group.panels
                while self.count():
                    self.removeTab(0)
                for _name in self.panels:
                    self.addTab("")
            self.show_titles()
            self.setCurrentIndex(group.panels.index(group.current))
            self.setGeometry(group.tab_bar)
            self._show_what_fits()

    def show_titles(self) -> None:
        for index, name in enumerate(self.panels):
            if self.tabText(index) != self._docks[name].windowTitle():
                self.setTabText(index, self._docks[name].windowTitle())

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
        words = tr("More tabs: {names}").format(names=", ".join(map(self.tabText, self._in_list())))
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
            menu.addAction(self.tabText(index), partial(self._requests.tab_clicked.emit, self.panels[index]))
        menu.popup(self._more.mapToGlobal(self._more.rect().bottomLeft()))

    def place_of(self, at: QPoint, panel: PanelName) -> int:
        """Tab index for a drop at this point, not counting the panel itself."""
        others = [i for i, name in enumerate(self.panels) if name != panel and self.isTabVisible(i)]
        return sum(self.tabRect(index).center().x() < at.x() for index in others)

    def _on_current_changed(self, index: int) -> None:
        if 0 <= index < len(self.panels):
            self._requests.tab_chosen.emit(self.panels[index])

    def mousePressEvent(self, event: QMouseEvent) -> None:
        index = self.tabAt(event.position().toPoint())
        # The empty part of the bar belongs to the panel below it, like a title.
        panel = self.panels[index if index >= 0 else self.currentIndex()]
        super().mousePressEvent(event)
        if event.button() == Qt.MouseButton.LeftButton:
            if index >= 0:
                self._requests.press(panel, event, times_start_distance=_TAB_DRAG_FACTOR)
            self._requests.tab_clicked.emit(panel)

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
        self.lower()
        self.show()

    def show_handle(self, handle: Handle, *, locked: bool) -> None:
        self._handle = handle
        self.setGeometry(handle.rect)
        self.setEnabled(not locked)
        shape = Qt.CursorShape.SplitHCursor if handle.split == "horizontal" else Qt.CursorShape.SplitVCursor
        self.setCursor(Qt.CursorShape.ArrowCursor if locked else shape)

    def _position(self, event: QMouseEvent, handle: Handle) -> int:
        at = event.globalPosition().toPoint()
        return at.x() if handle.split == "horizontal" else at.y()

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
