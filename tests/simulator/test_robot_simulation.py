"""Complete robot simulation: lease, goals, people, emergency stop, and reproducible runs."""

import itertools
import math
from typing import Any

import numpy as np
import pytest

from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.simulator import simulated_navigation
from caris_desktop.simulator.floor_plan import PLACES
from caris_desktop.simulator.robot_simulation import Robot
from caris_desktop.simulator.simulated_base import STEP_S
from caris_desktop.simulator.simulated_navigation import GoalEnded

POSES = {place.name: place.pose for place in PLACES}


def run(robot: Robot, seconds: float) -> list[GoalEnded]:
    ended = []
    for _ in range(round(seconds / STEP_S)):
        robot.step()
        ended += robot.take_ended_goals()
    return ended


def run_until_goals_end(robot: Robot, *, most_s: float = 120.0) -> list[GoalEnded]:
    for _ in range(round(most_s / STEP_S)):
        robot.step()
        if ended := robot.take_ended_goals():
            return ended
    return []


def test_without_a_command_for_half_a_second_it_stops_automatically() -> None:
    robot = Robot(seed=1)
    robot.drive(Twist2D(0.0, 0.0, 1.0))
    run(robot, 0.48)
    assert robot.truth.turn_radps == pytest.approx(1.0)
    run(robot, 0.2)
    assert robot.truth.turn_radps == 0.0


@pytest.mark.long
def test_the_same_seed_repeats_a_run_and_another_does_not() -> None:
    def trace(seed: int) -> list[Any]:
        robot = Robot(seed)
        seen = []
        for step in range(600):
            if step % 10 == 0:
                robot.drive(Twist2D(0.2, 0.0, 0.3 * math.sin(step / 50)))
            robot.step()
            if step % 100 == 0:
                seen.append((robot.truth, robot.scan(stamp_ns=0).ranges_m.tolist(), robot.people, robot.pose_in_map))
        return seen

    assert trace(5) == trace(5)
    assert trace(5) != trace(6)


@pytest.mark.long("exhibition", "counselling room")
@pytest.mark.parametrize("name", ["lab bench", "counselling room", "exhibition"])
def test_a_goal_is_reached(name: str) -> None:
    robot = Robot(seed=1)
    run(robot, 3.0)
    assert robot.go("g", POSES[name])
    first = robot.navigation.progress(robot.now_s)
    assert first is not None
    assert first.distance_left_m > 2.0
    (ended,) = run_until_goals_end(robot)
    assert (ended.goal_id, ended.ending) == ("g", "reached")
    here = robot.truth.pose_in_map
    assert math.dist((here.x_m, here.y_m), (POSES[name].x_m, POSES[name].y_m)) < 0.12
    assert abs(math.remainder(here.heading_rad - POSES[name].heading_rad, 2 * math.pi)) < 0.1
    assert robot.truth.collisions == 0


def test_a_goal_inside_a_wall_is_refused() -> None:
    robot = Robot(seed=1)
    robot.go("g", Pose2D(-3.0, 5.0, 0.0))
    assert run(robot, 0.1) == [GoalEnded("g", "aborted", "there is no path to the goal")]


def test_a_newer_goal_takes_the_place_of_the_older() -> None:
    robot = Robot(seed=1)
    robot.go("first", POSES["kitchen"])
    run(robot, 1.0)
    robot.go("second", POSES["entrance"])
    assert [(goal.goal_id, goal.ending) for goal in run(robot, 0.1)] == [("first", "preempted")]
    assert robot.navigation.goal_id == "second"


def test_driving_by_hand_ends_a_goal_and_a_zero_twist_does_not() -> None:
    robot = Robot(seed=1)
    robot.go("g", POSES["kitchen"])
    robot.drive(Twist2D())
    assert run(robot, 1.0) == []
    robot.drive(Twist2D(0.1))
    assert [goal.ending for goal in run(robot, 0.1)] == ["aborted"]


def test_cancelling_stops_at_once() -> None:
    robot = Robot(seed=1)
    robot.go("g", POSES["corridor"])
    run(robot, 4.0)
    robot.cancel_goal()
    assert [goal.ending for goal in run(robot, 0.3)] == ["cancelled"]
    assert robot.truth.forward_mps == 0.0


def test_the_emergency_stop_stops_and_refuses_until_it_is_cleared() -> None:
    robot = Robot(seed=1)
    robot.go("g", POSES["corridor"])
    run(robot, 4.0)
    robot.set_emergency_stop(True)
    assert [goal.ending for goal in run(robot, 0.3)] == ["aborted"]
    assert not robot.go("again", POSES["corridor"])
    robot.drive(Twist2D(0.5))
    run(robot, 0.3)
    assert robot.truth.forward_mps == 0.0
    robot.set_emergency_stop(False)
    robot.drive(Twist2D(0.0, 0.0, 0.5))
    run(robot, 0.3)
    assert robot.truth.turn_radps > 0.3


@pytest.mark.long
def test_a_visitor_comes_up_to_the_robot_and_leaves_again() -> None:
    robot = Robot(seed=1)

    def distance_m() -> float:
        here, visitor = robot.truth.pose_in_map, robot.people[0]
        return math.dist((here.x_m, here.y_m), (visitor.x_m, visitor.y_m))

    assert 2.5 < distance_m() < 6.0
    run(robot, 8.0)
    assert 1.5 < distance_m() < 2.6
    run(robot, 40.0)
    assert 1.5 < distance_m() < 2.6
    farthest = 0.0
    for _ in range(90):
        run(robot, 1.0)
        farthest = max(farthest, distance_m())
    assert farthest > 2.7


@pytest.mark.long
def test_people_walk_and_stop_without_walking_through_anything() -> None:
    robot = Robot(seed=2)
    travelled = np.zeros(3)
    stood = np.zeros(3, dtype=bool)
    last = [(person.x_m, person.y_m) for person in robot.people]
    for _ in range(1200):
        run(robot, 0.1)
        now = [(person.x_m, person.y_m) for person in robot.people]
        moved = np.array([math.dist(a, b) for a, b in zip(last, now, strict=True)])
        assert moved.max() < 0.2
        assert min(simulated_navigation.clearance_m(*place) for place in now) > 0.2
        travelled += moved
        stood |= moved == 0.0
        last = now
    assert travelled.min() > 3.0
    assert stood.all()


def test_paths_keep_their_distance() -> None:
    way = simulated_navigation.plan((1.0, 1.3), (14.75, 2.0), body_m=0.35)
    assert way is not None
    for a, b in itertools.pairwise(way):
        for share in np.linspace(0.0, 1.0, 20):
            x, y = a[0] + (b[0] - a[0]) * share, a[1] + (b[1] - a[1]) * share
            assert simulated_navigation.clearance_m(x, y) > 0.27
    around = simulated_navigation.plan((3.0, 5.0), (9.0, 5.0), body_m=0.35, avoid=np.array([[6.0, 5.3, 0.2]]))
    assert around is not None
    assert min(math.dist(point, (6.0, 5.3)) for point in around) > 0.5
    assert simulated_navigation.plan((1.0, 1.3), (7.0, 8.3), body_m=0.35, give_way_m=0.3) is None
    assert simulated_navigation.plan((1.0, 1.3), (99.0, 99.0), body_m=0.35) is None
