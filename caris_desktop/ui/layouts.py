"""QVBoxLayout and QHBoxLayout with margins and spacing in px; None keeps the style's default."""

from PySide6.QtWidgets import QBoxLayout, QHBoxLayout, QVBoxLayout, QWidget

Margins = int | tuple[int, int, int, int]
"""Equal on all sides; or left, top, right, bottom."""


def vbox(
    holder: QWidget | None = None, *, margins_px: Margins | None = None, spacing_px: int | None = None
) -> QVBoxLayout:
    """Vertical layout of ``holder``, or one without a parent."""
    layout = QVBoxLayout() if holder is None else QVBoxLayout(holder)
    _give_room(layout, margins_px, spacing_px)
    return layout


def hbox(
    holder: QWidget | None = None, *, margins_px: Margins | None = None, spacing_px: int | None = None
) -> QHBoxLayout:
    """Horizontal layout of ``holder``, or one without a parent."""
    layout = QHBoxLayout() if holder is None else QHBoxLayout(holder)
    _give_room(layout, margins_px, spacing_px)
    return layout


def _give_room(layout: QBoxLayout, margins_px: Margins | None, spacing_px: int | None) -> None:
    if margins_px is not None:
        left, above, right, below = (margins_px,) * 4 if isinstance(margins_px, int) else margins_px
        layout.setContentsMargins(left, above, right, below)
    if spacing_px is not None:
        layout.setSpacing(spacing_px)
