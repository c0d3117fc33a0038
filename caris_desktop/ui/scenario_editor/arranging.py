"""Widgets that come and go in a form: shown at once, and taken away."""

from PySide6.QtWidgets import QWidget


def drop(part: QWidget) -> None:
    """Take a piece of the form away."""
    part.hide()
    part.setParent(None)
    part.deleteLater()


def show_at_once(part: QWidget) -> None:
    """Qt shows what comes into a layout only with the next event, and what is not shown takes no keys."""
    parent = part.parentWidget()
    if parent is not None and parent.isVisible():
        part.show()
