"""Error type of language models, and sanitising of external texts for display."""

import unicodedata

from caris_desktop.domain.failure import UserFacingError


class LanguageModelError(UserFacingError):
    """A language model did not answer."""


def shortened(text: str, characters: int = 200) -> str:
    """External text as one readable line."""
    line = " ".join("".join(c if unicodedata.category(c)[0] != "C" else " " for c in text[: 4 * characters]).split())
    return line if len(line) <= characters else line[: characters - 1] + "…"


def without(api_key: str | None, text: str) -> str:
    """``text`` without the key, which some servers repeat."""
    return text.replace(api_key, "[key]") if api_key else text
