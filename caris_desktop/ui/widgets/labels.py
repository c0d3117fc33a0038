"""Labels and line edits with the looks of the style sheet's roles."""

from typing import Any

from PySide6.QtWidgets import QLabel, QLineEdit, QWidget

FIELD_PX = 36


def label(text: str = "", role: str = "", *, tone: str = "", wraps: bool = False, **qt: Any) -> QLabel:
    """Label of a ``role`` in the style sheet, such as "heading" or "note".

    ``tone``: its colour, such as "dim" or "amber", for a role that sets none. ``qt``: properties, as objectName.
    """
    made = QLabel(text, wordWrap=wraps, **qt)
    made.setProperty("role", role)
    made.setProperty("tone", tone)
    return made


def line_edit(name: str, title: str, text: str = "", **qt: Any) -> QLineEdit:
    """Field with its object name, and its accessible name ``title``. ``qt``: properties and signals."""
    properties: dict[str, Any] = {"objectName": name, "accessibleName": title, **qt}
    field = QLineEdit(text, **properties)
    field.setMinimumHeight(FIELD_PX)
    return field


def restyle(widget: QWidget, **properties: object) -> None:
    """Set properties that the style sheet asks for, as ``role``, and apply it again where they changed."""
    if any(widget.property(name) != value for name, value in properties.items()):
        for name, value in properties.items():
            widget.setProperty(name, value)
        widget.style().unpolish(widget)
        widget.style().polish(widget)
