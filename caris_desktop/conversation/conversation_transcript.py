"""Conversation transcript, turn by turn, from utterance events and corrections."""

from collections.abc import Iterable
from dataclasses import replace

from caris_desktop.domain.corrections import Correction, Corrections, WhoSpoke
from caris_desktop.domain.events import UtteranceChanged, UtteranceCorrected, UtteranceOrigin, UtteranceState
from caris_desktop.domain.value_class import Value

_ENDED: tuple[UtteranceState, ...] = ("finished", "interrupted", "failed")

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
        return self.state in _ENDED

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
    """Turns from events, in order of their first event."""
    transcript = Transcript()
    for event in events:
        transcript.add(event)
    return transcript.turns


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
    if event.state in _ENDED:
        return replace(turn, text=event.text or turn.text, state=event.state, ended_ns=event.stamp_ns)
    return turn
