"""Camera process entry point in a thread, and videos for it."""

import multiprocessing
import threading
import time
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import av
import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.sensing import CameraState, FrameRef
from caris_desktop.perception.cameras.camera_process import run_camera
from caris_desktop.perception.cameras.camera_source import CameraSource, ChosenCamera, parse_camera

FPS = 25
PICTURES = 12


class KeptFrames:
    """Frame writer that records the mean brightness of each frame."""

    def __init__(self) -> None:
        self.brightness: list[float] = []

    def write(
        self, image_bgr: NDArray[np.uint8], *, stamp_ns: int, robot_stamp_ns: int | None, camera: str
    ) -> FrameRef:
        assert image_bgr.dtype == np.uint8
        self.brightness.append(float(image_bgr.mean()))
        height_px, width_px = image_bgr.shape[:2]
        number = len(self.brightness)
        return FrameRef(stamp_ns, robot_stamp_ns, camera, "ring", 0, number, width_px, height_px)


class RunningCamera:
    """``run_camera`` in a thread, with its messages."""

    def __init__(
        self, source: str, *, open_one: Callable[[ChosenCamera], CameraSource] | None = None, name: str = ""
    ) -> None:
        self.frames = KeptFrames()
        self.connection, theirs = multiprocessing.Pipe()
        self.thread = threading.Thread(
            target=self._run, args=(theirs, parse_camera(source, name=name), open_one), daemon=True
        )
        self.received: list[Any] = []
        self.thread.start()

    def _run(
        self, connection: Connection, chosen: ChosenCamera, open_one: Callable[[ChosenCamera], CameraSource] | None
    ) -> None:
        run_camera(connection, chosen, self.frames, open_one=open_one)
        connection.close()

    def until(self, condition: Callable[[list[Any]], bool], *, within_s: float = 20.0) -> list[Any]:
        deadline_s = time.monotonic() + within_s
        while not condition(self.received):
            assert self.connection.poll(max(0.0, deadline_s - time.monotonic())), self.received[-3:]
            self.received.append(self.connection.recv())
        return self.received

    def states(self) -> list[str]:
        return [state.state for state in self.of(CameraState)]

    def of(self, kind: type[Any]) -> list[Any]:
        return [message for message in self.received if isinstance(message, kind)]

    def close(self) -> None:
        self.connection.close()
        self.thread.join(10.0)
        assert not self.thread.is_alive()


def has(kind: type[Any], count: int = 1) -> Callable[[list[Any]], bool]:
    return lambda received: sum(isinstance(message, kind) for message in received) >= count


def has_state(state: str, count: int = 1) -> Callable[[list[Any]], bool]:
    return lambda received: (
        [message.state for message in received if isinstance(message, CameraState)].count(state) >= count
    )


def write_video(path: Path, *, size_px: tuple[int, int] = (320, 240), fps: int = FPS) -> None:
    """Write a video in which each frame is a little brighter than the previous one."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=fps)
        stream.width, stream.height = size_px
        for number in range(PICTURES):
            image = np.full((size_px[1], size_px[0], 3), 20 + 15 * number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode(None))
