"""What the parts of the window that paint themselves are to a screen reader. Qt takes whatever it does not know for a
``Client``, of which a screen reader says nothing.

A widget class says it in ``accessible_role`` (a widget of a class that is not ours: :func:`has_role`), and, where its
name does not tell what it shows, in ``accessible_words()``, which is asked only when somebody wants to hear it; a
description that it is given beside them makes a screen reader ask.
"""

from PySide6.QtCore import QObject
from PySide6.QtGui import QAccessible, QAccessibleInterface
from PySide6.QtWidgets import QAccessibleWidget, QWidget

_ROLE = "accessible_role"


class _Interface(QAccessibleWidget):
    """Holds nothing of its widget, which lives no longer because of it."""

    def text(self, kind: QAccessible.Text) -> str:
        words = getattr(self.object(), "accessible_words", None) if kind == QAccessible.Text.Description else None
        return super().text(kind) if words is None else str(words())


def install_accessible_roles() -> None:
    """Once for the application, before the first widget is shown; PySide keeps what it is given here."""
    if not _installed:
        _installed.append(_interface)
        QAccessible.installFactory(_interface)


_installed: list[object] = []


def has_role(widget: QWidget, role: QAccessible.Role) -> None:
    """Before its name, which may be asked for at once."""
    setattr(widget, _ROLE, role)


def _interface(_class_name: str, thing: QObject | None) -> QAccessibleInterface | None:
    """Asked for each class of a widget, the most special one first."""
    role = getattr(thing, _ROLE, None)
    if role is None or not isinstance(thing, QWidget):
        return None
    return _Interface(thing, role)
