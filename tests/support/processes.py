"""State of processes that may exit at any time."""

from collections.abc import Iterable

import psutil


def alive(pids: Iterable[int]) -> list[int]:
    """PIDs of the running processes; zombies do not count."""
    return [pid for pid in pids if _runs(pid)]


def _runs(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
