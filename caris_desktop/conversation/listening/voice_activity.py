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
