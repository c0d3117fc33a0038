"""Local speech recognition engine, by faster-whisper."""

import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.listening.engine import NoEngineError, Recognised
from caris_desktop.conversation.listening.hallucination_filter import is_nothing
from caris_desktop.conversation.listening.local_agreement import RecognisedWord
from caris_desktop.conversation.listening.recogniser_files import OFFLINE_PACKAGE, find_recogniser
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings
from caris_desktop.domain.model_files import GET_WEIGHTS_ANEW, WrongChecksum, check_file, expected_of
from caris_desktop.domain.translation import QT_TR_NOOP, localized

_RATE_HZ = 16_000
_NO_TEXT = QT_TR_NOOP("Speech is not transcribed; everything else works.")
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
        words = [
            RecognisedWord(word.word.strip(), float(word.start), float(word.end), float(word.probability))
            for segment in itertools.takewhile(lambda each: _is_of_voice(each, voice_s), segments)
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


def _is_of_voice(segment: Any, voice_s: float) -> bool:
    """False for text from silence: after ending at the first of two sentences, the model may decode the rest, and
    invents text for silence after the last word.
    """
    return bool(segment.seek == 0 or segment.seek / _FRAMES_PER_S <= voice_s - _SPEECH_GOES_ON_S)


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
