"""What was said, turn by turn, from the events that report on it and correct it."""

from collections.abc import Iterable
from dataclasses import replace

from caris_desktop.domain.corrections import Correction, Corrections, WhoSpoke
from caris_desktop.domain.events import UtteranceChanged, UtteranceCorrected, UtteranceOrigin, UtteranceState
from caris_desktop.domain.value_class import dataclass

_ENDED: tuple[UtteranceState, ...] = ("finished", "interrupted", "failed")

UtteranceReport = UtteranceChanged | UtteranceCorrected


@dataclass(frozen=True, slots=True)
class Turn:
    """One utterance with its latest state; times on the session clock, None while they are not known.

    ``speaker`` is empty where nobody is sure. ``person_id`` is who says it, or to whom the robot says it.
    ``heard_text`` is what was made out before somebody corrected it, None where nobody did.
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
        """Whether at least a part of it was said, as far as is known by now.

        What the robot began to say was heard, also where its end is not known (the link was lost meanwhile).
        """
        return self.started_ns is not None and (self.state != "failed" or not is_heard(self))

    @property
    def over(self) -> bool:
        """Whether no more of it comes."""
        return self.state in _ENDED

    @property
    def begins_ns(self) -> int:
        """Where it stands among the others."""
        if self.started_ns is not None:
            return self.started_ns
        return self.asked_ns or self.ended_ns or 0


class Transcript:
    """Folds what is reported of utterances, as it comes: a correction may come before what it corrects."""

    def __init__(self) -> None:
        self._told: dict[str, Turn] = {}
        self._turns: dict[str, Turn] = {}
        self._corrections = Corrections()

    def take(self, event: UtteranceReport) -> None:
        turn_id = event.utterance_id
        if isinstance(event, UtteranceCorrected):
            self._corrections.take(event)
        else:
            known = self._told.get(turn_id)
            self._told[turn_id] = _first(event) if known is None else _next(known, event)
        if turn_id in self._told:
            self._turns[turn_id] = _corrected(self._told[turn_id], self._corrections.of(turn_id))

    def forget_before(self, at_ns: int) -> None:
        """Another session begins: of what was over by then nothing is left."""
        self._told = {turn_id: turn for turn_id, turn in self._told.items() if not turn.over or turn.begins_ns >= at_ns}
        self._turns = {turn_id: self._turns[turn_id] for turn_id in self._told}

    def turn(self, utterance_id: str) -> Turn | None:
        return self._turns.get(utterance_id)

    @property
    def turns(self) -> tuple[Turn, ...]:
        """In the order in which they were first heard of."""
        return tuple(self._turns.values())


def turns_of(events: Iterable[UtteranceReport]) -> tuple[Turn, ...]:
    """The turns in the order in which they were first heard of."""
    transcript = Transcript()
    for event in events:
        transcript.take(event)
    return transcript.turns


def in_order(turns: Iterable[Turn]) -> list[Turn]:
    """What was said, in the order in which it began."""
    return sorted((turn for turn in turns if turn.said), key=lambda turn: turn.begins_ns)


def is_heard(turn: Turn) -> bool:
    """Whether a microphone told who said it and what, so that either may be wrong."""
    return turn.origin in ("heard", "own_voice")


def newest_heard(turns: Iterable[Turn]) -> Turn | None:
    """The newest turn of which a microphone told."""
    return next((turn for turn in reversed(in_order(turns)) if is_heard(turn) and turn.text), None)


def next_speaker(turn: Turn, here: Iterable[str]) -> tuple[WhoSpoke, str]:
    """Who said it by one more press of the key: the participant, each person who is here, the robot, the wizard, not
    sure, and the participant again.
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
    # What a recogniser heard may come as one finished event.
    if event.state == "finished":
        turn = replace(turn, started_ns=event.stamp_ns)
    return _next(turn, event)


def _next(turn: Turn, event: UtteranceChanged) -> Turn:
    if turn.over:
        return turn
    turn = replace(turn, speaker=event.speaker, person_id=event.person_id or turn.person_id)
    if event.state == "started":
        return replace(turn, text=event.text, state="started", started_ns=event.stamp_ns)
    if event.state in _ENDED:
        return replace(turn, text=event.text or turn.text, state=event.state, ended_ns=event.stamp_ns)
    return turn
