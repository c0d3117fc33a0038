"""Gaps in what is to be said, as in "Hello, {name}!": what fills them in, spoken and as it is recorded."""

import re
from collections.abc import Callable, Mapping

from caris_desktop.domain import person_marks
from caris_desktop.domain.value_class import dataclass

NAME, PLACE = "name", "place"
"""What the console can fill in by itself."""
_GAP = re.compile(r"\{([a-z][a-z ]{0,38})\}")


@dataclass(frozen=True, slots=True)
class Words:
    """The same words as they are spoken and as they are recorded, where ids stand in place of names."""

    spoken: str
    recorded: str


def gaps(text: str) -> tuple[str, ...]:
    """What is to be filled in, each once, in order. Marks of people are none."""
    return tuple(dict.fromkeys(_GAP.findall(text)))


def missing(text: str, words: Mapping[str, Words]) -> tuple[str, ...]:
    """The gaps for which there are no words."""
    return tuple(gap for gap in gaps(text) if gap not in words)


def filled(text: str, words: Mapping[str, Words], name_of: Callable[[str], str]) -> Words:
    """``text`` with the words in its gaps; ``name_of`` gives what is spoken for a person's mark that it holds."""
    spoken = _GAP.sub(lambda gap: words[gap[1]].spoken if gap[1] in words else gap[0], text)
    recorded = _GAP.sub(lambda gap: words[gap[1]].recorded if gap[1] in words else gap[0], text)
    return Words(person_marks.with_names(spoken, name_of), recorded)
