"""Robot sensors and plans from topics to the console: scans, odometry, pose, transforms, path, battery."""

import logging
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.clock import StampAge, now_ns
from caris_desktop.domain.events import Problem
from caris_desktop.domain.geometry import Pose2D, Twist2D, moved_by
from caris_desktop.domain.sensing import LaserScan, Odometry, PlannedPath, RobotPose, lidar_mounting
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.robot.link_context import LinkContext
from caris_desktop.robot.localization import PoseTracker
from caris_desktop.robot.profile_model import TopicSource
from caris_desktop.ros.message_conversion import (
    decode_battery_state,
    decode_clock,
    decode_laser_scan,
    decode_odometry,
    decode_path,
    decode_pose_with_covariance_stamped,
    decode_tf_message,
)

logger = logging.getLogger(__name__)

MOST_PATH_POINTS = 500
# Transforms may arrive one by one; an earlier warning would be premature.
FRAMES_KNOWN_AFTER_NS = 3_000_000_000
PLACE_KNOWN_AFTER_NS = 8_000_000_000
CLOCK = TopicSource("/clock", throttle_ms=100)


class Sensors:
    """Subscribes to the profile's topics and sends domain values.

    ``on_scan``, ``on_odometry`` and ``on_pose`` are also called with each LaserScan, Odometry and RobotPose;
    for a scan with its transmission time in seconds, as far as known.
    """

    def __init__(
        self,
        link: LinkContext,
        *,
        on_scan: Callable[[LaserScan, float], None],
        on_odometry: Callable[[Odometry], None],
        on_pose: Callable[[RobotPose], None],
    ) -> None:
        self._ros, self._profile = link.ros, link.profile
        self._report = link.report
        self._measurement = link.measurement
        self._put = link.put
        self._scan_taken = on_scan
        self._odometry_taken = on_odometry
        self._pose_taken = on_pose
        self._poses = PoseTracker(link.profile.frames)
        self._transforms_since_ns: int | None = None
        self._scans_since_ns: int | None = None
        self._reported_frames: set[str] = set()
        self._reported_lost = False
        self._scan_stamps = StampAge()
        self._odometry: Odometry | None = None
        self._reported_transforms: set[str] = set()
        self.pose_in_map: Pose2D | None = None
        profile, listen = link.profile, link.listen
        listen(profile.scan, "sensor_msgs/LaserScan", self._on_scan)
        listen(profile.odometry, "nav_msgs/Odometry", self._on_odometry)
        listen(profile.pose, "geometry_msgs/PoseWithCovarianceStamped", self._on_pose)
        listen(profile.tf_static, "tf2_msgs/TFMessage", lambda m: self._on_transforms(m, static=True), queue_length=20)
        # Several nodes publish transforms here: none may replace another.
        listen(profile.tf, "tf2_msgs/TFMessage", self._on_transforms, queue_length=20)
        # It is normally silent, and resubscribing would lose messages.
        listen(profile.path, "nav_msgs/Path", self._on_path, watched=False)
        listen(profile.battery, "sensor_msgs/BatteryState", self._on_battery)
        if profile.simulation_time:
            listen(CLOCK, "rosgraph_msgs/Clock", lambda m: self._measurement.add_simulation_time(decode_clock(m)))

    def link_lost(self) -> None:
        """Reset the localization."""
        self._poses.forget()
        self._transforms_since_ns = self._scans_since_ns = None
        self._scan_stamps = StampAge()
        self._odometry = None
        self._reported_frames.clear()
        self._reported_lost = False
        self.pose_in_map = None

    def clear_path(self) -> None:
        """Clear the path after the end of a goal."""
        if self._profile.path is not None:
            self._put(PlannedPath(now_ns(), None, np.empty((0, 2), np.float32)))

    def _on_scan(self, message: Any) -> None:
        scan = decode_laser_scan(message, stamp_ns=self._ros.arrival_ns)
        if self._profile.scan is not None:
            self._measurement.add_message(self._profile.scan.topic, scan.robot_stamp_ns)
        scan = self._mounted(scan)
        # Pose at the measurement, not at its arrival: a turning robot has moved on.
        map_from_robot = self._poses.map_from_base(robot_stamp_ns=scan.robot_stamp_ns, now_ns=scan.stamp_ns)
        if map_from_robot is not None and scan.robot_from_laser is not None:
            scan = replace(scan, map_from_laser=map_from_robot @ scan.robot_from_laser)
        self._scan_stamps.add(scan.robot_stamp_ns, arrival_ns=scan.stamp_ns)
        offset = self._measurement.offset_at(scan.stamp_ns)
        known = (None, 0.0) if offset is None else (offset.offset_ns, offset.uncertainty_ns)
        self._scan_taken(scan, self._scan_stamps.delay_s(*known))
        self._put(scan)

    def _mounted(self, scan: LaserScan) -> LaserScan:
        """Scan with the LIDAR's pose; beams reversed if it is mounted upside down.

        Without a pose, and thus unused, while transforms may still arrive, or if the LIDAR is tilted.
        """
        mount = self._profile.laser
        robot_from_laser = self._poses.base_from(scan.frame_id, scan.robot_stamp_ns) if scan.frame_id else None
        if robot_from_laser is None:
            if scan.frame_id and self._transforms_may_come(scan.stamp_ns):
                return scan
            if scan.frame_id:
                self._complain_of_frame(
                    scan.frame_id, QT_TR_NOOP("The LIDAR is shown at the mounting position set in the profile.")
                )
            return scan.mounted(mount.robot_from_laser, upside_down=mount.mounting == "upside_down")
        mounting = mount.mounting or lidar_mounting(robot_from_laser)
        if mounting == "tilted":
            self._complain_of_tilt(scan.frame_id, robot_from_laser.tilt_rad)
            return scan
        return scan.mounted(robot_from_laser.floor, upside_down=mounting == "upside_down")

    def _transforms_may_come(self, at_ns: int) -> bool:
        """True while the link is so new that transforms may still arrive."""
        if self._profile.tf is None and self._profile.tf_static is None:
            return False
        self._scans_since_ns = self._scans_since_ns or at_ns
        return at_ns - self._scans_since_ns < FRAMES_KNOWN_AFTER_NS

    def _complain_of_tilt(self, frame: str, tilt_rad: float) -> None:
        self._report.problems.count(
            "tilted lidar",
            severity="warning",
            what=localized(
                QT_TR_NOOP("The LIDAR is tilted by {degrees} degrees (frame {frame} on tf): its scans are not used."),
                degrees=f"{math.degrees(tilt_rad):.0f}",
                frame=repr(frame[:100]),
            ),
            meaning=QT_TR_NOOP(
                "A tilted LIDAR measures the floor and the ceiling. The obstacle guard has no data, the "
                "robot drives slowly, and the map shows no scan."
            ),
            advice=QT_TR_NOOP(
                "Mount the LIDAR level, or correct its transform. If it is already level, enter 'mounting: "
                "upright' or 'mounting: upside_down' under 'laser' in the robot profile."
            ),
        )

    def _on_odometry(self, message: Any) -> None:
        odometry = decode_odometry(message, stamp_ns=self._ros.arrival_ns, pose_of=self._reckoned)
        self._odometry = odometry
        if self._profile.odometry is not None:
            self._measurement.add_message(self._profile.odometry.topic, odometry.robot_stamp_ns)
        self._measurement.add_stamp(odometry.robot_stamp_ns)
        self._odometry_taken(odometry)
        self._put(odometry)
        self._put_pose(self._poses.add_odometry(odometry))

    def _reckoned(self, twist: Twist2D) -> Pose2D:
        """Dead reckoning by velocity for an odometry without a pose (zero quaternion)."""
        self._report.problems.count(
            "odometry without pose",
            severity="warning",
            what=QT_TR_NOOP(
                "The robot's odometry reports no orientation (a zero quaternion), so its pose is not used."
            ),
            meaning=QT_TR_NOOP("The robot's path is estimated from its speed and is less accurate."),
            advice=QT_TR_NOOP("Set up the robot's base driver to report the orientation in its odometry."),
        )
        before = self._odometry
        if before is None:
            return Pose2D(0.0, 0.0, 0.0)
        elapsed_s = min((self._ros.arrival_ns - before.stamp_ns) / 1e9, 1.0)
        return before.pose_in_odom @ moved_by(twist, elapsed_s)

    def _complain_of_transform(self, parent: str, child: str, reason: str) -> None:
        if child not in self._reported_transforms and len(self._reported_transforms) >= 20:
            return
        self._reported_transforms.add(child)
        self._report.problems.count(
            f"transform {child}",
            severity="warning",
            what=localized(
                QT_TR_NOOP("The transform from {parent} to {child} cannot be used: {why}."),
                parent=repr(parent[:100]),
                child=repr(child[:100]),
                why=reason,
            ),
            meaning=QT_TR_NOOP("Frames attached to it have no position; the robot's other transforms are used."),
            advice=QT_TR_NOOP("Correct the node on the robot that publishes this transform."),
        )

    def _on_pose(self, message: Any) -> None:
        pose = decode_pose_with_covariance_stamped(message, stamp_ns=self._ros.arrival_ns)
        self._put_pose(self._poses.add_pose(pose))

    def _on_transforms(self, message: Any, *, static: bool = False) -> None:
        transforms = decode_tf_message(message, unusable=self._complain_of_transform)
        if transforms and self._transforms_since_ns is None:
            self._transforms_since_ns = self._ros.arrival_ns
        self._put_pose(self._poses.add_transforms(transforms, stamp_ns=self._ros.arrival_ns, static=static))
        if self.pose_in_map is None:
            self._complain_of_place()

    def _on_path(self, message: Any) -> None:
        path = decode_path(message, most_points=MOST_PATH_POINTS)
        map_from_path = self._poses.map_from(path.frame_id, path.robot_stamp_ns)
        if map_from_path is None:
            self._complain_of_frame(path.frame_id, QT_TR_NOOP("The robot's planned path is not shown."))
            return
        points = points_in_parent(map_from_path, path.points_m)
        self._put(PlannedPath(self._ros.arrival_ns, path.robot_stamp_ns, points))

    def _on_battery(self, message: Any) -> None:
        self._put(decode_battery_state(message, stamp_ns=self._ros.arrival_ns))

    def _put_pose(self, pose: RobotPose | None) -> None:
        if pose is not None:
            self.pose_in_map = pose.pose_in_map
            self._put(pose)
            self._pose_taken(pose)

    def _complain_of_place(self) -> None:
        since_ns = self._transforms_since_ns
        needs_place = self._profile.map is not None or self._profile.navigation is not None
        if self._reported_lost or not needs_place or since_ns is None:
            return
        if self._ros.arrival_ns - since_ns < PLACE_KNOWN_AFTER_NS:
            return
        self._reported_lost = True
        frames = self._profile.frames
        self._put(
            Problem(
                now_ns(),
                "warning",
                localized(
                    QT_TR_NOOP("The robot does not report its position: it has no transform from {map} to {base}."),
                    map=f"{frames.map!r}",
                    base=f"{frames.base!r}",
                ),
                QT_TR_NOOP(
                    "Without a map, the robot is shown by its odometry; on a map, it is not shown. Goals and "
                    "places cannot be used, and the distance to goals is unknown."
                ),
                localized(
                    QT_TR_NOOP(
                        "Set the robot's pose on the map. If that does not help, compare 'frames' in the "
                        "robot profile with the robot's own frames: {frames}."
                    ),
                    frames=", ".join(sorted(self._poses.tree.frames)[:8]),
                ),
                until="pose",
            )
        )

    def _complain_of_frame(self, frame: str, meaning: str) -> None:
        since_ns = self._transforms_since_ns
        if since_ns is None or self._ros.arrival_ns - since_ns < FRAMES_KNOWN_AFTER_NS:
            return
        if frame in self._reported_frames or len(self._reported_frames) >= 20:
            return
        self._reported_frames.add(frame)
        self._report.problems.count(
            f"frame {frame}",
            severity="warning",
            what=localized(QT_TR_NOOP("{unknown_frame}."), unknown_frame=self._poses.unknown_frame(frame[:100])),
            meaning=meaning,
            advice=QT_TR_NOOP("Check 'frames' in the robot profile, and what the robot publishes on tf and tf_static."),
        )


def points_in_parent(parent_from_child: Pose2D, points_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Transform points, shape (n, 2), from a child frame to its parent."""
    cos, sin = math.cos(parent_from_child.heading_rad), math.sin(parent_from_child.heading_rad)
    points = np.empty_like(points_m, dtype=np.float32)
    points[:, 0] = parent_from_child.x_m + cos * points_m[:, 0] - sin * points_m[:, 1]
    points[:, 1] = parent_from_child.y_m + sin * points_m[:, 0] + cos * points_m[:, 1]
    return points
