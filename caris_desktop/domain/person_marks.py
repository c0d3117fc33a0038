"""Markers that replace a person's name in recorded utterances: pseudonymised by their id."""

import re
from collections.abc import Callable

_MARK = re.compile(r"\{(p-[\w-]+)\}")


def mark_of(person_id: str) -> str:
    """Marker in place of this person's name: ``{p-3f9a}``."""
    return f"{{{person_id}}}"


def marked(text: str, name: str, person_id: str) -> str:
    """``text`` with this person's marker in place of their name."""
    return re.sub(rf"(?<!\w){re.escape(name)}(?!\w)", lambda _name: mark_of(person_id), text, flags=re.IGNORECASE)


def with_names(text: str, name_of: Callable[[str], str]) -> str:
    """``text`` with the result of ``name_of`` for each person id in place of the markers."""
    return _MARK.sub(lambda mark: name_of(mark[1]), text)
