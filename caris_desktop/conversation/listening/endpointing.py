"""Turn-taking: start, pauses and end of turns, from voice probabilities per 32 ms.

No clock: all times are those of the sound.
"""

from typing import Literal

from caris_desktop.conversation.listening.endpoint_delay_model import SilenceOfPeople
from caris_desktop.domain.value_class import Value

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
