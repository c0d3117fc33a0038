"""Finds sessions of a study by what heads them and by what was said in them: an index that the folders can rebuild."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class SessionEntry:
    """One session as the list shows it."""

    folder: Path
    started_utc: str
    duration_s: float
    participant: str = ""
    condition: str = ""
    trial: str = ""
    recording: str = ""
    wizard: str = ""
    scenario: str = ""
    purpose: str = ""
    closed_properly: bool = True
    size_bytes: int = 0
    utterances: int = 0
    marks: int = 0
    problems: int = 0


@dataclass(frozen=True, slots=True)
class SessionQuery:
    """What to find; empty fields do not matter. ``text`` is searched in everything said, noted and marked."""

    text: str = ""
    participant: str = ""
    condition: str = ""
    wizard: str = ""
    scenario: str = ""
    purpose: str = ""


@dataclass(frozen=True, slots=True)
class SearchHit:
    """Where a text was found: ``at_ns`` of that session's clock. ``snippet`` has the words around it."""

    folder: Path
    at_ns: int
    session_s: float
    kind: str
    snippet: str
