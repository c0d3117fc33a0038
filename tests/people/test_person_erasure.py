"""Selection of people to erase by id or name, with all their data in the database."""

from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.people.people_store import About, PeopleStore, StoredEmbeddings
from caris_desktop.people.person_erasure import erase, find_person


@pytest.fixture
def database(tmp_path: Path) -> Path:
    """Ada with a merged second id, and two people called Ben."""
    path = tmp_path / "people.sqlite"
    with closing(PeopleStore(path)) as store:
        ada, again, *bens = (store.add().person_id for _ in range(4))
        store.describe(ada, About(name="Ada  Quill", note="Likes trains"))
        for ben in bens:
            store.describe(ben, About(name="Ben"))
        store.store_portrait(again, b"a picture", 0.9)
        vectors = np.eye(2, 8, dtype=np.float32)
        store.store_embeddings(StoredEmbeddings(ada, "clothing", "osnet", "2026-11-22", vectors), expires_utc_ns=None)
        store.link(again, ada)
    return path


def test_a_person_is_found_by_name_or_any_id_with_all_that_is_known(database: Path) -> None:
    by_name = find_person(database, "ada quill")
    assert by_name is not None
    assert by_name.names == ("Ada  Quill",)
    assert len(by_name.person_ids) == 2
    assert b"a picture" in by_name.pictures
    assert len(by_name.pictures) == 3
    assert all(find_person(database, each) == by_name for each in by_name.person_ids)
    assert find_person(database, "Nobody") is None
    assert find_person(database.with_name("absent.sqlite"), "Ada Quill") is None


def test_of_two_with_one_name_nobody_is_chosen(database: Path) -> None:
    with pytest.raises(UserFacingError, match=r"2 people in this study are called Ben\..*by id: p-\w+, last seen"):
        find_person(database, "Ben")


def test_an_erased_person_is_gone_and_may_be_erased_again(database: Path) -> None:
    ada = find_person(database, "Ada Quill")
    assert ada is not None
    for _ in range(2):
        erase(database, ada.person_ids)
    assert find_person(database, "Ada Quill") is None
    with closing(PeopleStore(database)) as store:
        assert [person.name for person in store.everybody()] == ["Ben", "Ben"]


@pytest.mark.logs("could not be opened")
def test_a_database_of_something_else_is_reported_and_left(tmp_path: Path) -> None:
    path = tmp_path / "people.sqlite"
    path.write_bytes(b"no database" * 100)
    with pytest.raises(UserFacingError, match="No person was erased"):
        find_person(path, "Ada")
    assert path.read_bytes() == b"no database" * 100
