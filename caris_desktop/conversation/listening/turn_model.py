"""End-of-turn detection by sound: the SmartTurn network (Daily, BSD-2; version 3.2).

It was trained on Whisper's log-mel spectrogram (Radford et al. 2022) over the last 8 s of a turn, zero-padded in front,
and returns the probability that the turn is complete.
"""

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.voice_activity import open_network
from caris_desktop.domain.model_files import packaged_file

RATE_HZ = 16_000
SECONDS = 8
_SAMPLES = RATE_HZ * SECONDS
_WINDOW, _HOP, _BANDS = 400, 160, 80
_VARIANCE_FLOOR, _POWER_FLOOR, _RANGE = 1e-7, 1e-10, 8.0


class TurnModel:
    """``TurnModel.find()`` returns None if the network is not installed, and raises WrongChecksum."""

    @classmethod
    def find(cls) -> "TurnModel | None":
        path = packaged_file("pipecat/audio/turn/smart_turn/data/smart-turn-v3.2-cpu.onnx")
        return None if path is None else cls(open_network(path))

    def __init__(self, session: object) -> None:
        self._session = session
        self._bands = _mel_filters()
        self._window = np.hanning(_WINDOW + 1)[:-1]

    def turn_over(self, turn: NDArray[np.float32]) -> float:
        """Probability that a turn is complete. ``turn`` is its sound at 16 kHz, including the following silence."""
        features = self.features(turn)[np.newaxis]
        (output,) = self._session.run(None, {"input_features": features})  # type: ignore[attr-defined]
        return float(np.asarray(output).reshape(-1)[0])

    def features(self, turn: NDArray[np.float32]) -> NDArray[np.float32]:
        """Log-mel spectrogram of the last 8 s, shape (80, 800)."""
        sound = np.zeros(_SAMPLES, np.float32)
        last = turn[-_SAMPLES:]
        sound[_SAMPLES - len(last) :] = last
        sound = (sound - sound.mean()) / np.sqrt(sound.var() + _VARIANCE_FLOOR)
        padded = np.pad(sound.astype(np.float64), _WINDOW // 2, mode="reflect")
        frames = np.lib.stride_tricks.sliding_window_view(padded, _WINDOW)[::_HOP][:-1]
        power = np.abs(np.fft.rfft(frames * self._window, axis=-1)) ** 2
        log = np.log10(np.maximum(_POWER_FLOOR, self._bands @ power.T))
        log = np.maximum(log, log.max() - _RANGE)
        return np.asarray((log + 4.0) / 4.0, np.float32)


def _mel_filters() -> NDArray[np.float64]:
    """Mel filter bank, Slaney's scale with equal areas; shape (bands, frequencies of the spectrum)."""
    edges = _hz(np.linspace(_mel(0.0), _mel(RATE_HZ / 2), _BANDS + 2))
    frequencies = np.linspace(0, RATE_HZ / 2, _WINDOW // 2 + 1)
    widths = np.diff(edges)
    slopes = edges[:, np.newaxis] - frequencies
    bands = np.maximum(0.0, np.minimum(-slopes[:-2] / widths[:-1, np.newaxis], slopes[2:] / widths[1:, np.newaxis]))
    return np.asarray(bands * (2.0 / (edges[2:] - edges[:-2]))[:, np.newaxis])


# Slaney's scale: linear up to 1 kHz, logarithmic above.
_LINEAR_HZ, _KNEE_MEL, _PER_MEL = 1000.0, 15.0, np.log(6.4) / 27.0


def _mel(hz: float) -> float:
    return hz * 3 / 200 if hz < _LINEAR_HZ else _KNEE_MEL + float(np.log(hz / _LINEAR_HZ)) / _PER_MEL


def _hz(mel: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(mel < _KNEE_MEL, mel * 200 / 3, _LINEAR_HZ * np.exp(_PER_MEL * (mel - _KNEE_MEL)))
