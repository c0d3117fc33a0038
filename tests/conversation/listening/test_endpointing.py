"""Endpointing by voice activity, with the clock of the sound."""

import pytest

from caris_desktop.conversation.listening.endpointing import (
    EndpointDelayModel,
    SilenceOfPeople,
    TurnTaking,
    silence_to_wait_s,
)
from caris_desktop.conversation.listening.recogniser_messages import UseSilence

WINDOW_NS = 32_000_000
BOUNDS = UseSilence()


class Talk:
    """Feeds an endpointer; ``changes`` are its results with their times in seconds."""

    def __init__(self, silence: SilenceOfPeople | None = None) -> None:
        self.turns = TurnTaking(silence or SilenceOfPeople(), BOUNDS)
        self.now_ns = 0
        self.changes: list[tuple[str, float]] = []

    def hear(self, seconds: float, voice: float, *, turn_over: float | None = None) -> "Talk":
        until_ns = self.now_ns + round(seconds * 1e9)
        while self.now_ns < until_ns:
            change = self.turns.process(self.now_ns, WINDOW_NS, voice)
            self.now_ns += WINDOW_NS
            if change == "paused" and turn_over is not None:
                self.turns.judge(turn_over)
            if change is not None:
                self.changes.append((change, self.now_ns / 1e9))
        return self

    @property
    def said(self) -> list[str]:
        return [change for change, _ in self.changes]


def test_a_turn_begins_pauses_continues_and_ends() -> None:
    talk = Talk().hear(1, 0).hear(2, 0.9).hear(0.3, 0.1).hear(1, 0.8).hear(4, 0)
    assert talk.said == ["began", "paused", "spoke on", "paused", "over"]
    assert talk.turns.started_ns / 1e9 == pytest.approx(1.0, abs=0.033)
    assert talk.turns.voice_ended_ns / 1e9 == pytest.approx(4.3, abs=0.12)


def test_a_click_is_no_turn() -> None:
    assert Talk().hear(1, 0).hear(0.1, 0.9).hear(2, 0).hear(0.1, 0.9).hear(2, 0).said == []


def test_a_word_that_dips_is_one_voice() -> None:
    assert Talk().hear(1, 0.9).hear(0.1, 0.1).hear(1, 0.9).said == ["began"]


def test_a_finished_speaker_is_not_waited_for_and_an_unfinished_one_is() -> None:
    def waited_s(turn_over: float | None) -> float:
        talk = Talk().hear(2, 0.9).hear(4, 0, turn_over=turn_over)
        return talk.changes[-1][1] - talk.turns.voice_ended_ns / 1e9

    sure, open_, unknown, not_over = waited_s(0.6), waited_s(0.36), waited_s(None), waited_s(0.05)
    assert sure <= 0.35
    assert sure < open_ < unknown == pytest.approx(not_over, abs=0.04)


def test_until_it_is_judged_a_pause_lasts_as_long_as_it_may() -> None:
    talk = Talk().hear(2, 0.9).hear(0.6, 0)
    assert talk.said == ["began", "paused"]
    talk.turns.judge(0.97)
    assert talk.hear(0.1, 0).said == ["began", "paused", "over"]
    assert Talk().hear(2, 0.9).hear(2, 0).said == ["began", "paused", "over"]


@pytest.mark.parametrize("turn_over", [None, 0.0, 0.2, 0.5, 0.8, 1.0])
@pytest.mark.parametrize("learnt_s", [0.5, 1.0, 3.0])
def test_the_wait_keeps_within_the_bounds_of_the_scenario(turn_over: float | None, learnt_s: float) -> None:
    bounds = UseSilence(0.6, 1.2)
    assert 0.6 <= silence_to_wait_s(turn_over, learnt_s, bounds) <= 1.2


def test_silence_is_learnt_from_a_persons_own_pauses() -> None:
    quick, slow = EndpointDelayModel(), EndpointDelayModel()
    for _ in range(30):
        quick.learn(0.25)
        slow.learn(1.4)
    assert quick.seconds < EndpointDelayModel().seconds < slow.seconds
    assert quick.seconds >= 0.5
    assert slow.seconds <= 3.0


def test_one_long_pause_changes_little() -> None:
    silence = EndpointDelayModel()
    for _ in range(20):
        silence.learn(0.4)
    before_s = silence.seconds
    silence.learn(2.9)
    assert silence.seconds - before_s < 0.2


def test_a_speaker_who_was_cut_off_gets_more_time() -> None:
    silence = SilenceOfPeople()
    at_first_s = silence.seconds
    talk = Talk(silence)
    for number in range(12):
        talk.turns.turn = f"h-{number}"
        talk.hear(1, 0.9).hear(1.6, 0, turn_over=0.96)
    assert talk.said.count("over") == 12
    assert silence.seconds > at_first_s + 0.3


def test_a_silence_in_which_the_robot_answered_is_no_pause() -> None:
    silence = SilenceOfPeople()
    at_first_s = silence.seconds
    talk = Talk(silence)
    for number in range(12):
        talk.turns.turn = f"h-{number}"
        talk.hear(1, 0.9).hear(0.8, 0, turn_over=0.96)
        talk.turns.another_spoke()
        talk.hear(0.8, 0)
    assert silence.seconds == at_first_s


def test_a_person_who_is_reported_afterwards_has_a_silence_of_their_own() -> None:
    silence = SilenceOfPeople()
    for number in range(10):
        silence.learn(f"slow-{number}", 1.5)
        silence.spoken_by(f"slow-{number}", "p-slow")
    slow_s = silence.seconds
    for number in range(10):
        silence.spoken_by(f"quick-{number}", "p-quick")
        silence.learn(f"quick-{number}", 0.25)
    assert silence.seconds < slow_s
    silence.spoken_by("slow-again", "p-slow")
    assert silence.seconds == slow_s
