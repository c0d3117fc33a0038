"""People database of one study: opaque ids in SQLite, with all identifying data encrypted under a key per id.

Each id has a random data key for name, group, tags, note, portrait, embeddings and history (AES-256-GCM). A newcomer
gets an id; once identified it is linked to the person's id, so that the link can be undone and no data moves. A person
is an id with all linked ids; erasure deletes their keys and rows.
"""

import json
import logging
import secrets
import sqlite3
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import fields, replace
from heapq import merge
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import ConsentKind
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.person_values import LooksKind
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


MOST_HISTORY_FOUND = 500

HistoryKind = Literal["visit", "said", "heard", "photo", "note"]


class StoredPerson(Value):
    """One id. ``is_person_id`` is the person it was identified as, empty for a main id."""

    person_id: str
    about: About
    created_utc_ns: int
    last_seen_utc_ns: int
    is_person_id: str = ""

    @property
    def name(self) -> str:
        return self.about.name


class StoredEmbeddings(Value, eq=False):
    """Appearance embeddings by one network. ``vectors`` is float32, shape (n, length), each of unit length.

    ``day`` is the local day, as 2026-11-22; without one, as for faces, they do not expire.
    """

    person_id: str
    kind: LooksKind
    model: str
    day: str
    vectors: NDArray[np.float32]


class Consent(Value):
    """Last answer to a consent question, with time and who noted it."""

    kind: ConsentKind
    given: bool
    noted_utc_ns: int
    actor: Actor = ""


class HistoryEntry(Value):
    """History entry. ``text`` is speech, a note, or the file of a photo.

    ``session`` is the session folder's name, empty without a recording. ``until_utc_ns`` is the end of a visit.
    """

    kind: HistoryKind
    utc_ns: int
    session: str
    text: str = ""
    until_utc_ns: int | None = None


class Traces(Value):
    """Search terms for the erasure of a person: all ids, and bytes of portraits and vectors."""

    person_ids: tuple[str, ...]
    blobs: tuple[bytes, ...]


def new_person_id() -> str:
    """Random opaque id."""
    return f"p-{secrets.token_hex(6)}"


_TABLES = ("keys", "people", "looks", "portraits", "visits", "rejections", "consents", "history")


class PeopleStore:
    """Opens the database at ``path``, or creates it and its folder. Use from the thread that created it.

    Every method writes through and raises PeopleStoreError on failure, after which the store remains usable. A file
    that is not such a database is left untouched.
    """

    def __init__(self, path: Path, *, utc_now_ns: Callable[[], int] = time.time_ns) -> None:
        self._utc_now_ns = utc_now_ns
        self._file = PeopleDatabase(path)
        self._database = self._file.connection

    @property
    def path(self) -> Path:
        return self._file.path

    def close(self) -> None:
        self._database.close()

    # Ids

    def add(self) -> StoredPerson:
        """Add a new id."""
        person_id, now_ns = new_person_id(), self._utc_now_ns()
        with self._file.writing():
            self._database.execute("INSERT INTO keys VALUES (?, ?)", (person_id, new_key()))
            self._database.execute("INSERT INTO people VALUES (?, '', ?, ?, NULL)", (person_id, now_ns, now_ns))
        return StoredPerson(person_id, About(), now_ns, now_ns)

    def get(self, person_id: str) -> StoredPerson | None:
        with self._file.explained("read"):
            row = self._database.execute(f"{_SELECT} WHERE people.person_id = ?", (person_id,)).fetchone()
        return None if row is None else _person(row)

    def everybody(self) -> tuple[StoredPerson, ...]:
        """All ids of the study in order of their creation."""
        with self._file.explained("read"):
            rows = self._database.execute(f"{_SELECT} ORDER BY created_utc_ns").fetchall()
        return tuple(_person(row) for row in rows)

    def ids_of(self, person_id: str) -> tuple[str, ...]:
        """All ids of the person with this id, the main one first; only this one if unknown."""
        person = self.get(person_id)
        root = person_id if person is None or not person.is_person_id else person.is_person_id
        with self._file.explained("read"):
            linked = self._database.execute("SELECT person_id FROM people WHERE is_person_id = ?", (root,)).fetchall()
        return (root, *(row[0] for row in linked))

    def name_of(self, person_id: str) -> str:
        """Name of the person with this id; empty if there is none."""
        person = self.get(self.ids_of(person_id)[0])
        return "" if person is None else person.name

    def link(self, person_id: str, is_person_id: str) -> None:
        """Link this id and its linked ids to that person; empty: unlink.

        Raises KeyError for an unknown id.
        """
        with self._file.writing():
            if is_person_id:
                self._database.execute(
                    "UPDATE people SET is_person_id = ? WHERE is_person_id = ?", (is_person_id, person_id)
                )
            updated = self._database.execute(
                "UPDATE people SET is_person_id = ? WHERE person_id = ?", (is_person_id, person_id)
            ).rowcount
        if not updated:
            raise KeyError(person_id)

    def describe(self, person_id: str, about: About) -> None:
        """Set the notes on a person. Names need not be unique. Raises KeyError for an unknown id."""
        with self._file.writing():
            self._key_of(person_id)
            sealed = self._seal(person_id, "about", about_bytes(about)) if about != About() else None
            self._database.execute("UPDATE people SET about = ? WHERE person_id = ?", (sealed, person_id))

    # Data

    def store_embeddings(self, embeddings: StoredEmbeddings, *, expires_utc_ns: int | None) -> None:
        """Store embeddings, replacing those of the same day, kind and model. Raises KeyError for an unknown id."""
        with self._file.writing():
            width = np.array(embeddings.vectors.shape[1], "<u4").tobytes()
            sealed = self._seal(embeddings.person_id, "looks", width + embeddings.vectors.astype("<f4").tobytes())
            self._database.execute(
                "INSERT OR REPLACE INTO looks VALUES (?, ?, ?, ?, ?, ?)",
                (embeddings.person_id, embeddings.kind, embeddings.model, embeddings.day, expires_utc_ns, sealed),
            )

    def drop_embeddings(self, person_id: str, kind: LooksKind) -> None:
        with self._file.writing():
            self._database.execute("DELETE FROM looks WHERE person_id = ? AND kind = ?", (person_id, kind))

    def embeddings(self, *, person_id: str = "") -> tuple[StoredEmbeddings, ...]:
        """Embeddings that have not expired, of everybody or of one id."""
        with self._file.explained("read"):
            rows = self._database.execute(
                "SELECT looks.person_id, kind, model, day, vectors, key FROM looks JOIN keys USING (person_id) "
                "WHERE (expires_utc_ns IS NULL OR expires_utc_ns > ?) AND (? = '' OR person_id = ?)",
                (self._utc_now_ns(), person_id, person_id),
            ).fetchall()
        return tuple(
            StoredEmbeddings(owner, kind, model, day, np.frombuffer(content[4:], "<f4").reshape(-1, _width(content)))
            for owner, kind, model, day, sealed, key in rows
            if (content := unseal(key, owner, "looks", sealed))
        )

    def expire(self, *, day_began_utc_ns: int) -> None:
        """Delete expired embeddings, and portraits of people without notes and consent to photos who were not present
        today.
        """
        with self._file.writing():
            removed = self._database.execute(
                "DELETE FROM looks WHERE expires_utc_ns <= ?", (self._utc_now_ns(),)
            ).rowcount
            removed += self._database.execute(
                "DELETE FROM portraits WHERE person_id IN (SELECT person_id FROM people WHERE about IS NULL "
                "AND is_person_id = '' AND last_seen_utc_ns < ?) "
                "AND person_id NOT IN (SELECT person_id FROM consents WHERE kind = 'photo' AND given)",
                (day_began_utc_ns,),
            ).rowcount
        if removed:
            with self._file.explained("written"):
                self._database.execute("PRAGMA wal_checkpoint(TRUNCATE)")

    def store_portrait(self, person_id: str, jpeg: bytes, quality: float) -> None:
        """Store the portrait, replacing the old one. Raises KeyError for an unknown id."""
        with self._file.writing():
            sealed = self._seal(person_id, "portrait", jpeg)
            self._database.execute("INSERT OR REPLACE INTO portraits VALUES (?, ?, ?)", (person_id, quality, sealed))

    def portrait(self, person_id: str) -> bytes | None:
        """Best portrait over all ids of the person; None if there is none."""
        for owner, sealed, key in self._of_all_ids(
            person_id,
            "SELECT portraits.person_id, jpeg, key FROM portraits JOIN keys USING (person_id) "
            "WHERE person_id IN ({}) ORDER BY quality DESC",
        ):
            jpeg = unseal(key, owner, "portrait", sealed)
            if jpeg:
                return jpeg
        return None

    def note_visit(self, person_id: str, *, from_utc_ns: int, to_utc_ns: int, session: str = "") -> None:
        """Add a visit by its start, or extend it to ``to_utc_ns``."""
        with self._file.writing():
            self._key_of(person_id)
            self._database.execute(
                "INSERT INTO visits VALUES (?, ?, ?, ?) ON CONFLICT DO UPDATE SET to_utc_ns = excluded.to_utc_ns, "
                "session = CASE WHEN excluded.session = '' THEN session ELSE excluded.session END",
                (person_id, from_utc_ns, to_utc_ns, session),
            )
            self._database.execute(
                "UPDATE people SET last_seen_utc_ns = max(last_seen_utc_ns, ?) WHERE person_id = ?",
                (to_utc_ns, person_id),
            )

    def reject(self, person_id: str, is_not_person_id: str, actor: Actor = "") -> None:
        """Note that these are different people."""
        with self._file.writing():
            self._database.execute(
                "INSERT OR REPLACE INTO rejections VALUES (?, ?, ?, ?)",
                (person_id, is_not_person_id, self._utc_now_ns(), actor),
            )

    def take_back_rejection(self, person_id: str, is_not_person_id: str) -> None:
        with self._file.writing():
            self._database.execute(
                "DELETE FROM rejections WHERE person_id = ? AND is_not_person_id = ?", (person_id, is_not_person_id)
            )

    def rejections(self) -> tuple[tuple[str, str], ...]:
        """Pairs of ids that a wizard marked as different people."""
        with self._file.explained("read"):
            return tuple(self._database.execute("SELECT person_id, is_not_person_id FROM rejections").fetchall())

    def note_consent(self, person_id: str, kind: ConsentKind, *, given: bool, actor: Actor = "") -> None:
        """Add an answer to a consent question. Raises KeyError for an unknown id."""
        with self._file.writing():
            self._key_of(person_id)
            self._database.execute(
                "INSERT INTO consents (person_id, kind, given, utc_ns, actor) VALUES (?, ?, ?, ?, ?)",
                (person_id, kind, int(given), self._utc_now_ns(), actor),
            )

    def consents(self) -> dict[str, dict[ConsentKind, Consent]]:
        """Valid answers by main id: the newest of each kind."""
        with self._file.explained("read"):
            rows = self._database.execute(
                "SELECT CASE WHEN is_person_id = '' THEN person_id ELSE is_person_id END, kind, given, utc_ns, actor "
                "FROM consents JOIN people USING (person_id) ORDER BY consent_id"
            ).fetchall()
        held: dict[str, dict[ConsentKind, Consent]] = {}
        for person_id, kind, given, utc_ns, actor in rows:
            held.setdefault(person_id, {})[kind] = Consent(kind, bool(given), utc_ns, actor)
        return held

    def add_history(self, person_id: str, kind: HistoryKind, text: str, *, utc_ns: int, session: str = "") -> None:
        """Add a history entry. Raises KeyError for an unknown id."""
        with self._file.writing():
            sealed = self._seal(person_id, "history", text.encode())
            self._database.execute(
                "INSERT INTO history (person_id, kind, utc_ns, session, text) VALUES (?, ?, ?, ?, ?)",
                (person_id, kind, utc_ns, session, sealed),
            )

    def take_back_history(self, person_id: str, kind: HistoryKind, text: str) -> None:
        """Remove the newest entry with this text."""
        with self._file.writing():
            rows = self._database.execute(
                "SELECT entry_id, text FROM history WHERE person_id = ? AND kind = ? ORDER BY entry_id DESC",
                (person_id, kind),
            ).fetchall()
            key = self._key_of(person_id)
            for entry_id, sealed in rows:
                if unseal(key, person_id, "history", sealed).decode() == text:
                    self._database.execute("DELETE FROM history WHERE entry_id = ?", (entry_id,))
                    break

    def visits(self, person_id: str) -> tuple[HistoryEntry, ...]:
        """Visits of a person, newest first."""
        rows = self._of_all_ids(
            person_id,
            "SELECT from_utc_ns, to_utc_ns, session FROM visits WHERE person_id IN ({}) ORDER BY from_utc_ns DESC",
        )
        return tuple(
            HistoryEntry("visit", began_ns, session, until_utc_ns=end_ns) for began_ns, end_ns, session in rows
        )

    def history(self, person_id: str, text: str = "", *, at_most: int = MOST_HISTORY_FOUND) -> tuple[HistoryEntry, ...]:
        """History of a person (visits, speech, photos, notes), newest first, filtered by all words of ``text``."""
        query_words = text.casefold().split()
        entries = merge(self.visits(person_id), self._decrypted_history(person_id), key=lambda entry: -entry.utc_ns)
        found = (entry for entry in entries if all(word in entry.text.casefold() for word in query_words))
        return tuple(islice(found, at_most))

    def _decrypted_history(self, person_id: str) -> Iterator[HistoryEntry]:
        """History without visits, newest first, decrypted lazily."""
        for owner, kind, utc_ns, session, sealed, key in self._of_all_ids(
            person_id,
            "SELECT history.person_id, kind, utc_ns, session, text, key FROM history JOIN keys USING (person_id) "
            "WHERE person_id IN ({}) ORDER BY utc_ns DESC",
        ):
            yield HistoryEntry(kind, utc_ns, session, unseal(key, owner, "history", sealed).decode())

    # Erasure

    def traces_of(self, person_id: str) -> Traces:
        """Search terms for this person's erasure; read them before it."""
        ids = self.ids_of(person_id)
        vectors = [
            row.tobytes()
            for each in ids
            for embeddings in self.embeddings(person_id=each)
            for row in embeddings.vectors
        ]
        jpegs = self._of_all_ids(
            person_id,
            "SELECT portraits.person_id, jpeg, key FROM portraits JOIN keys USING (person_id) WHERE person_id IN ({})",
        )
        portraits = [unseal(key, owner, "portrait", sealed) for owner, sealed, key in jpegs]
        return Traces(ids, tuple(dict.fromkeys(filter(None, [*portraits, *vectors]))))

    def forget(self, person_id: str) -> tuple[str, ...]:
        """Delete keys and rows of a person, also from log and free pages; return all of their ids.

        Idempotent: after an interruption it deletes the rest.
        """
        ids = self.ids_of(person_id)
        marks = ", ".join("?" * len(ids))
        with self._file.writing():
            for table in _TABLES:
                self._database.execute(f"DELETE FROM {table} WHERE person_id IN ({marks})", ids)  # noqa: S608 - ours
            self._database.execute(f"DELETE FROM rejections WHERE is_not_person_id IN ({marks})", ids)  # noqa: S608
        self._file.empty_log_and_free_pages()
        return ids

    def rewrite_texts(self, rewrite: Callable[[str, str], str]) -> None:
        """Apply ``rewrite`` to each note and history entry, given the owner's id and the text."""
        for person in self.everybody():
            note = rewrite(person.person_id, person.about.note) if person.about.note else ""
            if note != person.about.note:
                self.describe(person.person_id, replace(person.about, note=note))
        with self._file.explained("read"):
            rows = self._database.execute(
                "SELECT entry_id, history.person_id, text, key FROM history JOIN keys USING (person_id)"
            ).fetchall()
        for entry_id, owner, sealed, key in rows:
            text = unseal(key, owner, "history", sealed).decode()
            rewritten = rewrite(owner, text)
            if rewritten != text:
                with self._file.writing():
                    self._database.execute(
                        "UPDATE history SET text = ? WHERE entry_id = ?",
                        (self._seal(owner, "history", rewritten.encode()), entry_id),
                    )

    # Encryption

    def _of_all_ids(self, person_id: str, query: str) -> list[tuple[Any, ...]]:
        ids = self.ids_of(person_id)
        with self._file.explained("read"):
            return self._database.execute(query.format(", ".join("?" * len(ids))), ids).fetchall()

    def _key_of(self, person_id: str) -> bytes:
        row = self._database.execute("SELECT key FROM keys WHERE person_id = ?", (person_id,)).fetchone()
        if row is None:
            raise KeyError(person_id)
        return bytes(row[0])

    def _seal(self, person_id: str, content_kind: str, content: bytes) -> bytes:
        return seal(self._key_of(person_id), person_id, content_kind, content)


_SELECT = (
    "SELECT people.person_id, is_person_id, created_utc_ns, last_seen_utc_ns, about, key "
    "FROM people JOIN keys USING (person_id)"
)


def _person(row: tuple[str, str, int, int, bytes | None, bytes]) -> StoredPerson:
    person_id, is_person_id, created_utc_ns, last_seen_utc_ns, sealed, key = row
    content = b"" if sealed is None else unseal(key, person_id, "about", sealed)
    about = about_of(content) if content else About()
    return StoredPerson(person_id, about, created_utc_ns, last_seen_utc_ns, is_person_id)


def _width(content: bytes) -> int:
    return int(np.frombuffer(content[:4], "<u4")[0])
