import numpy as np
import pytest

from caris_desktop.conversation.resampling import Resampler, resampled


def _tone(rate_hz: int, frequency_hz: float, seconds: float = 0.5) -> np.ndarray:
    return np.sin(2 * np.pi * frequency_hz * np.arange(round(rate_hz * seconds)) / rate_hz).astype(np.float32)


@pytest.mark.parametrize("from_hz", [8_000, 11_025, 16_000, 22_050, 24_000, 32_000, 44_100, 48_000])
def test_a_tone_is_the_same_tone_at_the_same_moment(from_hz: int) -> None:
    out = resampled(_tone(from_hz, 1_000.0), from_hz, 16_000)
    wanted = _tone(16_000, 1_000.0)
    assert abs(len(out) - len(wanted)) <= 1
    middle = slice(800, 7_000)
    assert np.abs(out[middle] - wanted[middle]).max() < 1e-3


def test_frequencies_above_the_lower_rate_are_removed() -> None:
    out = resampled(_tone(48_000, 10_000.0), 48_000, 16_000)
    assert np.abs(out[800:7_000]).max() < 1e-3


def test_in_pieces_it_is_the_same_as_whole() -> None:
    sound = np.random.default_rng(1).standard_normal(9_000).astype(np.float32)
    resampler = Resampler(44_100, 16_000)
    pieces = [resampler.process(piece) for piece in np.split(sound, [1, 7, 441, 3_000, 3_001])]
    np.testing.assert_allclose(np.concatenate((*pieces, resampler.rest())), resampled(sound, 44_100, 16_000), atol=1e-6)
