"""Simulated people who walk, stop, leave and return, and a visitor who approaches the robot."""

import csv
import math
import random
from collections import deque
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.geometry import Pose2D, wrap_angle
from caris_desktop.domain.value_class import Value
from caris_desktop.simulator.characters import CHARACTERS, Appearance
from caris_desktop.simulator.shipped_data import built, shipped_data
from caris_desktop.simulator.simulated_base import RADIUS_M as ROBOT_RADIUS_M
from caris_desktop.simulator.simulated_base import clearance_m
from caris_desktop.simulator.simulated_navigation import Point, in_sight, plan

BODY_M = 0.23
_LEG_M, _HIP_M, _STRIDE_M = 0.06, 0.11, 0.24
_WALK_CLEARANCE_M = 0.3
_PERSONAL_SPACE_M = 0.65
_VISIT_M = 2.0
_TURNS_EVERY_S = 4.0
_STAYS_S = 20.0
OUTSIDE: Point = (2.55, -0.95)
"""In the porch behind the entrance door, where nobody is seen."""


class Seen(Value):
    """One person for camera and state service.

    ``sprite`` is the index of a photo sprite; a person with an ``appearance`` is rendered with it from the visible
    side.
    """

    x_m: float
    y_m: float
    height_m: float
    sprite: int
    walking: bool
    stride_rad: float
    heading_rad: float = 0.0
    appearance: Appearance | None = None


class Visit(Value):
    """A person of ``CHARACTERS`` enters at the door, stays in front of the robot, turns there, and leaves."""

    person: int
    comes_s: float
    stays_s: float = _STAYS_S
    clothes: int = 0


class BadVisits(ValueError):  # noqa: N818 - the file does not say what it should; nothing is broken
    """Unusable file of visits, with the reason."""


def visits_by_chance(people: int, seed: int, *, rounds: int = 20) -> list[Visit]:
    """Random visits: everybody once per round, in random order and the same clothes; about three at a time."""
    chance = random.Random(f"{seed}/visits")  # noqa: S311 - walks, no secrets
    visits, comes_s = [], 1.0
    for _ in range(rounds):
        for person in chance.sample(range(people), people):
            visits.append(Visit(person, comes_s, _STAYS_S * chance.uniform(0.8, 1.2)))
            # about ten seconds each on the way in and out
            comes_s += (_STAYS_S + 20.0) / 3 * chance.uniform(0.8, 1.2)
        comes_s += _STAYS_S
    return visits


def read_visits(path: Path) -> list[Visit]:
    """Visits from a table with the columns person (1 to 20), comes_s, stays_s and clothes (1 or 2).

    Raises BadVisits where it is not such a table.
    """
    try:
        with path.open(newline="", encoding="utf-8") as table:
            visits = [
                Visit(int(row["person"]) - 1, float(row["comes_s"]), float(row["stays_s"]), int(row["clothes"]) - 1)
                for row in csv.DictReader(table)
            ]
    except OSError as error:
        raise BadVisits(f"{path} cannot be read: {error.strerror or error}.") from error
    except (KeyError, TypeError, ValueError, csv.Error) as error:
        raise BadVisits(
            f"{path} is not a table of visits: its columns must be person, comes_s, stays_s and clothes, with a "
            f"number in each ({error})."
        ) from error
    for visit in visits:
        if not 0 <= visit.person < len(CHARACTERS) or visit.clothes not in (0, 1):
            raise BadVisits(f"{path}: person must be 1 to {len(CHARACTERS)}, and clothes 1 or 2.")
        if not (0.0 <= visit.comes_s < math.inf and 0.0 <= visit.stays_s < math.inf):
            raise BadVisits(f"{path}: comes_s and stays_s must be numbers of seconds, from 0.")
    return sorted(visits, key=lambda visit: visit.comes_s)


class _Role(Value):
    sprite: int
    height_m: float
    speed_mps: float
    begins: Point
    rounds: tuple[tuple[Point, float], ...]
    visits_robot: bool = False
    visit: Visit | None = None
    appearance: Appearance | None = None


_ROLES: tuple[_Role, ...] = built(tuple[_Role, ...], shipped_data("people.yaml"))


class _Person:
    def __init__(self, role: _Role, chance: random.Random) -> None:
        self.role = role
        self.chance = chance
        self.x_m, self.y_m = role.begins
        self.heading_rad = 0.0
        self.stride_rad = 0.0
        self.walking = False
        self.way: list[Point] = []
        self.wait_s = 1.0 if role.visits_robot else chance.uniform(2.0, 6.0)
        self.round = 0
        self.blocked_s = 0.0
        self.visiting = False
        self.visit_left_s = 0.0


class Crowd:
    """All people in the building. Equal seed and robot motion give equal walks.

    Parameters
    ----------
    visits
        Who comes instead of the three who are always there, in the order of their coming; None for those three.
    """

    def __init__(self, seed: int, visits: Iterable[Visit] | None = None) -> None:
        self._seed = seed
        self._now_s = 0.0
        self._expected = deque(sorted(visits or (), key=lambda visit: visit.comes_s))
        self._came = 0
        roles = _ROLES if visits is None else ()
        self._people = [_Person(role, random.Random(f"{seed}/{index}")) for index, role in enumerate(roles)]  # noqa: S311 - walks, no secrets

    @property
    def bodies(self) -> NDArray[np.float64]:
        """Circles (x, y, radius), shape (people, 3)."""
        return np.array([(person.x_m, person.y_m, BODY_M) for person in self._people]).reshape(-1, 3)

    @property
    def seen(self) -> tuple[Seen, ...]:
        """All people, for the camera."""
        return tuple(
            Seen(
                p.x_m, p.y_m, p.role.height_m, p.role.sprite, p.walking, p.stride_rad, p.heading_rad, p.role.appearance
            )
            for p in self._people
        )

    @property
    def legs(self) -> NDArray[np.float64]:
        """Circles (x, y, radius) of all legs, shape (2 * people, 3)."""
        circles = []
        for person in self._people:
            cos, sin = math.cos(person.heading_rad), math.sin(person.heading_rad)
            swing = _STRIDE_M * math.sin(person.stride_rad) if person.walking else 0.0
            for side, ahead in ((_HIP_M, swing), (-_HIP_M, -swing)):
                circles.append((person.x_m + ahead * cos - side * sin, person.y_m + ahead * sin + side * cos, _LEG_M))
        return np.array(circles).reshape(-1, 3)

    def step(self, robot: Pose2D, dt_s: float) -> None:
        """Advance the simulation by ``dt_s``."""
        self._now_s += dt_s
        self._come_and_go()
        for index, person in enumerate(self._people):
            if person.way:
                self._walk(index, person, robot, dt_s)
            else:
                self._stand(person, robot, dt_s)

    def _come_and_go(self) -> None:
        # a visitor who left is outside again without a destination
        self._people = [
            p for p in self._people if p.role.visit is None or not p.round or p.way or (p.x_m, p.y_m) != OUTSIDE
        ]
        while self._expected and self._expected[0].comes_s <= self._now_s:
            visit = self._expected.popleft()
            self._came += 1
            height_m, appearance = CHARACTERS[visit.person].height_m, Appearance(visit.person, visit.clothes)
            role = _Role(0, height_m, 1.1, OUTSIDE, ((OUTSIDE, 1.0),), True, visit, appearance)
            self._people.append(_Person(role, random.Random(f"{self._seed}/{self._came}")))  # noqa: S311

    def _stand(self, person: _Person, robot: Pose2D, dt_s: float) -> None:
        person.walking = False
        person.wait_s -= dt_s
        if person.visiting:
            person.visit_left_s -= dt_s
            heading_rad = math.atan2(robot.y_m - person.y_m, robot.x_m - person.x_m)
            if person.role.visit is not None:  # turned away from the robot, to be seen from every side
                heading_rad += math.pi / 2.0 * (int(person.visit_left_s / _TURNS_EVERY_S) % 4)
            person.heading_rad += min(max(wrap_angle(heading_rad - person.heading_rad), -3.0 * dt_s), 3.0 * dt_s)
        if person.wait_s > 0.0:
            return
        if person.role.visits_robot and (not person.visiting or person.visit_left_s > 0.0):
            self._visit(person, robot)
            return
        person.visiting = False
        spot, stay_s = person.role.rounds[person.round % len(person.role.rounds)]
        person.round += 1
        self._go(person, spot)
        person.wait_s = stay_s * person.chance.uniform(0.8, 1.3)

    def _visit(self, person: _Person, robot: Pose2D) -> None:
        if not person.visiting:
            person.visiting = True
            visit = person.role.visit
            person.visit_left_s = person.chance.uniform(80.0, 100.0) if visit is None else visit.stays_s
        person.wait_s = 1.0
        ahead_m = math.dist((person.x_m, person.y_m), (robot.x_m, robot.y_m))
        bearing = math.atan2(person.y_m - robot.y_m, person.x_m - robot.x_m)
        in_front = abs(wrap_angle(bearing - robot.heading_rad)) < 0.4
        if in_front and 1.4 < ahead_m < 2.8:
            return
        # the regular visitor has the robot to themselves; visits keep a distance from one another
        others = [p for p in self._people if p is not person] if person.role.visit is not None else ()
        spot = _spot_before(robot, others)
        if spot is not None and math.dist(spot, (person.x_m, person.y_m)) > 0.4:
            self._go(person, spot)

    def _go(self, person: _Person, spot: Point, avoid: NDArray[np.float64] | None = None) -> None:
        way = plan((person.x_m, person.y_m), spot, body_m=_WALK_CLEARANCE_M, avoid=avoid)
        person.way = way[1:] if way else []
        person.blocked_s = 0.0

    def _walk(self, index: int, person: _Person, robot: Pose2D, dt_s: float) -> None:
        target = person.way[0]
        left_m = math.dist((person.x_m, person.y_m), target)
        stretch = person.role.speed_mps * dt_s
        if left_m <= stretch:
            person.x_m, person.y_m = target
            del person.way[0]
            return
        heading_rad = math.atan2(target[1] - person.y_m, target[0] - person.x_m)
        x = person.x_m + (target[0] - person.x_m) / left_m * stretch
        y = person.y_m + (target[1] - person.y_m) / left_m * stretch
        if self._in_path_of_somebody(index, person, robot, (x, y)):
            self._wait_for_room(person, robot, dt_s)
            return
        person.blocked_s = 0.0
        person.walking = True
        person.stride_rad += 2.0 * math.pi * stretch / 1.3
        person.heading_rad += min(max(wrap_angle(heading_rad - person.heading_rad), -5.0 * dt_s), 5.0 * dt_s)
        person.x_m, person.y_m = x, y

    def _in_path_of_somebody(self, index: int, person: _Person, robot: Pose2D, at: Point) -> bool:
        others = [(robot.x_m, robot.y_m, ROBOT_RADIUS_M + BODY_M + 0.3)]
        # the lower number goes first, so that two never wait for each other
        others += [(other.x_m, other.y_m, _PERSONAL_SPACE_M) for other in self._people[:index]]
        return any(
            math.dist(at, (x, y)) < space and math.dist(at, (x, y)) < math.dist((person.x_m, person.y_m), (x, y))
            for x, y, space in others
        )

    def _wait_for_room(self, person: _Person, robot: Pose2D, dt_s: float) -> None:
        person.walking = False
        person.blocked_s += dt_s
        if person.blocked_s < 1.5:
            return
        everybody = [(robot.x_m, robot.y_m, ROBOT_RADIUS_M + 0.25)]
        everybody += [(other.x_m, other.y_m, BODY_M) for other in self._people if other is not person]
        self._go(person, person.way[-1], np.array(everybody))


def _spot_before(robot: Pose2D, others: Sequence[_Person] = ()) -> Point | None:
    """Free position in front of the robot, about two metres away and in its sight."""
    for distance_m in (_VISIT_M, 2.4, 1.7):
        for off in (0.0, 0.2, -0.2, 0.35, -0.35):
            angle = robot.heading_rad + off
            spot = (robot.x_m + distance_m * math.cos(angle), robot.y_m + distance_m * math.sin(angle))
            if any(math.dist(spot, other.way[-1] if other.way else (other.x_m, other.y_m)) < 0.7 for other in others):
                continue
            if clearance_m(*spot) > 0.35 and in_sight((robot.x_m, robot.y_m), spot):
                return spot
    return None
