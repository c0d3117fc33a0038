"""Cached syntax trees of source files that several checks share."""

import ast
import gc
from functools import cache
from pathlib import Path


@cache
def parsed(source: str) -> ast.Module:
    """Shared syntax tree; must not be modified."""
    return ast.parse(source)


def parse_all(folder: Path) -> None:
    """Parse all sources before the first test of a file, and exclude the trees from garbage collection."""
    for path in folder.rglob("*.py"):
        parsed(path.read_text("utf-8"))
    gc.freeze()
