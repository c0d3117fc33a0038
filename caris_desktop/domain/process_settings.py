"""Priority and title of a process: background processes yield to window and links on a busy processor."""

import os
import sys
import threading
import time
from pathlib import Path

from setproctitle import setproctitle

RECORD_NICENESS = 5
"""Niceness of recording processes: behind the window and the links, before mere displays."""

_SESSION = Path("/proc/self/autogroup")
# Linux accepts one write in a tenth of a second from all processes without root.
_AGAIN_AFTER_S = 0.13
_TRIES = 50


def step_back(niceness: int) -> None:
    """Lower the priority of this process permanently in favour of window and links.

    A process in a separate session, such as the console's children, must lower its session too. Linux divides the
    processor among sessions first (autogroup), and niceness counts within one only. The session gets half the niceness,
    since every other session, of any busy program, counts in full.
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
    """False if refused because other processes write theirs just now."""
    try:
        _SESSION.write_text(str(niceness))
    except BlockingIOError:
        return False
    except OSError:
        return True  # not every kernel supports it
    return True


def _say_until_heard(niceness: int) -> None:
    for _try in range(_TRIES):
        time.sleep(_AGAIN_AFTER_S)
        if _say_for_session(niceness):
            return


# Process titles for system monitors, in place of the name of Python.

_DOES = {
    "simulate": "simulated robot",
    "control": "driving and sensors",
    "media": "pictures and maps",
    "inference": "people detection",
    "recorder": "recording",
    "language-model": "language model",
    "camera-server": "camera server",
    "overview": "coding overview",
}


def title_process(name: str) -> None:
    """Set this process's title; ``name`` is its name in the log or its command."""
    setproctitle(f"caris: {title_of(name)}")


def title_of(name: str) -> str:
    """Its purpose in a word or two."""
    return _DOES.get(name, name)
