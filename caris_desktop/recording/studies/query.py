"""What can be asked about the sessions of a study, and what is found; light, as the window needs it to begin with."""

from pathlib import Path

from caris_desktop.domain.value_class import dataclass

PLACES_A_PAGE = 500


@dataclass(frozen=True, slots=True)
class SessionEntry:
    """One session as the list shows it.

    ``losses`` says what was recorded and is not there any more, in English and for ``tr``; ``copy_of`` names the
    session whose copy this one is: it counts once.
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


@dataclass(frozen=True, slots=True)
class SessionQuery:
    """What to find; empty fields do not matter. ``text`` is searched in everything said, noted and marked.

    The other fields are compared whole, whatever their case; ``*`` stands for anything. Of ``text`` each word must
    begin a word of one utterance, note or mark. The first ``places`` are given where it was found.
    """

    text: str = ""
    participant: str = ""
    condition: str = ""
    wizard: str = ""
    scenario: str = ""
    purpose: str = ""
    places: int = PLACES_A_PAGE


@dataclass(frozen=True, slots=True)
class SearchHit:
    """Where a text was found: ``at_ns`` of that session's clock. ``snippet`` has the words around it.

    ``quoted`` prompts to language models have this utterance in them: they are no places of their own.
    """

    folder: Path
    at_ns: int
    session_s: float
    kind: str
    snippet: str
    quoted: int = 0
