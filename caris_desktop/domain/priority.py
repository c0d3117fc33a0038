"""Who lets others go first when the processor is busy."""

import contextlib
import os
import sys
from pathlib import Path

RECORD_NICENESS = 5
"""Of what writes the record: behind the window and the links, before whatever only shows something."""


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
