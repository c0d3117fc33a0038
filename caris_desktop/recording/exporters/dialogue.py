"""Dialogue turns of the robot as JSON lines: what was known, what the wizard had it say, and how soon."""

import bisect
import json
from pathlib import Path
from typing import Any

from caris_desktop.domain.events import AnswerUsed, LlmExchange
from caris_desktop.domain.schema import to_jsonable
from caris_desktop.recording.measures.session_measures import measure, read_facts
from caris_desktop.recording.session.session_conversation import LlmUse, SpokenUtterance
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.tables.catalog import key_values

TURNS_BEFORE = 20
"""A turn contains at most so many utterances before it."""
_EDIT_WITHIN_NS = 5_000_000_000
_OF_EXCHANGE = (
    "exchange_id", "provider", "model", "model_version", "server", "seed", "parameters", "messages", "answer",
    "outcome", "cut",
)  # fmt: skip


def write_dialogue(session: Session, path: Path) -> int:
    """Write one line per robot utterance; return their number. Raises OSError, SessionError."""
    facts = read_facts(session)
    spoken = [utterance for utterance in facts.utterances if utterance.said]
    measures = measure(facts)
    responses, reactions = (
        {delay.utterance_id: round(delay.delay_s, 4) for delay in delays}
        for delays in (measures.responses, measures.reactions)
    )
    exchanges = [answer.exchange for answer in facts.answers]
    became: dict[str, LlmUse] = {answer.exchange.exchange_id: answer.use or "unused" for answer in facts.answers}
    in_view, of_this = _counts_in_view(session), key_values(session)
    turns, before_ns = 0, -(2**62)
    with path.open("w", encoding="utf-8", errors="replace") as file:
        for utterance in facts.utterances:
            at_ns = utterance.start_ns if utterance.requested_ns is None else utterance.requested_ns
            if utterance.speaker != "robot" or at_ns is None:
                continue
            known = [other for other in spoken if other is not utterance and _known_at(other, at_ns)]
            preceding = [exchange for exchange in exchanges if before_ns < exchange.stamp_ns <= at_ns]
            edited = any(
                use.use == "edited"
                and use.text.strip() == utterance.text.strip()
                and abs(use.stamp_ns - at_ns) <= _EDIT_WITHIN_NS
                for use in facts.of(AnswerUsed)
            )
            found = {
                camera: numbers[index - 1]
                for camera, (moments, numbers) in in_view.items()
                if (index := bisect.bisect_right(moments, at_ns))
            }
            line = {
                **of_this,
                "turn": turns + 1,
                "utterance_id": utterance.utterance_id,
                "decided_s": _seconds(session, at_ns),
                "utc": session.clock.utc(at_ns),
                "context": {
                    "transcript": [_as_heard(session, other, at_ns) for other in known[-TURNS_BEFORE:]],
                    "people_in_view": found,
                    "assistant": [_exchange(session, exchange, became[exchange.exchange_id]) for exchange in preceding],
                },
                "action": {
                    "text": utterance.text,
                    "origin": "edited" if edited else utterance.origin,
                    "voice": utterance.voice,
                    "started_s": _seconds(session, utterance.start_ns),
                    "ended_s": _seconds(session, utterance.end_ns),
                    "state": utterance.state,
                    "said": utterance.said,
                },
                "response_time_s": responses.get(utterance.utterance_id),
                "wizard_reaction_time_s": reactions.get(utterance.utterance_id),
            }
            file.write(json.dumps(line, ensure_ascii=False, separators=(",", ":"), allow_nan=False) + "\n")
            turns, before_ns = turns + 1, at_ns
    return turns


def _known_at(utterance: SpokenUtterance, at_ns: int) -> bool:
    """True if the utterance had begun; transcripts of heard speech are known only after its end."""
    if utterance.start_ns is None or utterance.start_ns >= at_ns:
        return False
    return utterance.speaker == "robot" or (utterance.end_ns is not None and utterance.end_ns <= at_ns)


def _as_heard(session: Session, utterance: SpokenUtterance, at_ns: int) -> dict[str, Any]:
    ended = utterance.end_ns is not None and utterance.end_ns <= at_ns
    return {
        "speaker": utterance.speaker,
        "text": utterance.text,
        "origin": utterance.origin,
        "started_s": _seconds(session, utterance.start_ns),
        "ended_s": _seconds(session, utterance.end_ns) if ended else None,
    }


def _exchange(session: Session, exchange: LlmExchange, use: LlmUse) -> dict[str, Any]:
    fields = to_jsonable(exchange)
    return {
        **{name: fields[name] for name in _OF_EXCHANGE},
        "asked_s": _seconds(session, exchange.asked_ns),
        "answered_s": _seconds(session, exchange.stamp_ns),
        "use": use,
    }


def _counts_in_view(session: Session) -> dict[str, tuple[list[int], list[int]]]:
    """Times and numbers of people per camera, at each change."""
    counts: dict[str, tuple[list[int], list[int]]] = {}
    for _, people in session.values("people"):
        moments, numbers = counts.setdefault(people.camera, ([], []))
        if not numbers or numbers[-1] != len(people.boxes):
            moments.append(people.stamp_ns)
            numbers.append(len(people.boxes))
    return counts


def _seconds(session: Session, stamp_ns: int | None) -> float | None:
    return None if stamp_ns is None else round(session.clock.session_s(stamp_ns), 4)
