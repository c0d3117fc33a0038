"""Clock offset estimate of a remote camera's computer, from round trips."""

import logging
from collections import deque
from collections.abc import Callable

from caris_desktop.domain import clock
from caris_desktop.perception.cameras.camera_source import CameraError, ChosenCamera
from caris_desktop.perception.cameras.http_request import CameraConnection

_log = logging.getLogger(__name__)
_FIRST_ROUND_TRIPS = 8
_ASK_EVERY_NS = 2_000_000_000

_HISTORY = 30
# Maximum drift between ordinary computers' clocks, in ns per ns.
_DRIFT = 50e-6


class RemoteClockEstimate:
    """Remote clock estimate; ``ask`` returns the remote monotonic clock in ns, with one round trip."""

    def __init__(self, ask: Callable[[], int], *, now_ns: Callable[[], int] = clock.now_ns) -> None:
        self._ask = ask
        self._now_ns = now_ns
        self._measured: deque[tuple[int, int, int]] = deque(maxlen=_HISTORY)

    def measure(self) -> None:
        """Measure one round trip; the shortest ones are the most accurate. Raises what ``ask`` raises."""
        requested_ns = self._now_ns()
        far_ns = self._ask()
        received_ns = self._now_ns()
        self._measured.append(
            (received_ns, far_ns - (requested_ns + received_ns) // 2, (received_ns - requested_ns) // 2)
        )

    def here(self, far_ns: int) -> tuple[int, int] | None:
        """Remote time in session time, and its uncertainty; None if not known well enough."""
        if not self._measured:
            return None
        now_ns = self._now_ns()
        uncertainty_ns, offset_ns = min(
            (round(half_ns + _DRIFT * (now_ns - at_ns)), offset_ns) for at_ns, offset_ns, half_ns in self._measured
        )
        taken_ns = clock.measured_ns(far_ns, arrival_ns=now_ns, offset_ns=offset_ns, uncertainty_ns=uncertainty_ns)
        return None if taken_ns is None else (taken_ns, uncertainty_ns)


class ServedClock:
    """Clock of a camera server, polled over HTTP: several times at first, then periodically."""

    def __init__(self, chosen: ChosenCamera, path: str) -> None:
        self._chosen = chosen
        self._path = path
        self._connection: CameraConnection | None = None
        self._clock = RemoteClockEstimate(self._notify)
        self._requested_ns = 0
        for _ in range(_FIRST_ROUND_TRIPS):
            self._ask()

    def here(self, far_ns: int) -> tuple[int, int] | None:
        """As :meth:`RemoteClockEstimate.here`, with an occasional round trip."""
        if clock.now_ns() - self._requested_ns >= _ASK_EVERY_NS:
            self._ask()
        return self._clock.here(far_ns)

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()

    def _notify(self) -> int:
        if self._connection is None:
            self._connection = CameraConnection(self._chosen)
        return int(self._connection.ask("GET", self._path)[1])

    def _ask(self) -> None:
        self._requested_ns = clock.now_ns()
        try:
            self._clock.measure()
        except (CameraError, ValueError):
            _log.info("the clock of %s was not told", self._chosen.name, exc_info=True)
