"""Markers for other recorders: a real inlet on this computer receives them with the right times."""

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.domain import clock
from caris_desktop.domain.events import ChatMessage, Problem, StepEntered, UtteranceChanged
from caris_desktop.recording.recorder.recorder_messages import OfferMarkers, PauseRecording, RecorderReport
from caris_desktop.recording.recorder.recorder_process import STREAM_NAME
from caris_desktop.recording.session.session_reader import open_session
from tests.recording.driving import RecorderUnderTest, command, mark, pose, start
from tests.recording.told_session import exchange

_NO_NETWORK = "needs a network interface on which Lab Streaming Layer finds its own streams"


@pytest.fixture
def pylsl(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The library, limited to this computer and without log output."""
    configuration = tmp_path / "lsl.cfg"
    configuration.write_text("[multicast]\nResolveScope = machine\n[log]\nlevel = -2\n")
    monkeypatch.setenv("LSLAPICFG", str(configuration))
    try:
        import pylsl
    except (ImportError, RuntimeError, OSError) as error:
        pytest.skip(f"needs pylsl and its library ({error})")
    yield pylsl


@pytest.mark.parametrize("words", [False, True], ids=["marks only", "words too"])
def test_another_recorder_hears_markers_at_their_time(tmp_path: Path, pylsl: Any, words: bool) -> None:
    recorder = RecorderUnderTest()
    recorder.send(OfferMarkers(True, words=words))
    found = pylsl.resolve_byprop("name", STREAM_NAME, timeout=20.0)
    if not found:
        recorder.close()
        pytest.skip(_NO_NETWORK)
    inlet = pylsl.StreamInlet(found[0])
    inlet.open_stream(timeout=10.0)
    recorder.send(start(tmp_path / "s", lsl=True, lsl_words=words))
    recorder.wait_for(RecorderReport)
    utterance = UtteranceChanged(clock.now_ns(), "u1", "robot", "Grüß dich! " * 200, "phrase", "started")
    marked = replace(mark("here"), note="she looked away")
    session_s, lsl_s = clock.now_ns() / 1e9, pylsl.local_clock()
    step = StepEntered(clock.now_ns(), "arm", "Robot arm", 3, "branch", "greet", "Asks who that is")
    recorder.send(command(1), pose(1.0), marked, step, utterance, PauseRecording(True), PauseRecording(False))
    recorder.stop_session()
    samples = []
    while not samples or samples[-1][0]["event"] != "session_ended":
        sample, lsl_stamp_s = inlet.pull_sample(timeout=10.0)
        assert sample is not None, samples
        samples.append((json.loads(sample[0]), lsl_stamp_s))
    inlet.close_stream()
    recorder.close()
    assert [marker["event"] for marker, _ in samples] == [
        "session_started",
        "marked",
        "step_entered",
        *(["utterance_changed"] if words else []),
        "recording_paused",
        "recording_paused",
        "session_ended",
    ]
    assert samples[1][0]["label"] == "here"
    assert (samples[2][0]["title"], samples[2][0]["number"]) == ("Robot arm", 3)
    assert ("looked away" in str(samples)) == ("who that is" in str(samples)) == words
    if words:
        assert samples[3][0]["text"].startswith("Grüß dich!")
        assert len(samples[3][0]["text"]) < 1100
    for marker, lsl_stamp_s in samples:
        assert lsl_stamp_s - lsl_s == pytest.approx(marker["stamp_ns"] / 1e9 - session_s, abs=0.02)
    assert open_session(tmp_path / "s").closed_properly


@pytest.mark.logs(r"recorder\.recorder_process: ", r"recorder\.session_recorder: ")
def test_without_the_library_the_wizard_learns_how_to_get_it_and_the_recording_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pylsl", None)  # makes its import fail
    recorder = RecorderUnderTest(in_thread=True)
    recorder.send(start(tmp_path / "s", lsl=True), mark("kept"))
    problem = recorder.wait_for(Problem)
    assert "Lab Streaming Layer is not installed" in problem.what
    assert "pip install pylsl" in problem.advice
    recorder.stop_session()
    recorder.close()
    assert [value.label for _, value in open_session(tmp_path / "s").values("event/marked")] == ["kept"]


class FailingLibrary:
    """Double of the library whose network fails after the first sample."""

    IRREGULAR_RATE, cf_string = 0.0, 3

    def __init__(self) -> None:
        self.sent: list[str] = []

    def __getattr__(self, _name: str) -> Any:
        return lambda *_: self

    def local_clock(self) -> float:
        return 0.0

    def push_sample(self, sample: list[str], _at_s: float) -> None:
        self.sent += sample
        if len(self.sent) > 2:
            raise ValueError("the network is gone")


@pytest.mark.logs(r"recorder\.recorder_process: ", r"recorder\.session_recorder: ")
def test_an_outlet_that_fails_ends_itself_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    library = FailingLibrary()
    monkeypatch.setitem(sys.modules, "pylsl", library)
    recorder = RecorderUnderTest(in_thread=True)
    asked = exchange(1, 1.0, 2.0, "answer")
    long = replace(asked, messages=(ChatMessage("system", "long " * 1000),))
    recorder.send(start(tmp_path / "s", lsl=True, lsl_words=True), long, mark("a"), mark("b"))
    recorder.stop_session()
    recorder.close()
    problems = [problem for problem in recorder.heard if isinstance(problem, Problem)]
    assert len(library.sent) == 3
    sent = json.loads(library.sent[1])
    assert len(sent["messages"][0]["content"]) < 1100
    assert ["failed (the network is gone)" in problem.what for problem in problems] == [True]
    session = open_session(tmp_path / "s")
    assert [value.label for _, value in session.values("event/marked")] == ["a", "b"]
    assert [value.what for _, value in session.values("event/problem")] == [problems[0].what]
