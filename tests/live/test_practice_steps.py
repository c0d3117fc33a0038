"""Practice steps: each is ticked after its real event, and the score evaluates the run."""

from typing import Any, Literal

import pytest

from caris_desktop.domain.events import (
    CommandSent,
    EmergencyStopChanged,
    LinkChanged,
    LlmExchange,
    Marked,
    PersonRenamed,
    PhotoTaken,
    SuggestionChanged,
    UtteranceChanged,
)
from caris_desktop.domain.geometry import ZERO_TWIST, Pose2D, Twist2D
from caris_desktop.domain.sensing import Odometry
from caris_desktop.live.services.practice_service import STEPS, Practice

FORWARD, STILL = Twist2D(0.4, 0.0, 0.0), Twist2D(0.0, 0.0, 0.0)


def _moves(twist: Twist2D = FORWARD) -> CommandSent:
    return CommandSent(0, 1, twist, "keyboard")


def _at(x_m: float) -> Odometry:
    return Odometry(0, None, Pose2D(x_m, 0.0, 0.0), FORWARD)


def _says(origin: Any, state: Any = "started") -> UtteranceChanged:
    return UtteranceChanged(0, "u-1", "robot", "Hello", origin, state)


def _stop(latched: bool) -> EmergencyStopChanged:
    return EmergencyStopChanged(0, latched, "wizard")


def _link(state: Literal["connected", "lost"]) -> LinkChanged:
    return LinkChanged(0, "control", state, "ws://x")


def _question(outcome: Any) -> LlmExchange:
    return LlmExchange(0, "e-1", "openai", "m", (), "", outcome, 0, None, {})


def _suggestion(state: Any) -> SuggestionChanged:
    return SuggestionChanged(0, "s-1", state, "t-1", 1, 1, "Yes.", "m")


DOES: dict[str, list[Any]] = {
    "drive": [_at(0.0), _moves(), _at(0.6), _at(1.05)],
    "type": [_moves(), _says("typed", "requested")],
    "phrase": [_says("phrase")],
    "name": [PersonRenamed(0, "p-1", "wizard")],
    "photo": [PhotoTaken(0, "front", 1, "photos/1.png")],
    "ask": [_question("answered")],
    "suggestion": [_suggestion("taken")],
    "mark": [Marked(0, "")],
    "link": [_link("lost"), _link("connected"), _moves(), _at(0.0), _at(0.4)],
    "emergency": [_stop(True), _stop(False)],
}
"""Events that complete each step with the last one, and not before."""
DOES_NOT: dict[str, list[Any]] = {
    "drive": [_at(0.0), _moves(ZERO_TWIST), _at(2.0)],  # moved by a goal or by hand
    "type": [_moves(), _moves(ZERO_TWIST), _says("typed", "requested")],
    "phrase": [_says("typed"), _says("phrase", "requested")],
    "name": [PersonRenamed(0, "p-1", "")],
    "photo": [Marked(0, "")],
    "ask": [_question("failed")],
    "suggestion": [_suggestion("displayed"), _suggestion("dismissed")],
    "mark": [Marked(0, "", "wizard_error"), Marked(0, "", state="withdrawn")],
    "link": [_moves(), _at(0.0), _at(0.4)],
    "emergency": [_stop(False)],
}


def _at_step(step_id: str) -> Practice:
    practice = Practice(0.0)
    while practice.now is not None and practice.now.id != step_id:
        practice.skip(0.0)
    return practice


@pytest.mark.parametrize("step_id", DOES)
def test_a_step_ends_when_it_has_happened_and_not_before(step_id: str) -> None:
    practice = _at_step(step_id)
    *before, last = DOES[step_id]
    assert [practice.add(value, 1.0) for value in before] == [None] * len(before)
    ended = practice.add(last, 2.0)
    assert ended is not None and (ended.step.id, ended.done, ended.took_s) == (step_id, True, 2.0)


@pytest.mark.parametrize("step_id", DOES_NOT)
def test_similar_events_do_not_end_a_step(step_id: str) -> None:
    practice = _at_step(step_id)
    assert [practice.add(value, 1.0) for value in DOES_NOT[step_id]] == [None] * len(DOES_NOT[step_id])


def test_the_usual_time_gives_all_points() -> None:
    practice, now_s = Practice(0.0), 0.0
    for step in STEPS:
        now_s += step.usual_s
        for value in DOES[step.id]:
            practice.add(value, now_s)
    assert (practice.now, practice.done, practice.score) == (None, 10, 100)
    assert practice.minutes(now_s) == pytest.approx(sum(step.usual_s for step in STEPS) / 60)


def test_slow_steps_have_fewer_points_and_skipped_ones_none() -> None:
    practice = Practice(0.0)
    usual_s = STEPS[0].usual_s
    for value in DOES["drive"]:
        practice.add(value, 2 * usual_s)
    assert practice.score == 8  # midway between ten and five, rounded
    practice.skip(2 * usual_s + 1)
    assert practice.score == 8
    slow = Practice(0.0)
    for value in DOES["drive"]:
        slow.add(value, 100 * usual_s)
    assert slow.score == 5


def test_the_last_of_the_distance_counts_though_it_is_reported_after_the_key() -> None:
    practice = _at_step("drive")
    assert practice.add(_at(0.0), 0.0) is None
    assert practice.add(_moves(), 0.0) is None
    assert practice.add(_moves(STILL), 3.0) is None
    ended = practice.add(_at(1.1), 3.5)
    assert ended is not None and ended.done


def test_motion_by_hand_after_the_drive_does_not_count() -> None:
    practice = _at_step("drive")
    for value in (_at(0.0), _moves(), _at(0.5), _moves(STILL), _at(0.6)):
        assert practice.add(value, 1.0) is None
    assert practice.add(_at(2.0), 2.0) is None


def test_earlier_events_do_not_count_for_a_step() -> None:
    practice = _at_step("link")
    practice.add(_link("lost"), 1.0)
    practice.skip(2.0)
    assert practice.now is not None and practice.now.id == "emergency"
    practice = _at_step("mark")
    practice.add(_stop(True), 1.0)
    for value in (Marked(0, ""), _link("lost"), _moves(), _at(0.0), _at(1.0)):
        practice.add(value, 2.0)
    assert practice.now is not None and practice.now.id == "emergency"
    assert practice.add(_stop(False), 3.0) is None
