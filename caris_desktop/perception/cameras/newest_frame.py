"""Newest frame of one camera for several clients, each at its own rate."""

import asyncio
import logging
from collections.abc import Callable, Coroutine
from dataclasses import field
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.picture_checks import PictureError, fitted, jpeg_of
from caris_desktop.domain.value_class import dataclass
from caris_desktop.perception.cameras.camera_source import CameraError, CameraSource, ChosenCamera

_JPEG_QUALITY = 80
_RETRY_AFTER_S = (1.0, 2.0, 5.0)
_log = logging.getLogger(__name__)
T = TypeVar("T")


@dataclass(slots=True, eq=False)
class Frame:
    """Frame as uint8 BGR. ``captured_ns`` is this computer's monotonic clock."""

    image_bgr: NDArray[np.uint8]
    captured_ns: int
    sequence: int
    _jpeg: "asyncio.Task[bytes] | None" = field(default=None, init=False)

    async def jpeg(self) -> bytes:
        """JPEG, encoded once for all clients."""
        if self._jpeg is None:
            self._jpeg = asyncio.create_task(asyncio.to_thread(jpeg_of, self.image_bgr, quality=_JPEG_QUALITY))
        return await asyncio.shield(self._jpeg)


class NewestFrame:
    """Reads a camera while ``run`` runs, and reconnects."""

    def __init__(self, chosen: ChosenCamera, open_one: Callable[[ChosenCamera], CameraSource]) -> None:
        self._chosen = chosen
        self._open = open_one
        self._frame: Frame | None = None
        self._came = asyncio.Event()
        self.state = "connecting"
        self.detail = ""

    @property
    def sequence(self) -> int:
        """Number of images so far."""
        return 0 if self._frame is None else self._frame.sequence

    async def after(self, sequence: int) -> Frame:
        """Wait for a frame newer than ``sequence``."""
        while self._frame is None or self._frame.sequence <= sequence:
            await self._came.wait()
        return self._frame

    async def run(self) -> None:
        """Read until cancelled. A file is looped at its own rate."""
        failures = 0
        while True:
            camera: CameraSource | None = None
            try:
                camera = await _finished(asyncio.to_thread(self._open, self._chosen))
                await self._read(camera)
                failures = 0
            except CameraError as error:
                if (self.state, self.detail) != ("lost", str(error)):
                    _log.warning("%s %s", error, error.advice)
                self.state, self.detail = "lost", str(error)
                await asyncio.sleep(_RETRY_AFTER_S[min(failures, len(_RETRY_AFTER_S) - 1)])
                failures += 1
            finally:
                if camera is not None:
                    camera.close()

    async def _read(self, camera: CameraSource) -> None:
        """Read until a recorded video ends. Raises CameraError."""
        began_ns = clock.now_ns()
        while True:
            try:
                picture = await _finished(asyncio.to_thread(camera.read))
                if picture is None:
                    return
                image_bgr = fitted(picture.image)
            except PictureError as error:
                _log.info("a picture %s", error)
                continue
            now_ns = clock.now_ns()
            if picture.due_s is not None:
                await asyncio.sleep(max(0.0, picture.due_s - (now_ns - began_ns) / 1e9))
                now_ns = clock.now_ns()
            if self.state != "connected":
                _log.warning("%s delivers.", self._chosen.name)
                self.state, self.detail = "connected", ""
            captured_ns = now_ns if picture.taken_ns is None else picture.taken_ns
            self._frame = Frame(image_bgr, captured_ns, self.sequence + 1)
            self._came.set()
            self._came = asyncio.Event()


async def _finished(work: Coroutine[Any, Any, T]) -> T:
    """Await a thread's result even when cancelled: a camera must not be closed while it is read."""
    task = asyncio.ensure_future(work)
    try:
        return await asyncio.shield(task)
    except asyncio.CancelledError:
        await asyncio.wait([task])
        raise
