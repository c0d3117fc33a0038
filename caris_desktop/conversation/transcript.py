"""What was said, turn by turn, from the events that report on it."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from caris_desktop.domain.events import Speaker, UtteranceChanged, UtteranceOrigin, UtteranceState

_ENDED: tuple[UtteranceState, ...] = ("finished", "interrupted", "failed")


@dataclass(frozen=True, slots=True)
class Turn:
    """One utterance with its latest state; times on the session clock, None while they are not known."""

    utterance_id: str
    speaker: Speaker
    text: str
    origin: UtteranceOrigin
    state: UtteranceState
    started_ns: int | None = None
    ended_ns: int | None = None

    @property
    def said(self) -> bool:
        """Whether at least a part of it was said."""
        return self.started_ns is not None and self.state != "failed"


class Conversation:
    """The newest ``max_turns`` turns, in the order in which they were first heard of."""

    def __init__(self, *, max_turns: int = 500) -> None:
        self._max_turns = max_turns
        self._turns: dict[str, Turn] = {}

    def add(self, event: UtteranceChanged) -> None:
        known = self._turns.get(event.utterance_id)
        self._turns[event.utterance_id] = _first(event) if known is None else _next(known, event)
        while len(self._turns) > self._max_turns:
            del self._turns[next(iter(self._turns))]

    @property
    def turns(self) -> tuple[Turn, ...]:
        return tuple(self._turns.values())


def turns_of(events: Iterable[UtteranceChanged]) -> tuple[Turn, ...]:
    conversation = Conversation()
    for event in events:
        conversation.add(event)
    return conversation.turns


def _first(event: UtteranceChanged) -> Turn:
    turn = Turn(event.utterance_id, event.speaker, event.text, event.origin, "requested")
    # What a recogniser heard comes as one finished event.
    if event.state == "finished":
        turn = replace(turn, started_ns=event.stamp_ns)
    return _next(turn, event)


def _next(turn: Turn, event: UtteranceChanged) -> Turn:
    if turn.state in _ENDED:
        return turn
    if event.state == "started":
        return replace(turn, text=event.text, state="started", started_ns=event.stamp_ns)
    if event.state in _ENDED:
        return replace(turn, text=event.text, state=event.state, ended_ns=event.stamp_ns)
    return turn
