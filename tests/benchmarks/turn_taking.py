"""Endpointing: cut-offs and dead air of silence alone and of the console, on the same turns.

``python -m tests.benchmarks.turn_taking [--held-out] [--turns N] [--seed S]`` prints one JSON object. Its turns contain
pauses of 0.1 to 1.5 s between and within clauses, of a speaker with short pauses and of one with long ones. Each is
synthesised as one sentence and split afterwards, so that the part before a pause sounds as if it continued. The
console's recogniser processes them in real time; computing time of its networks is added. A cut-off is a turn that is
ended in one of its pauses; dead air is the time from the end of speech to the detected end of the turn, without cut-off
turns.

``--held-out`` uses other sentences, to which nothing was fitted. ``low_high`` is the 95 % interval (bootstrap over
turns, with the same samples for both methods); ``ours_less_silence`` is the interval of the difference, below zero if
the console is better.

``silence_alone_at_same_dead_air`` is the silence threshold with the same dead air, with its cut-offs.

Words: the delay from the end of speech to the commit of the last word or the end of the turn, and the word error rate
against the intended text. The endpointing network was trained on people: synthetic voices have little of the intonation
that it uses, so results with real speech are better.
"""

import argparse
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import jiwer
import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.echo import EchoCanceller
from caris_desktop.conversation.listening.endpointing import (
    SilenceOfPeople,
    TurnModel,
    TurnTaking,
    VoiceActivity,
)
from caris_desktop.conversation.listening.engines import LocalEngine, Recognised
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings, UseSilence
from caris_desktop.conversation.listening.robot_speech_filter import RobotSpeechFilter
from caris_desktop.conversation.listening.speech_segmenter import SpeechSegmenter, TurnInterval
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE, Hearing
from tests.benchmarks.made_turns import HELD_OUT, RATE_HZ, SENTENCES, MadeTurn, made_turn

_CHUNK = RATE_HZ // 20
_SILENCES_S = (0.3, 0.6)
_HABITS = {"brief": (0.1, 0.7), "slow": (0.1, 1.5)}
_TOLERANCE_S = 0.15
_DRAWS = 2000


@dataclass(slots=True)
class Kept:
    """Results of a method: number of cut pauses and turns, and dead air of the other turns."""

    pauses: int = 0
    cut_pauses: int = 0
    turns: int = 0
    cut_turns: int = 0
    dead_air_s: list[float] = field(default_factory=list)
    of_turns: list[tuple[bool, float]] = field(default_factory=list)
    """For each turn whether it was cut off, and its dead air; NaN if its end was not detected."""

    def add(self, turn: MadeTurn, ends: list[tuple[float, float]]) -> None:
        """Add a turn; ``ends`` are pairs of the end of speech and its detection, in seconds of the turn."""
        cut = sum(any(abs(voice_s - pause.from_s) < _TOLERANCE_S for voice_s, _ in ends) for pause in turn.pauses)
        self.pauses += len(turn.pauses)
        self.cut_pauses += cut
        self.turns += 1
        self.cut_turns += bool(cut)
        dead_air_s = [known_s - turn.ended_s for voice_s, known_s in ends if voice_s > turn.ended_s - _TOLERANCE_S]
        self.dead_air_s += dead_air_s
        self.of_turns.append((bool(cut), dead_air_s[-1] if dead_air_s else float("nan")))

    def told(self) -> dict[str, float]:
        return {
            "turns_cut_off_percent": round(100 * self.cut_turns / self.turns, 1),
            "pauses_cut_off_percent": round(100 * self.cut_pauses / self.pauses, 1),
            "dead_air_mean_s": round(float(np.mean(self.dead_air_s)), 3),
            "dead_air_p95_s": round(float(np.quantile(self.dead_air_s, 0.95)), 3),
        }

    def bounds(self, less: "Kept | None" = None) -> dict[str, list[float]]:
        """``[low, high]`` of cut-offs in percent and mean dead air; ``less`` are the results to subtract."""
        turns = np.array(self.of_turns, float) - (0.0 if less is None else np.array(less.of_turns, float))
        drawn = np.random.default_rng(0).integers(0, len(turns), (_DRAWS, len(turns)))
        low, high = np.quantile(np.nanmean(turns[drawn], axis=1), (0.025, 0.975), axis=0)
        return {
            "turns_cut_off_percent": [round(100 * low[0], 1), round(100 * high[0], 1)],
            "dead_air_mean_s": [round(low[1], 3), round(high[1], 3)],
        }


class Participant:
    """Participant at the robot's microphone, with one adaptive segmenter for all turns."""

    def __init__(self, engine: LocalEngine, turn_model: TurnModel) -> None:
        self._engine = engine
        self._turn_model = turn_model
        self._silence = SilenceOfPeople()
        self._now_s = 0.0
        self.ends: list[tuple[float, float]] = []
        self.committed_s = 0.0
        self._committed = ""
        self.texts: list[str] = []

    def hear(self, turn: MadeTurn) -> None:
        """Process the whole turn, with the silence after it."""
        self.ends, self.texts, self.committed_s = [], [], 0.0
        self._now_s = 0.0
        ear = SpeechSegmenter(
            ROBOT_MICROPHONE,
            TurnTaking(self._silence, UseSilence()),
            VoiceActivity(),
            canceller=EchoCanceller(),
            robot_speech=RobotSpeechFilter(),
            turn_over=self._judge,
            report=self._on_reported,
        )
        coming: tuple[float, TurnInterval, Recognised] | None = None
        for at in range(0, len(turn.sound), _CHUNK):
            # A chunk is available after its last sample.
            self._now_s = max(self._now_s, (at + _CHUNK) / RATE_HZ)
            if coming is not None and self._now_s >= coming[0]:
                _, stretch, text = coming
                coming = None
                ear.add_result(stretch, text)
            sound = turn.sound[at : at + _CHUNK, np.newaxis]
            ear.process(AudioChunk(1 + round(at * 1e9 / RATE_HZ), ROBOT_MICROPHONE, RATE_HZ, sound))
            wanted = ear.next_interval(self._engine.every_s) if coming is None else None
            if wanted is not None:
                began_s = time.process_time()
                text = self._engine.transcribe(
                    wanted.sound, wanted.before, careful=wanted.at_pause, voice_s=wanted.voice_s
                )
                coming = self._now_s + time.process_time() - began_s, wanted, text
            ear.judge()

    def _judge(self, sound: NDArray[np.float32]) -> float:
        began_s = time.process_time()
        over = self._turn_model.turn_over(sound)
        self._now_s += time.process_time() - began_s
        return over

    def _on_reported(self, told: Hearing | UtteranceChanged) -> None:
        match told:
            case UtteranceChanged(state="finished", stamp_ns=stamp_ns, text=text):
                self.ends.append((stamp_ns / 1e9, self._now_s))
                self.texts.append(text)
                self._commit(text)
            case Hearing(committed=words):
                self._commit(words)

    def _commit(self, words: str) -> None:
        if words and words != self._committed:
            self._committed, self.committed_s = words, self._now_s


def silence_alone(turn: MadeTurn, silences_s: tuple[float, ...]) -> dict[float, list[tuple[float, float]]]:
    """Detected ends for each silence threshold, with the same voice activity."""
    ends: dict[float, list[tuple[float, float]]] = {}
    sound = turn.sound.astype(np.float32) / 32768
    for silence_s in silences_s:
        turns = TurnTaking(SilenceOfPeople(), UseSilence(silence_s, silence_s))
        voices = VoiceActivity()
        made = ends.setdefault(silence_s, [])
        for at in range(0, len(sound) - 511, 512):
            change = turns.process(at * 1_000_000_000 // RATE_HZ, 32_000_000, voices.probability(sound[at : at + 512]))
            if change == "over":
                made.append((turns.voice_ended_ns / 1e9, (at + 512) / RATE_HZ))
    return ends


def made_turns(turns: int, seed: int, voice: str, of: Sequence[str]) -> Iterator[tuple[str, list[MadeTurn]]]:
    """Turns of each participant."""
    for habit, (shortest_s, longest_s) in _HABITS.items():
        chance = np.random.default_rng((seed, len(habit)))
        sentences = map(str, chance.permutation(list(of))[:turns])
        yield habit, [made_turn(each, voice, chance, shortest_s=shortest_s, longest_s=longest_s) for each in sentences]


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--turns", type=int, default=len(SENTENCES), help="of each of the two participants")
    options.add_argument("--voice", default="joe", help="Piper's joe, or one of espeak-ng, such as en-gb")
    options.add_argument("--held-out", action="store_true", help="sentences to which nothing was fitted")
    options.add_argument("--seed", type=int, default=11)
    given = options.parse_args()
    engine, turn_model = LocalEngine(RecogniserSettings()), TurnModel.find()
    if turn_model is None:
        raise SystemExit("the network for the ends of turns is not installed (packaging/setup.sh)")
    ours, alone = Kept(), {silence_s: Kept() for silence_s in _SILENCES_S}
    each: dict[str, dict[str, float]] = {}
    everything: list[MadeTurn] = []
    sentences: list[str] = []
    expected: list[str] = []
    committed_s: list[float] = []
    ended_off_s: list[float] = []
    for name, turns in made_turns(given.turns, given.seed, given.voice, HELD_OUT if given.held_out else SENTENCES):
        participant, own = Participant(engine, turn_model), Kept()
        for turn in turns:
            participant.hear(turn)
            for kept in (ours, own):
                kept.add(turn, participant.ends)
            for silence_s, ends in silence_alone(turn, _SILENCES_S).items():
                alone[silence_s].add(turn, ends)
            sentences.append(_plain(turn.text))
            expected.append(_plain(" ".join(participant.texts)))
            committed_s.append(participant.committed_s - turn.ended_s)
            ended_off_s += [voice_s - turn.ended_s for voice_s, _ in participant.ends[-1:]]
        each[name] = own.told()
        everything += turns
    dead_air_s = float(np.mean(ours.dead_air_s))
    same = Kept()
    overhead_s = float(np.mean(alone[0.6].dead_air_s)) - 0.6
    for turn in everything:
        same.add(turn, silence_alone(turn, (dead_air_s - overhead_s,)).popitem()[1])
    print(
        json.dumps(
            {
                "turns": ours.turns,
                "pauses": ours.pauses,
                "silence_300_ms": alone[0.3].told(),
                "silence_600_ms": alone[0.6].told(),
                "ours": ours.told(),
                "low_high": {
                    "silence_300_ms": alone[0.3].bounds(),
                    "silence_600_ms": alone[0.6].bounds(),
                    "ours": ours.bounds(),
                },
                "ours_less_silence": {
                    "silence_300_ms": ours.bounds(alone[0.3]),
                    "silence_600_ms": ours.bounds(alone[0.6]),
                    "silence_alone_at_same_dead_air": ours.bounds(same),
                },
                "silence_alone_at_same_dead_air": {"silence_s": round(dead_air_s - overhead_s, 3), **same.told()},
                "ours_by_participant": each,
                "word_error_percent": round(100 * jiwer.wer(sentences, expected), 1),
                "committed_after_voice_p50_s": round(float(np.median(committed_s)), 3),
                "committed_after_voice_p95_s": round(float(np.quantile(committed_s, 0.95)), 3),
                "voice_end_off_p50_ms": round(1e3 * float(np.median(np.abs(ended_off_s)))),
                "voice_end_off_p95_ms": round(1e3 * float(np.quantile(np.abs(ended_off_s), 0.95))),
            }
        )
    )


def _plain(text: str) -> str:
    return "".join(sign for sign in text.lower().replace("-", " ") if sign.isalnum() or sign == " ")


if __name__ == "__main__":
    main()
