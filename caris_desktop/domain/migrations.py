"""Files of older versions, brought up to the present format one version at a time."""

from collections.abc import Callable, Mapping
from typing import Any

# What a file of one version says, as the next one says it. A step that was once released is never changed.
Migration = Callable[[dict[str, Any]], dict[str, Any]]


def migrated(data: dict[str, Any], migrations: Mapping[int, Migration], *, version: int, newest: int) -> dict[str, Any]:
    """``data`` of ``version`` as ``newest`` says them; the argument is left alone."""
    raised = dict(data)
    for step in range(version, newest):
        raised = migrations[step](dict(raised))
        raised["version"] = step + 1
    return raised
