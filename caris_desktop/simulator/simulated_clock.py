"""Clock of the simulated robot: this computer's, one with offset and drift, or simulation time."""

import time
from collections.abc import Callable

_NS_PER_S = 1_000_000_000


class RobotClock:
    """Robot time.

    Parameters
    ----------
    simulated_s
        Simulation time, where the robot goes by that; None for this computer's clock.
    """

    def __init__(self, simulated_s: Callable[[], float] | None = None) -> None:
        self._simulated_s = simulated_s
        self._offset_ns = 0
        self._drift = 0.0
        self._drifts_from_ns = 0

    def now_ns(self) -> int:
        """Time for stamps."""
        true_ns = self._true_ns()
        return true_ns + self._offset_ns + round((true_ns - self._drifts_from_ns) * self._drift)

    def now_s(self) -> float:
        return self.now_ns() / _NS_PER_S

    def disagree(self, *, offset_s: float = 0.0, drift_ppm: float = 0.0) -> None:
        """Set an offset of ``offset_s`` and a drift of ``drift_ppm``."""
        self._offset_ns = round(offset_s * _NS_PER_S)
        self._drift = drift_ppm * 1e-6
        self._drifts_from_ns = self._true_ns()

    def _true_ns(self) -> int:
        return time.time_ns() if self._simulated_s is None else round(self._simulated_s() * _NS_PER_S)
