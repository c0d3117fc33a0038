"""Emergency stop button over modal dialogs, which block the window that holds the red button."""

from PySide6.QtCore import QObject, QPoint, Qt, Signal
from PySide6.QtWidgets import QApplication, QWidget

from caris_desktop.ui import layouts
from caris_desktop.ui.input.drive_input_filter import DriveInputFilter
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton


class EmergencyOverDialogs(QObject):
    """Shows a copy of the red button in a small window owned by the dialog, over the blocked one.

    A modal dialog blocks every window except its own children. Where the system does not let a program position its
    windows (Wayland), it appears where the compositor puts it.
    """

    pressed = Signal()

    def __init__(self, theme: Theme, button: ActionButton, hold: DriveInputFilter) -> None:
        super().__init__(button)
        self._theme = theme
        self._button = button
        self._copy: QWidget | None = None
        hold.windows_changed.connect(self._follow)

    def _follow(self) -> None:
        dialog = QApplication.activeModalWidget()
        if self._copy is not None and (dialog is None or self._copy.parentWidget() is not dialog):
            self._copy.hide()
            self._copy.deleteLater()
            self._copy = None
        if dialog is not None and self._copy is None and self._button.isVisible():
            self._copy = self._copy_for(dialog)

    def _copy_for(self, dialog: QWidget) -> QWidget:
        flags = Qt.WindowType.Tool | Qt.WindowType.FramelessWindowHint | Qt.WindowType.WindowDoesNotAcceptFocus
        window = QWidget(dialog, flags)
        window.setObjectName("emergency_over_dialog")
        window.setAttribute(Qt.WidgetAttribute.WA_ShowWithoutActivating)
        window.setAttribute(Qt.WidgetAttribute.WA_TranslucentBackground)
        window.destroyed.connect(self._on_copy_destroyed)
        button = ActionButton(self._theme, self._button.text(), key=self._button.key, role="danger", height_px=40)
        button.setObjectName("emergency_stop_copy")
        button.setToolTip(self._button.toolTip())
        button.pressed.connect(self.pressed)
        layout = layouts.vbox(window, margins_px=0)
        layout.addWidget(button)
        window.resize(self._button.size())
        window.move(self._button.mapToGlobal(QPoint(0, 0)))
        window.show()
        return window

    def _on_copy_destroyed(self) -> None:
        # Destroyed together with its dialog.
        self._copy = None
