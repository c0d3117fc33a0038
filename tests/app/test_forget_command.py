"""``caris-desktop forget`` on a study with a database of people."""

import argparse
import re
import shutil
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

from caris_desktop.app import forget_command
from caris_desktop.app.composition import speech_history_file
from caris_desktop.people.people_store import About, PeopleStore, StoredEmbeddings
from caris_desktop.recording.forgetting.byte_search import ByteSearch
from caris_desktop.recording.forgetting.text_erasure import all_of
from tests.recording.forgetting.named_study import NAME, OTHER, PERSON, make_study, portrait

FACE = portrait()
VECTORS = np.random.default_rng(3).normal(size=(3, 128)).astype(np.float32)
PEOPLE = 50


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A study with 50 known people. To be copied."""
    study = make_study(tmp_path_factory.mktemp("made") / "study")
    # The first two are those in the recordings.
    ids = [f"p-{number + 1}" for number in range(PEOPLE)]
    new_ids = mock.patch("caris_desktop.people.people_store.new_person_id", side_effect=ids)
    with new_ids, closing(PeopleStore(study / "people.sqlite")) as store:
        for number, person_id in enumerate(ids):
            store.add()
            store.describe(person_id, About(name={PERSON: NAME, "p-2": OTHER}.get(person_id, f"Somebody {number}")))
            jpeg, vectors = (FACE, VECTORS) if person_id == PERSON else (portrait(), VECTORS[::-1] * 0.5)
            store.store_portrait(person_id, jpeg, 0.9)
            store.store_embeddings(StoredEmbeddings(person_id, "face", "arcface", "", vectors), expires_utc_ns=None)
    return study


@pytest.fixture
def study(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "study"))


def run(study: Path, *words: str) -> int:
    parser = argparse.ArgumentParser()
    forget_command.add_arguments(parser)
    return forget_command.run(parser.parse_args([str(study), *words]))


def found_in(study: Path) -> Sequence[str]:
    search = ByteSearch(all_of([NAME], [FACE, *(row.tobytes() for row in VECTORS)]))
    return [path.name for path in sorted(study.rglob("*")) if path.is_file() and search.file(path).hits]


@pytest.mark.long
def test_one_of_fifty_is_forgotten_and_the_others_are_as_they_were(
    study: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with closing(PeopleStore(study / "people.sqlite")) as store:
        others = {
            each.person_id: (each.about, store.portrait(each.person_id), [one.vectors.tobytes() for one in looks])
            for each in store.everybody()
            if each.person_id != PERSON
            for looks in [store.embeddings(person_id=each.person_id)]
        }
    assert len(others) == PEOPLE - 1
    # The folder of its sessions identifies the study, too.
    assert run(study / "sessions", NAME, "--text", "redact", "--yes") == 0
    assert found_in(study) == []
    told, noted = capsys.readouterr()
    assert "Incomplete" not in noted
    assert "1 video changed" in told
    assert ": 0 matches" in told
    with closing(PeopleStore(study / "people.sqlite")) as store:
        assert {
            each.person_id: (each.about, store.portrait(each.person_id), [one.vectors.tobytes() for one in looks])
            for each in store.everybody()
            for looks in [store.embeddings(person_id=each.person_id)]
        } == others


def test_an_unreadable_file_makes_the_erasure_incomplete(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (study / "torn.zip").write_bytes(b"PK\x03\x04 torn")
    (study / "interview.mp3").write_bytes(b"ID3")
    assert run(study, NAME, "--text", "redact", "--yes") == 1
    noted = capsys.readouterr().err
    assert noted.startswith("Incomplete: ")
    assert "could not be decompressed: torn.zip" in noted
    assert "interview.mp3 was not searched for people" in noted
    (review,) = (study / "forgotten").glob("review-*.txt")
    text = review.read_text(encoding="utf-8")
    review.write_text(re.sub(r"^\?", "keep", text, flags=re.MULTILINE), encoding="utf-8")
    assert run(study, PERSON, "--yes", "--review", str(review)) == 0
    assert "Incomplete" not in capsys.readouterr().err


def test_a_copy_of_the_people_is_reported_since_it_has_the_key(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("people.sqlite.bak", "old people.db"):
        shutil.copy(study / "people.sqlite", study / name)
    assert run(study, NAME, "--text", "redact", "--yes") == 1
    noted = capsys.readouterr().err
    assert "people.sqlite.bak" in noted
    assert "old people.db" in noted


def test_the_typed_sentences_of_the_study_are_cleaned_too(study: Path) -> None:
    history = speech_history_file(study)
    history.parent.mkdir(parents=True, exist_ok=True)
    history.write_text(f'"Fine."\n"Hello, {NAME}."\n', encoding="utf-8")
    try:
        assert run(study, NAME, "--text", "redact", "--yes") == 0
        assert history.read_text(encoding="utf-8") == '"Fine."\n'
    finally:
        history.unlink()


def test_texts_are_decided_on_in_a_list_and_handed_back(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(study, PERSON, "--yes") == 1
    told = capsys.readouterr().err
    (review,) = (study / "forgotten").glob("review-*.txt")
    assert f"caris-desktop forget {study} {PERSON} --review {review}" in told
    # Database and images are already free of the person.
    assert set(found_in(study)) == {"events.mcap", "speech.txt", review.name}
    lines = review.read_text(encoding="utf-8").splitlines()
    assert any(f"Hello »{NAME}«, welcome" in line for line in lines)
    assert run(study, PERSON, "--yes", "--review", str(review)) == 1
    review.write_text("\n".join(line.replace("?", "redact", 1) if line[:1] == "?" else line for line in lines), "utf-8")
    assert run(study, PERSON, "--yes", "--review", str(review)) == 0
    assert found_in(study) == []
    assert not review.exists()


def test_records_of_others_no_longer_name_the_person(study: Path) -> None:
    with closing(PeopleStore(study / "people.sqlite")) as store:
        for person_id in (PERSON, "p-2"):
            store.add_history(person_id, "said", f"{OTHER}, this is {NAME}.", utc_ns=5)
        store.describe("p-3", About(name="Quillfeather Senior", note=f"Father of {NAME}"))
    assert run(study, PERSON, "--yes") == 1
    (review,) = (study / "forgotten").glob("review-*.txt")
    listed = review.read_text(encoding="utf-8")
    assert f"data stored about p-2: {OTHER}, this is »{NAME}«." in listed
    assert "data stored about p-1" not in listed
    review.write_text(
        "\n".join(line.replace("?", "redact", 1) if line[:1] == "?" else line for line in listed.splitlines())
    )
    assert run(study, PERSON, "--yes", "--review", str(review)) == 0
    with closing(PeopleStore(study / "people.sqlite")) as store:
        assert [entry.text for entry in store.history("p-2")] == [f"{OTHER}, this is [forgotten]."]
        father = store.get("p-3")
        assert father is not None
        assert father.about == About(name="Quillfeather Senior", note="Father of [forgotten]")


def test_without_a_yes_nothing_is_done(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = found_in(study)
    assert run(study, PERSON) == 130
    assert "cannot be undone" in capsys.readouterr().out
    assert found_in(study) == before


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("Nobody At All", "--yes"), "has the name or id Nobody At All"),
        ((PERSON, "--yes", "--review", "absent.txt"), "absent.txt cannot be read"),
    ],
)
def test_a_failed_erasure_is_reported(
    study: Path, capsys: pytest.CaptureFixture[str], words: Sequence[str], expected: str
) -> None:
    assert run(study, *words) == 1
    assert expected in capsys.readouterr().err


def test_a_list_with_a_wrong_word_changes_nothing(study: Path, capsys: pytest.CaptureFixture[str]) -> None:
    review = study.parent / "review.txt"
    review.write_text("delete 0123456789 0:01: words\n", encoding="utf-8")
    before = found_in(study)
    assert run(study, PERSON, "--yes", "--review", str(review)) == 1
    assert "'delete', which is not a decision" in capsys.readouterr().err
    assert found_in(study) == before


def test_a_person_whom_the_database_does_not_know_is_forgotten_by_id_and_name(study: Path) -> None:
    (study / "people.sqlite").unlink()
    assert run(study, PERSON, "--yes", "--also-called", NAME, "--text", "redact") == 0
    assert found_in(study) == []
