"""Change of the pitch of voices in WAV files."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.recording.forgetting.media import UnreadableMediaError
from caris_desktop.recording.session.wav_files import WavLayout, wav_header, wav_layout

_BLOCK_SAMPLES = 1 << 16


def write_sound(source: Path, target: Path, pitch: float = 1.0) -> None:
    """Rewrite a WAV file as samples alone, with the pitch of all voices multiplied by ``pitch``.

    Length and times do not change. ffmpeg's ``asetrate`` and ``atempo`` do it, since PyAV comes without ``rubberband``.
    Raises OSError, UnreadableMediaError.
    """
    with source.open("rb") as old, target.open("wb") as new:
        try:
            wav = wav_layout(old)
        except ValueError as error:
            raise UnreadableMediaError(localized(QT_TR_NOOP("{file} contains no audio"), file=source.name)) from error
        samples = max(0, source.stat().st_size - wav.offset_bytes) // wav.frame_bytes
        if 0 < wav.data_bytes < samples * wav.frame_bytes:
            samples = wav.data_bytes // wav.frame_bytes
        new.write(wav_header(wav.channels, wav.sample_rate_hz, samples))
        left = samples
        blocks = _blocks(old, wav, samples)
        for block in blocks if pitch == 1.0 else _changed(blocks, wav, pitch):
            part = block[:left]
            new.write(part.tobytes())
            left -= len(part)
        new.write(bytes(left * wav.frame_bytes))


def _blocks(file: IO[bytes], wav: WavLayout, samples: int) -> Iterator[NDArray[np.int16]]:
    file.seek(wav.offset_bytes)
    while samples > 0:
        data = file.read(min(samples, _BLOCK_SAMPLES) * wav.frame_bytes)
        block = np.frombuffer(data[: len(data) // wav.frame_bytes * wav.frame_bytes], "<i2").reshape(-1, wav.channels)
        if not len(block):
            return
        samples -= len(block)
        yield block


def _changed(blocks: Iterator[NDArray[np.int16]], wav: WavLayout, pitch: float) -> Iterator[NDArray[np.int16]]:
    import av

    rate, layout = wav.sample_rate_hz, "mono" if wav.channels == 1 else "stereo" if wav.channels == 2 else ""
    if not layout:
        layout = f"{wav.channels}c"
    graph = av.filter.Graph()
    nodes = [
        graph.add_abuffer(format="s16", sample_rate=rate, layout=layout),
        graph.add("asetrate", str(round(rate * pitch))),
        graph.add("aresample", str(rate)),
        graph.add("atempo", f"{1 / pitch:.6f}"),
        graph.add("aformat", f"sample_fmts=s16:sample_rates={rate}"),
        graph.add("abuffersink"),
    ]
    for node, following in itertools.pairwise(nodes):
        node.link_to(following)
    graph.configure()
    at = 0
    for block in blocks:
        frame = av.AudioFrame.from_ndarray(block.reshape(1, -1), "s16", layout)
        frame.sample_rate, frame.pts = rate, at
        at += len(block)
        graph.push(frame)
        yield from _pulled(graph, wav.channels)
    graph.push(None)
    yield from _pulled(graph, wav.channels)


def _pulled(graph: Any, channels: int) -> Iterator[NDArray[np.int16]]:
    import av

    while True:
        try:
            frame = graph.pull()
        except (av.error.BlockingIOError, av.error.EOFError):
            return
        yield frame.to_ndarray().reshape(-1, channels)
