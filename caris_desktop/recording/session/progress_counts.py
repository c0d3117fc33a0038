"""Value counts of a running recording, updated every few seconds, to detect data loss after an interruption.

The file exists only while a session is recorded; afterwards ``session.json`` has the counts.
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


def store_counts(folder: Path, counts: Mapping[str, int]) -> Path:
    """Store the number of values per stream, without fsync; return the path.

    Raises OSError.
    """
    path = folder / COUNTS_NAME
    replace_file(path, json.dumps(dict(counts)).encode(), durable=False)
    return path


def progress_counts(folder: Path) -> Counter[str] | None:
    """Last stored counts; None if there are none."""
    try:
        with (folder / COUNTS_NAME).open("rb") as file:
            data = json.loads(file.read(_MAX_BYTES))
    except (OSError, ValueError, RecursionError):
        return None
    if not isinstance(data, dict):
        return None
    return Counter({str(name): count for name, count in data.items() if isinstance(count, int) and count > 0}) or None


def forget_counts(folder: Path) -> None:
    """Remove the file once the session header has the counts."""
    try:
        (folder / COUNTS_NAME).unlink(missing_ok=True)
    except OSError:
        _log.warning("%s stays behind", folder / COUNTS_NAME, exc_info=True)
