import pytest

from caris_desktop.conversation.listening.agreement import HeardWord
from caris_desktop.conversation.listening.plausible import without_repetition

QUESTION = "Hello, can the robot arm hurt people when it moves?"


def _words(text: str, seconds: float) -> list[HeardWord]:
    spoken = text.split()
    each_s = seconds / len(spoken)
    return [HeardWord(word, number * each_s, (number + 1) * each_s) for number, word in enumerate(spoken)]


def _kept(text: str, seconds: float) -> str:
    return " ".join(word.text for word in without_repetition(_words(text, seconds)))


@pytest.mark.parametrize("again", [QUESTION, "Hello, can the robot arm hurt people when", "hello can the robot"])
def test_what_comes_twice_in_the_time_of_once_was_said_once_also_where_it_breaks_off(again: str) -> None:
    assert _kept(f"{QUESTION} {again}", 2.7) == QUESTION


def test_who_asks_twice_is_heard_twice() -> None:
    assert _kept(f"{QUESTION} {QUESTION}", 6.0) == f"{QUESTION} {QUESTION}"
    assert _kept("No no no, not that one", 1.5) == "No no no, not that one"
