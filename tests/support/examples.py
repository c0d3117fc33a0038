"""How many examples a property is tried with."""

import os


def examples(count: int) -> int:
    """``count`` under ``--long``, and a quarter of it where every change waits for the answer."""
    return count if "CARIS_TEST_LONG" in os.environ else max(10, count // 4)
