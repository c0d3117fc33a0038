"""Obstacle guard: the fraction of a velocity that the LIDAR permits. Pure logic; time is an argument.

Assumptions: obstacles do not move while the robot stops, and the LIDAR sees them. What is above or below its plane is
unknown.
"""

import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.events import GuardChanged, GuardState
from caris_desktop.domain.geometry import ZERO_TWIST, Pose2D, Twist2D, moved_by
from caris_desktop.domain.sensing import LaserScan, Odometry
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import Value
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


SIDE_MARGIN_M = 0.05
"""Margin all around for the LIDAR's noise and for what sticks out above its plane."""
LEGS_MARGIN_M, LEGS_STOP_M = 0.05, 0.08
"""Extra margin at the sides and front of possible legs: feet, hips and bags reach beyond them."""
TURNING_STOP_M = 0.03
"""The stop distance of a part of the footprint that only turns towards something."""
BLIND_FRACTION = 0.3
CRAWL_MPS = 0.1
MEMORY_S = 10.0
_STALE_AFTER_S, _STALE_PERIODS = 0.5, 3.0
_REPORTED_M = 2.0
_REMEMBERED_WITHIN_M = 3.0
# Below the first speed the robot stops; it restarts once the second is permitted, so that noise causes no motion.
_CREEP_MPS, _START_MPS = 0.03, 0.07
_LEGS_WIDE_M, _FREE_M, _ROUND, _FEWEST_BEAMS = 0.45, 0.12, 0.12, 4
# Only the robot's own parts can be this deep inside it.
_DEEP_M, _DEEP_OWN_AFTER_S, _OWN_AFTER_M, _SAME_RANGE_M = 0.05, 1.0, 0.3, 0.03
_NEAR_FIELD_M = 0.5
_UNSEEN_WIDTH_M = 0.1
_NOISE_M = 0.015
_BESIDE_M = 0.1
_VIEWS, _VIEW_EVERY_M, _VIEW_EVERY_RAD, _SAME_VIEW = 12, 0.3, 0.35, 0.03
_ODOMETRY_FRESH_S = 0.3
_BINS = 720

_STALE_WORDS = QT_TR_NOOP("no fresh scan from the LIDAR")
_UNSEEN_WORDS = QT_TR_NOOP("the LIDAR does not cover this direction")


class GuardLimit(Value):
    """``fraction`` of the velocity is permitted, on the same arc; ``distance_m`` is the clearance along it."""

    fraction: float
    state: GuardState
    distance_m: float | None = None
    detail: str = ""


class _View(Value):
    """Coverage of one scan: its pose, and each beam's angle to the nearest measuring one."""

    stamp_s: float
    odom_from_laser: Pose2D
    odom_from_robot: Pose2D
    angle_min_rad: float
    increment_rad: float
    ranges_m: Array
    uncovered_rad: Array
    full_circle: bool

    def knows(self, points_in_odom: Array, *, seen: bool) -> NDArray[np.bool_]:
        """True for points within the beams' coverage; ``seen``: and without an obstacle in between."""
        x, y = transformed(self.odom_from_laser.inverse(), points_in_odom).T
        distance = np.hypot(x, y)
        last = len(self.ranges_m) - 1
        beyond_min = np.mod(np.arctan2(y, x) - self.angle_min_rad, 2.0 * math.pi)
        past_end = beyond_min - last * self.increment_rad
        outside = np.where(past_end > 0.0, np.minimum(past_end, 2.0 * math.pi - beyond_min), 0.0)
        beam = np.where(
            past_end > 2.0 * math.pi - beyond_min,
            0,
            np.minimum(np.rint(beyond_min / self.increment_rad).astype(np.intp), last),
        )
        known: NDArray[np.bool_] = (outside + self.uncovered_rad[beam]) * distance <= _UNSEEN_WIDTH_M
        if seen:
            known &= self.ranges_m[beam] >= distance - _UNSEEN_WIDTH_M
        return known


class ObstacleGuard:
    """Limits manual driving so that the footprint touches nothing that the LIDAR sees.

    For each velocity it computes how far the footprint can go along that arc (forward, back, sideways, turning in
    place) before it reaches a scanned point, and permits the fraction from which the robot can stop, after
    ``reaction_s`` and the profile's braking, with ``stop_distance_m`` left. The arc is preserved, and moving away from
    an obstacle is always permitted. Obstacles that leave the view by rotation are remembered in the odometry frame for
    10 s; outside of the coverage the robot crawls.

    Points inside the footprint belong to the robot's own body once they were fixed relative to it for 1 s (if deeper
    inside than an obstacle can be) or over 0.3 m of motion (near the outline). Until then they block motion that goes
    deeper. Beams that end on the robot's body do not count as coverage.

    Motion since a scan is compensated with odometry, or without it with the velocities sent. Times are seconds on the
    session clock.
    """

    def __init__(self, profile: RobotProfile) -> None:
        self._settings = profile.guard
        self._limits = profile.limits
        self._present = profile.scan is not None
        self._footprint = Footprint.of(profile)
        self._on = profile.guard.on
        self._round_trip_s = 0.0
        self._view: _View | None = None
        self._views: deque[_View] = deque(maxlen=_VIEWS)
        self._views_anchor = Pose2D(0.0, 0.0, 0.0)
        self.forget()

    @property
    def on(self) -> bool:
        return self._on

    def switch(self, *, on: bool) -> None:
        """Switch on, or off on the wizard's own responsibility. The speed limit without a fresh scan remains."""
        self._on = on

    def forget(self) -> None:
        """Reset for a new link: unknown surroundings, and the profile's default state."""
        self._on = self._settings.on
        self._odometry: deque[tuple[int, Odometry]] = deque(maxlen=64)
        self._sent = ZERO_TWIST
        self._odom_from_robot = Pose2D(0.0, 0.0, 0.0)
        self._reckoned_s: float | None = None
        self._travelled_m = 0.0
        self._scan_s: float | None = None
        self._delay_s = 0.0
        self._period_s = 0.0
        self._blocked = False
        self._body_range_m = np.full(_BINS, np.nan)
        self._body_since_s = np.zeros(_BINS)
        self._body_since_m = np.zeros(_BINS)
        self._forget_surroundings()

    # Measurements

    def add_round_trip(self, round_trip_s: float) -> None:
        """Set the network round trip, which adds to ``reaction_s``."""
        self._round_trip_s = max(min(round_trip_s, 1.0), 0.8 * self._round_trip_s)

    def add_odometry(self, odometry: Odometry) -> None:
        now_s = odometry.stamp_ns / 1e9
        previous = self._odometry[-1][1] if self._odometry else None
        self._reckon(now_s)
        jump = self._odom_from_robot.inverse() @ odometry.pose_in_odom
        if previous is None or math.hypot(jump.x_m, jump.y_m) > 0.5 or abs(jump.heading_rad) > 0.8:
            # A new odometry frame, or the robot was moved: no remembered point is valid.
            self._forget_surroundings()
            self._odometry.clear()
        else:
            self._note_travelled(previous.pose_in_odom.inverse() @ odometry.pose_in_odom)
        stamp_ns = odometry.robot_stamp_ns if odometry.robot_stamp_ns is not None else odometry.stamp_ns
        self._odometry.append((stamp_ns, odometry))
        # From its arrival: it may have been queued.
        self._odom_from_robot, self._reckoned_s = odometry.pose_in_odom, now_s

    def note_sent(self, twist: Twist2D, now_s: float) -> None:
        """Note a velocity that was sent."""
        self._reckon(now_s)
        self._sent = twist

    def add_scan(self, scan: LaserScan, *, delay_s: float = 0.0) -> None:
        """Add a scan; ignored without information, as of a covered LIDAR or one with an unknown mounting.

        ``delay_s`` is its transmission time, as far as known.
        """
        if scan.robot_from_laser is None:
            return
        now_s = scan.stamp_ns / 1e9
        ranges_m = scan.ranges_m.astype(np.float64)
        angle_min_rad, increment_rad = scan.angle_min_rad, scan.angle_increment_rad
        if increment_rad < 0.0:
            ranges_m = ranges_m[::-1]
            angle_min_rad, increment_rad = angle_min_rad + (len(ranges_m) - 1) * increment_rad, -increment_rad
        with np.errstate(invalid="ignore"):
            # A beam without an echo reads inf, 0 or beyond the range; one that never measures reads nan or less than 0.
            measuring = ranges_m >= 0.0
            measured = (ranges_m >= max(scan.range_min_m, 1e-3)) & (ranges_m <= scan.range_max_m)
        measured &= np.isfinite(ranges_m)
        usable = math.isfinite(angle_min_rad) and 1e-5 < increment_rad < 1.0
        if not usable or not (measured.any() or np.isposinf(ranges_m).any()):
            return
        self._reckon(now_s)
        if self._scan_s is not None and now_s > self._scan_s:
            period_s = min(now_s - self._scan_s, 1.0)
            self._period_s = period_s if not self._period_s else 0.8 * self._period_s + 0.2 * period_s
        self._scan_s, self._delay_s = now_s, delay_s
        at_laser = np.where(measured, ranges_m, 0.0)
        angles = angle_min_rad + increment_rad * np.arange(len(ranges_m))
        points_in_laser = np.column_stack((at_laser * np.cos(angles), at_laser * np.sin(angles)))
        points_in_robot = transformed(scan.robot_from_laser, points_in_laser)
        on_body = self._own_body(points_in_robot, ranges_m, measured, angles, now_s)
        obstacle = measured & ~on_body
        measuring &= ~on_body
        full_circle = len(ranges_m) * increment_rad > 2.0 * math.pi - 1.5 * increment_rad
        odom_from_robot = self._pose_at(scan)
        view = _View(
            stamp_s=now_s,
            odom_from_laser=odom_from_robot @ scan.robot_from_laser,
            odom_from_robot=odom_from_robot,
            angle_min_rad=angle_min_rad,
            increment_rad=increment_rad,
            ranges_m=np.where(measured, ranges_m, np.inf),
            uncovered_rad=_angle_to_nearest(measuring, increment_rad, full_circle=full_circle),
            full_circle=full_circle and bool(measuring.all()),
        )
        self._remember_out_of_view(view, measuring, on_body)
        legs = _is_free(points_in_laser, ranges_m, measured, full_circle=full_circle)
        self._view = view
        self._store_view(view)
        self._points_in_odom = transformed(odom_from_robot, points_in_robot[obstacle])
        self._legs = legs[obstacle]

    # Limits

    def limit(self, twist: Twist2D, now_s: float) -> GuardLimit:
        """Permitted fraction of ``twist``. Without motion it only reports the state."""
        if not self._present:
            return GuardLimit(1.0, "absent")
        stale = self.stale(now_s)
        cap = self._blind_cap(twist) if stale else 1.0
        if not self._on:
            return GuardLimit(cap, "overridden")
        found = GuardLimit(1.0, "clear")
        if twist.moving:
            self._reckon(now_s)
            found = self._obstacle_limit(twist, now_s)
        if found.state == "blocked":
            return found
        if stale:
            return GuardLimit(min(cap, found.fraction), "blind", found.distance_m, _STALE_WORDS)
        if twist.moving and not self._sees_path(twist, now_s):
            crawl = self._crawl(twist)
            if crawl < found.fraction:
                return GuardLimit(crawl, "blind", found.distance_m, _UNSEEN_WORDS)
        return found

    def stale(self, now_s: float) -> bool:
        """True if the newest scan is too old (or missing)."""
        if self._scan_s is None:
            return True
        return now_s - self._scan_s + self._delay_s > max(_STALE_AFTER_S, _STALE_PERIODS * self._period_s)

    def _obstacle_limit(self, twist: Twist2D, now_s: float) -> GuardLimit:
        speed_mps = math.hypot(twist.forward_mps, twist.left_mps)
        fastest_mps = speed_mps + abs(twist.turn_radps) * self._footprint.radius_m
        reaction_s = self._settings.reaction_s + self._round_trip_s
        braking_s = max(
            speed_mps / self._limits.deceleration_mps2, abs(twist.turn_radps) / self._limits.turn_deceleration_radps2
        )
        horizon_s = max(
            reaction_s + braking_s + (self._settings.stop_distance_m + LEGS_STOP_M) / fastest_mps,
            _REPORTED_M / fastest_mps,
        )
        within_m = self._footprint.radius_m + SIDE_MARGIN_M + LEGS_MARGIN_M + horizon_s * fastest_mps
        points, legs = self._points_near(within_m, now_s)
        fraction, distance_m = 1.0, math.inf
        kinds = ((points[~legs], SIDE_MARGIN_M, 0.0), (points[legs], SIDE_MARGIN_M + LEGS_MARGIN_M, LEGS_STOP_M))
        for kind, needed_m, more_m in kinds:
            if not len(kind):
                continue
            gaps_m = self._footprint.gap_m(kind)
            # With less clearance than the margin, the present one is preserved: the robot may drive along a wall.
            margin_m = min(max(float(gaps_m.min()) - _NOISE_M, 0.0), needed_m)
            contact_s = self._footprint.contact_s(kind, twist, margin_m=margin_m)
            reached = contact_s < horizon_s
            if not reached.any():
                continue
            contact_s, group, gaps_m = contact_s[reached], kind[reached], gaps_m[reached]
            approach_mps = np.maximum(
                np.hypot(
                    twist.forward_mps - twist.turn_radps * group[:, 1], twist.left_mps + twist.turn_radps * group[:, 0]
                ),
                1e-6,
            )
            stop_m = (self._settings.stop_distance_m + more_m) * np.minimum(1.0, speed_mps / approach_mps)
            stop_m = np.maximum(stop_m, TURNING_STOP_M)
            room_s = float((contact_s - stop_m / approach_mps).min())
            fraction = min(fraction, _stopping_fraction(room_s, reaction_s, braking_s))
            ways_m = np.where(contact_s > 0.0, contact_s * approach_mps + margin_m, np.maximum(gaps_m, 0.0))
            distance_m = min(distance_m, float(ways_m.min()))
        reported_m = distance_m if distance_m <= _REPORTED_M else None
        allowed_mps = fraction * fastest_mps
        if fraction < 1.0 and allowed_mps < (_START_MPS if self._blocked else _CREEP_MPS):
            self._blocked = True
            return GuardLimit(0.0, "blocked", reported_m)
        self._blocked = False
        return GuardLimit(fraction, "slowing" if fraction < 0.99 else "clear", reported_m)

    def _points_near(self, within_m: float, now_s: float) -> tuple[Array, NDArray[np.bool_]]:
        """Scanned and remembered points in the robot frame, and which of them may be legs."""
        recent = now_s - self._memory_s <= MEMORY_S
        newest = slice(None) if self._view is not None and now_s - self._view.stamp_s <= MEMORY_S else slice(0)
        in_odom = np.concatenate((self._points_in_odom[newest], self._memory_in_odom[recent]))
        legs = np.concatenate((self._legs[newest], self._memory_legs[recent]))
        here = np.array([self._odom_from_robot.x_m, self._odom_from_robot.y_m])
        near = ((in_odom - here) ** 2).sum(axis=1) <= within_m**2
        return transformed(self._odom_from_robot.inverse(), in_odom[near]), legs[near]

    def _blind_cap(self, twist: Twist2D) -> float:
        limits = self._limits
        along_mps = limits.forward_mps if twist.forward_mps > 0.0 else limits.backward_mps
        return min(
            1.0,
            _share(BLIND_FRACTION * along_mps, twist.forward_mps),
            _share(BLIND_FRACTION * limits.left_mps, twist.left_mps),
            _share(BLIND_FRACTION * limits.turn_radps, twist.turn_radps),
        )

    def _crawl(self, twist: Twist2D) -> float:
        speed_mps = math.hypot(twist.forward_mps, twist.left_mps)
        return min(1.0, _share(CRAWL_MPS, speed_mps), _share(CRAWL_MPS, twist.turn_radps * self._footprint.radius_m))

    def _sees_path(self, twist: Twist2D, now_s: float) -> bool:
        """True if beams cover, or recently covered, the footprint's path before it could stop."""
        view = self._view
        if view is None:
            return False
        if view.full_circle:
            return True
        fastest_mps = math.hypot(twist.forward_mps, twist.left_mps) + abs(twist.turn_radps) * self._footprint.radius_m
        until_s = self._settings.reaction_s + (self._settings.stop_distance_m + 0.1) / fastest_mps
        until_s = min(until_s, math.pi / max(abs(twist.turn_radps), 1e-6))
        swept = self._footprint.outline_after(twist, np.linspace(0.25, 1.0, 4) * until_s)
        swept = swept[self._footprint.gap_m(swept) > _BESIDE_M]
        if not len(swept):
            return True
        unknown = transformed(self._odom_from_robot, swept)
        unknown = unknown[~view.knows(unknown, seen=False)]
        for earlier in reversed(self._views):
            if not len(unknown) or now_s - earlier.stamp_s > MEMORY_S:
                break
            unknown = unknown[~earlier.knows(unknown, seen=True)]
        return not len(unknown)

    # Pose

    def _reckon(self, now_s: float) -> None:
        """Extrapolate the pose from the last odometry with its velocity, or the one sent since."""
        before_s, self._reckoned_s = self._reckoned_s, now_s
        if before_s is None or now_s <= before_s:
            self._reckoned_s = before_s if before_s is not None else now_s
            return
        newest = self._odometry[-1][1] if self._odometry else None
        fresh = newest is not None and now_s - newest.stamp_ns / 1e9 <= _ODOMETRY_FRESH_S
        twist = newest.twist if newest is not None and fresh else self._sent
        step = moved_by(twist, min(now_s - before_s, 1.0))
        self._odom_from_robot = self._odom_from_robot @ step
        if not fresh:
            self._note_travelled(step)

    def _note_travelled(self, step: Pose2D) -> None:
        self._travelled_m += math.hypot(step.x_m, step.y_m) + abs(step.heading_rad) * self._footprint.radius_m

    def _pose_at(self, scan: LaserScan) -> Pose2D:
        """Pose at the time of the scan: by robot stamps if scan and odometry both have them."""
        if not self._odometry:
            return self._odom_from_robot
        by_robot = scan.robot_stamp_ns is not None and self._odometry[-1][1].robot_stamp_ns is not None
        stamp_ns = scan.robot_stamp_ns if by_robot and scan.robot_stamp_ns is not None else scan.stamp_ns
        newest_ns, newest = self._odometry[-1]
        if stamp_ns >= newest_ns:
            ahead_s = (stamp_ns - newest_ns) / 1e9
            if ahead_s > _ODOMETRY_FRESH_S:
                return self._odom_from_robot
            return newest.pose_in_odom @ moved_by(newest.twist, ahead_s)
        for at_ns, odometry in reversed(self._odometry):
            if at_ns <= stamp_ns:
                return odometry.pose_in_odom @ moved_by(odometry.twist, (stamp_ns - at_ns) / 1e9)
        # Older than all known motion, or stamped by another clock.
        return self._odom_from_robot

    # Memory

    def _forget_surroundings(self) -> None:
        self._points_in_odom = np.empty((0, 2))
        self._legs = np.empty(0, dtype=bool)
        self._memory_in_odom = np.empty((0, 2))
        self._memory_legs = np.empty(0, dtype=bool)
        self._memory_s = np.empty(0)
        self._view = None
        self._views.clear()

    def _remember_out_of_view(self, view: _View, measuring: NDArray[np.bool_], on_body: NDArray[np.bool_]) -> None:
        """Remember earlier points outside of the new coverage or below its minimum range, except those on the robot's
        body.
        """
        if self._view is not None:
            before = np.full(len(self._points_in_odom), self._view.stamp_s)
            self._memory_s = np.concatenate((self._memory_s, before))
            self._memory_in_odom = np.concatenate((self._memory_in_odom, self._points_in_odom))
            self._memory_legs = np.concatenate((self._memory_legs, self._legs))
        if not len(self._memory_in_odom):
            return
        x, y = transformed(view.odom_from_laser.inverse(), self._memory_in_odom).T
        distance = np.hypot(x, y)
        beyond_min = np.mod(np.arctan2(y, x) - view.angle_min_rad, 2.0 * math.pi)
        beam = np.rint(beyond_min / view.increment_rad).astype(np.intp)
        if view.full_circle:
            beam %= len(measuring)
        within = beam < len(measuring)
        beam = np.minimum(beam, len(measuring) - 1)
        measured = within & measuring[beam] & (np.isfinite(view.ranges_m[beam]) | (distance > _NEAR_FIELD_M))
        if on_body.any():
            in_robot = transformed(view.odom_from_robot.inverse(), self._memory_in_odom)
            measured |= within & on_body[beam] & (self._footprint.gap_m(in_robot) < 0.0)
        keep = ~measured & (distance <= _REMEMBERED_WITHIN_M) & (view.stamp_s - self._memory_s <= MEMORY_S)
        self._memory_in_odom = self._memory_in_odom[keep]
        self._memory_legs = self._memory_legs[keep]
        self._memory_s = self._memory_s[keep]

    def _store_view(self, view: _View) -> None:
        if view.full_circle:
            return
        if self._views:
            # Relative to the start of the last one, else slow motion would carry it along forever.
            moved = self._views_anchor.inverse() @ view.odom_from_robot
            way_m, turned_rad = math.hypot(moved.x_m, moved.y_m), abs(moved.heading_rad)
            if way_m < _SAME_VIEW and turned_rad < _SAME_VIEW:
                self._views[-1] = view
                return
            if way_m < _VIEW_EVERY_M and turned_rad < _VIEW_EVERY_RAD:
                return
        self._views_anchor = view.odom_from_robot
        self._views.append(view)

    def _own_body(
        self,
        points_in_robot: Array,
        ranges_m: Array,
        measured: NDArray[np.bool_],
        angles: NDArray[np.floating],
        now_s: float,
    ) -> NDArray[np.bool_]:
        gaps_m = self._footprint.gap_m(points_in_robot)
        inside = measured & (gaps_m < 0.0)
        # By angle, as some LIDARs vary in the number of beams.
        bins = np.floor(angles / (2.0 * math.pi) * _BINS).astype(np.intp) % _BINS
        current_m = np.full(_BINS, np.nan)
        current_m[bins[inside]] = ranges_m[inside]
        with np.errstate(invalid="ignore"):
            same = np.abs(current_m - self._body_range_m) < _SAME_RANGE_M
        self._body_since_s[~same] = now_s
        self._body_since_m[~same] = self._travelled_m
        self._body_range_m[~same] = current_m[~same]
        moved = self._travelled_m - self._body_since_m[bins] >= _OWN_AFTER_M
        lasted = now_s - self._body_since_s[bins] >= _DEEP_OWN_AFTER_S
        on_body: NDArray[np.bool_] = inside & (moved | (lasted & (gaps_m < -_DEEP_M)))
        return on_body


class GuardChangeDetector:
    """Decides which limits are worth an event: each deterioration at once, others at intervals."""

    EVERY_S = 0.2
    BETTER_AFTER_S = 0.4
    _ORDER: tuple[GuardState, ...] = ("absent", "overridden", "clear", "slowing", "blind", "blocked")

    def __init__(self) -> None:
        self._reported: GuardLimit | None = None
        self._reported_s = -math.inf
        self._better_since_s: float | None = None

    def forget(self) -> None:
        """Report the next limit in any case."""
        self._reported = None
        self._reported_s = -math.inf
        self._better_since_s = None

    def of(self, limit: GuardLimit, now_s: float, *, stamp_ns: int) -> GuardChanged | None:
        reported = self._reported
        if reported is not None:
            if limit.state != reported.state:
                worse = self._ORDER.index(limit.state) > self._ORDER.index(reported.state)
                switched = "overridden" in (limit.state, reported.state)
                if not (worse or switched):
                    # Noise makes a limit flicker; its end is reported once it lasts.
                    if self._better_since_s is None:
                        self._better_since_s = now_s
                    if now_s - self._better_since_s < self.BETTER_AFTER_S:
                        return None
                elif not switched and limit.state != "blocked" and now_s - self._reported_s < self.EVERY_S:
                    return None
            else:
                self._better_since_s = None
                if now_s - self._reported_s < self.EVERY_S or _alike(limit, reported):
                    return None
        self._reported, self._reported_s, self._better_since_s = limit, now_s, None
        return GuardChanged(stamp_ns, limit.state, limit.distance_m, limit.detail)


def _stopping_fraction(room_s: float, reaction_s: float, braking_s: float) -> float:
    """Fraction k of a velocity with k * reaction + k^2 * braking / 2 = room, in seconds at full velocity."""
    if room_s <= 0.0:
        return 0.0
    if braking_s <= 1e-9:
        return min(1.0, room_s / reaction_s) if reaction_s > 0.0 else 1.0
    return min(1.0, (math.sqrt(reaction_s**2 + 2.0 * braking_s * room_s) - reaction_s) / braking_s)


def _share(most: float, value: float) -> float:
    return most / abs(value) if abs(value) > 1e-9 else 1.0


def _alike(limit: GuardLimit, reported: GuardLimit) -> bool:
    if limit.detail != reported.detail or (limit.distance_m is None) != (reported.distance_m is None):
        return False
    if limit.distance_m is None or reported.distance_m is None:
        return True
    return abs(limit.distance_m - reported.distance_m) < max(0.05, 0.1 * reported.distance_m)


def _angle_to_nearest(measuring: NDArray[np.bool_], increment_rad: float, *, full_circle: bool) -> Array:
    """Angle of each beam to the nearest measuring one; ``inf`` if there is none."""
    count = len(measuring)
    if measuring.all():
        return np.zeros(count)
    if not measuring.any():
        return np.full(count, np.inf)
    beams = np.arange(count)
    if full_circle:
        beams, measuring = np.arange(3 * count), np.tile(measuring, 3)
    before = np.maximum.accumulate(np.where(measuring, beams, -(10**6)))
    after = np.minimum.accumulate(np.where(measuring, beams, 10**6)[::-1])[::-1]
    steps = np.minimum(beams - before, after - beams)
    nearest: Array = (steps[count : 2 * count] if full_circle else steps) * increment_rad
    return nearest


def _is_free(
    points_in_laser: Array, ranges_m: Array, measured: NDArray[np.bool_], *, full_circle: bool
) -> NDArray[np.bool_]:
    """Points on a round, free-standing object no wider than a person.

    The end of a wall at a door is free-standing as well, but flat.
    """
    count = len(ranges_m)
    free = np.zeros(count, dtype=bool)
    depth = np.where(measured, ranges_m, np.inf)
    with np.errstate(invalid="ignore"):
        rise = np.diff(depth, append=depth[:1])
    # inf - inf is nan: no object begins or ends between two beams without an echo.
    ends = np.flatnonzero(np.abs(np.nan_to_num(rise, nan=0.0, posinf=1e9, neginf=-1e9)) > _FREE_M)
    if len(ends) < 2:
        return free
    firsts, lasts = np.concatenate(([ends[-1] + 1 - count], ends[:-1] + 1)), ends
    if not full_circle:
        firsts, lasts = firsts[1:], lasts[1:]
        lasts, firsts = lasts[lasts < count - 1], firsts[lasts < count - 1]
    nearer = (rise[firsts - 1] < 0.0) & (rise[lasts] > 0.0) & measured[firsts]
    chords = points_in_laser[lasts] - points_in_laser[firsts]
    widths_m = np.hypot(chords[:, 0], chords[:, 1])
    many = lasts - firsts + 1 >= _FEWEST_BEAMS
    near = depth[lasts] <= _REMEMBERED_WITHIN_M
    for index in np.flatnonzero(nearer & many & near & (widths_m <= _LEGS_WIDE_M)):
        beams = np.arange(firsts[index], lasts[index] + 1)
        across = points_in_laser[beams] - points_in_laser[firsts[index]]
        # The beams run counter-clockwise, so that bulges towards the LIDAR are left of the chord.
        bulge = chords[index, 0] * across[:, 1] - chords[index, 1] * across[:, 0]
        if float(bulge.mean()) > _ROUND * float(widths_m[index]) ** 2:
            free[beams] = True
    return free
