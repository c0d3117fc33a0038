"""Cameras connected to this computer: through OpenCV, and Luxonis OAK through depthai."""

import datetime
import logging
import os
import re
from pathlib import Path
from typing import Any

import numpy as np

from caris_desktop.domain.media_checks import fitted
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


class DeviceCamera:
    """Camera through OpenCV, by a number or a device path."""

    def __init__(self, chosen: ChosenCamera) -> None:
        import cv2

        target = chosen.target
        self._target = target
        self._has_delivered = False
        # A missing device is reported as a Problem; OpenCV would log each retry.
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        self._capture = cv2.VideoCapture(int(target) if target.isdecimal() else target)
        if not self._capture.isOpened():
            raise CameraError(
                localized(QT_TR_NOOP("Camera {target} cannot be opened."), target=target),
                QT_TR_NOOP(
                    "Check that the camera is plugged in, that no other program uses it, and that you have "
                    "permission to use cameras."
                ),
            )
        # Motion-JPEG, since uncompressed images of this size are slow over USB 2.
        self._capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
        self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, DEVICE_SIZE_PX[0])
        self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, DEVICE_SIZE_PX[1])
        self._capture.set(cv2.CAP_PROP_FPS, DEVICE_FPS)
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        self._moment = cv2.CAP_PROP_POS_MSEC
        self.width_px = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height_px = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        self.fps = float(self._capture.get(cv2.CAP_PROP_FPS)) or None

    def read(self) -> Picture | None:
        delivered, image = self._capture.read()
        if not delivered and not self._has_delivered:
            # Some drivers open a camera in use by another program, but deliver no image.
            raise CameraError(
                localized(QT_TR_NOOP("Camera {target} does not deliver any images."), target=self._target),
                QT_TR_NOOP(
                    "Close other programs that may be using the camera, such as a browser or a video call, and "
                    "check its cable."
                ),
            )
        if not delivered:
            raise CameraError(
                localized(QT_TR_NOOP("Camera {target} stopped delivering images."), target=self._target),
                QT_TR_NOOP("Check the camera cable."),
            )
        self._has_delivered = True
        # With Video4Linux this is the driver's capture time; with others, a different clock.
        return picture_of(image, device_ns=round(self._capture.get(self._moment) * 1e6))

    def close(self) -> None:
        self._capture.release()


_V4L = Path("/sys/class/video4linux")


def found_cameras(v4l: Path = _V4L) -> list[str]:
    """Discovery of cameras connected to this computer.

    Selection strings, with names where known: ``0 (HD Webcam)``, ``oak:14442C10D13EABCE00``.
    """
    found = {}
    for folder in v4l.glob("video*"):
        # A camera has several nodes; the one with index 0 delivers images.
        number = re.fullmatch(r"video(\d+)", folder.name)
        try:
            if number is not None and (folder / "index").read_text().strip() == "0":
                found[int(number[1])] = (folder / "name").read_text().strip()
        except OSError:
            continue
    devices = [f"{number} ({name})" if name else str(number) for number, name in sorted(found.items())]
    return [*devices, *(f"oak:{device}" for device in oak_devices())]


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
            if len(device.getConnectedCameras()) >= 3:
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
