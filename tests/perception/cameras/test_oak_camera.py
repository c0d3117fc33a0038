"""OAK cameras with depthai's replay of a video, and doubles of the few calls that need a device."""

import datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from caris_desktop.perception.cameras.camera_source import CameraError, ChosenCamera
from caris_desktop.perception.cameras.device_camera import OakCamera, oak_devices
from tests.perception.cameras.running_camera import PICTURES

depthai = pytest.importorskip("depthai")


class DepthOutput:
    """Depth of 2 m on the left and 5 m on the right, with each frame."""

    def __init__(self) -> None:
        self.moment = datetime.timedelta(0)

    def createOutputQueue(self, **_size: object) -> "DepthOutput":
        return self

    def tryGet(self) -> "DepthOutput":
        return self

    def getTimestamp(self) -> datetime.timedelta:
        return self.moment

    def getFrame(self) -> Any:
        return np.hstack((np.full((180, 160), 2000, np.uint16), np.full((180, 160), 5000, np.uint16)))


class ReplayedDevice:
    """Double of device, pipeline and nodes; ``eyes`` is the number of cameras."""

    def __init__(self, video: Path, *, eyes: int = 1) -> None:
        self.asked: list[Any] = []
        self.eyes = eyes
        self.depth = DepthOutput()
        self.left = self.right = self.inputAlignTo = object()
        self.pipeline = depthai.Pipeline(False)
        self.replay = self.pipeline.create(depthai.node.ReplayVideo)
        self.replay.setReplayVideoFile(video)
        self.replay.setOutFrameType(depthai.ImgFrame.Type.BGR888i)
        self.replay.setLoop(False)

    def getConnectedCameras(self) -> list[int]:
        return list(range(self.eyes))

    def create(self, node: Any) -> "ReplayedDevice":
        self.asked.append(node)
        return self

    def build(self, *_socket: Any) -> "ReplayedDevice":
        return self

    def requestOutput(self, size: tuple[int, int], *, fps: float, type: Any = None) -> Any:  # noqa: A002 - name in depthai
        self.asked.append((size, fps))
        return LinkedOutput(self.replay.out)

    def setOutputSize(self, width: int, height: int) -> None:
        self.asked.append((width, height))

    def start(self) -> None:
        self.pipeline.start()

    def stop(self) -> None:
        self.pipeline.stop()


class LinkedOutput:
    def __init__(self, output: Any) -> None:
        self.createOutputQueue = output.createOutputQueue

    def link(self, _to: Any) -> None:
        pass


def opened(video: Path, monkeypatch: pytest.MonkeyPatch, *, eyes: int) -> tuple[OakCamera, ReplayedDevice]:
    device = ReplayedDevice(video, eyes=eyes)
    monkeypatch.setattr(depthai, "Device", lambda _id: device)
    monkeypatch.setattr(depthai, "Pipeline", lambda _device: device)
    return OakCamera(ChosenCamera("oak", "14442C10D13EABCE00", "oak")), device


def test_it_delivers_until_it_ends(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    camera, device = opened(video, monkeypatch, eyes=1)
    picture = camera.read()
    assert picture is not None
    assert picture.image.shape == (240, 320, 3)
    assert picture.depth_mm is None
    with pytest.raises(CameraError, match="stopped"):
        for _ in range(PICTURES + 1):
            camera.read()
    camera.close()
    assert device.asked == [depthai.node.Camera, ((1280, 720), 30)]


def test_with_two_more_eyes_it_reports_depth_as_the_colour_camera_sees_it(
    video: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("caris_desktop.perception.cameras.device_camera._SAME_MOMENT", datetime.timedelta.max)
    camera, device = opened(video, monkeypatch, eyes=3)
    picture = camera.read()
    camera.close()
    assert picture is not None and picture.depth_mm is not None
    assert (picture.depth_mm.shape, picture.depth_mm[90, 10], picture.depth_mm[90, 300]) == ((180, 320), 2000, 5000)
    assert depthai.node.StereoDepth in device.asked


def test_a_missing_camera_is_reported() -> None:
    if oak_devices():
        pytest.skip("an OAK camera is attached")
    with pytest.raises(CameraError, match="No OAK"):
        OakCamera(ChosenCamera("oak", "", "oak"))
