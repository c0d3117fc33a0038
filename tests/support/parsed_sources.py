"""Sources as syntax trees: each that several checks look through is parsed once, which takes longer than to look."""

import ast
import gc
from functools import cache
from pathlib import Path


@cache
def parsed(source: str) -> ast.Module:
    """To be looked through, never changed."""
    return ast.parse(source)


def parse_all(folder: Path) -> None:
    """For the tests of a file, before the first: what is collected between them leaves these million nodes alone."""
    for path in folder.rglob("*.py"):
        parsed(path.read_text("utf-8"))
    gc.freeze()
