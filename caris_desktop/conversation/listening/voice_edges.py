"""Onset and end of a voice by sample levels: voice activity networks are some tenths of a second early or late."""

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.voice_activity import RATE_HZ

_FRAME = RATE_HZ // 100
_ABOVE_NOISE, _BELOW_TOP = 3.0, 0.02
"""A voice is 10 dB above the noise around it, and not 34 dB below its loudest moment: that is the room's echo."""
_TOLD_APART = 2.0
"""If the loudest is hardly above that, voice and noise are indistinguishable."""
_CLOSED_FRAMES = 15
"""A plosive, or the breath between two words, ends no voice."""
_CLICK_FRAMES = 3


def voiced_spans(sound: NDArray[np.float32]) -> list[tuple[float, float]]:
    """Voice intervals in seconds, without clicks; empty if noise cannot be distinguished."""
    frames = sound[: len(sound) // _FRAME * _FRAME].reshape(-1, _FRAME)
    if not len(frames):
        return []
    levels = np.sqrt((frames.astype(np.float64) ** 2).mean(axis=1))
    top = float(np.quantile(levels, 0.95))
    least = max(_ABOVE_NOISE * float(np.quantile(levels, 0.1)), _BELOW_TOP * top)
    if top < _TOLD_APART * least or not top:
        return []
    edges = np.flatnonzero(np.diff(np.concatenate(([0], levels > least, [0])).astype(np.int8)))
    spans: list[tuple[int, int]] = []
    for first, end in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if spans and first - spans[-1][1] <= _CLOSED_FRAMES:
            spans[-1] = spans[-1][0], end
        else:
            spans.append((first, end))
    frame_s = _FRAME / RATE_HZ
    return [(first * frame_s, end * frame_s) for first, end in spans if end - first > _CLICK_FRAMES]


def onset_s(sound: NDArray[np.float32], about_s: float, *, nearest: bool = False) -> float:
    """Start of the voice that was detected at about that time, or of the ``nearest`` one; ``about_s`` if none is found.
    In seconds of ``sound``.
    """
    spans = voiced_spans(sound)
    if nearest:
        return min((first for first, _ in spans), key=lambda first: abs(first - about_s), default=about_s)
    return next((first for first, end in spans if end > about_s), about_s)


def end_s(sound: NDArray[np.float32], about_s: float) -> float:
    """End of the voice that was expected at about that time; ``about_s`` if none is found. In seconds of ``sound``."""
    return next((end for first, end in reversed(voiced_spans(sound)) if first < about_s), about_s)
