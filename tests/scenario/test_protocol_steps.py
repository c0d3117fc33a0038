"""Protocols in scenario files, and messages for mistakes in them."""

from pathlib import Path

import pytest

from caris_desktop.scenario.protocol_steps import ProtocolSettings, ProtocolStep, step_named
from caris_desktop.scenario.scenario_file import ScenarioError, parse_scenario

PLACES = "places:\n  - {name: Kitchen, x_m: 1, y_m: 2}\n"
HEAD = f"version: 1\ntitle: T\nlayout: {{panel: video}}\n{PLACES}protocol:\n  steps:\n"


def protocol(steps: str) -> ProtocolSettings:
    return parse_scenario(HEAD + steps, path=Path("t.yaml")).protocol


def told(steps: str) -> str:
    with pytest.raises(ScenarioError) as refused:
        protocol(steps)
    return str(refused.value)


def test_an_id_follows_from_the_title_and_a_branch_leads_to_either() -> None:
    steps = protocol(
        "    - {title: 'Say hello, {name}!', minutes: 0.5, tick: [Coat off]}\n"
        "    - {title: Stress 1 to 10, id: stress, branches: [{title: Cries, to: stress}]}\n"
    ).steps
    assert [step.step_id for step in steps] == ["say-hello-name", "stress"]
    assert [step.expected_s for step in steps] == [30.0, 0.0]
    assert step_named(steps, "stress") == step_named(steps, "stress 1 TO 10") == steps[1]
    assert step_named(steps, "Sleep") is None
    assert ProtocolStep("Ünï – 二").step_id == "ünï-二" and ProtocolStep("!?").step_id == "!?"


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        (
            "    - title: Cook\n      go_to: Kitchn\n",
            "t.yaml, line 9: unknown place 'Kitchn'. Allowed: Kitchen. Did you mean 'Kitchen'?",
        ),
        (
            "    - title: Cook\n      branches:\n        - {title: Leaves, to: Coook}\n",
            "t.yaml, line 10: unknown step 'Coook'. Allowed: Cook. Did you mean 'Cook'?",
        ),
        (
            "    - title: Cook\n      then: ende\n",
            "t.yaml, line 9: unknown step 'ende'. Allowed: Cook, end. Did you mean 'end'?",
        ),
        (
            "    - title: Cook\n    - title: cook!\n",
            "t.yaml, line 9: duplicate step id 'cook': give one of them a different id.",
        ),
        (
            "    - title: Cook\n      branches:\n        - {title: Out, to: Cook}\n        - {title: out, to: Cook}\n",
            "t.yaml, line 11: duplicate branch 'out' in one step.",
        ),
        (
            "    - title: Cook\n      minutes: -1\n",
            "t.yaml, line 9: 'protocol.steps[1].minutes' is -1. Allowed: at least 0.",
        ),
    ],
)  # fmt: skip
def test_a_slip_is_reported_with_its_line_and_a_suggestion(steps: str, message: str) -> None:
    assert told(steps) == message


def test_a_place_where_there_are_none() -> None:
    text = HEAD.replace(PLACES, "") + "    - {title: A, go_to: Kitchen}\n"
    with pytest.raises(ScenarioError, match=r"line 6: unknown place 'Kitchen'\. This scenario has no places\."):
        parse_scenario(text, path=Path("t.yaml"))
