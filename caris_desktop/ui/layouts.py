"""QVBoxLayout and QHBoxLayout with items, margins and spacing in px; None keeps the style's default."""

from collections.abc import Callable
from typing import TypeVar

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QBoxLayout, QHBoxLayout, QLayout, QVBoxLayout, QWidget

Margins = int | tuple[int, int, int, int]
"""Equal on all sides; or left, top, right, bottom."""

_Part = TypeVar("_Part", bound=QWidget)

TOP = Qt.AlignmentFlag.AlignTop
Item = QWidget | QLayout | int | tuple[QWidget | QLayout, int] | tuple[QWidget, int, Qt.AlignmentFlag]
"""Widget or layout, one with its stretch factor and alignment, or empty space of a stretch factor."""


def vbox(
    holder: QWidget | None = None, *items: Item, margins_px: Margins | None = None, spacing_px: int | None = None
) -> QVBoxLayout:
    """Vertical layout of ``holder``, or one without a parent."""
    layout = QVBoxLayout() if holder is None else QVBoxLayout(holder)
    _give_room(layout, margins_px, spacing_px)
    fill(layout, *items)
    return layout


def hbox(
    holder: QWidget | None = None, *items: Item, margins_px: Margins | None = None, spacing_px: int | None = None
) -> QHBoxLayout:
    """Horizontal layout of ``holder``, or one without a parent."""
    layout = QHBoxLayout() if holder is None else QHBoxLayout(holder)
    _give_room(layout, margins_px, spacing_px)
    fill(layout, *items)
    return layout


def fill(layout: QBoxLayout, *items: Item) -> None:
    """Append the items to a layout."""
    for item in items:
        part, stretch, *alignment = item if isinstance(item, tuple) else (item, 0)
        if isinstance(part, int):
            layout.addStretch(part)
        elif isinstance(part, QWidget):
            layout.addWidget(part, stretch, *alignment)
        else:
            layout.addLayout(part, stretch)


def adjust_count(parts: list[_Part], count: int, new: Callable[[], _Part]) -> None:
    """Adjust the number of widgets, reusing existing ones."""
    for part in parts[count:]:
        discard(part)
    del parts[count:]
    while len(parts) < count:
        parts.append(new())


def discard(widget: QWidget) -> None:
    """Hide a widget now, and delete it in the next turn of the event loop."""
    widget.hide()
    widget.deleteLater()


def _give_room(layout: QBoxLayout, margins_px: Margins | None, spacing_px: int | None) -> None:
    if margins_px is not None:
        left, above, right, below = (margins_px,) * 4 if isinstance(margins_px, int) else margins_px
        layout.setContentsMargins(left, above, right, below)
    if spacing_px is not None:
        layout.setSpacing(spacing_px)
