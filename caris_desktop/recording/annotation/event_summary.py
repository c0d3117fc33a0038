"""One-line summaries of events of any type."""

import dataclasses
import re
from typing import Any

from caris_desktop.domain.actor import CONSOLE, WIZARD
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.translation import QT_TR_NOOP

_LONGEST_SUMMARY = 300


EVENTS_IN_WORDS = (
    QT_TR_NOOP("Drive ended"),
    QT_TR_NOOP("Movement changed"),
    QT_TR_NOOP("Stop requested"),
    QT_TR_NOOP("Navigation speed changed"),
    QT_TR_NOOP("Initial pose set"),
    QT_TR_NOOP("Map request changed"),
    QT_TR_NOOP("Mapping changed"),
    QT_TR_NOOP("Places changed"),
    QT_TR_NOOP("Head moved"),
    QT_TR_NOOP("Control used"),
    QT_TR_NOOP("Gamepad changed"),
    QT_TR_NOOP("Response timed"),
    QT_TR_NOOP("Suggestion changed"),
    QT_TR_NOOP("Proposal changed"),
    QT_TR_NOOP("Level changed"),
    QT_TR_NOOP("Voice changed"),
    QT_TR_NOOP("Assistant changed"),
    QT_TR_NOOP("Face changed"),
    QT_TR_NOOP("Person renamed"),
    QT_TR_NOOP("Person suggested"),
    QT_TR_NOOP("Person described"),
    QT_TR_NOOP("Consent noted"),
    QT_TR_NOOP("Person attended"),
    QT_TR_NOOP("Photo taken"),
    QT_TR_NOOP("Photo tagged"),
    QT_TR_NOOP("Photo deleted"),
    QT_TR_NOOP("Step ticked"),
    QT_TR_NOOP("Preflight checked"),
    QT_TR_NOOP("Robot chosen"),
    QT_TR_NOOP("Layout changed"),
    QT_TR_NOOP("Gap"),
    QT_TR_NOOP("Problem"),
    QT_TR_NOOP("Alarm changed"),
    QT_TR_NOOP("Trial resumed"),
    QT_TR_NOOP("Confirmed as before"),
    QT_TR_NOOP("Practice step ended"),
    QT_TR_NOOP("Practice ended"),
)
"""Texts of ``type_in_words`` for events whose tier has no other name, for translators of the timeline."""


def summary_of(value: Any) -> str:
    """Summarise an event: its fields except times and ids, without the field name if there is only one, and the actor
    unless it is the wizard or the console.
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
    """First line, shortened; texts may be whole files."""
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
