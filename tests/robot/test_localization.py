"""Position of the robot in the map from transforms, poses and odometry."""

import math

import pytest

from caris_desktop.domain.geometry import Pose2D, Pose3D, Twist2D
from caris_desktop.domain.sensing import Odometry, RobotPose
from caris_desktop.robot.localization import MOST_FRAMES, PoseHistory, PoseTracker, TransformTree
from caris_desktop.robot.profile_model import TransformFrames
from caris_desktop.ros.message_conversion import Transform

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
    tracker.add_transforms([Transform("map", "odom", Pose2D(1.0, 0.0, 0.0), 7)], stamp_ns=STEP_NS, static=False)
    pose = tracker.add_transforms(
        [Transform("odom", "base_link", Pose2D(2.0, 0.0, 0.0), 9)], stamp_ns=2 * STEP_NS, static=False
    )
    assert pose == RobotPose(2 * STEP_NS, 9, Pose2D(3.0, 0.0, 0.0))
    assert tracker.add_pose(RobotPose(3 * STEP_NS, None, Pose2D(50.0, 0.0, 0.0))) is None
    late = RobotPose(20 * STEP_NS, None, Pose2D(50.0, 0.0, 0.0))
    assert tracker.add_pose(late) == late


def test_odometry_carries_a_rare_pose_on() -> None:
    tracker = PoseTracker(TransformFrames())
    assert tracker.add_odometry(odometry(1, 10.0)) is None
    told = RobotPose(2 * STEP_NS, None, Pose2D(1.0, 1.0, 0.0))
    assert tracker.add_pose(told) == told
    carried = tracker.add_odometry(odometry(3, 10.5))
    assert carried is not None
    assert carried.pose_in_map == Pose2D(1.5, 1.0, 0.0)


def test_after_a_lost_link_nothing_old_is_carried_on() -> None:
    tracker = PoseTracker(TransformFrames())
    tracker.add_odometry(odometry(1, 10.0))
    tracker.add_pose(RobotPose(2 * STEP_NS, None, Pose2D(1.0, 1.0, 0.0)))
    tracker.forget()
    assert tracker.add_odometry(odometry(3, 10.5)) is None


def moving(stamps_and_headings: dict[int, float], *, child: str = "base_link") -> list[Transform]:
    return [
        Transform("odom", child, Pose2D(float(stamp), 0.0, heading), stamp * STEP_NS)
        for stamp, heading in stamps_and_headings.items()
    ]


def test_between_two_samples_a_frame_is_where_tf2_puts_it() -> None:
    tree = TransformTree()
    tree.add(moving({1: 3.0, 3: -3.0, 2: 3.1}))  # out of order, and across the wrap from pi to -pi
    between = tree.lookup("odom", "base_link", 2 * STEP_NS + STEP_NS // 2)
    assert between is not None
    assert between.x_m == pytest.approx(2.5)
    assert abs(between.heading_rad) == pytest.approx(math.pi - 0.05, abs=0.05)
    assert tree.lookup("odom", "base_link", STEP_NS - 1) is None
    newest = tree.lookup("odom", "base_link", 9 * STEP_NS)
    assert newest == Pose2D(3.0, 0.0, -3.0)
    goes_on = tree.lookup("odom", "base_link", 4 * STEP_NS, goes_on=frozenset({"base_link"}))
    assert goes_on is not None
    assert goes_on.x_m == pytest.approx(4.0)
    far = tree.lookup("odom", "base_link", 90 * STEP_NS, goes_on=frozenset({"base_link"}))
    assert far is not None
    assert far.x_m == pytest.approx(5.0), "for 0.2 s and no longer"


def test_frames_that_share_an_ancestor_are_found_from_one_another() -> None:
    tree = TransformTree()
    tree.add([Transform("base_footprint", "base_link", Pose2D(0.0, 0.0, math.pi / 2), None)], static=True)
    tree.add([Transform("base_footprint", "laser", Pose2D(1.0, 0.0, 0.0), None)], static=True)
    mounted = tree.lookup("base_link", "laser")
    assert mounted is not None
    assert (mounted.x_m, mounted.y_m) == (pytest.approx(0.0), pytest.approx(-1.0))
    assert tree.lookup("laser", "laser") == Pose2D(0.0, 0.0, 0.0)


def test_memory_is_bounded_in_time_in_samples_and_in_frames() -> None:
    history = PoseHistory()
    for number in range(20_000):
        history.add(number * 1_000_000, Pose2D(float(number), 0.0, 0.0))
    assert history.at(19_999_000_000 - 500_000_000) == Pose2D(19_499.0, 0.0, 0.0)
    assert history.at(1_000_000_000) is None
    assert len(history._poses) < 1_400
    tree = TransformTree()
    tree.add([Transform(f"p{number}", f"c{number}", Pose2D(0, 0, 0), number) for number in range(10_000)])
    assert len(tree.frames) <= 2 * MOST_FRAMES


def test_a_clock_that_is_set_back_begins_again() -> None:
    tree = TransformTree()
    tree.add(moving({1000: 0.0}))
    tree.add(moving({1: 0.0}))
    assert tree.lookup("odom", "base_link", STEP_NS) == Pose2D(1.0, 0.0, 0.0)
    # A stamp far in the future must not invalidate all later ones.
    tree.add(moving({10**8: 0.0}))
    tree.add(moving({2: 0.0, 3: 0.0}))
    assert tree.lookup("odom", "base_link", 2 * STEP_NS) == Pose2D(2.0, 0.0, 0.0)


def test_a_frame_that_changes_its_parent_forgets_where_it_was() -> None:
    tree = TransformTree()
    tree.add(moving({1: 0.0, 2: 0.0}))
    tree.add([Transform("map", "base_link", Pose2D(7.0, 0.0, 0.0), 3 * STEP_NS)])
    assert tree.lookup("odom", "base_link") is None
    assert tree.lookup("map", "base_link", STEP_NS) is None
    assert tree.lookup("map", "base_link") == Pose2D(7.0, 0.0, 0.0)


def test_a_slow_localizer_is_joined_with_the_odometry_of_its_own_moment() -> None:
    tracker = PoseTracker(TransformFrames())
    for at in range(1, 11):
        tracker.add_odometry(Odometry(at * STEP_NS, at * STEP_NS, Pose2D(float(at), 0.0, 0.0), Twist2D()))
    # Received now, with a stamp of half a second ago.
    tracker.add_pose(RobotPose(10 * STEP_NS, 5 * STEP_NS, Pose2D(0.0, 50.0, 0.0)))
    carried = tracker.add_odometry(Odometry(11 * STEP_NS, 11 * STEP_NS, Pose2D(11.0, 0.0, 0.0), Twist2D()))
    assert carried is not None
    assert carried.pose_in_map == Pose2D(6.0, 50.0, 0.0)
    then = tracker.map_from_base(robot_stamp_ns=7 * STEP_NS + STEP_NS // 2, now_ns=11 * STEP_NS)
    assert then is not None
    assert (then.x_m, then.y_m) == (pytest.approx(2.5), 50.0)


def test_names_of_frames_may_have_an_old_leading_slash() -> None:
    tracker = PoseTracker(TransformFrames(map="/map", odom="/odom", base="/base_link"))
    told = tracker.add_transforms(
        [Transform("map", "base_link", Pose2D(1.0, 0.0, 0.0), 9)], stamp_ns=STEP_NS, static=False
    )
    assert told is not None
    assert tracker.base_from("/nowhere", None) is None
    assert "'nowhere'" in tracker.unknown_frame("/nowhere")


@pytest.mark.parametrize("step_s", [0.3, 1.0, 9.0, 11.0, 3600.0])
def test_the_pose_continues_when_the_robot_s_clock_is_set_back(step_s: float) -> None:
    """Data of ``cases/clock_jump``: 20 transforms a second at 0.3 m/s, and NTP sets the clock back after 10 s."""
    tracker = PoseTracker(TransformFrames("map", "odom", "base_link"))
    shown_m: dict[int, float] = {}
    scanned_m: dict[int, float] = {}
    for step in range(400):
        stamp_ns = round((4000.0 + step / 20 - (step_s if step > 200 else 0.0)) * 1e9)
        told = [
            Transform("map", "odom", Pose2D(0.0, 0.0, 0.0), stamp_ns),
            Transform("odom", "base_link", Pose2D(0.015 * step, 0.0, 0.0), stamp_ns),
        ]
        pose = tracker.add_transforms(told, stamp_ns=step * STEP_NS, static=False)
        shown_m[step] = pose.pose_in_map.x_m if pose else math.nan
        scanned = tracker.map_from_base(robot_stamp_ns=stamp_ns, now_ns=step * STEP_NS)
        scanned_m[step] = scanned.x_m if scanned else math.nan
    for step in (200, *range(203, 400)):
        assert (shown_m[step], scanned_m[step]) == pytest.approx((0.015 * step, 0.015 * step), abs=1e-6), step


def test_one_that_comes_out_of_order_or_with_a_stray_stamp_costs_nothing() -> None:
    history = PoseHistory()
    for stamp in (1, 2, 4, 3, 5, 900, 6, 7):
        history.add(stamp * STEP_NS, Pose3D.on_floor(Pose2D(float(stamp), 0.0, 0.0)))
    assert history.newest_ns == 7 * STEP_NS
    before = history.at(2 * STEP_NS + STEP_NS // 2)
    assert before is not None
    assert before.x_m == pytest.approx(2.5)
