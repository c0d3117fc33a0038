"""Voice selection: the requested voice, or an available fallback with the reason."""

import importlib.util
import traceback
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from caris_desktop.conversation.speech_plugins import PLUGIN
from caris_desktop.conversation.voices.espeak import EspeakVoice, system_voices
from caris_desktop.conversation.voices.installed_voices import (
    ESPEAK,
    PIPER,
    NoSuchVoiceError,
    PiperFiles,
    base_language,
    best_for,
    find_piper_voice,
    piper_voices,
    voice_folders,
)
from caris_desktop.conversation.voices.piper import PiperVoice
from caris_desktop.conversation.voices.plugin_voice import PluginVoice
from caris_desktop.conversation.voices.utterance_sound import Voice, words_of
from caris_desktop.domain.model_files import WrongChecksum
from caris_desktop.domain.plugins import PluginError
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value


class VoiceChoice(Value):
    """Requested voice, as in the scenario file. ``at_hand``: it will be used."""

    voice: str
    language: str
    rate: float
    volume: float
    folder: str
    at_hand: bool


def open_voice(
    choice: VoiceChoice, files_folder: Path, on_plugin_failure: Callable[[PluginError], None]
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


def every_voice(choice: VoiceChoice, used: Voice) -> list[tuple[str, str]]:
    """All selectable voices with their languages; system voices only in the spoken language."""
    piper = {PIPER + files.name: files.language for files in piper_voices(voice_folders(choice.folder))}
    # pyttsx3 hangs in two threads: if its voice is in use, that has already read the list.
    others = used.others if isinstance(used, EspeakVoice) else system_voices()
    system = {ESPEAK + name: language for name, language in others.items()}
    spoken = base_language(choice.language or {**piper, **system}.get(used.name, ""))
    plugin = [(used.name, choice.language)] if isinstance(used, PluginVoice) else []
    return [*plugin, *piper.items(), *(each for each in system.items() if base_language(each[1]) == spoken)]


def _piper_files(choice: VoiceChoice) -> PiperFiles | None:
    if choice.voice.startswith(PIPER):
        return find_piper_voice(choice.voice.removeprefix(PIPER), voice_folders(choice.folder))
    if choice.voice or not choice.language or importlib.util.find_spec("piper") is None:
        return None
    return best_for(choice.language, piper_voices(voice_folders(choice.folder)))
