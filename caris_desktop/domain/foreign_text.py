"""Text and JSON of others: bounded reading, characters made safe for a terminal or question, and a strict parser."""

import errno
import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any


def read_bounded(path: Path, most_bytes: int) -> bytes:
    """First ``most_bytes`` of a regular file, and one more if it is longer.

    Raises OSError, also for a device or pipe, which may have no end or no beginning.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "not a regular file")
    with path.open("rb") as file:
        return file.read(most_bytes + 1)


def typed_path(text: str | Path) -> Path:
    """Path that a person typed or a file names, with ``~`` as the home folder; as it is if there is no such user."""
    path = Path(text)
    with suppress(RuntimeError):
        return path.expanduser()
    return path


def printable(text: str, *, lines: bool = False) -> str:
    """``text`` with non-printable characters escaped as ``\\x1b`` or ``\\u202e``; with ``lines``, line breaks and tabs
    remain.
    """
    if text.isprintable():
        return text
    return "".join(
        one if one.isprintable() or (lines and one in "\n\t") else one.encode("unicode_escape").decode() for one in text
    )


class PrintableStream:
    """Output stream whose text is :func:`printable`, line by line. ``plain`` is the underlying stream; ``failure`` is
    why it could not be written.
    """

    def __init__(self, plain: Any) -> None:
        self.plain = getattr(plain, "plain", plain)
        self.failure: OSError | None = None

    def write(self, text: str) -> int:
        with self._noting_failure():
            self.plain.write(printable(text, lines=True))
        return len(text)

    def flush(self) -> None:
        with self._noting_failure():
            self.plain.flush()

    @contextmanager
    def _noting_failure(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            self.failure = error
            raise

    def writelines(self, lines: Iterable[str]) -> None:
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.plain, name)


# Parser for JSON from other sources.


def parse_json(text: str | bytes | bytearray) -> Any:
    """``json.loads`` that raises ValueError for too deeply nested text as well."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
