"""From transforms, poses and odometry to the robot's place in the map."""

import pytest

from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import Odometry, RobotPose
from caris_desktop.robot.localization import PoseTracker, TransformTree
from caris_desktop.robot.profile import TransformFrames
from caris_desktop.ros.messages import Transform

STEP_NS = 100_000_000


def odometry(at: int, x_m: float) -> Odometry:
    return Odometry(at * STEP_NS, None, Pose2D(x_m, 0.0, 0.0), Twist2D())


def test_a_chain_of_frames_is_composed() -> None:
    tree = TransformTree()
    tree.add(
        [
            Transform("base_link", "mast", Pose2D(0.1, 0.0, 0.0), None),
            Transform("mast", "laser", Pose2D(0.2, 0.0, 3.0), None),
        ]
    )
    mounted = tree.lookup("base_link", "laser")
    assert mounted is not None
    assert (mounted.x_m, mounted.heading_rad) == (pytest.approx(0.3), 3.0)
    assert tree.lookup("base_link", "camera") is None


def test_a_circle_of_frames_ends() -> None:
    tree = TransformTree()
    tree.add([Transform("a", "b", Pose2D(0, 0, 0), None), Transform("b", "a", Pose2D(0, 0, 0), None)])
    assert tree.lookup("map", "a") is None


def test_transforms_win_over_the_pose_topic_while_they_come() -> None:
    tracker = PoseTracker(TransformFrames())
    tracker.take_transforms([Transform("map", "odom", Pose2D(1.0, 0.0, 0.0), 7)], stamp_ns=STEP_NS, static=False)
    pose = tracker.take_transforms(
        [Transform("odom", "base_link", Pose2D(2.0, 0.0, 0.0), 9)], stamp_ns=2 * STEP_NS, static=False
    )
    assert pose == RobotPose(2 * STEP_NS, 9, Pose2D(3.0, 0.0, 0.0))
    assert tracker.take_pose(RobotPose(3 * STEP_NS, None, Pose2D(50.0, 0.0, 0.0))) is None
    late = RobotPose(20 * STEP_NS, None, Pose2D(50.0, 0.0, 0.0))
    assert tracker.take_pose(late) == late


def test_odometry_carries_a_rare_pose_on() -> None:
    tracker = PoseTracker(TransformFrames())
    assert tracker.take_odometry(odometry(1, 10.0)) is None
    told = RobotPose(2 * STEP_NS, None, Pose2D(1.0, 1.0, 0.0))
    assert tracker.take_pose(told) == told
    carried = tracker.take_odometry(odometry(3, 10.5))
    assert carried is not None
    assert carried.pose_in_map == Pose2D(1.5, 1.0, 0.0)


def test_after_a_lost_link_nothing_old_is_carried_on() -> None:
    tracker = PoseTracker(TransformFrames())
    tracker.take_odometry(odometry(1, 10.0))
    tracker.take_pose(RobotPose(2 * STEP_NS, None, Pose2D(1.0, 1.0, 0.0)))
    tracker.forget()
    assert tracker.take_odometry(odometry(3, 10.5)) is None
