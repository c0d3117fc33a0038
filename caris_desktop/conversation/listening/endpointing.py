"""Turn-taking: start, pauses and end of turns, from voice probabilities per 32 ms.

No clock: all times are those of the sound.
"""

import math
from collections import OrderedDict, deque
from typing import Literal

from caris_desktop.domain.value_class import Value

# Adaptive endpointing delay: pause lengths within turns, learned per person.

LEAST_S, MOST_S = 0.5, 3.0
_USUAL_S = (0.25, 0.3, 0.4, 0.5, 0.75)
"""Pauses of people in conversation, for as long as little is known of this one."""
_MAX_PAUSES = 40
_SHARE = 0.9
_BEYOND = 1.15
_PEOPLE_AT_MOST, _TURNS_AT_MOST = 50, 30


class EndpointDelayModel:
    """Delay of one person: a high quantile of their pauses, robust against single long ones, with typical pauses as a
    prior.
    """

    def __init__(self) -> None:
        self._pauses_s: deque[float] = deque(maxlen=_MAX_PAUSES)

    def learn(self, pause_s: float) -> None:
        """Add a pause after which they continued."""
        if pause_s <= MOST_S:
            self._pauses_s.append(pause_s)

    def unlearn(self, pause_s: float) -> None:
        """Remove a pause that belonged to another person."""
        if pause_s in self._pauses_s:
            self._pauses_s.remove(pause_s)

    @property
    def seconds(self) -> float:
        """Silence after which this person has usually finished."""
        known = sorted((*_USUAL_S, *self._pauses_s))
        at = _SHARE * (len(known) - 1)
        low, rest = math.floor(at), at - math.floor(at)
        quantile = known[low] + rest * (known[min(low + 1, len(known) - 1)] - known[low])
        return min(MOST_S, max(LEAST_S, _BEYOND * quantile))


class SilenceOfPeople:
    """Delays of all speakers at a microphone. The speaker of a turn is known only later; until then the last speaker is
    assumed.
    """

    def __init__(self) -> None:
        self._people: OrderedDict[str, EndpointDelayModel] = OrderedDict()
        self._turns: OrderedDict[str, list[float]] = OrderedDict()
        self._speaker_of: OrderedDict[str, str] = OrderedDict()
        self.speaker = ""
        """Whose turn it is taken to be: a person's id, empty for somebody."""

    def learn(self, turn: str, pause_s: float) -> None:
        """Add a pause within that turn."""
        self._turns.setdefault(turn, []).append(pause_s)
        while len(self._turns) > _TURNS_AT_MOST:
            self._turns.popitem(last=False)
        self._of(self._speaker_of.get(turn, self.speaker)).learn(pause_s)

    def spoken_by(self, turn: str, person_id: str) -> None:
        """Assign the turn to its speaker."""
        taken_for = self._speaker_of.get(turn, self.speaker)
        self._speaker_of[turn] = self.speaker = person_id
        while len(self._speaker_of) > _TURNS_AT_MOST:
            self._speaker_of.popitem(last=False)
        if taken_for != person_id:
            for pause_s in self._turns.get(turn, ()):
                self._of(taken_for).unlearn(pause_s)
                self._of(person_id).learn(pause_s)

    @property
    def seconds(self) -> float:
        """Delay for the present speaker."""
        return self._of(self.speaker).seconds

    def _of(self, person_id: str) -> EndpointDelayModel:
        silence = self._people.setdefault(person_id, EndpointDelayModel())
        self._people.move_to_end(person_id)
        while len(self._people) > _PEOPLE_AT_MOST:
            self._people.popitem(last=False)
        return silence


VOICE_FROM, VOICE_UNTIL = 0.5, 0.35
"""What is like a voice as much as this begins one; less than that ends it."""
BEGINS_AFTER_NS = 190_000_000
"""A click or a cough is no turn."""
_LATE_NS = 32_000_000
"""For so long the network still takes a silence for a voice."""
PAUSE_NS = 200_000_000 + _LATE_NS
"""A silence of this length may be the end of the turn."""
_FORGET_NS = 600_000_000
_SPOKE_ON_WITHIN_NS = 3_000_000_000
_SURE, _UNSURE = 0.4, 0.3

Change = Literal["began", "paused", "spoke on", "over"]


class SilenceBounds(Value):
    """Minimum and maximum silence that ends a turn, whatever the probability."""

    at_least_s: float = 0.3
    at_most_s: float = 3.0


def silence_to_wait_s(turn_over: float | None, learnt_s: float, bounds: SilenceBounds) -> float:
    """Silence that ends the turn, by the probability that it is over (None: unknown).

    If it is likely over, the minimum; if not, as long as this person's pauses take.
    """
    unsure = 1.0 if turn_over is None else min(1.0, max(0.0, (_SURE - turn_over) / (_SURE - _UNSURE)))
    wait_s = bounds.at_least_s + unsure * (learnt_s - bounds.at_least_s)
    return min(bounds.at_most_s, max(bounds.at_least_s, wait_s))


class TurnTaking:
    """Turns at one microphone. ``turn`` names the present one for the learned pauses."""

    def __init__(self, silence: SilenceOfPeople, bounds: SilenceBounds) -> None:
        self._silence = silence
        self.bounds = bounds
        self._voiced_ns = self._audio_end_ns = 0
        self._turn_over: float | None = None
        self._last_turn, self._last_ended_ns = "", 0
        self.turn = ""
        self.under_way = False
        self.speaking = False
        self.voiced = False
        """Whether there is voice at this very moment."""
        self.started_ns = 0
        """Where the voice of the turn began."""
        self.voice_ended_ns = 0
        """Where there was voice last."""

    @property
    def beginning_ns(self) -> int:
        """Duration of voice that is not a turn yet, including short silences."""
        return self._audio_end_ns - self.started_ns if self._voiced_ns and not self.under_way else 0

    def process(self, stamp_ns: int, length_ns: int, voice: float) -> Change | None:
        """Process the next window with its voice probability."""
        end_ns = self._audio_end_ns = stamp_ns + length_ns
        self.voiced = voice >= (VOICE_UNTIL if self.voiced else VOICE_FROM)
        if self.voiced:
            return self._process_voice(stamp_ns, end_ns)
        return self._process_silence(end_ns)

    def judge(self, turn_over: float) -> None:
        """Set the probability that the turn is over at this pause. Before, the person's learned delay applies."""
        self._turn_over = turn_over

    def end(self) -> None:
        """End the present turn, without learning from its pauses."""
        self.under_way = self.speaking = self.voiced = False
        self._voiced_ns = 0
        self._last_turn = ""

    def another_spoke(self) -> None:
        """The robot answered: silence after the last turn was not a pause in it."""
        self._last_turn = ""

    def _process_voice(self, stamp_ns: int, end_ns: int) -> Change | None:
        change: Change | None = None
        if not self.under_way:
            if self._voiced_ns == 0:
                self.started_ns = stamp_ns
            self._voiced_ns += end_ns - stamp_ns
            if self._voiced_ns >= BEGINS_AFTER_NS:
                change = "began"
                self.under_way = self.speaking = True
                self._learn_from_cut()
        elif not self.speaking:
            change = "spoke on"
            self.speaking = True
            self._silence.learn(self.turn, (stamp_ns - self.voice_ended_ns) / 1e9)
        self.voice_ended_ns = max(self.started_ns, end_ns - _LATE_NS)
        return change

    def _process_silence(self, end_ns: int) -> Change | None:
        silent_ns = end_ns - self.voice_ended_ns
        if not self.under_way:
            if silent_ns > _FORGET_NS:
                self._voiced_ns = 0
            return None
        if self.speaking:
            if silent_ns < PAUSE_NS:
                return None
            self.speaking = False
            self._turn_over = None
            return "paused"
        if silent_ns < silence_to_wait_s(self._turn_over, self._silence.seconds, self.bounds) * 1e9:
            return None
        self.under_way = False
        self._voiced_ns = 0
        self._last_turn, self._last_ended_ns = self.turn, self.voice_ended_ns
        return "over"

    def _learn_from_cut(self) -> None:
        """Learn from a turn that was cut: a speaker who continues soon, with nobody in between, had not finished."""
        pause_ns = self.started_ns - self._last_ended_ns
        if self._last_turn and pause_ns <= _SPOKE_ON_WITHIN_NS:
            self._silence.learn(self._last_turn, pause_ns / 1e9)
        self._last_turn = ""
