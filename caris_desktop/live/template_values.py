"""Template values of the robot's utterances: addressee's name, place."""

import math

from caris_desktop.conversation.placeholders import NAME, PLACE, Words
from caris_desktop.domain.person_marks import mark_of
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow, is_unnamed_label

_IN_PROGRESS = ("requested", "active")
_AT_PLACE_M = 4.0
"""Maximum distance at which the robot counts as being at a place."""


def name_of(state: LiveState, person_id: str, *, naming: bool) -> str:
    """Name given by the wizard; empty if there is none or naming is not permitted."""
    rows: tuple[PersonRow, ...] = (*state.persons.value, *state.everybody.value)
    row = next((row for row in rows if row.person_id == person_id), None)
    return row.name if naming and row is not None and not is_unnamed_label(row.name) else ""


def words_now(state: LiveState, person_id: str, *, naming: bool) -> dict[str, Words]:
    """Template values for an utterance to this person."""
    found = {}
    name, place = name_of(state, person_id, naming=naming), current_place(state)
    if name:
        found[NAME] = Words(name, mark_of(person_id))
    if place:
        found[PLACE] = Words(place, place)
    return found


def given_words(gap: str, value: str, person_id: str) -> Words:
    """Template value typed by the wizard. A name is not recorded, even if it belongs to no known person."""
    if gap != NAME:
        return Words(value, value)
    return Words(value, mark_of(person_id) if person_id else f"{{{NAME}}}")


def current_place(state: LiveState) -> str:
    """Name of the goal's place, else of the nearest place; empty if unknown."""
    goal = state.goal.value
    if goal is not None and goal.state in _IN_PROGRESS and goal.place:
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
