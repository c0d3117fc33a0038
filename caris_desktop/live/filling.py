"""What fills the gaps in what the robot is to say, as it is now: whom it speaks to, where it goes or stands."""

import math

from caris_desktop.conversation.placeholders import NAME, PLACE, Words
from caris_desktop.domain.person_marks import mark_of
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow, is_unnamed_label

_GOING = ("requested", "active")
_AT_PLACE_M = 4.0
"""Who is further away than this stands at no place in particular."""


def name_of(state: LiveState, person_id: str, *, naming: bool) -> str:
    """The name that the wizard gave; empty where there is none, or the scenario names nobody."""
    rows: tuple[PersonRow, ...] = (*state.persons.value, *state.everybody.value)
    row = next((row for row in rows if row.person_id == person_id), None)
    return row.name if naming and row is not None and not is_unnamed_label(row.name) else ""


def words_now(state: LiveState, person_id: str, *, naming: bool) -> dict[str, Words]:
    """What is known for the gaps of something said to this person."""
    found = {}
    name, place = name_of(state, person_id, naming=naming), place_meant(state)
    if name:
        found[NAME] = Words(name, mark_of(person_id))
    if place:
        found[PLACE] = Words(place, place)
    return found


def given_words(gap: str, said: str, person_id: str) -> Words:
    """What the wizard wrote into a gap. A name stays out of the record also where it is nobody's yet."""
    if gap != NAME:
        return Words(said, said)
    return Words(said, mark_of(person_id) if person_id else f"{{{NAME}}}")


def place_meant(state: LiveState) -> str:
    """The place that the robot goes to, or else the nearest one; empty where neither is known."""
    goal = state.goal.value
    if goal is not None and goal.state in _GOING and goal.place:
        return str(goal.place)
    if state.pose.value is None or state.pose.freshness == "lost":
        return ""
    at = state.pose.value.pose_in_map
    away = [
        (math.hypot(place.pose_in_map.x_m - at.x_m, place.pose_in_map.y_m - at.y_m), place.name)
        for place in state.places.value
    ]
    distance_m, nearest = min(away, default=(math.inf, ""))
    return nearest if distance_m <= _AT_PLACE_M else ""
