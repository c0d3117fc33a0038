"""Terminal output of commands: progress line and aligned tables."""

import shutil
import sys
from collections.abc import Callable, Sequence
from typing import TextIO

from caris_desktop.domain.printable import printable


class ProgressLine:
    """Progress line on stderr, rewritten in place; silent if stderr is not a terminal."""

    def __init__(self) -> None:
        self._out: TextIO = getattr(sys.stderr, "plain", sys.stderr)
        self._shows = self._out.isatty()

    def __enter__(self) -> "ProgressLine":
        return self

    def __exit__(self, *_: object) -> None:
        self.clear()

    def show(self, fraction: float, what: str) -> None:
        """Show ``fraction``, 0..1, and the present item."""
        if self._shows:
            room = max(20, shutil.get_terminal_size().columns - 8)
            self._out.write(f"\r{fraction:4.0%}  {printable(what[:room])}\033[K")
            self._out.flush()

    def clear(self) -> None:
        if self._shows:
            self._out.write("\r\033[K")
            self._out.flush()


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
