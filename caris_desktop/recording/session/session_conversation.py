"""Utterances of a session, the use of a language model's texts, and response times, from the events."""

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal, get_args

from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.corrections import Correction, Corrections, WhoSpoke
from caris_desktop.domain.events import (
    RESPONSE_LIMIT_S,
    UTTERANCE_ENDS,
    AnswerUsed,
    LlmExchange,
    ReplyMeans,
    ResponseTimed,
    SuggestionChanged,
    UtteranceChanged,
    UtteranceCorrected,
    UtteranceOrigin,
    UtteranceState,
)
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.session_visits import Visit

HEARD_FROM_NS = 200_000_000
"""A syllable: of speech cut short earlier, nobody heard a word."""
UtteranceEvent = UtteranceChanged | UtteranceCorrected
UTTERANCE_STREAMS = ("event/utterance_changed", "event/utterance_corrected")
"""Streams with utterances."""
PRESENT_SHARE, _ALONE = 0.8, 0.78
"""Who was alone there for that share of an utterance is taken for its speaker. They are so with a likelihood of 0.78,
as the console reckons of somebody whose distance and gaze it does not know: somebody may speak whom no camera sees."""


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
        known = utterances.get(event.utterance_id) or SpokenUtterance(
            event.utterance_id, event.speaker, event.text, event.origin, None, None, None, "requested", event.voice
        )
        utterances[event.utterance_id] = _with(known, event)
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
        state=known.state if known.state in UTTERANCE_ENDS and event.state not in UTTERANCE_ENDS else event.state,
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
    moments_ns = (utterance.start_ns, utterance.requested_ns, utterance.end_ns, 0)
    return next(stamp_ns for stamp_ns in moments_ns if stamp_ns is not None)


def _ended(utterance: SpokenUtterance, starts_ns: list[int], breaks_ns: list[int]) -> SpokenUtterance:
    if utterance.start_ns is None or utterance.end_ns is not None:
        return utterance
    later_ns = [
        moments_ns[index]
        for moments_ns in (starts_ns, breaks_ns)
        if (index := bisect_right(moments_ns, utterance.start_ns)) < len(moments_ns)
    ]
    return replace(utterance, end_ns=min(later_ns, default=utterance.start_ns))


# Outcome of each suggested reply that was displayed in a session: exactly one, even for interrupted sessions.

Fate = Literal["taken", "edited", "dismissed", "superseded", "expired"]


class ShownReply(Value):
    """Displayed suggestion. ``told`` is False if the session ended or paused before its outcome; it has then expired,
    as it could no longer be used.
    """

    suggestion_id: str
    turn_id: str
    revision: int
    rank: int
    text: str
    model: str
    shown_ns: int
    latency_ms: float | None
    fate: Fate
    ended_ns: int
    told: bool
    edit_distance: int | None = None
    utterance_id: str = ""
    actor: Actor = ""

    @property
    def was_said(self) -> bool:
        return self.fate in ("taken", "edited")


def replies_of(changes: Iterable[SuggestionChanged], *, ends_ns: Sequence[int]) -> tuple[ShownReply, ...]:
    """Outcomes from ``changes``. ``ends_ns`` are the pauses and the end of the recording. The first outcome counts;
    outcomes of suggestions whose display was not recorded are ignored.
    """
    replies: dict[str, ShownReply] = {}
    for change in changes:
        known = replies.get(change.suggestion_id)
        if change.state == "displayed":
            if known is None:
                replies[change.suggestion_id] = _unended(change, ends_ns)
        elif known is not None and not known.told:
            replies[change.suggestion_id] = replace(
                known,
                fate=change.state,
                ended_ns=change.stamp_ns,
                told=True,
                edit_distance=change.edit_distance,
                utterance_id=change.utterance_id,
                actor=change.actor,
            )
    return tuple(replies.values())


def _unended(suggestion: SuggestionChanged, ends_ns: Sequence[int]) -> ShownReply:
    ended_ns = min((end_ns for end_ns in ends_ns if end_ns >= suggestion.stamp_ns), default=suggestion.stamp_ns)
    return ShownReply(
        suggestion.suggestion_id, suggestion.turn_id, suggestion.revision, suggestion.rank, suggestion.text,
        suggestion.model, suggestion.stamp_ns, suggestion.latency_ms, "expired", ended_ns, told=False,
    )  # fmt: skip


LlmUse = Literal["", "said", "edited", "dismissed", "superseded", "expired", "unused"]
_USE_OF_FATE: dict[Fate, LlmUse] = {
    "taken": "said", "edited": "edited", "dismissed": "dismissed", "superseded": "superseded", "expired": "expired",
}  # fmt: skip
"""The use of an exchange is that of its suggestion which comes first here."""
_SAID_WITHIN_NS = 5_000_000_000


class LlmAnswer(Value):
    """Exchange with a language model, and the use of its answer: empty if it gave none.

    Of an exchange for suggested replies, ``shown`` counts those that the wizard saw, ``latency_ms`` is that of the
    first one, and ``edit_distance`` of the one that was used; None for other exchanges, and without such a suggestion.
    """

    exchange: LlmExchange
    use: LlmUse
    shown: int | None = None
    latency_ms: float | None = None
    edit_distance: int | None = None


def answers_of(
    exchanges: Iterable[LlmExchange], uses: Iterable[AnswerUsed], utterances: Sequence[SpokenUtterance]
) -> tuple[LlmAnswer, ...]:
    """The wizard's questions in recording order."""
    questions = questions_of(exchanges)
    became = answer_uses(questions, uses, utterances)
    return tuple(LlmAnswer(one, became[one.exchange_id] if one.outcome == "answered" else "") for one in questions)


def reply_answers_of(
    exchanges: Iterable[LlmExchange], replies: Iterable[ShownReply], utterances: Sequence[SpokenUtterance]
) -> tuple[LlmAnswer, ...]:
    """Exchanges for suggested replies, in recording order. Their outcome does not tell the use: replies are shown while
    the model writes, and a newer turn cancels it.
    """
    asked = [exchange for exchange in exchanges if exchange.purpose == "replies"]
    of_exchange: dict[str, list[ShownReply]] = {}
    for reply in replies:
        # Older recordings have no revision.
        possible = [
            exchange
            for exchange in asked
            if exchange.turn_id == reply.turn_id
            and exchange.revision in (0, reply.revision)
            and exchange.asked_ns <= reply.shown_ns
        ]
        if possible:
            newest = max(possible, key=lambda exchange: exchange.asked_ns)
            of_exchange.setdefault(newest.exchange_id, []).append(reply)
    unheard_ids = {utterance.utterance_id for utterance in utterances if not utterance.said}
    return tuple(_of_replies(exchange, of_exchange.get(exchange.exchange_id, []), unheard_ids) for exchange in asked)


def _of_replies(exchange: LlmExchange, replies: list[ShownReply], unheard_ids: set[str]) -> LlmAnswer:
    if not replies:
        return LlmAnswer(exchange, "unused" if exchange.outcome == "answered" else "", 0)
    used = min(replies, key=lambda reply: [*_USE_OF_FATE].index(reply.fate))
    unheard = used.was_said and used.utterance_id in unheard_ids
    latencies_ms = [reply.latency_ms for reply in replies if reply.latency_ms is not None]
    return LlmAnswer(
        exchange, "unused" if unheard else _USE_OF_FATE[used.fate], len(replies), min(latencies_ms, default=None),
        used.edit_distance,
    )  # fmt: skip


def questions_of(exchanges: Iterable[LlmExchange]) -> tuple[LlmExchange, ...]:
    """Exchanges that the wizard asked; suggestions and proposals have events of their own."""
    return tuple(exchange for exchange in exchanges if exchange.purpose == "question")


def answer_uses(
    exchanges: Iterable[LlmExchange], uses: Iterable[AnswerUsed], utterances: Sequence[SpokenUtterance]
) -> dict[str, LlmUse]:
    """Use of each answer by exchange: said if it was audible unchanged, else edited, else dismissed."""
    by_exchange: dict[str, set[str]] = {}
    for use in uses:
        if not unheard(use, utterances):
            by_exchange.setdefault(use.exchange_id, set()).add(use.use)
    became: dict[str, LlmUse] = {}
    for exchange in exchanges:
        made = by_exchange.get(exchange.exchange_id, set())
        became[exchange.exchange_id] = (
            "said" if "said" in made else "edited" if "edited" in made else "dismissed" if made else "unused"
        )
    return became


def unheard(use: AnswerUsed, utterances: Iterable[SpokenUtterance]) -> bool:
    """True if an answer was to be spoken but was not audible: cancelled before, or speech failed."""
    if use.use == "dismissed":
        return False
    utterance = _utterance_of(use, utterances)
    return utterance is not None and not utterance.said


def _utterance_of(use: AnswerUsed, utterances: Iterable[SpokenUtterance]) -> SpokenUtterance | None:
    """The utterance by id; older recordings only allow matching by text and time."""
    robots = [item for item in utterances if item.speaker == "robot"]
    if use.utterance_id:
        return next((item for item in robots if item.utterance_id == use.utterance_id), None)
    words = use.text.split()
    apart_ns = [
        (abs(item.requested_ns - use.stamp_ns), item)
        for item in robots
        if item.requested_ns is not None and item.text.split() == words
    ]
    nearest = min(apart_ns, key=lambda pair: pair[0], default=None)
    return nearest[1] if nearest is not None and nearest[0] <= _SAID_WITHIN_NS else None


# Response times: the gap between each participant turn and its answer, and the means of the answer.

AT_ONCE_S = 1.0
"""Answers that come sooner are counted: from here on a pause is noticed."""
_MEANS: tuple[ReplyMeans, ...] = get_args(ReplyMeans)


class Response(Value):
    """One answer. ``gap_s`` is from the end of the participant's voice to the first sound, negative for overlaps.
    ``first``: no filler or other answer came before it. Values that older recordings lack are None.
    """

    turn_id: str
    reply_id: str
    means: ReplyMeans
    voice_ended_ns: int
    first_sound_ns: int
    first: bool
    asked_ns: int | None = None
    text_ns: int | None = None
    suggested_ns: int | None = None
    person_id: str = ""

    @property
    def gap_s(self) -> float:
        return (self.first_sound_ns - self.voice_ended_ns) / 1e9


def responses_of(
    utterances: Iterable[SpokenUtterance], timed: Iterable[ResponseTimed] = (), pauses: Sequence[tuple[int, int]] = ()
) -> tuple[Response, ...]:
    """Responses from corrected utterances: turns of speakers found not to be participants have none. ``timed`` adds
    details that utterances lack. A turn is answered by the first filler after it and by the first other reply.

    Excludes replies after ``RESPONSE_LIMIT_S``, and after a pause of the recording.
    """
    ordered = sorted((item for item in utterances if item.said), key=lambda item: item.start_ns or 0)
    turns = [item for item in ordered if item.speaker == "participant"]
    starts_ns = [turn.start_ns or 0 for turn in turns]
    by_reply = {(event.turn_id, event.reply_id): event for event in timed}
    found: list[Response] = []
    answered: set[tuple[str, bool]] = set()
    for reply in ordered:
        number = bisect_right(starts_ns, reply.start_ns or 0) - 1
        if number < 0 or reply.speaker == "participant" or reply.origin not in _MEANS:
            continue
        turn, filler = turns[number], reply.origin == "filler"
        ended_ns, reply_ns = turn.end_ns or turn.start_ns or 0, reply.start_ns or 0
        paused = any(start_ns < reply_ns and end_ns > ended_ns for start_ns, end_ns in pauses)
        late = reply_ns - ended_ns > RESPONSE_LIMIT_S * 1e9
        if paused or late or (turn.utterance_id, False) in answered or (turn.utterance_id, filler) in answered:
            continue
        first = (turn.utterance_id, not filler) not in answered
        answered.add((turn.utterance_id, filler))
        response = Response(
            turn.utterance_id, reply.utterance_id, reply.origin, ended_ns, reply_ns, first, reply.requested_ns,
            person_id=turn.person_id,
        )  # fmt: skip
        event = by_reply.get((turn.utterance_id, reply.utterance_id))
        if event is not None:
            response = replace(response, means=event.means, text_ns=event.text_ns, suggested_ns=event.suggested_ns)
        found.append(response)
    return tuple(found)
