"""Interfaces between packages, so that live robot, simulator and replay are interchangeable."""

from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.events import ProblemEnd, Severity
from caris_desktop.domain.link_commands import RobotCommand
from caris_desktop.domain.sensing import FrameRef


class FrameReader(Protocol):
    """Reader of the pixels of a :class:`FrameRef`."""

    def read(self, ref: FrameRef) -> NDArray[np.uint8] | None:
        """Copy of the frame (BGR, uint8, shape (height, width, 3)), or None if it was overwritten meanwhile.

        May be called from any thread and any process that attached to the ring.
        """


class FrameWriter(Protocol):
    """Publisher of camera frames to all readers on this machine."""

    def write(
        self, image_bgr: NDArray[np.uint8], *, stamp_ns: int, robot_stamp_ns: int | None, camera: str
    ) -> FrameRef:
        """Copy ``image_bgr`` (uint8, shape (height, width, 3)) into the ring; never blocks on readers."""


ValueSink = Callable[[Any], None]
"""Receiver of domain values. Called in the source's thread; must not block."""


class ReportProblem(Protocol):
    """Reporter of a :class:`Problem` to the wizard and the record."""

    def __call__(
        self, severity: Severity, what: str, meaning: str, advice: str, *, until: ProblemEnd = "", cause: str = ""
    ) -> None: ...


class RobotPort(Protocol):
    """Receiver of robot commands: the service that owns the links. In a replay, the gate refuses before it."""

    def send(self, command: RobotCommand) -> bool:
        """Pass a command on at once. False if impossible; nothing is ever queued."""
