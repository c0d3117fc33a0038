"""Menus that a window can open, and the names of the menus that its sources create."""

import ast
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from PySide6.QtCore import QPoint
from PySide6.QtGui import QContextMenuEvent
from PySide6.QtWidgets import QAbstractButton, QApplication, QMenu, QWidget

MAKERS = ("QMenu", "as_menu", "_menu")
"""Functions that create a menu."""

_NEAR_THE_CORNER = QPoint(12, 8)


def menus_made(files: Iterable[Path]) -> set[str]:
    """Object names of the menus in the sources; FILE:LINE for a menu without a name."""
    return {name for file in files for name in _made_in(file)}


def _made_in(file: Path) -> Iterator[str]:
    tree = ast.parse(file.read_text("utf-8"))
    for function in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)):
        calls = [node for node in ast.walk(function) if isinstance(node, ast.Call)]
        made = [call for call in calls if _name_of(call.func) in MAKERS]
        named = [call for call in made if _literal(call)]
        set_later = [call for call in calls if _name_of(call.func) in {"setObjectName", "named"} and call.args]
        names = [_literal(call) for call in set_later if _literal(call).endswith("menu")]
        yield from (_literal(call) for call in named)
        yield from names
        if made and len(made) > len(named) + (len(names) or len(set_later)):
            yield f"{file.name}:{made[0].lineno}"


def _literal(call: ast.Call) -> str:
    return next((one.value for one in call.args if isinstance(one, ast.Constant) and isinstance(one.value, str)), "")


def _name_of(function: ast.expr) -> str:
    if isinstance(function, ast.Name):
        return function.id
    return function.attr if isinstance(function, ast.Attribute) else ""


def opened_menus(widgets: Iterable[QWidget], *openers: Callable[[], None]) -> Iterator[QMenu]:
    """Click each button of the widgets and their children, request their context menus, call the ``openers``, and yield
    each menu while it is open.
    """
    for opener in openers:
        opener()
        yield from _open_now()
    for widget in widgets:
        for each in (widget, *widget.findChildren(QWidget)):
            if not each.isVisible() or not each.isEnabled():
                continue
            if isinstance(each, QAbstractButton):
                each.click()
                yield from _open_now()
            if each.isVisible() and "contextMenuEvent" in _methods_of_ours(type(each)):
                for reason in (QContextMenuEvent.Reason.Mouse, QContextMenuEvent.Reason.Keyboard):
                    at = each.mapToGlobal(_NEAR_THE_CORNER)
                    QApplication.sendEvent(each, QContextMenuEvent(reason, _NEAR_THE_CORNER, at))
                    yield from _open_now()


def _open_now() -> Iterator[QMenu]:
    menu = QApplication.activePopupWidget()
    if isinstance(menu, QMenu):
        yield menu
        menu.close()


def _methods_of_ours(kind: type) -> set[str]:
    return {name for one in kind.__mro__ if one.__module__.startswith("caris_desktop") for name in vars(one)}
