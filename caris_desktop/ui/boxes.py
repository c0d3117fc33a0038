"""Columns and rows of widgets, with the room around and between them; None is what the style has."""

from PySide6.QtWidgets import QBoxLayout, QHBoxLayout, QVBoxLayout, QWidget

Margins = int | tuple[int, int, int, int]
"""The same on every side; or left, above, right, below."""


def column(
    holder: QWidget | None = None, *, margins_px: Margins | None = None, spacing_px: int | None = None
) -> QVBoxLayout:
    """That of ``holder``, or one to lie in another layout."""
    layout = QVBoxLayout() if holder is None else QVBoxLayout(holder)
    _give_room(layout, margins_px, spacing_px)
    return layout


def row(
    holder: QWidget | None = None, *, margins_px: Margins | None = None, spacing_px: int | None = None
) -> QHBoxLayout:
    """That of ``holder``, or one to lie in another layout."""
    layout = QHBoxLayout() if holder is None else QHBoxLayout(holder)
    _give_room(layout, margins_px, spacing_px)
    return layout


def _give_room(layout: QBoxLayout, margins_px: Margins | None, spacing_px: int | None) -> None:
    if margins_px is not None:
        left, above, right, below = (margins_px,) * 4 if isinstance(margins_px, int) else margins_px
        layout.setContentsMargins(left, above, right, below)
    if spacing_px is not None:
        layout.setSpacing(spacing_px)
