"""Query and result types of the study search; cheap to import at window start."""

from pathlib import Path

from caris_desktop.domain.value_class import Value

PLACES_A_PAGE = 500


class SessionEntry(Value):
    """List entry of one session.

    ``losses`` describes missing data, in English and for ``tr``; ``copy_of`` names the original of a copy, as sessions
    count once.
    """

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
    losses: tuple[str, ...] = ()
    copy_of: str = ""


class SessionQuery(Value):
    """Search criteria; empty fields match everything. ``text`` is searched in utterances, notes and marks.

    The other fields are compared completely and case-insensitively, with ``*`` as a wildcard. Each word of ``text``
    must begin a word of one utterance, note or mark. The first ``places`` hits are returned.
    """

    text: str = ""
    participant: str = ""
    condition: str = ""
    wizard: str = ""
    scenario: str = ""
    purpose: str = ""
    places: int = PLACES_A_PAGE


class SearchHit(Value):
    """Text hit at ``at_ns`` in session time. ``snippet`` is the surrounding text.

    ``quoted`` prompts to language models contain this utterance and are not separate hits.
    """

    folder: Path
    at_ns: int
    session_s: float
    kind: str
    snippet: str
    quoted: int = 0
