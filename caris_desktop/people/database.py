"""SQLite file of the study's people: opening, validation and schema migration; foreign files are left untouched."""

import json
import logging
import secrets
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.domain.translation import QT_TR_NOOP, LocalizedText, joined, localized
from caris_desktop.domain.value_class import Value

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.ciphers.aead import AESGCM

# Envelope encryption: each person's data under a key of their own (AES-256-GCM), erased by deleting the key.

_NONCE_BYTES = 12
_KEY_BITS = 256


class About(Value):
    """The wizard's notes on a person. Someone without any counts as seen only, not as known."""

    name: str = ""
    group: str = ""
    tags: tuple[str, ...] = ()
    note: str = ""


def new_key() -> bytes:
    return _cipher().generate_key(_KEY_BITS)


def seal(key: bytes, person_id: str, content_kind: str, content: bytes) -> bytes:
    """Encrypt, bound to the person and field, so that content cannot be moved to another person."""
    nonce = secrets.token_bytes(_NONCE_BYTES)
    return nonce + _cipher()(key).encrypt(nonce, content, f"{person_id}/{content_kind}".encode())


def unseal(key: bytes, person_id: str, content_kind: str, content: bytes) -> bytes:
    """Decrypt; empty if damaged, so that one person's data does not block the others."""
    from cryptography.exceptions import InvalidTag

    try:
        return _cipher()(key).decrypt(
            content[:_NONCE_BYTES], content[_NONCE_BYTES:], f"{person_id}/{content_kind}".encode()
        )
    except (InvalidTag, ValueError):
        _log.warning("%s of %s cannot be read", content_kind, person_id)
        return b""


def _cipher() -> "type[AESGCM]":
    """Late import, since the first window must not wait for it."""
    from cryptography.hazmat.primitives.ciphers.aead import AESGCM

    return AESGCM


def about_bytes(about: About) -> bytes:
    return json.dumps({each.name: getattr(about, each.name) for each in fields(About)}, ensure_ascii=False).encode()


def about_of(written: bytes) -> About:
    content = parse_json(written)
    tags = content.get("tags")
    return About(
        str(content.get("name", "")),
        str(content.get("group", "")),
        tuple(map(str, tags)) if isinstance(tags, Iterable) else (),
        str(content.get("note", "")),
    )


_log = logging.getLogger(__name__)

# "CaPe", recognised by `file`: a database of another program is never written to.
_APPLICATION_ID = 0x43615065
_BUSY_TIMEOUT_S = 2.0

Verb = Literal["opened", "read", "written"]
_CANNOT: dict[Verb, str] = {
    "opened": QT_TR_NOOP("The people database {path} cannot be opened."),
    "read": QT_TR_NOOP("The people database {path} cannot be read."),
    "written": QT_TR_NOOP("The people database {path} cannot be written."),
}


class PeopleStoreError(Exception):
    """The study's people cannot be read or written; the text is a user text for tr."""


def _wrap_names(database: sqlite3.Connection) -> None:
    for person_id, name, created_utc_ns, last_seen_utc_ns in database.execute("SELECT * FROM people_in_clear"):
        key = new_key()
        wrapped = seal(key, person_id, "about", about_bytes(About(name=name)))
        database.execute("INSERT INTO keys VALUES (?, ?)", (person_id, key))
        database.execute(
            "INSERT INTO people VALUES (?, '', ?, ?, ?)", (person_id, created_utc_ns, last_seen_utc_ns, wrapped)
        )


Step = tuple[str | Callable[[sqlite3.Connection], None], ...]
# Each step migrates by one version; released steps are never changed.
STEPS: tuple[Step, ...] = (
    (
        """CREATE TABLE people (
            person_id TEXT PRIMARY KEY NOT NULL,
            name TEXT NOT NULL DEFAULT '',
            created_utc_ns INTEGER NOT NULL,
            last_seen_utc_ns INTEGER NOT NULL
        ) STRICT, WITHOUT ROWID""",
        f"PRAGMA application_id = {_APPLICATION_ID}",
    ),
    (
        "ALTER TABLE people RENAME TO people_in_clear",
        "CREATE TABLE keys (person_id TEXT PRIMARY KEY NOT NULL, key BLOB NOT NULL) STRICT, WITHOUT ROWID",
        """CREATE TABLE people (
            person_id TEXT PRIMARY KEY NOT NULL,
            is_person_id TEXT NOT NULL DEFAULT '',
            created_utc_ns INTEGER NOT NULL,
            last_seen_utc_ns INTEGER NOT NULL,
            about BLOB
        ) STRICT, WITHOUT ROWID""",
        "CREATE INDEX people_linked ON people (is_person_id) WHERE is_person_id <> ''",
        """CREATE TABLE looks (
            person_id TEXT NOT NULL,
            kind TEXT NOT NULL,
            model TEXT NOT NULL,
            day TEXT NOT NULL,
            expires_utc_ns INTEGER,
            vectors BLOB NOT NULL,
            PRIMARY KEY (person_id, kind, model, day)
        ) STRICT, WITHOUT ROWID""",
        """CREATE TABLE portraits (
            person_id TEXT PRIMARY KEY NOT NULL,
            quality REAL NOT NULL,
            jpeg BLOB NOT NULL
        ) STRICT, WITHOUT ROWID""",
        """CREATE TABLE visits (
            person_id TEXT NOT NULL,
            from_utc_ns INTEGER NOT NULL,
            to_utc_ns INTEGER NOT NULL,
            session TEXT NOT NULL,
            PRIMARY KEY (person_id, from_utc_ns)
        ) STRICT, WITHOUT ROWID""",
        """CREATE TABLE rejections (
            person_id TEXT NOT NULL,
            is_not_person_id TEXT NOT NULL,
            utc_ns INTEGER NOT NULL,
            actor TEXT NOT NULL,
            PRIMARY KEY (person_id, is_not_person_id)
        ) STRICT, WITHOUT ROWID""",
        """CREATE TABLE consents (
            consent_id INTEGER PRIMARY KEY,
            person_id TEXT NOT NULL,
            kind TEXT NOT NULL,
            given INTEGER NOT NULL,
            utc_ns INTEGER NOT NULL,
            actor TEXT NOT NULL
        ) STRICT""",
        "CREATE INDEX consents_of ON consents (person_id)",
        """CREATE TABLE history (
            entry_id INTEGER PRIMARY KEY,
            person_id TEXT NOT NULL,
            kind TEXT NOT NULL,
            utc_ns INTEGER NOT NULL,
            session TEXT NOT NULL,
            text BLOB NOT NULL
        ) STRICT""",
        "CREATE INDEX history_of ON history (person_id, utc_ns)",
        _wrap_names,
        "DROP TABLE people_in_clear",
    ),
)


class PeopleDatabase:
    """Opens the database at ``path``, or creates it and its folder. Use from the thread that created it.

    Every method raises PeopleStoreError on failure and remains usable afterwards.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with self.explained("opened"):
            path.parent.mkdir(parents=True, exist_ok=True)
            if not path.exists():
                path.touch()  # SQLite's own file would not be writable by the group of a shared study
            self.connection = sqlite3.connect(path, timeout=_BUSY_TIMEOUT_S, isolation_level=None)
        try:
            with self.explained("opened"):
                self._prepare()
        except PeopleStoreError:
            self.connection.close()
            raise

    def empty_log_and_free_pages(self) -> None:
        with self.explained("written"):
            self.connection.execute("VACUUM")
            busy = self.connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0]
        if busy:
            raise PeopleStoreError(
                localized(
                    QT_TR_NOOP(
                        "Another program is using {path}, so its log still contains deleted data. Close that "
                        "program and try again."
                    ),
                    path=self.path,
                )
            )

    def _prepare(self) -> None:
        database = self.connection
        application_id = database.execute("PRAGMA application_id").fetchone()[0]
        version = database.execute("PRAGMA user_version").fetchone()[0]
        tables = database.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]
        if tables and application_id != _APPLICATION_ID:
            raise PeopleStoreError(
                localized(QT_TR_NOOP("{path} is a database of another program and was left unchanged."), path=self.path)
            )
        if version > len(STEPS):
            raise PeopleStoreError(
                localized(
                    QT_TR_NOOP(
                        "{path} was written by a newer version of this program and was left unchanged. "
                        "Update the program."
                    ),
                    path=self.path,
                )
            )
        if tables and database.execute("PRAGMA quick_check(1)").fetchone()[0] != "ok":
            raise PeopleStoreError(_damaged(self.path))
        database.execute("PRAGMA journal_mode = WAL")
        database.execute("PRAGMA synchronous = NORMAL")
        database.execute("PRAGMA secure_delete = ON")
        # A temporary file in a shared folder would contain what VACUUM moves.
        database.execute("PRAGMA temp_store = MEMORY")
        if version < len(STEPS):
            self._migrate()
            if version:
                # Earlier versions stored names in plain text.
                self.empty_log_and_free_pages()

    def _migrate(self) -> None:
        """Migrate atomically. No copy of the old database remains, since it would retain people erased later."""
        database = self.connection
        with self._transaction():
            # Another console may have migrated since the version was read.
            version = database.execute("PRAGMA user_version").fetchone()[0]
            for number, step in enumerate(STEPS[version:], start=version + 1):
                for statement in step:
                    if isinstance(statement, str):
                        database.execute(statement)
                    else:
                        statement(database)
                database.execute(f"PRAGMA user_version = {number}")

    @contextmanager
    def writing(self) -> Iterator[None]:
        with self.explained("written"), self._transaction():
            yield

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self.connection.execute("BEGIN IMMEDIATE")
        try:
            yield
            self.connection.execute("COMMIT")
        except BaseException:
            if self.connection.in_transaction:
                self.connection.execute("ROLLBACK")
            raise

    @contextmanager
    def explained(self, verb: Verb) -> Iterator[None]:
        try:
            yield
        except sqlite3.DatabaseError as error:
            _log.exception("people database %s could not be %s", self.path, verb)
            raise PeopleStoreError(_explanation(self.path, verb, error)) from error
        except OSError as error:
            _log.exception("people database %s could not be %s", self.path, verb)
            raise PeopleStoreError(_for_this_reason(self.path, verb, error.strerror or error)) from error


def _damaged(path: Path) -> LocalizedText:
    return localized(
        QT_TR_NOOP(
            "{path} is not a people database or is damaged; it was left unchanged. Move it elsewhere to "
            "start with an empty one, or replace it with a backup."
        ),
        path=path,
    )


def _explanation(path: Path, verb: Verb, error: sqlite3.DatabaseError) -> LocalizedText:
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    if code in (sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_CORRUPT):
        return _damaged(path)
    if code == sqlite3.SQLITE_FULL:
        return joined((_cannot(path, verb), QT_TR_NOOP("The disk is full: free some disk space.")))
    if code == sqlite3.SQLITE_BUSY:
        return joined((_cannot(path, verb), QT_TR_NOOP("Another program is using the database: close that program.")))
    if code in (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PERM, sqlite3.SQLITE_IOERR):
        return joined((_cannot(path, verb), QT_TR_NOOP("Choose a study folder that is writable.")))
    return _for_this_reason(path, verb, error)


def _cannot(path: Path, verb: Verb) -> LocalizedText:
    return localized(_CANNOT[verb], path=path)


def _for_this_reason(path: Path, verb: Verb, reason: object) -> LocalizedText:
    return joined((_cannot(path, verb), localized(QT_TR_NOOP("The system reports: {why}."), why=reason)))
