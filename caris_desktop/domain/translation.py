"""Translation of texts for the wizard. Plain Python: the translator is passed in.

Qt's ``lupdate`` finds each literal in ``tr("...")``, or in ``QT_TR_NOOP("...")`` if it is looked up later, as in a
module-level table. A text is one whole sentence or label: variable parts are ``{name}``, filled with ``str.format``
after translation; a number that selects singular or plural is ``%n``.

A process that speaks English, or a package that does not know its reader, uses ``localized(QT_TR_NOOP("..."),
name=value)``: the English sentence, with text and values still separate, so that ``tr`` can translate it later. The
number of singular or plural is in the marker there, as in ``tr``: ``QT_TR_NOOP("%n pictures are lost.", "", 3)``. A
marked text remains translatable also as a value of another sentence; everything else is data. Files contain the English
sentence only; ``parse_localized`` recovers text and values from it.
"""

import re
from collections.abc import Callable, Iterable, Mapping
from functools import cache, lru_cache
from typing import Self

_NUMBER = "%n"
_PLACE = re.compile(rf"\{{(\w+)\}}|{_NUMBER}")

Translator = Callable[[str, str, int], str]
"""Given a text, a word on its meaning if needed, and the number for ``%n`` (-1: none)."""


def _as_written(text: str, _meant: str, number: int) -> str:
    return text.replace("%n", str(number)) if number >= 0 else text


class _Used:
    translator: Translator = staticmethod(_as_written)


def use_translator(translator: Translator | None) -> None:
    """Translator for all texts shown from now on; None for English."""
    _Used.translator = staticmethod(translator or _as_written)


def speaks_english() -> bool:
    """Whether texts are shown untranslated."""
    return _Used.translator is _as_written


def tr(text: str, meant: str = "", number: int = -1) -> str:
    """``text`` in the wizard's language. ``meant`` distinguishes two meanings of one English text."""
    if not text:
        return ""
    if isinstance(text, LocalizedText):
        if not text.values:
            return _Used.translator(text.template, meant, number)
        number = int(text.values.get(_NUMBER, number))
        return _fill(_Used.translator(text.template, meant, number), text.values, tr)
    return _Used.translator(text, meant, number)


def tr_filled(text: str) -> str:
    """``tr`` for ``LocalizedText`` texts; other texts unchanged. For lists that mix both."""
    return tr(text) if isinstance(text, LocalizedText) else text


def QT_TR_NOOP(text: str, _meant: str = "", number: int = -1) -> str:  # noqa: N802 - by this name lupdate finds it
    """Mark a text for a later ``tr``; one with ``%n`` keeps its number.

    It remains translatable wherever it is passed, also as a value of another text.
    """
    return LocalizedText(text, {_NUMBER: str(number)}) if number >= 0 else LocalizedText.marked(text)


_NOTHING: Mapping[str, str] = {}


class LocalizedText(str):
    """English text of the program, with or without values, which are kept separate for translation.

    ``template`` is the text that is looked up, ``values`` replace its ``{names}``: data, inserted as they are. A value
    that is ``LocalizedText`` is translated too. It is pickled as both, and recorded as plain text.
    """

    template: str
    values: Mapping[str, str]

    def __new__(cls, template: str, values: Mapping[str, str]) -> Self:
        self = super().__new__(cls, _fill(template, values, lambda one: one))
        self.template, self.values = template, dict(values)
        return self

    @classmethod
    def marked(cls, text: str) -> Self:
        """Text without values; fast, since every table of texts creates these at import."""
        self = super().__new__(cls, text)
        self.template, self.values = text, _NOTHING
        return self

    def __str__(self) -> str:
        return self  # and so does the error of which this is the text

    def __reduce__(self) -> tuple[type["LocalizedText"], tuple[str, dict[str, str]]]:
        return LocalizedText, (self.template, dict(self.values))


def localized(text: str, /, **values: object) -> LocalizedText:
    """``text``, marked by ``QT_TR_NOOP``, with its ``{names}`` filled; missing ones remain."""
    before = text.values if isinstance(text, LocalizedText) else {}
    return LocalizedText(
        text.template if isinstance(text, LocalizedText) else text,
        {**before, **{name: str(value) for name, value in values.items()}},
    )


def parse_localized(sentence: str, texts: tuple[str, ...]) -> str:
    """Recover text and values of a sentence stored as plain text; unchanged if it matches none of ``texts``. The
    longest match counts, and values that match are recovered too.
    """
    if isinstance(sentence, LocalizedText):
        return sentence
    for text, pieces in _by_length(texts):
        if all(map(sentence.__contains__, pieces)) and (found := _pattern(text).fullmatch(sentence)):
            values = found.groupdict()
            number = values.pop(_NUMBER_GROUP, None)
            recovered = {name: parse_localized(value, texts) for name, value in values.items()}
            return LocalizedText(text, recovered if number is None else {_NUMBER: number, **recovered})
    return sentence


def joined(sentences: Iterable[str], between: str = " ") -> LocalizedText:
    """Several sentences joined, each with its values."""
    values = {f"part_{number}": sentence for number, sentence in enumerate(sentences)}
    return LocalizedText(between.join(f"{{{name}}}" for name in values), values)


_NUMBER_GROUP = "_number"


@lru_cache
def _by_length(texts: tuple[str, ...]) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Each text with its fixed pieces, the one with the most fixed text first."""
    templates = {text.template if isinstance(text, LocalizedText) else text for text in texts}
    by_length = sorted(templates, key=lambda text: (-len(_PLACE.sub("", text)), text))
    return tuple((text, tuple(filter(None, _PLACE.sub("\n", text).split("\n")))) for text in by_length)


@cache
def _pattern(text: str) -> re.Pattern[str]:
    """Pattern of the filled text. Building it costs more than checking its pieces first."""
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
        return place[0] if value is None else say(value) if isinstance(value, LocalizedText) else value

    return _PLACE.sub(one, template)
