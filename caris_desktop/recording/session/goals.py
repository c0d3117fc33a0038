"""Where the robot went by itself: one value for each navigation goal, put together from the events that report it."""

from collections.abc import Iterable, Sequence

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import GoalChanged, GoalState
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.value_class import dataclass

_OVER: tuple[GoalState, ...] = ("reached", "cancelled", "failed")


@dataclass(frozen=True, slots=True)
class NavigationGoal:
    """One goal. ``end_ns`` is None where it was under way still, and is ``start_ns`` where it was refused at once.
    ``actor`` set it.
    """

    goal_id: str
    target_in_map: Pose2D
    place: str | None
    start_ns: int
    end_ns: int | None
    state: GoalState
    actor: Actor = ""


def navigation_goals(
    events: Iterable[GoalChanged], *, started_ns: int, pauses: Sequence[tuple[int, int]] = ()
) -> tuple[NavigationGoal, ...]:
    """The goals of a session, in the order in which they were first told of.

    A recording that begins, or goes on after one of the ``pauses``, notes how the last goal stands: one of which that
    tells first that it is over was none of this recording.
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
            # Of one that is cancelled the event names who did that.
            actor = first.actor if first.state != "cancelled" else ""
            goals.append(
                NavigationGoal(first.goal_id, first.target_in_map, first.place, first.stamp_ns, end_ns, state, actor)
            )
    return tuple(goals)
