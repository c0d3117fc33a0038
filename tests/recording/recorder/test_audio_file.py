"""Sound files synchronised with the session: gaps, clock drift, stamp jitter and kills."""

import wave
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.recording.recorder.audio_file import AudioFile, AudioWriter
from caris_desktop.recording.session.media_files import audio_file_name

SECOND = 1_000_000_000
RATE_HZ = 16_000


def tone(count: int, first: int = 0, channels: int = 1) -> NDArray[np.int16]:
    """Sine tone of 200 Hz, int16, shape (samples, channels)."""
    samples = np.sin(np.arange(first, first + count) * 2 * np.pi * 200 / RATE_HZ) * 8000
    return np.repeat(samples.astype(np.int16)[:, None], channels, axis=1)


def chunk(session_s: float, samples: NDArray[np.int16], rate_hz: int = RATE_HZ) -> AudioChunk:
    return AudioChunk(SECOND + round(session_s * SECOND), "microphone", rate_hz, samples)


def samples_of(path: Path) -> NDArray[np.int16]:
    """Samples as read by Python's wave module."""
    with wave.open(str(path)) as file:
        assert file.getsampwidth() == 2
        data = file.readframes(file.getnframes())
        return np.frombuffer(data, dtype="<i2").reshape(-1, file.getnchannels())


def test_received_sound_is_in_the_file_with_the_position_of_its_blocks(tmp_path: Path) -> None:
    writer = AudioWriter(tmp_path, on_full=lambda: False)
    sound = tone(RATE_HZ, channels=2)
    blocks = []
    for first in range(0, RATE_HZ, 800):
        blocks += writer.write(chunk(first / RATE_HZ, sound[first : first + 800]))
    writer.update_headers()
    # Not closed, as after a kill.
    assert np.array_equal(samples_of(tmp_path / "audio-microphone.wav"), sound)
    blocks += writer.close()
    assert np.array_equal(samples_of(tmp_path / "audio-microphone.wav"), sound)
    assert [(block.first_sample, block.sample_count) for block in blocks] == [
        (at, 3200) for at in range(0, 16000, 3200)
    ]
    assert all(block.stamp_ns == SECOND + block.first_sample * SECOND // RATE_HZ for block in blocks)
    (info,) = writer.infos()
    assert (info.samples, info.channels, info.sample_rate_hz) == (RATE_HZ, 2, RATE_HZ)
    assert (info.first_stamp_ns, info.last_stamp_ns) == (SECOND, 2 * SECOND)


@pytest.mark.parametrize("gap_s", [0.1, 3600.0])
def test_missing_sound_is_silence_and_overlaps_are_cut(tmp_path: Path, gap_s: float) -> None:
    writer = AudioWriter(tmp_path, on_full=lambda: False)
    loud = np.full((1600, 1), 1000, np.int16)
    writer.write(chunk(0.0, loud))
    writer.write(chunk(0.1 + gap_s, loud))
    writer.write(chunk(0.1 + gap_s + 0.05, loud * 2))
    with pytest.raises(ValueError, match="already"):
        writer.write(chunk(0.1, loud))
    writer.close()
    found = samples_of(tmp_path / "audio-microphone.wav")[:, 0]
    begin = round((0.1 + gap_s) * RATE_HZ)
    assert len(found) == begin + 2400
    assert (found[:1600] == 1000).all()
    assert not found[1600:begin].any()
    assert (found[begin : begin + 1600] == 1000).all()
    assert (found[begin + 1600 :] == 2000).all()
    assert (tmp_path / "audio-microphone.wav").stat().st_blocks * 512 < 1_000_000


@pytest.mark.parametrize("drift", [-300e-6, 300e-6])
@pytest.mark.long("-0.0003")
def test_a_clock_that_drifts_is_followed_without_a_click(tmp_path: Path, drift: float) -> None:
    """Three minutes with 5 ms jitter, and a sound card that drifts by 18 ms per minute."""
    rng = np.random.default_rng(5)
    writer = AudioWriter(tmp_path, on_full=lambda: False)
    sound = tone(180 * RATE_HZ)
    true_rate_hz = RATE_HZ * (1 + drift)
    errors_s = []
    for first in range(0, len(sound), 1600):
        session_s = first / true_rate_hz
        jitter_s = rng.uniform(-0.005, 0.005) if first else 0.0
        writer.write(chunk(session_s + jitter_s, sound[first : first + 1600]))
        (info,) = writer.infos()
        errors_s.append((info.samples / RATE_HZ) - (first + 1600) / true_rate_hz)
    writer.close()
    assert max(np.abs(errors_s)) < 0.004
    found = samples_of(tmp_path / "audio-microphone.wav")[:, 0].astype(int)
    # No step is larger than those of the tone itself.
    assert np.abs(np.diff(found)).max() <= 1.02 * np.abs(np.diff(sound[:, 0].astype(int))).max()
    assert len(found) == pytest.approx(180 * RATE_HZ / (1 + drift), abs=0.004 * RATE_HZ)


def test_sound_of_another_form_begins_a_new_file(tmp_path: Path) -> None:
    writer = AudioWriter(tmp_path, on_full=lambda: False)
    writer.write(chunk(0.0, tone(800)))
    writer.write(chunk(0.05, tone(2400), 48_000))
    writer.write(AudioChunk(SECOND, "../robot voice", 22_050, tone(100)))
    writer.close()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "audio-microphone-2.wav",
        "audio-microphone.wav",
        "audio-robot-voice.wav",
    ]
    assert [info.sample_rate_hz for info in writer.infos()] == [16_000, 48_000, 22_050]
    with pytest.raises(ValueError, match="invalid audio"):
        writer.write(AudioChunk(SECOND, "x", RATE_HZ, np.zeros(5, np.int16)))


def test_a_wav_never_outgrows_what_its_header_can_say(tmp_path: Path) -> None:
    file = AudioFile(tmp_path / "a.wav", chunk(0.0, tone(100)), on_full=lambda: False)
    assert file.fits(chunk(36 * 3600.0, tone(100)))
    assert not file.fits(chunk(38 * 3600.0, tone(100)))
    file.close()


def test_file_names_stay_in_the_folder() -> None:
    assert audio_file_name("../../etc/x", set()) == "audio-etc-x.wav"
    assert audio_file_name("", set()) == "audio-sound.wav"
    assert audio_file_name("robot voice", {"audio-robot-voice.wav"}) == "audio-robot-voice-2.wav"
