"""Completion of a partial sentence."""

import pytest

from caris_desktop.ui.speak.speak_field import completion
from tests.support.yardstick import in_yardsticks

KNOWN = (
    "Hello, {name}!",
    "Please follow me.",
    "It is safe to stand next to it.",
    "Please wait here.",
    "The arm lifts five kilos and stops by itself.",
)


@pytest.mark.parametrize(
    ("written", "rest"),
    [
        ("Hel", "lo, {name}!"),
        ("hello", ", {name}!"),
        ("Please ", "follow me."),
        ("Please w", "ait here."),
        ("It can lift five kilos and it is safe to st", "and next to it."),
        ("This one also lifts five k", "ilos and stops by itself."),
        ("It is safe to stand next to it.", ""),
        ("h", ""),
        ("", ""),
        ("  ", ""),
        ("You and", ""),
        ("Nothing like this was ever said", ""),
        ("Could it be safe (to st", ""),
    ],
)
def test_it_continues_as_an_earlier_text(written: str, rest: str) -> None:
    assert completion(written, KNOWN) == rest


def test_the_first_match_counts() -> None:
    assert completion("Go", ("Go left.", "Go right.")) == " left."
    assert completion("Go", ("Go", "Go right.")) == " right."


def test_no_key_waits_for_a_long_text_among_many_sentences() -> None:
    known = [" ".join(f"w{number * step % 211}" for step in range(1, 13)) for number in range(1, 501)]
    text = " ".join(f"w{number % 97}" for number in range(150))
    assert in_yardsticks(lambda: completion(text, known), tries=8) < 4.0
