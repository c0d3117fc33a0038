"""Journal of an erasure in progress, so that it can resume after a kill at any time. It holds no personal data."""

import hashlib
import json
import logging
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from caris_desktop.domain.file_replacement import SHOWN_CHARACTERS, bring_to_disk
from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.domain.value_class import Value

_log = logging.getLogger(__name__)
FOLDER = "forgotten"
PART = ".forgetting.part"


class Change(Value):
    """Change of one file. ``after`` is the SHA-256 of its new content, empty if removed.

    The old digest is not recorded: a name could be guessed from it by trial.
    """

    file: str
    what: str
    after: str
    count: int = 0


class Journal:
    """JSON lines in ``STUDY/forgotten``, each flushed to disk before its action. Methods raise OSError."""

    def __init__(self, study: Path, person_id: str, *, without_names: Callable[[str], str]) -> None:
        """``without_names`` redacts file names, which may contain anything."""
        self._study = study
        self._without_names = without_names
        self.path = path_of(study, person_id)
        self.resumed = self.path.exists()
        self._lines: list[dict[str, Any]] = []
        self._changes: dict[tuple[str, str], Change] = {}
        self._left: set[str] = set()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.resumed:
            self._read_entries()
        else:
            self.path.touch()
            bring_to_disk(self.path.parent)

    def note(self, **entry: Any) -> None:
        with self.path.open("ab") as file:
            file.write(json.dumps(entry, separators=(",", ":")).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        self._remember(entry)

    def noted(self, key: str) -> Any:
        """Last noted value of ``key``; None if there is none."""
        return next((line[key] for line in reversed(self._lines) if key in line), None)

    def changes(self) -> list[Change]:
        """Last completed change of each file and kind."""
        return list(self._changes.values())

    def changes_in(self, folder: Path) -> list[Change]:
        """Those of files in ``folder``, named relative to it."""
        inside = f"{self.name_of(folder)}/"
        found = (change for change in self._changes.values() if change.file.startswith(inside))
        return [replace(change, file=change.file.removeprefix(inside)) for change in found]

    def was_done(self, path: Path, what: str) -> bool:
        """True if the change was made and the file is still as it left it."""
        change = self._changes.get((self.name_of(path), what))
        if change is None:
            return False
        try:
            # Or as a later step left it.
            return digest_of(path) in self._left
        except FileNotFoundError:
            return change.after == ""

    def replace(self, path: Path, what: str, make: Callable[[Path], int]) -> None:
        """Replace a file by what ``make`` writes to the given path; ``make`` returns the number of changes.

        The old file stays if that fails.
        """
        # Not replace_file: videos are written by another program to a path, and the journal entry must come between the
        # completion of the new file and the replacement of the old.
        part = path.with_name(f".{path.name[:SHOWN_CHARACTERS]}{PART}")
        part.unlink(missing_ok=True)
        try:
            count = make(part)
            bring_to_disk(part)
            part.chmod(path.stat().st_mode & 0o7777)
            self.note(file=self.name_of(path), what=what, after=digest_of(part), count=count)
            part.replace(path)
        except BaseException:
            part.unlink(missing_ok=True)
            raise
        bring_to_disk(path.parent)

    def remove(self, path: Path, what: str) -> None:
        self.note(file=self.name_of(path), what=what, after="", count=1)
        path.unlink()

    def name_of(self, path: Path) -> str:
        """Path of the file in the study, or of the user's other files relative to their home folder."""
        if path.is_relative_to(self._study):
            return self._without_names(path.relative_to(self._study).as_posix())
        home = Path.home()
        return self._without_names(f"~/{path.relative_to(home).as_posix()}" if path.is_relative_to(home) else str(path))

    def end(self) -> None:
        self.path.unlink(missing_ok=True)
        bring_to_disk(self.path.parent)

    def _remember(self, entry: dict[str, Any]) -> None:
        self._lines.append(entry)
        if "file" in entry:
            entry = {key: value for key, value in entry.items() if key != "before"}  # written by older versions
            change = Change(**entry)
            self._changes[change.file, change.what] = change
            self._left.add(change.after)

    def _read_entries(self) -> None:
        content = self.path.read_bytes()
        complete = content[: content.rfind(b"\n") + 1]
        for line in complete.splitlines():
            self._remember(parse_json(line))
        if len(complete) < len(content):
            # A kill truncated the last line; its action did not happen.
            with self.path.open("r+b") as file:
                file.truncate(len(complete))


def path_of(study: Path, person_id: str) -> Path:
    """Path of this person's journal while the erasure is in progress."""
    plain = hashlib.sha256(person_id.encode()).hexdigest()[:12]
    return study / FOLDER / f"under-way-{plain}.jsonl"


def first_line_of(journal: Path) -> dict[str, Any]:
    """First line of a journal. Raises OSError."""
    with journal.open("rb") as file:
        line = file.readline()
    first = parse_json(line) if line.endswith(b"\n") else {}
    return first if isinstance(first, dict) else {}


def digest_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
