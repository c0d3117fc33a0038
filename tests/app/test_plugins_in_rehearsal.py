"""Plug-ins in a whole rehearsal: the examples as packages, and ones that fail while the robot is driven."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from caris_desktop.domain.shipped import layouts_dir
from tests.support.plugins import ROOT, built_and_installed, install


def rehearsed(
    folder: Path, tracker: str, model: str, panel: str, python_path: str
) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """Header and events of a rehearsal of the tour with these plug-ins."""
    text = (layouts_dir() / "tour-guide.yaml").read_text("utf-8")
    text, found = re.subn(r"^( +)model: embedded$", rf"\1model: plugin:{model}", text, flags=re.MULTILINE)
    assert found == 1 and "perception:" not in text
    text, found = re.subn(r"tabs: \[", f'tabs: ["plugin:{panel}", ', text, count=1)
    assert found == 1
    scenario = folder / "tour.yaml"
    scenario.write_text(f"{text}\nperception: {{tracker: {tracker}}}\n", "utf-8")
    words = ["rehearse", scenario, "--out", folder / "out", "--accept-named"]
    done = subprocess.run(
        [sys.executable, "-m", "caris_desktop", *words],
        env={**os.environ, "PYTHONPATH": python_path}, capture_output=True, text=True, check=False, timeout=350,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    (session,) = (folder / "out" / "study" / "sessions").iterdir()
    messages: dict[str, list[Any]] = {}
    with (session / "events.mcap").open("rb") as stream:
        for _schema, channel, message in make_reader(stream).iter_messages():
            messages.setdefault(channel.topic, []).append(json.loads(message.data))
    return json.loads((session / "session.json").read_text("utf-8")), messages


@pytest.mark.long
@pytest.mark.timeout(500)
def test_the_examples_take_part_and_are_named_in_the_session(tmp_path: Path) -> None:
    examples = [ROOT / "examples" / "plugins" / name for name in ("nearest-tracker", "phrase-model", "turn-timer")]
    path = built_and_installed(tmp_path, *examples)
    header, messages = rehearsed(tmp_path, "nearest", "phrases", "turn_timer", path)
    used = {name: version for name, version in header["software"].items() if name.startswith("plug-in")}
    assert used == {
        "plug-in tracker nearest": "caris-nearest-tracker 1.0",
        "plug-in language model phrases": "caris-phrase-model 1.0",
        "plug-in panel turn_timer": "caris-turn-timer 1.0",
    }
    assert any(message["boxes"] for message in messages["/people"])
    (exchange,) = (each for each in messages["/event/llm_exchange"] if each["purpose"] == "question")
    assert exchange["outcome"] == "answered" and "caris-phrase-model 1.0" in json.dumps(exchange)


@pytest.mark.long
@pytest.mark.timeout(500)
def test_ones_that_fail_cost_neither_driving_nor_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    packages = tmp_path / "packages"
    tracker = """
import time

class Plugin:
    caris_interface = 1

    def __init__(self, *, appearance):
        pass

    def follow(self, corners_px, confidences, frame):
        time.sleep(3600)
"""
    model = """
class Plugin:
    caris_interface = 1

    def answer(self, messages, **how):
        raise KeyError("no idea")
"""
    panel = """
from PySide6.QtWidgets import QLabel
from caris_desktop.domain.events import UtteranceChanged

class Plugin(QLabel):
    caris_interface = 1

    def __init__(self, console):
        super().__init__("Last words")
        console.follow(UtteranceChanged, lambda utterance: self.setText(utterance.words))
"""
    install(packages, "panels", "blank", panel, monkeypatch)
    install(packages, "trackers", "stuck", tracker, monkeypatch)
    install(packages, "language_models", "lost", model, monkeypatch)
    header, messages = rehearsed(tmp_path, "stuck", "lost", "blank", os.pathsep.join((str(packages), str(ROOT))))
    told = [each["what"] for each in messages.get("/event/problem", ()) if "switched off" in each["what"]]
    assert any("lost (lab-lost 2.1)" in what for what in told), told
    assert any("blank (lab-blank 2.1) was switched off: it raised AttributeError" in what for what in told), told
    assert max(each["twist"]["forward_mps"] for each in messages["/event/command_sent"]) > 0.1
    assert any(message["boxes"] for message in messages["/people"]), "the built-in tracker took over"
    assert header["reason"] == "wizard"
