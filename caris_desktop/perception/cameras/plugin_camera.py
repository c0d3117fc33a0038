"""Cameras of plug-ins of the group ``caris_desktop.cameras``, each in a process of its own."""

import functools
from collections.abc import Callable
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.plugin_process import PluginProcess
from caris_desktop.domain.plugins import Plugin, PluginError, find
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.perception.cameras.camera_source import CameraError, CameraSwitchedOffError, ChosenCamera, Picture

OPENED_WITHIN_S, READ_WITHIN_S = 10.0, 5.0


class CameraPlugin(Protocol):
    """Camera: a class with the attribute ``caris_interface = 1``, called as ``Camera("TARGET")`` for the source
    ``plugin:NAME:TARGET``, and with an empty text for ``plugin:NAME``.

    A scenario names it as the source of a camera, a user by ``--camera``. One instance is made for each camera, in a
    process of its own, and called in its main thread. The process is not the window's, the robot link's or the
    recorder's, nor that which detects people: all of them get its pictures from the console. It has a minute to be
    imported, and ten seconds from its call to the first picture.

    OSError (also ConnectionError, TimeoutError) means that the camera is lost: the wizard reads the text, and another
    instance is made after one, two and five seconds, and so on. A camera that raises anything else, prints, is too
    slow, ends its process or returns anything but a picture is switched off until the console is started again, and the
    wizard is told its name; the other cameras go on. Log with :mod:`logging`.
    """

    caris_interface: ClassVar[int]

    def read(self) -> NDArray[np.uint8]:
        """Wait for the newest picture, at most five seconds: BGR, uint8, shape (height, width, 3).

        Each picture once: the console shows what comes, and asks again at once. 30 a second are good. The picture
        counts as taken when this returns.
        """
        ...


class PluginCamera:
    """Camera of a plug-in. ``target`` is ``NAME`` or ``NAME:TARGET``."""

    fps: float | None = None

    def __init__(self, chosen: ChosenCamera) -> None:
        """Raises CameraError, also for a plug-in that was switched off."""
        self._name = chosen.name
        name, _, target = chosen.target.partition(":")
        try:
            plugin = find("cameras", name)
            self._process = PluginProcess(plugin, functools.partial(_host, plugin, target))
        except PluginError as error:
            raise _switched_off(error) from error
        try:
            self._first: Picture | None = self._read(OPENED_WITHIN_S)
        except CameraError:
            self.close()
            raise
        self.height_px, self.width_px = self._first.image.shape[:2]

    def read(self) -> Picture | None:
        first, self._first = self._first, None
        return first or self._read(READ_WITHIN_S)

    def close(self) -> None:
        self._process.close()

    def _read(self, within_s: float) -> Picture:
        try:
            answer = self._process.ask(within_s=within_s)
        except PluginError as error:
            raise _switched_off(error) from error
        if isinstance(answer, OSError):
            raise CameraError(
                localized(QT_TR_NOOP("The camera {name} is lost: {why}."), name=self._name, why=answer),
                QT_TR_NOOP("Check the camera, and its cable or network."),
            )
        image, taken_ns = answer
        return Picture(image, taken_ns=taken_ns)


def _host(plugin: Plugin, target: str, make: Callable[[str], CameraPlugin]) -> Callable[..., Any]:
    """Host of a camera in its process: makes it with the first request, and answers with a picture or an OSError."""
    made: list[CameraPlugin] = []

    def answer(_report: object) -> tuple[NDArray[np.uint8], int] | OSError:
        try:
            if not made:
                made.append(make(target))
            image = made[0].read()
        except OSError as error:
            return error
        return checked_image(plugin, image), clock.now_ns()

    return answer


def checked_image(plugin: Plugin, image: object) -> NDArray[np.uint8]:
    """Picture that a camera returned. Raises PluginError."""
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
        raise PluginError(plugin, QT_TR_NOOP("it did not return a picture of shape (height, width, 3) in uint8"))
    return image


def _switched_off(error: PluginError) -> CameraSwitchedOffError:
    return CameraSwitchedOffError(
        localized(
            QT_TR_NOOP("The camera plug-in {name} ({package}) was switched off: {reason}."),
            name=error.plugin.name,
            package=error.plugin.package,
            reason=error.reason,
        ),
        QT_TR_NOOP("Update the plug-in, or choose another camera; the log has details."),
    )
