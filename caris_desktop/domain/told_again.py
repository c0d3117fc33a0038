"""Why something happened, out of the record: plain English there, found again as a text of the program with its values,
so that ``tr`` says it in the language of whoever watches the replay.
"""

import json
from functools import cache, lru_cache

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.translation import refilled, speaks_english

TEXTS_PATH = resources_dir() / "recorded-texts.json"


def told_again(sentence: str) -> str:
    """For ``tr``. As it is where nobody needs it, or where it is no text of the program with values in it."""
    return sentence if not sentence or speaks_english() else _found(sentence)


@lru_cache(maxsize=2048)
def _found(sentence: str) -> str:
    return refilled(sentence, _texts())


@cache
def _texts() -> tuple[str, ...]:
    return tuple(json.loads(TEXTS_PATH.read_text(encoding="utf-8")))
