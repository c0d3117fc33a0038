"""Voices and recognisers of others: installed as packages, used, and switched off when they fail."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from caris_desktop.app.plugin_contracts import check_speech
from caris_desktop.conversation import speech_plugins
from caris_desktop.conversation.listening import recogniser
from caris_desktop.conversation.listening.engines import PluginEngine
from caris_desktop.conversation.listening.recogniser import Recognition, WordsThread
from caris_desktop.conversation.listening.recogniser_messages import RecogniserReady, RecogniserSettings
from caris_desktop.conversation.listening.speech_segmenter import TurnInterval
from caris_desktop.conversation.voices.utterance_sound import Stop
from caris_desktop.conversation.voices.voice_selection import PluginVoice
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.plugins import PluginError
from caris_desktop.live.services.session_service import _with_plugins
from caris_desktop.recording.session.session_header import RecordedScenario, SessionHeader
from tests.support.plugins import install


def source(speak: str = "return sound", transcribe: str = "return [('hello', 0.0, 0.5)]", version: int = 1) -> str:
    return f"""
import os, time
import numpy as np

class Plugin:
    caris_interface = {version}
    rate_hz = 8000

    def __init__(self, *, language):
        pass

    def speak(self, text, *, rate, volume):
        sound = np.full(len(text) * 800, round(volume * 1000), np.int16)
        {speak}

    def transcribe(self, sound, *, before):
        if not sound.any():
            return []
        {transcribe}
"""


def voice(failures: list[PluginError]) -> PluginVoice:
    return PluginVoice("plugin:lab", "en", rate=1.0, volume=0.5, on_failure=failures.append)


def test_a_voice_speaks_and_a_recogniser_transcribes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "speech", "lab", source(), monkeypatch)
    failures: list[PluginError] = []
    made = voice(failures)
    assert (made.name, made.rate_hz) == ("plugin:lab", 8000)
    (sound,) = made.parts("Hello", Stop())
    assert (sound.dtype, sound.shape, sound[0]) == (np.int16, (4000,), 500)
    made.tune(1.0, 1.0)
    assert next(made.parts("Hello", Stop()))[0] == 1000
    engine = PluginEngine("plugin:lab", "en")
    found = engine.transcribe(np.ones(16_000, np.float32), "", careful=True)
    assert ([(word.text, word.end_s) for word in found.words], found.language) == ([("hello", 0.5)], "en")
    engine.close()
    made._process.close()
    assert not failures and "lab_lab" not in sys.modules, "this process does not run it"


@pytest.mark.logs("the plug-in lab of lab-lab failed")
@pytest.mark.parametrize(
    ("speak", "reason"),
    [
        ("raise ValueError('no idea')", "it raised ValueError: no idea"),
        ("print('hello'); return sound", "it printed “hello”"),
        ("os._exit(3)", "it ended its process"),
        ("time.sleep(3600)", "it did not return within 1 s"),
        ("return sound.astype(float)", "it did not return an array of int16 samples"),
        ("return sound[:0]", "it did not return an array of int16 samples"),
    ],
)
def test_a_voice_that_fails_is_switched_off(
    speak: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "speech", "lab", source(speak), monkeypatch)
    monkeypatch.setattr(speech_plugins, "SPEAK_WITHIN_S", 1.0)
    failures: list[PluginError] = []
    with pytest.raises(ValueError, match=reason):
        next(voice(failures).parts("Hello", Stop()))
    assert [(one.plugin.package, one.reason) for one in failures] == [("lab-lab 2.1", reason)]
    with pytest.raises(PluginError, match=reason):
        voice(failures)


@pytest.mark.logs("the plug-in lab of lab-lab failed")
def test_a_voice_whose_process_is_killed_between_two_utterances_is_switched_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "speech", "lab", source(), monkeypatch)
    failures: list[PluginError] = []
    made = voice(failures)
    made._process._process.kill()
    made._process._process.join()
    with pytest.raises(ValueError, match="it ended its process"):
        next(made.parts("Hello", Stop()))
    assert [one.reason for one in failures] == ["it ended its process"]


def test_one_of_another_version_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "speech", "lab", source(version=9), monkeypatch)
    with pytest.raises(PluginError, match="written for version 9 of the interface, and this program has version 1"):
        voice([])


@pytest.mark.logs("the plug-in lab of lab-lab failed")
@pytest.mark.parametrize(
    ("transcribe", "reason"),
    [
        ("raise ValueError('no idea')", "it raised ValueError: no idea"),
        ("time.sleep(3600)", "it did not return within 1 s"),
        ("return 'hello'", "it did not return words with start and end"),
        ("return [('hello', 7.0, 8.0)]", "it returned times that are not in order, or outside the sound"),
    ],
)
def test_the_usual_recogniser_replaces_one_that_fails(
    transcribe: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Usual:
        model, language, every_s = "usual", "en", 0.5

        def __init__(self, settings: RecogniserSettings) -> None:
            assert settings.model == ""

        def close(self) -> None: ...

    install(tmp_path, "speech", "lab", source(transcribe=transcribe), monkeypatch)
    monkeypatch.setattr(speech_plugins, "TRANSCRIBE_WITHIN_S", 1.0)
    monkeypatch.setattr(recogniser, "LocalEngine", Usual)
    words = WordsThread(RecogniserSettings(model="plugin:lab"))
    words.start()
    ready = words.news.get(timeout=60)
    assert isinstance(ready, RecogniserReady) and ready.model == "plugin:lab"
    words.ask(TurnInterval("t", np.ones(16_000, np.float32), 0.0, 1.0, "", False))
    lost, failure, usual = (words.news.get(timeout=60) for _ in range(3))
    assert isinstance(lost, Recognition) and lost.text is None
    assert isinstance(failure, PluginError) and failure.reason == reason
    assert isinstance(usual, RecogniserReady) and usual.model == "usual"
    words.end()


@pytest.mark.parametrize(
    ("speak", "transcribe", "message"),
    [
        ("return sound[:9]", "return []", "a longer sound"),
        ("return sound.astype(float)", "return []", "int16 samples"),
        ("print('hello'); return sound", "return []", "prints"),
        ("return sound", "return [('a', 1.0, 0.5)]", "not in order"),
        ("return sound", "return 3", "words with start and end"),
    ],
)
def test_the_contract_refuses(speak: str, transcribe: str, message: str) -> None:
    made: dict[str, Any] = {}
    exec(source(speak, transcribe), made)  # noqa: S102 - of this test
    with pytest.raises(AssertionError, match=message):
        check_speech(made["Plugin"])


def test_a_session_names_those_that_ran(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "speech", "lab", source(), monkeypatch)
    header = SessionHeader(clock=ClockAnchor.take(), program_version="0", scenario=RecordedScenario("Lab"))
    new_session: Any = lambda *_: (tmp_path, header)  # noqa: E731
    none: Any = None
    for speech, named in ((("plugin:lab", ""), {"plug-in speech lab": "lab-lab 2.1"}), (("espeak:en", "tiny"), {})):
        _, made = _with_plugins(new_session, none, none, none, plugins={}, named={"speech": speech})
        assert made.software == named
