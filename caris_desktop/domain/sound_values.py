"""Sound: source names, playback and hearing."""

from dataclasses import field, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import dataclass

MICROPHONE = "microphone"
"""A microphone of this computer that hears the participant, as in a laboratory with the wizard behind the wall."""
ROBOT_MICROPHONE = "robot microphone"
WIZARD_MICROPHONE = "wizard microphone"
ROBOT_VOICE = "robot voice"
PARTICIPANT_SOURCES = (ROBOT_MICROPHONE, MICROPHONE)
Role = Literal["participant", "wizard"]
"""Whom a microphone is there to hear."""
TalkTo = Literal["robot", "dictation"]
"""Where the wizard's voice goes: out of the robot, or into the Speak field as text."""


@dataclass(frozen=True, slots=True, eq=False)
class PlayedSound:
    """What a loudspeaker plays, told as soon as it is known: the reference of the echo canceller. Never recorded.

    ``samples`` is int16, shape (samples, channels); the first of them is heard at ``stamp_ns``, which may lie ahead.
    An utterance that is heard while it is still being made is told in several pieces, in their order.
    ``utterance_id`` and ``text`` are empty where it is no utterance of the console's.
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


@dataclass(frozen=True, slots=True)
class PlayedSoundEnded:
    """Nothing of that utterance is heard any more from ``stamp_ns`` on, whatever was to be played. Never recorded."""

    stamp_ns: int
    utterance_id: str


@dataclass(frozen=True, slots=True)
class Hearing:
    """What is heard now at one microphone.

    ``utterance_id`` is the turn under way, empty between turns. ``committed`` words stay as they are, ``tentative``
    ones may still change. ``speech_started_ns`` is when its voice began, ``silent_since_ns`` since when there is none,
    None while somebody speaks. ``turn_over`` is how likely the turn is over, 0 to 1, None where that is not known.
    ``revision`` grows whenever the words of the turn change or somebody speaks on.
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
