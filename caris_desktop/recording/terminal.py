"""Terminal output of commands: failures, progress line and aligned tables."""

import functools
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from typing import ParamSpec, TextIO

from caris_desktop.domain.foreign_text import printable

CANCELLED = 130
"""Exit status after Ctrl+C, by the rule of shells."""
P = ParamSpec("P")


def reporting(*errors: type[Exception], cancelled: str = "") -> Callable[[Callable[P, int]], Callable[P, int]]:
    """Decorator of a command: one of ``errors`` is printed on stderr, with exit status 1; after Ctrl+C, ``cancelled``
    with 130.
    """

    def decorate(run: Callable[P, int]) -> Callable[P, int]:
        @functools.wraps(run)
        def reported(*args: P.args, **kwargs: P.kwargs) -> int:
            try:
                return run(*args, **kwargs)
            except errors as error:
                print(error, file=sys.stderr)
                return 1
            except KeyboardInterrupt:
                if not cancelled:
                    raise
                print(f"\n{cancelled}", file=sys.stderr)
                return CANCELLED

        return reported

    return decorate


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
