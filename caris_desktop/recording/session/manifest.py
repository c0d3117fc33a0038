"""``manifest-sha256.txt``: checksums of all files of a closed session, for ``sha256sum -c``.

Later results (annotations, exports, derived layers) are excluded.
"""

import hashlib
import json
import logging
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path, PurePosixPath

from caris_desktop.domain.file_replacement import replace_file

# Value counts of a running recording, updated every few seconds, to detect data loss after an interruption.
#
# The file exists only while a session is recorded; afterwards ``session.json`` has the counts.

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


MANIFEST_NAME = "manifest-sha256.txt"
DERIVED_FOLDER = "derived"
"""Of what was made of the session's videos again afterwards."""
_OUTSIDE = re.compile(rf"annotations|export-.*|{DERIVED_FOLDER}")
_BLOCK_BYTES = 1 << 20
_LINE = re.compile(r"(\\?)([0-9a-f]{64}) [ *](.+)")


class HashingStopped(Exception):  # noqa: N818 - no error: somebody asked for it
    """The caller no longer waits for the manifest."""


def write_manifest(folder: Path, *, may_go_on: Callable[[], bool] = lambda: True) -> Path:
    """Hash every file of the session in ``folder``; the manifest is written atomically and synced.

    Raises OSError if a file cannot be read or the manifest not be written. Raises HashingStopped if ``may_go_on``,
    asked about every few milliseconds, says no.
    """
    lines = []

    def stop(_count: int) -> None:
        if not may_go_on():
            raise HashingStopped

    for name in session_files(folder):
        digest = digest_of(folder / name, stop)
        escaped = name.replace("\\", "\\\\").replace("\n", "\\n").replace("\r", "\\r")
        lines.append(f"{'' if escaped == name else chr(92)}{digest}  {escaped}\n")
    path = folder / MANIFEST_NAME
    for unfinished in folder.glob(f".{MANIFEST_NAME}.*.part"):  # of a process that was killed
        unfinished.unlink(missing_ok=True)
    replace_file(path, "".join(lines).encode("utf-8", "surrogateescape"), durable=True)
    return path


def verify_manifest(folder: Path) -> list[str]:
    """Differences from the manifest, one sentence each; empty if all files are as at the close of the session.

    Raises OSError if the manifest itself cannot be read (FileNotFoundError where there is none).
    """
    problems, listed = [], set()
    for number, entry in enumerate(manifest_entries(folder), start=1):
        if entry is None:
            problems.append(f"Line {number} of {MANIFEST_NAME} is not a checksum.")
            continue
        name, digest = entry
        listed.add(name)
        problem = _problem_of(folder, name, digest)
        if problem:
            problems.append(problem)
    problems += [f"{name} was added after the session closed." for name in session_files(folder) if name not in listed]
    return problems


def manifest_entries(folder: Path) -> Iterator[tuple[str, str] | None]:
    """Name and checksum of each line of the manifest; None for a line that is no entry. Raises OSError."""
    text = (folder / MANIFEST_NAME).read_bytes().decode("utf-8", "surrogateescape")
    for line in text.removesuffix("\n").split("\n"):
        match = _LINE.fullmatch(line)
        if match is None:
            yield None
            continue
        escaped, digest, name = match.groups()
        if escaped:
            name = re.sub(r"\\(.)", lambda found: {"n": "\n", "r": "\r"}.get(found[1], found[1]), name)
        yield name, digest


def session_files(folder: Path) -> list[str]:
    """Files of a session, sorted, as relative paths with forward slashes.

    Excludes the manifest, annotations, exports, derived layers, the counts of a running recording, and hidden files,
    which are temporary or belong to other programs.
    """
    names = []
    for path in folder.rglob("*"):
        name = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in name.parts)
        outside = name.as_posix() in (MANIFEST_NAME, COUNTS_NAME) or _OUTSIDE.fullmatch(name.parts[0])
        if not (hidden or outside or path.is_symlink()) and path.is_file():
            names.append(name.as_posix())
    return sorted(names)


def _problem_of(folder: Path, name: str, digest: str) -> str:
    pure = PurePosixPath(name)
    path = folder / name
    if pure.is_absolute() or ".." in pure.parts or not path.resolve().is_relative_to(folder.resolve()):
        return f"{name} is outside the session folder."
    try:
        found = digest_of(path)
    except FileNotFoundError:
        return f"{name} is missing."
    except OSError as error:
        return f"{name} cannot be read: {error.strerror or error}."
    return "" if found == digest else f"{name} was changed after the session closed."


def digest_of(path: Path, on_bytes: Callable[[int], object] = lambda _count: None) -> str:
    """SHA-256 of a file. ``on_bytes`` gets the length of each piece, and may raise to stop. Raises OSError."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK_BYTES):
            digest.update(block)
            on_bytes(len(block))
    return digest.hexdigest()
