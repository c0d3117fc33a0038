"""The keys go where the wizard sent them by a key, into another window of the console too."""

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication, QWidget


def give_keys(widget: QWidget, reason: Qt.FocusReason = Qt.FocusReason.ShortcutFocusReason) -> None:
    """Give the focus to ``widget`` and the keys to its window.

    Panels have windows of their own, and a focus in a window without the keys gets nothing of what is typed.
    """
    widget.setFocus(reason)
    bring_keys_to(widget.window())


def bring_keys_to(window: QWidget) -> None:
    """Only from another window of the console: no other program loses them, and no dialog that has to be answered."""
    active = QApplication.activeWindow()
    if active is not None and active is not window and QApplication.activeModalWidget() is None:
        window.activateWindow()
