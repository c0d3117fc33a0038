"""Tooltips with line breaks: Qt wraps HTML tooltips only, and these are plain text."""

import textwrap

from PySide6.QtWidgets import QWidget

_LINE_CHARACTERS = 70


def wrapped_tip(*texts: str) -> str:
    """Wrap ``texts``, each on a new line; empty ones are skipped."""
    lines = "\n".join(filter(None, texts)).splitlines()
    return "\n".join(textwrap.fill(line, _LINE_CHARACTERS) for line in lines)


def set_wrapped_tip(widget: QWidget, *texts: str) -> None:
    """Set the tooltip; the accessible description has no line breaks."""
    widget.setToolTip(wrapped_tip(*texts))
    widget.setAccessibleDescription(" ".join(filter(None, texts)))
