"""Terminal output of commands: progress line and aligned tables."""

import shutil
import sys
import time
from collections.abc import Callable, Sequence
from typing import TextIO

from caris_desktop.domain.foreign_text import printable


class ProgressLine:
    """Progress line on stderr with the time left, rewritten in place; silent if stderr is not a terminal."""

    def __init__(self) -> None:
        self._out: TextIO = getattr(sys.stderr, "plain", sys.stderr)
        self._shows = sys.stderr is not None and self._out.isatty()
        self._began_s = time.monotonic()

    def __enter__(self) -> "ProgressLine":
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()

    def show(self, fraction: float, what: str) -> None:
        """Show ``fraction``, 0..1, and the present item."""
        if self._shows:
            left = f"  {_time_left(time.monotonic() - self._began_s, fraction)}"
            room = max(20, shutil.get_terminal_size().columns - 8 - len(left))
            self._out.write(f"\r{fraction:4.0%}{left}  {printable(what[:room])}\033[K")
            self._out.flush()

    def clear(self) -> None:
        if self._shows:
            self._out.write("\r\033[K")
            self._out.flush()


def _time_left(took_s: float, fraction: float) -> str:
    """Estimate as ``m:ss left``; blank while there is nothing to go by."""
    if took_s < 2.0 or not 0.0 < fraction < 1.0:
        return " " * 10
    left_s = round(took_s * (1 - fraction) / fraction)
    return f"{left_s // 60:2}:{left_s % 60:02} left"


def aligned(rows: Sequence[Sequence[str]], *, to_the_right: Callable[[int], bool]) -> list[str]:
    """Rows as text with aligned columns; ``to_the_right`` selects right-aligned ones by index."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(
            text.rjust(width) if to_the_right(column) else text.ljust(width)
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
