"""Microphone and robot speech on one clock: a microphone at the loudspeaker."""

import contextlib
import multiprocessing
import subprocess
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.conversation.sound_devices import (
    CloseMicrophone,
    MicrophoneFailed,
    MicrophoneList,
    MicrophoneOpened,
    OpenMicrophone,
    run_microphone,
)
from caris_desktop.conversation.synthesis import run_synthesis
from caris_desktop.conversation.synthesis_messages import SynthesisReady, SynthesisSettings, UseVoice
from caris_desktop.domain import clock
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.link_commands import Say
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import ROBOT_VOICE
from tests.conversation.sound_server import SoundServer, require_pulseaudio

_CONTEXT = multiprocessing.get_context("spawn")


class Body:
    """A process entry point, and its messages."""

    def __init__(self, target: Any, *arguments: Any) -> None:
        self.connection, theirs = _CONTEXT.Pipe()
        self.process = _CONTEXT.Process(target=target, args=(theirs, *arguments), daemon=True)
        self.process.start()
        theirs.close()
        self.heard: list[Any] = []

    def wait_for(self, kind: type[Any], *, timeout_s: float = 20.0, **fields: Any) -> Any:
        until_s = time.monotonic() + timeout_s
        while self.connection.poll(max(0.0, until_s - time.monotonic())):
            self.heard.append(self.connection.recv())
            last = self.heard[-1]
            if isinstance(last, kind) and all(getattr(last, name) == value for name, value in fields.items()):
                return last
        raise AssertionError(f"no {kind.__name__} {fields} within {timeout_s:.0f} s")

    def listen_for(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        while self.connection.poll(max(0.0, until_s - time.monotonic())):
            self.heard.append(self.connection.recv())

    def chunks(self, source: str) -> list[AudioChunk]:
        return [message for message in self.heard if isinstance(message, AudioChunk) and message.source == source]

    def close(self) -> None:
        self.connection.close()
        self.process.join(10)
        assert self.process.exitcode is not None, "it outlived its console"


@pytest.fixture
def sound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SoundServer]:
    require_pulseaudio()
    server = SoundServer(tmp_path / "server")
    monkeypatch.setenv("PULSE_SERVER", server.address)
    yield server
    server.kill()


def _loudness(chunks: list[AudioChunk], *, window_ns: int = 10_000_000) -> tuple[int, NDArray[np.float64]]:
    """Stamp of the first window, and the loudness of each 10 ms, by the stamps of the chunks alone."""
    first_ns = chunks[0].stamp_ns
    last = chunks[-1]
    end_ns = last.stamp_ns + len(last.samples) * 1_000_000_000 // last.sample_rate_hz
    loud = np.zeros((end_ns - first_ns) // window_ns + 2)
    for chunk in chunks:
        at_ns = chunk.stamp_ns - first_ns + np.arange(len(chunk.samples)) * 1e9 / chunk.sample_rate_hz
        np.add.at(loud, (at_ns // window_ns).astype(int), np.abs(chunk.samples[:, 0].astype(float)))
    return first_ns, loud


@pytest.mark.long
def test_robot_speech_is_recorded_when_a_microphone_picks_it_up(sound: SoundServer) -> None:
    microphone, speech = Body(run_microphone), Body(run_synthesis)
    try:
        assert microphone.wait_for(MicrophoneList).names
        microphone.connection.send(OpenMicrophone(""))
        microphone.wait_for(MicrophoneOpened)
        speech.connection.send(UseVoice(SynthesisSettings(rate=1.8)))
        assert speech.wait_for(SynthesisReady).audible
        microphone.wait_for(AudioChunk)
        speech.connection.send(Say(clock.now_ns(), "u1", "Welcome to the robot laboratory. Please follow me."))
        start = speech.wait_for(UtteranceChanged, state="started")
        end = speech.wait_for(UtteranceChanged, state="finished")
        microphone.listen_for(1.0)
        microphone.connection.send(CloseMicrophone())
    finally:
        microphone.close()
        speech.close()
    robot_chunks = speech.chunks(ROBOT_VOICE)
    assert abs(robot_chunks[0].stamp_ns - start.stamp_ns) < 1_000_000, "the voice's sound begins with the utterance"
    robot_s = sum(len(chunk.samples) for chunk in robot_chunks) / robot_chunks[0].sample_rate_hz
    assert robot_s == pytest.approx((end.stamp_ns - start.stamp_ns) / 1e9, abs=0.02)
    robot_from_ns, robot_loudness = _loudness(robot_chunks)
    microphone_chunks = microphone.chunks("microphone")
    gaps_ms = np.diff([chunk.stamp_ns for chunk in microphone_chunks]) / 1e6
    assert np.percentile(np.abs(gaps_ms - 40.0), 80) < 20.0, "the microphone's stamps go on evenly"
    microphone_from_ns, microphone_loudness = _loudness(microphone_chunks)
    shift = int(np.argmax(np.correlate(microphone_loudness, robot_loudness, mode="full"))) - (len(robot_loudness) - 1)
    late_ms = (microphone_from_ns - robot_from_ns) / 1e6 + shift * 10.0
    # In steps of 10 ms.
    assert abs(late_ms) <= 30.0, f"heard {late_ms:.0f} ms after it was said"


def pactl(*words: str) -> str:
    return subprocess.run(["pactl", *words], capture_output=True, text=True, check=True, timeout=20).stdout.strip()


@pytest.mark.long
def test_another_default_input_is_followed_and_one_that_is_unplugged_replaced(sound: SoundServer) -> None:
    """The tone is only in the loudspeaker's monitor: recording it requires a switch from another input."""
    desk = pactl("load-module", "module-null-sink", "sink_name=desk")
    pactl("set-default-source", "desk.monitor")
    microphone = Body(run_microphone)
    tone = subprocess.Popen(
        ["pacat", "--device=speaker", "--format=s16le", "--rate=16000", "--channels=1"], stdin=subprocess.PIPE
    )
    try:
        microphone.connection.send(OpenMicrophone(""))
        microphone.wait_for(MicrophoneOpened)
        assert tone.stdin is not None
        samples = (np.sin(np.arange(16000 * 60) * 0.3) * 8000).astype("<i2")
        threading.Thread(target=_feed, args=(tone.stdin, samples.tobytes()), daemon=True).start()
        microphone.listen_for(0.5)
        assert max(_peak(chunk) for chunk in microphone.chunks("microphone")) < 100
        pactl("set-default-source", "speaker.monitor")
        pactl("unload-module", desk)
        _until_loud(microphone)
        told = [message for message in microphone.heard if isinstance(message, MicrophoneFailed)]
        assert len(told) <= 1, "once at most, whatever the sound server does with its stream"
    finally:
        tone.kill()
        tone.wait()
        microphone.close()


def _feed(stdin: IO[bytes], content: bytes) -> None:
    with contextlib.suppress(OSError):
        stdin.write(content)


def _peak(chunk: AudioChunk) -> int:
    return int(np.abs(chunk.samples.astype(np.int32)).max())


def _until_loud(microphone: Body) -> None:
    until_s = time.monotonic() + 30.0
    while time.monotonic() < until_s:
        if _peak(microphone.wait_for(AudioChunk)) > 3000:
            return
    raise AssertionError("the tone was not heard")


def test_without_a_microphone_the_session_continues_quietly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PULSE_SERVER", "unix:/nonexistent/no-sound-server")
    microphone = Body(run_microphone)
    try:
        assert microphone.wait_for(MicrophoneList).names == ()
        microphone.connection.send(OpenMicrophone(""))
        assert microphone.wait_for(MicrophoneFailed).problem is None, "none was asked for by name"
        microphone.connection.send(OpenMicrophone("Headset of the lab"))
        problem = microphone.wait_for(MicrophoneFailed).problem
        assert problem is not None and "is not working" in problem.what
    finally:
        microphone.close()
