"""What was said says whether more is to come, beside how it sounds."""

import pytest

from caris_desktop.conversation.listening.turn_words import with_words


@pytest.mark.parametrize("text", ["I came here with the", "I came here with the.", "We went there because", "And um"])
def test_who_stops_where_nobody_ends_goes_on(text: str) -> None:
    assert with_words(0.95, text, "en") <= 0.1


@pytest.mark.parametrize("text", ["Where are you from?", "Yes, I do.", "That is kind of you."])
def test_who_ends_with_a_small_word_may_have_finished(text: str) -> None:
    assert with_words(0.9, text, "en") >= 0.9


def test_a_sentence_that_is_written_as_ended_is_rather_over_and_one_with_a_comma_rather_not() -> None:
    by_sound = 0.4
    assert with_words(by_sound, "We liked the hall,", "en") < by_sound
    assert with_words(by_sound, "We liked the hall", "en") == by_sound
    assert with_words(by_sound, "We liked the hall.", "en") > by_sound


def test_of_a_language_without_a_list_the_marks_count_alone() -> None:
    assert with_words(0.8, "I came with", "pl") == 0.8


@pytest.mark.parametrize("by_sound", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("text", ["", "Yes.", "Yes,", "so"])
def test_it_stays_a_likelihood(by_sound: float, text: str) -> None:
    assert 0.0 <= with_words(by_sound, text, "en") <= 1.0
