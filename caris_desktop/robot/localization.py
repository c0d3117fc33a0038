"""Where the robot is in the map, from its transforms, or from a pose topic carried on by odometry."""

from collections.abc import Iterable

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import Odometry, RobotPose
from caris_desktop.robot.profile import TransformFrames
from caris_desktop.ros.messages import Transform

_LONGEST_CHAIN = 32
_TRANSFORMS_LIVE_NS = 1_000_000_000
_LEAST_PERIOD_NS = 45_000_000


class TransformTree:
    """The newest transform of each frame to its parent."""

    def __init__(self) -> None:
        self._to_parent: dict[str, Transform] = {}

    def add(self, transforms: Iterable[Transform]) -> set[str]:
        """Remember them; returns the child frames that were told."""
        told = set()
        for transform in transforms:
            self._to_parent[transform.child_frame] = transform
            told.add(transform.child_frame)
        return told

    def chain(self, parent: str, child: str) -> tuple[Transform, ...] | None:
        """The transforms that lead from ``child`` up to ``parent``; None when they do not meet."""
        found: list[Transform] = []
        frame = child
        while frame != parent:
            step = self._to_parent.get(frame)
            if step is None or len(found) >= _LONGEST_CHAIN:
                return None
            found.append(step)
            frame = step.parent_frame
        return tuple(found)

    def lookup(self, parent: str, child: str) -> Pose2D | None:
        """``parent_from_child``, or None when the frames are not connected that way."""
        steps = self.chain(parent, child)
        if steps is None:
            return None
        pose = Pose2D(0.0, 0.0, 0.0)
        for step in steps:
            pose = step.parent_from_child @ pose
        return pose


class PoseTracker:
    """Gives the robot's pose in the map whenever there is news of it, at most about 20 times a second.

    Transforms win while they come. Without them a pose topic is carried on by odometry: a localizer such as amcl
    tells the pose only when the robot has moved.
    """

    def __init__(self, frames: TransformFrames) -> None:
        self._frames = frames
        self.tree = TransformTree()
        self._transforms_ns: int | None = None
        self._odometry: Odometry | None = None
        self._map_from_odom: Pose2D | None = None
        self._told_ns = 0

    def take_transforms(self, transforms: Iterable[Transform], *, stamp_ns: int, static: bool) -> RobotPose | None:
        told = self.tree.add(transforms)
        if static:
            return None
        steps = self.tree.chain(self._frames.map, self._frames.base)
        if not steps or not any(step.child_frame in told for step in steps):
            return None
        self._transforms_ns = stamp_ns
        if stamp_ns - self._told_ns < _LEAST_PERIOD_NS:
            return None
        pose = self.tree.lookup(self._frames.map, self._frames.base)
        if pose is None:
            return None
        self._told_ns = stamp_ns
        stamps = [step.robot_stamp_ns for step in steps if step.robot_stamp_ns is not None]
        return RobotPose(stamp_ns, max(stamps, default=None), pose)

    def take_pose(self, pose: RobotPose) -> RobotPose | None:
        if self._odometry is not None:
            self._map_from_odom = pose.pose_in_map @ self._odometry.pose_in_odom.inverse()
        if self._transforms_are_live(pose.stamp_ns):
            return None
        self._told_ns = pose.stamp_ns
        return pose

    def take_odometry(self, odometry: Odometry) -> RobotPose | None:
        self._odometry = odometry
        if self._map_from_odom is None or self._transforms_are_live(odometry.stamp_ns):
            return None
        if odometry.stamp_ns - self._told_ns < _LEAST_PERIOD_NS:
            return None
        self._told_ns = odometry.stamp_ns
        return RobotPose(odometry.stamp_ns, odometry.robot_stamp_ns, self._map_from_odom @ odometry.pose_in_odom)

    def forget(self) -> None:
        """The link was lost: what was known of the robot's place is no longer."""
        self.tree = TransformTree()
        self._transforms_ns = None
        self._odometry = None
        self._map_from_odom = None

    def _transforms_are_live(self, now_ns: int) -> bool:
        return self._transforms_ns is not None and now_ns - self._transforms_ns < _TRANSFORMS_LIVE_NS
