"""How many values were in the record a few seconds ago: what a recording that is cut off can be compared with.

The file is there while a session is recorded, and goes with its end: ``session.json`` has the counts then.
"""

import json
import logging
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

from caris_desktop.domain.file_replacement import replace_file

_log = logging.getLogger(__name__)
COUNTS_NAME = "counts.json"
_MAX_BYTES = 1024 * 1024


def keep_counts(folder: Path, counts: Mapping[str, int]) -> Path:
    """Write down how many values of each stream are in the record now; where. Does not wait for the disk.

    Raises OSError.
    """
    path = folder / COUNTS_NAME
    replace_file(path, json.dumps(dict(counts)).encode(), durable=False)
    return path


def last_counts(folder: Path) -> Counter[str] | None:
    """What was written down last; None where nothing was."""
    try:
        with (folder / COUNTS_NAME).open("rb") as file:
            data = json.loads(file.read(_MAX_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    return counts_of(data)


def counts_of(data: object) -> Counter[str] | None:
    """Counts as a file tells them; None where it tells none."""
    if not isinstance(data, dict):
        return None
    return Counter({str(name): count for name, count in data.items() if isinstance(count, int) and count > 0}) or None


def forget_counts(folder: Path) -> None:
    """The head of the session has them now."""
    try:
        (folder / COUNTS_NAME).unlink(missing_ok=True)
    except OSError:
        _log.warning("%s stays behind", folder / COUNTS_NAME, exc_info=True)
