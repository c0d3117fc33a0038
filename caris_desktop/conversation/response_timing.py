"""Response time: how long the participant waits for the robot, from speech events."""

from collections.abc import Iterable, Sequence
from dataclasses import field
from typing import Literal

from caris_desktop.conversation.conversation_transcript import Turn, UtteranceReport
from caris_desktop.domain.events import (
    RESPONSE_LIMIT_S,
    ReplyMeans,
    ResponseTimed,
    SuggestionChanged,
    UtteranceChanged,
    UtteranceCorrected,
    UtteranceOrigin,
)
from caris_desktop.domain.sound_values import Hearing
from caris_desktop.domain.value_class import Value, dataclass

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
                return self._correct(event, at_ns)
            case UtteranceChanged(speaker="participant"):
                return self._hear(event, at_ns)
            case UtteranceChanged(state="requested"):
                self._requested_ns[event.utterance_id] = event.stamp_ns
            case UtteranceChanged(state="started") if event.origin in _MEANS:
                return self._answer(event, at_ns)
        return []

    def _turn(self, turn_id: str) -> _ParticipantTurn | None:
        return next((turn for turn in reversed(self._turns) if turn.turn_id == turn_id), None)

    def _correct(self, event: UtteranceCorrected, at_ns: int) -> list[ResponseTimed]:
        turn = self._turn(event.utterance_id)
        if turn is not None and event.speaker not in (None, "participant"):
            return self._take_back(turn, at_ns)
        if turn is not None and event.person_id is not None:
            turn.person_id = event.person_id
        return []

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
