"""Robot speech: real audio, recorded at a sound server of the tests, and its length."""

import asyncio
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from caris_desktop.simulator import simulated_speech
from tests.conversation.sound_server import SoundServer, require_pulseaudio
from tests.support.polling import wait_for
from tests.support.simulated_robot import RosbridgeClient, SimulatedRobot

SENTENCE = "Welcome to the robot lab."
needs_espeak = pytest.mark.skipif(shutil.which("espeak-ng") is None, reason="espeak-ng is not installed")


@pytest.fixture
def sound(tmp_path: Path) -> Iterator[SoundServer]:
    require_pulseaudio()
    server = SoundServer(tmp_path / "server")
    yield server
    server.kill()


@needs_espeak
def test_speech_is_rendered_at_its_true_length() -> None:
    short, long = (asyncio.run(simulated_speech.render(text)) for text in (SENTENCE, SENTENCE * 4))
    assert short.duration_s == pytest.approx(len(short.samples) / short.rate_hz)
    assert 0.8 < short.duration_s < 4.0
    assert long.duration_s > 2.5 * short.duration_s
    assert np.abs(short.samples).max() > 3000


@needs_espeak
def test_text_is_never_taken_for_an_option() -> None:
    assert asyncio.run(simulated_speech.render("--version")).duration_s > 0.3


def test_without_espeak_the_length_is_estimated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    spoken = asyncio.run(simulated_speech.render(SENTENCE))
    assert len(spoken.samples) == 0
    assert 1.0 < spoken.duration_s < 4.0


@pytest.mark.logs(r"simulator\.simulated_speech: ")
def test_sentences_are_spoken_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulated_speech, "_CHARS_PER_S", 500.0)
    monkeypatch.setenv("PATH", "")

    async def scenario() -> list[bool]:
        states: list[bool] = []
        done = asyncio.Event()

        def on_speaking(speaking: bool) -> None:
            states.append(speaking)
            if states == [True, False] * 2:
                done.set()

        voice = simulated_speech.Voice(on_speaking, muted=True)
        assert voice.say("one")
        assert voice.say("two")
        assert not voice.say("   ")
        await asyncio.wait_for(done.wait(), 5)
        return states

    assert asyncio.run(scenario()) == [True, False, True, False]


@needs_espeak
@pytest.mark.long
def test_the_robot_is_heard_and_silenced(sound: SoundServer) -> None:
    with (
        SimulatedRobot(muted=False, environment={"PULSE_SERVER": sound.address}) as robot,
        RosbridgeClient(robot.address) as client,
    ):
        client.subscribe("/tts/speaking")
        listening = sound.listen()
        client.publish("/tts", {"data": SENTENCE})
        wait_for(lambda: listening.loud_total_s() > 0.5, "the sentence is heard")
        wait_for(lambda: [m["data"] for m in client.messages("/tts/speaking")] == [False, True, False], "it is spoken")
        one_s = listening.loud_total_s()
        client.publish("/tts", {"data": SENTENCE * 10})
        again = sound.listen()
        wait_for(lambda: again.loud_total_s() > 0.3, "the long one is heard")
        client.publish("/tts/stop", {})
        wait_for(lambda: not client.messages("/tts/speaking")[-1]["data"], "it is silent")
        after = sound.listen()
        wait_for(lambda: after.length_s > 2.0, "two seconds pass")
        # Sound in the server's buffers is still played: hardly one of ten sentences.
        assert again.loud_total_s() < 3.0 * one_s
        assert after.loud_total_s() < one_s
