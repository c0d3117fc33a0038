"""Navigation goals of a session: one record per goal, from its change events."""

from collections.abc import Iterable, Sequence

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import GoalChanged, GoalState
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.value_class import Value

_OVER: tuple[GoalState, ...] = ("reached", "cancelled", "failed")


class NavigationGoal(Value):
    """One goal. ``end_ns`` is None if it was still active, and ``start_ns`` if it was refused at once. ``actor`` set
    it.
    """

    goal_id: str
    target_in_map: Pose2D
    place: str | None
    start_ns: int
    end_ns: int | None
    state: GoalState
    actor: Actor = ""

    @property
    def duration_s(self) -> float | None:
        return None if self.end_ns is None else (self.end_ns - self.start_ns) / 1e9


def navigation_goals(
    events: Iterable[GoalChanged], *, started_ns: int, pauses: Sequence[tuple[int, int]] = ()
) -> tuple[NavigationGoal, ...]:
    """Goals of a session in order of their first event.

    A recording that begins, or resumes after one of the ``pauses``, notes the state of the last goal: one that was over
    by then does not belong to it.
    """
    histories: dict[str, list[GoalChanged]] = {}
    for event in events:
        histories.setdefault(event.goal_id, []).append(event)
    goals = []
    for history in histories.values():
        first = history[0]
        over = next((event for event in history if event.state in _OVER), None)
        unrecorded = first.stamp_ns <= started_ns or any(begin < first.stamp_ns <= end for begin, end in pauses)
        if over is not first or not unrecorded:
            end_ns, state = (None, history[-1].state) if over is None else (over.stamp_ns, over.state)
            # The event of a cancelled goal names who cancelled it.
            actor = first.actor if first.state != "cancelled" else ""
            goals.append(
                NavigationGoal(first.goal_id, first.target_in_map, first.place, first.stamp_ns, end_ns, state, actor)
            )
    return tuple(goals)
