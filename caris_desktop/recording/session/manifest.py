"""``manifest-sha256.txt``: the checksum of every file of a closed session, as ``sha256sum -c`` reads it.

What is made of the session afterwards, annotations, exports and derived layers, is no part of it.
"""

import hashlib
import re
from collections.abc import Callable
from pathlib import Path, PurePosixPath

from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.recording.session.last_counts import COUNTS_NAME

MANIFEST_NAME = "manifest-sha256.txt"
DERIVED_FOLDER = "derived"
"""Of what was made of the session's videos again afterwards."""
_OUTSIDE = re.compile(rf"annotations|export-.*|{DERIVED_FOLDER}")
_BLOCK_BYTES = 1 << 20
_LINE = re.compile(r"(\\?)([0-9a-f]{64}) [ *](.+)")


class HashingStopped(Exception):  # noqa: N818 - no error: somebody asked for it
    """Whoever asked for the manifest no longer waits for it."""


def write_manifest(folder: Path, *, may_go_on: Callable[[], bool] = lambda: True) -> Path:
    """Hash every file of the session in ``folder``; the manifest appears whole or not at all, on the disk itself.

    Raises
    ------
    OSError
        If a file cannot be read or the manifest not be written.
    HashingStopped
        If ``may_go_on``, asked about every few milliseconds, says no.
    """
    lines = []
    for name in session_files(folder):
        digest = _digest(folder / name, may_go_on)
        escaped = name.replace("\\", "\\\\").replace("\n", "\\n").replace("\r", "\\r")
        lines.append(f"{'' if escaped == name else chr(92)}{digest}  {escaped}\n")
    path = folder / MANIFEST_NAME
    replace_file(path, "".join(lines).encode("utf-8", "surrogateescape"), durable=True)
    return path


def verify_manifest(folder: Path) -> list[str]:
    """What is not as the manifest says, one sentence each; empty when all is as it was when the session closed.

    Raises
    ------
    OSError
        If the manifest itself cannot be read (FileNotFoundError where there is none).
    """
    text = (folder / MANIFEST_NAME).read_bytes().decode("utf-8", "surrogateescape")
    problems, listed = [], set()
    for number, line in enumerate(text.removesuffix("\n").split("\n"), start=1):
        match = _LINE.fullmatch(line)
        if match is None:
            problems.append(f"Line {number} of {MANIFEST_NAME} is no checksum.")
            continue
        escaped, digest, name = match.groups()
        if escaped:
            name = re.sub(r"\\(.)", lambda found: {"n": "\n", "r": "\r"}.get(found[1], found[1]), name)
        listed.add(name)
        problem = _problem_of(folder, name, digest)
        if problem:
            problems.append(problem)
    problems += [f"{name} was added after the session closed." for name in session_files(folder) if name not in listed]
    return problems


def session_files(folder: Path) -> list[str]:
    """The files that make up a session, sorted, as relative paths with forward slashes.

    Without the manifest itself, annotations, exports, derived layers, the counts of a recording under way, and what is
    hidden: that is there only while something is being written, or is some program's own.
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
        return f"{name} does not lie in the session's folder."
    try:
        found = _digest(path, lambda: True)
    except FileNotFoundError:
        return f"{name} is missing."
    except OSError as error:
        return f"{name} cannot be read: {error.strerror or error}."
    return "" if found == digest else f"{name} was changed after the session closed."


def _digest(path: Path, may_go_on: Callable[[], bool]) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK_BYTES):
            digest.update(block)
            if not may_go_on():
                raise HashingStopped
    return digest.hexdigest()
