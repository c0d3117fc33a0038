"""Polling for an observable condition; only a failing program reaches the timeout."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")


def wait_for(observe: Callable[[], T], what: str, *, timeout_s: float = 20.0, every_s: float = 0.01) -> T:
    """Return the first truthy observation; AssertionError with ``what`` after ``timeout_s``."""
    until_s = time.monotonic() + timeout_s
    while True:
        observed = observe()
        if observed:
            return observed
        if time.monotonic() > until_s:
            raise AssertionError(f"timeout after {timeout_s:.0f} s: {what}")
        time.sleep(every_s)
