"""Cameras of others: installed as packages, shown, and switched off when they fail."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.app.composition import _camera_plugins
from caris_desktop.app.plugin_contracts import check_camera
from caris_desktop.domain.events import Problem
from caris_desktop.domain.sensing import CameraState, FrameRef
from caris_desktop.perception.cameras import plugin_camera
from caris_desktop.perception.cameras.camera_source import parse_camera
from caris_desktop.scenario.scenario_file import parse_scenario
from tests.perception.cameras.running_camera import RunningCamera, has, has_state
from tests.support.plugins import install

Start = Callable[..., RunningCamera]
PICTURE = "return np.full((48, 64, 3), self.pictures, np.uint8)"


def source(body: str = PICTURE, version: int = 1, begin: str = "pass") -> str:
    return f"""
import os, time
import numpy as np

class Plugin:
    caris_interface = {version}

    def __init__(self, target):
        self.target, self.pictures = target, 0
        {begin}

    def read(self):
        time.sleep(0.02)
        self.pictures += 1
        if self.pictures < 4:
            {PICTURE}
        {body}
"""


def test_its_pictures_are_shown(start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "cameras", "lab", source(begin="assert target == 'rtsp://there'"), monkeypatch)
    camera = start("plugin:lab:rtsp://there", name="desk")
    camera.until(has(FrameRef, 8))
    (connected,) = (one for one in camera.of(CameraState) if one.state == "connected")
    assert (connected.camera, connected.width_px, connected.height_px) == ("desk", 64, 48)
    frames = camera.of(FrameRef)
    assert all(0 <= frame.stamp_ns - frame.taken_ns < 5_000_000_000 for frame in frames)
    assert "lab_lab" not in sys.modules, "this process does not run it"


@pytest.mark.logs("the plug-in lab of lab-lab failed", r"camera lab: ")
@pytest.mark.parametrize(
    ("module", "reason"),
    [
        (source("raise ValueError('no idea')"), "it raised ValueError: no idea"),
        (source(f"print('hello'); {PICTURE}"), "it printed “hello”"),
        (source("os._exit(3)"), "it ended its process"),
        (source("time.sleep(3600)"), "it did not return within 1 s"),
        (source("return np.zeros((48, 64))"), "it did not return a picture of shape (height, width, 3) in uint8"),
        (source(version=9), "it is written for version 9 of the interface, and this program has version 1"),
    ],
)
def test_one_that_fails_is_named_and_ends(
    module: str, reason: str, start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "cameras", "lab", module, monkeypatch)
    monkeypatch.setattr(plugin_camera, "READ_WITHIN_S", 1.0)
    camera = start("plugin:lab")
    camera.until(has_state("ended"), within_s=60.0)
    (problem,) = camera.of(Problem)
    assert problem.what == f"The camera plug-in lab (lab-lab 2.1) was switched off: {reason}."
    assert camera.of(CameraState)[-1].detail == problem.what


@pytest.mark.logs("camera lab: ")
def test_a_lost_camera_is_opened_again(start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "cameras", "lab", source("raise ConnectionError('no route')"), monkeypatch)
    camera = start("plugin:lab")
    camera.until(has_state("connected", 2), within_s=60.0)
    assert camera.of(Problem)[0].what == "The camera lab is lost: no route."
    assert "ended" not in camera.states()


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("return np.zeros((48, 64))", "shape"),
        ("return None", "shape"),
        (f"print('hello'); {PICTURE}", "prints"),
        ("return np.zeros((96, 64, 3), np.uint8)", "one size"),
    ],
)
def test_the_contract_refuses(body: str, message: str) -> None:
    made: dict[str, Any] = {}
    exec(source(body), made)  # noqa: S102 - of this test
    with pytest.raises(AssertionError, match=message):
        check_camera(made["Plugin"])


def test_scenario_and_session_name_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "cameras", "lab", source(), monkeypatch)
    text = "version: 1\ntitle: Lab\nlayout: {panel: video}\ncameras: [{source: 'plugin:lab:2'}, {source: robot}]\n"
    scenario = parse_scenario(text, path=tmp_path / "lab.yaml")
    assert _camera_plugins(None, scenario) == {"plug-in camera lab": "lab-lab 2.1"}
    assert _camera_plugins((parse_camera("robot"),), scenario) == {}
