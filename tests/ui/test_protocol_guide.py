"""Guide of the protocol: its example loads, and its keys are those of the table."""

import re
from pathlib import Path

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.scenario.scenario_file import parse_scenario
from caris_desktop.ui.action_rows import ACTIONS, PROTOCOL_GROUP
from caris_desktop.ui.key_choices import normalized

PAGE = (resources_dir() / "guide" / "protocol.md").read_text(encoding="utf-8")
HEAD = "version: 1\ntitle: T\nlayout: {panel: video}\nplaces:\n  - {name: Robot arm, x_m: 1, y_m: 2}\n"


def test_the_example_is_a_protocol() -> None:
    (example,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    steps = parse_scenario(HEAD + example, path=Path("example.yaml")).protocol.steps
    assert [step.step_id for step in steps] == ["greet", "robot-arm", "questions", "farewell"]
    assert [branch.to for branch in steps[2].branches] == ["Robot arm", "Farewell"]


def test_its_keys_are_those_that_work() -> None:
    rows = [tuple(cell.strip() for cell in line.split("|")[1:4]) for line in PAGE.splitlines() if line.startswith("| ")]
    told = {
        tuple(normalized(key.replace("Page", "Pg")) if key else "" for key in (anywhere, driving))
        for anywhere, driving, _ in rows[2:]
    }
    bound = {
        (normalized(spec.keys[0]), normalized(spec.driving_keys[0]) if spec.driving_keys else "")
        for spec in ACTIONS
        if spec.group == PROTOCOL_GROUP
    }
    assert told == bound
