"""Suggestion cycle: one per pause, late answers are dropped, and each displayed reply has one outcome."""

from collections import Counter
from dataclasses import dataclass, field, replace
from itertools import count

import pytest

from caris_desktop.conversation.suggestions.suggestion_cycle import (
    EXPIRES_NS,
    PAUSE_NS,
    TO_READ_NS,
    Round,
    SuggestionCycle,
)
from caris_desktop.domain.actor import CONSOLE, MODEL, WIZARD
from caris_desktop.domain.events import SuggestionChanged, UtteranceChanged
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE, Hearing

S = 1_000_000_000
SILENT = Hearing(
    5 * S, ROBOT_MICROPHONE, False, "participant", "t-1", "can it hurt people", silent_since_ns=5 * S, revision=1
)
SPEAKING = replace(SILENT, stamp_ns=6 * S, speaking=True, silent_since_ns=None, revision=2)
FINISHED = UtteranceChanged(5 * S, "t-1", "participant", "Can it hurt people?", "heard", "finished", person_id="p-luis")
ROBOT = UtteranceChanged(7 * S, "u-1", "robot", "It stops.", "typed", "requested")


@dataclass
class Follower:
    """Records the reports of the cycle."""

    asked: list[Round] = field(default_factory=list)
    dropped: list[str] = field(default_factory=list)
    told: list[SuggestionChanged] = field(default_factory=list)

    @property
    def fates(self) -> list[tuple[int, str]]:
        return [(event.rank, event.state) for event in self.told if event.state != "displayed"]


@pytest.fixture
def heard() -> Follower:
    return Follower()


@pytest.fixture
def rounds(heard: Follower) -> SuggestionCycle:
    numbers = count(1)
    return SuggestionCycle(
        heard.told.append, lambda: f"s-{next(numbers)}", ask=heard.asked.append, drop=heard.dropped.append
    )


def begun(rounds: SuggestionCycle, heard: Follower, *texts: str) -> Round:
    """A cycle at the first pause, with these replies displayed at 5.5 s."""
    rounds.add(SILENT)
    rounds.pass_time(5 * S + PAUSE_NS)
    for text in texts:
        assert rounds.offer(heard.asked[-1], text, "small", 5 * S + S // 2)
    return heard.asked[-1]


def test_a_round_begins_200_ms_into_a_pause_and_not_before(rounds: SuggestionCycle, heard: Follower) -> None:
    rounds.add(SILENT)
    assert rounds.next_ns == 5 * S + PAUSE_NS
    rounds.pass_time(5 * S + PAUSE_NS - 1)
    assert heard.asked == []
    rounds.pass_time(5 * S + PAUSE_NS)
    assert heard.asked == [Round("t-1", 1, "can it hurt people", 5 * S)]


def test_half_a_turn_gets_no_reply(rounds: SuggestionCycle, heard: Follower) -> None:
    rounds.add(SILENT)
    rounds.add(SPEAKING)
    rounds.pass_time(9 * S)
    assert heard.asked == []


def test_a_reply_after_resumed_speech_is_discarded(rounds: SuggestionCycle, heard: Follower) -> None:
    first = begun(rounds, heard, "It stops at once.")
    rounds.add(SPEAKING)
    assert heard.dropped and rounds.cards == ()
    assert not rounds.offer(first, "There is a zone around it.", "small", 7 * S)
    rounds.add(
        replace(SILENT, stamp_ns=7 * S, silent_since_ns=7 * S, committed="can it hurt people when it moves", revision=3)
    )
    rounds.pass_time(8 * S)
    assert not rounds.offer(first, "There is a zone around it.", "small", 8 * S)
    assert rounds.offer(heard.asked[-1], "There is a zone around it.", "small", 8 * S)
    assert heard.fates == [(1, "superseded")] and heard.asked[-1].revision == 3


def test_a_pause_that_was_missed_is_reported_by_when_it_began(rounds: SuggestionCycle, heard: Follower) -> None:
    begun(rounds, heard, "It stops at once.")
    rounds.add(replace(SILENT, stamp_ns=8 * S, silent_since_ns=8 * S, revision=3))
    assert heard.fates == [(1, "superseded")]
    rounds.pass_time(9 * S)
    assert [(each.turn_id, each.revision) for each in heard.asked] == [("t-1", 1), ("t-1", 3)]


def test_place_and_key_stay_and_a_second_one_with_the_same_intention_gets_none(
    rounds: SuggestionCycle, heard: Follower
) -> None:
    first = begun(rounds, heard, "It stops as soon as it touches something.")
    assert not rounds.offer(first, "It stops once it touches something.", "small", 6 * S)
    assert rounds.offer(first, "Good question! There is a safety zone around it.", "small", 6 * S)
    assert rounds.offer(first, "Would you like to see it move?", "small", 6 * S)
    assert not rounds.offer(first, "Goodbye, and thank you for your visit.", "small", 6 * S), "three are enough"
    assert [(card.rank, card.suggestion_id) for card in rounds.cards] == [(1, "s-1"), (2, "s-2"), (3, "s-3")]
    assert heard.told[0].latency_ms == 500.0 and heard.told[0].actor == MODEL


def test_no_reply_is_a_valid_answer(rounds: SuggestionCycle, heard: Follower) -> None:
    begun(rounds, heard)
    rounds.on_robot(ROBOT, 7 * S)
    assert heard.told == [] and rounds.round is None


def test_the_spoken_reply_is_accepted_and_the_others_are_superseded(rounds: SuggestionCycle, heard: Follower) -> None:
    begun(rounds, heard, "It stops at once.", "Would you like to see it?")
    card = rounds.card("s-2", 6 * S)
    assert card is not None
    rounds.accept(card, card.text, "u-7", WIZARD, 6 * S)
    assert heard.fates == [(2, "taken"), (1, "superseded")]
    assert heard.told[2].utterance_id == "u-7" and heard.told[2].actor == WIZARD
    rounds.on_robot(replace(ROBOT, utterance_id="u-7"), 7 * S)
    assert rounds.card("s-2", 7 * S) is None, "it is not said twice"


def test_an_edited_one_says_how_much_was_changed(rounds: SuggestionCycle, heard: Follower) -> None:
    begun(rounds, heard, "It stops at once.")
    rounds.accept(rounds.cards[0], "It halts at once!", "u-7", WIZARD, 6 * S)
    assert [(event.state, event.edit_distance) for event in heard.told[1:]] == [("edited", 5)]


def test_a_turn_that_was_replied_to_needs_no_other_reply_when_its_final_words_come(
    rounds: SuggestionCycle, heard: Follower
) -> None:
    begun(rounds, heard, "It stops at once.")
    rounds.accept(rounds.cards[0], "It stops at once.", "u-7", WIZARD, 6 * S)
    rounds.on_participant(replace(FINISHED, text="Can it hurt the people?"), 7 * S)
    rounds.pass_time(9 * S)
    assert len(heard.asked) == 1


def test_final_words_that_are_the_same_leave_the_replies_where_they_are(
    rounds: SuggestionCycle, heard: Follower
) -> None:
    begun(rounds, heard, "It stops at once.")
    rounds.on_participant(FINISHED, 6 * S)
    assert len(heard.asked) == 1 and rounds.round is not None and rounds.round.person_id == "p-luis"
    rounds.on_participant(replace(FINISHED, text="Can it help people?"), 6 * S)
    assert heard.fates == [(1, "superseded")] and heard.asked[-1].text == "Can it help people?"
    assert heard.asked[-1].revision == 2


def test_a_turn_is_replied_to_also_where_its_end_is_reported_before_the_silence(
    rounds: SuggestionCycle, heard: Follower
) -> None:
    rounds.add(replace(SPEAKING, stamp_ns=4 * S))
    rounds.on_participant(FINISHED, 6 * S)
    assert [each.text for each in heard.asked] == ["Can it hurt people?"]


def test_a_turn_whose_end_is_reported_while_a_person_speaks_again_waits_for_what_that_is(
    rounds: SuggestionCycle, heard: Follower
) -> None:
    again = replace(SPEAKING, utterance_id="t-2", committed="")
    rounds.add(again)
    rounds.on_participant(FINISHED, 6 * S)
    assert heard.asked == []
    rounds.add(replace(again, speaking=False, stamp_ns=7 * S, silent_since_ns=7 * S))
    rounds.pass_time(8 * S)
    assert [each.text for each in heard.asked] == ["Can it hurt people?"]


def test_robot_speech_gets_no_reply(rounds: SuggestionCycle, heard: Follower) -> None:
    begun(rounds, heard, "It stops at once.")
    rounds.on_participant(replace(FINISHED, state="failed", text=""), 6 * S)
    rounds.pass_time(9 * S)
    assert heard.fates == [(1, "superseded")] and len(heard.asked) == 1
    rounds.add(replace(SILENT, speaker="robot", utterance_id="t-2", stamp_ns=10 * S, silent_since_ns=10 * S))
    rounds.pass_time(12 * S)
    assert len(heard.asked) == 1


def test_after_a_noise_the_turn_before_it_is_still_to_be_replied_to(rounds: SuggestionCycle, heard: Follower) -> None:
    begun(rounds, heard, "It stops at once.")
    noise = replace(SPEAKING, utterance_id="t-2", committed="", speaker="")
    rounds.add(noise)
    rounds.add(replace(noise, speaking=False, stamp_ns=7 * S, silent_since_ns=7 * S))
    rounds.pass_time(8 * S)
    assert [(each.text, each.revision) for each in heard.asked] == [
        ("can it hurt people", 1),
        ("can it hurt people", 2),
    ]


def test_a_filler_leaves_the_replies_and_every_other_sentence_ends_them(
    rounds: SuggestionCycle, heard: Follower
) -> None:
    begun(rounds, heard, "It stops at once.")
    rounds.on_robot(replace(ROBOT, origin="filler"), 6 * S)
    assert len(rounds.cards) == 1
    rounds.on_robot(ROBOT, 7 * S)
    assert heard.fates == [(1, "superseded")]


def test_a_sentence_that_waited_in_the_queue_moves_nothing_on_when_it_is_started(
    rounds: SuggestionCycle, heard: Follower
) -> None:
    for number in (1, 2):
        rounds.on_robot(replace(ROBOT, utterance_id=f"u-{number}"), 4 * S)
    begun(rounds, heard, "It stops at once.")
    rounds.on_robot(replace(ROBOT, utterance_id="u-1", state="started"), 6 * S)
    rounds.on_robot(replace(ROBOT, utterance_id="u-2", state="started"), 7 * S)
    assert len(rounds.cards) == 1


def test_dismissed_ones_do_not_return_with_the_next_noise(rounds: SuggestionCycle, heard: Follower) -> None:
    begun(rounds, heard, "It stops at once.", "Would you like to see it?")
    rounds.dismiss(WIZARD, 6 * S)
    assert heard.fates == [(1, "dismissed"), (2, "dismissed")]
    rounds.add(replace(SPEAKING, utterance_id="t-2", committed=""))
    rounds.add(replace(SILENT, utterance_id="t-2", committed="", stamp_ns=8 * S, silent_since_ns=8 * S))
    rounds.pass_time(9 * S)
    assert len(heard.asked) == 1


def test_an_unused_suggestion_expires_once(rounds: SuggestionCycle, heard: Follower) -> None:
    begun(rounds, heard, "It stops at once.")
    shown_ns = rounds.cards[0].shown_ns
    rounds.pass_time(shown_ns + EXPIRES_NS - 1)
    assert len(rounds.cards) == 1
    rounds.pass_time(shown_ns + EXPIRES_NS)
    rounds.forget(shown_ns + EXPIRES_NS)
    assert heard.fates == [(1, "expired")]


def test_a_key_for_the_earlier_suggestion_speaks_nothing(rounds: SuggestionCycle, heard: Follower) -> None:
    begun(rounds, heard, "It stops at once.")
    rounds.on_participant(replace(FINISHED, text="Can it help people?"), 5 * S + S // 2)
    rounds.offer(heard.asked[-1], "Yes, in the kitchen.", "small", 5 * S + S // 2)
    card = rounds.cards[0]
    assert rounds.card(card.suggestion_id, card.shown_ns + TO_READ_NS - 1) is None
    assert rounds.card(card.suggestion_id, card.shown_ns + TO_READ_NS) == card


def test_only_a_key_speaks_unless_the_level_permits_a_countdown(rounds: SuggestionCycle, heard: Follower) -> None:
    begun(rounds, heard, "It stops at once.", "Would you like to see it?")
    shown_ns = rounds.cards[0].shown_ns
    assert rounds.says_ns is None and rounds.due(shown_ns + 3 * S) is None
    rounds.acts_after_ns = 3 * S
    assert rounds.due(shown_ns + 3 * S - 1) is None
    assert rounds.due(shown_ns + 3 * S) == rounds.cards[0]
    assert rounds.due(shown_ns + 5 * S) is None, "the program stood still, so nobody saw the end of the countdown"
    rounds.add(SPEAKING)
    assert rounds.due(shown_ns + 3 * S) is None


def test_a_corrected_turn_is_replied_to_as_corrected(rounds: SuggestionCycle, heard: Follower) -> None:
    begun(rounds, heard, "It stops at once.")
    rounds.reword("Can it heat people?", 7 * S)
    assert heard.asked[-1].text == "Can it heat people?" and heard.fates == [(1, "superseded")]
    rounds.withdraw("the wizard spoke", 8 * S)
    assert rounds.round is None
    assert Counter(event.state for event in heard.told) == {"displayed": 1, "superseded": 1}
    assert heard.told[-1].actor == CONSOLE
