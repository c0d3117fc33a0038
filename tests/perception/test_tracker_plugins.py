"""Trackers of others: installed as packages, named, checked, and switched off when they fail."""

import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from caris_desktop.app.plugin_contracts import check_tracker
from caris_desktop.domain.plugins import BUILT_IN, GROUPS, PluginCall, PluginError, find, installed, load
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.perception.detector import Detections
from caris_desktop.perception.inference_messages import DetectionRequest
from caris_desktop.perception.tracker import PersonTracker
from tests.support.plugins import ROOT, install

PICTURE = np.zeros((480, 640, 3), np.uint8)


def source(body: str) -> str:
    """Module with a tracker whose method has this body."""
    return f"""
class Plugin:
    caris_interface = 1

    def __init__(self, *, appearance):
        self.pictures = 0

    def follow(self, corners_px, confidences, frame):
        self.pictures += 1
        {body}
"""


def people(count: int) -> Detections:
    corners = np.array([[50.0 + 150 * row, 100, 130 + 150 * row, 400] for row in range(count)]).reshape(-1, 4)
    return Detections(corners, np.full(count, 0.9), np.zeros(count, np.int64))


def look(number: int, camera: str = "front") -> DetectionRequest:
    return DetectionRequest(FrameRef((number + 1) * 100_000_000, None, camera, "", 0, number, 640, 480))


def test_the_built_in_plug_ins_are_entry_points_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    declared = {name.removeprefix("caris_desktop."): entries for name, entries in project["entry-points"].items()}
    assert declared == {group: entries for group, entries in BUILT_IN.items() if entries}
    assert set(GROUPS) == set(BUILT_IN)


@pytest.mark.parametrize("name", BUILT_IN["trackers"])
def test_a_built_in_tracker_keeps_the_contract(name: str) -> None:
    check_tracker(load(find("trackers", name)))


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("return [(1, 0), (1, 1)]", "twice"),
        ("return [(step, 0) for step in (1, 2)]", "twice"),
        ("return [(1, len(corners_px))]", "rows of no box"),
        ("return [(0, 0)]", "below 1"),
        ("return [(1.5, 0)]", "pairs"),
        ("return None", "pairs"),
        ("return []", "both followed"),
        ("print('hello')", "prints"),
        ("corners_px[0] = 0", "read-only"),
        ("return [(2 * self.pictures + row, row) for row in range(len(corners_px))]", "keeps"),
    ],
)
def test_the_contract_refuses(body: str, message: str) -> None:
    made: dict[str, Any] = {}
    exec(source(body), made)  # noqa: S102 - of this test
    with pytest.raises((AssertionError, ValueError), match=message):
        check_tracker(made["Plugin"])


def test_the_contract_refuses_another_version() -> None:
    class Old:
        caris_interface = 0

    with pytest.raises(AssertionError, match="must be 1, and is 0"):
        check_tracker(Old)  # type: ignore[arg-type]


@pytest.mark.logs("the plug-in bad of lab-bad failed")
@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("raise ValueError('no idea')", "it raised ValueError: no idea"),
        ("raise SystemExit(3)", "it raised SystemExit: 3"),
        ("print('x' + chr(27)); return []", "it printed “x\\x1b”"),
        ("return [(1, 7)]", "it returned rows of no box"),
        ("return [(float('nan'), 0)]", "it did not return pairs of a track number and a row"),
        ("corners_px[:] = 0", "it raised ValueError: assignment destination is read-only"),
        ("frame.image_bgr[:] = 0", "it raised ValueError: assignment destination is read-only"),
    ],
)
def test_a_failure_is_named_and_another_tracker_can_take_over(
    body: str, reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "trackers", "bad", source(body), monkeypatch)
    monkeypatch.delitem(sys.modules, "lab_bad", raising=False)
    calls: list[PluginCall] = []
    tracker = PersonTracker((0,), tracker="bad", notify=calls.append)
    with pytest.raises(PluginError) as caught:
        tracker.track(people(2), PICTURE, look(0))
    assert (caught.value.reason, caught.value.plugin.package) == (reason, "lab-bad 2.1")
    called = [None if call.plugin is None else call.plugin.name for call in calls]
    assert called == ["bad", None, "bad", None], "the import, and one picture"
    tracker.use("own")
    for number in range(6):
        boxes = tracker.track(people(2), PICTURE, look(number))
    assert {box.detection for box in boxes} == {0, 1}


def test_numbers_are_unique_across_cameras_and_after_a_change(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    body = "return [(row + 1, row) for row in range(len(corners_px))]"
    install(tmp_path, "trackers", "each-row", source(body), monkeypatch)
    tracker = PersonTracker((0,), tracker="each-row")
    seen = [box.track for camera in ("front", "back") for box in tracker.track(people(2), PICTURE, look(0, camera))]
    tracker.use("each-row")
    seen += [box.track for box in tracker.track(people(2), PICTURE, look(0))]
    assert sorted(seen) == [1, 2, 3, 4, 5, 6]


@pytest.mark.logs("the plug-in needy of lab-needy failed")
def test_another_interface_version_a_broken_import_and_a_missing_package_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "trackers", "later", "class Plugin:\n    caris_interface = 2\n", monkeypatch)
    install(tmp_path, "trackers", "needy", "import nothing_of_this_name", monkeypatch)
    for name, reason in {
        "later": "it is written for version 2 of the interface, and this program has version 1",
        "needy": "it raised ModuleNotFoundError: No module named 'nothing_of_this_name'",
        "absent": "it is not installed; installed are own, deepsort, bytetrack, botsort, later, needy",
    }.items():
        with pytest.raises(PluginError) as caught:
            PersonTracker((0,), tracker=name)
        assert str(caught.value) == reason


@pytest.mark.logs("own of lab-own is ignored")
def test_nobody_replaces_a_built_in_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "trackers", "own", "Plugin = None", monkeypatch)
    assert installed("trackers")["own"].is_built_in


@pytest.mark.logs("is ignored: it is no name", "cannot be read")
def test_a_damaged_package_hides_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("steady", "empty", "a name"):
        install(tmp_path, "trackers", name, "class Plugin: caris_interface = 1", monkeypatch)
    (tmp_path / "lab_empty-2.1.dist-info" / "METADATA").unlink()
    here = installed("trackers")
    assert here["steady"].package == "lab-steady 2.1"
    assert "empty" in here and "a name" not in here
