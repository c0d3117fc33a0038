"""Programs of somebody else that burn every core."""

import subprocess
import sys

# Ends with the benchmark, however that ends.
_BURN = """
import os
parent = os.getppid()
while os.getppid() == parent:
    for _ in range(1_000_000):
        pass
"""


class Burners:
    """So many of them, until ``end``."""

    def __init__(self, count: int) -> None:
        # Of another session, as what is started elsewhere is: Linux shares its cores among sessions first.
        self._running = [subprocess.Popen([sys.executable, "-c", _BURN], start_new_session=True) for _ in range(count)]

    def end(self) -> None:
        for process in self._running:
            process.kill()
        for process in self._running:
            process.wait()
