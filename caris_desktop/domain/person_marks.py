"""A person's name within what is said: the record has a mark with their id in its place."""

import re
from collections.abc import Callable

_MARK = re.compile(r"\{(p-[\w-]+)\}")


def mark_of(person_id: str) -> str:
    """What stands for the name of this person: ``{p-3f9a}``."""
    return f"{{{person_id}}}"


def marked(text: str, name: str, person_id: str) -> str:
    """``text`` with the mark of this person wherever it has their name."""
    return re.sub(rf"(?<!\w){re.escape(name)}(?!\w)", lambda _name: mark_of(person_id), text, flags=re.IGNORECASE)


def with_names(text: str, name_of: Callable[[str], str]) -> str:
    """``text`` with what ``name_of`` gives for each person's id in place of the marks."""
    return _MARK.sub(lambda mark: name_of(mark[1]), text)
