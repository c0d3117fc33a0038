"""Check that a message is completely translatable, by formatting it with a translation that marks every text."""

import re
from collections.abc import Callable

from caris_desktop.domain.translation import use_translator

_MARKED = re.compile(r"«[^«»]*»")
_SENTENCE = re.compile(r"[A-Za-z]{2,}(?: [A-Za-z]{2,}){2,}")


def untranslated_part(say: Callable[[], str]) -> list[str]:
    """Sequences of words that no translation contains; placeholders hold data and are ignored."""
    use_translator(lambda text, _context, _number: "".join(map(_marked, re.split(r"(\{\w+\})", text))))
    try:
        left = _MARKED.sub("", say())
    finally:
        use_translator(None)
    return _SENTENCE.findall(left)


def _marked(part: str) -> str:
    return part if not part or part.startswith("{") else f"«{part}»"
