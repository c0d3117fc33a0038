"""Foreign programs that use every core completely."""

import subprocess
import sys

# Exits with the benchmark in every case.
_BURN = """
import os
parent = os.getppid()
while os.getppid() == parent:
    for _ in range(1_000_000):
        pass
"""


class Burners:
    """``count`` such programs until ``end``."""

    def __init__(self, count: int) -> None:
        # Another session, as of programs started elsewhere: Linux shares its cores among sessions first.
        self._running = [subprocess.Popen([sys.executable, "-c", _BURN], start_new_session=True) for _ in range(count)]

    def end(self) -> None:
        for process in self._running:
            process.kill()
        for process in self._running:
            process.wait()
