"""A person's utterances in a session, and those of unknown speakers during their presence."""

import json
import re
from collections.abc import Iterable, Iterator
from functools import cached_property
from typing import Any

from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.forgetting.person_tracks import PersonTracks, messages_of
from caris_desktop.recording.forgetting.search_terms import FORGOTTEN
from caris_desktop.recording.session.session_conversation import UTTERANCE_STREAMS, SpokenUtterance, spoken
from caris_desktop.recording.session.session_reader import Session

AROUND_VISIT_NS = 2_000_000_000
"""Somebody speaks before a camera sees them, and after."""
_TOPICS = tuple(f"/{name}" for name in (*UTTERANCE_STREAMS, "hearing"))
_WORDS = ("text", "message", "heard_text", "detail", "committed", "tentative")
_UTTERANCE = re.compile(r'"utterance_id":\s*("(?:[^"\\]|\\.)*")')
# Sentences this long are distinctive; shorter ones match only as a whole value, line or cell.
_LONG, _LONG_WORDS = 12, 3


@dataclass(frozen=True)
class Sentences:
    """A person's sentences, to be found in any text."""

    texts: tuple[str, ...] = ()

    @property
    def long(self) -> tuple[str, ...]:
        return tuple(text for text in self.texts if len(text) >= _LONG and len(text.split()) >= _LONG_WORDS)

    @cached_property
    def _pattern(self) -> re.Pattern[str] | None:
        patterns = []
        for text in sorted(self.texts, key=len, reverse=True):
            for form in dict.fromkeys((text, json.dumps(text)[1:-1], json.dumps(text, ensure_ascii=False)[1:-1])):
                plain = r"\s+".join(map(re.escape, form.split()))
                patterns.append(
                    plain if text in self.long else rf'(?:^|(?<=[",\t;])|(?<=: )){plain}(?=["\t,;\r\n]|  \[|\]|$)'
                )
        return re.compile("|".join(patterns), re.MULTILINE) if patterns else None

    @cached_property
    def _firsts(self) -> tuple[str, ...]:
        """First words of each sentence, plain and JSON-escaped: a fast check that excludes most texts."""
        forms = (form for text in self.texts for form in (text, json.dumps(text)[1:-1]))
        return tuple({form.split()[0] for form in forms})

    def spans(self, text: str) -> Iterator[tuple[int, int]]:
        """Positions of the sentences."""
        if self._pattern is not None and any(first in text for first in self._firsts):
            yield from (match.span() for match in self._pattern.finditer(text))

    @property
    def probes(self) -> tuple[bytes, ...]:
        """Byte patterns for a file search."""
        forms = (form for text in self.long for form in (text, json.dumps(text)[1:-1]))
        return tuple(dict.fromkeys(form.encode("utf-8", "replace") for form in forms))


@dataclass(frozen=True)
class Speech:
    """Utterances of one session: ids of the person's own, ``doubtful`` ones of unknown speakers during their presence,
    and ``others`` of known other speakers.
    """

    theirs: frozenset[str] = frozenset()
    doubtful: tuple[SpokenUtterance, ...] = ()
    others: tuple[SpokenUtterance, ...] = ()


def speech_in(session: Session, person_ids: frozenset[str], tracks: PersonTracks) -> Speech:
    """Utterances of the session by speaker. Raises SessionError."""
    theirs: set[str] = set()
    doubtful: list[SpokenUtterance] = []
    others: list[SpokenUtterance] = []
    for utterance in spoken(session):
        if utterance.speaker not in ("participant", ""):
            continue
        if utterance.person_id in person_ids:
            theirs.add(utterance.utterance_id)
        elif utterance.person_id:
            others.append(utterance)
        elif utterance.text != FORGOTTEN and _is_during(utterance, tracks):
            doubtful.append(utterance)
    return Speech(frozenset(theirs), tuple(doubtful), tuple(others))


def _is_during(utterance: SpokenUtterance, tracks: PersonTracks) -> bool:
    moments = [at for at in (utterance.start_ns, utterance.end_ns, utterance.requested_ns) if at is not None]
    return bool(moments) and any(
        min(moments) <= until_ns + AROUND_VISIT_NS and max(moments) >= from_ns - AROUND_VISIT_NS
        for from_ns, until_ns in tracks.visits_ns
    )


def sentences_of(session: Session, utterance_ids: Iterable[str]) -> Sentences:
    """All recorded texts of these utterances: partial, final and corrected.

    Raises OSError.
    """
    ids = frozenset(utterance_ids)
    found: dict[str, None] = {}
    for _, data in messages_of(session.folder / "events.mcap", lambda topic: topic.startswith(_TOPICS)):
        message = _read(data.decode("utf-8", "replace"), ids)
        for text in (message.get(key) for key in _WORDS if key not in ("message", "detail")):
            if isinstance(text, str) and text.strip() and text != FORGOTTEN:
                found.setdefault(" ".join(text.split()))
    return Sentences(tuple(found))


def without_words(message: str, utterance_ids: frozenset[str]) -> tuple[str, int]:
    """Recorded message without the texts of these utterances, and the number of changed texts."""
    fields = _read(message, utterance_ids)
    words = [key for key in _WORDS if isinstance(fields.get(key), str) and fields[key] not in ("", FORGOTTEN)]
    if not words:
        return message, 0
    return json.dumps(fields | dict.fromkeys(words, FORGOTTEN), separators=(",", ":")), 1


def _read(message: str, utterance_ids: frozenset[str]) -> dict[str, Any]:
    """Parsed message; empty if it is about another utterance."""
    named = _UTTERANCE.search(message)
    if named is None or json.loads(named[1]) not in utterance_ids:
        return {}
    try:
        fields = json.loads(message)
    except (ValueError, RecursionError):
        return {}
    return fields if isinstance(fields, dict) else {}
