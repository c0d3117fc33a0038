"""Texts for the wizard in their language. Plain Python: what translates is given by whoever has it.

Qt's ``lupdate`` finds each text that is written as a literal in ``tr("...")``, or, where it is only looked up later as
in a table at the top of a module, in ``QT_TR_NOOP("...")``. A text is one whole sentence or label: what varies in it
stands as ``{name}`` and is filled with ``str.format`` after it was translated, and a number that decides between one
and many as ``%n``.

A process that speaks English, or a room that does not know who will read it, says ``filled(QT_TR_NOOP("..."),
name=value)``: the English sentence, which still has its text and its values apart, so that ``tr`` can say it anew. The
number of one and many stands in the mark there, as it does in ``tr``: ``QT_TR_NOOP("%n pictures are lost.", "", 3)``.
What is marked stays a text of the program wherever it goes, as a value of another sentence too; all else is data.
Files keep the English sentence alone; ``refilled`` finds text and values in it again.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from functools import cache, lru_cache
from typing import Self

_NUMBER = "%n"
_PLACE = re.compile(rf"\{{(\w+)\}}|{_NUMBER}")

Translator = Callable[[str, str, int], str]
"""Given a text, a word on how it is meant where that is needed, and the number for ``%n`` (-1: none)."""


def _as_written(text: str, _meant: str, number: int) -> str:
    return text.replace("%n", str(number)) if number >= 0 else text


class _Used:
    translator: Translator = staticmethod(_as_written)


def use_translator(translator: Translator | None) -> None:
    """Whoever shows texts from now on shows what this makes of them; None for English."""
    _Used.translator = staticmethod(translator or _as_written)


def speaks_english() -> bool:
    """Whether texts are shown as they are written."""
    return _Used.translator is _as_written


def tr(text: str, meant: str = "", number: int = -1) -> str:
    """``text`` in the wizard's language. ``meant`` tells apart two meanings of one English text."""
    if not text:
        return ""
    if isinstance(text, Filled):
        if not text.values:
            return _Used.translator(text.template, meant, number)
        number = int(text.values.get(_NUMBER, number))
        return _fill(_Used.translator(text.template, meant, number), text.values, tr)
    return _Used.translator(text, meant, number)


def tr_filled(text: str) -> str:
    """For a list that holds texts of the program and words of others: ``tr`` for what is ``Filled``; others stay."""
    return tr(text) if isinstance(text, Filled) else text


def QT_TR_NOOP(text: str, _meant: str = "", number: int = -1) -> str:  # noqa: N802 - by this name lupdate finds it
    """Marks a text that ``tr`` is given later; one with ``%n`` keeps the number for it.

    It stays a text of the program wherever it goes: one that is filled into another is translated with it.
    """
    return Filled(text, {_NUMBER: str(number)}) if number >= 0 else Filled.marked(text)


_NOTHING: Mapping[str, str] = {}


class Filled(str):
    """An English text of the program, with values in it or none, which keeps both apart for whoever translates it.

    ``template`` is the text as it is looked up, ``values`` what stands in its ``{names}``: data, put in as it is. One
    that is filled itself is translated too. It travels to other processes as these two, and is recorded as plain text.
    """

    template: str
    values: Mapping[str, str]

    def __new__(cls, template: str, values: Mapping[str, str]) -> Self:
        self = super().__new__(cls, _fill(template, values, lambda one: one))
        self.template, self.values = template, dict(values)
        return self

    @classmethod
    def marked(cls, text: str) -> Self:
        """With nothing in it yet: quickly, as every table of texts is made of these when its module is read."""
        self = super().__new__(cls, text)
        self.template, self.values = text, _NOTHING
        return self

    def __str__(self) -> str:
        return self  # and so does the error that it is the words of

    def __reduce__(self) -> tuple[type["Filled"], tuple[str, dict[str, str]]]:
        return Filled, (self.template, dict(self.values))


def filled(text: str, /, **values: object) -> Filled:
    """``text``, marked by ``QT_TR_NOOP``, with its ``{names}`` filled; those that are not given yet stay."""
    before = text.values if isinstance(text, Filled) else {}
    return Filled(
        text.template if isinstance(text, Filled) else text,
        {**before, **{name: str(value) for name, value in values.items()}},
    )


def refilled(sentence: str, texts: tuple[str, ...]) -> str:
    """A sentence that was kept as plain text, with its text and values apart again; as it is where it is none of
    ``texts``. The longest that fits counts, and a value that is one of them itself is refilled too.
    """
    if isinstance(sentence, Filled):
        return sentence
    for text, pieces in _by_length(texts):
        if all(map(sentence.__contains__, pieces)) and (found := _pattern(text).fullmatch(sentence)):
            values = found.groupdict()
            number = values.pop(_NUMBER_GROUP, None)
            told = {name: refilled(value, texts) for name, value in values.items()}
            return Filled(text, told if number is None else {_NUMBER: number, **told})
    return sentence


def joined(sentences: Iterable[str], between: str = " ") -> Filled:
    """Several in a row, each of which keeps what it is filled with."""
    values = {f"part_{number}": sentence for number, sentence in enumerate(sentences)}
    return Filled(between.join(f"{{{name}}}" for name in values), values)


_NUMBER_GROUP = "_number"


@lru_cache
def _by_length(texts: tuple[str, ...]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Each with the pieces between its values, the one with the most words of its own first."""
    templates = {text.template if isinstance(text, Filled) else text for text in texts}
    by_length = sorted(templates, key=lambda text: (-len(_PLACE.sub("", text)), text))
    return tuple((text, tuple(filter(None, _PLACE.sub("\n", text).split("\n")))) for text in by_length)


@cache
def _pattern(text: str) -> re.Pattern[str]:
    """What it reads like once it is filled. To make one costs more than to see that its pieces are not there."""
    pieces, end, known = list[str](), 0, set[str]()
    for place in _PLACE.finditer(text):
        name = place[1] or _NUMBER_GROUP
        pieces.append(re.escape(text[end : place.start()]))
        pieces.append(f"(?P={name})" if name in known else f"(?P<{name}>{'.+?' if place[1] else '[0-9]+'})")
        known.add(name)
        end = place.end()
    return re.compile("".join((*pieces, re.escape(text[end:]))), re.DOTALL)


def _fill(template: str, values: Mapping[str, str], say: Callable[[str], str]) -> str:
    def one(place: re.Match[str]) -> str:
        value = values.get(place[1] or _NUMBER)
        return place[0] if value is None else say(value) if isinstance(value, Filled) else value

    return _PLACE.sub(one, template)
