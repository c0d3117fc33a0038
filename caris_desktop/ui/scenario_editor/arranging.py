"""Widgets that come and go in a form: shown at once, taken away, and reached by Tab as they are read."""

import itertools
from collections.abc import Iterator

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QLayout, QWidget


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


def chain_focus(part: QWidget | None) -> None:
    """Let Tab go through what it holds as it is read, whatever was added last."""
    chain = [
        widget
        for widget in (_as_read(part) if part is not None else ())
        if widget.focusPolicy() & Qt.FocusPolicy.TabFocus
    ]
    for before, after in itertools.pairwise(chain):
        QWidget.setTabOrder(before, after)


def _as_read(widget: QWidget) -> Iterator[QWidget]:
    layout = widget.layout()
    yield widget
    if layout is not None:
        yield from _in_layout(layout)


def _in_layout(layout: QLayout) -> Iterator[QWidget]:
    for number in range(layout.count()):
        item = layout.itemAt(number)
        below, inside = (item.layout(), item.widget()) if item is not None else (None, None)
        if below is not None:
            yield from _in_layout(below)
        elif inside is not None:
            yield from _as_read(inside)
