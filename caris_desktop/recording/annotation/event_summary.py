"""An event in one line, whatever its type is."""

import dataclasses
import re
from typing import Any

from caris_desktop.domain.actor import CONSOLE, WIZARD
from caris_desktop.domain.geometry import Pose2D

_LONGEST_SUMMARY = 300


def summary_of(value: Any) -> str:
    """What an event says, in one line: its fields but for times and ids, without the names where there is only one; and
    who did it, where that is neither the wizard nor the console.
    """
    parts = [
        (field.name, _cell(getattr(value, field.name)))
        for field in dataclasses.fields(value)
        if not field.name.endswith(("_ns", "_id")) and field.name not in ("sequence", "actor")
    ]
    parts = [(name, text) for name, text in parts if text]
    text = parts[0][1] if len(parts) == 1 else ", ".join(f"{_named(name)}: {_short(text)}" for name, text in parts)
    text = " ".join(text.split()) or type_in_words(type(value))
    actor = getattr(value, "actor", "")
    if actor not in ("", WIZARD, CONSOLE):
        text = f"{text} (by {actor})"
    return text if len(text) <= _LONGEST_SUMMARY else f"{text[: _LONGEST_SUMMARY - 1]}…"


def _named(field: str) -> str:
    return field.replace("_", " ")


def _short(text: str) -> str:
    """The first line, of whole files too."""
    first, _, rest = text.strip().partition("\n")
    return f"{first[:79]}…" if rest or len(first) > 80 else first


def _cell(value: Any) -> str:
    match value:
        case None | "":
            return ""
        case bool():
            return "yes" if value else "no"
        case float():
            return f"{value:.3g}"
        case Pose2D():
            return f"({value.x_m:.2f}, {value.y_m:.2f})"
        case str() | int():
            return str(value)
        case tuple() | list() | dict():
            return f"{len(value)}" if value else ""
        case _:
            return str(value)


def type_in_words(event_type: type[Any]) -> str:
    """``StopRequested`` as ``Stop requested``."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", event_type.__name__).capitalize()
