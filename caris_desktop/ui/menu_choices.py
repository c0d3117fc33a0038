"""Checkable entries of menus."""

from collections.abc import Callable, Iterable

from PySide6.QtGui import QAction, QActionGroup
from PySide6.QtWidgets import QMenu


def add_choices(menu: QMenu, choices: Iterable[tuple[str, bool, Callable[[], object]]]) -> list[QAction]:
    """Add alternatives, of which one holds: text, whether it holds, and what choosing it does."""
    group = QActionGroup(menu)
    actions = []
    for text, holds, choose in choices:
        action = menu.addAction(text)
        action.setCheckable(True)
        action.setChecked(holds)
        action.setActionGroup(group)
        action.triggered.connect(lambda _checked=False, choose=choose: choose())
        actions.append(action)
    return actions


def add_switch(menu: QMenu, text: str, on: bool, use: Callable[[bool], object]) -> None:
    action = menu.addAction(text)
    action.setCheckable(True)
    action.setChecked(on)
    action.triggered.connect(use)
