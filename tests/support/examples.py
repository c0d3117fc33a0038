"""Number of examples for property-based tests."""

import os


def examples(count: int) -> int:
    """``count`` with ``--long``, otherwise a quarter of it, to keep normal runs short."""
    return count if "CARIS_TEST_LONG" in os.environ else max(10, count // 4)
