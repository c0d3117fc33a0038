"""Sound: source names, playback and hearing."""

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
