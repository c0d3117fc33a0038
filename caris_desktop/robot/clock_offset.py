"""Clock offset estimate between robot and session: pure arithmetic on samples, no sockets.

Each sample bounds the offset without assuming how the delay is split: if the robot read its clock between question and
answer, the offset is between ``reading - answered`` and ``reading - asked``. Samples of a window are combined under an
unknown, bounded drift; what fits all of them is the estimate. That is NTP's minimum delay filter with a hard error
bound: a late answer widens only its own sample.
"""

import math
from collections import deque

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.value_class import Value

WINDOW_S = 60.0
MOST_SAMPLES = 128
# Far above any crystal; includes slewing by NTP.
DRIFT_LIMIT = 1e-3
# Change of the rate itself: crystals warm up, NTP slews.
WANDER_PER_S = 1e-6


class OffsetEstimate(Value):
    """Robot clock minus session clock at one time, true within ``uncertainty_ns`` of ``offset_ns``."""

    offset_ns: int
    uncertainty_ns: int

    @property
    def offset_ms(self) -> float:
        return self.offset_ns / 1e6

    @property
    def uncertainty_ms(self) -> float:
        return self.uncertainty_ns / 1e6


class ClockOffset:
    """Estimates the offset of one robot clock from samples at any times.

    Parameters
    ----------
    drift_limit
        Most that the robot's clock gains or loses against ours, in seconds a second.
    window_s
        How long a sample is used.
    """

    def __init__(self, *, drift_limit: float = DRIFT_LIMIT, window_s: float = WINDOW_S) -> None:
        self._drift_limit = drift_limit
        self._window_ns = int(window_s * 1e9)
        # (session time, lower bound, upper bound) of each, in ns.
        self._exchanges: deque[tuple[int, int, int]] = deque(maxlen=MOST_SAMPLES)
        self._stamped: deque[tuple[int, int]] = deque(maxlen=MOST_SAMPLES)
        self._fit: _Fit | None = None

    @classmethod
    def of_simulation_time(cls) -> "ClockOffset":
        """For a simulated clock, which may run slower or stop."""
        return cls(drift_limit=1.0, window_s=3.0)

    def add_exchange(self, *, sent_ns: int, answered_ns: int, robot_ns: int) -> None:
        """Add an exchange: the robot's clock read ``robot_ns`` between these two session times."""
        if answered_ns < sent_ns:
            raise ValueError("an answer comes after its question")
        self._exchanges.append((answered_ns, robot_ns - answered_ns, robot_ns - sent_ns))
        self._refit(answered_ns)

    def add_stamp(self, *, robot_stamp_ns: int, arrival_ns: int) -> None:
        """Add a stamp made before sending: the offset is at least stamp minus arrival.

        Only for stamps never ahead of the robot's clock (transforms often are).
        """
        bound_ns = robot_stamp_ns - arrival_ns
        if self._stamped and arrival_ns - self._stamped[-1][0] < 250_000_000:
            # The best of a burst is enough.
            if bound_ns <= self._stamped[-1][1]:
                return
            self._stamped.pop()
        self._stamped.append((arrival_ns, bound_ns))

    def at(self, session_ns: int) -> OffsetEstimate | None:
        """Estimate for a time at or after the last sample; None before any exchange."""
        return None if self._fit is None else self._fit.at(session_ns)

    def _refit(self, now_ns: int) -> None:
        while self._exchanges and now_ns - self._exchanges[0][0] > self._window_ns:
            self._exchanges.popleft()
        while self._stamped and now_ns - self._stamped[0][0] > self._window_ns:
            self._stamped.popleft()
        fit = _fit(list(self._exchanges), list(self._stamped), self._drift_limit)
        if fit is None:
            # The stamps are from another clock.
            self._stamped.clear()
            fit = _fit(list(self._exchanges), [], self._drift_limit)
        while fit is None:
            # The clock was set: older samples contradict the newest.
            self._exchanges.popleft()
            fit = _fit(list(self._exchanges), [], self._drift_limit)
        self._fit = fit


class _Fit(Value):
    """Bounds of offset and rate that agree with all samples. Times relative to ``origin_ns``."""

    origin_ns: int
    base_ns: int
    age_s: NDArray[np.float64]
    lower_ns: NDArray[np.float64]
    upper_ns: NDArray[np.float64]
    slowest: float
    fastest: float

    def at(self, session_ns: int) -> OffsetEstimate:
        later_s = (session_ns - self.origin_ns) / 1e9
        age_s = self.age_s + later_s
        wander_ns = 0.5e9 * WANDER_PER_S * age_s**2
        # For a given rate all bounds shift equally with age, so the extremes are at the extreme rates.
        upper_ns = float(np.min(self.upper_ns + self.fastest * 1e9 * age_s + wander_ns))
        lower_ns = float(np.max(self.lower_ns + self.slowest * 1e9 * age_s - wander_ns))
        middle_ns, half_ns = (upper_ns + lower_ns) / 2.0, max(0.0, upper_ns - lower_ns) / 2.0
        return OffsetEstimate(self.base_ns + round(middle_ns), math.ceil(half_ns) + 1)


def _fit(exchanges: list[tuple[int, int, int]], stamped: list[tuple[int, int]], drift_limit: float) -> _Fit | None:
    """Fit; None if no constant rate within the limit agrees with all samples."""
    origin_ns, base_ns, _ = exchanges[-1]
    # Relative to the newest, since nanoseconds since 1970 exceed a float's precision.
    samples = [(at, lower - base_ns, float(upper - base_ns)) for at, lower, upper in exchanges]
    samples += [(at, bound - base_ns, math.inf) for at, bound in stamped]
    age_s = np.array([(origin_ns - at) / 1e9 for at, _, _ in samples])
    lower_ns = np.array([lower for _, lower, _ in samples], dtype=np.float64)
    upper_ns = np.array([upper for _, _, upper in samples], dtype=np.float64)
    wander_ns = 0.5e9 * WANDER_PER_S * age_s**2
    # A rate fits if, for every pair, the older bounds moved to the younger time still overlap.
    apart_s = age_s[:, None] - age_s[None, :]
    widening_ns = wander_ns[:, None] + wander_ns[None, :]
    with np.errstate(divide="ignore", invalid="ignore"):
        fastest = (upper_ns[None, :] - lower_ns[:, None] + widening_ns) / (apart_s * 1e9)
        slowest = (lower_ns[None, :] - upper_ns[:, None] - widening_ns) / (apart_s * 1e9)
    older = apart_s > 0.0
    fastest_rate = min(drift_limit, float(np.min(fastest[older], initial=drift_limit)))
    slowest_rate = max(-drift_limit, float(np.max(slowest[older], initial=-drift_limit)))
    if fastest_rate < slowest_rate:
        return None
    return _Fit(origin_ns, base_ns, age_s, lower_ns, upper_ns, slowest_rate, fastest_rate)
