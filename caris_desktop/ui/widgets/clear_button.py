"""The button in a field that empties it, with a name: Qt gives it none."""

from PySide6.QtWidgets import QLineEdit, QToolButton

from caris_desktop.domain.translation import tr


def add_clear_button(field: QLineEdit) -> None:
    field.setClearButtonEnabled(True)
    for button in field.findChildren(QToolButton):
        button.setAccessibleName(tr("Empty the field: {field}").format(field=field.accessibleName()))
