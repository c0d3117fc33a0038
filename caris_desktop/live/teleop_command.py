"""Teleoperation command for base and head, and merging of several sources. Plain functions."""

from collections.abc import Iterable
from dataclasses import replace

from caris_desktop.domain.value_class import Value


class TeleopCommand(Value):
    """Components of -1..1: forward, left and counter-clockwise positive for the base, pan left and tilt down for the
    head.
    """

    forward: float = 0.0
    left: float = 0.0
    turn: float = 0.0
    pan: float = 0.0
    tilt: float = 0.0

    @property
    def moving(self) -> bool:
        return self != AT_REST

    @property
    def base(self) -> tuple[float, float, float]:
        """(forward, left, turn)."""
        return self.forward, self.left, self.turn

    @property
    def head(self) -> tuple[float, float]:
        """(pan, tilt)."""
        return self.pan, self.tilt

    def limited_to(self, *, sideways: bool, head: bool) -> "TeleopCommand":
        """Without motions that the robot lacks."""
        limited = self if sideways else replace(self, left=0.0)
        return limited if head else replace(limited, pan=0.0, tilt=0.0)


AT_REST = TeleopCommand()


def merged(wishes: Iterable[TeleopCommand]) -> TeleopCommand:
    """Sum of commands, clamped to full speed; opposite ones cancel."""
    forward = left = turn = pan = tilt = 0.0
    for command in wishes:
        forward, left, turn = forward + command.forward, left + command.left, turn + command.turn
        pan, tilt = pan + command.pan, tilt + command.tilt
    return TeleopCommand(*(max(-1.0, min(1.0, total)) for total in (forward, left, turn, pan, tilt)))
