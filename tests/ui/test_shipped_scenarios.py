"""Shipped scenarios: their differences, and every key in them."""

import math
from dataclasses import fields

import pytest

from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.scenario.protocol_steps import step_named
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.scenario.scenario_model import Permissions, Scenario, layout_data
from caris_desktop.simulator.floor_plan import SOLID, Box
from caris_desktop.ui.action_bindings import actions_for, keyed_phrases
from caris_desktop.ui.action_rows import say_keyed_phrase
from caris_desktop.ui.key_choices import conflicts

SHIPPED = {path.stem: load_scenario(path) for path in sorted(layouts_dir().glob("*.yaml"))}


def test_those_are_there() -> None:
    assert {name: scenario.title for name, scenario in SHIPPED.items()} == {
        "blank": "Blank",
        "mental-health-check": "Mental health check",
        "practice": "Practice",
        "reception": "Reception",
        "tour-guide": "Tour guide",
    }


def test_they_differ_in_more_than_words() -> None:
    for what in (
        lambda scenario: tuple(getattr(scenario.permissions, each.name) for each in fields(Permissions)),
        lambda scenario: str(layout_data(scenario.layout)),
        lambda scenario: (scenario.driving, scenario.assistance, scenario.blur, scenario.protocol),
    ):
        assert len({what(scenario) for scenario in SHIPPED.values()}) == len(SHIPPED)


@pytest.mark.parametrize("scenario", SHIPPED.values(), ids=SHIPPED)
def test_every_key_of_a_phrase_works(scenario: Scenario) -> None:
    rows = actions_for(scenario)
    assert conflicts(rows) == []
    bound = {row.argument for row in rows if row.intent is say_keyed_phrase}
    assert bound == set(keyed_phrases(scenario)), "else the key belongs to another row"


def test_the_simulated_robot_has_room_at_every_place() -> None:
    def away_m(box: Box, x_m: float, y_m: float) -> float:
        return math.hypot(max(box.x0_m - x_m, 0.0, x_m - box.x1_m), max(box.y0_m - y_m, 0.0, y_m - box.y1_m))

    for scenario in SHIPPED.values():
        for place in scenario.places:
            at = place.pose_in_map
            nearest_m = min(away_m(box, at.x_m, at.y_m) for box in SOLID)
            assert nearest_m > 0.3, f"{scenario.title}: {place.name}"


def test_the_mental_health_check_keeps_little_comes_slowly_and_hands_over() -> None:
    scenario = SHIPPED["mental-health-check"]
    permissions = scenario.permissions
    assert not (permissions.photos or permissions.cloud_models or permissions.audio_recording)
    assert (scenario.blur.who, scenario.face.face, scenario.perception.recognise) == ("everybody", "calm", "nobody")
    assert scenario.driving.max_forward_mps <= 0.2
    steps = scenario.protocol.steps
    assert [step.title for step in steps if step.go_to] == [steps[0].title], "it comes up, then it stands still"
    over = step_named(steps, "Hand over to a person")
    assert over is not None
    talking = [step for step in steps[1:] if step is not over]
    lead_on = {branch.to for step in talking for branch in step.branches}
    assert over.title in lead_on
    assert any(phrase.say == over.say for phrase in keyed_phrases(scenario)), "one key in every group"


def test_the_reception_branches_to_what_people_came_for() -> None:
    steps = SHIPPED["reception"].protocol.steps
    greet = step_named(steps, "Greet")
    assert greet is not None and len(greet.branches) >= 4
    reached, new = set(), {steps[0].step_id}
    while new:
        step = step_named(steps, new.pop())
        assert step is not None
        reached.add(step.step_id)
        after = steps[steps.index(step) + 1 :][:1]
        new |= {each.step_id for each in after} - reached
        for branch in step.branches:
            to = step_named(steps, branch.to)
            assert to is not None
            new |= {to.step_id} - reached
    assert reached == {step.step_id for step in steps}


def test_practice_has_all_that_is_practised() -> None:
    scenario = SHIPPED["practice"]
    permissions = scenario.permissions
    assert scenario.robot == "simulated"
    for needed in ("photos", "driving", "assistant", "naming_people", "transcription", "speech"):
        assert getattr(permissions, needed), needed
    panels = str(layout_data(scenario.layout))
    for panel in ("video", "drive", "speak", "people", "assistant", "conversation", "session"):
        assert f"'{panel}'" in panels


def test_the_blank_one_keeps_nothing_of_people() -> None:
    permissions = SHIPPED["blank"].permissions
    kept = ("photos", "video_recording", "audio_recording", "transcription", "cloud_models")
    assert [name for name in kept if getattr(permissions, name)] == []
