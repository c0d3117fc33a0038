"""Simulated camera, in the process that the console starts."""

import queue
from dataclasses import replace
from pathlib import Path
from typing import Any

import psutil

from caris_desktop.app import composition
from caris_desktop.domain.sensing import CameraState, FrameRef
from caris_desktop.live.child_process import ChildProcess, RingToWrite
from caris_desktop.live.frame_ring import FrameRing, FrameRings
from caris_desktop.scenario.scenario_model import PanelLeaf, Scenario


def test_it_shows_simulated_rooms_in_a_process_that_says_which_camera_it_is(tmp_path: Path) -> None:
    parts = composition.parts(study=composition.open_study(tmp_path / "study"), cameras=["simulated"])
    (camera,) = parts.cameras(Scenario("Test", PanelLeaf("video"))).own
    came: queue.SimpleQueue[Any] = queue.SimpleQueue()
    ring = FrameRing.create()
    readers = FrameRings([], attach=True)
    body = replace(camera.body, arguments=(*camera.body.arguments, RingToWrite(ring.name)))
    child = ChildProcess(body, on_message=lambda value, _raw: came.put(value))
    try:
        child.start()
        values = [came.get(timeout=40.0) for _ in range(6)]
        assert [value.state for value in values if isinstance(value, CameraState)] == ["connecting", "connected"]
        frames = [value for value in values if isinstance(value, FrameRef)]
        assert [(ref.camera, ref.width_px, ref.height_px) for ref in frames] == [("simulated", 640, 480)] * 4
        assert all(ref.taken_ns is not None and ref.taken_ns <= ref.stamp_ns for ref in frames)
        image_bgr = readers.read(frames[-1])
        assert image_bgr is not None and image_bgr.std() > 20, "rooms, and not one colour"
        assert psutil.Process(child.pid).cmdline()[0].startswith("caris: camera simulated")
    finally:
        child.stop(grace_s=5.0)
        readers.close()
        ring.close()
