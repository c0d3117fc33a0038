"""Camera interface: an open source of images, and errors as user texts."""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

OPEN_TIMEOUT_S = 5.0
SILENCE_S = 3.0
SOUND_RATE_HZ = 16_000
"""A camera that sends nothing for so long is lost."""
_DRIVER_WITHIN_NS = 1_000_000_000
_DRIVER_UNCERTAINTY_NS = 2_000_000
DEVICE_SIZE_PX = (1280, 720)
DEVICE_FPS = 30


class CameraError(Exception):
    """The source cannot be opened or stopped delivering. Text and ``advice`` are for the wizard."""

    def __init__(self, what: str, advice: str) -> None:
        super().__init__(what)
        self.advice = advice


def cannot_be_reached(name: str) -> CameraError:
    """Error for an unreachable network camera."""
    return CameraError(
        localized(QT_TR_NOOP("The camera at {name} cannot be reached."), name=name),
        QT_TR_NOOP("Check the camera's address and password, and that it is on the same network."),
    )


class Picture(Value, eq=False):
    """One frame as the camera delivers it: grey, BGR or BGRA, of 8 or 16 bits.

    ``due_s`` is its time from the start of a recorded video. ``taken_ns`` is the capture in session time within
    ``taken_uncertainty_ns``; None if unknown. ``depth_mm`` is uint16, shape (rows, columns): the same view in its own
    resolution, 0 if unknown; None without a depth camera.
    """

    image: NDArray[Any]
    due_s: float | None = None
    taken_ns: int | None = None
    taken_uncertainty_ns: int | None = None
    depth_mm: NDArray[np.uint16] | None = None


def picture_of(image: NDArray[Any], *, device_ns: int, depth_mm: NDArray[np.uint16] | None = None) -> Picture:
    """Picture with the driver's time, if that is in session time, as on Linux."""
    ago_ns = clock.now_ns() - device_ns
    if not 0 <= ago_ns <= _DRIVER_WITHIN_NS:
        return Picture(image, depth_mm=depth_mm)
    return Picture(image, taken_ns=device_ns, taken_uncertainty_ns=_DRIVER_UNCERTAINTY_NS, depth_mm=depth_mm)


class CameraSource(Protocol):
    """Open camera. For one thread. Another kind of camera needs a class like this, a keyword in ``chosen_camera.py``
    and a case in ``open_camera.py``.
    """

    width_px: int
    height_px: int
    fps: float | None  # None if unknown

    def read(self) -> Picture | None:
        """Wait for the newest image; None at the end of a recorded video.

        Raises CameraError if the camera is lost, and PictureError if only this image is unusable.
        """

    def close(self) -> None:
        """Close the camera; called once in any state."""


@runtime_checkable
class CameraWithMicrophone(Protocol):
    """Camera with a microphone. ``on_sound`` gets the session time of the first sample and the samples, int16, shape
    (samples, 1), at ``SOUND_RATE_HZ``, in the thread that waits for an image.
    """

    on_sound: Callable[[int, NDArray[np.int16]], None]
