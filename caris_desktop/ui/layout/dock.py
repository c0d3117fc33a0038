"""Dock widget: a panel with its title bar, which can be dragged, closed and floated."""

from PySide6.QtCore import QEvent, QObject, QPoint, QRect, QSize, Qt, Signal
from PySide6.QtGui import QCloseEvent, QContextMenuEvent, QEnterEvent, QHideEvent, QMouseEvent, QResizeEvent, QShowEvent
from PySide6.QtWidgets import QApplication, QFrame, QScrollArea, QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.scenario.scenario_model import PanelName
from caris_desktop.ui import layouts
from caris_desktop.ui.focus_widget import KeyPlace
from caris_desktop.ui.layout.dock_geometry import TITLE_PX, Room
from caris_desktop.ui.panel import Panel, show_part
from caris_desktop.ui.panel_title_bar import PanelTitleBar
from caris_desktop.ui.widgets.buttons import ActionButton

_BUTTON_PX = 26


class DockRequests(QObject):
    """What the wizard requests at a panel's title, menu or tab, and the drag of a panel by one of them."""

    tab_chosen = Signal(object)  # PanelName
    tab_clicked = Signal(object)  # focus its panel too
    close_requested = Signal(object)
    float_requested = Signal(object)  # float or dock
    menu_requested = Signal(object, object)  # PanelName, QPoint on the desktop
    drag_moved = Signal(object, object)
    drag_dropped = Signal(object, object)

    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
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
        self._pressed, self._dragging = None, False
        if pressed is not None and dragged:
            self.drag_dropped.emit(pressed, at)  # the tab bar of the press may be deleted by it
        return pressed is not None and not dragged

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
        self._panel = panel
        self._requests = requests
        self._floating = False
        self._scroll = QScrollArea(self)
        self._scroll.setObjectName("panel_scroll")
        self._scroll.setFrameShape(QFrame.Shape.NoFrame)
        self._scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        panel.setParent(self._scroll.viewport())
        self._scroll.setWidget(panel)
        for part in (panel, self._scroll.viewport()):  # a panel paints its card
            part.setAutoFillBackground(False)
        panel.show()
        picture = panel.picture()
        self._title_px = TITLE_PX if picture is None else 0
        self._handle = _Handle(panel.theme, icon="dots-six-vertical", height_px=_BUTTON_PX)
        self._handle.setObjectName("panel_handle")
        self._handle.set_quiet(True)
        self._handle.setToolTip(tr("Drag to move this panel, click for its menu"))
        self._handle.clicked.connect(self._open_menu)
        self._handle.setParent(self)
        if picture is None:
            self._handle.hide()
        self._float = ActionButton(
            panel.theme, icon="arrow-square-out", role="ghost" if picture is None else "plain", height_px=_BUTTON_PX
        )
        self._float.setObjectName("float_button")
        self._float.set_quiet(True)
        self._float.clicked.connect(lambda: requests.float_requested.emit(name))
        parts = (self._float,) if picture is None else (self._float, self._handle)
        self._title_bar = PanelTitleBar(panel, parts, picture=picture)
        if picture is None:
            self._title_bar.setParent(self)
        else:
            self._over_picture = layouts.vbox(picture, margins_px=0)
            self._over_picture.addWidget(self._title_bar)
            self._over_picture.addStretch(1)
        self._title_bar.show()
        panel.title_changed.connect(self._on_title_changed)
        self._on_title_changed(panel.shown_title)
        self.set_place(floating=False, locked=False)

    def focus_target(self) -> QWidget:
        return self._panel.focus_target()

    def widget(self) -> Panel:
        return self._panel

    def titleBarWidget(self) -> PanelTitleBar:
        return self._title_bar

    def isFloating(self) -> bool:
        """Whether it is in a floating window, alone or with others."""
        return self._floating

    def set_place(self, *, floating: bool, locked: bool) -> None:
        self._floating = floating
        show_part(self._float, not locked)
        words = tr("Dock in the main window") if floating else tr("Open in a separate window")
        self._float.set_label("", icon="arrow-square-in" if floating else "arrow-square-out")
        self._float.setAccessibleName(f"{self._panel.shown_title}: {words}")
        self._handle.setAccessibleName(tr("{panel}: move and menu").format(panel=self._panel.shown_title))
        self._float.setToolTip(words)

    def set_shown(self, visible: bool) -> None:
        """Show the dock, or hide it behind another tab or entirely."""
        self.setVisible(visible)
        self._panel.set_in_view(visible)

    def least(self) -> Room:
        """Minimum size, including the title bar."""
        need = self._panel_need()
        return (max(need.width(), self._title_bar.minimumSizeHint().width()), need.height() + self._title_px)

    def _panel_need(self) -> QSize:
        """Minimum size of the panel: an explicit one overrides its size hint."""
        hint, least = self._panel.minimumSizeHint(), self._panel.minimumSize()
        return QSize(least.width() or hint.width(), least.height() or hint.height())

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.fit()

    def fit(self) -> None:
        """Lay out title bar and panel."""
        if self._title_px:
            self._title_bar.setGeometry(0, 0, self.width(), TITLE_PX)
        self._scroll.setGeometry(0, self._title_px, self.width(), max(0, self.height() - self._title_px))
        room, need = self._scroll.maximumViewportSize(), self._panel_need()
        # Beside a scroll bar across the other direction.
        if need.height() > room.height():
            room.setWidth(room.width() - self._scroll.verticalScrollBar().sizeHint().width())
        if need.width() > room.width():
            room.setHeight(room.height() - self._scroll.horizontalScrollBar().sizeHint().height())
        self._panel.resize(room.expandedTo(need))

    # ---- controls that appear under the pointer

    def enterEvent(self, event: QEnterEvent) -> None:
        super().enterEvent(event)
        self._title_bar.set_pointed(True)

    def leaveEvent(self, event: QEvent) -> None:
        super().leaveEvent(event)
        self._title_bar.set_pointed(False)

    def leave_clear(self, covered: QRect) -> None:
        """Keep the controls on a picture below what covers its upper edge, in the coordinates of the parent."""
        if not self._title_px:
            lower = covered.bottom() + 1 - self.y() if covered.intersects(self.geometry()) else 0
            self._over_picture.setContentsMargins(0, max(0, lower), 0, 0)

    def _is_handle(self, at: QPoint) -> bool:
        return self._handle.isVisible() and self._handle.rect().contains(self._handle.mapFromGlobal(at))

    def _open_menu(self, _checked: bool = False) -> None:
        self._requests.menu_requested.emit(self.name, self._handle.mapToGlobal(self._handle.rect().bottomLeft()))

    # ---- dragging

    @property
    def _title_bottom(self) -> int:
        """Lower end of the title bar, by which the panel is dragged."""
        return self._title_bar.mapTo(self, QPoint(0, TITLE_PX)).y()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and event.position().y() < self._title_bottom:
            self._requests.press(self.name, event)

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        self._requests.move(event)

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        if self._requests.release(event) and self._is_handle(event.globalPosition().toPoint()):
            self._open_menu()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        if event.position().y() < self._title_bottom:
            self._requests.float_requested.emit(self.name)

    def contextMenuEvent(self, event: QContextMenuEvent) -> None:
        if event.y() < self._title_bottom:
            self._requests.menu_requested.emit(self.name, event.globalPos())

    # ---- Qt events

    def closeEvent(self, event: QCloseEvent) -> None:
        event.ignore()
        self._requests.close_requested.emit(self.name)

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        self._panel.set_in_view(True)

    def hideEvent(self, event: QHideEvent) -> None:
        super().hideEvent(event)
        self._panel.set_in_view(False)

    def _on_title_changed(self, title: str) -> None:
        self.setWindowTitle(title)
        self.set_place(floating=self._floating, locked=self._float.isHidden())
