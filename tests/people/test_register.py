"""The people of a study on disk."""

import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from caris_desktop.people.register import STEPS, PeopleRegister, PeopleStoreError


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "study" / "people.db"


def test_names_survive_reopening(path: Path) -> None:
    register = PeopleRegister(path)
    ada, other = register.add(), register.add()
    register.rename(ada.person_id, "Ada")
    register.close()

    register = PeopleRegister(path)
    assert [person.name for person in register.everybody()] == ["Ada", ""]
    assert register.get(other.person_id) == other
    assert register.get("p-unknown") is None
    register.close()


def test_ids_are_opaque_and_differ(path: Path) -> None:
    register = PeopleRegister(path)
    ids = {register.add().person_id for _ in range(50)}
    register.close()
    assert len(ids) == 50
    assert all(person_id.startswith("p-") for person_id in ids)


def test_two_people_may_have_the_same_name(path: Path) -> None:
    register = PeopleRegister(path)
    for _ in range(2):
        register.rename(register.add().person_id, "Alex")
    assert [person.name for person in register.everybody()] == ["Alex", "Alex"]
    register.close()


def test_being_seen_is_noted(path: Path) -> None:
    register = PeopleRegister(path)
    person = register.add()
    register.seen(person.person_id)
    seen = register.get(person.person_id)
    assert seen is not None
    assert seen.last_seen_utc_ns >= person.last_seen_utc_ns
    assert seen.created_utc_ns == person.created_utc_ns
    register.close()


def test_an_erased_person_leaves_no_trace_in_the_files(path: Path) -> None:
    register = PeopleRegister(path)
    erased, kept = register.add(), register.add()
    register.rename(erased.person_id, "Wilhelmina Unusual")
    register.rename(kept.person_id, "Kept Person")
    register.erase(erased.person_id)
    # Also while the database is still open: its write-ahead log holds what was written.
    content = b"".join(file.read_bytes() for file in path.parent.iterdir())
    assert b"Wilhelmina" not in content
    assert erased.person_id.encode() not in content
    assert [person.name for person in register.everybody()] == ["Kept Person"]
    with pytest.raises(KeyError):
        register.erase(erased.person_id)
    register.close()


def test_what_was_written_is_there_without_closing(path: Path) -> None:
    register = PeopleRegister(path)
    register.rename(register.add().person_id, "Ada")
    second = PeopleRegister(path)
    assert [person.name for person in second.everybody()] == ["Ada"]
    second.close()
    register.close()


@pytest.mark.logs("people database .* could not be")
@pytest.mark.parametrize(
    "content", [b"this is not a database, but someone's thesis " * 100, b"SQLite format 3\0" * 300]
)
def test_a_file_that_is_no_database_is_left_untouched(path: Path, content: bytes) -> None:
    path.parent.mkdir()
    path.write_bytes(content)
    with pytest.raises(PeopleStoreError, match="left untouched"):
        PeopleRegister(path)
    assert path.read_bytes() == content


def test_a_damaged_database_is_left_untouched(path: Path) -> None:
    register = PeopleRegister(path)
    for _ in range(300):
        register.rename(register.add().person_id, "x" * 80)
    register.close()
    content = bytearray(path.read_bytes())
    content[4096:] = b"\x5a" * (len(content) - 4096)
    path.write_bytes(bytes(content))
    with pytest.raises(PeopleStoreError, match="damaged"):
        PeopleRegister(path)
    assert path.read_bytes() == bytes(content)


def test_the_database_of_another_program_is_left_untouched(path: Path) -> None:
    path.parent.mkdir()
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE recipes (name TEXT)")
    database.commit()
    database.close()
    before = path.read_bytes()
    with pytest.raises(PeopleStoreError, match="another program"):
        PeopleRegister(path)
    assert path.read_bytes() == before


def test_a_newer_database_is_refused(path: Path) -> None:
    PeopleRegister(path).close()
    database = sqlite3.connect(path)
    database.execute("PRAGMA user_version = 99")
    database.close()
    with pytest.raises(PeopleStoreError, match="newer version"):
        PeopleRegister(path)


MORE = (
    ("ALTER TABLE people ADD COLUMN language TEXT NOT NULL DEFAULT ''",),
    ("UPDATE people SET language = 'en'", "CREATE TABLE groups (group_id TEXT PRIMARY KEY) STRICT"),
)


def content(path: Path) -> tuple[int, list[str]]:
    """Version and statements of the database."""
    with closing(sqlite3.connect(path)) as database:
        statements = [
            row[0] for row in database.execute("SELECT sql FROM sqlite_master WHERE sql NOT NULL ORDER BY name")
        ]
        return database.execute("PRAGMA user_version").fetchone()[0], statements


def test_an_older_database_is_raised_step_by_step_and_keeps_its_people(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    register = PeopleRegister(path)
    ada = register.add()
    register.rename(ada.person_id, "Ada")
    register.close()
    monkeypatch.setattr("caris_desktop.people.register.STEPS", STEPS + MORE)
    register = PeopleRegister(path)
    assert [person.name for person in register.everybody()] == ["Ada"]
    register.close()
    assert content(path)[0] == len(STEPS) + 2
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("SELECT language FROM people").fetchall() == [("en",)]
    PeopleRegister(path).close()
    fresh = path.with_name("fresh.db")
    PeopleRegister(fresh).close()
    assert content(fresh) == content(path)


@pytest.mark.logs("people database .* could not be")
def test_a_step_that_fails_leaves_the_database_at_its_version(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    register = PeopleRegister(path)
    register.add()
    register.close()
    before = content(path)
    monkeypatch.setattr("caris_desktop.people.register.STEPS", (*STEPS, *MORE, ("INSERT INTO nowhere VALUES (1)",)))
    with pytest.raises(PeopleStoreError, match="cannot be opened"):
        PeopleRegister(path)
    assert content(path) == before
    monkeypatch.setattr("caris_desktop.people.register.STEPS", STEPS)
    register = PeopleRegister(path)
    assert len(register.everybody()) == 1
    register.close()


@pytest.mark.logs("people database .* could not be")
def test_a_folder_that_cannot_be_written_is_explained(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(PeopleStoreError, match="cannot be"):
        PeopleRegister(tmp_path / "file" / "people.db")
    with pytest.raises(PeopleStoreError, match="cannot be opened"):
        PeopleRegister(tmp_path)
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


@pytest.mark.logs("people database .* could not be")
def test_a_database_that_is_locked_by_another_program_is_explained(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("caris_desktop.people.register._BUSY_TIMEOUT_S", 0.05)
    register = PeopleRegister(path)
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(PeopleStoreError, match="Another program"):
        register.add()
    other.execute("ROLLBACK")
    other.close()
    assert register.add().name == ""
    register.close()
