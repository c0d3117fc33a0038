"""Real-time priority for the control link, where the system permits it.

With normal scheduling on two busy cores a key press reached the socket after 8 to 9 ms (p95), with real-time scheduling
as for audio programs after 2.5 ms. With root or ``rtprio`` in ``limits.conf`` the process sets it; on a Linux desktop
RealtimeKit grants it to any user, under the conditions in its README (https://github.com/heftig/rtkit).

A real-time process must be fast. If it computes for longer than ``LONGEST_S`` without a pause, or receives a message
that may take that long to decode, it returns to normal priority for good.
"""

import contextlib
import logging
import os
import signal
import sys
import threading
from pathlib import Path

logger = logging.getLogger(__name__)

LONGEST_S = 0.1
LARGE_BYTES = 2**19
"""No robot sends as much in one message over this link; a scan has a tenth of it."""

_NICENESS = -10
_PRIORITY = 1
_RTKIT = "org.freedesktop.RealtimeKit1"
_RTKIT_LONGEST_S = 0.2
"""Who computes for so long without a pause is ended by the system: RealtimeKit asks for this limit first."""
_ANSWERED_WITHIN_S = 5.0


def request_realtime_priority() -> None:
    """Request real-time priority for this process, as far as the system permits. Main thread only."""
    if sys.platform != "win32":
        with contextlib.suppress(OSError):
            os.nice(_NICENESS)
    if sys.platform != "linux":
        return
    _limit_to(LONGEST_S)
    signal.signal(signal.SIGXCPU, _on_long)
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(_PRIORITY))
    except OSError:
        threading.Thread(target=_ask_realtime_kit, name="real-time", daemon=True).start()
    else:
        logger.info("comes before other programs")


def has_realtime_priority() -> bool:
    """True while it has real-time priority."""
    if sys.platform != "linux":
        return False
    return os.sched_getscheduler(os.getpid()) & ~os.SCHED_RESET_ON_FORK == os.SCHED_RR


def drop_realtime_priority() -> None:
    """Return to normal priority."""
    if not has_realtime_priority():
        return
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # one that has just ended
            # Any process may leave the flag that RealtimeKit sets, but few may clear it.
            flag = os.sched_getscheduler(int(thread.name)) & os.SCHED_RESET_ON_FORK
            os.sched_setscheduler(int(thread.name), os.SCHED_OTHER | flag, os.sched_param(0))


def _on_long(_signal: int, _frame: object) -> None:
    drop_realtime_priority()
    logger.warning("computed for more than %.1f s without a pause: other programs have their turn again", LONGEST_S)


def _limit_to(longest_s: float, at_most_s: float | None = None) -> None:
    """Limits for real-time computation without a pause: SIGXCPU, and SIGKILL after ``at_most_s``."""
    import resource

    _soft, hard = resource.getrlimit(resource.RLIMIT_RTTIME)
    most = hard if at_most_s is None else round(at_most_s * 1e6)
    resource.setrlimit(resource.RLIMIT_RTTIME, (round(longest_s * 1e6), most))


def _ask_realtime_kit() -> None:
    """Ask RealtimeKit, in a thread, as the answer may be slow or missing."""
    from jeepney import DBusAddress, DBusErrorResponse, new_method_call
    from jeepney.io.blocking import open_dbus_connection
    from jeepney.wrappers import unwrap_msg

    kit = DBusAddress("/org/freedesktop/RealtimeKit1", _RTKIT, _RTKIT)
    own_tid = threading.get_native_id()
    others = [tid for thread in Path("/proc/self/task").iterdir() if (tid := int(thread.name)) != own_tid]
    try:
        _limit_to(LONGEST_S, _RTKIT_LONGEST_S)
        with open_dbus_connection(bus="SYSTEM") as bus:
            for tid in others:
                call = new_method_call(kit, "MakeThreadRealtime", "tu", (tid, _PRIORITY))
                unwrap_msg(bus.send_and_get_reply(call, timeout=_ANSWERED_WITHIN_S))
    except (OSError, ValueError, KeyError, TimeoutError, DBusErrorResponse) as error:
        logger.info("waits for its turn like other programs: %s", error)
    else:
        logger.info("comes before other programs, by leave of RealtimeKit")
