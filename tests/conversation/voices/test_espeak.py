"""Tuning of the system voice, independent of espeak's state."""

from pathlib import Path

import pytest

from caris_desktop.conversation.voices.utterance_sound import Stop
from caris_desktop.conversation.voices.voice_selection import EspeakVoice

pytest.importorskip("pyttsx3.drivers._espeak", reason="only espeak drops what it was told", exc_type=ImportError)


def test_a_rate_holds_though_espeak_was_cancelled_before_it_heard_of_it(tmp_path: Path) -> None:
    from pyttsx3.drivers import _espeak

    voice = EspeakVoice("gmw/de", "de", rate=1.0, volume=1.0, folder=tmp_path)
    lengths: dict[float, list[int]] = {1.8: [], 0.9: []}
    for rate in 4 * list(lengths):
        voice.tune(rate, 1.0)
        # As pyttsx3 does if espeak still seems busy with the last sentence, which is frequent on a busy computer.
        _espeak.Cancel()
        lengths[rate].append(sum(len(part) for part in voice.parts("Ja, das ist gut.", Stop())))
    assert min(lengths[0.9]) > 1.8 * max(lengths[1.8]), lengths
