"""Simulated microphone: mixing, speakers, and faults of a real one."""

import asyncio
import wave
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from caris_desktop.ros.message_conversion import decode_audio_data, samples_of
from caris_desktop.simulator import simulated_speech
from caris_desktop.simulator.faults import Faults
from caris_desktop.simulator.robot_models import AudioTopics
from caris_desktop.simulator.robot_topics import SoundOnRos
from caris_desktop.simulator.simulated_speech import (
    RATE_HZ,
    BadSentences,
    Microphone,
    Participant,
    at_rate,
    in_room,
    read_sentences,
)
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot

TONE = np.sin(np.arange(RATE_HZ) * 2 * np.pi * 440 / RATE_HZ).astype(np.float32) * 0.3


def loudness(samples: np.ndarray) -> float:
    return float(np.sqrt(np.mean((samples.astype(float) / 32768.0) ** 2)))


def test_the_room_is_audible_and_then_a_speaker_in_it() -> None:
    microphone, over = Microphone(), list[bool]()
    assert 0.0 < loudness(microphone.take(1600)) < 0.003
    microphone.speak(TONE, lambda: over.append(True))
    spoken = np.concatenate([microphone.take(640) for _ in range(25)])
    assert loudness(spoken) == pytest.approx(0.3 / np.sqrt(2), rel=0.3)
    assert over == [], "the walls still answer"
    for _ in range(RATE_HZ // 640):
        microphone.take(640)
    assert over == [True]


def test_the_robots_own_voice_comes_late_through_the_room_and_no_more_when_it_is_silenced() -> None:
    microphone = Microphone()
    microphone.noise, microphone.leak = 0.0, 0.5
    microphone.leak_voice(TONE)
    begun = microphone.take(RATE_HZ // 2)[:, 0]
    assert not begun[:400].any(), "sound takes its way"
    assert loudness(begun[1000:]) == pytest.approx(0.5 * 0.3 / np.sqrt(2), rel=0.35)
    microphone.leak_voice(TONE)
    microphone.silence_voice()
    assert not microphone.take(RATE_HZ).any()


class _Wire:
    """Records published messages, and offers nothing."""

    faults = Faults()

    def __init__(self) -> None:
        self.sound: list[np.ndarray] = []

    def publishes(self, topic: str, *_of: Any, **_how: Any) -> str:
        return topic

    def every(self, _steps: int, publish: Callable[[], None]) -> None:
        self.due = publish

    def obeys(self, *_of: Any) -> None: ...

    def serves(self, *_of: Any) -> None: ...

    def wanted(self, _topic: str) -> bool:
        return True

    def publish(self, topic: str, message: Any) -> None:
        if topic == "ear":
            self.sound.append(samples_of(decode_audio_data(message).content, 1)[:, 0])


def test_sound_keeps_its_time_where_the_robots_time_is_skipped() -> None:
    """Otherwise the robot would be heard seconds after it reports the end of its speech."""
    wire: Any = _Wire()
    sound = SoundOnRos(wire, AudioTopics("ear", "loudspeaker"))
    try:
        sound.microphone.leak_voice(TONE)
        for _ in range(5):
            wire.due()
        sound.skip_time(1.4)
        heard = np.concatenate(wire.sound)
        assert len(heard) == pytest.approx(1.6 * RATE_HZ, abs=640)
        assert loudness(heard[RATE_HZ // 2 : RATE_HZ]) > 0.05 > loudness(heard[-1600:])
    finally:
        sound.stop()


def test_pieces_of_a_live_voice_follow_one_another_without_a_gap() -> None:
    whole, pieces = Microphone(), Microphone()
    for microphone in (whole, pieces):
        microphone.noise = 0.0
    whole.leak_voice(TONE)
    for begin in range(0, len(TONE), 320):
        pieces.leak_voice(TONE[begin : begin + 320])
    heard = [np.abs(each.take(RATE_HZ)[2000:15000, 0].astype(int)).max() for each in (whole, pieces)]
    assert heard[1] == pytest.approx(heard[0], rel=0.2)


def test_a_room_keeps_the_direct_sound_first() -> None:
    click = np.zeros(1000, np.float32)
    click[100] = 1.0
    heard = in_room(click)
    assert np.argmax(np.abs(heard)) == 100
    assert np.abs(heard[200:]).max() > 0.001


def test_sound_of_another_rate_keeps_its_length_and_pitch() -> None:
    tone = (np.sin(np.arange(22050) * 2 * np.pi * 440 / 22050) * 8000).astype(np.int16)
    heard = at_rate(tone, 22050)
    assert len(heard) == pytest.approx(RATE_HZ, abs=40)
    assert np.argmax(np.abs(np.fft.rfft(heard[:RATE_HZ]))) == pytest.approx(440, abs=3)


def test_speech_of_a_participant_is_read_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "visitor.txt"
    path.write_text("# A visitor\nHello there.\n\n  Where is the kitchen?\n")
    assert read_sentences(path) == ["Hello there.", "Where is the kitchen?"]
    path.write_text("# nothing\n")
    with pytest.raises(BadSentences, match="1 to 100 lines"):
        read_sentences(path)
    with pytest.raises(BadSentences, match="cannot be read"):
        read_sentences(tmp_path / "missing.txt")


def keep(cache: Path, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put the sound into the cache."""
    monkeypatch.setattr(simulated_speech, "_voice", lambda: ["voice", "-f"])
    monkeypatch.setattr(simulated_speech, "_render", _beep)
    assert asyncio.run(simulated_speech.rendered(text, cache)) is not None


async def _beep(command: list[str], _text: str) -> bool:
    with wave.open(command[-1], "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(RATE_HZ)
        quiet = np.zeros(4000, np.int16)
        file.writeframes(np.concatenate([quiet, (TONE[:3200] * 20000).astype(np.int16), quiet]).tobytes())
    return True


def test_a_sentence_is_spoken_once_and_retained_without_the_silence_around_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keep(tmp_path, "Hello there.", monkeypatch)

    async def never(*_: object) -> bool:
        raise AssertionError("it is kept")

    monkeypatch.setattr(simulated_speech, "_render", never)
    sound = asyncio.run(simulated_speech.rendered("Hello there.", tmp_path))
    assert sound is not None and len(sound) == pytest.approx(3200, abs=50)
    assert [path.suffix for path in tmp_path.iterdir()] == [".wav"]


@pytest.mark.logs(r"simulator\.simulated_speech: ")
def test_it_is_the_participants_turn_when_the_robot_has_spoken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulated_speech, "_THINKS_S", 0.0)
    for text in ("One.", "Two.", "Asked for."):
        keep(tmp_path, text, monkeypatch)

    async def scenario() -> tuple[list[str], list[bool]]:
        states: list[bool] = []
        microphone = Microphone()
        speaker = Participant(microphone, ["One.", "Two."], on_speaking=states.append, cache=tmp_path)
        for expected in (1, 2):
            speaker.on_robot_finished()
            speaker.on_robot_finished()  # a second one during the answer changes nothing
            while len([said for said in speaker.utterances if said.ended_ns]) < expected:
                microphone.take(640)
                await asyncio.sleep(0)
        speaker.on_robot_finished()
        assert speaker.say("Asked for.") and not speaker.say("   ")
        while len([said for said in speaker.utterances if said.ended_ns]) < 3:
            microphone.take(640)
            await asyncio.sleep(0)
        speaker.stop()
        speaker.on_robot_finished()
        return [said.text for said in speaker.utterances], states

    said, states = asyncio.run(scenario())
    assert said == ["One.", "Two.", "Asked for."]
    assert states == [True, False] * 3


def test_the_simulated_robot_sends_its_sound_and_loses_some_on_request(
    robot: SimulatedRobot, client: RosbridgeClient
) -> None:
    client.subscribe("/odom", type="nav_msgs/Odometry")
    client.subscribe("/audio/audio", type="audio_common_msgs/AudioData")

    def pieces() -> list[np.ndarray]:
        return [samples_of(decode_audio_data(each).content, 1) for each in client.messages("/audio/audio")]

    wait_for(lambda: len(pieces()) > 3, "sound")
    assert {len(piece) for piece in pieces()} == {640}
    robot.fault("silent_microphone")
    assert robot.state()["sound"]["said"] == []
    before = len(pieces())
    for _ in range(3):
        client.wait_for_messages("/odom", len(client.messages("/odom")) + 3)
    assert len(pieces()) <= before + 1
    robot.fault("clear")
    wait_for(lambda: len(pieces()) > before + 3, "sound again")
