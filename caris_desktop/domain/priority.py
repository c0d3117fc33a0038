"""Who lets others go first when the processor is busy."""

import os
import sys
import threading
import time
from pathlib import Path

RECORD_NICENESS = 5
"""Of what writes the record: behind the window and the links, before whatever only shows something."""

_SESSION = Path("/proc/self/autogroup")
# Linux hears one process of all that are not root's in a tenth of a second.
_AGAIN_AFTER_S = 0.13
_TRIES = 50


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
    if os.getsid(0) == os.getpid() and not _say_for_session(niceness // 2):
        threading.Thread(target=_say_until_heard, args=(niceness // 2,), name="step-back", daemon=True).start()


def _say_for_session(niceness: int) -> bool:
    """False where it was not heard, since others say the same just now."""
    try:
        _SESSION.write_text(str(niceness))
    except BlockingIOError:
        return False
    except OSError:
        return True  # not every kernel has it
    return True


def _say_until_heard(niceness: int) -> None:
    for _try in range(_TRIES):
        time.sleep(_AGAIN_AFTER_S)
        if _say_for_session(niceness):
            return
