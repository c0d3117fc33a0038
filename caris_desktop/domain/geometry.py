"""Poses and velocities, on the floor plane and in space (REP 103: x forward, y left, z up)."""

import math

from caris_desktop.domain.value_class import Value


class Pose2D(Value):
    """Position and heading; the name of the holding field gives the frame of reference."""

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
            -(cos * self.x_m + sin * self.y_m), -(-sin * self.x_m + cos * self.y_m), wrap_angle(-self.heading_rad)
        )


class Pose3D(Value):
    """Position and rotation in space; the rotation is a unit quaternion."""

    x_m: float
    y_m: float
    z_m: float
    qx: float
    qy: float
    qz: float
    qw: float

    @classmethod
    def on_floor(cls, pose: Pose2D) -> "Pose3D":
        """Same pose with the z axis upwards."""
        half_rad = pose.heading_rad / 2.0
        return cls(pose.x_m, pose.y_m, 0.0, 0.0, 0.0, math.sin(half_rad), math.cos(half_rad))

    @property
    def heading_rad(self) -> float:
        """Direction of the x axis, seen from above."""
        x, y, z, w = self.qx, self.qy, self.qz, self.qw
        return wrap_angle(math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))

    @property
    def floor(self) -> Pose2D:
        """Pose seen from above."""
        return Pose2D(self.x_m, self.y_m, self.heading_rad)

    @property
    def tilt_rad(self) -> float:
        """Angle between the z axes of this frame and its parent: 0 upright, pi upside down."""
        return 2.0 * math.atan2(math.hypot(self.qx, self.qy), math.hypot(self.qz, self.qw))

    def __matmul__(self, inner: "Pose3D") -> "Pose3D":
        """Compose, as :meth:`Pose2D.__matmul__`."""
        ax, ay, az, aw = self.qx, self.qy, self.qz, self.qw
        bx, by, bz, bw = inner.qx, inner.qy, inner.qz, inner.qw
        x_m, y_m, z_m = self.rotated(inner.x_m, inner.y_m, inner.z_m)
        return Pose3D(
            self.x_m + x_m,
            self.y_m + y_m,
            self.z_m + z_m,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        )

    def inverse(self) -> "Pose3D":
        back = Pose3D(0.0, 0.0, 0.0, -self.qx, -self.qy, -self.qz, self.qw)
        x_m, y_m, z_m = back.rotated(-self.x_m, -self.y_m, -self.z_m)
        return Pose3D(x_m, y_m, z_m, back.qx, back.qy, back.qz, back.qw)

    def towards(self, other: "Pose3D", share: float) -> "Pose3D":
        """Interpolate to ``other`` by ``share`` as tf2 does: positions linearly, rotations by the shorter arc. Above 1
        it extrapolates.
        """
        dot = self.qx * other.qx + self.qy * other.qy + self.qz * other.qz + self.qw * other.qw
        sign = -1.0 if dot < 0.0 else 1.0
        angle_rad = math.acos(min(abs(dot), 1.0))
        if angle_rad < 1e-6:
            near, far = 1.0 - share, share * sign
        else:
            near = math.sin((1.0 - share) * angle_rad) / math.sin(angle_rad)
            far = sign * math.sin(share * angle_rad) / math.sin(angle_rad)
        return Pose3D(
            self.x_m + share * (other.x_m - self.x_m),
            self.y_m + share * (other.y_m - self.y_m),
            self.z_m + share * (other.z_m - self.z_m),
            near * self.qx + far * other.qx,
            near * self.qy + far * other.qy,
            near * self.qz + far * other.qz,
            near * self.qw + far * other.qw,
        )

    def rotated(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """Direction of this frame in its parent."""
        qx, qy, qz, qw = self.qx, self.qy, self.qz, self.qw
        # v + 2 q x (q x v + w v)
        tx, ty, tz = qy * z - qz * y + qw * x, qz * x - qx * z + qw * y, qx * y - qy * x + qw * z
        return x + 2.0 * (qy * tz - qz * ty), y + 2.0 * (qz * tx - qx * tz), z + 2.0 * (qx * ty - qy * tx)


class Twist2D(Value):
    """Velocity of the base in its own frame."""

    forward_mps: float = 0.0
    left_mps: float = 0.0
    turn_radps: float = 0.0

    @property
    def moving(self) -> bool:
        return self != ZERO_TWIST


ZERO_TWIST = Twist2D()
_MOVES_MPS, _TURNS_RADPS = 0.02, 0.05


def moves(measured: Twist2D) -> bool:
    """Whether a base with this measured velocity moves: at rest an inertial sensor measures up to 0.01 m/s."""
    speed_mps = math.hypot(measured.forward_mps, measured.left_mps)
    return speed_mps > _MOVES_MPS or abs(measured.turn_radps) > _TURNS_RADPS


def moved_by(twist: Twist2D, duration_s: float) -> Pose2D:
    """Pose after driving with ``twist`` for that long, in the frame of the start."""
    turned = twist.turn_radps * duration_s
    if abs(turned) < 1e-6:
        ahead, aside = duration_s, turned * duration_s / 2.0
    else:
        ahead, aside = math.sin(turned) / twist.turn_radps, (1.0 - math.cos(turned)) / twist.turn_radps
    return Pose2D(
        twist.forward_mps * ahead - twist.left_mps * aside, twist.forward_mps * aside + twist.left_mps * ahead, turned
    )


def wrap_angle(angle_rad: float) -> float:
    """Same angle in (-pi, pi]."""
    wrapped = math.remainder(angle_rad, 2.0 * math.pi)
    return math.pi if wrapped == -math.pi else wrapped
