"""The guide's page about preflight checks names each of them, and its example is part of a valid scenario."""

import re
from dataclasses import replace
from pathlib import Path

from caris_desktop.domain.shipped import resources_dir
from caris_desktop.live.services.preflight_service import automatic_checks, ticked_checks
from caris_desktop.robot.profile import load_profile
from caris_desktop.scenario.scenario_file import parse_scenario
from tests.live.test_preflight_checks import GOOD, STUDY, by_id, covering

PAGE = (resources_dir() / "guide" / "preflight.md").read_text(encoding="utf-8")


def test_each_check_is_in_the_table_and_no_other() -> None:
    table = PAGE.split("## What the console checks")[1].split("## What you check")[0]
    named = re.findall(r"^\| ([^|]+?) \|", table, re.MULTILINE)[2:]
    simulated = replace(GOOD, robot=load_profile("simulated"), scenario=covering(STUDY, "without_consent"))
    checks = {**by_id(simulated), "people unblurred": by_id(GOOD)["people"]}
    assert sorted(named) == sorted(check.title for check in checks.values())
    assert len(automatic_checks(simulated)) == len(named) - 1


def test_the_example_is_read() -> None:
    (example,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    scenario = parse_scenario(f"version: 1\ntitle: A\nlayout: {{panel: video}}\n{example}", path=Path("a.yaml"))
    assert [(check.title, check.needed) for check in ticked_checks(scenario, {})] == [
        ("Consent form signed", True),
        ("Emergency button in reach", True),
        ("The way is clear", False),
    ]
