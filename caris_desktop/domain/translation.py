"""Texts for the wizard in their language. Plain Python: what translates is given by whoever has it.

Qt's ``lupdate`` finds each text that is written as a literal in ``tr("...")``, or, where it is only looked up later as
in a table at the top of a module, in ``QT_TR_NOOP("...")``. A text is one whole sentence or label: what varies in it
stands as ``{name}`` and is filled with ``str.format`` after it was translated, and a number that decides between one
and many as ``%n``.
"""

from collections.abc import Callable

Translator = Callable[[str, str, int], str]
"""Given a text, a word on how it is meant where that is needed, and the number for ``%n`` (-1: none)."""


def _as_written(text: str, _meant: str, number: int) -> str:
    return text.replace("%n", str(number)) if number >= 0 else text


class _Used:
    translator: Translator = staticmethod(_as_written)


def use_translator(translator: Translator | None) -> None:
    """Whoever shows texts from now on shows what this makes of them; None for English."""
    _Used.translator = staticmethod(translator or _as_written)


def tr(text: str, meant: str = "", number: int = -1) -> str:
    """``text`` in the wizard's language. ``meant`` tells apart two meanings of one English text."""
    return _Used.translator(text, meant, number) if text else ""


def QT_TR_NOOP(text: str) -> str:  # noqa: N802 - by this name lupdate finds it
    """Marks a text that ``tr`` is given later."""
    return text
