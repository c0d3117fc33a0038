"""Intents of the speech queue's keys for the selected utterance."""

from caris_desktop.domain import intents
from caris_desktop.domain.intents import Intent
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui.action_spec import gives


@gives(intents.CancelQueued)
def cancel_queued(_scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    chosen = state.chosen_utterance.value
    return intents.CancelQueued(chosen) if chosen in _waiting(state) else None


@gives(intents.MoveQueued)
def move_queued(_scenario: Scenario, state: LiveState, step: int) -> Intent | None:
    """Move one position later (1) or earlier (-1)."""
    chosen, waiting = state.chosen_utterance.value, _waiting(state)
    if chosen not in waiting:
        return None
    place = waiting.index(chosen) + step
    return intents.MoveQueued(chosen, place) if 0 <= place < len(waiting) else None


def _waiting(state: LiveState) -> list[str]:
    return [utterance.utterance_id for utterance in state.speech.value.waiting]
