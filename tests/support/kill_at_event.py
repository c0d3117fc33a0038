"""A process that dies in the middle of its work with files."""

import os
import signal
import sys
from collections.abc import Collection
from pathlib import Path


def die_at(count: int, folder: Path, events: Collection[str], *, reading: bool = True) -> None:
    """From now on the ``count``-th of these audit events for something in ``folder`` is the last thing this process
    does. Without ``reading`` a file that is opened to be read does not count.
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
