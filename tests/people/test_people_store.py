"""Database of the people of a study."""

import contextlib
import sqlite3
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from caris_desktop.people.identities import unit
from caris_desktop.people.people_store import (
    MOST_HISTORY_FOUND,
    STEPS,
    About,
    PeopleStore,
    PeopleStoreError,
    Step,
    StoredEmbeddings,
    unseal,
)

HOUR_NS = 3600 * 10**9
NOW_NS = 1_790_000_000 * 10**9
ABOUT = About("Wilhelmina Unusual", "Control", ("shy", "tall"), "Likes trains")
PORTRAIT = b"\xff\xd8" + bytes(range(256)) * 40
LOOKS = np.stack([unit(row) for row in np.random.default_rng(1).normal(size=(3, 512)).astype(np.float32)])


def furnished(store: PeopleStore, about: About) -> str:
    """Add a person with data in every table."""
    person_id = store.add().person_id
    store.describe(person_id, about)
    store.store_embeddings(
        StoredEmbeddings(person_id, "clothing", "osnet", "2026-09-21", LOOKS), expires_utc_ns=NOW_NS + HOUR_NS
    )
    store.store_portrait(person_id, PORTRAIT, 0.8)
    store.note_visit(person_id, from_utc_ns=NOW_NS, to_utc_ns=NOW_NS + 1, session="first")
    store.note_consent(person_id, "photo", given=False)
    store.note_consent(person_id, "photo", given=True, actor="wizard")
    store.add_history(person_id, "said", "Some lemonade?", utc_ns=NOW_NS + 2)
    return person_id


def everything(path: Path) -> bytes:
    """All bytes of the database, including its log."""
    return b"".join(file.read_bytes() for file in path.parent.iterdir())


def key_of(path: Path, person_id: str) -> bytes:
    with closing(sqlite3.connect(path)) as database:
        return bytes(database.execute("SELECT key FROM keys WHERE person_id = ?", (person_id,)).fetchone()[0])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "study" / "people.db"


def test_names_survive_reopening(path: Path) -> None:
    store = PeopleStore(path)
    ada, other = store.add(), store.add()
    store.describe(ada.person_id, About("Ada"))
    store.close()

    store = PeopleStore(path)
    assert [person.name for person in store.everybody()] == ["Ada", ""]
    assert store.get(other.person_id) == other
    assert store.get("p-unknown") is None
    store.close()


def test_ids_are_opaque_and_differ(path: Path) -> None:
    store = PeopleStore(path)
    ids = {store.add().person_id for _ in range(50)}
    store.close()
    assert len(ids) == 50
    assert all(person_id.startswith("p-") for person_id in ids)


def test_two_people_may_have_the_same_name(path: Path) -> None:
    store = PeopleStore(path)
    for _ in range(2):
        store.describe(store.add().person_id, About("Alex"))
    assert [person.name for person in store.everybody()] == ["Alex", "Alex"]
    store.close()


def test_a_visit_is_noted_once_and_grows(path: Path) -> None:
    store = PeopleStore(path, utc_now_ns=lambda: NOW_NS)
    person = store.add()
    for until_s in (5, 9):
        store.note_visit(person.person_id, from_utc_ns=NOW_NS, to_utc_ns=NOW_NS + until_s * 10**9, session="first")
    (visit,) = store.history(person.person_id)
    assert (visit.kind, visit.utc_ns, visit.until_utc_ns) == ("visit", NOW_NS, NOW_NS + 9 * 10**9)
    assert visit.session == "first"
    seen = store.get(person.person_id)
    assert seen is not None and seen.last_seen_utc_ns == NOW_NS + 9 * 10**9
    store.close()


def test_everything_about_a_person_comes_back_and_stands_nowhere_in_the_clear(path: Path) -> None:
    store = PeopleStore(path, utc_now_ns=lambda: NOW_NS)
    ada = furnished(store, ABOUT)
    held = everything(path)
    for text in (b"Wilhelmina", b"trains", b"shy", b"lemonade", b"Control", PORTRAIT, LOOKS[0].tobytes()):
        assert text not in held, text
    store.close()

    store = PeopleStore(path, utc_now_ns=lambda: NOW_NS)
    again = store.get(ada)
    assert again is not None and again.about == ABOUT
    assert store.portrait(ada) == PORTRAIT
    (looks,) = store.embeddings(person_id=ada)
    assert np.array_equal(looks.vectors, LOOKS)
    assert [(entry.kind, entry.text) for entry in store.history(ada)] == [
        ("said", "Some lemonade?"),
        ("visit", ""),
    ]
    assert [consent.given for consent in store.consents()[ada].values()] == [True]
    store.close()


def test_a_merged_person_has_one_history_until_that_is_undone(path: Path) -> None:
    store = PeopleStore(path)
    ada, guest, third = (store.add().person_id for _ in range(3))
    store.describe(ada, About("Ada"))
    store.add_history(ada, "said", "Hello", utc_ns=1)
    store.add_history(guest, "heard", "Hello again", utc_ns=2)
    store.link(third, guest)
    store.link(guest, ada)
    assert store.ids_of(third) == store.ids_of(ada)
    assert set(store.ids_of(ada)) == {ada, guest, third}
    assert store.name_of(third) == "Ada"
    assert [entry.text for entry in store.history(guest)] == ["Hello again", "Hello"]
    store.link(guest, "")
    assert [entry.text for entry in store.history(ada)] == ["Hello"]
    assert store.name_of(guest) == ""
    store.close()


def test_a_history_is_searched_by_words(path: Path) -> None:
    store = PeopleStore(path)
    ada = store.add().person_id
    for number, text in enumerate(("The Mona Lisa is upstairs", "Lunch is at noon", "Is the mona lisa real?")):
        store.add_history(ada, "said", text, utc_ns=number)
    assert [entry.text for entry in store.history(ada, "lisa mona")] == [
        "Is the mona lisa real?",
        "The Mona Lisa is upstairs",
    ]
    store.close()


def test_of_a_long_history_only_what_is_shown_is_opened_and_all_of_it_has_to_be_forgotten(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = PeopleStore(path)
    ada = store.add().person_id
    store._database.execute("BEGIN")
    monkeypatch.setattr(store._file, "writing", contextlib.nullcontext)
    for number in range(3000):
        store.add_history(ada, "said", f"Sentence {number}", utc_ns=number)
    store._database.execute("COMMIT")
    opened: list[bytes] = []

    def counted(*arguments: Any) -> bytes:
        opened.append(arguments[3])
        return unseal(*arguments)

    monkeypatch.setattr("caris_desktop.people.people_store.unseal", counted)
    assert [entry.text for entry in store.history(ada, at_most=2)] == ["Sentence 2999", "Sentence 2998"]
    assert len(opened) <= 5
    assert [entry.text for entry in store.history(ada, "sentence 7", at_most=3000)][-1] == "Sentence 7"
    assert len(store.history(ada)) == MOST_HISTORY_FOUND
    store.close()


def test_clothes_expire_with_the_day_and_with_them_the_picture_of_who_was_only_passing(path: Path) -> None:
    now_ns = NOW_NS
    store = PeopleStore(path, utc_now_ns=lambda: now_ns)
    ada, agreed, passer_by, undecided = (furnished(store, about) for about in (ABOUT, About(), About(), About()))
    store.drop_embeddings(undecided, "clothing")
    store._database.execute("DELETE FROM consents WHERE person_id <> ?", (agreed,))
    now_ns += 10**9
    store.expire(day_began_utc_ns=NOW_NS)
    assert len(store.embeddings()) == 3
    now_ns += 2 * HOUR_NS
    assert store.embeddings() == (), "also before they are deleted"
    store.expire(day_began_utc_ns=now_ns - 10**9)
    assert [store.portrait(each) for each in (ada, agreed, passer_by, undecided)] == [PORTRAIT, PORTRAIT, None, None]
    now_ns = NOW_NS
    assert store.embeddings() == ()
    store.close()


def test_a_forgotten_person_leaves_no_trace_in_the_files_and_the_others_stay_as_they_are(path: Path) -> None:
    store = PeopleStore(path, utc_now_ns=lambda: NOW_NS)
    forgotten = furnished(store, ABOUT)
    guest = store.add().person_id
    store.store_portrait(guest, PORTRAIT[::-1], 0.5)
    store.link(guest, forgotten)
    others = {each: About(f"Other {each}", note="Stays") for each in (furnished(store, About()) for _ in range(49))}
    for person_id, about in others.items():
        store.describe(person_id, about)
        store.reject(person_id, guest)
    keys = [key_of(path, each) for each in (forgotten, guest)]
    traces = store.traces_of(guest)
    assert set(traces.person_ids) == {forgotten, guest}
    assert set(traces.blobs) == {PORTRAIT, PORTRAIT[::-1], *(row.tobytes() for row in LOOKS)}

    assert set(store.forget(guest)) == {forgotten, guest}
    # Also while the database is open: its write-ahead log contained the data.
    held = everything(path)
    for text in (*traces.person_ids, ABOUT.name, ABOUT.note, "Some lemonade?"):
        assert text.encode() not in held
    for blob in (*keys, *traces.blobs):
        assert blob not in held
    assert {person.person_id: person.about for person in store.everybody()} == others
    for person_id in others:
        assert store.portrait(person_id) == PORTRAIT
        assert len(store.embeddings(person_id=person_id)) == 1
        assert len(store.history(person_id)) == 2
    assert store.forget(guest) == (guest,), "asked again, it is as it was"
    store.close()


@pytest.mark.logs("people database .* could not be")
def test_a_log_that_could_not_be_emptied_is_reported_and_retried(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("caris_desktop.people.people_store._BUSY_TIMEOUT_S", 0.05)
    store = PeopleStore(path)
    ada = furnished(store, ABOUT)
    reader = sqlite3.connect(path, isolation_level=None)
    reader.execute("BEGIN")
    reader.execute("SELECT count(*) FROM people").fetchone()
    with pytest.raises(PeopleStoreError, match="Another program"):
        store.forget(ada)
    reader.execute("ROLLBACK")
    reader.close()
    store.forget(ada)
    assert ada.encode() not in everything(path)
    store.close()


def test_names_of_the_first_version_are_wrapped_and_stand_nowhere_in_the_clear(path: Path) -> None:
    path.parent.mkdir()
    with closing(sqlite3.connect(path, isolation_level=None)) as old:
        for statement in STEPS[0]:
            assert isinstance(statement, str)
            old.execute(statement)
        old.execute("PRAGMA user_version = 1")
        old.execute("BEGIN")
        for number in range(300):
            old.execute(
                "INSERT INTO people VALUES (?, ?, ?, ?)", (f"p-{number}", f"Wilhelmina {number}", number, number)
            )
        old.execute("COMMIT")
    assert b"Wilhelmina" in everything(path)
    store = PeopleStore(path)
    assert [person.name for person in store.everybody()] == [f"Wilhelmina {number}" for number in range(300)]
    assert b"Wilhelmina" not in everything(path)
    store.close()


@pytest.mark.logs("cannot be read")
def test_damaged_data_of_one_person_hides_no_other(path: Path) -> None:
    store = PeopleStore(path)
    for name in ("Ada", "Bo"):
        store.describe(store.add().person_id, About(name))
    store._database.execute("UPDATE people SET about = x'00' WHERE person_id = ?", (store.everybody()[0].person_id,))
    assert sorted(person.name for person in store.everybody()) == ["", "Bo"]
    store.close()


def test_written_data_is_there_without_closing(path: Path) -> None:
    store = PeopleStore(path)
    store.describe(store.add().person_id, About("Ada"))
    second = PeopleStore(path)
    assert [person.name for person in second.everybody()] == ["Ada"]
    second.close()
    store.close()


@pytest.mark.logs("people database .* could not be")
@pytest.mark.parametrize(
    "content", [b"this is not a database, but someone's thesis " * 100, b"SQLite format 3\0" * 300]
)
def test_a_file_that_is_no_database_is_left_untouched(path: Path, content: bytes) -> None:
    path.parent.mkdir()
    path.write_bytes(content)
    with pytest.raises(PeopleStoreError, match="left unchanged"):
        PeopleStore(path)
    assert path.read_bytes() == content


def test_a_damaged_database_is_left_untouched(path: Path) -> None:
    store = PeopleStore(path)
    for _ in range(300):
        store.describe(store.add().person_id, About("x" * 80))
    store.close()
    content = bytearray(path.read_bytes())
    content[4096:] = b"\x5a" * (len(content) - 4096)
    path.write_bytes(bytes(content))
    with pytest.raises(PeopleStoreError, match="damaged"):
        PeopleStore(path)
    assert path.read_bytes() == bytes(content)


def test_the_database_of_another_program_is_left_untouched(path: Path) -> None:
    path.parent.mkdir()
    database = sqlite3.connect(path)
    database.execute("CREATE TABLE recipes (name TEXT)")
    database.commit()
    database.close()
    before = path.read_bytes()
    with pytest.raises(PeopleStoreError, match="another program"):
        PeopleStore(path)
    assert path.read_bytes() == before


def test_a_newer_database_is_refused(path: Path) -> None:
    PeopleStore(path).close()
    database = sqlite3.connect(path)
    database.execute("PRAGMA user_version = 99")
    database.close()
    with pytest.raises(PeopleStoreError, match="newer version"):
        PeopleStore(path)


MORE: tuple[Step, ...] = (
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
    store = PeopleStore(path)
    ada = store.add()
    store.describe(ada.person_id, About("Ada"))
    store.close()
    monkeypatch.setattr("caris_desktop.people.people_store.STEPS", STEPS + MORE)
    store = PeopleStore(path)
    assert [person.name for person in store.everybody()] == ["Ada"]
    store.close()
    assert content(path)[0] == len(STEPS) + 2
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("SELECT language FROM people").fetchall() == [("en",)]
    PeopleStore(path).close()
    fresh = path.with_name("fresh.db")
    PeopleStore(fresh).close()
    assert content(fresh) == content(path)


@pytest.mark.logs("people database .* could not be")
def test_a_step_that_fails_leaves_the_database_at_its_version(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    store = PeopleStore(path)
    store.add()
    store.close()
    before = content(path)
    monkeypatch.setattr("caris_desktop.people.people_store.STEPS", (*STEPS, *MORE, ("INSERT INTO nowhere VALUES (1)",)))
    with pytest.raises(PeopleStoreError, match="cannot be opened"):
        PeopleStore(path)
    assert content(path) == before
    monkeypatch.setattr("caris_desktop.people.people_store.STEPS", STEPS)
    store = PeopleStore(path)
    assert len(store.everybody()) == 1
    store.close()


@pytest.mark.logs("people database .* could not be")
def test_a_folder_that_cannot_be_written_is_explained(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(PeopleStoreError, match="cannot be"):
        PeopleStore(tmp_path / "file" / "people.db")
    with pytest.raises(PeopleStoreError, match="cannot be opened"):
        PeopleStore(tmp_path)
    assert list(tmp_path.iterdir()) == [tmp_path / "file"]


@pytest.mark.logs("people database .* could not be")
def test_a_database_that_is_locked_by_another_program_is_explained(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("caris_desktop.people.people_store._BUSY_TIMEOUT_S", 0.05)
    store = PeopleStore(path)
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN EXCLUSIVE")
    with pytest.raises(PeopleStoreError, match="Another program"):
        store.add()
    other.execute("ROLLBACK")
    other.close()
    assert store.add().name == ""
    store.close()
