"""Simulated base: acceleration, braking and obstacles."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from caris_desktop.domain.geometry import ZERO_TWIST, Pose2D, Twist2D
from caris_desktop.simulator import simulated_base
from caris_desktop.simulator.floor_plan import FURNITURE, PLACES, START, WALLS
from caris_desktop.simulator.simulated_base import STEP_S, BaseState
from tests.support.examples import examples

NOBODY = np.zeros((0, 3))
CORRIDOR = BaseState(Pose2D(3.0, 5.0, 0.0))


def driven(state: BaseState, twist: Twist2D, seconds: float, people: np.ndarray = NOBODY) -> list[BaseState]:
    states = [state]
    for _ in range(round(seconds / STEP_S)):
        states.append(simulated_base.step(states[-1], twist, people))
    return states


def test_it_speeds_up_gently_and_brakes_hard() -> None:
    speeding_up = driven(CORRIDOR, Twist2D(0.5), 1.0)
    to_speed = next(i for i, state in enumerate(speeding_up) if state.forward_mps == pytest.approx(0.5)) * STEP_S
    braking = driven(speeding_up[-1], ZERO_TWIST, 1.0)
    to_stand = next(i for i, state in enumerate(braking) if state.forward_mps == 0.0) * STEP_S
    assert to_speed == pytest.approx(0.5, abs=0.03)
    assert to_stand == pytest.approx(0.1, abs=0.03)


def test_it_keeps_its_limits_and_never_moves_sideways() -> None:
    state = driven(CORRIDOR, Twist2D(9.0, 9.0, 0.0), 2.0)[-1]
    assert state.forward_mps == pytest.approx(simulated_base.MAX_FORWARD_MPS)
    assert state.pose_in_map.y_m == pytest.approx(5.0)
    assert driven(CORRIDOR, Twist2D(-9.0), 2.0)[-1].forward_mps == pytest.approx(-simulated_base.MAX_REVERSE_MPS)


def test_reversing_the_command_never_overshoots_through_zero() -> None:
    speeds = [s.forward_mps for s in driven(driven(CORRIDOR, Twist2D(0.4), 1.0)[-1], Twist2D(-0.4), 1.0)]
    assert speeds == sorted(speeds, reverse=True)
    assert 0.0 in speeds


def test_a_wall_stops_it_and_counts_once() -> None:
    end = driven(BaseState(Pose2D(15.0, 5.0, 0.0)), Twist2D(0.8), 3.0)[-1]
    assert end.pose_in_map.x_m == pytest.approx(16.0 - 0.06 - simulated_base.RADIUS_M, abs=0.01)
    assert end.forward_mps < 0.05
    assert (end.touching, end.collisions) == (True, 1)


def test_it_slides_along_a_wall_that_it_meets_at_an_angle() -> None:
    states = driven(BaseState(Pose2D(5.0, 5.2, math.radians(20))), Twist2D(0.5), 6.0)
    assert states[-1].pose_in_map.x_m > 6.2
    assert (
        simulated_base.clearance_m(states[-1].pose_in_map.x_m, states[-1].pose_in_map.y_m)
        >= simulated_base.RADIUS_M - 0.01
    )


def test_it_never_enters_a_person() -> None:
    people = np.array([[5.0, 5.0, 0.23]])
    for state in driven(CORRIDOR, Twist2D(1.0), 5.0, people):
        assert math.dist((state.pose_in_map.x_m, state.pose_in_map.y_m), (5.0, 5.0)) > simulated_base.RADIUS_M + 0.21


@settings(max_examples=examples(25), deadline=None)
@given(
    st.sampled_from(PLACES),
    st.lists(st.tuples(st.floats(-1, 1), st.floats(-2, 2), st.integers(5, 60)), min_size=1, max_size=6),
)
def test_no_drive_gets_into_anything_solid(place: object, drives: list[tuple[float, float, int]]) -> None:
    state = BaseState(place.pose)  # type: ignore[attr-defined]
    for forward, turn, steps in drives:
        for _ in range(steps):
            state = simulated_base.step(state, Twist2D(forward, 0.0, turn), NOBODY)
            assert (
                simulated_base.clearance_m(state.pose_in_map.x_m, state.pose_in_map.y_m)
                > simulated_base.RADIUS_M - 0.02
            )


def test_the_building_has_room_at_every_place_and_doors_to_drive_through() -> None:
    assert simulated_base.is_free(START.x_m, START.y_m, 0.5, NOBODY)
    for place in PLACES:
        assert simulated_base.is_free(place.pose.x_m, place.pose.y_m, 0.4, NOBODY), place.name
    assert len({place.name for place in PLACES}) == len(PLACES) >= 6
    assert len(WALLS) > 15
    assert len(FURNITURE) > 20
