"""Addressee of the robot's next utterance."""

from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow

WITHIN_EARSHOT_M = 3.0


def addressee(state: LiveState) -> str:
    """Id of the selected person if present; else of the nearest within earshot, or of the only one.

    Empty if there is none, or if it is ambiguous.
    """
    here: list[PersonRow] = [row for row in state.persons.value if row.here]
    if any(row.person_id == state.selected_person.value for row in here):
        return str(state.selected_person.value)
    if len(here) == 1:
        return here[0].person_id
    placed = [(row.distance_m, row.person_id) for row in here if row.distance_m is not None]
    distance_m, nearest = min(placed, default=(WITHIN_EARSHOT_M, ""))
    return nearest if distance_m < WITHIN_EARSHOT_M else ""
