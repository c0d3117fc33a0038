"""What a language model's failure is called, and texts from outside made fit to be shown."""

import unicodedata

from caris_desktop.domain.failure import ToldFailure


class LanguageModelError(ToldFailure):
    """A language model did not answer."""


def shortened(text: str, characters: int = 200) -> str:
    """One readable line of a text that came from outside."""
    line = " ".join("".join(c if unicodedata.category(c)[0] != "C" else " " for c in text[: 4 * characters]).split())
    return line if len(line) <= characters else line[: characters - 1] + "…"


def without(api_key: str | None, text: str) -> str:
    """``text`` with the key struck out, as some servers repeat it."""
    return text.replace(api_key, "[key]") if api_key else text
