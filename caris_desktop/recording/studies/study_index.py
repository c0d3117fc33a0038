"""Search index of a study's sessions: header fields and full text; it can be rebuilt from the folders."""

import contextlib
import fnmatch
import hashlib
import logging
import os
import re
import sqlite3
import unicodedata
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from caris_desktop.domain.events import (
    LlmExchange,
    Marked,
    Problem,
    RecordingPaused,
    UtteranceChanged,
    UtteranceCorrected,
)
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.annotation.annotation_store import load_documents
from caris_desktop.recording.session.folder_lock import is_held
from caris_desktop.recording.session.loss_messages import read_loss
from caris_desktop.recording.session.manifest import MANIFEST_NAME
from caris_desktop.recording.session.session_data import read_data
from caris_desktop.recording.session.session_header import SessionError
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.studies.study_query import SearchHit, SessionEntry, SessionQuery

_log = logging.getLogger(__name__)
T = TypeVar("T")

DATABASE_NAME = "session-index.sqlite"
_APPLICATION_ID = 0x43415249
_SCHEMA_VERSION = 4
_QUOTED_FROM = 12
"""Characters: a shorter sentence within a line may be somebody else's words."""
_BUSY_MS = 2000
_SNIPPET_CHARACTERS = 160
_MAX_WORDS = 40
_NEVER_NS = 2**63
_SCHEMA = """
CREATE TABLE session (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE,
    signature TEXT NOT NULL,
    trouble TEXT NOT NULL,
    started_utc TEXT NOT NULL,
    duration_s REAL NOT NULL,
    participant TEXT NOT NULL,
    condition TEXT NOT NULL,
    trial TEXT NOT NULL,
    recording TEXT NOT NULL,
    wizard TEXT NOT NULL,
    scenario TEXT NOT NULL,
    purpose TEXT NOT NULL,
    closed_properly INTEGER NOT NULL,
    size_bytes INTEGER NOT NULL,
    utterances INTEGER NOT NULL,
    marks INTEGER NOT NULL,
    problems INTEGER NOT NULL,
    losses TEXT NOT NULL,
    identity TEXT NOT NULL
);
CREATE TABLE item (
    id INTEGER PRIMARY KEY,
    session_id INTEGER NOT NULL REFERENCES session (id),
    at_ns INTEGER NOT NULL,
    session_s REAL NOT NULL,
    kind TEXT NOT NULL,
    text TEXT NOT NULL,
    quoted INTEGER NOT NULL
);
CREATE INDEX item_of_session ON item (session_id);
CREATE VIRTUAL TABLE item_text USING fts5 (
    text, content = 'item', content_rowid = 'id', tokenize = 'unicode61 remove_diacritics 2', prefix = '2 3'
);
"""


class UnreadableSession(Value):
    """Folder that looks like a session and cannot be read; ``trouble`` is the reason."""

    folder: Path
    trouble: str


# Any of them marks a session, even without the others.
_SESSION_FILES = ("session.json", "events.mcap", MANIFEST_NAME)
_FIELDS = ("participant", "condition", "wizard", "scenario", "purpose")
_ENTRY_COLUMNS = (
    "name", "started_utc", "duration_s", "participant", "condition", "trial", "recording", "wizard", "scenario",
    "purpose", "closed_properly", "size_bytes", "utterances", "marks", "problems", "losses",
)  # fmt: skip


def sessions_dir_of(study: Path) -> Path:
    """Folder of the study's sessions; ``study`` may be that folder."""
    return study / "sessions" if (study / "sessions").is_dir() else study


def study_dir_of(path: Path) -> Path:
    """Study folder of ``path``, which may be its sessions folder."""
    return path.absolute().parent if path.absolute().name == "sessions" and sessions_dir_of(path) == path else path


def session_folders(sessions_dir: Path) -> list[Path]:
    """Folders in ``sessions_dir`` with a session or remains of one, by name. Raises OSError."""
    with os.scandir(sessions_dir) as entries:
        names = sorted(
            entry.name
            for entry in entries
            if not entry.name.startswith(".")
            and entry.is_dir(follow_symlinks=False)
            and any(os.path.isfile(f"{entry.path}/{name}") for name in _SESSION_FILES)  # noqa: PTH113 - asked of every session at each opening
        )
    return [sessions_dir / name for name in names]


def _no_progress(_fraction: float) -> None:
    """Ignore progress."""


class StudyIndex:
    """Index of the sessions in one folder. Any thread, one at a time. Never changes a session.

    ``message`` is a user text if the index is in memory only or was rebuilt; else empty.
    """

    def __init__(self, sessions_dir: Path, database: Path) -> None:
        """Open or create the index; :meth:`update` fills it."""
        self.message = ""
        self._sessions_dir = sessions_dir
        self._path = database
        self._database = self._open()

    @classmethod
    def of_study(cls, study: Path) -> "StudyIndex":
        """Index that a study folder stores next to its sessions."""
        return cls(sessions_dir_of(study), study_dir_of(study) / DATABASE_NAME)

    def close(self) -> None:
        self._database.close()

    def update(self, progress: Callable[[float], None] = _no_progress) -> None:
        """Read new and changed sessions, drop removed ones. ``progress`` may raise to cancel.

        The index then retains what was read.

        Raises OSError if the folder of the sessions cannot be read.
        """
        self._whole(lambda: self._update(progress))

    def rebuild(self, progress: Callable[[float], None] = _no_progress) -> None:
        """Clear the index and read all sessions again. Raises OSError as :meth:`update`."""

        def rebuild_all() -> None:
            with self._database:
                self._forget(None)
            self._update(progress)

        self._whole(rebuild_all)

    def sessions(self, query: SessionQuery | None = None) -> tuple[SessionEntry, ...]:
        """Matching sessions, newest first."""
        query = query or SessionQuery()
        words = _words(query.text)
        if query.text.strip() and not words:
            return ()
        condition, arguments = _header_condition(query)
        if words:
            matching, its_arguments = _text_condition(words)
            condition += f" AND s.id IN (SELECT i.session_id FROM item i WHERE {matching})"  # noqa: S608 - likewise
            arguments += its_arguments
        sql = (
            f"SELECT {', '.join(f's.{column}' for column in _ENTRY_COLUMNS)} FROM session s"  # noqa: S608 - no values in it
            f" WHERE s.trouble = '' AND {condition} ORDER BY s.started_utc DESC, s.name DESC"
        )
        rows = self._whole(lambda: self._database.execute(sql, arguments).fetchall())
        copies = self._whole(self._copies)
        return tuple(self._entry(row, copies) for row in rows)

    def _copies(self) -> dict[str, str]:
        """Original of each session that is a copy."""
        sql = "SELECT name, identity, losses FROM session WHERE trouble = '' AND identity != ''"
        rows = self._database.execute(sql)
        return copies_among({name: (identity, losses.splitlines()) for name, identity, losses in rows})

    def search(self, query: SessionQuery, *, after: int = 0) -> tuple[SearchHit, ...]:
        """Text hits: newest session first, each in order of time; at most ``query.places``, starting at ``after``."""
        words = _words(query.text)
        rows = self._found(
            query,
            "s.name, i.at_ns, i.session_s, i.kind, i.text, i.quoted",
            "ORDER BY s.started_utc DESC, s.name DESC, i.at_ns, i.id LIMIT ? OFFSET ?",
            query.places,
            after,
        )
        return tuple(
            SearchHit(self._sessions_dir / name, at_ns, session_s, kind, _snippet(text, words), quoted)
            for name, at_ns, session_s, kind, text, quoted in rows
        )

    def places(self, query: SessionQuery) -> dict[Path, int]:
        """Number of all hits per session, newest session first."""
        rows = self._found(query, "s.name, count(*)", "GROUP BY s.id ORDER BY s.started_utc DESC, s.name DESC")
        return {self._sessions_dir / name: count for name, count in rows}

    def _found(self, query: SessionQuery, columns: str, how: str, *more: int) -> list[tuple[Any, ...]]:
        words = _words(query.text)
        if not words:
            return []
        condition, arguments = _header_condition(query)
        matching, its_arguments = _text_condition(words)
        sql = (
            f"SELECT {columns} FROM item i JOIN session s ON s.id = i.session_id"  # noqa: S608 - no values in it
            f" WHERE {matching} AND s.trouble = '' AND {condition} {how}"
        )
        return self._whole(lambda: self._database.execute(sql, [*its_arguments, *arguments, *more]).fetchall())

    def unreadable(self) -> tuple[UnreadableSession, ...]:
        """Folders with a session, or remains of one, that cannot be read."""
        sql = "SELECT name, trouble FROM session WHERE trouble != '' ORDER BY name"
        rows = self._whole(lambda: self._database.execute(sql).fetchall())
        return tuple(UnreadableSession(self._sessions_dir / name, trouble) for name, trouble in rows)

    # Reading the folders

    def _update(self, progress: Callable[[float], None]) -> None:
        progress(0.0)
        folders = {folder.name: folder for folder in session_folders(self._sessions_dir)}
        for name in [name for name in folders if _storable(name) != name]:
            _log.warning("%r is not in the index: its name is no text", str(folders.pop(name)))
        known = dict(self._database.execute("SELECT name, signature FROM session").fetchall())
        removed = [name for name in known if name not in folders]
        signatures = {name: content_signature(folder) for name, folder in folders.items()}
        changed = [
            name
            for name, folder in folders.items()
            # A session in progress changes constantly: it is read when it is new, and when it has ended.
            if known.get(name) != signatures[name] and not (name in known and is_held(folder))
        ]
        with self._database:
            for name in removed:
                self._forget(name)
        for number, name in enumerate(changed, start=1):
            content = _read(folders[name])
            with self._database:
                # Another process may update the same index.
                self._database.execute("BEGIN IMMEDIATE")
                self._forget(name)
                self._add(name, signatures[name], content)
            progress(number / len(changed))
        progress(1.0)

    def _forget(self, name: str | None) -> None:
        """Remove a session, or all of them without a name."""
        of_session = "session_id IN (SELECT id FROM session WHERE name = coalesce(?, name))"
        for statement in (
            f"INSERT INTO item_text (item_text, rowid, text) SELECT 'delete', id, text FROM item WHERE {of_session}",  # noqa: S608 - no values in it
            f"DELETE FROM item WHERE {of_session}",  # noqa: S608 - likewise
            "DELETE FROM session WHERE name = coalesce(?, name)",
        ):
            self._database.execute(statement, (name,))

    def _add(self, name: str, signature: str, content: "_Content") -> None:
        entry = content.entry
        values = [name, *(getattr(entry, column) for column in _ENTRY_COLUMNS[1:-1]), "\n".join(entry.losses)]
        columns = ", ".join(_ENTRY_COLUMNS)
        row = self._database.execute(
            f"INSERT INTO session (signature, trouble, identity, {columns}) VALUES (?, ?, ?{', ?' * len(values)})",  # noqa: S608 - no values in it
            [signature, content.trouble, content.identity, *values],
        ).lastrowid
        for item in content.items:
            item_row = self._database.execute(
                "INSERT INTO item (session_id, at_ns, session_s, kind, text, quoted) VALUES (?, ?, ?, ?, ?, ?)",
                (row, item.at_ns, item.session_s, item.kind, item.text, item.quoted),
            ).lastrowid
            self._database.execute("INSERT INTO item_text (rowid, text) VALUES (?, ?)", (item_row, item.text))

    def _entry(self, row: tuple[Any, ...], copies: dict[str, str]) -> SessionEntry:
        values = dict(zip(_ENTRY_COLUMNS, row, strict=True))
        values["copy_of"] = copies.get(values["name"], "")
        values["losses"] = tuple(map(read_loss, values["losses"].splitlines()))
        values["folder"] = self._sessions_dir / values.pop("name")
        values["closed_properly"] = bool(values["closed_properly"])
        return SessionEntry(**values)

    # The database

    def _whole(self, act: Callable[[], T]) -> T:
        """Run ``act``, and once more with a new index if the database is damaged or read-only."""
        try:
            return act()
        except sqlite3.Error as error:
            _log.warning("%s: %s", self._path, error)
            self._database.close()
            self._database = self._replacement(error)
            self._update(_no_progress)
            return act()

    def _open(self) -> sqlite3.Connection:
        try:
            return _opened(str(self._path))
        except sqlite3.Error as error:
            return self._replacement(error)
        except _ForeignDatabaseError:
            return self._in_memory(QT_TR_NOOP("it is not a session index"))

    def _replacement(self, error: sqlite3.Error) -> sqlite3.Connection:
        """Empty index in place of a damaged one, in memory if the file cannot be used."""
        if not _is_damage(error):
            return self._in_memory(str(error))
        _log.warning("%s is made anew: %s", self._path, error)
        try:
            self._path.replace(self._path.with_name(f"{self._path.name}.damaged"))
            for suffix in ("-wal", "-shm"):
                self._path.with_name(self._path.name + suffix).unlink(missing_ok=True)
            database = _opened(str(self._path))
        except (OSError, sqlite3.Error) as failure:
            return self._in_memory(str(failure))
        self.message = QT_TR_NOOP("The session index was damaged and has been rebuilt from the session folders.")
        return database

    def _in_memory(self, reason: str) -> sqlite3.Connection:
        _log.warning("%s cannot be used: %s", self._path, reason)
        message = QT_TR_NOOP(
            "The session index cannot be saved in {file} ({why}). Searching sessions works, but the folders "
            "are read again each time. Choose a writable study folder."
        )
        self.message = localized(message, file=self._path, why=reason)
        return _opened(":memory:")


class _Item(Value):
    """One searchable text."""

    at_ns: int
    session_s: float
    kind: str
    text: str
    quoted: int = 0


class _ForeignDatabaseError(Exception):
    """Database of another program."""


def _opened(path: str) -> sqlite3.Connection:
    """Database with the tables of the index. Raises sqlite3.Error, _ForeignDatabaseError."""
    if path != ":memory:" and not Path(path).exists():
        with contextlib.suppress(OSError):
            Path(path).touch()  # SQLite's own would never be writable by the group of a shared study
    database = sqlite3.connect(path, timeout=_BUSY_MS / 1000, check_same_thread=False)
    try:
        database.create_function("fits", 2, _fits, deterministic=True)
        _prepare(database)
    except BaseException:
        database.close()
        raise
    return database


def _prepare(database: sqlite3.Connection) -> None:
    """Create missing tables."""
    (application,) = database.execute("PRAGMA application_id").fetchone()
    (version,) = database.execute("PRAGMA user_version").fetchone()
    (tables,) = database.execute("SELECT count(*) FROM sqlite_master").fetchone()
    if tables and application != _APPLICATION_ID:
        raise _ForeignDatabaseError
    database.execute("PRAGMA journal_mode = WAL")
    database.execute("PRAGMA synchronous = NORMAL")
    if tables and version == _SCHEMA_VERSION:
        # Test write, since opening a database on a read-only disk succeeds.
        database.execute(f"PRAGMA user_version = {_SCHEMA_VERSION}")
        return
    with database:
        database.execute("BEGIN IMMEDIATE")
        if database.execute("PRAGMA user_version").fetchone() == (_SCHEMA_VERSION,):
            # Another process created them in the meantime.
            return
        for table in ("item_text", "item", "session"):
            database.execute(f"DROP TABLE IF EXISTS {table}")
        for statement in _SCHEMA.split(";\n"):
            database.execute(statement)
        database.execute(f"PRAGMA application_id = {_APPLICATION_ID}")
        database.execute(f"PRAGMA user_version = {_SCHEMA_VERSION}")


def _is_damage(error: sqlite3.Error) -> bool:
    """True if the file itself is broken, rather than locked, read-only, or the disk full."""
    code = getattr(error, "sqlite_errorcode", None)
    broken = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)
    return code is not None and (code & 0xFF) in broken


# One session


def content_signature(folder: Path) -> str:
    """Signature that changes with the session's files or annotations."""
    # Called for every session of a study, hence without a Path for each file.
    names = ["session.json", "events.mcap"]
    for inside, endings in (("", _MEDIA), ("annotations/", (".json",))):
        # No annotations; unreadable ones have no signature until they are readable.
        with contextlib.suppress(OSError), os.scandir(f"{folder}/{inside}") as entries:
            names += sorted(f"{inside}{entry.name}" for entry in entries if entry.name.endswith(endings))
    ages_and_sizes = "|".join(f"{name}:{_age_and_size(f'{folder}/{name}')}" for name in names)
    # Annotation files are named after coders, whose names must not leak.
    return hashlib.sha256(ages_and_sizes.encode("utf-8", "surrogateescape")).hexdigest()


_MEDIA = (".mp4", ".wav", ".txt", ".csv")


def copies_among(sessions: Mapping[str, tuple[Any, Sequence[str]]]) -> dict[str, str]:
    """Original of each copy, from session names with identities and losses.

    Of several copies, the original is the one with the fewest losses, then the first by name.
    """
    groups: dict[Any, list[str]] = {}
    for name, (identity, _) in sessions.items():
        groups.setdefault(identity, []).append(name)
    copies: dict[str, str] = {}
    for names in groups.values():
        original, *others = sorted(names, key=lambda name: (len(sessions[name][1]), name))
        copies |= dict.fromkeys(others, original)
    return copies


def without_copies(sessions: Sequence[Session], notify: Callable[[str], None]) -> list[Session]:
    """Sessions of a study that count; ``notify`` gets a sentence on each copy among them."""
    copies = copies_among({one.folder.name: (one.identity, one.losses) for one in sessions})
    for name, original in copies.items():
        notify(
            localized(
                QT_TR_NOOP("{session} is a copy of {original} and is not counted again."),
                session=name,
                original=original,
            )
        )
    return [one for one in sessions if one.folder.name not in copies]


def _age_and_size(path: str) -> str:
    try:
        status = os.stat(path)  # noqa: PTH116 - as said above
    except OSError:
        return "-"
    return f"{status.st_mtime_ns}:{status.st_size}"


class _Content(Value):
    """Index content of one session: its entry, identity and texts, or why it cannot be read."""

    entry: SessionEntry
    identity: str
    items: Sequence[_Item]
    trouble: str = ""


def _read(folder: Path) -> _Content:
    try:
        return _content(folder)
    except (SessionError, OSError) as error:
        _log.info("%s is not in the index: %s", folder, error)
        trouble = str(error)
    except Exception:
        # A faulty file must not hide the other sessions of the study.
        _log.exception("%s is not in the index", folder)
        trouble = (
            f"{folder} cannot be read: it is damaged in an unexpected way. See the log for"
            " details; the folder was not changed."
        )
    return _Content(SessionEntry(folder, "", 0.0), "", (), _storable(trouble))


def _content(folder: Path) -> _Content:
    """Read a session. Raises SessionError, OSError, and ValueError for times that no index can hold."""
    session = open_session(folder, repair=False)
    items = list(_items(session))
    if not all(abs(at_ns) < _NEVER_NS for at_ns in (session.started_ns, *(item.at_ns for item in items))):
        raise ValueError("a time that is out of range")
    trial = {key: _storable(value) for key, value in session.trial.items()}
    entry = SessionEntry(
        folder=folder,
        started_utc=session.clock.utc(session.started_ns),
        duration_s=session.duration_s,
        scenario=_storable(session.header.scenario.title),
        closed_properly=session.closed_properly,
        size_bytes=sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file()),
        utterances=sum(item.kind in _UTTERANCES for item in items),
        marks=sum(item.kind in _MARKS for item in items),
        problems=sum(item.kind == "problem" for item in items),
        losses=tuple(_storable(" ".join(loss.split())) for loss in session.losses),
        **{
            name: trial.get(name, "")
            for name in ("participant", "condition", "trial", "recording", "wizard", "purpose")
        },
    )
    heading = " ".join(
        part
        for part in (folder.name, entry.participant, entry.condition, entry.trial, entry.recording, entry.wizard,
                     entry.scenario, entry.purpose, trial.get("study", ""))
        if part
    )  # fmt: skip
    items.insert(0, _Item(session.started_ns, 0.0, "session", heading))
    return _Content(entry, _storable(repr(session.identity)), items)


_UTTERANCES = ("robot", "participant", "wizard")
_MARKS = ("mark", "wizard_error", "note")
_TOLD_BY = (UtteranceChanged, UtteranceCorrected, RecordingPaused, Marked, LlmExchange, Problem)


def _items(session: Session) -> Iterator[_Item]:
    def item(at_ns: int, kind: str, text: str, quoted: int = 0) -> _Item:
        return _Item(at_ns, session.clock.session_s(at_ns), kind, _storable(text), quoted)

    data = read_data(session, _TOLD_BY)
    timed = [(one, one.start_ns) for one in data.utterances if one.said and one.start_ns is not None]
    texts = {text for one, _ in timed if (text := " ".join(one.text.split()))}
    quoted: Counter[str] = Counter()
    exchanges = []
    for exchange in data.of(LlmExchange):
        question, found = _without_quotations(exchange.messages[-1].content if exchange.messages else "", texts)
        quoted.update(found)
        exchanges.append(item(exchange.asked_ns, "assistant", f"{question}\n{exchange.answer}".strip()))
    for one, start_ns in timed:
        yield item(start_ns, one.speaker, one.text, quoted[" ".join(one.text.split())])
    yield from exchanges
    for mark in data.marks:
        yield item(mark.start_ns, mark.kind, " ".join(part for part in (mark.label, mark.note) if part))
    for problem in data.of(Problem):
        yield item(problem.stamp_ns, "problem", f"{problem.what} {problem.meaning}".strip())
    yield from _annotations(session)


def _without_quotations(question: str, texts: set[str]) -> tuple[str, set[str]]:
    """A prompt without its quotations of session texts, and the quoted texts."""
    left, found = [], set()
    for line in question.splitlines():
        plain = " ".join(line.split())
        quoted = next((text for text in (plain, plain.partition(": ")[2]) if text in texts), None)
        if quoted is not None:
            found.add(quoted)
            continue
        for text in texts:
            if len(text) >= _QUOTED_FROM and text in plain:
                plain = plain.replace(text, " … ")
                found.add(text)
        left.append(plain)
    return "\n".join(left), found


def _annotations(session: Session) -> Iterator[_Item]:
    try:
        document = load_documents(session.folder, on_damaged=lambda what: _log.warning("not in the index: %s", what))
    except AnnotationError as error:
        _log.warning("not in the index: %s", error)
        return
    for annotation in document.annotations:
        if annotation.value.strip():
            at_ns = session.started_ns + annotation.start_ms * 1_000_000
            yield _Item(at_ns, annotation.start_ms / 1000, "annotation", _storable(annotation.value))


def _storable(text: str) -> str:
    """``text`` without characters that UTF-8 or SQLite cannot hold: lone surrogates and NUL."""
    return text.encode("utf-8", "replace").decode().replace("\0", " ")


# Queries


def _fits(value: str, pattern: str) -> bool:
    return fnmatch.fnmatchcase(value.casefold(), re.sub(r"([\[?])", r"[\1]", pattern.casefold()))


def _header_condition(query: SessionQuery) -> tuple[str, list[Any]]:
    given = [(name, getattr(query, name).strip()) for name in _FIELDS]
    given = [(name, pattern) for name, pattern in given if pattern]
    condition = " AND ".join(["1", *(f"fits(s.{name}, ?)" for name, _ in given)])
    return condition, [pattern for _, pattern in given]


def _words(text: str) -> list[str]:
    """Words of the user's input, ignoring punctuation."""
    words = [word for word in _storable(text).split() if any(character.isalnum() for character in word)]
    return words[:_MAX_WORDS]


def _text_condition(words: Sequence[str]) -> tuple[str, list[Any]]:
    """SQL for ``item i``: every word is a prefix of a word in the text. FTS5 operators are quoted."""
    conditions, arguments = [], []
    spaced = [word for word in words if not _UNSPACED.search(word)]
    if spaced:
        conditions.append("i.id IN (SELECT rowid FROM item_text WHERE item_text MATCH ?)")
        arguments.append(" AND ".join('"' + word.replace('"', '""') + '"*' for word in spaced))
    for word in words:
        if word not in spaced:
            conditions.append("instr(i.text, ?)")
            arguments.append(word)
    return " AND ".join(conditions), arguments


# Scripts without spaces between words, which the index cannot split: Thai to Khmer, Chinese, Japanese.
_UNSPACED = re.compile("[\u0e00-\u0eff\u1000-\u109f\u1780-\u17ff\u3040-\u30ff\u3400-\u9fff\uf900-\ufaff]")


def _plain(text: str) -> str:
    """Text without case and accents, preserving its length."""
    return "".join((unicodedata.normalize("NFKD", character).casefold() or " ")[0] for character in text)


def _snippet(text: str, words: Sequence[str]) -> str:
    """A line or two of ``text`` around the first of the words."""
    text = " ".join(text.split())
    if len(text) <= _SNIPPET_CHARACTERS:
        return text
    plain = _plain(text)
    places = [plain.find(_plain(word.strip("\"'()[]*.,:;!?"))) for word in words]
    first = min((place for place in places if place >= 0), default=0)
    start = max(0, min(first - _SNIPPET_CHARACTERS // 3, len(text) - _SNIPPET_CHARACTERS))
    end = start + _SNIPPET_CHARACTERS
    start = text.find(" ", start, first) + 1 if start else 0
    end = text.rfind(" ", first, end) if text.rfind(" ", first, end) > first and end < len(text) else end
    return f"{'…' if start else ''}{text[start:end].strip()}{'…' if end < len(text) else ''}"
