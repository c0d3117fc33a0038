"""Migration of files of older versions, one version at a time."""

from collections.abc import Callable, Mapping
from typing import Any

# Converts data of one version to the next. A released migration never changes.
Migration = Callable[[dict[str, Any]], dict[str, Any]]


def migrated(data: dict[str, Any], migrations: Mapping[int, Migration], *, version: int, newest: int) -> dict[str, Any]:
    """Copy of ``data`` migrated from ``version`` to ``newest``."""
    raised = dict(data)
    for step in range(version, newest):
        raised = migrations[step](dict(raised))
        raised["version"] = step + 1
    return raised
