"""Obstacle guard on synthetic scans in simulated time."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.domain.events import GuardChanged
from caris_desktop.domain.geometry import ZERO_TWIST, Pose2D, Twist2D, moved_by
from caris_desktop.domain.sensing import LaserScan, Odometry
from caris_desktop.robot.guard import (
    CRAWL_MPS,
    MEMORY_S,
    Footprint,
    GuardChangeDetector,
    GuardLimit,
    ObstacleGuard,
    convex_hull,
    transformed,
)
from caris_desktop.robot.profile_model import FloorOutline, GuardSettings, MotionLimits, RobotProfile, TopicSource
from tests.support.yardstick import in_yardsticks

AHEAD, BACK, LEFT = Twist2D(0.5), Twist2D(-0.3), Twist2D(0.0, 0.3)
TURN = Twist2D(0.0, 0.0, 1.0)
PROFILE = RobotProfile(
    "test",
    "Test",
    scan=TopicSource("/scan"),
    limits=MotionLimits(forward_mps=0.5, backward_mps=0.3, left_mps=0.3),
    guard=GuardSettings(stop_distance_m=0.12, reaction_s=0.35),
    footprint=FloorOutline(0.25),
)
BOX = ((-0.3, -0.2), (0.3, -0.2), (0.3, 0.2), (-0.3, 0.2))
T = 100.0


def scan(
    sees: Callable[[NDArray[np.float64]], NDArray[np.float64]] | dict[float, float] | None = None,
    *,
    at_s: float = T,
    field_rad: float = 2.0 * math.pi,
) -> LaserScan:
    """Scan of 720 beams; ``sees`` gives ranges by angle, or single readings by degree; other beams return nothing."""
    count = 720
    increment = field_rad / count
    angles = -field_rad / 2.0 + increment * np.arange(count)
    ranges = np.full(count, np.inf)
    if isinstance(sees, dict):
        for degree, range_m in sees.items():
            ranges[int(np.abs(angles - math.radians(degree)).argmin())] = range_m
    elif sees is not None:
        ranges = sees(angles)
    at_ns, laser = round(at_s * 1e9), Pose2D(0.0, 0.0, 0.0)
    return LaserScan(at_ns, None, "laser", -field_rad / 2.0, increment, 0.05, 12.0, ranges.astype(np.float32), laser)


def wall_ahead(distance_m: float) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Infinite wall across the path, at this distance from the LIDAR."""
    return lambda angles: np.where(np.cos(angles) > 0.05, distance_m / np.maximum(np.cos(angles), 0.05), np.inf)


def wall_beside(distance_m: float) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Infinite wall along the left side."""
    return lambda angles: np.where(np.sin(angles) > 0.05, distance_m / np.maximum(np.sin(angles), 0.05), np.inf)


def guard_with(profile: RobotProfile = PROFILE, *scans: LaserScan) -> ObstacleGuard:
    guard = ObstacleGuard(profile)
    for each in scans or (scan(),):
        guard.add_scan(each)
    return guard


def odometry(at_s: float, pose: Pose2D, twist: Twist2D = ZERO_TWIST) -> Odometry:
    return Odometry(round(at_s * 1e9), None, pose, twist)


# Swept footprint


def _first_touch_s(
    footprint: Footprint, points: NDArray[np.float64], twist: Twist2D, margin_m: float
) -> NDArray[np.float64]:
    first_s = np.full(len(points), np.inf)
    for time_s in np.arange(6.0, 0.0, -0.005):
        seen_from_robot = transformed(moved_by(twist, float(time_s)).inverse(), points)
        first_s[footprint.gap_m(seen_from_robot) < margin_m] = time_s
    return first_s


def _motions() -> Iterator[tuple[Footprint, Twist2D, float]]:
    chance = np.random.default_rng(7)
    for number in range(24):
        corners = [tuple(corner) for corner in chance.uniform(-0.4, 0.4, (int(chance.integers(4, 9)), 2)).tolist()]
        footprint = Footprint(radius_m=0.25, corners_m=corners if number % 2 else ())
        forward, left, turn = chance.uniform(-1.0, 1.0, 3).tolist()
        kind = number % 4
        twist = (Twist2D(forward), Twist2D(0, 0, turn), Twist2D(forward, left), Twist2D(forward, left, turn))[kind]
        yield footprint, twist, (0.0, 0.05, 0.2)[number % 3]


@pytest.mark.long
def test_the_moment_of_contact_is_that_of_driving_in_small_steps() -> None:
    chance = np.random.default_rng(3)
    compared = 0
    for footprint, twist, margin_m in _motions():
        points = chance.uniform(-1.2, 1.2, (40, 2))
        points = points[footprint.gap_m(points) > margin_m + 0.01]
        contact_s = footprint.contact_s(points, twist, margin_m=margin_m)
        stepped_s = _first_touch_s(footprint, points, twist, margin_m)
        met = np.isfinite(stepped_s)
        np.testing.assert_allclose(contact_s[met], stepped_s[met], atol=0.01)
        # Small steps may miss a grazing contact.
        grazed = np.isfinite(_first_touch_s(footprint, points, twist, margin_m + 0.003))
        assert (contact_s[~met & ~grazed] > 5.99).all()
        compared += int(met.sum())
    assert compared > 60


def test_a_box_touches_with_its_corner_when_it_turns_on_the_spot() -> None:
    box = Footprint(radius_m=0.3, corners_m=BOX)
    [contact_s] = box.contact_s(np.array([[0.0, 0.3]]), TURN)
    # The corner (0.3, 0.2) is farther out than 0.3 m; the side before it arrives where x = sqrt(0.3^2 - 0.2^2).
    assert contact_s == pytest.approx(math.pi / 2 - math.acos(math.sqrt(0.3**2 - 0.2**2) / 0.3))
    assert math.isinf(Footprint(radius_m=0.25).contact_s(np.array([[0.0, 0.26]]), TURN)[0])


def test_the_hull_of_an_outline_with_a_dent_is_used() -> None:
    assert convex_hull([(0, 0), (1, 0), (0.5, 0.2), (1, 1), (0, 1)]) == ((0, 0), (1, 0), (1, 1), (0, 1))


# Permitted speed


def test_nothing_near_allows_everything() -> None:
    assert guard_with().limit(AHEAD, T) == GuardLimit(1.0, "clear")


def test_from_the_allowed_speed_the_robot_stops_with_the_stop_distance_left() -> None:
    for gap_m in (0.25, 0.3, 0.4):
        guard = guard_with(PROFILE, scan(wall_ahead(0.25 + gap_m)))
        limit = guard.limit(AHEAD, T)
        speed_mps = limit.fraction * AHEAD.forward_mps
        way_m = speed_mps * 0.35 + speed_mps**2 / (2.0 * PROFILE.limits.deceleration_mps2)
        assert limit.state == "slowing"
        assert limit.distance_m == pytest.approx(gap_m, abs=0.01)
        assert 0.12 <= gap_m - way_m <= 0.12 + 0.1, "and not much more than that"


def test_close_to_a_wall_it_stops_but_leaves_backwards_and_turns_on_the_spot() -> None:
    for gap_m in (0.0, 0.02, 0.1):
        guard = guard_with(PROFILE, scan(wall_ahead(0.25 + gap_m)))
        assert guard.limit(AHEAD, T).fraction == 0.0
        assert guard.limit(AHEAD, T).state == "blocked"
        assert guard.limit(BACK, T) == GuardLimit(1.0, "clear")
        assert guard.limit(TURN, T).fraction == 1.0


def test_a_wall_that_reaches_into_the_footprint_still_lets_the_robot_leave() -> None:
    guard = guard_with(PROFILE, scan(wall_ahead(0.22)))
    assert guard.limit(AHEAD, T).fraction == 0.0
    assert guard.limit(BACK, T).fraction == 1.0


def test_a_wall_alongside_blocks_only_the_strafe_into_it() -> None:
    guard = guard_with(PROFILE, scan(wall_beside(0.35)))
    assert guard.limit(AHEAD, T).fraction == 1.0
    assert guard.limit(Twist2D(0.0, -0.3), T).fraction == 1.0
    assert guard.limit(LEFT, T).fraction == 0.0
    assert guard.limit(Twist2D(0.3, 0.0, 1.0), T).fraction < 0.5, "an arc into it"


def test_the_arc_is_retained() -> None:
    guard = guard_with(PROFILE, scan(wall_ahead(0.5)))
    limit = guard.limit(Twist2D(0.5, 0.0, 0.4), T)
    assert 0.0 < limit.fraction < 1.0


def test_a_box_in_a_gap_that_it_fits_into_drives_but_does_not_turn() -> None:
    profile = replace(PROFILE, footprint=FloorOutline(polygon_m=BOX))
    narrow = scan(lambda angles: 0.28 / np.maximum(np.abs(np.sin(angles)), 0.02))
    guard = guard_with(profile, narrow)
    assert guard.limit(AHEAD, T).fraction == 1.0
    assert guard.limit(TURN, T).fraction < 0.3


def test_legs_get_more_room_than_the_end_of_a_wall() -> None:
    def round_leg(angles: NDArray[np.float64]) -> NDArray[np.float64]:
        beside = 0.7 * np.sin(angles)
        reach = np.sqrt(np.maximum(0.06**2 - beside**2, 0.0))
        return np.where((np.abs(beside) < 0.06) & (np.cos(angles) > 0), 0.7 * np.cos(angles) - reach, np.inf)

    def flat_end(angles: NDArray[np.float64]) -> NDArray[np.float64]:
        beside = 0.64 * np.tan(angles)
        return np.where((np.abs(beside) < 0.06) & (np.cos(angles) > 0), 0.64 / np.cos(angles), np.inf)

    leg, end = guard_with(PROFILE, scan(round_leg)), guard_with(PROFILE, scan(flat_end))
    assert leg.limit(AHEAD, T).fraction < end.limit(AHEAD, T).fraction - 0.1


def test_the_latency_of_the_network_is_added() -> None:
    guard = guard_with(PROFILE, scan(wall_ahead(0.25 + 0.35)))
    before = guard.limit(AHEAD, T).fraction
    guard.add_round_trip(0.3)
    assert guard.limit(AHEAD, T).fraction < 0.7 * before


# Known and unknown areas


def test_without_a_lidar_in_the_profile_there_is_no_guard() -> None:
    assert ObstacleGuard(replace(PROFILE, scan=None)).limit(AHEAD, T) == GuardLimit(1.0, "absent")


def test_without_a_fresh_scan_speed_is_capped_at_thirty_percent_of_the_robots_own() -> None:
    guard = ObstacleGuard(PROFILE)
    assert guard.limit(AHEAD, T).state == "blind"
    guard.add_scan(scan())
    assert guard.limit(AHEAD, T + 0.45).state == "clear"
    late = guard.limit(AHEAD, T + 0.6)
    assert (late.state, late.fraction) == ("blind", pytest.approx(0.3))
    assert guard.limit(Twist2D(0.1), T + 0.6).fraction == 1.0, "slow enough already"
    assert guard.limit(ZERO_TWIST, T + 0.6).state == "blind", "also while nothing moves"


def test_a_slow_lidar_is_stale_after_three_of_its_periods() -> None:
    guard = guard_with(PROFILE, *(scan(at_s=T + 0.4 * number) for number in range(8)))
    assert not guard.stale(T + 0.4 * 7 + 1.1)
    assert guard.stale(T + 0.4 * 7 + 1.3)


def test_a_wall_seen_before_the_scans_ended_still_blocks() -> None:
    guard = guard_with(PROFILE, scan(wall_ahead(0.3)))
    assert guard.limit(AHEAD, T + 1.0).fraction == 0.0
    assert guard.limit(AHEAD, T + MEMORY_S + 0.1) == GuardLimit(
        pytest.approx(0.3), "blind", None, "no fresh scan from the LIDAR"
    )


def test_overridden_it_lets_everything_pass_but_not_fast_without_scans() -> None:
    guard = guard_with(PROFILE, scan(wall_ahead(0.3)))
    guard.switch(on=False)
    assert guard.limit(AHEAD, T) == GuardLimit(1.0, "overridden")
    assert guard.limit(AHEAD, T + 1.0).fraction == pytest.approx(0.3)
    guard.forget()
    assert guard.on, "each connection begins with it on"


def test_motion_since_the_scan_counts() -> None:
    guard = ObstacleGuard(PROFILE)
    guard.add_odometry(odometry(T, Pose2D(5.0, 1.0, 0.0), Twist2D(0.5)))
    guard.add_scan(scan(wall_ahead(0.8)))
    before = guard.limit(AHEAD, T)
    guard.add_odometry(odometry(T + 0.3, Pose2D(5.15, 1.0, 0.0), Twist2D(0.5)))
    after = guard.limit(AHEAD, T + 0.4)
    assert before.distance_m == pytest.approx(0.55, abs=0.01)
    assert after.distance_m == pytest.approx(0.35, abs=0.01), "0.15 m told, and 0.05 m since"


def test_odometry_that_waited_for_its_turn_is_carried_on_from_when_it_arrived() -> None:
    guard = ObstacleGuard(PROFILE)
    guard.add_odometry(odometry(T, Pose2D(0.0, 0.0, 0.0), Twist2D(0.5)))
    guard.add_scan(scan(wall_ahead(0.8)))
    guard.limit(AHEAD, T + 0.3)
    guard.add_odometry(odometry(T + 0.2, Pose2D(0.1, 0.0, 0.0), Twist2D(0.5)))
    assert guard.limit(AHEAD, T + 0.3).distance_m == pytest.approx(0.4, abs=0.01)


def test_without_odometry_the_velocities_that_were_sent_count() -> None:
    guard = guard_with(PROFILE, scan(wall_ahead(0.8)))
    guard.note_sent(Twist2D(0.5), T)
    assert guard.limit(AHEAD, T + 0.4).distance_m == pytest.approx(0.35, abs=0.01)


def test_a_late_scan_is_placed_where_the_robot_was_when_it_was_taken() -> None:
    guard = ObstacleGuard(PROFILE)
    robot_ns = 50_000_000_000
    for step in range(5):
        pose = Pose2D(0.05 * step, 0.0, 0.0)
        at_s = T + 0.1 * step
        guard.add_odometry(Odometry(round(at_s * 1e9), robot_ns + step * 100_000_000, pose, Twist2D(0.5)))
    late = replace(scan(wall_ahead(0.8), at_s=T + 0.4), robot_stamp_ns=robot_ns + 100_000_000)
    guard.add_scan(late)
    assert guard.limit(AHEAD, T + 0.4).distance_m == pytest.approx(0.55 - 0.15, abs=0.01)


def _front_scan(at_s: float, **wall: float) -> LaserScan:
    """Scan of a LIDAR with a 180 degree field of view."""
    sees = wall_ahead(wall["wall_m"]) if "wall_m" in wall else None
    return scan(sees, at_s=at_s, field_rad=math.pi)


def test_without_a_beam_the_robot_crawls_and_reports_it() -> None:
    guard = guard_with(PROFILE, _front_scan(T))
    assert guard.limit(AHEAD, T).state == "clear"
    back = guard.limit(BACK, T)
    assert back.state == "blind"
    assert back.fraction * BACK.forward_mps == pytest.approx(-CRAWL_MPS)
    assert "LIDAR" in back.detail
    assert guard.limit(TURN, T).fraction == 1.0, "a disc that turns on the spot goes nowhere"


def test_a_covered_or_nonsensical_lidar_is_none() -> None:
    clear = guard_with(PROFILE, scan(at_s=T + 0.6))
    assert clear.limit(AHEAD, T + 0.6).state == "clear"
    zeros = scan(lambda angles: np.zeros(len(angles)), at_s=T + 0.6)
    nothing = replace(zeros, ranges_m=np.empty(0, np.float32))
    for useless in (zeros, nothing, replace(zeros, angle_increment_rad=0.0), replace(zeros, angle_min_rad=math.inf)):
        guard = guard_with(PROFILE, scan(), useless)
        assert guard.limit(AHEAD, T + 0.6).state == "blind"


def test_beams_that_never_look_are_no_sight() -> None:
    def without_a_sector(angles: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(np.abs(angles) < 0.5, np.nan, np.inf)

    assert guard_with(PROFILE, scan(without_a_sector)).limit(AHEAD, T).state == "blind"
    assert guard_with(PROFILE, scan({0.0: math.nan})).limit(AHEAD, T).state == "clear", "one beam is no gap"


def _turned_about(*, wall_m: float) -> tuple[ObstacleGuard, float]:
    """Guard of a robot with a front LIDAR after it turned its back to a wall within three seconds."""
    guard = ObstacleGuard(PROFILE)
    for step in range(31):
        at_s, heading = T + 0.1 * step, math.pi * step / 30
        guard.add_odometry(odometry(at_s, Pose2D(0.0, 0.0, heading), TURN if step < 30 else ZERO_TWIST))

        def sees(angles: NDArray[np.float64], heading: float = heading) -> NDArray[np.float64]:
            towards = np.cos(angles + heading)
            return np.where(towards > 0.05, wall_m / np.maximum(towards, 0.05), np.inf)

        guard.add_scan(scan(sees, at_s=at_s, field_rad=math.pi))
    return guard, T + 3.0


def test_obstacles_out_of_view_are_remembered_for_a_while() -> None:
    guard, now_s = _turned_about(wall_m=0.4)
    assert guard.limit(BACK, now_s).fraction == 0.0, "the wall behind is remembered"
    free, now_s = _turned_about(wall_m=2.5)
    assert free.limit(BACK, now_s).fraction == 1.0, "and so is the free room"
    later_s = now_s + MEMORY_S
    for step in range(int(MEMORY_S * 10) + 1):
        for each in (guard, free):
            each.add_odometry(odometry(now_s + 0.1 * step, Pose2D(0.0, 0.0, math.pi)))
            each.add_scan(_front_scan(now_s + 0.1 * step))
    assert guard.limit(BACK, later_s).state == "blind", "not for ever"
    assert free.limit(BACK, later_s).state == "blind"


def test_a_lidar_with_gaps_crawls_only_until_it_has_scanned_the_path() -> None:
    def three_sectors(angles: NDArray[np.float64]) -> NDArray[np.float64]:
        off = np.abs(angles)
        return np.where(((off > 0.45) & (off < 1.2)) | (off > 2.1), -1.0, np.inf)

    guard = ObstacleGuard(PROFILE)
    states = []
    for step in range(60):
        at_s, x_m = T + 0.1 * step, 0.01 * step
        guard.add_odometry(odometry(at_s, Pose2D(x_m, 0.0, 0.0), Twist2D(0.1)))
        guard.add_scan(scan(three_sectors, at_s=at_s))
        states.append(guard.limit(AHEAD, at_s).state)
    assert states[0] == "blind"
    assert states[-1] == "clear"


def test_obstacles_that_leave_in_view_are_forgotten_at_once() -> None:
    guard = guard_with(PROFILE, scan(wall_ahead(0.9)), scan(at_s=T + 0.1))
    assert guard.limit(AHEAD, T + 0.1) == GuardLimit(1.0, "clear")


def test_an_obstacle_too_near_to_be_measured_is_not_gone() -> None:
    guard = guard_with(PROFILE, scan(wall_ahead(0.3)), scan(at_s=T + 0.1))
    assert guard.limit(AHEAD, T + 0.1).fraction == 0.0


def test_a_robot_that_was_set_elsewhere_knows_nothing_of_the_old_place() -> None:
    guard = ObstacleGuard(PROFILE)
    guard.add_odometry(odometry(T, Pose2D(0.0, 0.0, 0.0)))
    guard.add_scan(scan(wall_ahead(0.3)))
    guard.add_odometry(odometry(T + 0.1, Pose2D(9.0, 0.0, 0.0)))
    assert guard.limit(AHEAD, T + 0.1).state != "blocked"


# Returns from the robot's body


def test_the_robots_own_parts_are_known_after_a_second_or_some_distance() -> None:
    post = {170.0: 0.15, -170.0: 0.15}
    guard = guard_with(PROFILE, scan(post))
    assert guard.limit(BACK, T).fraction == 0.0, "it might be something that is stuck there"
    for step in range(1, 12):
        guard.add_scan(scan(post, at_s=T + 0.1 * step))
    assert guard.limit(BACK, T + 1.1).fraction == 1.0

    near_the_edge = {180.0: 0.23}
    guard = ObstacleGuard(PROFILE)
    for step in range(40):
        guard.add_odometry(odometry(T + 0.1 * step, Pose2D(0.02 * step, 0.0, 0.0)))
        guard.add_scan(scan(near_the_edge, at_s=T + 0.1 * step))
        if step == 12:
            assert guard.limit(BACK, T + 1.2).fraction == 0.0, "an obstacle can be that deep, by the noise"
    assert guard.limit(BACK, T + 3.9).fraction == 1.0, "but none drives along"


def test_something_that_is_pushed_into_the_robot_is_not_its_own() -> None:
    guard = ObstacleGuard(PROFILE)
    for step in range(30):
        guard.add_scan(scan({0.0: 0.24 - 0.004 * (step % 10)}, at_s=T + 0.1 * step))
    assert guard.limit(AHEAD, T + 2.9).fraction == 0.0


# Reports


def test_changes_for_the_worse_are_reported_at_once_and_noise_is_not_reported() -> None:
    news = GuardChangeDetector()

    def told(at_s: float, limit: GuardLimit) -> GuardChanged | None:
        return news.of(limit, at_s, stamp_ns=1)

    assert told(0.0, GuardLimit(1.0, "clear")) is not None
    assert told(0.05, GuardLimit(1.0, "clear")) is None
    assert told(0.30, GuardLimit(0.5, "slowing", 0.4)) == GuardChanged(1, "slowing", 0.4)
    assert told(0.35, GuardLimit(1.0, "clear")) is None
    assert told(0.40, GuardLimit(0.5, "slowing", 0.4)) is None
    assert told(0.45, GuardLimit(0.0, "blocked", 0.1)) == GuardChanged(1, "blocked", 0.1)
    assert told(0.50, GuardLimit(1.0, "clear")) is None
    assert told(0.95, GuardLimit(1.0, "clear")) == GuardChanged(1, "clear", None)
    assert told(0.96, GuardLimit(1.0, "overridden")) == GuardChanged(1, "overridden", None)


def test_at_most_about_five_are_reported_in_a_second() -> None:
    news = GuardChangeDetector()
    limits = [GuardLimit(0.5, "slowing", 2.0 - 0.03 * step) for step in range(60)]
    told = [news.of(limit, 0.033 * step, stamp_ns=step) for step, limit in enumerate(limits)]
    assert len([one for one in told if one is not None]) <= 11


@pytest.mark.long
def test_a_scan_costs_little() -> None:
    chance = np.random.default_rng(1)
    cluttered = [scan(lambda angles: chance.uniform(0.3, 4.0, len(angles)), at_s=T + 0.1 * n) for n in range(20)]
    for footprint in (FloorOutline(0.25), FloorOutline(polygon_m=BOX)):
        guard = ObstacleGuard(replace(PROFILE, footprint=footprint))

        def watch(guard: ObstacleGuard = guard) -> None:
            for each in cluttered:
                guard.add_scan(each)
                guard.limit(Twist2D(0.5, 0.0, 0.7), each.stamp_ns / 1e9)

        cost = in_yardsticks(watch) / len(cluttered)
        print(f"scan and limit: {cost:.2f} yardsticks")
        assert cost < 5.0
