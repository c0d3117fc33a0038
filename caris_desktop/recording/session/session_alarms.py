"""Alarms of a session: one record per alarm, from its change events."""

from collections.abc import Iterable, Sequence

from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import AlarmChanged, Severity
from caris_desktop.domain.value_class import Value


class AlarmRecord(Value):
    """One alarm. ``start_ns`` is its first record, ``end_ns`` its last end, None if active at the end of the session.
    ``stood_s`` is its active time without pauses; ``times`` counts how often it was raised. ``seen_to_by`` is who
    resolved it, unless it ended without intervention.
    """

    alarm_id: str
    cause: str
    severity: Severity
    what: str
    start_ns: int
    end_ns: int | None
    stood_s: float
    times: int
    seen_to_by: Actor = ""


def alarms_of(
    events: Iterable[AlarmChanged], *, ended_ns: int, pauses: Sequence[tuple[int, int]] = ()
) -> tuple[AlarmRecord, ...]:
    """Alarms in order of their first occurrence.

    Nothing is recorded during a pause, and active alarms are raised again after it: an alarm without a later event
    ended with the pause.
    """
    histories: dict[str, list[AlarmChanged]] = {}
    for event in events:
        histories.setdefault(event.alarm_id, []).append(event)
    return tuple(_alarm(history, ended_ns, pauses) for history in histories.values())


def _alarm(history: Sequence[AlarmChanged], ended_ns: int, pauses: Sequence[tuple[int, int]]) -> AlarmRecord:
    stood_ns, end_ns = 0, None
    for number, event in enumerate(history):
        if event.state == "ended":
            end_ns = event.stamp_ns
            continue
        following = history[number + 1].stamp_ns if number + 1 < len(history) else None
        paused = next((begin for begin, _end in pauses if begin >= event.stamp_ns), None)
        until = min(one for one in (following, paused, max(ended_ns, event.stamp_ns)) if one is not None)
        stood_ns += until - event.stamp_ns
        end_ns = until if until != following and until == paused else None
    last = history[-1]
    by_itself = last.state != "ended" or last.actor in ("", CONSOLE)
    return AlarmRecord(
        last.alarm_id, last.cause, last.severity, last.what, history[0].stamp_ns, end_ns, stood_ns / 1e9,
        max(event.times for event in history), "" if by_itself else last.actor,
    )  # fmt: skip
