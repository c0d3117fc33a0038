"""XML-safe ids, unique per document, and quoted names in messages."""

import re
from collections.abc import Iterable

from caris_desktop.domain.translation import QT_TR_NOOP, LocalizedText, localized


def id_part(coder: str) -> str:
    """XML-safe id from a coder's name: letters, digits, hyphens, and no leading digit."""
    return "c-" + (re.sub(r"[^A-Za-z0-9]+", "-", coder).strip("-")[:30] or "coder")


def next_id(prefix: str, taken: Iterable[str]) -> str:
    """Next numbered id. It is higher than all present ones, so that an id keeps its meaning for people."""
    numbers = [item[len(prefix) :] for item in taken if item.startswith(prefix)]
    return f"{prefix}{max((int(number) for number in numbers if number.isascii() and number.isdigit()), default=0) + 1}"


def untaken(name: str, taken: Iterable[str]) -> str:
    taken = taken if isinstance(taken, (set, dict)) else set(taken)
    candidate, number = name, 2
    while candidate in taken:
        candidate, number = f"{name}-{number}", number + 1
    return candidate


def quoted(text: str) -> str:
    """Quote a text for messages: one line, shortened."""
    if isinstance(text, LocalizedText):
        return localized(QT_TR_NOOP("“{name}”"), name=text)
    text = " ".join(text.split())
    return f"“{text[:40]}…”" if len(text) > 41 else f"“{text}”"
