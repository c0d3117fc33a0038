"""Camera sources of this computer, and the process body that feeds their frames into the frame ring."""

from dataclasses import dataclass
from multiprocessing.connection import Connection

from caris_desktop.domain.ports import FrameWriter


@dataclass(frozen=True, slots=True)
class CameraReady:
    """The source delivers. Sent again after each successful retry. ``fps`` is None where the source does not tell."""

    stamp_ns: int
    camera: str
    width_px: int
    height_px: int
    fps: float | None


@dataclass(frozen=True, slots=True)
class CameraEnded:
    """A video file played to its end; the process ends after sending this."""

    stamp_ns: int
    camera: str
    frames: int


def run_camera(connection: Connection, source: str, frames: FrameWriter) -> None:
    """Sends ``FrameRef`` per frame, and ``CameraReady``, ``Problem``, ``CameraEnded``. Ends on EOF or any message."""
