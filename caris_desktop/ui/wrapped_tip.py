"""Long tooltips, on as many lines as they take: Qt breaks only the lines of HTML, which a tooltip here never is."""

import textwrap

from PySide6.QtWidgets import QWidget

_LINE_CHARACTERS = 70


def wrapped_tip(*texts: str) -> str:
    """Each of ``texts`` that is not empty begins a line of its own."""
    lines = "\n".join(filter(None, texts)).splitlines()
    return "\n".join(textwrap.fill(line, _LINE_CHARACTERS) for line in lines)


def set_wrapped_tip(widget: QWidget, *texts: str) -> None:
    """What a screen reader is told has no line breaks in it."""
    widget.setToolTip(wrapped_tip(*texts))
    widget.setAccessibleDescription(" ".join(filter(None, texts)))
