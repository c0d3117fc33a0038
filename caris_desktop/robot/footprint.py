"""Robot footprint, and its time to contact with points along an arc. Plain geometry."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.geometry import Pose2D, Twist2D, moved_by
from caris_desktop.robot.profile_model import RobotProfile

Array = NDArray[np.float64]

# A rotation that shifts the outline by less than a thousandth of the path counts as straight.
_STRAIGHT = 1e-3
# Maximum sine of the angle at which sliding along the outline does not count as going deeper.
_SLIDING = 0.05


class Footprint:
    """Disc around the robot's origin, or a convex polygon (other outlines become their hull, which is safe).

    Points are float64, shape (n, 2), in the robot frame. A margin enlarges the footprint on all sides (polygon corners
    stay pointed).
    """

    def __init__(self, *, radius_m: float, corners_m: Sequence[tuple[float, float]] = ()) -> None:
        """Without ``corners_m`` it is the disc of ``radius_m``."""
        hull = convex_hull(corners_m) if corners_m else ()
        self._disc_m = radius_m if len(hull) < 3 else None
        if self._disc_m is not None:
            angles = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
            self._outline = radius_m * np.column_stack((np.cos(angles), np.sin(angles)))
            self.radius_m = radius_m
            return
        corners = np.array(hull)
        along = np.roll(corners, -1, axis=0) - corners
        lengths = np.hypot(along[:, 0], along[:, 1])
        self._tangents = along / lengths[:, None]
        self._normals = np.column_stack((self._tangents[:, 1], -self._tangents[:, 0]))
        self._offsets = (self._normals * corners).sum(axis=1)
        steps = [np.arange(0.0, 1.0, 1.0 / max(1, math.ceil(length / 0.15))) for length in lengths]
        self._outline = np.concatenate(
            [corner + step[:, None] * way for corner, way, step in zip(corners, along, steps, strict=True)]
        )
        self.radius_m = float(np.hypot(corners[:, 0], corners[:, 1]).max())
        """The farthest that any part of it is from the robot's origin."""

    @classmethod
    def of(cls, profile: RobotProfile) -> "Footprint":
        return cls(radius_m=profile.footprint_radius_m, corners_m=profile.footprint_m)

    @property
    def outline_m(self) -> Array:
        """Points along the outline, at most about 0.15 m apart."""
        return self._outline

    def gap_m(self, points: Array) -> Array:
        """Distance of each point outside the footprint, negative inside; shape (n,). Near a polygon's corner it is
        underestimated, as corners stay pointed when enlarged.
        """
        if self._disc_m is not None:
            return np.hypot(points[:, 0], points[:, 1]) - self._disc_m
        beyond: Array = (points @ self._normals.T - self._offsets).max(axis=1)
        return beyond

    def contact_s(self, points: Array, twist: Twist2D, *, margin_m: float = 0.0) -> Array:
        """Seconds until the footprint, moving with ``twist``, reaches each point; ``inf`` if never.

        A point inside counts as reached (0) if the motion goes deeper, and as never reached if it leaves or slides
        along: the robot must be able to move away from contact.
        """
        contact_s = np.full(len(points), np.inf)
        if not twist.moving or not len(points):
            return contact_s
        gap = self.gap_m(points)
        inside = gap < margin_m
        contact_s[inside] = np.where(self._goes_deeper(points[inside], twist), 0.0, np.inf)
        outside = ~inside
        speed_mps = math.hypot(twist.forward_mps, twist.left_mps)
        straight = abs(twist.turn_radps) * self.radius_m < _STRAIGHT * speed_mps
        reach_s = self._straight_contact_s if straight else self._arc_contact_s
        contact_s[outside] = reach_s(points[outside], twist, margin_m)
        return contact_s

    def outline_after(self, twist: Twist2D, times_s: Array) -> Array:
        """Outline after each of the times, in the present robot frame; shape (times * outline, 2)."""
        moved = [moved_by(twist, float(time_s)) for time_s in times_s]
        return np.concatenate([transformed(pose, self._outline) for pose in moved])

    def _goes_deeper(self, points: Array, twist: Twist2D) -> NDArray[np.bool_]:
        across_x = -(twist.forward_mps - twist.turn_radps * points[:, 1])
        across_y = -(twist.left_mps + twist.turn_radps * points[:, 0])
        if self._disc_m is not None:
            distance = np.maximum(np.hypot(points[:, 0], points[:, 1]), 1e-9)
            out_x, out_y = points[:, 0] / distance, points[:, 1] / distance
        else:
            nearest = (points @ self._normals.T - self._offsets).argmax(axis=1)
            out_x, out_y = self._normals[nearest, 0], self._normals[nearest, 1]
        deeper: NDArray[np.bool_] = out_x * across_x + out_y * across_y < -_SLIDING * np.hypot(across_x, across_y)
        return deeper

    def _straight_contact_s(self, points: Array, twist: Twist2D, margin_m: float) -> Array:
        # In the robot frame the points move towards the footprint.
        velocity = np.array([-twist.forward_mps, -twist.left_mps])
        if self._disc_m is not None:
            radius_m = self._disc_m + margin_m
            speed = float(np.hypot(*velocity))
            along = points @ velocity / speed
            beside_2 = (points**2).sum(axis=1) - along**2
            meets = (along < 0.0) & (beside_2 < radius_m**2)
            way_m = -along - np.sqrt(np.where(meets, radius_m**2 - beside_2, 0.0))
            return np.where(meets, np.maximum(way_m, 0.0) / speed, np.inf)
        approach = self._normals @ velocity
        room = self._offsets + margin_m - points @ self._normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = room / approach
        enter = np.where(approach < -1e-12, crossing, -np.inf).max(axis=1)
        leave = np.where(approach > 1e-12, crossing, np.inf).min(axis=1)
        beside = ((np.abs(approach) <= 1e-12) & (room < 0.0)).any(axis=1)
        return np.where((enter < leave) & (enter >= 0.0) & ~beside, enter, np.inf)

    def _arc_contact_s(self, points: Array, twist: Twist2D, margin_m: float) -> Array:
        # In the robot frame each point circles around the centre of rotation, against the turn.
        turn = twist.turn_radps
        centre = np.array([-twist.left_mps / turn, twist.forward_mps / turn])
        relative = points - centre
        radius = np.maximum(np.hypot(relative[:, 0], relative[:, 1]), 1e-9)
        angle = np.arctan2(relative[:, 1], relative[:, 0])
        if self._disc_m is not None:
            reach_m = self._disc_m + margin_m
            away = float(np.hypot(*centre))
            if away < 1e-9:
                return np.full(len(points), np.inf)
            cosine = (away**2 + radius**2 - reach_m**2) / (2.0 * away * radius)
            meets = np.abs(cosine) < 1.0
            half = np.arccos(np.clip(cosine, -1.0, 1.0))
            to_robot = math.atan2(-centre[1], -centre[0])
            travel = angle - (to_robot + half) if turn > 0.0 else (to_robot - half) - angle
            return np.where(meets, np.mod(travel, 2.0 * math.pi) / abs(turn), np.inf)
        near = (self._offsets + margin_m - self._normals @ centre) / radius[:, None]
        crosses = np.abs(near) < 1.0
        half = np.arccos(np.clip(near, -1.0, 1.0))
        sideways = radius[:, None] * np.sqrt(np.clip(1.0 - near**2, 0.0, 1.0))
        facing = np.arctan2(self._normals[:, 1], self._normals[:, 0])
        low, high = self._side_ends(margin_m)
        centre_along = self._tangents @ centre
        first = np.full(len(points), np.inf)
        for side in (1.0, -1.0):
            along = centre_along + side * sideways
            on_side = crosses & (along >= low - 1e-9) & (along <= high + 1e-9)
            crossing = facing + side * half
            travel = angle[:, None] - crossing if turn > 0.0 else crossing - angle[:, None]
            first = np.minimum(first, np.where(on_side, np.mod(travel, 2.0 * math.pi), np.inf).min(axis=1))
        return first / abs(turn)

    def _side_ends(self, margin_m: float) -> tuple[Array, Array]:
        """Ends of each side of the enlarged polygon, along its tangent."""
        before, after = np.roll(self._normals, 1, axis=0), np.roll(self._normals, -1, axis=0)
        offsets = self._offsets + margin_m
        return (
            _corner_on_path(self._normals, self._tangents, offsets, before, np.roll(offsets, 1)),
            _corner_on_path(self._normals, self._tangents, offsets, after, np.roll(offsets, -1)),
        )


def convex_hull(points: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Corners of the hull, counter-clockwise, without collinear ones."""
    ordered = sorted(set(points))

    def chain(run: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        corners: list[tuple[float, float]] = []
        for x, y in run:
            while len(corners) >= 2:
                (x0, y0), (x1, y1) = corners[-2], corners[-1]
                if (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0) > 1e-12:
                    break
                corners.pop()
            corners.append((x, y))
        return corners[:-1]

    return (*chain(ordered), *chain(ordered[::-1]))


def transformed(pose: Pose2D, points: Array) -> Array:
    """Transform points by ``pose`` to its parent frame."""
    cos, sin = math.cos(pose.heading_rad), math.sin(pose.heading_rad)
    turned: Array = points @ np.array([[cos, sin], [-sin, cos]]) + np.array([pose.x_m, pose.y_m])
    return turned


def _corner_on_path(normals: Array, tangents: Array, offsets: Array, others: Array, other_offsets: Array) -> Array:
    # A corner x obeys n.x = h and n'.x = h'; with x = h n + s t this is s = (h' - h n.n') / (t.n').
    facing = (normals * others).sum(axis=1)
    turning = (tangents * others).sum(axis=1)
    corner: Array = (other_offsets - offsets * facing) / turning
    return corner
