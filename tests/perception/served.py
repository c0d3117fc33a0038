"""Perception server in a thread of the test, with a detector of bright areas."""

import asyncio
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.perception.backends.remote_detector import serving
from caris_desktop.perception.detector import Detections

TOKEN = "a token of enough characters"
POINTS = np.arange(51.0).reshape(1, 17, 3)


class Bright:
    """Detector of one person in a bright image, and of a chair in all of it."""

    label = "bright, torch on CUDA"
    class_names = ("chair", "person")

    def __init__(self) -> None:
        self.sizes: list[tuple[int, ...]] = []
        self.confidences = (0.8, 0.15)

    def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
        self.sizes.append(image_bgr.shape)
        height, width = image_bgr.shape[:2]
        rows, columns = np.nonzero(image_bgr.max(axis=2) > 128)
        if not len(rows):
            raise ValueError("too dark")
        corners = [[columns.min(), rows.min(), columns.max() + 1, rows.max() + 1], [0, 0, width, height]]
        points = np.repeat(POINTS, 2, axis=0)
        return Detections(np.array(corners, float), np.array(self.confidences), np.array([1, 0]), points)


class Serving:
    """Server in a thread of the test; it can be stopped and restarted on the same port."""

    def __init__(self, token: str = "", tls: Any = None) -> None:
        self.detector = Bright()
        self.token, self.tls = token, tls
        self.notes: list[str] = []
        self.port = 0
        self._stop: asyncio.Event | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self.start()

    def start(self) -> None:
        started = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve(started)))
        self._thread.start()
        assert started.wait(20)

    async def _serve(self, started: threading.Event) -> None:
        self._loop, self._stop = asyncio.get_running_loop(), asyncio.Event()
        async with serving(
            self.detector,
            (1,),
            host="127.0.0.1",
            port=self.port,
            token=self.token,
            tls=self.tls,
            note=self.notes.append,
        ) as server:
            self.port = server.sockets[0].getsockname()[1]
            started.set()
            await self._stop.wait()

    def stop(self) -> None:
        if self._thread.is_alive():
            assert self._loop is not None
            assert self._stop is not None
            self._loop.call_soon_threadsafe(self._stop.set)
            self._thread.join()

    @property
    def address(self) -> str:
        return f"{'ws' if self.tls is None else 'wss'}://127.0.0.1:{self.port}"


def picture(height: int = 120, width: int = 160) -> NDArray[np.uint8]:
    image = np.zeros((height, width, 3), np.uint8)
    image[height // 4 : height // 2, width // 4 : width // 2] = 255
    return image
