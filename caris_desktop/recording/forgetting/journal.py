"""What a forgetting under way has done, so that a kill at any moment can be gone on from. Nothing in it is personal."""

import hashlib
import json
import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from caris_desktop.domain.file_replacement import SHOWN_CHARACTERS, bring_to_disk
from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.domain.value_class import dataclass

_log = logging.getLogger(__name__)
FOLDER = "forgotten"
PART = ".forgetting.part"


@dataclass(frozen=True, slots=True)
class Change:
    """What became of one file. ``after`` is the SHA-256 of what it holds now, empty where it was removed.

    There is none of what it held: a name could be guessed from that, one name after the other.
    """

    file: str
    what: str
    after: str
    count: int = 0


class Journal:
    """Lines of JSON in ``STUDY/forgotten``, each on the disk before what it tells of happens. Methods raise OSError."""

    def __init__(self, study: Path, person_id: str, *, without_names: Callable[[str], str]) -> None:
        """``without_names`` is what the names of files pass through, which may be anything."""
        self._study = study
        self._without_names = without_names
        self.path = path_of(study, person_id)
        self.resumed = self.path.exists()
        self._lines: list[dict[str, Any]] = []
        self._changes: dict[tuple[str, str], Change] = {}
        self._left: set[str] = set()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.resumed:
            self._take_over()
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
        """The last that was noted of it; None where nothing was."""
        return next((line[key] for line in reversed(self._lines) if key in line), None)

    def changes(self) -> list[Change]:
        """The last of each file and kind that really happened."""
        return list(self._changes.values())

    def was_done(self, path: Path, what: str) -> bool:
        """Whether this was done to the file, which is as that left it."""
        told = self._changes.get((self.name_of(path), what))
        if told is None:
            return False
        try:
            # Or as a later step left it.
            return digest_of(path) in self._left
        except FileNotFoundError:
            return told.after == ""

    def replace(self, path: Path, what: str, make: Callable[[Path], int]) -> None:
        """Put what ``make`` writes, to the path that it is given, in the place of a file; it tells how much it changed.

        The old file stays where that fails.
        """
        # Not replace_file: a film is written by another program, to a path; and what follows has to be in the journal
        # between the moment at which the new file is whole and the one at which it takes the place of the old.
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
        """The file's path in the study; of the user's other files that below their home folder."""
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
            entry = {key: value for key, value in entry.items() if key != "before"}  # of versions that had it
            change = Change(**entry)
            self._changes[change.file, change.what] = change
            self._left.add(change.after)

    def _take_over(self) -> None:
        content = self.path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        for line in whole.splitlines():
            self._remember(parse_json(line))
        if len(whole) < len(content):
            # A kill cut the last line off; what it tells of has not happened.
            with self.path.open("r+b") as file:
                file.truncate(len(whole))


def path_of(study: Path, person_id: str) -> Path:
    """Where the journal of forgetting this person lies, as long as it is under way."""
    plain = hashlib.sha256(person_id.encode()).hexdigest()[:12]
    return study / FOLDER / f"under-way-{plain}.jsonl"


def first_line_of(journal: Path) -> dict[str, Any]:
    """Raises OSError."""
    with journal.open("rb") as file:
        line = file.readline()
    told = parse_json(line) if line.endswith(b"\n") else {}
    return told if isinstance(told, dict) else {}


def digest_of(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
