"""Translation of recorded sentences: plain English in the record, matched to the program's texts and values, so that
``tr`` can translate them for the viewer of a replay.
"""

import json
from functools import cache, lru_cache

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.translation import LocalizedText, joined, parse_localized, speaks_english

_LONGEST, _MOST_ENDS = 500, 8
"""A longer text, or one of more sentences, was written by a person, and would be slow to search: minutes for 80."""

TEXTS_PATH = resources_dir() / "recorded-texts.json"
EARLIER_PATH = resources_dir() / "earlier-texts.json"
"""Reworded texts: the wording of older sessions and the present one, with the same values."""


def retranslate(sentence: str) -> str:
    """Sentence for ``tr``; unchanged in English, or if it matches no text with values."""
    foreign = not 0 < len(sentence) <= _LONGEST or sentence.count(". ") > _MOST_ENDS
    return sentence if speaks_english() or foreign else _found(sentence)


@lru_cache(maxsize=2048)
def _found(sentence: str) -> str:
    end = sentence.find(". ")
    while end >= 0:
        # Two sentences, event and advice: a text that ends in a value would match both together.
        both = _found(sentence[: end + 1]), _found(sentence[end + 2 :])
        if all(isinstance(one, LocalizedText) for one in both):
            return joined(both)
        end = sentence.find(". ", end + 1)
    return parse_recorded(sentence, _texts())


def parse_recorded(sentence: str, texts: tuple[str, ...]) -> str:
    """``parse_localized`` for sentences from a file, which may have an earlier wording of one of ``texts``."""
    return _present(parse_localized(sentence, _with_earlier(texts)))


def _present(sentence: str) -> str:
    if not isinstance(sentence, LocalizedText):
        return sentence
    values = {name: _present(value) for name, value in sentence.values.items()}
    return LocalizedText(_earlier().get(sentence.template, sentence.template), values)


@cache
def _with_earlier(texts: tuple[str, ...]) -> tuple[str, ...]:
    present = set(map(str, texts))
    return (*texts, *(before for before, now in _earlier().items() if now in present))


@cache
def _texts() -> tuple[str, ...]:
    return tuple(json.loads(TEXTS_PATH.read_text(encoding="utf-8")))


@cache
def _earlier() -> dict[str, str]:
    texts: dict[str, str] = json.loads(EARLIER_PATH.read_text(encoding="utf-8"))
    return texts
