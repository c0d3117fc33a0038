"""The people of one study: opaque ids and names in a SQLite database."""

import logging
import secrets
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

log = logging.getLogger(__name__)

# Recognised by `file` and by us: a database of another program is never written to. Reads "CaPe".
_APPLICATION_ID = 0x43615065
_BUSY_TIMEOUT_S = 2.0

# Each step raises a database by one version; one that was once released is never changed.
STEPS: tuple[tuple[str, ...], ...] = (
    (
        """CREATE TABLE people (
            person_id TEXT PRIMARY KEY NOT NULL,
            name TEXT NOT NULL DEFAULT '',
            created_utc_ns INTEGER NOT NULL,
            last_seen_utc_ns INTEGER NOT NULL
        ) STRICT, WITHOUT ROWID""",
        f"PRAGMA application_id = {_APPLICATION_ID}",
    ),
)


class PeopleStoreError(Exception):
    """The study's people cannot be read or written; the text is a sentence for the wizard."""


@dataclass(frozen=True, slots=True)
class RegisteredPerson:
    """One row. ``name`` is empty until the wizard gives one."""

    person_id: str
    name: str
    created_utc_ns: int
    last_seen_utc_ns: int


def new_person_id() -> str:
    """An opaque id that tells nothing about the person."""
    return f"p-{secrets.token_hex(6)}"


class PeopleRegister:
    """Opens the database at ``path``, or creates it and its folder. Use from the thread that created it.

    Every method writes through before it returns and raises PeopleStoreError, after which the register remains
    usable. A file that is not such a database is left untouched.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with self._explained("opened"):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._database = sqlite3.connect(path, timeout=_BUSY_TIMEOUT_S, isolation_level=None)
        try:
            with self._explained("opened"):
                self._prepare()
        except PeopleStoreError:
            self._database.close()
            raise

    def add(self) -> RegisteredPerson:
        """A new person without a name."""
        person_id, now_ns = new_person_id(), time.time_ns()
        with self._explained("written"):
            self._database.execute(
                "INSERT INTO people (person_id, created_utc_ns, last_seen_utc_ns) VALUES (?, ?, ?)",
                (person_id, now_ns, now_ns),
            )
        return RegisteredPerson(person_id, "", now_ns, now_ns)

    def get(self, person_id: str) -> RegisteredPerson | None:
        with self._explained("read"):
            row = self._database.execute(f"{_SELECT} WHERE person_id = ?", (person_id,)).fetchone()
        return None if row is None else RegisteredPerson(*row)

    def everybody(self) -> tuple[RegisteredPerson, ...]:
        """All people of the study in the order in which they were first seen."""
        with self._explained("read"):
            rows = self._database.execute(f"{_SELECT} ORDER BY created_utc_ns").fetchall()
        return tuple(RegisteredPerson(*row) for row in rows)

    def rename(self, person_id: str, name: str) -> None:
        """Names need not be unique; an empty one takes the name away. Raises KeyError for an unknown person."""
        self._update(person_id, "name", name)

    def seen(self, person_id: str) -> None:
        """Note that the person was seen just now. Raises KeyError for an unknown person."""
        self._update(person_id, "last_seen_utc_ns", time.time_ns())

    def erase(self, person_id: str) -> None:
        """Remove everything about a person, also from the file's free pages. Raises KeyError for an unknown one."""
        with self._explained("written"):
            erased = self._database.execute("DELETE FROM people WHERE person_id = ?", (person_id,)).rowcount
            # The write-ahead log still holds the old page until it is emptied.
            self._database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        if not erased:
            raise KeyError(person_id)

    def close(self) -> None:
        self._database.close()

    def _update(self, person_id: str, column: str, value: str | int) -> None:
        with self._explained("written"):
            statement = f"UPDATE people SET {column} = ? WHERE person_id = ?"  # noqa: S608 - one of two literals above
            updated = self._database.execute(statement, (value, person_id)).rowcount
        if not updated:
            raise KeyError(person_id)

    def _prepare(self) -> None:
        database = self._database
        application_id = database.execute("PRAGMA application_id").fetchone()[0]
        version = database.execute("PRAGMA user_version").fetchone()[0]
        tables = database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
        if tables and application_id != _APPLICATION_ID:
            raise PeopleStoreError(f"{self.path} is a database of another program and was left untouched.")
        if version > len(STEPS):
            raise PeopleStoreError(
                f"{self.path} was written by a newer version of this program and was left untouched. "
                "Update the program."
            )
        if tables and database.execute("PRAGMA quick_check(1)").fetchone()[0] != "ok":
            raise PeopleStoreError(_damaged(self.path))
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = NORMAL")
        database.execute("PRAGMA secure_delete = ON")
        if version < len(STEPS):
            self._migrate()

    def _migrate(self) -> None:
        """All steps or none. No copy of the old database is kept: whoever is erased later would stay in it."""
        database = self._database
        database.execute("BEGIN IMMEDIATE")
        try:
            # Another console may have been here since the version was looked at.
            version = database.execute("PRAGMA user_version").fetchone()[0]
            for number, step in enumerate(STEPS[version:], start=version + 1):
                for statement in step:
                    database.execute(statement)
                database.execute(f"PRAGMA user_version = {number}")
            database.execute("COMMIT")
        except BaseException:
            if database.in_transaction:
                database.execute("ROLLBACK")
            raise

    @contextmanager
    def _explained(self, verb: str) -> Iterator[None]:
        try:
            yield
        except sqlite3.DatabaseError as error:
            log.exception("people database %s could not be %s", self.path, verb)
            raise PeopleStoreError(_explanation(self.path, verb, error)) from error
        except OSError as error:
            log.exception("people database %s could not be %s", self.path, verb)
            raise PeopleStoreError(
                f"The study's people in {self.path} cannot be {verb}: {error.strerror or error}."
            ) from error


_SELECT = "SELECT person_id, name, created_utc_ns, last_seen_utc_ns FROM people"


def _damaged(path: Path) -> str:
    return (
        f"{path} is not a people database or is damaged; it was left untouched. "
        "Move it away to start an empty one, or put a backup in its place."
    )


def _explanation(path: Path, verb: str, error: sqlite3.DatabaseError) -> str:
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    if code in (sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT):
        return _damaged(path)
    if code == sqlite3.SQLITE_FULL:
        return f"The disk is full: the study's people in {path} cannot be {verb}. Make room on the disk."
    if code == sqlite3.SQLITE_BUSY:
        return f"Another program is using {path}. Close it; the study's people cannot be {verb} meanwhile."
    if code in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM, sqlite3.SQLITE_IOERR):
        return f"The study's people in {path} cannot be {verb}. Choose a study folder that you may write to."
    return f"The study's people in {path} cannot be {verb}: {error}."
