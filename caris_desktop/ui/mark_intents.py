"""Intents of the mark keys, from the current state."""

from caris_desktop.domain import intents
from caris_desktop.domain.events import Marked
from caris_desktop.domain.intents import Intent
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui.action_spec import gives

STEP_BACK_S = 3.0


@gives(intents.Mark)
def mark_moment(_scenario: Scenario, _state: LiveState, _argument: None) -> Intent:
    return intents.Mark("")


@gives(intents.Mark)
def mark_with_label(scenario: Scenario, _state: LiveState, number: int) -> Intent:
    labels = scenario.recording.labels
    return intents.Mark(labels[number - 1] if number <= len(labels) else "")


@gives(intents.Mark)
def mark_wizard_error(_scenario: Scenario, _state: LiveState, _argument: None) -> Intent:
    return intents.Mark("", "wizard_error")


@gives(intents.BeginMark, intents.EndMark)
def begin_or_end_interval(_scenario: Scenario, state: LiveState, _argument: None) -> Intent:
    """End the newest open interval that no key holds, or begin one."""
    going_on: tuple[Marked, ...] = state.marks.value.open
    held = state.held_marks.value
    stretch = next((mark for mark in reversed(going_on) if mark.mark_id not in held), None)
    return intents.BeginMark("") if stretch is None else intents.EndMark(stretch.mark_id)


@gives(intents.ChangeMark)
def move_last_mark_back(_scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    last: Marked | None = state.marks.value.last
    return None if last is None else intents.ChangeMark(last.mark_id, earlier_s=STEP_BACK_S)


@gives(intents.WithdrawMark)
def withdraw_last_mark(_scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    last: Marked | None = state.marks.value.last
    return None if last is None else intents.WithdrawMark(last.mark_id)
