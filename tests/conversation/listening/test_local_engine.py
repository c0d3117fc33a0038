"""Filtering of faster-whisper's segments, window by window."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from caris_desktop.conversation.listening import engines
from caris_desktop.conversation.listening.recogniser_messages import RecogniserSettings


def segment(seek_s: float, text: str) -> SimpleNamespace:
    """Segment of the window from ``seek_s`` on, with one word every 0.2 s."""
    words = [
        SimpleNamespace(word=f" {word}", start=seek_s + 0.2 * at, end=seek_s + 0.2 * (at + 1), probability=0.9)
        for at, word in enumerate(text.split())
    ]
    return SimpleNamespace(seek=round(seek_s * 100), text=text, words=words, no_speech_prob=0.1, avg_logprob=-0.2)


class Model:
    """Model double that returns these windows."""

    model = SimpleNamespace(is_multilingual=False)
    see_s = 30

    def __init__(self, *segments: SimpleNamespace) -> None:
        self.segments = segments

    def transcribe(self, _sound: Any, **_given: Any) -> tuple[Any, SimpleNamespace]:
        return iter(self.segments), SimpleNamespace(language="en")


@pytest.mark.parametrize(
    ("voice_s", "heard"),
    [
        (3.7, "It is safe. Who built you?"),
        (2.2, "It is safe."),  # the voice ended with the first sentence: the second one is a hallucination
        (0.0, "It is safe."),  # unknown
    ],
)
def test_a_second_sentence_is_taken_where_a_person_still_spoke_and_silence_is_no_sentence(
    monkeypatch: pytest.MonkeyPatch, voice_s: float, heard: str
) -> None:
    monkeypatch.setattr(engines, "_open", lambda *_: Model(segment(0.0, "It is safe."), segment(2.0, "Who built you?")))
    engine = engines.LocalEngine(RecogniserSettings())
    text = engine.transcribe(np.zeros(64_000, np.float32), "", careful=True, voice_s=voice_s)
    assert " ".join(word.text for word in text.words) == heard
