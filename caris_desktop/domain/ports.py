"""Interfaces that rooms offer one another, so that live robot, simulator and replay can stand in for each other."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.commands import RobotCommand
from caris_desktop.domain.events import ProblemEnd, Severity
from caris_desktop.domain.sensing import FrameRef


class FrameReader(Protocol):
    """Gives the pixels that a :class:`FrameRef` speaks of."""

    def read(self, ref: FrameRef) -> NDArray[np.uint8] | None:
        """A copy of the frame (BGR, uint8, shape (height, width, 3)), or None when it was overwritten meanwhile.

        May be called from any thread and any process that attached to the ring.
        """


class FrameWriter(Protocol):
    """Publishes camera frames to every reader on this machine."""

    def write(
        self, image_bgr: NDArray[np.uint8], *, stamp_ns: int, robot_stamp_ns: int | None, camera: str
    ) -> FrameRef:
        """Copy ``image_bgr`` (uint8, shape (height, width, 3)) into the ring; never blocks on readers."""


class ValueSink(Protocol):
    """Takes domain values as they happen. Called from the thread that the source lives in; must not block."""

    def __call__(self, value: Any) -> None: ...


class TellProblem(Protocol):
    """Tells the wizard, and the record, what a :class:`Problem` holds."""

    def __call__(
        self, severity: Severity, what: str, meaning: str, advice: str, *, until: ProblemEnd = "", cause: str = ""
    ) -> None: ...


class RobotPort(Protocol):
    """What takes commands to the robot: the service that keeps the links. In a replay the gate refuses before that."""

    def send(self, command: RobotCommand) -> bool:
        """Hand a command over at once. False when it could not be handed over; nothing is ever queued."""
