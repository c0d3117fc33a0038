"""Piper voices with streaming synthesis: playback begins after the first tenths of a second.

A Piper voice is one network (VITS). It quickly plans a whole clause; the two following steps, from plan to sound,
depend only on neighbouring frames. So the file is split into these three, and the last two run in pieces; the sound is
the same up to rounding.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.voices.installed_voices import PIPER, NoSuchVoiceError, PiperFiles
from caris_desktop.conversation.voices.utterance_sound import RenderingStoppedError, Samples, Stop
from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.domain.model_files import check_file, packaged_file, read_checked
from caris_desktop.domain.onnx_graph import part_of_graph, taken_by
from caris_desktop.domain.translation import QT_TR_NOOP, localized

_THREADS = 2
_FIRST_PIECE_FRAMES = 16
_LONGEST_PIECE_FRAMES = 64
# Receptive field in frames: with fewer, pieces would differ from the whole.
_AROUND_SHAPING_FRAMES = 24
_AROUND_SOUNDING_FRAMES = 12
# Tensor names from Piper's training code, common to its voices: first results of the two later steps.
_SHAPING_BEGINS = "/flow/flows.7/Slice_output_0"
_SHAPING_MASKED = "/flow/flows.6/Mul_output_0"
_SOUNDING_BEGINS = "/dec/conv_pre/Conv_output_0"
_CHANNELS = 192
# By phoneme type. For others, Piper loads and runs code from the working directory.
_NETWORKS_OF_PIPER = {
    "espeak": (),
    "text": (),
    "ar": ("piper/tashkeel/model.onnx",),
    "hebrew": ("piper/hebrew/nakdimon.onnx",),
}
# Length of a first clause: long enough for its melody, and worth it only with much text after it.
_FIRST_CLAUSE_AT_LEAST = 12
_ALONE_AT_MOST = 60
_LEAST_AUDIBLE = 80


class PiperVoice:
    """Loaded voice. ``rate`` 1 is normal; ``volume`` 0 to 1."""

    def __init__(self, files: PiperFiles, *, rate: float, volume: float) -> None:
        import onnxruntime
        from piper.config import PiperConfig
        from piper.voice import PiperVoice as Piper

        config = PiperConfig.from_dict(parse_json(read_checked(files.config)[0]))
        network = _NETWORKS_OF_PIPER.get("ar" if config.espeak_voice == "ar" else config.phoneme_type.value)
        if network is None:
            raise NoSuchVoiceError(
                localized(
                    QT_TR_NOOP("the voice {name} needs further files, which would be downloaded and run"),
                    name=files.name,
                )
            )
        for name in network:
            path = packaged_file(name)
            if path is not None:
                check_file(path)
        self._runtime = onnxruntime
        # Only used for phonemes, which need no network.
        self._piper: Any = Piper(session=None, config=config)
        self._config = config
        self._steps = self._sessions(read_checked(files.model)[0])
        self.name = PIPER + files.name
        self.rate_hz = int(config.sample_rate)
        self.tune(rate, volume)
        # Warm-up: the first run of a network is several times slower.
        for _ in self.parts("Yes.", Stop()):
            pass

    def tune(self, rate: float, volume: float) -> None:
        config = self._config
        self._scales = np.array([config.noise_scale, config.length_scale / rate, config.noise_w_scale], np.float32)
        self._volume = volume
        self.least_audible = max(1, round(_LEAST_AUDIBLE * volume))

    def parts(self, text: str, stop: Stop) -> Iterator[Samples]:
        # Text in [[ ]] would be parsed as phonemes.
        clauses = _clauses(self._piper.phonemize(text.replace("[[", "[ [")))
        if not clauses:
            raise ValueError("the text contains nothing to say")
        for clause in clauses:
            stop.check()
            try:
                yield from self._spoken(self._piper.phonemes_to_ids(clause), stop)
            except RenderingStoppedError:
                raise
            except Exception:
                # An interrupted run raises runtime-specific errors.
                stop.check()
                raise

    def _spoken(self, ids: list[int], stop: Stop) -> Iterator[Samples]:
        inputs: dict[str, Any] = {
            "input": np.array([ids], np.int64),
            "input_lengths": np.array([len(ids)], np.int64),
            "scales": self._scales,
        }
        if self._config.num_speakers > 1:
            inputs["sid"] = np.array([self._config.default_speaker_id], np.int64)
        planning, *later = self._steps
        planned = self._run(planning, inputs, stop)
        if not later:
            yield self._pcm(planned[0])
            return
        shaping, sounding = later
        names = [one.name for one in planning.get_outputs()]
        frames, first, length = planned[0].shape[-1], 0, _FIRST_PIECE_FRAMES
        while first < frames:
            end = min(frames, first + length)
            if frames - end < _FIRST_PIECE_FRAMES:
                end = frames
            outer = _around(first, end, _AROUND_SHAPING_FRAMES + _AROUND_SOUNDING_FRAMES, frames)
            inner = _around(first, end, _AROUND_SOUNDING_FRAMES, frames)
            plan = {name: value[:, :, outer] for name, value in zip(names, planned, strict=True)}
            shaped = self._run(shaping, inputs | plan, stop)[0]
            piece = shaped[:, :, inner.start - outer.start : inner.stop - outer.start]
            sound = self._run(sounding, {**inputs, shaping.get_outputs()[0].name: piece}, stop)[0]
            per_frame = sound.shape[-1] // (inner.stop - inner.start)
            yield self._pcm(sound[..., (first - inner.start) * per_frame : (end - inner.start) * per_frame])
            # The second piece is as short as the first, which is all that is audible until then.
            first, length = end, min(_LONGEST_PIECE_FRAMES, max(_FIRST_PIECE_FRAMES, end))

    def _run(self, session: Any, given: dict[str, Any], stop: Stop) -> list[NDArray[np.float32]]:
        stop.check()
        options = self._runtime.RunOptions()
        stop.at_once(lambda: setattr(options, "terminate", True))
        taken = {one.name for one in session.get_inputs()}
        results: list[NDArray[np.float32]] = session.run(
            None, {name: value for name, value in given.items() if name in taken}, options
        )
        return results

    def _pcm(self, sound: NDArray[np.float32]) -> Samples:
        pcm: Samples = (np.clip(sound.reshape(-1) * self._volume, -1.0, 1.0) * 32767.0).astype(np.int16)
        return pcm

    def _sessions(self, content: bytes) -> list[Any]:
        """Sessions for planning, shaping and sound; a single one for voices of another structure, synthesised clause by
        clause.
        """
        frames = ("batch", _CHANNELS, "frames")
        try:
            plan, mask = taken_by(content, _SHAPING_BEGINS)[0], taken_by(content, _SHAPING_MASKED)[1]
            shaped = taken_by(content, _SOUNDING_BEGINS)[0]
            parts = [
                part_of_graph(content, given={}, outputs=(plan, mask)),
                part_of_graph(content, given={plan: frames, mask: ("batch", 1, "frames")}, outputs=(shaped,)),
                part_of_graph(content, given={shaped: frames}),
            ]
        except (ValueError, IndexError):
            parts = [content]
        return [self._session(part) for part in parts]

    def _session(self, content: bytes) -> Any:
        options = self._runtime.SessionOptions()
        options.intra_op_num_threads = _THREADS
        options.inter_op_num_threads = 1
        # Spinning threads would take processor time from the window.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        return self._runtime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


def _around(first: int, end: int, frames: int, at_most: int) -> slice:
    return slice(max(0, first - frames), min(at_most, end + frames))


def _clauses(sentences: list[list[str]]) -> list[list[str]]:
    """Split off the first clause of a long beginning, so that its sound is ready sooner."""
    spoken = [phonemes for phonemes in sentences if phonemes]
    if not spoken or len(spoken[0]) <= _ALONE_AT_MOST:
        return spoken
    first = spoken[0]
    ends = [at + 1 for at, phoneme in enumerate(first) if phoneme in (",", ";", ":")]
    end = next((at for at in ends if at >= _FIRST_CLAUSE_AT_LEAST and at < len(first) - _FIRST_CLAUSE_AT_LEAST), None)
    return spoken if end is None else [first[:end], first[end:], *spoken[1:]]
