"""Poses and velocities on the floor plane (REP 103: x forward, y left, counter-clockwise positive)."""

import math

from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class Pose2D:
    """Position and heading; the frame of reference is in the name of whatever holds it."""

    x_m: float
    y_m: float
    heading_rad: float

    def __matmul__(self, inner: "Pose2D") -> "Pose2D":
        """Compose: ``map_from_robot @ pose_in_robot`` is the pose in the map."""
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return Pose2D(
            self.x_m + cos * inner.x_m - sin * inner.y_m,
            self.y_m + sin * inner.x_m + cos * inner.y_m,
            wrap_angle(self.heading_rad + inner.heading_rad),
        )

    def inverse(self) -> "Pose2D":
        cos, sin = math.cos(self.heading_rad), math.sin(self.heading_rad)
        return Pose2D(
            -(cos * self.x_m + sin * self.y_m),
            -(-sin * self.x_m + cos * self.y_m),
            wrap_angle(-self.heading_rad),
        )


@dataclass(frozen=True, slots=True)
class Twist2D:
    """Velocity of the base in its own frame."""

    forward_mps: float = 0.0
    left_mps: float = 0.0
    turn_radps: float = 0.0

    @property
    def moving(self) -> bool:
        return self != ZERO_TWIST


ZERO_TWIST = Twist2D()


def wrap_angle(angle_rad: float) -> float:
    """The same angle in (-pi, pi]."""
    wrapped = math.remainder(angle_rad, 2.0 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped
