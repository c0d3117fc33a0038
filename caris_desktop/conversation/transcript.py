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


def turns_of(events: Iterable[UtteranceChanged]) -> tuple[Turn, ...]:
    """The turns in the order in which they were first heard of."""
    turns: dict[str, Turn] = {}
    for event in events:
        known = turns.get(event.utterance_id)
        turns[event.utterance_id] = _first(event) if known is None else _next(known, event)
    return tuple(turns.values())


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
