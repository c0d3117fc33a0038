"""Face window for a screen on the robot. It never takes the keyboard focus from driving."""

from typing import Any

from PySide6.QtCore import Qt, Signal
from PySide6.QtGui import QAccessible, QCloseEvent, QGuiApplication, QMouseEvent, QScreen
from PySide6.QtWidgets import QWidget

from caris_desktop.domain.translation import tr
from caris_desktop.live.state import LiveState
from caris_desktop.ui import layouts
from caris_desktop.ui.face.face_view import FaceView, show_on


class FaceWindow(QWidget):
    """Full screen on a second screen if there is one. A double click toggles full screen."""

    accessible_role = QAccessible.Role.Window

    closed_by_hand = Signal()

    def __init__(self, state: LiveState, beside: QWidget) -> None:
        super().__init__(None, Qt.WindowType.Window | Qt.WindowType.WindowDoesNotAcceptFocus)
        self.setObjectName("face_window")
        self.setWindowTitle(tr("Robot’s face"))
        self.setAttribute(Qt.WidgetAttribute.WA_ShowWithoutActivating)
        self.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._view = FaceView()
        layout = layouts.vbox(self, margins_px=0)
        layout.addWidget(self._view)
        state.face_drawing.changed.connect(self._on_shown)
        self._on_shown(state.face_drawing.value)
        self._place(beside)

    def _place(self, beside: QWidget) -> None:
        other = next((one for one in QGuiApplication.screens() if one is not beside.screen()), None)
        self.resize(640, 400)
        if other is None:
            corner = beside.screen().availableGeometry().bottomRight()
            self.move(corner.x() - 680, corner.y() - 460)
        else:
            self._fill(other)

    def _fill(self, screen: QScreen) -> None:
        self.setGeometry(screen.geometry())
        self.showFullScreen()

    def _on_shown(self, contents: Any) -> None:
        show_on(self._view, contents)

    def mouseDoubleClickEvent(self, event: QMouseEvent) -> None:
        if self.isFullScreen():
            self.showNormal()
        else:
            self._fill(self.screen())
        event.accept()

    def closeEvent(self, event: QCloseEvent) -> None:
        if event.spontaneous():
            self.closed_by_hand.emit()
        super().closeEvent(event)
