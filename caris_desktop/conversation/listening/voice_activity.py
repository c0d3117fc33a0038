"""Voice activity detection by the Silero network, window by window."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.model_files import packaged_file, read_checked

if TYPE_CHECKING:
    import onnxruntime


RATE_HZ = 16_000
WINDOW = 512
"""Samples of one window: 32 ms."""
_CONTEXT = 64
_STATE = 128
# Non-voice sound such as music or long silence degrades the network's state; resetting it in clear silence restores it.
_CLEAR_BELOW, _CLEAR_AFTER, _CLEAR_EVERY = 0.1, 5, 62


class NoVoiceActivity(Exception):  # noqa: N818 - says what is missing
    """The network for voice activity is not installed."""


class VoiceActivity:
    """Detector of one microphone, with state."""

    def __init__(self) -> None:
        """Raises NoVoiceActivity, and WrongChecksum."""
        path = packaged_file("faster_whisper/assets/silero_vad_v6.onnx")
        if path is None:
            raise NoVoiceActivity(
                "The Python package faster-whisper, which distinguishes speech from other sound, is not installed"
            )
        self._session = open_network(path)
        self._context = np.zeros(_CONTEXT, np.float32)
        self._clear()
        self._quiet = self._since_clear = 0

    def _clear(self) -> None:
        self._h = np.zeros((1, 1, _STATE), np.float32)
        self._c = np.zeros((1, 1, _STATE), np.float32)
        self._since_clear = 0

    def probability(self, window: NDArray[np.float32]) -> float:
        """Voice probability of the next ``WINDOW`` samples at 16 kHz."""
        sound = np.concatenate((self._context, window))[np.newaxis]
        output, self._h, self._c = self._session.run(None, {"input": sound, "h": self._h, "c": self._c})
        self._context = window[-_CONTEXT:]
        probability = float(np.asarray(output).reshape(-1)[0])
        self._since_clear += 1
        self._quiet = self._quiet + 1 if probability < _CLEAR_BELOW else 0
        if self._quiet >= _CLEAR_AFTER and self._since_clear >= _CLEAR_EVERY:
            self._clear()
        return probability


def open_network(path: Path) -> "onnxruntime.InferenceSession":
    """Session on one thread without spinning, which delays other processes on a busy computer by milliseconds.

    Raises WrongChecksum.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.enable_cpu_mem_arena = False
    options.log_severity_level = 3
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return onnxruntime.InferenceSession(read_checked(path)[0], sess_options=options, providers=["CPUExecutionProvider"])


# End-of-turn detection by sound: the SmartTurn network (Daily, BSD-2; version 3.2).
#
# It was trained on Whisper's log-mel spectrogram (Radford et al. 2022) over the last 8 s of a turn, zero-padded in
# front, and returns the probability that the turn is complete.

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
