"""Nearest person in front of the robot."""

import math
from collections.abc import Iterable

from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import text_formatting


def nearest_person(persons: Iterable[PersonRow], *, selected: str = "") -> PersonRow | None:
    """The selected person if present; else the nearest unnamed person, else the nearest.

    Without distances: the one most straight ahead, then the one present longest.
    """
    here = [person for person in persons if person.here]
    chosen = next((person for person in here if person.person_id == selected), None)
    return chosen or min(here, key=_how_far, default=None)


def _how_far(person: PersonRow) -> tuple[bool, float, float, int]:
    aside = math.inf if person.bearing_rad is None else abs(math.remainder(person.bearing_rad, math.tau))
    distance_m = math.inf if person.distance_m is None else person.distance_m
    return text_formatting.has_given_name(person), distance_m, aside, person.since_ns
