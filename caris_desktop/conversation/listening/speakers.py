"""Who said what was heard: the participant or the wizard, and which of the people here. "Not sure" is an answer.

A person speaks for as long as they were here while the voice was heard, more likely facing the robot than not, near
than far, and whom the wizard deals with than another. Somebody whom no camera sees may have spoken, too. What mouths do
is not looked at: pictures of the robot's camera are too few and faces in them too small for that to tell anything.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence

from caris_desktop.conversation.listening.own_words import likeness
from caris_desktop.domain.value_class import dataclass

_KEPT_NS = 120_000_000_000
_SURE = 0.7
# Who is alone here for so much of an utterance said it, but for somebody whom no camera sees.
_ALL_ALONG, _ALONE_AT_LEAST = 0.8, 0.5
_UNSEEN = 0.12
_FACING = {True: 1.0, None: 0.7, False: 0.15}
_NEAR_M, _FALLS_OVER_M = 0.8, 1.2
_DISTANCE_NOT_KNOWN = 0.6
_ATTENDED = 1.8
_SAME_TIME, _SAME_WORDS = 0.6, 0.6


@dataclass(frozen=True, slots=True)
class Here:
    """One person who is here. ``facing`` the robot and the distance to it are None where that is not known."""

    person_id: str
    facing: bool | None = None
    distance_m: float | None = None
    attended: bool = False


@dataclass(frozen=True, slots=True)
class WizardsVoice:
    """What the wizard's own microphone heard, and when; ``ended_ns`` is None while they speak on."""

    started_ns: int
    ended_ns: int | None
    text: str


class PeopleHere:
    """Who was here at each moment of the last two minutes."""

    def __init__(self) -> None:
        self._since: deque[tuple[int, tuple[Here, ...]]] = deque()

    def note(self, stamp_ns: int, here: Iterable[Here]) -> None:
        """From that moment on these are here."""
        self._since.append((stamp_ns, tuple(here)))
        while len(self._since) > 1 and self._since[1][0] < stamp_ns - _KEPT_NS:
            self._since.popleft()

    def who_spoke(self, started_ns: int, ended_ns: int) -> tuple[str, float]:
        """The id of who spoke then, and how likely that is; empty where nobody can be sure. Of somebody who was alone
        here it is always told, however unlikely they look.
        """
        chances: dict[str, float] = {}
        shares: dict[str, float] = {}
        whole_ns = max(1, ended_ns - started_ns)
        for number, (since_ns, here) in enumerate(self._since):
            until_ns = self._since[number + 1][0] if number + 1 < len(self._since) else ended_ns + 1
            share = (min(until_ns, started_ns + whole_ns) - max(since_ns, started_ns)) / whole_ns
            if share <= 0:
                continue
            for person in here:
                chances[person.person_id] = chances.get(person.person_id, 0.0) + share * _chance(person)
                shares[person.person_id] = shares.get(person.person_id, 0.0) + share
        likeliest = max(chances, key=chances.__getitem__, default="")
        if not likeliest:
            return "", 0.0
        likely = chances[likeliest] / (_UNSEEN + sum(chances.values()))
        if len(shares) == 1 and shares[likeliest] >= _ALL_ALONG:
            return likeliest, max(likely, _ALONE_AT_LEAST)
        return (likeliest, likely) if likely >= _SURE else ("", 0.0)


def _chance(person: Here) -> float:
    near = _DISTANCE_NOT_KNOWN
    if person.distance_m is not None:
        near = math.exp(-max(0.0, person.distance_m - _NEAR_M) / _FALLS_OVER_M)
    return _FACING[person.facing] * near * (_ATTENDED if person.attended else 1.0)


def is_wizards(text: str, started_ns: int, ended_ns: int, voices: Sequence[WizardsVoice]) -> bool:
    """Whether what a participant's microphone heard is the wizard's voice: their own microphone heard the same words at
    the same time.
    """
    for voice in voices:
        together_ns = min(ended_ns, voice.ended_ns or ended_ns) - max(started_ns, voice.started_ns)
        if together_ns >= _SAME_TIME * max(1, ended_ns - started_ns) and likeness(text, voice.text) >= _SAME_WORDS:
            return True
    return False
