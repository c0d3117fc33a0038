"""Clear button of a line edit with an accessible name, which Qt's own lacks."""

from PySide6.QtWidgets import QLineEdit, QToolButton

from caris_desktop.domain.translation import tr


def add_clear_button(field: QLineEdit) -> None:
    field.setClearButtonEnabled(True)
    for button in field.findChildren(QToolButton):
        button.setAccessibleName(tr("Clear the field: {field}").format(field=field.accessibleName()))
