"""Insertion and removal of form widgets."""

from PySide6.QtWidgets import QWidget


def drop(part: QWidget) -> None:
    """Remove and delete a form widget."""
    part.hide()
    part.setParent(None)
    part.deleteLater()


def show_at_once(part: QWidget) -> None:
    """Show a new form widget now: Qt shows it only with the next event, and a hidden one cannot be focused."""
    parent = part.parentWidget()
    if parent is not None and parent.isVisible():
        part.show()
