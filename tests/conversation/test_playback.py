"""Streamed playback: continuous, without delay, with the time at which sound is heard."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from caris_desktop.conversation.sound_devices import (
    BeginPlaying,
    EndPlaying,
    JitterBuffer,
    PlaybackFailed,
    PlaybackStarted,
    PlayedOut,
    PlayThis,
    run_playback,
)
from caris_desktop.domain import clock
from tests.conversation.sound_server import SoundServer, require_pulseaudio
from tests.conversation.test_microphone_process import Body

RATE_HZ = 16_000


def pieces(count: int, length: int = 320) -> list[np.ndarray]:
    return [np.full(length, number + 1, np.int16) for number in range(count)]


def test_nothing_is_played_before_there_is_a_little_and_then_without_a_gap() -> None:
    buffer = JitterBuffer(RATE_HZ)
    for piece in pieces(3):
        buffer.push(piece)
        assert buffer.pull(0)[1] == 0
    assert buffer.pull(320)[1] == 0, "60 ms are too little to begin with"
    buffer.push(pieces(4)[3])
    pulled = np.concatenate([buffer.pull(160)[0] for _ in range(8)])
    assert pulled.tolist() == np.repeat([1, 2, 3, 4], 320).tolist()
    assert buffer.pull(160)[1] == 0


def test_a_burst_is_dropped_rather_than_played_late() -> None:
    buffer = JitterBuffer(RATE_HZ)
    for number in range(100):
        buffer.push(np.full(320, 1000 + 100 * number, np.int16))
    assert buffer.waiting <= 0.25 * RATE_HZ and buffer.dropped
    assert buffer.pull(320)[0][0] > 9500, "the newest is heard"


def test_a_backlog_is_made_up_for_in_the_next_pause_without_losing_a_word() -> None:
    buffer = JitterBuffer(RATE_HZ, most_s=2.0)
    loud, quiet = np.full(320, 5000, np.int16), np.full(320, 100, np.int16)
    for _ in range(25):  # half a second that arrives while the output opens
        buffer.push(loud)
    played = []
    for piece in [loud] * 10 + [quiet] * 40:
        buffer.push(piece)
        played.append(buffer.pull(320)[0])
    assert np.concatenate(played).tolist().count(5000) == 35 * 320, "every word is heard"
    assert buffer.waiting <= 0.2 * RATE_HZ


def test_the_end_of_it_is_played_however_little() -> None:
    buffer = JitterBuffer(RATE_HZ)
    buffer.push(pieces(1)[0])
    assert buffer.pull(320)[1] == 0
    buffer.finish()
    samples, sound = buffer.pull(400)
    assert sound == 320 and samples[:320].all() and not samples[320:].any()


@pytest.fixture
def sound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SoundServer]:
    require_pulseaudio()
    server = SoundServer(tmp_path / "server")
    monkeypatch.setenv("PULSE_SERVER", server.address)
    yield server
    server.kill()


@pytest.mark.long
def test_playback_starts_when_reported_and_is_reported_completely(sound: SoundServer) -> None:
    tone = (np.sin(np.arange(RATE_HZ // 2) * 0.3) * 12000).astype(np.int16)
    with sound.stamped() as recording:
        playback = Body(run_playback)
        try:
            playback.connection.send(BeginPlaying("s1", most_s=2.0))
            for begin in range(0, len(tone), 640):
                playback.connection.send(PlayThis(RATE_HZ, tone[begin : begin + 640, None]))
                playback.listen_for(0.04)
            playback.connection.send(EndPlaying())
            out = playback.wait_for(PlayedOut)
            playback.listen_for(0.3)
        finally:
            playback.close()
    told = [each for each in playback.heard if isinstance(each, PlaybackStarted)]
    assert {each.stream_id for each in told} == {"s1"} and out.stream_id == "s1"
    samples = np.concatenate([each.samples[:, 0] for each in told])
    assert np.array_equal(samples, tone), "what was heard is what was to be played"
    first_ns, last_ns = recording.loud_between(told[0].stamp_ns - 500_000_000, clock.now_ns(), least=3000)
    assert abs(first_ns - told[0].stamp_ns) < 60_000_000
    assert abs(last_ns - out.stamp_ns) < 150_000_000


def test_a_missing_output_is_reported_and_nothing_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PULSE_SERVER", "unix:/nonexistent/no-sound-server")
    playback = Body(run_playback)
    try:
        playback.connection.send(BeginPlaying("s1"))
        playback.connection.send(PlayThis(RATE_HZ, np.zeros((640, 1), np.int16)))
        assert playback.wait_for(PlaybackFailed).stream_id == "s1"
    finally:
        playback.close()
