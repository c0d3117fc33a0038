"""Classes of the package that are windows, dialogs or popups, found by introspection."""

import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from functools import cache

from PySide6.QtWidgets import QDialog, QMainWindow, QMenu, QWidget

from caris_desktop import ui
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.widgets.popups import FloatingCard

_WINDOWS = (QDialog, QMainWindow, QMenu, Overlay, FloatingCard)


@cache
def window_classes() -> tuple[type[QWidget], ...]:
    """Subclasses of Qt's windows and of the program's popups, and widgets that set a window's title or type; not the
    base classes.
    """
    return tuple(filter(_is_window, widget_classes()))


@cache
def widget_classes() -> tuple[type[QWidget], ...]:
    for module in pkgutil.walk_packages(ui.__path__, f"{ui.__name__}."):
        importlib.import_module(module.name)
    return tuple(sorted(set(_below(QWidget)), key=lambda kind: kind.__name__))


def _below(base: type[QWidget]) -> Iterator[type[QWidget]]:
    for kind in base.__subclasses__():
        if kind.__module__.startswith("caris_desktop."):
            yield kind
        yield from _below(kind)


def _is_window(kind: type[QWidget]) -> bool:
    source = inspect.getsource(kind)
    of_its_own = "self.setWindowTitle(" in source or ("super().__init__(" in source and "Qt.WindowType." in source)
    return (issubclass(kind, _WINDOWS) or of_its_own) and not kind.__subclasses__()
