"""Local camera device, through OpenCV."""

import re
from pathlib import Path

from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.perception.cameras.camera_source import (
    DEVICE_FPS,
    DEVICE_SIZE_PX,
    CameraError,
    ChosenCamera,
    Picture,
    picture_of,
)
from caris_desktop.perception.cameras.oak_camera import oak_devices


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
    return [*_devices(v4l), *(f"oak:{device}" for device in oak_devices())]


def _devices(v4l: Path) -> list[str]:
    """Video4Linux devices. A camera has several nodes; the one with index 0 delivers images."""
    found = {}
    for folder in v4l.glob("video*"):
        number = re.fullmatch(r"video(\d+)", folder.name)
        try:
            if number is not None and (folder / "index").read_text().strip() == "0":
                found[int(number[1])] = (folder / "name").read_text().strip()
        except OSError:
            continue
    return [f"{number} ({name})" if name else str(number) for number, name in sorted(found.items())]
