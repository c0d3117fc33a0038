"""What commands show in a terminal: how far long work is, and tables."""

import shutil
import sys
from collections.abc import Callable, Sequence
from typing import TextIO

from caris_desktop.domain.printable import printable


class ProgressLine:
    """One line on stderr that is written over and over; nothing where stderr is no terminal."""

    def __init__(self) -> None:
        self._out: TextIO = getattr(sys.stderr, "plain", sys.stderr)
        self._shows = self._out.isatty()

    def __enter__(self) -> "ProgressLine":
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()

    def show(self, fraction: float, what: str) -> None:
        """``fraction`` of all, 0..1, and what is being done."""
        if self._shows:
            room = max(20, shutil.get_terminal_size().columns - 8)
            self._out.write(f"\r{fraction:4.0%}  {printable(what[:room])}\033[K")
            self._out.flush()

    def clear(self) -> None:
        if self._shows:
            self._out.write("\r\033[K")
            self._out.flush()


def aligned(rows: Sequence[Sequence[str]], *, to_the_right: Callable[[int], bool]) -> list[str]:
    """A line for each row, its columns below one another; ``to_the_right`` tells by its number which ends there."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return [
        "  ".join(
            text.rjust(width) if to_the_right(column) else text.ljust(width)
            for column, (text, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
