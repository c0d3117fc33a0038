"""Intents of the protocol keys."""

from caris_desktop.domain import intents
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.phrases import Phrase, phrase_groups
from caris_desktop.scenario.protocol_steps import Branch, ProtocolStep, step_named
from caris_desktop.scenario.scenario_model import Scenario
from caris_desktop.ui.action_spec import ActionSpec, gives

PROTOCOL_GROUP = QT_TR_NOOP("Protocol")


def present_step(scenario: Scenario, state: LiveState) -> ProtocolStep | None:
    """Current step, from the scenario."""
    step_id = state.protocol.value.step_id
    return step_named(scenario.protocol.steps, step_id) if step_id else None


def target_of(scenario: Scenario, branch: Branch) -> ProtocolStep:
    """Target step of a branch."""
    target = step_named(scenario.protocol.steps, branch.to)
    if target is None:
        raise ValueError(f"no scenario with a branch to nowhere is opened: {branch.to}")
    return target


@gives(intents.Say)
def say_step(scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    """Say the sentence of the current step, with the gesture and expression of a matching phrase."""
    step = present_step(scenario, state)
    if step is None or not step.say:
        return None
    phrases = (phrase for group in phrase_groups(scenario.phrases) for phrase in group.phrases)
    phrase = next((phrase for phrase in phrases if phrase.say == step.say), Phrase(step.say))
    return intents.Say(step.say, "phrase", gesture=phrase.gesture, face=phrase.face)


@gives(intents.GoToPlace)
def go_to_step_place(scenario: Scenario, state: LiveState, _argument: None) -> Intent | None:
    step = present_step(scenario, state)
    return intents.GoToPlace(step.go_to) if step is not None and step.go_to else None


PROTOCOL_ACTIONS: tuple[ActionSpec, ...] = (
    ActionSpec(
        "next_step",
        QT_TR_NOOP("Next step"),
        "arrow-right",
        ("Ctrl+PgDown",),
        ("PgDown",),
        enabled_when="step_ahead",
        intent=intents.NextStep(),
        group=PROTOCOL_GROUP,
    ),
    ActionSpec(
        "branch",
        QT_TR_NOOP("Choose a branch"),
        "git-branch",
        ("Ctrl+B",),
        ("B",),
        enabled_when="step_branches",
        callback="choose_branch",
        group=PROTOCOL_GROUP,
    ),
    ActionSpec(
        "previous_step",
        QT_TR_NOOP("Back to the previous step"),
        "arrow-left",
        ("Ctrl+PgUp",),
        ("PgUp",),
        enabled_when="step_back",
        intent=intents.PreviousStep(),
        group=PROTOCOL_GROUP,
    ),
    ActionSpec(
        "skip_step",
        QT_TR_NOOP("Skip this step"),
        "skip-forward",
        ("Ctrl+Shift+PgDown",),
        ("Shift+PgDown",),
        enabled_when="step",
        intent=intents.SkipStep(),
        group=PROTOCOL_GROUP,
    ),
    ActionSpec(
        "say_step",
        QT_TR_NOOP("Say the text of this step"),
        "chat-text",
        ("F11",),
        permission="speech",
        enabled_when="step_says",
        intent=say_step,
        group=PROTOCOL_GROUP,
    ),
    ActionSpec(
        "go_to_step_place",
        QT_TR_NOOP("Go to the place of this step"),
        "flag",
        ("Alt+0",),
        ("0",),
        "driving",
        enabled_when="step_goes",
        intent=go_to_step_place,
        group=PROTOCOL_GROUP,
        by_position=True,
    ),
    ActionSpec(
        "all_steps",
        QT_TR_NOOP("All steps of the protocol"),
        "list-numbers",
        ("Ctrl+Shift+PgUp",),
        callback="show_steps",
        group=PROTOCOL_GROUP,
    ),
)
