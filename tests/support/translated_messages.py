"""Whether all of a message is translatable: said once more with every text of a translation in marks."""

import re
from collections.abc import Callable

from caris_desktop.domain.translation import use_translator

_MARKED = re.compile(r"«[^«»]*»")
_SENTENCE = re.compile(r"[A-Za-z]{2,}(?: [A-Za-z]{2,}){2,}")


def untranslated_part(say: Callable[[], str]) -> list[str]:
    """Words in a row that no translation has; what the texts are filled with is data, and none."""
    use_translator(lambda text, _meant, _number: "".join(map(_marked, re.split(r"(\{\w+\})", text))))
    try:
        left = _MARKED.sub("", say())
    finally:
        use_translator(None)
    return _SENTENCE.findall(left)


def _marked(part: str) -> str:
    return part if not part or part.startswith("{") else f"«{part}»"
