"""Sound: source names, playback and hearing, and timestamps of sound that arrives in pieces."""

from collections import deque
from dataclasses import field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value

MICROPHONE = "microphone"
"""A microphone of this computer for the participant, as in a laboratory with the wizard behind the wall."""
ROBOT_MICROPHONE = "robot microphone"
WIZARD_MICROPHONE = "wizard microphone"
ROBOT_VOICE = "robot voice"
PARTICIPANT_SOURCES = (ROBOT_MICROPHONE, MICROPHONE)
Role = Literal["participant", "wizard"]
"""Person for whom a microphone is used."""
TalkTo = Literal["robot", "dictation"]
"""Target of the wizard's voice: the robot, or the Speak field as text."""


class PlayedSound(Value, eq=False):
    """Sound that a loudspeaker plays, sent as soon as known: the echo canceller's reference. Never recorded.

    ``samples`` is int16, shape (samples, channels); the first is heard at ``stamp_ns``, which may be in the future. An
    utterance that is played during its synthesis is sent in several pieces, in order. ``utterance_id`` and ``text`` are
    empty for sound other than the console's utterances.
    """

    stamp_ns: int
    utterance_id: str
    text: str
    sample_rate_hz: int
    samples: NDArray[np.int16] = field(metadata={"shape": (-1, -1)})


def joined(before: PlayedSound, piece: PlayedSound) -> PlayedSound:
    """Both pieces as one, with silence between them."""
    frames = (piece.stamp_ns - before.stamp_ns) * before.sample_rate_hz // 1_000_000_000 - len(before.samples)
    silence = np.zeros((max(0, frames), before.samples.shape[1]), np.int16)
    return replace(before, samples=np.concatenate([before.samples, silence, piece.samples]))


class PlayedSoundEnded(Value):
    """End of an utterance at ``stamp_ns``, whatever was still to be played. Never recorded."""

    stamp_ns: int
    utterance_id: str


class Hearing(Value):
    """Current speech at one microphone.

    ``utterance_id`` is the current turn, empty between turns. ``committed`` words are final, ``tentative`` words may
    still change. ``speech_started_ns`` is the start of the voice, ``silent_since_ns`` the start of the silence, None
    during speech. ``turn_over`` is the probability that the turn is over, 0 to 1, None if unknown. ``revision`` grows
    when the words of the turn change or speech continues.
    """

    stamp_ns: int
    source: str
    speaking: bool
    speaker: Literal["", "participant", "robot", "wizard"] = ""
    utterance_id: str = ""
    committed: str = ""
    tentative: str = ""
    speech_started_ns: int | None = None
    silent_since_ns: int | None = None
    turn_over: float | None = None
    revision: int = 0


# Timestamps of sound that arrives in pieces over a network.

_LATE_NS = 60_000_000
_FOR_NS = 1_000_000_000
_SLEW = 0.01


class SoundClock:
    """Clock that gives the time of each piece's first sample.

    A network adds varying delay; the samples themselves keep time. So a piece follows the one before it, however late
    it arrives, until all pieces of a second were late: then samples are missing.
    """

    def __init__(self) -> None:
        self._due_ns: int | None = None
        self._late: deque[tuple[int, int]] = deque()

    def stamp(self, *, arrival_ns: int, length_ns: int) -> tuple[int, int]:
        """Time of the first sample of a piece of this length, and the missing time before it."""
        latest_ns = arrival_ns - length_ns  # it had ended when it was sent
        if self._due_ns is None:
            self._due_ns = latest_ns
        late_ns = latest_ns - self._due_ns
        missing_ns = self._missing_ns(arrival_ns, late_ns)
        # Two clocks always differ slightly, and the first piece may itself have been late.
        most_ns = round(length_ns * _SLEW)
        follow_ns = missing_ns or max(-most_ns, min(most_ns, *(late for _, late in self._late)))
        stamp_ns = self._due_ns + follow_ns
        self._due_ns = stamp_ns + length_ns
        if missing_ns:
            self._late.clear()
        return stamp_ns, missing_ns

    def _missing_ns(self, arrival_ns: int, late_ns: int) -> int:
        if late_ns <= 0:
            self._late.clear()
        self._late.append((arrival_ns, late_ns))
        if late_ns > _FOR_NS:
            return late_ns
        while len(self._late) > 2 and arrival_ns - self._late[1][0] >= _FOR_NS:
            self._late.popleft()
        least_ns = min(late for _, late in self._late)
        return least_ns if least_ns > _LATE_NS and arrival_ns - self._late[0][0] >= _FOR_NS else 0
