"""Localization: the robot's present and past pose in the map, from transforms, or from a pose topic extended by
odometry.
"""

import bisect
from collections.abc import Iterable

from caris_desktop.domain.geometry import Pose2D, Pose3D
from caris_desktop.domain.sensing import Odometry, RobotPose
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.robot.profile_model import TransformFrames
from caris_desktop.ros.message_conversion import Transform

HISTORY_NS = 10_000_000_000
# A scan often precedes the transform of its time; motion is extrapolated for this long.
AHEAD_NS = 200_000_000
MOST_FRAMES = 2_000
_LONGEST_CHAIN = 32
_MOST_SAMPLES = 1_200
_TRANSFORMS_LIVE_NS = 1_000_000_000
_LEAST_PERIOD_NS = 45_000_000


AT_ORIGIN = Pose3D.on_floor(Pose2D(0.0, 0.0, 0.0))


class PoseHistory:
    """Moving pose over the last 10 s of robot time, interpolated between samples."""

    def __init__(self) -> None:
        # Stamp of the previous sample, if it was older than the newest.
        self._behind_ns: int | None = None
        self._stamps_ns: list[int] = []
        self._poses: list[Pose3D] = []

    @property
    def newest(self) -> Pose3D:
        return self._poses[-1]

    @property
    def newest_ns(self) -> int:
        return self._stamps_ns[-1]

    def add(self, stamp_ns: int, pose: Pose3D) -> None:
        before_ns, self._behind_ns = self._behind_ns, None
        if self._stamps_ns and stamp_ns < self._stamps_ns[-1]:
            self._behind_ns = stamp_ns
            if before_ns is not None and before_ns < stamp_ns:
                # An out-of-order sample not followed by the next in order: the robot's clock was set back (NTP), the
                # simulation restarted, or a stray stamp was ahead. What is ahead of the present clock is void.
                ahead = bisect.bisect_right(self._stamps_ns, before_ns)
                del self._stamps_ns[ahead:]
                del self._poses[ahead:]
                self._behind_ns = None
        at = bisect.bisect_left(self._stamps_ns, stamp_ns)
        if at < len(self._stamps_ns) and self._stamps_ns[at] == stamp_ns:
            self._poses[at] = pose
            return
        self._stamps_ns.insert(at, stamp_ns)
        self._poses.insert(at, pose)
        old = bisect.bisect_left(self._stamps_ns, self._stamps_ns[-1] - HISTORY_NS)
        old = max(old, len(self._stamps_ns) - _MOST_SAMPLES)
        if old > 64:
            # In groups: shifting the list for each sample would cost more than retaining a few.
            del self._stamps_ns[:old]
            del self._poses[:old]

    def at(self, stamp_ns: int, *, goes_on: bool = False) -> Pose3D | None:
        """Pose at a time, interpolated as in tf2; None before the history.

        After its end the newest pose holds, or with ``goes_on`` its motion is extrapolated for 0.2 s.
        """
        stamps, poses = self._stamps_ns, self._poses
        if stamp_ns < stamps[0]:
            return None
        after = bisect.bisect_left(stamps, stamp_ns)
        if after < len(stamps):
            return poses[after] if stamps[after] == stamp_ns else self._between(after, stamp_ns)
        if goes_on and len(stamps) > 1 and stamps[-1] - stamps[-2] <= AHEAD_NS:
            return self._between(len(stamps) - 1, min(stamp_ns, stamps[-1] + AHEAD_NS))
        return poses[-1]

    def _between(self, after: int, stamp_ns: int) -> Pose3D:
        """Interpolation on the line through samples ``after - 1`` and ``after``."""
        begin_ns, end_ns = self._stamps_ns[after - 1], self._stamps_ns[after]
        share = (stamp_ns - begin_ns) / (end_ns - begin_ns)
        return self._poses[after - 1].towards(self._poses[after], share)


class _Edge:
    """Frame in its parent frame; ``history`` is None for a static one."""

    __slots__ = ("history", "newest", "parent_frame")

    def __init__(self, parent_frame: str) -> None:
        self.parent_frame = parent_frame
        self.newest = AT_ORIGIN
        self.history: PoseHistory | None = None


class TransformTree:
    """Reference frames of the robot with their last 10 s; the part of tf2 that this program needs.

    Cycles and disconnected frames simply yield no result.
    """

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all known frames."""
        return tuple(dict.fromkeys([*self._edges, *(edge.parent_frame for edge in self._edges.values())]))

    def add(self, transforms: Iterable[Transform], *, static: bool = False) -> set[str]:
        """Add transforms; return their child frames. ``static`` ones hold at all times."""
        changed = set()
        for transform in transforms:
            child = transform.child_frame
            if child == transform.parent_frame or not child:
                continue
            edge = self._edges.get(child)
            if edge is None or edge.parent_frame != transform.parent_frame:
                if edge is None and len(self._edges) >= MOST_FRAMES:
                    continue
                edge = self._edges[child] = _Edge(transform.parent_frame)
            pose = transform.parent_from_child
            edge.newest = pose if isinstance(pose, Pose3D) else Pose3D.on_floor(pose)
            if static or transform.robot_stamp_ns is None:
                edge.history = None
            else:
                edge.history = edge.history or PoseHistory()
                edge.history.add(transform.robot_stamp_ns, edge.newest)
                edge.newest = edge.history.newest
            changed.add(child)
        return changed

    def depends_on(self, parent: str, child: str, changed: set[str]) -> bool:
        """True if the path from ``child`` to ``parent`` uses one of the frames ``changed``."""
        branches = self._branches(parent, child)
        return branches is not None and any(frame in changed for branch in branches for frame in branch)

    def newest_stamp_ns(self, parent: str, child: str) -> int | None:
        """Newest stamp on the path; None if nothing on it moves, or there is none."""
        branches = self._branches(parent, child)
        histories = [self._edges[frame].history for branch in branches or () for frame in branch]
        return max((history.newest_ns for history in histories if history is not None), default=None)

    def lookup(
        self, parent: str, child: str, at_ns: int | None = None, *, goes_on: frozenset[str] = frozenset()
    ) -> Pose2D | None:
        """:meth:`lookup_in_space`, projected to the floor."""
        pose = self.lookup_in_space(parent, child, at_ns, goes_on=goes_on)
        return None if pose is None else pose.floor

    def lookup_in_space(
        self, parent: str, child: str, at_ns: int | None = None, *, goes_on: frozenset[str] = frozenset()
    ) -> Pose3D | None:
        """``parent_from_child``, or None if the frames are not connected, or were not at ``at_ns``.

        ``at_ns`` is robot time, None: the newest. The motion of the frames ``goes_on`` is extrapolated for 0.2 s.
        """
        branches = self._branches(parent, child)
        if branches is None:
            return None
        up, down = (self._chained_pose(branch, at_ns, goes_on) for branch in branches)
        if up is None or down is None:
            return None
        return down.inverse() @ up

    def _branches(self, parent: str, child: str) -> tuple[list[str], list[str]] | None:
        """Frames from ``child`` and from ``parent`` up to their common ancestor (exclusive)."""
        from_child, from_parent = self._ancestors(child), self._ancestors(parent)
        if from_child is None or from_parent is None:
            return None
        known = set(from_parent)
        for index, frame in enumerate(from_child):
            if frame in known:
                return from_child[:index], from_parent[: from_parent.index(frame)]
        return None

    def _ancestors(self, frame: str) -> list[str] | None:
        found = [frame]
        while (edge := self._edges.get(found[-1])) is not None:
            if len(found) > _LONGEST_CHAIN:
                return None
            found.append(edge.parent_frame)
        return found

    def _chained_pose(self, branch: list[str], at_ns: int | None, goes_on: frozenset[str]) -> Pose3D | None:
        pose = AT_ORIGIN
        for frame in branch:
            edge = self._edges[frame]
            step: Pose3D | None = edge.newest
            if at_ns is not None and edge.history is not None:
                step = edge.history.at(at_ns, goes_on=frame in goes_on)
            if step is None:
                return None
            pose = step @ pose
        return pose


class PoseTracker:
    """Computes the robot's pose in the map on news, at most about 20 times per second.

    Transforms take precedence while they arrive. Without them a pose topic is extended by odometry: localizers such as
    amcl publish the pose only when the robot has moved.
    """

    def __init__(self, frames: TransformFrames) -> None:
        self._frames = TransformFrames(*(name.lstrip("/") for name in (frames.map, frames.odom, frames.base)))
        self.tree = TransformTree()
        self._goes_on = frozenset({self._frames.base})
        self._transforms_ns: int | None = None
        self._odometry: Odometry | None = None
        self._poses_in_odom: PoseHistory | None = None
        self._map_from_odom: Pose2D | None = None
        self._reported_ns = 0

    def add_transforms(self, transforms: Iterable[Transform], *, stamp_ns: int, static: bool) -> RobotPose | None:
        changed = self.tree.add(transforms, static=static)
        map_frame, base_frame = self._frames.map, self._frames.base
        if static or map_frame == base_frame or not self.tree.depends_on(map_frame, base_frame, changed):
            return None
        self._transforms_ns = stamp_ns
        if stamp_ns - self._reported_ns < _LEAST_PERIOD_NS:
            return None
        pose = self.tree.lookup(map_frame, base_frame)
        if pose is None:
            return None
        self._reported_ns = stamp_ns
        return RobotPose(stamp_ns, self.tree.newest_stamp_ns(map_frame, base_frame), pose)

    def add_pose(self, pose: RobotPose) -> RobotPose | None:
        if self._odometry is not None:
            then = None
            if self._poses_in_odom is not None and pose.robot_stamp_ns is not None:
                then = self._poses_in_odom.at(pose.robot_stamp_ns, goes_on=True)
            odom_from_base = self._odometry.pose_in_odom if then is None else then.floor
            self._map_from_odom = pose.pose_in_map @ odom_from_base.inverse()
        if self._transforms_are_live(pose.stamp_ns):
            return None
        self._reported_ns = pose.stamp_ns
        return pose

    def add_odometry(self, odometry: Odometry) -> RobotPose | None:
        self._odometry = odometry
        if odometry.robot_stamp_ns is not None:
            self._poses_in_odom = self._poses_in_odom or PoseHistory()
            self._poses_in_odom.add(odometry.robot_stamp_ns, Pose3D.on_floor(odometry.pose_in_odom))
        if self._map_from_odom is None or self._transforms_are_live(odometry.stamp_ns):
            return None
        if odometry.stamp_ns - self._reported_ns < _LEAST_PERIOD_NS:
            return None
        self._reported_ns = odometry.stamp_ns
        return RobotPose(odometry.stamp_ns, odometry.robot_stamp_ns, self._map_from_odom @ odometry.pose_in_odom)

    def map_from_base(self, *, robot_stamp_ns: int | None, now_ns: int) -> Pose2D | None:
        """Robot pose in the map at a robot time; None if unknown.

        ``now_ns`` is session time, to check whether transforms still arrive.
        """
        if self._transforms_are_live(now_ns):
            return self.tree.lookup(self._frames.map, self._frames.base, robot_stamp_ns, goes_on=self._goes_on)
        if self._map_from_odom is None or self._odometry is None:
            return None
        pose: Pose2D | None = self._odometry.pose_in_odom
        if robot_stamp_ns is not None and self._poses_in_odom is not None:
            then = self._poses_in_odom.at(robot_stamp_ns, goes_on=True)
            pose = None if then is None else then.floor
        return None if pose is None else self._map_from_odom @ pose

    def base_from(self, frame: str, robot_stamp_ns: int | None) -> Pose3D | None:
        """Mounting pose of a sensor at that time; None if the transforms lack it."""
        return self.tree.lookup_in_space(
            self._frames.base, frame.lstrip("/"), robot_stamp_ns
        ) or self.tree.lookup_in_space(self._frames.base, frame.lstrip("/"))

    def map_from(self, frame: str, robot_stamp_ns: int | None) -> Pose2D | None:
        """Frame in the map at that time, or else the newest; an empty name means the map itself."""
        name = frame.lstrip("/")
        if name in ("", self._frames.map):
            return Pose2D(0.0, 0.0, 0.0)
        return self.tree.lookup(self._frames.map, name, robot_stamp_ns) or self.tree.lookup(self._frames.map, name)

    def unknown_frame(self, frame: str) -> str:
        """Reason why ``frame`` is unknown, with similar names, for the wizard. No full stop."""
        name = frame.lstrip("/")
        alike = [known for known in self.tree.frames if known.rsplit("/", 1)[-1] == name.rsplit("/", 1)[-1] != ""]
        values = {"base": self._frames.base, "frame": repr(name)}
        if not alike or name in alike:
            return localized(QT_TR_NOOP("The robot has no transform from {base} to {frame}"), **values)
        return localized(
            QT_TR_NOOP("The robot has no transform from {base} to {frame}; similar frames: {alike}"),
            **values,
            alike=", ".join(sorted(alike)[:3]),
        )

    def forget(self) -> None:
        """Reset on link loss."""
        self.tree = TransformTree()
        self._transforms_ns = None
        self._odometry = None
        self._poses_in_odom = None
        self._map_from_odom = None

    def _transforms_are_live(self, now_ns: int) -> bool:
        return self._transforms_ns is not None and now_ns - self._transforms_ns < _TRANSFORMS_LIVE_NS
