"""Playback reference: past and scheduled loudspeaker sound at 16 kHz in session time."""

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.sound.resampling import resampled
from caris_desktop.domain.sound_values import PlayedSound, PlayedSoundEnded
from caris_desktop.domain.value_class import dataclass

RATE_HZ = 16_000
_CONTINUES_WITHIN_NS = 30_000_000


def samples_in(duration_ns: int) -> int:
    return round(duration_ns * RATE_HZ / 1_000_000_000)


def ns_of(samples: int) -> int:
    return samples * 1_000_000_000 // RATE_HZ


@dataclass(slots=True, eq=False)
class _Piece:
    utterance_id: str
    start_ns: int
    samples: NDArray[np.float32]

    @property
    def end_ns(self) -> int:
        return self.start_ns + ns_of(len(self.samples))


class PlaybackReference:
    """Accumulates reported sounds; simultaneous ones are mixed."""

    def __init__(self) -> None:
        self._pieces: list[_Piece] = []

    def add(self, sound: PlayedSound) -> int:
        """Add a sound; return its start: chunks of one utterance are joined without gaps."""
        mono = sound.samples.mean(axis=1, dtype=np.float32) / np.float32(32768.0)
        start_ns = sound.stamp_ns
        for piece in self._pieces:
            if piece.utterance_id == sound.utterance_id and abs(start_ns - piece.end_ns) < _CONTINUES_WITHIN_NS:
                start_ns = piece.end_ns
        self._pieces.append(_Piece(sound.utterance_id, start_ns, resampled(mono, sound.sample_rate_hz, RATE_HZ)))
        return start_ns

    def end(self, ended: PlayedSoundEnded) -> None:
        """Truncate an utterance."""
        for piece in self._pieces:
            if piece.utterance_id == ended.utterance_id:
                piece.samples = piece.samples[: max(0, samples_in(ended.stamp_ns - piece.start_ns))]

    def sound(self, start_ns: int, count: int) -> NDArray[np.float32]:
        """Sound from that time on, shape (count,); zeros where nothing was played."""
        sound = np.zeros(count, np.float32)
        for piece in self._pieces:
            first = samples_in(start_ns - piece.start_ns)
            start, end = max(0, first), min(len(piece.samples), first + count)
            if start < end:
                sound[start - first : end - first] += piece.samples[start:end]
        return sound

    def anything(self, start_ns: int, end_ns: int) -> bool:
        """True if any sound was played in that interval."""
        return any(piece.start_ns < end_ns and piece.end_ns > start_ns for piece in self._pieces)

    def began_ns(self, moment_ns: int) -> int | None:
        """Start of the utterance played at that time, or last before it; None if there was none."""
        before = [piece for piece in self._pieces if piece.start_ns <= moment_ns]
        if not before:
            return None
        last = max(before, key=lambda piece: piece.start_ns)
        if not last.utterance_id:
            return last.start_ns
        return min(piece.start_ns for piece in before if piece.utterance_id == last.utterance_id)

    def forget_before(self, moment_ns: int) -> None:
        self._pieces = [piece for piece in self._pieces if piece.end_ns >= moment_ns]
