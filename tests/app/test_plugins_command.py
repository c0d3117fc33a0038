"""The list of plug-ins, and the check before a session: each is loaded in a process of its own."""

import sys
from argparse import Namespace
from pathlib import Path

import pytest

from caris_desktop.app import check_command, command_table, plugins_command
from caris_desktop.domain import plugin_process
from caris_desktop.scenario.scenario_file import parse_scenario
from tests.support.plugins import install

GOOD = "class Plugin:\n    caris_interface = 1\n"


@pytest.fixture
def packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "packages"
    for name, source in {
        "good": GOOD,
        "later": GOOD.replace("1", "2"),
        "broken": "import nothing_of_this_name",
        "chatty": f"print('hello')\n{GOOD}",
        "deadly": "import os\nos._exit(3)",
        "slow": "import time\ntime.sleep(3600)",
    }.items():
        install(folder, "trackers", name, source, monkeypatch)
    monkeypatch.setattr(plugin_process, "LOAD_WITHIN_S", 10.0)
    return folder


@pytest.mark.logs("the plug-in broken of lab-broken failed")
def test_all_are_listed_with_version_and_fault(packages: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert command_table.run(["plugins"]) == 1
    printed = capsys.readouterr().out
    for line in (
        "trackers (interface version 1)",
        "ok   good                 lab-good 2.1",
        "FIX  later                lab-later 2.1: it is written for version 2 of the interface, and this program has",
        "FIX  broken               lab-broken 2.1: it raised ModuleNotFoundError: No module named",
        "FIX  chatty               lab-chatty 2.1: it printed “hello”.",
        "FIX  deadly               lab-deadly 2.1: it ended its process.",
        "FIX  slow                 lab-slow 2.1: it was not loaded within 10 s.",
        "language_models (interface version 1): no plug-ins",
        "detectors (interface version 1): no plug-ins",
        "exporters (interface version 1): no plug-ins",
        "measures (interface version 1): no plug-ins",
        "speech (interface version 1): no plug-ins",
        "cameras (interface version 1): no plug-ins",
        "robots (interface version 1): no plug-ins",
    ):
        assert line in printed
    assert "botsort" not in printed
    assert not [name for name in sys.modules if name.startswith("lab_")], "this process runs none of them"


def test_without_plug_ins_the_built_in_ones_are_listed_on_request(capsys: pytest.CaptureFixture[str]) -> None:
    assert plugins_command.run(Namespace(all=True)) == 0
    printed = capsys.readouterr().out
    assert "ok   botsort              caris-desktop" in printed and "ok   ros2                 caris-desktop" in printed


@pytest.mark.logs("the plug-in broken of lab-broken failed")
def test_the_check_loads_what_the_scenario_names(packages: Path, tmp_path: Path) -> None:
    for name, wrong in {"good": "", "broken": "ModuleNotFoundError"}.items():
        text = f"version: 1\ntitle: Lab\nlayout: {{panel: video}}\nperception: {{tracker: {name}}}\n"
        (finding,) = check_command.plugin_findings(parse_scenario(text, path=tmp_path / "lab.yaml"))
        assert finding.ok is not bool(wrong)
        assert f"tracker {name} (lab-{name} 2.1)" in finding.text and wrong in finding.text
