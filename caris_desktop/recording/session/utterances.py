"""Utterances of a session: one record per utterance, from its events and corrections."""

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal

from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.corrections import Correction, Corrections, WhoSpoke
from caris_desktop.domain.events import (
    RecordingPaused,
    UtteranceChanged,
    UtteranceCorrected,
    UtteranceOrigin,
    UtteranceState,
)
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.session_clock import pauses_of
from caris_desktop.recording.session.session_reader import Session
from caris_desktop.recording.session.session_visits import VISIT_STREAMS, Visit, VisitEvent, seen_throughout, visits_of

HEARD_FROM_NS = 200_000_000
"""A syllable: of speech cut short earlier, nobody heard a word."""
UtteranceEvent = UtteranceChanged | UtteranceCorrected
UTTERANCE_STREAMS = ("event/utterance_changed", "event/utterance_corrected")
"""Streams with utterances."""
PRESENT_SHARE, _ALONE = 0.8, 0.78
"""Who was alone there for that share of an utterance is taken for its speaker. They are so with a likelihood of 0.78,
as the console reckons of somebody whose distance and gaze it does not know: somebody may speak whom no camera sees."""
_ENDED: tuple[UtteranceState, ...] = ("finished", "interrupted", "failed")


class SpokenUtterance(Value):
    """One utterance, in session time.

    ``start_ns`` and ``end_ns`` are None if nothing was audible: dropped while waiting, speech failed, or the session
    ended first. ``state`` is the last recorded one: ``started`` with an ``end_ns`` means that the end was not recorded,
    and ``end_ns`` is a pause, the end of the recording, or the same speaker's next utterance. ``estimated``: start or
    end is inexact. ``requested_ns`` is None for heard speech. ``actor`` requested it.

    ``speaker``, ``text`` and ``person_id`` include corrections: ``heard_text`` is the transcript before a correction,
    else None. ``speaker`` is empty if uncertain. ``person_id`` is the speaker, or the person that the robot addresses.
    ``person_by`` assigned it for a participant: the wizard, the console, or ``record`` if it follows from presence
    alone; ``person_confidence`` is None for assignments by a wizard.
    """

    utterance_id: str
    speaker: WhoSpoke
    text: str
    origin: UtteranceOrigin
    requested_ns: int | None
    start_ns: int | None
    end_ns: int | None
    state: UtteranceState
    voice: str = ""
    detail: str = ""
    actor: Actor = ""
    person_id: str = ""
    heard_text: str | None = None
    tags: tuple[str, ...] = ()
    confidence: float | None = None
    language: str = ""
    estimated: bool = False
    person_by: Actor | Literal["record"] = ""
    person_confidence: float | None = None

    @property
    def said(self) -> bool:
        """True if at least a part of it was audible."""
        if self.start_ns is None or (self.origin == "heard" and self.state == "failed"):
            return False  # noise or the robot's own voice
        if self.origin == "heard" and self.state == "started" and not self.text:
            return False  # a turn begins before its speaker is classified, and the result was not recorded
        cut_short = self.state in ("interrupted", "failed") and self.end_ns is not None
        return not cut_short or (self.end_ns or 0) - self.start_ns >= HEARD_FROM_NS

    @property
    def duration_s(self) -> float | None:
        return None if self.start_ns is None or self.end_ns is None else (self.end_ns - self.start_ns) / 1e9


def spoken(session: Session) -> tuple[SpokenUtterance, ...]:
    """Utterances of a session in order of their start (or request). Raises SessionError."""
    events = [value for _, value in session.values(*UTTERANCE_STREAMS, *VISIT_STREAMS, "event/recording_paused")]
    paused = [event for event in events if isinstance(event, RecordingPaused)]
    return spoken_utterances(
        (event for event in events if isinstance(event, UtteranceEvent)),
        ended_ns=session.ended_ns,
        paused_ns=[event.stamp_ns for event in paused if event.paused],
        visits=visits_of(
            (event for event in events if isinstance(event, VisitEvent)),
            started_ns=session.started_ns,
            ended_ns=session.ended_ns,
            pauses=pauses_of(paused, ended_ns=session.ended_ns),
        )
        or seen_throughout(session),
    )


def spoken_utterances(
    events: Iterable[UtteranceEvent], *, ended_ns: int, paused_ns: Iterable[int] = (), visits: Sequence[Visit] = ()
) -> tuple[SpokenUtterance, ...]:
    """Fold ``events`` in recording order. ``paused_ns`` are the starts of pauses.

    Utterances of unidentified participants are assigned to the only person present, by ``visits``.
    """
    utterances: dict[str, SpokenUtterance] = {}
    corrections = Corrections()
    for event in events:
        if isinstance(event, UtteranceCorrected):
            corrections.take(event)
            continue
        known = utterances.get(event.utterance_id)
        utterances[event.utterance_id] = _with(known or _unknown(event), event)
    corrected = (_corrected(utterance, corrections.of(utterance.utterance_id)) for utterance in utterances.values())
    ordered = sorted(corrected, key=_begins_ns)
    breaks_ns = sorted([*paused_ns, ended_ns])
    starts_ns: dict[str, list[int]] = {}
    for utterance in ordered:
        if utterance.start_ns is not None:
            starts_ns.setdefault(utterance.speaker, []).append(utterance.start_ns)
    ended = (_ended(utterance, starts_ns.get(utterance.speaker, []), breaks_ns) for utterance in ordered)
    return tuple(_attributed(utterance, visits) for utterance in ended)


def _attributed(utterance: SpokenUtterance, visits: Sequence[Visit]) -> SpokenUtterance:
    """Assign an undecided utterance if a single person was present for nearly all of it."""
    undecided = utterance.person_id == "" and utterance.person_by in ("", CONSOLE)
    if not undecided or utterance.speaker != "participant" or not utterance.said or utterance.start_ns is None:
        return utterance
    end_ns = max(utterance.start_ns + 1, utterance.end_ns or 0)
    there: dict[str, int] = {}
    for visit in visits:
        together_ns = min(end_ns, visit.end_ns) - max(utterance.start_ns, visit.start_ns)
        if together_ns > 0:
            there[visit.person_id] = there.get(visit.person_id, 0) + together_ns
    if len(there) != 1:
        return utterance
    ((person_id, together_ns),) = there.items()
    share = together_ns / (end_ns - utterance.start_ns)
    if share < PRESENT_SHARE:
        return utterance
    return replace(
        utterance, person_id=person_id, person_by="record", person_confidence=round(min(1.0, share) * _ALONE, 3)
    )


def _unknown(event: UtteranceChanged) -> SpokenUtterance:
    return SpokenUtterance(
        event.utterance_id, event.speaker, event.text, event.origin, None, None, None, "requested", event.voice
    )


def _with(known: SpokenUtterance, event: UtteranceChanged) -> SpokenUtterance:
    requested_ns, start_ns, end_ns = known.requested_ns, known.start_ns, known.end_ns
    match event.state:
        case "requested":
            requested_ns = event.stamp_ns if requested_ns is None else requested_ns
        case "started":
            start_ns = event.stamp_ns if start_ns is None else start_ns
        case "finished":
            # Recognised speech may be a single finished event without a known start.
            start_ns = event.stamp_ns if start_ns is None else start_ns
            end_ns = event.stamp_ns
        case "interrupted" | "failed":
            end_ns = None if start_ns is None else event.stamp_ns
    return replace(
        known,
        speaker=event.speaker,
        text=event.text or known.text,
        origin=event.origin,
        requested_ns=requested_ns,
        start_ns=start_ns,
        end_ns=end_ns,
        state=known.state if known.state in _ENDED and event.state not in _ENDED else event.state,
        voice=event.voice or known.voice,
        detail=event.detail or known.detail,
        # The event of an interruption names who interrupted.
        person_id=event.person_id or known.person_id,
        confidence=known.confidence if event.confidence is None else event.confidence,
        language=event.language or known.language,
        estimated=known.estimated or event.estimated,
        actor=known.actor or (event.actor if event.state != "interrupted" else ""),
    )


def _corrected(utterance: SpokenUtterance, made: Correction) -> SpokenUtterance:
    start_ns, end_ns = utterance.start_ns, utterance.end_ns
    if start_ns is not None and made.start_ns is not None:
        start_ns = made.start_ns
    if end_ns is not None and made.end_ns is not None and utterance.state == "finished":
        end_ns = made.end_ns
    if start_ns is not None and end_ns is not None and end_ns < start_ns:
        start_ns, end_ns = utterance.start_ns, utterance.end_ns
    return replace(
        utterance,
        start_ns=start_ns,
        end_ns=end_ns,
        estimated=utterance.estimated and (made.start_ns is None or made.end_ns is None),
        text=utterance.text if made.text is None else made.text,
        heard_text=None if made.text in (None, utterance.text) else utterance.text,
        speaker=utterance.speaker if made.speaker is None else made.speaker,
        person_id=utterance.person_id if made.person_id is None else made.person_id,
        person_by=made.person_by,
        person_confidence=made.person_confidence if made.person_id else None,
        tags=made.tags or (),
    )


def _begins_ns(utterance: SpokenUtterance) -> int:
    for stamp_ns in (utterance.start_ns, utterance.requested_ns, utterance.end_ns):
        if stamp_ns is not None:
            return stamp_ns
    return 0


def _ended(utterance: SpokenUtterance, starts_ns: list[int], breaks_ns: list[int]) -> SpokenUtterance:
    if utterance.start_ns is None or utterance.end_ns is not None:
        return utterance
    later_ns = [
        moments_ns[index]
        for moments_ns in (starts_ns, breaks_ns)
        if (index := bisect_right(moments_ns, utterance.start_ns)) < len(moments_ns)
    ]
    return replace(utterance, end_ns=min(later_ns, default=utterance.start_ns))
