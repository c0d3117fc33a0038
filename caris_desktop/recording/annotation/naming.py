"""Ids as XML can hold them, each given once; and how messages show a name."""

import re
from collections.abc import Iterable

from caris_desktop.domain.translation import QT_TR_NOOP, Filled, filled


def id_part(coder: str) -> str:
    """Ids are those of XML too: letters, digits, hyphens, and no digit first."""
    return "c-" + (re.sub(r"[^A-Za-z0-9]+", "-", coder).strip("-")[:30] or "coder")


def next_id(prefix: str, taken: Iterable[str]) -> str:
    """Numbers are not used again while a higher one is there, so that an id keeps its meaning in the eyes of people."""
    numbers = [item[len(prefix) :] for item in taken if item.startswith(prefix)]
    return f"{prefix}{max((int(number) for number in numbers if number.isascii() and number.isdigit()), default=0) + 1}"


def untaken(name: str, taken: Iterable[str]) -> str:
    taken = taken if isinstance(taken, (set, dict)) else set(taken)
    candidate, number = name, 2
    while candidate in taken:
        candidate, number = f"{name}-{number}", number + 1
    return candidate


def quoted(text: str) -> str:
    """As messages show it: one line, not too long."""
    if isinstance(text, Filled):
        return filled(QT_TR_NOOP("“{name}”"), name=text)
    text = " ".join(text.split())
    return f"“{text[:40]}…”" if len(text) > 41 else f"“{text}”"
