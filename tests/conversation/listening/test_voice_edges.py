"""Start and end of speech from the samples, within 50 ms of an energy detector's result."""

import io
import subprocess
import wave

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.conversation.listening.endpointing import SilenceOfPeople, TurnTaking, VoiceActivity
from caris_desktop.conversation.listening.engines import Recognised
from caris_desktop.conversation.listening.recognised_words import RecognisedWord
from caris_desktop.conversation.listening.recogniser_messages import UseSilence
from caris_desktop.conversation.listening.robot_speech_filter import RobotSpeechFilter
from caris_desktop.conversation.listening.speech_segmenter import SpeechSegmenter
from caris_desktop.domain.events import UtteranceChanged, UtteranceCorrected
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE
from tests.conversation.listening.speech import RATE_HZ, room
from tests.conversation.listening.test_speech_segmenter import Plain

_SAID = (
    "Can you tell me where the kitchen is?", "Thank you.", "How much does it cost?", "I have no idea, I am sorry.",
    "She sells sea shells.", "Who built this robot?", "Wait.", "My sister works in the office upstairs.",
)  # fmt: skip
_VOICES = ("en-gb", "en-us+f2", "en-us+m3", "en-us+f4")
_BEGAN_NS = 10**12


def _espeak(text: str, voice: str) -> NDArray[np.float64]:
    """With the silence that espeak-ng adds."""
    asked = ["espeak-ng", "-v", voice, "-s", "145", "--stdout", text]
    told = subprocess.run(asked, capture_output=True, check=True, timeout=30).stdout
    with wave.open(io.BytesIO(told)) as file:
        rate_hz = file.getframerate()
    sound = np.frombuffer(told[44:], "<i2").astype(np.float64)
    at = np.arange(round(len(sound) * RATE_HZ / rate_hz)) * rate_hz / RATE_HZ
    return np.interp(at, np.arange(len(sound)), sound)


def _by_energy(sound: NDArray[np.float64]) -> tuple[float, float]:
    """Start and end of the part of clean sound within 40 dB of its loudest 5 ms, in seconds."""
    frames = np.sqrt((sound[: len(sound) // 80 * 80].reshape(-1, 80) ** 2).mean(axis=1))
    loud = np.flatnonzero(frames > frames.max() * 0.01)
    return loud[0] * 80 / RATE_HZ, (loud[-1] + 1) * 80 / RATE_HZ


@pytest.fixture(scope="module")
def scene() -> tuple[NDArray[np.int16], list[tuple[float, float, str]]]:
    """Sentences separated by pauses in room noise, with their times."""
    random = np.random.default_rng(3)
    pieces, said, at_s = [np.zeros(RATE_HZ)], [], 1.0
    for voice in _VOICES:
        for text in _SAID:
            sound = _espeak(text, voice) * random.uniform(0.3, 1.0)
            first_s, end_s = _by_energy(sound)
            said.append((at_s + first_s, at_s + end_s, text))
            pause = np.zeros(round(random.uniform(1.5, 2.5) * RATE_HZ))
            pieces += [sound, pause]
            at_s += (len(sound) + len(pause)) / RATE_HZ
    sound = np.concatenate(pieces)
    return np.clip(sound + room(len(sound) / RATE_HZ)[: len(sound)], -32768, 32767).astype(np.int16), said


def _heard(
    samples: NDArray[np.int16], text_at: "list[tuple[float, float, str]]", own: RobotSpeechFilter
) -> list[object]:
    told: list[object] = []
    ear = SpeechSegmenter(
        ROBOT_MICROPHONE, TurnTaking(SilenceOfPeople(), UseSilence()), VoiceActivity(), canceller=Plain(),
        robot_speech=own, turn_over=lambda _sound: 1.0, report=told.append,
    )  # fmt: skip
    for at in range(0, len(samples), 1600):
        chunk = AudioChunk(_BEGAN_NS + at * 10**9 // RATE_HZ, ROBOT_MICROPHONE, RATE_HZ, samples[at : at + 1600, None])
        ear.process(chunk)
        ear.judge()
        while (stretch := ear.next_interval(0.5)) is not None:
            from_s = stretch.from_s
            turn = ear._turn if ear._turn is not None and ear._turn.turn_id == stretch.turn_id else ear._ending[0]
            began_s = (turn._sound_from_ns - _BEGAN_NS) / 1e9
            words = [
                RecognisedWord(word, from_s + 0.2 + n * 0.01, from_s + 0.2 + n * 0.01 + 0.01, 0.9)
                for first_s, end_s, text in text_at
                if first_s < began_s + from_s + len(stretch.sound) / RATE_HZ and end_s > began_s + from_s
                for n, word in enumerate(text.split())
            ]
            ear.add_result(stretch, Recognised(tuple(words), "en"))
    return told


def _p95_s(off_s: list[float]) -> float:
    return float(np.quantile(np.abs(off_s), 0.95))


@pytest.mark.long
def test_a_participants_voice_begins_and_ends_as_its_samples_do(
    scene: tuple[NDArray[np.int16], list[tuple[float, float, str]]],
) -> None:
    samples, said = scene
    turns: dict[str, list[float]] = {}
    for event in _heard(samples, said, RobotSpeechFilter()):
        at_s = (event.stamp_ns - _BEGAN_NS) / 1e9  # type: ignore[attr-defined] # each has one
        if isinstance(event, UtteranceChanged):
            turns.setdefault(event.utterance_id, []).append(at_s)
        elif isinstance(event, UtteranceCorrected) and event.start_ns is not None:
            turns[event.utterance_id][0] = (event.start_ns - _BEGAN_NS) / 1e9
    assert len(turns) == len(said)
    onsets, ends = zip(*turns.values(), strict=True)
    assert _p95_s([onset - first for onset, (first, _end, _text) in zip(onsets, said, strict=True)]) <= 0.05
    assert _p95_s([end - last for end, (_first, last, _text) in zip(ends, said, strict=True)]) <= 0.05


@pytest.mark.long
def test_a_robot_with_a_voice_of_its_own_is_timed_by_what_is_heard_of_it(
    scene: tuple[NDArray[np.int16], list[tuple[float, float, str]]],
) -> None:
    samples, said = scene
    own = RobotSpeechFilter()
    for number, (first_s, end_s, text) in enumerate(said):
        # Report of a robot that includes the silence of its voice: slightly early, and a third of a second late.
        for state, at_s in (("started", first_s - 0.1), ("finished", end_s + 0.35)):
            stamp_ns = _BEGAN_NS + round(at_s * 1e9)
            own.robot_says(UtteranceChanged(stamp_ns, f"u-{number}", "robot", text, "typed", state))  # type: ignore[arg-type]
    told = [event for event in _heard(samples, said, own) if isinstance(event, UtteranceCorrected)]
    starts = {event.utterance_id: event.start_ns for event in told if event.start_ns is not None}
    ends = {event.utterance_id: event.end_ns for event in told if event.end_ns is not None}
    assert len(starts) >= len(said) - 4 and len(ends) >= len(said) - 4
    of = {f"u-{number}": times for number, times in enumerate(said)}
    assert _p95_s([(at - _BEGAN_NS) / 1e9 - of[name][0] for name, at in starts.items()]) <= 0.05
    assert _p95_s([(at - _BEGAN_NS) / 1e9 - of[name][1] for name, at in ends.items()]) <= 0.05
