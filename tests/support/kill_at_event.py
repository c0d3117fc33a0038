"""Process that kills itself in the middle of its file operations."""

import os
import signal
import sys
from collections.abc import Collection
from pathlib import Path


def kill_at_event(count: int, folder: Path, events: Collection[str], *, reading: bool = True) -> None:
    """Kill this process at the ``count``-th of these audit events for a path in ``folder``.

    Opening a file for reading counts only with ``reading``.
    """
    happened = 0

    def on_event(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal happened
        if event not in events or not str(arguments[0]).startswith(str(folder)):
            return
        if not reading and event == "open" and not int(str(arguments[2])) & (os.O_WRONLY | os.O_RDWR):
            return
        happened += 1
        if happened == count:
            os.kill(os.getpid(), signal.SIGKILL)

    sys.addaudithook(on_event)
