"""Adaptive endpointing delay: pause lengths within turns, learned per person."""

import math
from collections import OrderedDict, deque

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
