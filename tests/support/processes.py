"""Processes of others, which may end while one looks at them."""

from collections.abc import Iterable

import psutil


def alive(pids: Iterable[int]) -> list[int]:
    """Those that run. One that has ended and was not waited for yet does not."""
    return [pid for pid in pids if _runs(pid)]


def _runs(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
