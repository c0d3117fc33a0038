"""Camera of the simulated robot, in its own process, so that rendering never delays a velocity command."""

import asyncio
import contextlib
import logging
import multiprocessing
import os
from multiprocessing.connection import Connection

import numpy as np
from numpy.typing import NDArray

from caris_desktop.simulator.robot_simulation import HEIGHT_PX, WIDTH_PX, View

logger = logging.getLogger(__name__)

JPEG_QUALITY = 82
_NICENESS = 5


class CameraProcess:
    """Requests images from a process, which starts with the first request and ends with this process."""

    def __init__(self) -> None:
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None
        self._one_at_a_time = asyncio.Lock()

    async def picture(self, view: View | None) -> bytes:
        """JPEG of ``view``, or a black one. Raises EOFError when the child process died."""
        async with self._one_at_a_time:
            return await asyncio.to_thread(self._ask, view)

    def close(self) -> None:
        """End the camera process."""
        if self._pipe is not None:
            self._pipe.close()
        if self._process is not None:
            self._process.join(1.0)
            if self._process.is_alive():
                self._process.kill()

    def _ask(self, view: View | None) -> bytes:
        if self._pipe is None:
            context = multiprocessing.get_context("spawn")
            self._pipe, child = context.Pipe()
            self._process = context.Process(target=_draw_forever, args=(child,), name="camera", daemon=True)
            self._process.start()
            # without this copy the pipe's end closes with the process, so that its death is noticed
            child.close()
        self._pipe.send(view)
        return self._pipe.recv_bytes()


def _draw_forever(pipe: Connection) -> None:
    import signal

    import cv2

    from caris_desktop.domain.process_settings import title_process
    from caris_desktop.simulator.picture import Painter

    title_process("simulated camera")
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends this process by closing the pipe
    cv2.setNumThreads(1)
    if hasattr(os, "nice"):
        os.nice(_NICENESS)
    painter = Painter()
    black: NDArray[np.uint8] = np.zeros((HEIGHT_PX, WIDTH_PX, 3), dtype=np.uint8)
    with contextlib.suppress(EOFError, ConnectionError, BrokenPipeError):
        while True:
            view: View | None = pipe.recv()
            picture = black if view is None else painter.paint(view)
            _, content = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            pipe.send_bytes(content.tobytes())
