"""WAV files in session time: a position in seconds equals session time since the file's start.

A sound card's clock drifts from the session clock. Drift is corrected sample by sample at the flattest places; missing
audio becomes silence.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import AudioBlock, AudioChunk
from caris_desktop.domain.translation import localized
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.session import loss_messages
from caris_desktop.recording.session.media_files import HEADER_BYTES, audio_file_name, wav_header
from caris_desktop.recording.session.session_header import AudioInfo

_LARGEST_DATA_BYTES = 2**32 - 2**20
# Silence up to this is written; longer silence becomes a hole that uses no disk space.
_WRITTEN_SILENCE_S = 0.5
# A larger offset from the end of the audio means a gap or an overlap; smaller ones are jitter of the stamps.
_GAP_S = 0.03
# Time constant of the mean drift, and the drift that is tolerated.
_FOLLOW_S, _TOLERATED_S = 2.0, 0.0015
_LARGEST_CORRECTION = 0.004
_BLOCK_S = 0.2


class AudioFile:
    """Growing WAV file of 16-bit samples. Methods raise OSError."""

    def __init__(self, path: Path, first: AudioChunk, *, on_full: Callable[[], bool]) -> None:
        self.source = first.source
        self.rate_hz = first.sample_rate_hz
        self.channels: int = first.samples.shape[1]
        self.first_stamp_ns = first.stamp_ns
        self.samples = 0
        self._deviation_s = 0.0
        self._reported_samples = 0
        self._block: AudioBlock | None = None
        self.file = DiskFile(path, on_full=on_full)
        self.file.write(self._header())

    def fits(self, chunk: AudioChunk) -> bool:
        """True if ``chunk`` can be appended to this file."""
        end_s = (chunk.stamp_ns - self.first_stamp_ns) / 1e9 + len(chunk.samples) / chunk.sample_rate_hz
        same_form = (chunk.sample_rate_hz, chunk.samples.shape[1]) == (self.rate_hz, self.channels)
        return same_form and end_s * self.rate_hz * self._frame_bytes < _LARGEST_DATA_BYTES

    def write(self, chunk: AudioChunk) -> list[AudioBlock]:
        """Append ``chunk`` at its time; return completed blocks.

        Raises ValueError if there is audio already at its time.
        """
        blocks = []
        samples = np.ascontiguousarray(chunk.samples, dtype="<i2")
        stamp_ns = chunk.stamp_ns
        late = round((chunk.stamp_ns - self.first_stamp_ns) * self.rate_hz / 1e9) - self.samples
        if late > _GAP_S * self.rate_hz:
            blocks += self.finish_block()
            self._write_silence(late)
            self._deviation_s = 0.0
        elif late < -_GAP_S * self.rate_hz:
            if -late >= len(samples):
                raise ValueError(loss_messages.WRITTEN_ALREADY)
            samples = samples[-late:]
            stamp_ns = self.first_stamp_ns + self.samples * 1_000_000_000 // self.rate_hz
            self._deviation_s = 0.0
        else:
            samples = self._follow(samples, late)
        block = self._block
        if block is None:
            name = self.file.path.name
            block = AudioBlock(stamp_ns, self.source, name, self.samples, 0, self.rate_hz)
        self.file.write(samples.tobytes())
        self.samples += len(samples)
        self._block = replace(block, sample_count=self.samples - block.first_sample)
        if self._block.sample_count >= _BLOCK_S * self.rate_hz:
            blocks += self.finish_block()
        return blocks

    def finish_block(self) -> list[AudioBlock]:
        """The unreported block, if any."""
        block, self._block = self._block, None
        return [] if block is None else [block]

    def update_header(self) -> None:
        """Update the header, so that readers find all samples so far even after a kill."""
        if self.samples != self._reported_samples:
            self._reported_samples = self.samples
            self.file.patch(0, self._header())

    def close(self) -> None:
        try:
            self.update_header()
            self.file.sync()
        finally:
            self.file.close()

    def info(self) -> AudioInfo:
        return AudioInfo(
            file_name=self.file.path.name,
            source=self.source,
            sample_rate_hz=self.rate_hz,
            channels=self.channels,
            samples=self.samples,
            first_stamp_ns=self.first_stamp_ns,
            last_stamp_ns=self.first_stamp_ns + self.samples * 1_000_000_000 // self.rate_hz,
        )

    @property
    def _frame_bytes(self) -> int:
        return 2 * self.channels

    def _follow(self, samples: NDArray[np.int16], late: int) -> NDArray[np.int16]:
        """Chunk with samples added or removed, if the file's time has drifted from the stamps."""
        chunk_s = len(samples) / self.rate_hz
        share = min(1.0, chunk_s / _FOLLOW_S)
        self._deviation_s += share * (late / self.rate_hz - self._deviation_s)
        if abs(self._deviation_s) < _TOLERATED_S:
            return samples
        most = max(1, round(len(samples) * _LARGEST_CORRECTION))
        correction = round(self._deviation_s * self.rate_hz)
        count = int(np.clip(correction, -most, most))
        samples = _with_more(samples, count) if count > 0 else _with_fewer(samples, -count)
        self._deviation_s -= count / self.rate_hz
        return samples

    def _write_silence(self, count: int) -> None:
        size_bytes = count * self._frame_bytes
        if count <= _WRITTEN_SILENCE_S * self.rate_hz:
            self.file.write(bytes(size_bytes))
        else:
            self.file.end_at(HEADER_BYTES + (self.samples + count) * self._frame_bytes)
        self.samples += count

    def _header(self) -> bytes:
        return wav_header(self.channels, self.rate_hz, self.samples)


def _flattest(samples: NDArray[np.int16], count: int) -> NDArray[np.intp]:
    """Least audible positions for a correction: one in each of ``count`` intervals, in order."""
    wide = samples.astype(np.int32)
    steps = np.abs(np.diff(wide, axis=0)).max(axis=1)
    # Of equally flat positions, the quietest.
    roughness = 64 * steps + np.abs(wide[1:]).max(axis=1)
    edges = np.linspace(0, len(roughness), count + 1).astype(int)
    return np.array(
        [low + int(np.argmin(roughness[low:high])) for low, high in pairwise(edges) if high > low], dtype=np.intp
    )


def _with_more(samples: NDArray[np.int16], count: int) -> NDArray[np.int16]:
    if len(samples) < 2:
        return samples
    at = _flattest(samples, count)
    between = (samples[at].astype(np.int32) + samples[at + 1]) // 2
    return np.insert(samples, at + 1, between.astype(samples.dtype), axis=0)


def _with_fewer(samples: NDArray[np.int16], count: int) -> NDArray[np.int16]:
    if len(samples) < 2:
        return samples
    return np.delete(samples, _flattest(samples, count), axis=0)


class AudioWriter:
    """Audio files of a session: one for each source, and a new one when its format changes."""

    def __init__(self, folder: Path, *, on_full: Callable[[], bool]) -> None:
        self._folder = folder
        self._on_full = on_full
        self._open: dict[str, AudioFile] = {}
        self._finished: list[AudioInfo] = []
        self._finished_bytes = 0
        self._names: set[str] = set()

    def write(self, chunk: AudioChunk) -> list[AudioBlock]:
        """Write a chunk; return completed blocks. Raises OSError, and ValueError for invalid audio."""
        if chunk.samples.ndim != 2 or not 1 <= chunk.samples.shape[1] <= 64 or chunk.sample_rate_hz <= 0:
            raise ValueError(localized(loss_messages.NO_SOUND, shape=chunk.samples.shape, rate=chunk.sample_rate_hz))
        blocks = []
        file = self._open.get(chunk.source)
        if file is not None and not file.fits(chunk):
            blocks += self._finish(chunk.source)
            file = None
        if file is None:
            name = audio_file_name(chunk.source, self._names)
            file = AudioFile(self._folder / name, chunk, on_full=self._on_full)
            self._names.add(name)
            self._open[chunk.source] = file
        return blocks + file.write(chunk)

    def update_headers(self) -> None:
        """Update all headers, a few times per second, against data loss by a kill. Raises OSError."""
        for file in self._open.values():
            file.update_header()

    def finish_blocks(self) -> list[AudioBlock]:
        """Unreported blocks of all files, before a pause in the audio."""
        return [block for file in self._open.values() for block in file.finish_block()]

    def close(self) -> list[AudioBlock]:
        """Close all files; return the last blocks. Closes what it can before raising OSError."""
        blocks, failure = [], None
        for source in tuple(self._open):
            try:
                blocks += self._finish(source)
            except OSError as error:
                failure = error
        if failure is not None:
            raise failure
        return blocks

    def infos(self) -> tuple[AudioInfo, ...]:
        return (*self._finished, *(file.info() for file in tuple(self._open.values())))

    def files(self) -> list[DiskFile]:
        """Files being written. Any thread."""
        return [file.file for file in tuple(self._open.values())]

    @property
    def written_bytes(self) -> int:
        return self._finished_bytes + sum(file.file.written_bytes for file in self._open.values())

    def _finish(self, source: str) -> list[AudioBlock]:
        file = self._open.pop(source)
        blocks = file.finish_block()
        try:
            file.close()
        finally:
            self._finished.append(file.info())
            self._finished_bytes += file.file.written_bytes
        return blocks
