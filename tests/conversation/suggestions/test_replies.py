"""Replies parsed from a streamed answer, limited to speakable text."""

import json
from itertools import pairwise
from random import Random

import pytest

from caris_desktop.conversation.suggestions.prompt import LONGEST_REPLY, fit_to_say, replies_in
from caris_desktop.conversation.suggestions.suggestion_cycle import characters_changed, intention_of, same_intention

WRITTEN = '{"answer": "It stops \\"at once\\".", "ask": "Shall we?",\n "more": "No: it is safe."}'
TEXTS = ('It stops "at once".', "Shall we?", "No: it is safe.")


def test_each_reply_is_final_as_soon_as_it_is_complete() -> None:
    seen = [replies_in(WRITTEN[:end]) for end in range(len(WRITTEN) + 1)]
    assert seen[-1] == TEXTS
    assert all(before == after[: len(before)] for before, after in pairwise(seen))
    first = next(end for end, replies in enumerate(seen) if replies)
    assert first == WRITTEN.index(', "ask"'), "the first is there before the others are begun"


@pytest.mark.parametrize(
    ("written", "texts"),
    [
        ('["One.", "Two."]', ("One.", "Two.")),
        ('Sure! ```json\n{"replies": ["One.", "Two."]}\n``` Anything else, "sir"?', ("One.", "Two.")),
        ('{"answer": "Caf\\u00e9."}', ("Café.",)),
        ('{"answer": "bad \\x escape"}', ("",)),
        (
            '{"reasoning": "They ask.", "answer": "One.", "analysis": {"steps": ["Secret."]}, "ask": "Two?"}',
            ("One.", "Two?"),
        ),
        ('[{"type": "answer", "text": "One."}, {"type": "ask", "text": "Two?"}]', ("One.", "Two?")),
        ('{"error": "model overloaded"}', ()),
        ("One.\nTwo.", ()),
        ('{"answer": "never ends', ()),
        ("]]]}}}", ()),
    ],
)
def test_other_forms_of_an_answer_are_read_as_far_as_they_go(written: str, texts: tuple[str, ...]) -> None:
    assert replies_in(written) == texts


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("  **It** stops\n at once. ", "It stops at once."),
        ('1. "It stops."', "It stops."),
        ("Robot: It stops.", "It stops."),
        ("It <b>stops</b>.", "It stops."),
        ("Ask at the [desk](https://lab.example).", "Ask at the desk."),
        ("It stops\u202e\x07.", "It stops."),
        ("See https://example.org/x now", "See now"),
        ("Hello {name}!", ""),
        ("As an AI I cannot.", ""),
        ("...", ""),
        ("It is safe, but you should always be .", ""),
        ("It can be a bit of a challenge, but it is very,v.", ""),
        (" ".join(f"It is {number}." for number in range(100, 160)), " ".join(f"It is {n}." for n in range(100, 111))),
        ("word " * 60, ""),
        ("\ud800Hello.", "Hello."),
        ("I'm sorry, I'm sorry, I'm sorry, I'm so.", ""),
        ("It is, it is, it is a robot.", ""),
        ("Yes yes yes yes.", ""),
        ("No, no, no, stay here!", "No, no, no, stay here!"),
        ("Very well, very well, let us go.", "Very well, very well, let us go."),
    ],
)
def test_only_plain_complete_sentences_can_be_spoken(text: str, said: str) -> None:
    assert fit_to_say(text) == said
    assert len(fit_to_say(text)) <= LONGEST_REPLY


@pytest.mark.parametrize(
    ("text", "intention"),
    [
        ("Would you like to see it?", "question"),
        ("No, and we can watch it from here if you like.", "no"),
        ("Yes.", "yes"),
        ("Thank you!", "thanks"),
        ("Good question!", "acknowledgement"),
        ("Good question! There is a safety zone around it.", "statement"),
        ("Hello, nice to meet you.", "greeting"),
        ("It stops as soon as it touches something.", "statement"),
    ],
)
def test_effects_of_a_reply(text: str, intention: str) -> None:
    assert intention_of(text) == intention


@pytest.mark.parametrize(
    ("text", "other", "same"),
    [
        ("It stops as soon as it touches something.", "It stops when it touches something.", True),
        ("I see.", "I understand.", True),
        ("Hello!", "Good morning!", True),
        ("Yes, it is safe.", "No, it is not safe.", False),
        ("It stops as soon as it touches something.", "Good question! There is a safety zone around it.", False),
        ("Do you want to see the kitchen?", "Shall we go to the kitchen?", False),
        ("Do you want to see the kitchen?", "Would you like to see the kitchen?", True),
        ("The kitchen is in the lab.", "Where is the kitchen?", False),
    ],
)
def test_two_that_do_the_same_are_distinguished_from_two_that_do_not(text: str, other: str, same: bool) -> None:
    assert same_intention(text, other) is same and same_intention(other, text) is same


def test_the_distance_of_an_edit_is_levenshteins() -> None:
    def slowly(before: str, after: str) -> int:
        row = list(range(len(after) + 1))
        for place, character in enumerate(before, 1):
            diagonal, row[0] = row[0], place
            for column, other in enumerate(after, 1):
                diagonal, row[column] = (
                    row[column],
                    min(row[column] + 1, row[column - 1] + 1, diagonal + (character != other)),
                )
        return row[-1]

    random = Random(4)  # noqa: S311
    for _ in range(200):
        before, after = ("".join(random.choices("abc ", k=random.randrange(12))) for _ in range(2))
        assert characters_changed(before, after) == slowly(before, after), (before, after)
    assert characters_changed("a" * 1000, "b" * 1000) == 1000


def test_any_text_is_read_without_an_error() -> None:
    random = Random(11)  # noqa: S311
    pieces = ['"', "\\", "{", "}", "[", "]", ":", ",", "\n", "a", "\\u12", "\x00", "é", json.dumps({"a": ["b"]})]
    for _ in range(300):
        written = "".join(random.choices(pieces, k=random.randrange(40)))
        for text in replies_in(written):
            reply = fit_to_say(text)
            assert not set(reply) & set("{}<>\n\x00") and len(reply) <= LONGEST_REPLY
