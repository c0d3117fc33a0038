"""Placeholders in phrases, as in "Hello, {name}!": detection and filling, for speech and for the record."""

import re
from collections.abc import Callable, Mapping

from caris_desktop.domain import person_marks
from caris_desktop.domain.value_class import Value

NAME, PLACE = "name", "place"
"""Placeholders the console can fill."""
_GAP = re.compile(r"\{([a-z][a-z ]{0,38})\}")


class Words(Value):
    """Text as spoken and as recorded, with ids instead of names."""

    spoken: str
    recorded: str


def gaps(text: str) -> tuple[str, ...]:
    """Placeholders in order, without duplicates or person marks."""
    return tuple(dict.fromkeys(_GAP.findall(text)))


def missing(text: str, words: Mapping[str, Words]) -> tuple[str, ...]:
    """Placeholders without a value."""
    return tuple(gap for gap in gaps(text) if gap not in words)


def fill_placeholders(text: str, words: Mapping[str, Words], name_of: Callable[[str], str]) -> Words:
    """Fill the placeholders of ``text``; ``name_of`` returns the spoken name for a person mark."""
    spoken = _GAP.sub(lambda gap: words[gap[1]].spoken if gap[1] in words else gap[0], text)
    recorded = _GAP.sub(lambda gap: words[gap[1]].recorded if gap[1] in words else gap[0], text)
    return Words(person_marks.with_names(spoken, name_of), recorded)
