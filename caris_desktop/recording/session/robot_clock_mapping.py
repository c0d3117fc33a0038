"""Mapping of robot stamps to session time, by the clock offsets that the link measured.

The link estimates the robot's clock offset once per second, with an error bound. Afterwards the neighbours of an
estimate are known, so that a line through them removes noise; the measured bound is retained.
"""

import itertools
import math
import statistics
from bisect import bisect_right
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.events import LinkQuality
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.session_reader import Session

# Far above any crystal's drift: the maximum rate between two estimates unless the clock was set.
DRIFT_LIMIT = 1e-3
_WINDOW_S = 20.0
# Every estimate of an uneven clock (simulation) looks like a step; those are interpolated, not fitted.
_UNEVEN_SHARE = 0.2
_UNKNOWN_ABOVE_NS = 1_000_000_000
_LEAST_UNCERTAINTY_NS = 1_000.0
_NEVER_MS = 2**63 / 1e6


class Measured(NamedTuple):
    """Moment in session time, true within ``uncertainty_ns``."""

    stamp_ns: int
    uncertainty_ns: int


class ClockSummary(Value):
    """Robot clock statistics of a session: robot minus session clock at the first estimate, the drift since, and the
    largest uncertainty. ``utc_offset_s`` is its initial offset to this computer's UTC.
    """

    estimates: int
    times_set: int
    utc_offset_s: float
    drift_ms_per_min: float
    uncertainty_ms: float


class _Run(Value, eq=False):
    """Interval in which the robot's clock was not set. Session and robot times ascend, relative to the first."""

    first_session_ns: int
    first_robot_ns: int
    session_ns: list[float]
    robot_ns: list[float]
    uncertainty_ns: list[float]
    rate_at_start: float
    rate_at_end: float

    def measured(self, robot_stamp_ns: int) -> Measured:
        robot_ns = float(robot_stamp_ns - self.first_robot_ns)
        after = bisect_right(self.robot_ns, robot_ns)
        if after == 0 or after == len(self.robot_ns):
            edge, rate = (0, self.rate_at_start) if after == 0 else (-1, self.rate_at_end)
            away_ns = (robot_ns - self.robot_ns[edge]) / (1.0 + rate)
            session_ns = self.session_ns[edge] + away_ns
            uncertainty_ns = self.uncertainty_ns[edge] + DRIFT_LIMIT * abs(away_ns)
        else:
            before = after - 1
            span_ns = self.robot_ns[after] - self.robot_ns[before]
            share = (robot_ns - self.robot_ns[before]) / span_ns
            session_ns = _between(self.session_ns, before, share)
            # Half way between two estimates the clock may deviate this much from the straight line.
            sag_ns = 4.0 * share * (1.0 - share) * 0.25 * DRIFT_LIMIT * span_ns
            uncertainty_ns = _between(self.uncertainty_ns, before, share) + sag_ns
        return Measured(self.first_session_ns + round(session_ns), math.ceil(uncertainty_ns))


class RobotClock:
    """Maps robot stamps to session time."""

    def __init__(self, qualities: Iterable[LinkQuality]) -> None:
        known = sorted(
            {
                quality.stamp_ns: (quality.clock_offset_ms, quality.clock_uncertainty_ms)
                for quality in qualities
                if _is_number(quality.clock_offset_ms) and _is_number(quality.clock_uncertainty_ms)
            }.items()
        )
        at_ns = [stamp_ns for stamp_ns, _ in known]
        # Integers first: nanoseconds since 1970 exceed a float's precision.
        offset_ns = [round(offset_ms * 1e6) for _, (offset_ms, _) in known if offset_ms is not None]
        uncertainty_ns = [max(_LEAST_UNCERTAINTY_NS, (bound or 0.0) * 1e6) for _, (_, bound) in known]
        self._runs = _runs(at_ns, offset_ns, uncertainty_ns)
        self._starts_ns = [run.first_session_ns for run in self._runs]

    def __bool__(self) -> bool:
        return bool(self._runs)

    def measured(self, robot_stamp_ns: int | None, *, arrival_ns: int) -> Measured | None:
        """Measurement time of a value that arrived at ``arrival_ns``; None if not known within a second.

        A clock that was set shows some times twice: the shortest plausible transmission is assumed.
        """
        if robot_stamp_ns is None or not self._runs:
            return None
        here = max(0, bisect_right(self._starts_ns, arrival_ns) - 1)
        best = self._runs[here].measured(robot_stamp_ns)
        for other in self._runs[max(0, here - 1) : here] + self._runs[here + 1 : here + 2]:
            candidate = other.measured(robot_stamp_ns)
            if _travel_ns(candidate, arrival_ns) < _travel_ns(best, arrival_ns):
                best = candidate
        return best if best.uncertainty_ns <= _UNKNOWN_ABOVE_NS else None

    def summary(self, *, utc_ns_at: int, session_ns_at: int) -> ClockSummary | None:
        """Statistics for a report; the arguments are one moment in UTC and session time. None without estimates."""
        if not self._runs:
            return None
        first, last = self._runs[0], self._runs[-1]
        ahead_ns = (first.first_robot_ns - utc_ns_at) - (first.first_session_ns - session_ns_at)
        longest = max(self._runs, key=lambda run: run.session_ns[-1])
        gained_ns = (longest.robot_ns[-1] - longest.robot_ns[0]) - longest.session_ns[-1]
        lasted_min = longest.session_ns[-1] / 60e9
        return ClockSummary(
            estimates=sum(len(run.session_ns) for run in self._runs),
            times_set=len(self._runs) - 1,
            utc_offset_s=(ahead_ns + first.robot_ns[0]) / 1e9,
            drift_ms_per_min=gained_ns / 1e6 / lasted_min if lasted_min else last.rate_at_end * 60e3,
            uncertainty_ms=max(max(run.uncertainty_ns) for run in self._runs) / 1e6,
        )


def robot_clock(session: Session) -> RobotClock:
    """Robot clock of a session; maps nothing if the link measured nothing. Raises SessionError."""
    return RobotClock(value for _, value in session.values("event/link_quality"))


def clock_summary(session: Session) -> ClockSummary | None:
    """Statistics of the robot clock of a session, for a report. Raises SessionError."""
    utc_ns = session.clock.anchor.utc_ns_at(session.started_ns)
    return robot_clock(session).summary(utc_ns_at=utc_ns, session_ns_at=session.started_ns)


def _is_number(value: float | None) -> bool:
    """True if its nanoseconds fit into 64 bits, which excludes infinity."""
    return value is not None and abs(value) < _NEVER_MS


def _between(values: list[float], before: int, share: float) -> float:
    return values[before] + share * (values[before + 1] - values[before])


def _travel_ns(measured: Measured, arrival_ns: int) -> float:
    """Transmission time; negative values, which are implausible, are penalised by their size."""
    way_ns = arrival_ns - measured.stamp_ns
    return way_ns if way_ns >= -measured.uncertainty_ns else -1e3 * way_ns


def _runs(at_ns: list[int], offset_ns: list[int], uncertainty_ns: list[float]) -> list[_Run]:
    set_at = [
        index
        for index in range(1, len(at_ns))
        if abs(offset_ns[index] - offset_ns[index - 1])
        > 2 * DRIFT_LIMIT * (at_ns[index] - at_ns[index - 1]) + uncertainty_ns[index] + uncertainty_ns[index - 1]
    ]
    uneven = len(set_at) > max(2, _UNEVEN_SHARE * len(at_ns))
    bounds = [0, *([] if uneven else set_at), len(at_ns)]
    return [
        _run(at_ns[begin:end], offset_ns[begin:end], uncertainty_ns[begin:end], fitted=not uneven)
        for begin, end in itertools.pairwise(bounds)
        if end > begin
    ]


def _run(at_ns: list[int], offset_ns: list[int], uncertainty_ns: list[float], *, fitted: bool) -> _Run:
    session_ns = np.array([stamp_ns - at_ns[0] for stamp_ns in at_ns], dtype=np.float64)
    measured_ns = np.array([offset - offset_ns[0] for offset in offset_ns], dtype=np.float64)
    bound_ns = np.array(uncertainty_ns, dtype=np.float64)
    if fitted:
        smooth_ns, rates = _lines(session_ns, measured_ns, bound_ns)
        # The line must pass through the measured bounds, which contain the truth.
        lower_ns, upper_ns = _bounds(session_ns, measured_ns, bound_ns)
        offset = np.clip(smooth_ns, lower_ns, upper_ns)
        uncertainty = np.maximum(upper_ns - offset, offset - lower_ns)
        robot_ns = np.maximum.accumulate(session_ns + offset)
    else:
        rates = np.zeros_like(session_ns)
        robot_ns = np.maximum.accumulate(session_ns + measured_ns)
        bend_ns = np.zeros_like(session_ns)
        if len(session_ns) > 2:
            bend_ns[1:-1] = np.abs(np.diff(session_ns + measured_ns, 2))
        uncertainty = bound_ns + bend_ns + (robot_ns - session_ns - measured_ns)
    return _Run(
        at_ns[0],
        at_ns[0] + offset_ns[0],
        session_ns.tolist(),
        robot_ns.tolist(),
        uncertainty.tolist(),
        float(rates[0]),
        float(rates[-1]),
    )


def _bounds(
    at_ns: NDArray[np.float64], offset_ns: NDArray[np.float64], bound_ns: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Bounds of the offset at each estimate; uncertain estimates are bounded by better neighbours."""
    lower_ns, upper_ns = offset_ns - bound_ns, offset_ns + bound_ns
    for order in (range(1, len(at_ns)), range(len(at_ns) - 2, -1, -1)):
        for index in order:
            neighbour = index - 1 if order.step > 0 else index + 1
            drift_ns = DRIFT_LIMIT * abs(at_ns[index] - at_ns[neighbour])
            lower_ns[index] = max(lower_ns[index], lower_ns[neighbour] - drift_ns)
            upper_ns[index] = min(upper_ns[index], upper_ns[neighbour] + drift_ns)
    # A clock with excessive drift contradicts the bounds; each estimate then counts alone.
    contrary = lower_ns > upper_ns
    lower_ns[contrary] = (offset_ns - bound_ns)[contrary]
    upper_ns[contrary] = (offset_ns + bound_ns)[contrary]
    return lower_ns, upper_ns


def _lines(
    at_ns: NDArray[np.float64], offset_ns: NDArray[np.float64], bound_ns: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Linear fit around each estimate within the window: its value there and its slope."""
    values, rates = offset_ns.copy(), np.zeros_like(offset_ns)
    begin = np.searchsorted(at_ns, at_ns - _WINDOW_S * 1e9, side="left")
    end = np.searchsorted(at_ns, at_ns + _WINDOW_S * 1e9, side="right")
    for index in range(len(at_ns)):
        window = slice(int(begin[index]), int(end[index]))
        if window.stop - window.start < 3:
            continue
        away_s = (at_ns[window] - at_ns[index]) / 1e9
        weight = 1.0 / bound_ns[window] ** 2
        value, rate = _line(away_s, offset_ns[window], weight)
        # Once more without outliers relative to their uncertainty.
        strange = np.abs(offset_ns[window] - value - rate * away_s) / bound_ns[window]
        weight = np.where(strange > max(1.0, 3.0 * statistics.median(strange.tolist())), 0.0, weight)
        if np.count_nonzero(weight) >= 3:
            value, rate = _line(away_s, offset_ns[window], weight)
        values[index] = value
        rates[index] = min(DRIFT_LIMIT, max(-DRIFT_LIMIT, rate / 1e9))
    return values, rates


def _line(x: NDArray[np.float64], y: NDArray[np.float64], weight: NDArray[np.float64]) -> tuple[float, float]:
    total = float(weight.sum())
    mean_x, mean_y = float(weight @ x) / total, float(weight @ y) / total
    spread = float(weight @ (x - mean_x) ** 2)
    rate = float(weight @ ((x - mean_x) * (y - mean_y))) / spread if spread > 0.0 else 0.0
    return mean_y - rate * mean_x, rate
