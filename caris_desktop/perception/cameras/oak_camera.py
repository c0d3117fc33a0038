"""Luxonis OAK camera, through depthai."""

import datetime
import logging
import os
from typing import Any

import numpy as np

from caris_desktop.domain.picture_checks import fitted
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.perception.cameras.camera_source import (
    DEVICE_FPS,
    DEVICE_SIZE_PX,
    SILENCE_S,
    CameraError,
    ChosenCamera,
    Picture,
    picture_of,
)

_log = logging.getLogger(__name__)
_DEPTH_SIZE_PX = (320, 180)  # aspect ratio of the images, and enough for people
_DEPTH_FPS = 10
_SAME_MOMENT = datetime.timedelta(milliseconds=200)


def oak_devices() -> list[str]:
    """Ids of connected and network devices; empty if depthai is not installed."""
    # It would print that there is no USB here.
    os.environ.setdefault("DEPTHAI_LEVEL", "error")
    try:
        import depthai
    except ImportError:
        return []
    return [str(device.getDeviceId()) for device in depthai.Device.getAllAvailableDevices()]


class OakCamera:
    """Colour images, and depth if the device has the stereo cameras, through depthai 3.

    ``device_id`` is its id, name or address; empty: any device.
    """

    def __init__(self, chosen: ChosenCamera) -> None:
        device_id = chosen.target
        try:
            import depthai
        except ImportError as error:
            raise CameraError(
                QT_TR_NOOP("OAK cameras need the package depthai."), QT_TR_NOOP("Install it: pip install depthai")
            ) from error
        # Discovery is cheap; connecting to a missing device waits for twelve seconds.
        if not device_id and not depthai.Device.getAllAvailableDevices():
            raise CameraError(
                QT_TR_NOOP("No OAK camera was found."),
                QT_TR_NOOP("Check the camera cable, and that you have permission to use USB devices."),
            )
        self._depths: Any = None
        self._depth: Any = None
        try:
            device = depthai.Device(device_id) if device_id else depthai.Device()
            self._pipeline = depthai.Pipeline(device)
            camera = self._pipeline.create(depthai.node.Camera).build()
            output = camera.requestOutput(DEVICE_SIZE_PX, type=depthai.ImgFrame.Type.BGR888i, fps=DEVICE_FPS)
            # One slot that the newest image overwrites: queued images would be shown late.
            self._pictures = output.createOutputQueue(maxSize=1, blocking=False)
            if _sees_depth(device):
                self._depths = self._depth_output(depthai, output).createOutputQueue(maxSize=1, blocking=False)
            self._pipeline.start()
        except RuntimeError as error:
            raise CameraError(
                localized(QT_TR_NOOP("The OAK camera {name} cannot be opened."), name=device_id)
                if device_id
                else QT_TR_NOOP("The OAK camera cannot be opened."),
                QT_TR_NOOP("Check the camera cable, and that no other program uses the camera."),
            ) from error
        self.width_px, self.height_px = DEVICE_SIZE_PX
        self.fps: float | None = float(DEVICE_FPS)

    def _depth_output(self, depthai: Any, colour: Any) -> Any:
        """Depth aligned to the colour camera."""
        stereo = self._pipeline.create(depthai.node.StereoDepth)
        sockets = (depthai.CameraBoardSocket.CAM_B, depthai.CameraBoardSocket.CAM_C)
        for socket, eye in zip(sockets, (stereo.left, stereo.right), strict=True):
            camera = self._pipeline.create(depthai.node.Camera).build(socket)
            camera.requestOutput((640, 400), fps=_DEPTH_FPS).link(eye)
        colour.link(stereo.inputAlignTo)
        stereo.setOutputSize(*_DEPTH_SIZE_PX)
        return stereo.depth

    def read(self) -> Picture | None:
        import depthai

        try:
            frame: Any = self._pictures.get(datetime.timedelta(seconds=SILENCE_S))
            if self._depths is not None:
                self._depth = self._depths.tryGet() or self._depth
        except (RuntimeError, depthai.MessageQueue.QueueException) as error:
            raise self._lost() from error
        if frame is None:
            raise self._lost()
        depth_mm = None
        if self._depth is not None and abs(self._depth.getTimestamp() - frame.getTimestamp()) <= _SAME_MOMENT:
            depth_mm = np.asarray(self._depth.getFrame(), np.uint16)
            self._depth = None  # use each depth image once
        device_ns = round(frame.getTimestamp().total_seconds() * 1e9)  # depthai synchronises its clock with ours
        return picture_of(fitted(frame.getCvFrame()), device_ns=device_ns, depth_mm=depth_mm)

    def close(self) -> None:
        try:
            self._pipeline.stop()
        except RuntimeError:
            _log.info("the OAK camera was gone before it was closed", exc_info=True)

    def _lost(self) -> CameraError:
        return CameraError(
            QT_TR_NOOP("The OAK camera stopped delivering images."), QT_TR_NOOP("Check the camera cable.")
        )


def _sees_depth(device: Any) -> bool:
    return len(device.getConnectedCameras()) >= 3
