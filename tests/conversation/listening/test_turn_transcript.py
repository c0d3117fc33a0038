"""Prediction from the transcript, in addition to the sound, whether a turn continues."""

import pytest

from caris_desktop.conversation.listening.speech_segmenter import goes_on, with_words


@pytest.mark.parametrize("text", ["I came here with the", "I came here with the.", "We went there because", "And um"])
def test_an_ending_that_is_unusual_continues(text: str) -> None:
    assert with_words(0.95, text, "en") <= 0.1


@pytest.mark.parametrize(
    "text",
    [
        "My mother is", "Do I have to", "I would say.", "Well.", "Yesterday", "I liked it. Could you", "One of",
        "When I was a child", "If that is possible today.", "I do not think that it's", "Yes, maybe,", "And then...",
    ],
)  # fmt: skip
def test_a_word_that_rarely_ends_a_sentence_continues(text: str) -> None:
    assert goes_on(text, "en")


@pytest.mark.parametrize(
    "text",
    [
        "Yes, I do.", "No.", "I think it was.", "Thank you", "When does the museum close", "Where are you from?",
        "When I was a child, we came here every summer", "It was raining. We took a taxi", "What is it for?", "",
    ],
)  # fmt: skip
def test_a_complete_sentence_does_not_continue(text: str) -> None:
    assert not goes_on(text, "en")


@pytest.mark.parametrize("text", ["Where are you from?", "Yes, I do.", "That is kind of you."])
def test_a_short_last_word_may_be_the_end(text: str) -> None:
    assert with_words(0.9, text, "en") > with_words(0.9, "Somebody walked", "en") + 0.15


def test_a_sentence_that_is_written_as_ended_is_rather_over_and_one_with_a_comma_rather_not() -> None:
    comma, nothing, question, stop = (with_words(0.6, f"We liked the hall{mark}", "en") for mark in (",", "", "?", "."))
    assert comma < nothing < question < stop
    assert nothing < 0.3
    assert stop > 0.5


def test_the_intonation_counts_with_any_words() -> None:
    for text in ("We liked the hall.", "We liked the hall", "We liked the,"):
        assert with_words(0.05, text, "en") < with_words(0.5, text, "en") < with_words(0.99, text, "en")
    assert with_words(0.01, "We liked the hall.", "en") < 0.5 < with_words(0.9, "We liked the hall.", "en")


def test_of_a_language_without_a_list_the_marks_count_alone() -> None:
    assert with_words(0.8, "I came with", "pl") == with_words(0.8, "I came here", "pl")
    assert with_words(0.8, "I came with.", "pl") > with_words(0.8, "I came here", "pl")


@pytest.mark.parametrize("by_sound", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("text", ["", "Yes.", "Yes,", "so"])
def test_it_stays_a_likelihood(by_sound: float, text: str) -> None:
    assert 0.0 <= with_words(by_sound, text, "en") <= 1.0
