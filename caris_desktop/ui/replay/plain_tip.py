"""Texts from files in tooltips, which Qt reads as HTML where they look like it."""

import html

from PySide6.QtGui import Qt
from PySide6.QtWidgets import QWidget


def plain_tip(text: str) -> str:
    """A tooltip that shows ``text`` letter by letter."""
    return f"<p>{html.escape(text)}</p>" if Qt.mightBeRichText(text) else text


def wrapped_tip(text: str) -> str:
    """Like :func:`plain_tip`, and on as many lines as a long text takes: Qt breaks only the lines of HTML."""
    return f"<p>{html.escape(text)}</p>"


def set_wrapped_tip(widget: QWidget, *texts: str) -> None:
    """Each as a paragraph of its tooltip. A screen reader gets the words: Qt would tell it the HTML."""
    texts = tuple(filter(None, texts))
    widget.setToolTip("".join(map(wrapped_tip, texts)))
    widget.setAccessibleDescription(" ".join(texts))
