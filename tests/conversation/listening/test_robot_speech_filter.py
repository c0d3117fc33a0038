import pytest

from caris_desktop.conversation.listening import robot_speech_filter
from caris_desktop.conversation.listening.robot_speech_filter import RobotSpeechFilter
from caris_desktop.domain.events import UtteranceChanged, UtteranceState
from tests.benchmarks.echo import _PARTICIPANTS_SAY, _ROBOT_SAYS

_SAYS = "Would you like to see the kitchen or the lab first?"
_STARTS_S, _ENDS_S = 10.0, 13.0


def _ns(seconds: float) -> int:
    return round(seconds * 1e9)


def _told(
    state: UtteranceState, at_s: float, text: str = _SAYS, *, estimated: bool = False, utterance_id: str = "u-1"
) -> UtteranceChanged:
    return UtteranceChanged(_ns(at_s), utterance_id, "robot", text, "typed", state, estimated=estimated)


def _robot(
    text: str = _SAYS, *, ended: bool = True, estimated: bool = False, ends_s: float = _ENDS_S
) -> RobotSpeechFilter:
    words = RobotSpeechFilter()
    words.robot_says(_told("requested", _STARTS_S - 0.3, text))
    words.robot_says(_told("started", _STARTS_S, text, estimated=estimated))
    if ended:
        words.robot_says(_told("finished", ends_s, text, estimated=estimated))
    return words


@pytest.mark.parametrize(
    ("heard", "from_s", "until_s"),
    [
        (_SAYS, 10.1, 13.1),
        ("would you like to see", 10.1, 11.5),
        ("Could you like to sea the kitchen, all the lab thirst.", 10.1, 13.1),
        ("kitchen or the lap first", 11.7, 13.1),
        ("Would you like to see the kit chin or the lab first", 10.1, 13.1),
        ("like to see like to see like to see", 10.6, 11.5),
    ],
)
@pytest.mark.parametrize("echo_share", [None, 0.8])
def test_robot_speech_is_recognised_also_in_part_or_misheard(
    heard: str, from_s: float, until_s: float, echo_share: float | None
) -> None:
    assert _robot().is_robots(heard, _ns(from_s), _ns(until_s), echo_share) > 0.6


@pytest.mark.parametrize("heard", [_SAYS, "would you like to see the kitchen"])
def test_current_robot_speech_is_recognised(heard: str) -> None:
    assert _robot(ended=False).is_robots(heard, _ns(10.1), _ns(12.5)) > 0.6


@pytest.mark.parametrize(
    ("heard", "from_s", "until_s"),
    [
        ("the kitchen", 13.6, 14.2),
        ("I would like to see the kitchen please", 13.5, 15.4),
        ("Do you have a question about the tour?", 11.0, 13.0),
        ("No, I have to go home now.", 10.5, 12.0),
        ("yes", 12.5, 13.0),
    ],
)
def test_an_answer_with_the_same_or_other_words_is_not_the_robot(heard: str, from_s: float, until_s: float) -> None:
    assert _robot().is_robots(heard, _ns(from_s), _ns(until_s)) < 0.5
    assert _robot().is_robots(heard, _ns(from_s), _ns(until_s), 0.55) < 0.5


def test_a_short_answer_over_the_robot_counts_where_the_robot_was_hardly_heard() -> None:
    assert _robot().is_robots("the kitchen", _ns(11.7), _ns(12.3), 0.2) == 0.0
    assert _robot().is_robots("the kitchen", _ns(11.7), _ns(12.3), 0.9) > 0.6


def test_robot_sound_alone_has_no_words_of_the_participant() -> None:
    assert _robot().is_robots("thanks for watching", _ns(10.1), _ns(13.1), 0.99) == 1.0


def test_a_word_or_two_next_to_the_robot_count_where_enough_of_another_person_was_heard() -> None:
    assert _robot().is_robots("What's right?", _ns(12.8), _ns(13.2), 0.86) == 1.0
    assert _robot().is_robots("Oh", _ns(10.1), _ns(10.3), 0.7) == 1.0
    assert _robot().is_robots("This is our", _ns(10.9), _ns(11.06), 0.45) == 1.0, "faster than anybody speaks"
    assert _robot().is_robots("Yes", _ns(11.1), _ns(11.6), 0.5) == 0.0
    assert _robot().is_robots("Yes", _ns(11.1), _ns(11.4), 0.0) == 1.0, "too short beside the robot"
    assert _robot().is_robots("Yes", _ns(13.2), _ns(13.5), 0.0) == 0.0, "after it"
    assert _robot().is_robots("No, I have to go home now.", _ns(10.5), _ns(12.0), 0.86) < 0.5


def test_words_that_the_recogniser_does_not_believe_itself_are_made_of_the_robot_that_is_left() -> None:
    text, at_ns = "I don't know if I don't", (_ns(11.2), _ns(12.9))
    assert _robot().is_robots(text, *at_ns, 0.62, confidence=0.41, late_s=0.0) == 1.0
    assert _robot().is_robots(text, *at_ns, 0.62, confidence=0.68, late_s=0.0) < 0.6, "somebody over the robot"
    assert _robot().is_robots(text, *at_ns, 0.62, confidence=0.41) < 0.6, "the robot is not heard in it"
    assert _robot().is_robots(text, _ns(11.2), _ns(14.0), 0.62, confidence=0.41, late_s=0.0) < 0.6, "long"
    long_ns = _ns(11.2), _ns(14.0)
    assert _robot().is_robots(text, *long_ns, 0.8, confidence=0.41, late_s=0.0) == 1.0, "long, and mostly the robot"


def test_robot_words_at_their_time_are_its_own_at_any_share() -> None:
    assert _robot().is_robots("the kitchen or", _ns(13.9), _ns(14.7), 0.0, late_s=2.1) > 0.6
    assert _robot().is_robots("the kitchen or", _ns(13.9), _ns(14.7), 0.0, late_s=0.3) < 0.6, "an answer"
    assert _robot().is_robots("the kitchen", _ns(13.9), _ns(14.5), 0.0) < 0.6


def test_a_syllable_while_the_robot_is_heard_late_is_its_own() -> None:
    assert _robot().is_robots("3, 2, 3, 2, 3,", _ns(14.5), _ns(14.7), 0.0, beside_robot=True) == 1.0
    assert _robot().is_robots("Yes", _ns(14.5), _ns(15.1), 0.0, beside_robot=True) == 0.0


def test_a_whole_sentence_of_the_robots_is_its_own_though_the_canceller_did_not_find_it() -> None:
    assert _robot().is_robots(_SAYS, _ns(10.2), _ns(13.2), 0.1) > 0.6


@pytest.mark.parametrize("late_s", [-1.2, 1.8, 3.0, 3.8])
@pytest.mark.parametrize("echo_share", [None, 0.0, 0.4])
def test_a_whole_sentence_is_the_robots_though_it_is_heard_seconds_from_when_it_was_reported(
    late_s: float, echo_share: float | None
) -> None:
    assert _robot().is_robots(_SAYS, _ns(10.1 + late_s), _ns(13.1 + late_s), echo_share) > 0.6


def test_a_short_sentence_is_the_robots_though_it_is_heard_late_and_an_answer_to_it_is_not() -> None:
    assert _robot("We have arrived.", ends_s=11.1).is_robots("We have arrived", _ns(12.2), _ns(13.3)) > 0.6
    assert _robot("Good morning!", ends_s=10.7).is_robots("Good morning", _ns(11.5), _ns(12.2)) == 0.0


def test_of_a_robot_that_is_heard_its_words_come_first_and_then_an_answer_with_the_same() -> None:
    words = _robot("Good morning!", ends_s=10.7)
    words.was_heard("Good morning", _ns(10.1), _ns(10.8))
    assert words.is_robots("Good morning", _ns(11.5), _ns(12.2)) == 0.0
    for state, at_s in (("started", 20.0), ("finished", 20.7)):
        words.robot_says(_told(state, at_s, "This way.", utterance_id="u-2"))
    assert words.is_robots("This way", _ns(21.3), _ns(22.0)) > 0.6


def test_the_first_words_are_the_robots_though_they_are_heard_late_as_long_as_it_speaks() -> None:
    words = _robot("Hello! Welcome to our lab.")
    assert words.is_robots("Hello", _ns(12.2), _ns(12.7)) > 0.6
    assert words.is_robots("Hello", _ns(13.6), _ns(14.1)) == 0.0, "an answer to it"


def test_a_person_who_repeats_the_robot_is_not_the_robot() -> None:
    words = _robot()
    words.was_heard(_SAYS, _ns(10.2), _ns(13.2))
    assert words.is_robots(_SAYS, _ns(13.5), _ns(16.5)) == 0.0
    taken_out = _robot()
    taken_out.was_heard_on_time(lambda _started_ns, _ended_ns: 0.95)
    assert taken_out.is_robots(_SAYS, _ns(13.5), _ns(16.5), 0.0) == 0.0


def test_the_delay_of_the_robot_is_learnt_from_whole_sentences() -> None:
    last_words, at = "or the lab first", (_ns(25.1), _ns(26.0))
    told = [_told(state, at_s, utterance_id="u-2") for state, at_s in (("started", 20.0), ("finished", 23.0))]
    known, unknown = _robot(), _robot()
    known.was_heard(_SAYS, _ns(13.1), _ns(16.1))
    for words in (known, unknown):
        for each in told:
            words.robot_says(each)
    assert known.is_robots(last_words, *at) > 0.6
    assert unknown.is_robots(last_words, *at) == 0.0
    assert known.may_be_heard(_ns(25.5), 0)
    assert not unknown.may_be_heard(_ns(25.5), 0)


def test_a_name_that_is_in_no_record_may_be_any_word() -> None:
    words = _robot("Nice to meet you, {p-7f}! How are you today?")
    assert words.is_robots("Nice to meet you Luis how are you today", _ns(10.1), _ns(13.0)) > 0.9


def test_two_sentences_may_be_one_turn() -> None:
    words = _robot()
    for state, at_s in (("started", 13.2), ("finished", 15.0)):
        words.robot_says(UtteranceChanged(_ns(at_s), "u-2", "robot", "The lab is closer from here.", "typed", state))
    transcribed = f"{_SAYS} The lab is closer from here"
    assert words.is_robots(transcribed, _ns(10.1), _ns(15.1)) > 0.9


def test_a_failed_utterance_is_not_attributed() -> None:
    words = _robot(ended=False)
    words.robot_says(_told("failed", 10.2))
    assert words.is_robots(_SAYS, _ns(10.1), _ns(13.1)) == 0.0


def test_without_a_word_nothing_is_decided() -> None:
    assert RobotSpeechFilter().is_robots("hello", _ns(1.0), _ns(2.0)) == 0.0
    assert _robot().is_robots("", _ns(10.1), _ns(13.0), 0.5) == 0.0


def _heard(text: str, from_s: float, until_s: float) -> list[tuple[str, int]]:
    """Consecutive words of equal duration."""
    words = text.split()
    each_s = (until_s - from_s) / len(words)
    return [(word, _ns(from_s + (number + 1) * each_s)) for number, word in enumerate(words)]


@pytest.mark.parametrize("robots", [_SAYS, "Could you like to sea the kitchen all the lab thirst."])
def test_a_person_who_repeats_the_robot_at_once_keeps_only_their_words(robots: str) -> None:
    theirs = "The kitchen, please, I am hungry."
    words = [*_heard(robots, 10.1, 13.1), *_heard(theirs, 13.2, 15.0)]
    first = _robot().robots_beginning(words, _ns(10.1))
    assert " ".join(word for word, _ in words[first:]) == theirs


def test_a_sentence_is_made_out_of_hardly_anything_but_the_robot() -> None:
    text = "This is how you must defend you."
    assert _robot().is_robots(text, _ns(10.5), _ns(11.7), 0.93) == 1.0
    assert _robot().is_robots(text, _ns(10.5), _ns(11.7), 0.8) < 0.6


@pytest.mark.parametrize("share", [0.45, 0.6, 0.79])
def test_short_words_next_to_a_loud_robot_are_not_its_beginning_where_a_person_continues(share: float) -> None:
    robot = _robot("The library opens at nine in the morning and closes at six.", ends_s=14.1)
    words = [*_heard("I said it's", 10.9, 11.8), *_heard("barely maybe a horror", 11.8, 13.2)]
    assert robot.robots_beginning(words, _ns(10.3), share) == 0


def test_a_word_whose_end_is_reported_seconds_too_late_is_still_the_robots() -> None:
    words = [("We", _ns(10.3)), ("have", _ns(10.5)), ("arrived.", _ns(13.0)), ("Thank", _ns(13.3)), ("you.", _ns(13.6))]
    assert _robot("We have arrived.", ends_s=11.1).robots_beginning(words, _ns(10.1)) == 3


@pytest.mark.parametrize(
    ("text", "from_s", "until_s"),
    [
        (_SAYS, 10.1, 13.1),  # no words follow it
        ("I would like to see the kitchen please", 13.5, 15.4),
        ("Do you have a question about the tour or the lab?", 11.0, 13.0),
    ],
)
def test_no_beginning_is_the_robots_where_it_is_all_its_own_or_none_of_it(
    text: str, from_s: float, until_s: float
) -> None:
    assert _robot().robots_beginning(_heard(text, from_s, until_s), _ns(from_s)) == 0
    assert RobotSpeechFilter().robots_beginning([], 0) == 0


@pytest.mark.parametrize(
    ("says", "lasts_s", "heard", "from_s", "until_s"),
    [
        # As recorded: the robot reported the start half a second late.
        ("That is a good question. Let us have a look.", 2.12, "That's him, I've got the quest.", 9.45, 10.38),
        (
            "The professor is in a meeting until three in the afternoon.",
            3.4,
            "the profess her is in a meet in",
            10.1,
            11.7,
        ),
        (
            "Careful, the floor is a little wet in front of the window.",
            3.3,
            "Care full flour his lid all wet",
            10.0,
            12.0,
        ),
    ],
)
def test_other_words_of_the_same_sounds_are_the_robots_while_it_says_them(
    says: str, lasts_s: float, heard: str, from_s: float, until_s: float
) -> None:
    words = _robot(says, ends_s=_STARTS_S + lasts_s)
    assert words.is_robots(heard, _ns(from_s), _ns(until_s)) >= 0.6
    assert words.is_robots(heard, _ns(from_s), _ns(until_s), 0.7) >= 0.6
    assert words.is_robots(heard, _ns(from_s + 5.0), _ns(until_s + 5.0)) < 0.6, "long after it"


@pytest.mark.long
def test_speech_over_the_robot_does_not_resemble_it(monkeypatch: pytest.MonkeyPatch) -> None:
    def dropped() -> list[tuple[str, str, float]]:
        return [
            (says, heard_text, begins_s)
            for says in _ROBOT_SAYS
            for words in [_robot(says, ends_s=_STARTS_S + 0.06 * len(says))]
            for heard_text in _PARTICIPANTS_SAY
            for begins_s in (0.3, 0.8, 1.3)
            if words.is_robots(heard_text, _ns(10 + begins_s), _ns(10 + begins_s + 0.065 * len(heard_text))) >= 0.6
        ]

    by_sound = dropped()
    monkeypatch.setattr(robot_speech_filter, "_sounds_like", lambda *_: 0.0)
    assert by_sound == dropped(), "those that say the robot's own words count as before"
