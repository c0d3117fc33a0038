"""Conversation transcript, turn by turn, and response times, from utterance events and corrections."""

from collections.abc import Iterable, Sequence
from dataclasses import field, replace
from typing import Literal

from caris_desktop.domain.corrections import Correction, Corrections, WhoSpoke
from caris_desktop.domain.events import (
    RESPONSE_LIMIT_S,
    UTTERANCE_ENDS,
    ReplyMeans,
    ResponseTimed,
    SuggestionChanged,
    UtteranceChanged,
    UtteranceCorrected,
    UtteranceOrigin,
    UtteranceState,
)
from caris_desktop.domain.sound_values import Hearing
from caris_desktop.domain.value_class import Value, dataclass

UtteranceReport = UtteranceChanged | UtteranceCorrected


class Turn(Value):
    """One utterance in its latest state; session times, None if unknown.

    ``speaker`` is empty if uncertain. ``person_id`` is the speaker, or the person the robot addresses. ``heard_text``
    is the transcript before a correction, None without one.
    """

    utterance_id: str
    speaker: WhoSpoke
    text: str
    origin: UtteranceOrigin
    state: UtteranceState
    started_ns: int | None = None
    ended_ns: int | None = None
    asked_ns: int | None = None
    person_id: str = ""
    heard_text: str | None = None
    tags: tuple[str, ...] = ()

    @property
    def said(self) -> bool:
        """True if at least a part of it was audible, as far as known.

        A robot utterance that started was audible, even if its end is unknown (link lost).
        """
        return self.started_ns is not None and (self.state != "failed" or not is_heard(self))

    @property
    def over(self) -> bool:
        """True if it is complete."""
        return self.state in UTTERANCE_ENDS

    def moved(self, by_ns: int) -> "Turn":
        """The turn by another clock."""
        started_ns, ended_ns, asked_ns = (
            None if at_ns is None else at_ns + by_ns for at_ns in (self.started_ns, self.ended_ns, self.asked_ns)
        )
        return replace(self, started_ns=started_ns, ended_ns=ended_ns, asked_ns=asked_ns)

    @property
    def begins_ns(self) -> int:
        """Sort key: start, else request or end."""
        if self.started_ns is not None:
            return self.started_ns
        return self.asked_ns or self.ended_ns or 0


class Transcript:
    """Folds utterance events; a correction may come before its utterance."""

    def __init__(self) -> None:
        self._recognized: dict[str, Turn] = {}
        self._turns: dict[str, Turn] = {}
        self._corrections = Corrections()

    def add(self, event: UtteranceReport) -> None:
        turn_id = event.utterance_id
        if isinstance(event, UtteranceCorrected):
            self._corrections.take(event)
        else:
            known = self._recognized.get(turn_id)
            self._recognized[turn_id] = _first(event) if known is None else _next(known, event)
        if turn_id in self._recognized:
            self._turns[turn_id] = _corrected(self._recognized[turn_id], self._corrections.of(turn_id))

    def forget_before(self, at_ns: int) -> None:
        """Drop completed turns from before another session."""
        self._recognized = {
            turn_id: turn for turn_id, turn in self._recognized.items() if not turn.over or turn.begins_ns >= at_ns
        }
        self._turns = {turn_id: self._turns[turn_id] for turn_id in self._recognized}

    def turn(self, utterance_id: str) -> Turn | None:
        return self._turns.get(utterance_id)

    @property
    def turns(self) -> tuple[Turn, ...]:
        """Turns in order of their first event."""
        return tuple(self._turns.values())


def turns_of(events: Iterable[UtteranceReport]) -> tuple[Turn, ...]:
    """Turns of a session, in order of their first event.

    An empty heard turn whose speaker was never determined, because the record ended or has a gap, is dropped.
    """
    transcript = Transcript()
    for event in events:
        transcript.add(event)
    return tuple(turn for turn in transcript.turns if turn.text or turn.over or turn.origin != "heard")


def in_order(turns: Iterable[Turn]) -> list[Turn]:
    """Audible turns in order of their start."""
    return sorted((turn for turn in turns if turn.said), key=lambda turn: turn.begins_ns)


def is_heard(turn: Turn) -> bool:
    """True for speech recognised by a microphone, whose speaker and text may be wrong."""
    return turn.origin in ("heard", "own_voice")


def newest_heard(turns: Iterable[Turn]) -> Turn | None:
    """Newest recognised turn."""
    return next((turn for turn in reversed(in_order(turns)) if is_heard(turn) and turn.text), None)


def next_speaker(turn: Turn, here: Iterable[str]) -> tuple[WhoSpoke, str]:
    """Next speaker in the correction cycle: participant, each person present, robot, wizard, uncertain, and participant
    again.
    """
    possible: list[tuple[WhoSpoke, str]] = [("participant", "")]
    possible += [("participant", person_id) for person_id in here if person_id]
    possible += [("robot", ""), ("wizard", ""), ("", "")]
    now = (turn.speaker, turn.person_id if turn.speaker == "participant" else "")
    return possible[(possible.index(now) + 1) % len(possible)] if now in possible else possible[0]


def _corrected(turn: Turn, made: Correction) -> Turn:
    if made == Correction():
        return turn
    return replace(
        turn,
        text=turn.text if made.text is None else made.text,
        heard_text=None if made.text in (None, turn.text) else turn.text,
        speaker=turn.speaker if made.speaker is None else made.speaker,
        person_id=turn.person_id if made.person_id is None else made.person_id,
        tags=made.tags or (),
    )


def _first(event: UtteranceChanged) -> Turn:
    turn = Turn(event.utterance_id, event.speaker, event.text, event.origin, "requested", person_id=event.person_id)
    if event.state == "requested":
        turn = replace(turn, asked_ns=event.stamp_ns)
    # Recognised speech may come as a single finished event.
    if event.state == "finished":
        turn = replace(turn, started_ns=event.stamp_ns)
    return _next(turn, event)


def _next(turn: Turn, event: UtteranceChanged) -> Turn:
    if turn.over:
        return turn
    turn = replace(turn, speaker=event.speaker, person_id=event.person_id or turn.person_id)
    if event.state == "started":
        return replace(turn, text=event.text, state="started", started_ns=event.stamp_ns)
    if event.state in UTTERANCE_ENDS:
        return replace(turn, text=event.text or turn.text, state=event.state, ended_ns=event.stamp_ns)
    return turn


LATE_S = 1.0
"""From here on a pause is noticed. People leave a fifth of a second between turns."""
_FORGOTTEN_NS = 120_000_000_000


class Waiting(Value):
    """State of the conversation: ``seconds`` since the participant stopped, or until the robot answered."""

    state: Literal["talking", "waiting", "answered"]
    person_id: str
    seconds: float = 0.0


def waiting(turns: Sequence[Turn], hearings: Iterable[Hearing], now_ns: int) -> Waiting | None:
    """State from ``turns`` in order of their start; None without recent participant speech."""
    by_id = {hearing.utterance_id: hearing for hearing in hearings if hearing.utterance_id}
    answer: Turn | None = None
    for turn in reversed(turns):
        if turn.begins_ns > now_ns:
            continue
        if turn.speaker in ("robot", "wizard"):
            answer = turn
            continue
        if turn.speaker != "participant" or (not turn.text and turn.utterance_id not in by_id):
            continue
        silent_ns = turn.ended_ns if turn.ended_ns is not None and turn.ended_ns <= now_ns else None
        if silent_ns is None and not turn.over and turn.utterance_id in by_id:
            silent_ns = by_id[turn.utterance_id].silent_since_ns
        if answer is not None and answer.started_ns is not None and silent_ns is not None:
            return Waiting("answered", turn.person_id, (answer.started_ns - silent_ns) / 1e9)
        if silent_ns is None:
            return Waiting("talking", turn.person_id)
        if now_ns - silent_ns > _FORGOTTEN_NS:
            return None
        return Waiting("waiting", turn.person_id, (now_ns - silent_ns) / 1e9)
    return None


_MEANS: dict[UtteranceOrigin, ReplyMeans] = {
    "typed": "typed", "phrase": "phrase", "filler": "filler", "assistant": "assistant", "suggestion": "suggestion",
    "dictated": "dictated", "own_voice": "own_voice",
}  # fmt: skip
_MAX_TURNS = 8


@dataclass(slots=True)
class _ParticipantTurn:
    """Turn of the participant, with replies that began during it."""

    turn_id: str
    began_ns: int
    person_id: str = ""
    ended_ns: int | None = None
    text_ns: int | None = None
    replies: list[UtteranceChanged] = field(default_factory=list)
    filled: bool = False
    answered: bool = False


class ResponseTimes:
    """Reports the answer of each participant turn: possibly a filler first, then the first other reply.

    A reply belongs to the newest turn that began before it. Earlier robot speech is not an answer, even if interrupted.
    """

    def __init__(self) -> None:
        self._turns: list[_ParticipantTurn] = []
        self._requested_ns: dict[str, int] = {}
        self._suggested_ns: dict[str, int] = {}
        self._edited: set[str] = set()

    def add(self, event: UtteranceReport | SuggestionChanged, at_ns: int) -> list[ResponseTimed]:
        """Process an event, heard of at ``at_ns``."""
        match event:
            case SuggestionChanged(state="displayed"):
                self._suggested_ns.setdefault(event.turn_id, event.stamp_ns)
            case SuggestionChanged(state="edited"):
                self._edited.add(event.utterance_id)
            case UtteranceCorrected():
                turn = self._turn(event.utterance_id)
                if turn is not None and event.speaker not in (None, "participant"):
                    return self._take_back(turn, at_ns)
                if turn is not None and event.person_id is not None:
                    turn.person_id = event.person_id
                return []
            case UtteranceChanged(speaker="participant"):
                return self._hear(event, at_ns)
            case UtteranceChanged(state="requested"):
                self._requested_ns[event.utterance_id] = event.stamp_ns
            case UtteranceChanged(state="started") if event.origin in _MEANS:
                return self._answer(event, at_ns)
        return []

    def _turn(self, turn_id: str) -> _ParticipantTurn | None:
        return next((turn for turn in reversed(self._turns) if turn.turn_id == turn_id), None)

    def _take_back(self, turn: _ParticipantTurn, at_ns: int) -> list[ResponseTimed]:
        """Remove a turn that was not a participant's: its replies answered the turn before."""
        self._turns.remove(turn)
        return [timed for reply in turn.replies for timed in self._answer(reply, at_ns)]

    def _hear(self, event: UtteranceChanged, at_ns: int) -> list[ResponseTimed]:
        turn = self._turn(event.utterance_id)
        if event.state == "failed":
            return [] if turn is None else self._take_back(turn, at_ns)
        if turn is None:
            turn = _ParticipantTurn(event.utterance_id, event.stamp_ns)
            self._turns = [*self._turns, turn][-_MAX_TURNS:]
        turn.person_id = event.person_id or turn.person_id
        if event.state not in ("finished", "interrupted"):
            return []
        turn.ended_ns, turn.text_ns = event.stamp_ns, at_ns
        replies, turn.replies = turn.replies, []
        return [timed for reply in replies for timed in self._timed(turn, reply, at_ns)]

    def _answer(self, reply: UtteranceChanged, at_ns: int) -> list[ResponseTimed]:
        turn = next((turn for turn in reversed(self._turns) if turn.began_ns <= reply.stamp_ns), None)
        if turn is None:
            return []
        if turn.ended_ns is None:
            turn.replies.append(reply)
            return []
        return self._timed(turn, reply, at_ns)

    def _timed(self, turn: _ParticipantTurn, reply: UtteranceChanged, at_ns: int) -> list[ResponseTimed]:
        ended_ns = turn.ended_ns or turn.began_ns
        means = _MEANS[reply.origin]
        filler = means == "filler"
        if turn.answered or (filler and turn.filled) or reply.stamp_ns - ended_ns > RESPONSE_LIMIT_S * 1e9:
            return []
        turn.filled, turn.answered = turn.filled or filler, not filler
        if means == "suggestion" and reply.utterance_id in self._edited:
            means = "edited_suggestion"
        return [
            ResponseTimed(
                at_ns, turn.turn_id, reply.utterance_id, means, ended_ns,
                text_ns=turn.text_ns, suggested_ns=self._suggested_ns.get(turn.turn_id),
                asked_ns=self._requested_ns.get(reply.utterance_id), first_sound_ns=reply.stamp_ns,
                person_id=turn.person_id,
            )
        ]  # fmt: skip
