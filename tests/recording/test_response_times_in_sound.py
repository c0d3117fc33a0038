"""Response times of a session compared with its sound files."""

import wave
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.conversation.conversation_transcript import ResponseTimes
from caris_desktop.domain.events import ResponseTimed, UtteranceChanged
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE
from caris_desktop.recording.session.session_data import read_data
from caris_desktop.recording.session.session_reader import open_session
from tests.conversation.listening.test_speech_segmenter import RATE_HZ, Bench
from tests.recording.told_session import at, tell

TURNS = 20
AGREES_WITHIN_S = 0.05


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A participant and a robot take turns with one microphone each, with some overlaps."""
    random = np.random.default_rng(11)
    lasts_s = TURNS * 7.0 + 3.0
    heard, spoken = (np.zeros(round(lasts_s * RATE_HZ), np.int16) for _ in range(2))
    replies: list[UtteranceChanged] = []
    for number in range(TURNS):
        begins_s = 1.0 + number * 7.0 + random.uniform(0.0, 0.3)
        ends_s = begins_s + random.uniform(0.9, 2.5)
        burst(heard, begins_s, ends_s, random)
        starts_s = ends_s + random.uniform(-0.4, 2.0)
        burst(spoken, starts_s, starts_s + 1.0, random)
        said = UtteranceChanged(at(starts_s), f"r{number}", "robot", "Yes.", "phrase", "started")
        replies += [replace(said, stamp_ns=at(starts_s - 0.2), state="requested"), said]
        replies.append(replace(said, stamp_ns=at(starts_s + 1.0), state="finished"))
    told = listened(heard)
    # The live service receives each event at its report, which for the end of a turn is later.
    times = ResponseTimes()
    happened = sorted([*told, *((event.stamp_ns, event) for event in replies)], key=lambda pair: pair[0])
    timed = [answer for at_ns, event in happened for answer in times.add(event, at_ns)]
    folder = tmp_path_factory.mktemp("sound") / "s"
    audio = [
        {"file_name": name, "source": source, "first_stamp_ns": at(0.0)}
        for name, source in (("audio-microphone.wav", ROBOT_MICROPHONE), ("audio-robot.wav", "robot voice"))
    ]
    tell(folder, [*(event for _, event in happened), *timed], lasts_s=lasts_s, audio=audio)
    for file, samples in zip(audio, (heard, spoken), strict=True):
        with wave.open(str(folder / str(file["file_name"])), "wb") as written:
            written.setnchannels(1)
            written.setsampwidth(2)
            written.setframerate(RATE_HZ)
            written.writeframes(samples.tobytes())
    return folder


def burst(samples: NDArray[np.int16], begins_s: float, ends_s: float, random: np.random.Generator) -> None:
    where = slice(round(begins_s * RATE_HZ), round(ends_s * RATE_HZ))
    samples[where] = random.integers(6000, 9000, len(samples[where])) * random.choice((-1, 1), len(samples[where]))


def listened(samples: NDArray[np.int16]) -> list[tuple[int, UtteranceChanged]]:
    """Events of the speech segmenter for this sound, with their times."""
    bench, told = Bench(), []
    chunk = RATE_HZ // 10
    for first in range(0, len(samples) - chunk, chunk):
        stamp_ns = at(first / RATE_HZ)
        bench.ear.process(AudioChunk(stamp_ns, ROBOT_MICROPHONE, RATE_HZ, samples[first : first + chunk, None]))
        stretch = bench.ear.next_interval(0.5)
        if stretch is not None:
            bench.ear.add_result(stretch, bench.answer(stretch))
        told += [(stamp_ns + 100_000_000, event) for event in bench.utterances[len(told) :]]
    return told


def voices(folder: Path, name: str) -> list[tuple[float, float]]:
    """Loud intervals of a file in seconds, separated by silences of half a second."""
    with wave.open(str(folder / name), "rb") as file:
        samples = np.frombuffer(file.readframes(file.getnframes()), np.int16)
    loud = np.flatnonzero(np.abs(samples) > 2000) / RATE_HZ
    parts = np.split(loud, np.flatnonzero(np.diff(loud) > 0.5) + 1)
    return [(float(part[0]), float(part[-1])) for part in parts]


def test_response_times_agree_with_the_sound_files(session: Path) -> None:
    participant, robot = voices(session, "audio-microphone.wav"), voices(session, "audio-robot.wav")
    in_sound = [starts_s - ends_s for (_, ends_s), (starts_s, _) in zip(participant, robot, strict=True)]
    found = read_data(open_session(session)).responses
    assert len(found) == len(in_sound) == TURNS
    off_s = [abs(one.gap_s - gap_s) for one, gap_s in zip(found, in_sound, strict=True)]
    assert max(off_s) < AGREES_WITHIN_S
    assert min(in_sound) < 0 < max(in_sound), "they speak over each other too"


def test_live_reports_equal_those_of_the_session(session: Path) -> None:
    opened = open_session(session)
    live = [value for _, value in opened.values("event/response_timed") if isinstance(value, ResponseTimed)]
    of_session = [
        (one.turn_id, one.reply_id, one.voice_ended_ns, one.first_sound_ns) for one in read_data(opened).responses
    ]
    assert sorted((one.turn_id, one.reply_id, one.voice_ended_ns, one.first_sound_ns) for one in live) == sorted(
        of_session
    )
    assert all(one.text_ns is not None and one.text_ns > one.voice_ended_ns for one in live)
