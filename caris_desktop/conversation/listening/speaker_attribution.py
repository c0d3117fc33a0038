"""Speaker assignment of heard speech: participant or wizard, and which person present; may be undecided.

A person's probability depends on their presence during the speech, and is higher facing the robot, near it, and while
the wizard attends to them. An unseen person may have spoken, too. Mouth movement is not used: frame rate and face size
of the robot's camera are too low.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence

from caris_desktop.conversation.listening.robot_speech_filter import likeness
from caris_desktop.domain.value_class import Value

_KEPT_NS = 120_000_000_000
_SURE = 0.7
# A person alone for this fraction of an utterance is its speaker, unless an unseen person spoke.
_ALL_ALONG, _ALONE_AT_LEAST = 0.8, 0.5
_UNSEEN = 0.12
_FACING = {True: 1.0, None: 0.7, False: 0.15}
_NEAR_M, _FALLS_OVER_M = 0.8, 1.2
_DISTANCE_NOT_KNOWN = 0.6
_ATTENDED = 1.8
_SAME_TIME, _SAME_WORDS = 0.6, 0.6


class Here(Value):
    """Person present. ``facing`` the robot and the distance are None if unknown."""

    person_id: str
    facing: bool | None = None
    distance_m: float | None = None
    attended: bool = False


class WizardsVoice(Value):
    """Speech of the wizard's own microphone; ``ended_ns`` is None while it lasts."""

    started_ns: int
    ended_ns: int | None
    text: str


class PeopleHere:
    """People present over the last two minutes."""

    def __init__(self) -> None:
        self._since: deque[tuple[int, tuple[Here, ...]]] = deque()

    def note(self, stamp_ns: int, here: Iterable[Here]) -> None:
        """Set the people present from that time on."""
        self._since.append((stamp_ns, tuple(here)))
        while len(self._since) > 1 and self._since[1][0] < stamp_ns - _KEPT_NS:
            self._since.popleft()

    def who_spoke(self, started_ns: int, ended_ns: int) -> tuple[str, float]:
        """Id of the speaker and the probability; empty if undecided. A person who was alone is always returned, however
        unlikely.
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
    """True if a participant's microphone heard the wizard: the wizard's own microphone heard the same words at the same
    time.
    """
    for voice in voices:
        together_ns = min(ended_ns, voice.ended_ns or ended_ns) - max(started_ns, voice.started_ns)
        if together_ns >= _SAME_TIME * max(1, ended_ns - started_ns) and likeness(text, voice.text) >= _SAME_WORDS:
            return True
    return False
