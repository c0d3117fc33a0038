"""Response times for a participant, from speech events."""

from caris_desktop.conversation.conversation_transcript import ResponseTimes, Turn, waiting
from caris_desktop.domain.events import (
    ResponseTimed,
    Speaker,
    SuggestionChanged,
    UtteranceChanged,
    UtteranceCorrected,
    UtteranceOrigin,
    UtteranceState,
)
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE, Hearing

S = 1_000_000_000


def said(
    turn_id: str, state: UtteranceState, at_s: float, origin: UtteranceOrigin = "typed", speaker: Speaker = "robot"
) -> UtteranceChanged:
    return UtteranceChanged(round(at_s * S), turn_id, speaker, "Words.", origin, state)


def heard(turn_id: str, state: UtteranceState, at_s: float) -> UtteranceChanged:
    return said(turn_id, state, at_s, "heard", "participant")


def told(*events: UtteranceChanged | UtteranceCorrected | SuggestionChanged) -> list[ResponseTimed]:
    """Each event is reported 0.3 s after it happened."""
    times = ResponseTimes()
    return [timed for event in events for timed in times.add(event, event.stamp_ns + 300_000_000)]


def gaps_s(timed: list[ResponseTimed]) -> list[tuple[str, str, str, float]]:
    return [
        (one.turn_id, one.reply_id, one.means, round(((one.first_sound_ns or 0) - one.voice_ended_ns) / S, 3))
        for one in timed
    ]


def test_every_moment_of_an_answer_is_reported() -> None:
    shown = SuggestionChanged(round(2.7 * S), "s1", "displayed", "p", 3, 1, "Yes.", "small")
    assert told(
        heard("p", "started", 1.0), heard("p", "finished", 2.0), shown,
        said("r", "requested", 3.0, "suggestion"), said("r", "started", 3.2, "suggestion"),
    ) == [
        ResponseTimed(
            round(3.5 * S), "p", "r", "suggestion", 2 * S, text_ns=round(2.3 * S), suggested_ns=round(2.7 * S),
            asked_ns=3 * S, first_sound_ns=round(3.2 * S),
        )
    ]  # fmt: skip


def test_an_edited_suggestion_is_distinguished() -> None:
    taken = SuggestionChanged(3 * S, "s1", "edited", "p", 3, 1, "Yes.", "small", utterance_id="r")
    events = (heard("p", "finished", 2.0), said("r", "requested", 3.0, "suggestion"), taken)
    assert gaps_s(told(*events, said("r", "started", 3.2, "suggestion"))) == [("p", "r", "edited_suggestion", 1.2)]


def test_a_filler_and_then_the_first_that_is_none() -> None:
    timed = told(
        heard("p", "finished", 2.0), said("f", "started", 2.8, "filler"), said("g", "started", 3.5, "filler"),
        said("r", "started", 5.0), said("q", "started", 8.0, "phrase"),
    )  # fmt: skip
    assert gaps_s(timed) == [("p", "f", "filler", 0.8), ("p", "r", "typed", 3.0)]


def test_an_answer_over_a_speaker_precedes_their_end() -> None:
    timed = told(heard("p", "started", 1.0), said("r", "started", 1.8, "phrase"), heard("p", "finished", 2.5))
    assert gaps_s(timed) == [("p", "r", "phrase", -0.7)]


def test_an_answer_may_come_before_its_turn_was_understood() -> None:
    """The end of speech is known only after some silence."""
    timed = told(heard("p", "started", 1.0), said("r", "started", 2.4), heard("p", "finished", 2.0))
    assert gaps_s(timed) == [("p", "r", "typed", 0.4)]


def test_an_interruption_of_the_robot_was_not_answered_by_it() -> None:
    timed = told(said("r", "started", 1.0), heard("p", "started", 1.5), heard("p", "finished", 2.0))
    assert timed == []


def test_only_the_newest_turn_is_answered_and_noise_is_none() -> None:
    timed = told(
        heard("p1", "started", 1.0), heard("p1", "finished", 2.0), heard("p2", "started", 2.3),
        heard("p2", "finished", 3.0), heard("noise", "started", 3.2), heard("noise", "failed", 3.4),
        said("r", "started", 4.0),
    )  # fmt: skip
    assert gaps_s(timed) == [("p2", "r", "typed", 1.0)]


def test_speech_during_noise_answers_the_turn_before() -> None:
    timed = told(
        heard("p", "finished", 2.0), heard("noise", "started", 2.5), said("r", "started", 2.8),
        heard("noise", "failed", 3.4),
    )  # fmt: skip
    assert gaps_s(timed) == [("p", "r", "typed", 0.8)]


def test_an_utterance_after_half_a_minute_is_no_answer() -> None:
    assert told(heard("p", "finished", 2.0), said("r", "started", 32.5)) == []


def test_robot_speech_in_the_microphone_was_no_turn() -> None:
    wrong = UtteranceCorrected(2 * S, "p", speaker="robot")
    assert told(heard("p", "finished", 2.0), wrong, said("r", "started", 3.0)) == []
    who = UtteranceCorrected(2 * S, "p", person_id="p-7")
    assert [one.person_id for one in told(heard("p", "finished", 2.0), who, said("r", "started", 3.0))] == ["p-7"]


def test_unprompted_robot_speech_is_no_answer() -> None:
    assert told(heard("p", "finished", 2.0), said("r", "started", 3.0, "heard")) == []


# Present waiting time


def turn(turn_id: str, speaker: Speaker, started_s: float, ended_s: float | None) -> Turn:
    return Turn(
        turn_id, speaker, "Words.", "heard", "started" if ended_s is None else "finished", round(started_s * S),
        None if ended_s is None else round(ended_s * S),
    )  # fmt: skip


def stands(at_s: float, *turns: Turn, hearing: Hearing | None = None) -> tuple[str, float] | None:
    now = waiting(turns, [] if hearing is None else [hearing], round(at_s * S))
    return None if now is None else (now.state, round(now.seconds, 3))


def test_it_is_known_how_long_a_person_waits() -> None:
    question, answer = turn("p", "participant", 1.0, 2.0), turn("r", "robot", 3.1, None)
    assert stands(0.5, question) is None
    assert stands(1.5, question) == ("talking", 0.0)
    assert stands(2.7, question) == ("waiting", 0.7)
    assert stands(3.0, question, answer) == ("waiting", 1.0)
    assert stands(3.5, question, answer) == ("answered", 1.1)
    assert stands(123.0, question) is None, "nobody waits any more"


def test_silence_counts_before_the_turn_is_known_to_be_over() -> None:
    question = turn("p", "participant", 1.0, None)
    hearing = Hearing(round(2.4 * S), ROBOT_MICROPHONE, False, "participant", "p", silent_since_ns=2 * S)
    assert stands(2.5, question, hearing=hearing) == ("waiting", 0.5)
