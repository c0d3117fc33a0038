"""Accessible roles and descriptions of self-painted widgets. Qt reports an unknown class as ``Client``, which screen
readers skip.

A widget class sets ``accessible_role`` (:func:`has_role` for a class that is not ours) and, where its name does not say
what it shows, ``accessible_words()``, which is called only when a screen reader asks; setting a description makes a
screen reader ask. ``accessible_parts()`` returns widgets that Qt does not report: those in a table, which has only
cells.
"""

from collections.abc import Sequence

from PySide6.QtCore import QObject
from PySide6.QtGui import QAccessible, QAccessibleInterface
from PySide6.QtWidgets import QAccessibleWidget, QWidget

_ROLE = "accessible_role"


class _Interface(QAccessibleWidget):
    """Accessible interface that holds no reference to its widget, and so does not prolong its life."""

    def text(self, kind: QAccessible.Text) -> str:
        words = getattr(self.object(), "accessible_words", None) if kind == QAccessible.Text.Description else None
        return super().text(kind) if words is None else str(words())

    def childCount(self) -> int:
        return super().childCount() + len(self._parts())

    def child(self, index: int) -> QAccessibleInterface:
        own = super().childCount()
        return super().child(index) if index < own else QAccessible.queryAccessibleInterface(self._parts()[index - own])

    def _parts(self) -> Sequence[QWidget]:
        parts = getattr(self.object(), "accessible_parts", None)
        return () if parts is None else parts()


def install_accessible_roles() -> None:
    """Install the factory once per application, before the first widget is shown; PySide keeps the reference given
    here.
    """
    if not _installed:
        _installed.append(_interface)
        QAccessible.installFactory(_interface)


_installed: list[object] = []


def has_role(widget: QWidget, role: QAccessible.Role) -> None:
    """Set the role of a widget. Call it before setting the name, because Qt may query the role at once."""
    setattr(widget, _ROLE, role)


def _interface(_class_name: str, thing: QObject | None) -> QAccessibleInterface | None:
    """Accessible interface of a widget; Qt asks for each class of the widget, most derived first."""
    role = getattr(thing, _ROLE, None)
    if role is None or not isinstance(thing, QWidget):
        return None
    return _Interface(thing, role)
