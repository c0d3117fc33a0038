"""Local agreement: words confirmed by two passes are final, others may change."""

import numpy as np

from caris_desktop.conversation.listening.recognised_words import (
    AgreedWords,
    RecognisedWord,
    is_nothing,
    within_voice,
    without_repetition,
)


def heard(text: str, from_s: float = 0.0) -> list[RecognisedWord]:
    """Two words a second."""
    return [RecognisedWord(word, from_s + at / 2, from_s + at / 2 + 0.4) for at, word in enumerate(text.split())]


def test_words_are_committed_once_two_passes_agree() -> None:
    words = AgreedWords()
    words.add(heard("I came hear"))
    assert (words.committed, words.tentative) == ("", "I came hear")
    words.add(heard("I came here with"))
    assert (words.committed, words.tentative) == ("I came", "here with")
    words.add(heard("I came here with my sister"))
    assert (words.committed, words.tentative) == ("I came here with", "my sister")


def test_committed_words_never_change() -> None:
    chance = np.random.default_rng(3)
    vocabulary = ["where", "is", "the", "old", "robot", "tram", "lab", "please", "thank", "you"]
    for _ in range(100):
        words, before = AgreedWords(), ""
        sentence = chance.choice(vocabulary, 16)
        for length in range(1, 17):
            words.add(heard(" ".join(np.where(chance.random(length) > 0.2, sentence[:length], "um"))))
            assert words.committed.startswith(before)
            before = words.committed


def test_a_pass_that_writes_the_committed_words_otherwise_does_not_bring_them_twice() -> None:
    words = AgreedWords()
    words.add(heard("Where is the robotics lab"))
    words.add(heard("Where is the robotics lab"))
    words.add(heard("Wears the robotics lab please?"))
    assert (words.committed, words.tentative) == ("Where is the robotics lab", "please?")


def test_a_pass_that_leaves_out_the_beginning_does_not_bring_the_rest_twice() -> None:
    words = AgreedWords()
    words.add(heard("Well I was thinking where is the robotics lab"))
    words.add(heard("Well I was thinking where is the robotics lab"))
    words.add(heard("where is the robotics lab please?"))
    assert (words.committed, words.tentative) == ("Well I was thinking where is the robotics lab", "please?")


def test_punctuation_and_case_do_not_keep_passes_from_agreeing() -> None:
    words = AgreedWords()
    words.add(heard("well, I was"))
    words.add(heard("Well I was thinking."))
    assert words.committed == "Well I was"


def test_sound_is_cut_behind_the_last_committed_sentence() -> None:
    words = AgreedWords()
    for _ in range(2):
        words.add(heard("Good afternoon. Could you"))
    assert words.cut_at_s() == heard("Good afternoon. Could you")[1].end_s
    words.add(heard("Could you tell me", from_s=1.0))
    words.add(heard("Could you tell me", from_s=1.0))
    assert words.committed == "Good afternoon. Could you tell me"


def test_nothing_is_made_of_what_a_recogniser_writes_where_nobody_speaks() -> None:
    assert is_nothing("Thank you for watching!", no_speech=0.6, log_probability=-0.4)
    assert is_nothing(" [MUSIC] ", no_speech=0.0, log_probability=-0.1)
    assert is_nothing("and the", no_speech=0.7, log_probability=-1.2)
    assert not is_nothing("Thank you.", no_speech=0.05, log_probability=-0.3), "people say that, too"
    assert not is_nothing("Where is the lab?", no_speech=0.5, log_probability=-0.4)


def test_a_phrase_that_comes_over_and_over_is_retained_once() -> None:
    assert [word.text for word in without_repetition(heard("I see " + "the lab " * 6 + "there"))] == [
        "I", "see", "the", "lab", "there",
    ]  # fmt: skip
    assert len(without_repetition(heard("no no no I said"))) == 5, "people do say a word three times"


def test_a_phrase_that_comes_twice_in_the_time_that_it_takes_once_is_retained_once() -> None:
    asked = "where is the robotics lab"
    twice = heard(f"{asked} {asked} please")
    quick = [RecognisedWord(word.text, word.start_s / 3, word.end_s / 3) for word in twice]
    assert [word.text for word in without_repetition(quick)] == [*asked.split(), "please"]
    assert without_repetition(twice) == twice, "people do ask twice"


def test_subtitle_words_after_the_voice_are_dropped() -> None:
    assert [word.text for word in within_voice(heard("where is it thank you"), voice_ended_s=1.3)] == [
        "where", "is", "it",
    ]  # fmt: skip
