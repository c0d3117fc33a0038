"""Dock widget: a panel with its title bar, which can be dragged, closed, floated and enlarged."""

from PySide6.QtCore import QEvent, QPoint, QRect, QSize, Qt, Signal
from PySide6.QtGui import QCloseEvent, QContextMenuEvent, QEnterEvent, QHideEvent, QMouseEvent, QResizeEvent, QShowEvent
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractScrollArea,
    QAbstractSlider,
    QApplication,
    QLabel,
    QLineEdit,
    QWidget,
)

from caris_desktop.domain.translation import tr
from caris_desktop.scenario.scenario_model import PanelName
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.focus_widget import KeyPlace
from caris_desktop.ui.layout.dock_geometry import TITLE_PX, Room
from caris_desktop.ui.panel import Panel, show_part
from caris_desktop.ui.panel_title_bar import PanelTitleBar
from caris_desktop.ui.widgets.buttons import ActionButton

_BUTTON_PX = 26
_MOST_NAMED = 4


class _Handle(ActionButton):
    """Handle of a panel without a title bar: the dock gets its presses, for dragging. A key clicks it."""

    def mousePressEvent(self, event: QMouseEvent) -> None:
        event.ignore()


class Dock(KeyPlace):
    """Title bar and panel. In a dock that is too small the panel keeps its minimum size, and a button in the title bar
    lists what is cut off.
    """

    drag_moved = Signal(object, object)  # PanelName, QPoint on the desktop
    drag_dropped = Signal(object, object)
    close_requested = Signal(object)
    float_requested = Signal(object)  # float or dock
    menu_requested = Signal(object, object)
    drawer_requested = Signal(object)

    def __init__(self, name: PanelName, panel: Panel, parent: QWidget) -> None:
        super().__init__(parent)
        self.name = name
        self.setObjectName(f"dock_{name}")
        self._panel = panel
        self._pressed_at: QPoint | None = None
        self._dragging = False
        self._floating = self._drawer = False
        self._content = QWidget(self)
        panel.setParent(self._content)
        panel.show()
        self._more = ActionButton(
            panel.theme,
            icon="caret-double-down",
            role="amber",
            height_px=_BUTTON_PX,
            text_px=tokens.STATUS_PX,
            may_lose_words=True,
        )
        self._more.setObjectName("drawer_button")
        self._more.clicked.connect(lambda: self.drawer_requested.emit(self.name))
        self._more.hide()
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
        self._float.clicked.connect(lambda: self.float_requested.emit(self.name))
        parts = (self._more, self._float) if picture is None else (self._more, self._float, self._handle)
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

    def set_drawer(self, is_drawer: bool) -> None:
        """Set whether it is the drawer, enlarged over its neighbours."""
        self._drawer = is_drawer
        self.fit()

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

    # ---- cut-off content

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self.fit()

    def fit(self) -> None:
        """Lay out title bar and panel."""
        below = max(0, self.height() - self._title_px)
        if self._title_px:
            self._title_bar.setGeometry(0, 0, self.width(), TITLE_PX)
        self._content.setGeometry(0, self._title_px, self.width(), below)
        need = self._panel_need()
        self._panel.setGeometry(0, 0, max(self.width(), need.width()), max(below, need.height()))
        cut = self.width() < need.width() or below < need.height()
        self._more.setVisible(cut or self._drawer)
        if self._drawer:
            self._more.set_label(tr("Less"), icon="caret-double-up")
            self._more.setAccessibleName(tr("Close the drawer"))
            self._more.setToolTip(tr("Close the drawer"))
        elif cut:
            names = self.cut_off()
            words = tr("Too small: open as a drawer")
            hidden = tr("Cut off: {parts}").format(parts=", ".join(names)) if names else ""
            self._more.set_label(tr("More"), icon="caret-double-down")
            self._more.setAccessibleName(". ".join(part for part in (words, hidden) if part))
            self._more.setToolTip("\n".join(part for part in (words, hidden) if part))

    @property
    def is_cut(self) -> bool:
        return not self._more.isHidden() and not self._drawer

    def cut_off(self) -> list[str]:
        """Names of some widgets cut off because the dock is too small; scrollable ones do not count."""
        visible_rect = self._content.rect()
        names = []
        layout = self._panel.layout()
        if layout is not None:
            layout.activate()
        for part in self._panel.findChildren(QWidget):
            if not isinstance(part, QAbstractButton | QLineEdit | QAbstractSlider | QLabel) or not part.isVisibleTo(
                self._panel
            ):
                continue
            if self._scrolls(part):
                continue
            name = part.accessibleName() or (part.text() if isinstance(part, QAbstractButton | QLabel) else "")
            place = part.rect().translated(part.mapTo(self._content, QPoint(0, 0)))
            if name and not visible_rect.contains(place) and name not in names:
                names.append(name)
        return names[:_MOST_NAMED]

    def _scrolls(self, part: QWidget) -> bool:
        above = part.parentWidget()
        while above is not None and above is not self._panel:
            if isinstance(above, QAbstractScrollArea):
                return True
            above = above.parentWidget()
        return False

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
        self.menu_requested.emit(self.name, self._handle.mapToGlobal(self._handle.rect().bottomLeft()))

    # ---- dragging

    @property
    def _title_bottom(self) -> int:
        """Lower end of the title bar, by which the panel is dragged."""
        return self._title_bar.mapTo(self, QPoint(0, TITLE_PX)).y()

    def mousePressEvent(self, event: QMouseEvent) -> None:
        if event.button() == Qt.MouseButton.LeftButton and event.position().y() < self._title_bottom:
            self._pressed_at = event.globalPosition().toPoint()

    def mouseMoveEvent(self, event: QMouseEvent) -> None:
        at = event.globalPosition().toPoint()
        if self._pressed_at is None:
            return
        if self._dragging or self._is_far(at):
            self._dragging = True
            self.drag_moved.emit(self.name, at)

    def _is_far(self, at: QPoint) -> bool:
        pressed_at = self._pressed_at
        return pressed_at is not None and (at - pressed_at).manhattanLength() >= QApplication.startDragDistance()

    def mouseReleaseEvent(self, event: QMouseEvent) -> None:
        at = event.globalPosition().toPoint()
        # A quick release can precede the first move event.
        dragging, pressed_at = self._dragging or self._is_far(at), self._pressed_at
        self._dragging, self._pressed_at = False, None
        if dragging:
            self.drag_dropped.emit(self.name, at)
        elif pressed_at is not None and self._is_handle(pressed_at):
            self._open_menu()

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        if event.position().y() < self._title_bottom:
            self.float_requested.emit(self.name)

    def contextMenuEvent(self, event: QContextMenuEvent) -> None:
        if event.y() < self._title_bottom:
            self.menu_requested.emit(self.name, event.globalPos())

    # ---- Qt events

    def closeEvent(self, event: QCloseEvent) -> None:
        event.ignore()
        self.close_requested.emit(self.name)

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        self._panel.set_in_view(True)

    def hideEvent(self, event: QHideEvent) -> None:
        super().hideEvent(event)
        self._panel.set_in_view(False)

    def _on_title_changed(self, title: str) -> None:
        self.setWindowTitle(title)
        self.set_place(floating=self._floating, locked=self._float.isHidden())
