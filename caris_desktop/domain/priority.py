"""Who lets others go first when the processor is busy."""

import contextlib
import ctypes
import os
import struct
import sys
from pathlib import Path

# The number of Linux's sched_setattr, which Python does not offer, by machine.
_SCHED_SETATTR = {"x86_64": 314, "aarch64": 274, "riscv64": 274}
_SHORT_TURN_NS = 100_000
_NOT_FOR_CHILDREN = 1


def step_back(niceness: int) -> None:
    """Let the window and the links go first: this process is in the background, from now on and for good.

    A process in a session of its own, as the console's children are, has to say so for its session too: Linux shares
    the processor among sessions first, and niceness counts within one only. There half of it is said, as every other
    session counts in full, those of programs that only burn included.
    """
    if niceness <= 0:
        return
    if sys.platform == "win32":
        import psutil

        psutil.Process().nice(psutil.BELOW_NORMAL_PRIORITY_CLASS)
        return
    os.nice(niceness)
    if os.getsid(0) == os.getpid():
        with contextlib.suppress(OSError):  # not every kernel has it
            Path("/proc/self/autogroup").write_text(str(niceness // 2))


def take_short_turns() -> None:
    """Let this thread run as soon as it has something to do, in turns of a tenth of a millisecond.

    Linux from 6.12 on lets whoever asks for shorter turns go first, without a larger share and for every user. Of a
    process that waits beside four that burn two cores, one in twenty wake-ups came after 4 ms, and with this after
    0.15 ms. What this thread starts later takes turns as usual. Elsewhere nothing happens.
    """
    number = _SCHED_SETATTR.get(os.uname().machine) if sys.platform == "linux" else None
    if number is None:
        return
    size, policy, deadline_ns, period_ns, realtime_priority = 48, os.SCHED_OTHER, 0, 0, 0
    niceness = os.getpriority(os.PRIO_PROCESS, 0)
    attributes = struct.pack(
        "=IIQiIQQQ",
        size, policy, _NOT_FOR_CHILDREN, niceness, realtime_priority, _SHORT_TURN_NS, deadline_ns, period_ns,
    )  # fmt: skip
    # A sandbox may forbid it; then it stays as it was.
    ctypes.CDLL(None).syscall(number, 0, attributes, 0)
