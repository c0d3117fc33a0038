"""Priority of synthesis: requested utterances before those made in advance, without loss."""

import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from caris_desktop.conversation.voice_engine import Rendering
from caris_desktop.conversation.voices.utterance_sound import Samples, Stop, StreamingBuffer
from tests.support.polling import wait_for


class SlowVoice:
    """Each letter is a part of ten samples; waits before each ``_`` until it is released or interrupted."""

    name = "espeak:slow"
    rate_hz = 1000
    least_audible = 1

    def __init__(self) -> None:
        self.begun: list[str] = []
        self.go_on = threading.Event()

    def tune(self, rate: float, volume: float) -> None:
        self.begun.append(f"rate {rate}, volume {volume}")

    def parts(self, text: str, stop: Stop) -> Iterator[Samples]:
        self.begun.append(text)
        interrupted = threading.Event()
        stop.at_once(interrupted.set)
        for letter in text:
            if letter == "_":
                wait_for(lambda: self.go_on.is_set() or interrupted.is_set(), "it is let go on")
            if letter == "!":
                raise ValueError("cannot say this")
            stop.check()
            yield np.full(10, ord(letter), np.int16)


@pytest.fixture
def voice() -> SlowVoice:
    return SlowVoice()


@pytest.fixture
def rendering(voice: SlowVoice) -> Iterator[Rendering]:
    rendering = Rendering(voice, cache_bytes=200)
    thread = threading.Thread(target=rendering.run)
    thread.start()
    yield rendering
    rendering.end()
    thread.join(10.0)
    assert not thread.is_alive()


Say = Callable[[str], tuple[StreamingBuffer, list[int]]]


@pytest.fixture
def say(rendering: Rendering) -> Say:
    def ask(text: str) -> tuple[StreamingBuffer, list[int]]:
        sound, told = StreamingBuffer(1000, lambda: None), []
        rendering.say(text, sound, lambda at, part: told.append(len(part)))
        return sound, told

    return ask


def spoken(sound: StreamingBuffer) -> str:
    return "".join(chr(value) for value in sound.read(sound.end)[::10])


def test_a_requested_text_interrupts_drafts_which_are_made_later(
    rendering: Rendering, voice: SlowVoice, say: Say
) -> None:
    rendering.prepare(["ab_c", "de"])
    wait_for(lambda: voice.begun == ["ab_c"], "it is being made")
    sound, told = say("now")
    wait_for(lambda: sound.complete, "what is wanted is there")
    assert (spoken(sound), told, sound.trouble) == ("now", [10, 10, 10], "")
    voice.go_on.set()
    wait_for(lambda: voice.begun == ["ab_c", "now", "ab_c", "de"], "the others are made after it")


def test_a_draft_is_available_completely_and_at_once(rendering: Rendering, voice: SlowVoice, say: Say) -> None:
    rendering.prepare(["ab", "cd"])
    wait_for(lambda: voice.begun == ["ab", "cd"], "both are made")
    sound, told = say("ab")
    wait_for(lambda: sound.complete, "it is there")
    assert (spoken(sound), told) == ("ab", [20])
    assert voice.begun == ["ab", "cd"], "and was not made again"
    again, _ = say("ef")
    wait_for(lambda: again.complete, "it is there")
    say("ef")
    wait_for(lambda: voice.begun == ["ab", "cd", "ef"], "what was said is kept as well")


def test_nothing_more_is_made_of_what_nobody_wants(rendering: Rendering, voice: SlowVoice, say: Say) -> None:
    sound, told = say("a_b")
    wait_for(lambda: told == [10], "its beginning is there")
    rendering.stop()
    wait_for(lambda: sound.complete, "it is given up")
    assert sound.trouble
    again, _ = say("a_b")
    voice.go_on.set()
    wait_for(lambda: again.complete, "it can be said again")
    assert spoken(again) == "a_b"


def test_a_failed_text_is_reported_and_the_next_is_spoken(rendering: Rendering, voice: SlowVoice, say: Say) -> None:
    rendering.prepare(["!"])
    wait_for(lambda: voice.begun == ["!"], "it was tried")
    broken, _ = say("a!")
    wait_for(lambda: broken.complete, "it is given up")
    assert broken.trouble == "cannot say this"
    sound, _ = say("ok")
    wait_for(lambda: sound.complete, "the next is said")
    assert spoken(sound) == "ok"


def test_typed_text_is_synthesised_first_and_finished_when_it_is_spoken(
    rendering: Rendering, voice: SlowVoice, say: Say
) -> None:
    rendering.prepare(["ab_c"])
    wait_for(lambda: voice.begun == ["ab_c"], "it is being made")
    rendering.draft("x_y")
    wait_for(lambda: voice.begun == ["ab_c", "x_y"], "what is typed comes first")
    sound, told = say("x_y")
    wait_for(lambda: told == [10], "its beginning is heard while the rest is not there yet")
    voice.go_on.set()
    wait_for(lambda: sound.complete, "and then its end")
    assert (spoken(sound), sound.trouble) == ("x_y", "")
    wait_for(lambda: voice.begun == ["ab_c", "x_y", "ab_c"], "it was made once, and the other one after it")


def test_of_what_is_typed_only_the_last_is_made(rendering: Rendering, voice: SlowVoice, say: Say) -> None:
    rendering.draft("a_")
    wait_for(lambda: voice.begun == ["a_"], "it is being made")
    rendering.draft("a_b")
    wait_for(lambda: voice.begun == ["a_", "a_b"], "the longer one takes its place")
    sound, _ = say("no")
    wait_for(lambda: sound.complete, "something else was said")
    rendering.draft("")
    rendering.prepare(["c"])
    wait_for(lambda: voice.begun == ["a_", "a_b", "no", "c"], "and nobody asks for the draft again")


def test_the_end_of_an_utterance_does_not_stop_typed_text(rendering: Rendering, voice: SlowVoice, say: Say) -> None:
    first, _ = say("on")
    wait_for(lambda: first.complete, "it is there")
    rendering.draft("x_y")
    wait_for(lambda: voice.begun == ["on", "x_y"], "the next is typed")
    rendering.stop()
    sound, told = say("x_y")
    wait_for(lambda: told == [10], "it is still being made")
    rendering.stop()
    wait_for(lambda: sound.complete, "and can be silenced")
    assert sound.trouble and voice.begun == ["on", "x_y"]


def test_another_list_takes_the_place_of_the_first(rendering: Rendering, voice: SlowVoice) -> None:
    rendering.prepare(["a_", "b", "c"])
    wait_for(lambda: voice.begun == ["a_"], "the first is being made")
    rendering.prepare(["d"])
    voice.go_on.set()
    wait_for(lambda: voice.begun == ["a_", "d"], "the new one is made, and the old ones are not")


def test_with_another_rate_what_was_made_is_made_again(rendering: Rendering, voice: SlowVoice, say: Say) -> None:
    rendering.prepare(["ab"])
    wait_for(lambda: voice.begun == ["ab"], "it is made")
    rendering.tune(1.5, 0.5)
    wait_for(lambda: voice.begun == ["ab", "rate 1.5, volume 0.5", "ab"], "it is made again")
    say("cd")
    wait_for(lambda: voice.begun[-1] == "cd", "and the next is spoken")
