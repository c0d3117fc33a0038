"""Scope of an erasure: checksums, links, copies, unprocessed media, and the user's files."""

import gzip
import hashlib
import json
import os
import re
import shutil
import tarfile
import zipfile
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from caris_desktop.domain.events import ScenarioOpened
from caris_desktop.recording.forgetting.byte_search import ByteSearch
from caris_desktop.recording.forgetting.erasure_files import OwnFiles
from caris_desktop.recording.forgetting.person_tracks import messages_of
from caris_desktop.recording.forgetting.text_erasure import all_of, read_review
from caris_desktop.recording.session.manifest import verify_manifest
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import export_session
from caris_desktop.recording.table_files import transcripts_folder
from tests.recording.forgetting.named_study import NAME, make_study
from tests.recording.forgetting.test_study_erasure import forget, hits_in, receipt_of, sessions_of
from tests.support import recorded_session
from tests.support.recorded_session import SessionPlan, make_session

SCENARIO = "title: Tour\nphrases:\n- Hello {}\n"
GUESSES = [NAME, *(f"Guess {number}" for number in range(10_000))]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_study(tmp_path_factory.mktemp("made") / "study", sessions=2, seconds=7.0, fps=5.0)


@pytest.fixture
def study(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "study"))


def decide(study: Path, review: Path, decision: str, **fields: Any) -> Any:
    text = review.read_text(encoding="utf-8")
    review.write_text(re.sub(r"^\?", decision, text, flags=re.MULTILINE), encoding="utf-8")
    decided = read_review(review)
    return forget(study, names=decided.names, decisions=decided.decisions, only_texts=True, review=review, **fields)


def test_no_checksum_that_is_left_gives_the_name_to_a_person_who_guesses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def told_of(name: str) -> tuple[bytes, ...]:
        """Erased contents with this name."""
        return f"{name} was early.\n".encode(), SCENARIO.format(name).encode(), name.encode()

    text = SCENARIO.format(NAME)
    beginning = recorded_session._initial_values
    opened = ScenarioOpened(0, "tour.yaml", "Tour", hashlib.sha256(text.encode()).hexdigest(), text)

    def with_scenario(plan: SessionPlan) -> Any:
        rows = list(beginning(plan))
        return iter([*rows, (rows[-1][0], opened)])

    monkeypatch.setattr(recorded_session, "_initial_values", with_scenario)
    study = make_study(tmp_path / "study", seconds=7.0, fps=5.0)
    (folder,) = sessions_of(study)
    header = json.loads((folder / "session.json").read_bytes())
    header["scenario"] = {"title": "Tour", "file": "tour.yaml", "sha256": opened.sha256}
    (folder / "session.json").write_text(json.dumps(header), encoding="utf-8")
    (study / "notes.txt").write_bytes(told_of(NAME)[0])
    before = hashlib.sha256(told_of(NAME)[0]).hexdigest()
    older = {"files": [{"file": "a.txt", "what": "text", "before": before, "after": "00", "count": 1}]}
    (study / "forgotten").mkdir()
    (study / "forgotten" / "RECEIPT.json").write_text(
        json.dumps({"receipts": [older | {"steps": {}, "search_after": {}}]}), encoding="utf-8"
    )
    assert forget(study).complete
    left = b"\n".join(path.read_bytes() for path in study.rglob("*") if path.is_file())
    left += b"\n".join(data for _, data in messages_of(folder / "events.mcap", lambda _topic: True))
    digests = {digest.decode() for digest in re.findall(rb"[0-9a-f]{64}", left)}
    assert digests  # of the present files
    for name in GUESSES:
        assert digests.isdisjoint(hashlib.sha256(content).hexdigest() for content in told_of(name)), name
    now = open_session(folder).header.to_json()["scenario"]["sha256"]
    assert now == hashlib.sha256(SCENARIO.format("(forgotten)").encode()).hexdigest()
    assert receipt_of(study)["complete"] is True


@pytest.mark.long
def test_a_session_that_a_link_leads_to_is_the_studys(study: Path) -> None:
    folder = sessions_of(study)[0]
    elsewhere = study.parent / "big disk" / folder.name
    elsewhere.parent.mkdir()
    folder.rename(elsewhere)
    folder.symlink_to(elsewhere)
    film = (elsewhere / "video-front.mp4").read_bytes()
    assert forget(study).complete
    assert hits_in(elsewhere) == {}
    assert (elsewhere / "video-front.mp4").read_bytes() != film
    assert folder.is_symlink()
    assert verify_manifest(elsewhere) == []


@pytest.mark.long
def test_all_sessions_behind_a_link_are_the_studys(study: Path) -> None:
    elsewhere = study.parent / "all of them"
    (study / "sessions").rename(elsewhere)
    (study / "sessions").symlink_to(elsewhere)
    assert forget(study).complete
    assert hits_in(elsewhere) == {}


def test_names_of_files_and_targets_of_links_are_redacted_also_where_they_become_equal(study: Path) -> None:
    for number, name in enumerate(("Quillfeather.txt", "quillfeather.txt", "QUILLFEATHER.txt")):
        (study / name).write_text(str(number), encoding="utf-8")
    (study / "Quillfeather").mkdir()
    (study / "quillfeather").mkdir()
    (study / "latest").symlink_to("Quillfeather.txt")
    (study / "gone").symlink_to("missing-Quillfeather.txt")
    (study / "circle").symlink_to("circle")
    assert forget(study).complete
    named = [path.name for path in study.rglob("*")] + [str((study / name).readlink()) for name in ("latest", "gone")]
    assert [name for name in named if "quillfeather" in name.lower()] == []
    assert {path.read_text("utf-8") for path in study.glob("*.txt")} == {"0", "1", "2"}
    assert (study / "latest").exists()
    assert len([path for path in study.iterdir() if path.is_dir()]) == 4  # with sessions and forgotten


def test_a_link_to_a_path_elsewhere_that_names_the_person_is_a_problem(study: Path) -> None:
    folder = sessions_of(study)[0]
    elsewhere = study.parent / "quillfeathers disk"
    folder.rename(elsewhere)
    folder.symlink_to(elsewhere)
    outcome = forget(study)
    assert not outcome.complete
    assert any("leads to a path that names the person" in problem for problem in outcome.problems)
    assert folder.exists()


def test_names_of_files_that_are_not_utf_8_stop_nothing(study: Path) -> None:
    folders = (study, sessions_of(study)[0])
    for folder in folders:
        Path(os.fsdecode(os.fsencode(folder) + b"/note-\xff.txt")).write_text(NAME, encoding="utf-8")
    assert forget(study).complete
    assert hits_in(study) == {}
    assert any("note-\udcff" in one["file"] for one in receipt_of(study)["files"])


def test_tags_and_comments_of_a_file_manager_are_removed(study: Path) -> None:
    notes = study / "notes.txt"
    notes.write_text("Nothing.\n", encoding="utf-8")
    try:
        os.setxattr(notes, "user.xdg.comment", f"by {NAME}".encode())
    except (AttributeError, OSError):
        pytest.skip("needs a file system with extended attributes")
    assert forget(study).complete
    assert os.listxattr(notes) == []
    assert notes.read_text(encoding="utf-8") == "Nothing.\n"
    assert hits_in(study) == {}


def test_a_text_in_a_code_page_is_redacted_and_the_rest_is_as_it_was(study: Path) -> None:
    (study / "coders.csv").write_bytes("id;name\n1;Zoë\n2;Jürgen\n".encode("cp1252"))
    assert forget(study).complete
    assert (study / "coders.csv").read_bytes() == "id;name\n1;[forgotten]\n2;Jürgen\n".encode("cp1252")


@pytest.mark.parametrize("kind", ["film", "file", "folder"])
@pytest.mark.long("folder")
def test_another_link_out_of_the_study_is_refused_by_name(study: Path, kind: str) -> None:
    folder = sessions_of(study)[0]
    elsewhere = study.parent / "elsewhere"
    elsewhere.mkdir()
    target = elsewhere / "kept.mp4"
    if kind == "film":
        link = folder / "video-front.mp4"
        link.rename(target)
    else:
        link = study / "notes"
        target.write_text(f"{NAME}\n", encoding="utf-8")
    link.symlink_to(elsewhere if kind == "folder" else target)
    before = target.read_bytes()
    outcome = forget(study)
    assert not outcome.complete
    assert any(link.name in problem and "points outside the study" in problem for problem in outcome.problems)
    assert link.is_symlink()
    assert target.read_bytes() == before
    receipt = receipt_of(study)
    assert receipt["complete"] is False
    assert any(link.name in problem for problem in receipt["problems"])


def test_links_within_the_study_and_in_circles_hide_nothing(study: Path) -> None:
    (study / "again").symlink_to(study)
    (study / "sessions" / "one of them").symlink_to(sessions_of(study)[0])
    (study / "nowhere").symlink_to(study / "absent")
    assert forget(study).complete
    assert hits_in(study) == {}


def test_copies_of_film_and_photos_become_as_the_covered_ones(study: Path) -> None:
    folder = sessions_of(study)[0]
    (study / "for the talk").mkdir()
    film, photo = study / "for the talk" / "film.bak", study / "for the talk" / "best photo.png"
    shutil.copy(folder / "video-front.mp4", film)
    shutil.copy(folder / "photos" / "0001.png", photo)
    whole = Path(shutil.copytree(folder, study / "backup" / "a session"))
    before = film.read_bytes()
    assert forget(study).complete
    assert film.read_bytes() != before
    assert film.read_bytes() == (folder / "video-front.mp4").read_bytes()
    assert photo.read_bytes() == (folder / "photos" / "0001.png").read_bytes()
    assert (cv2.imread(str(photo)) == 112).all(axis=2).mean() > 0.05
    assert (whole / "video-front.mp4").read_bytes() != before
    assert hits_in(study) == {}
    assert "for the talk/film.bak" in {file["file"] for file in receipt_of(study)["files"]}


def test_copies_of_removed_films_go_with_them(study: Path) -> None:
    copy = study / "film.mp4"
    shutil.copy(sessions_of(study)[0] / "video-front.mp4", copy)
    forget(study, recordings="remove")
    assert not copy.exists()


def test_a_hard_link_from_outside_is_reported(study: Path) -> None:
    (study / "notes.txt").write_text(NAME, encoding="utf-8")
    for path in (study / "notes.txt", sessions_of(study)[0] / "video-front.mp4"):
        os.link(path, study.parent / path.name)
    outcome = forget(study)
    assert not outcome.complete
    for name in ("notes.txt", "video-front.mp4"):
        assert any(f"{name} has a hard link outside" in problem for problem in outcome.problems)


def test_media_that_nothing_looked_at_are_listed_and_wait(study: Path) -> None:
    blind = study / "sessions" / "2026-12-24_10-00-00_P09"
    nobody = {"people": 0, "people_hz": 0.0, "utterance_every_s": 0.0}
    make_session(blind, seconds=4.0, cameras=("front",), fps=5.0, photo_every_s=2.0, **nobody)
    (study / "interviews").mkdir()
    (study / "interviews" / "first.MP3").write_bytes(b"ID3 of somebody")
    (study / "photos").mkdir()
    cv2.imwrite(str(study / "photos" / "untagged.png"), np.zeros((8, 8, 3), np.uint8))
    (study / "torn.zip").write_bytes(b"PK\x03\x04 torn")
    (study / "consent.pdf").write_bytes(b"%PDF-1.7 packed")
    for name, content in (
        ("clip.MTS", (bytes(4) + b"G" + bytes(187)) * 3),
        ("phone.3gp", b"\0\0\0\x20ftyp3gp5"),
        ("backup", b"7z\xbc\xaf\x27\x1c packed"),
        ("ID3 FORM.txt", b"FORM 3"),
    ):
        (study / name).write_bytes(content)
    (study / "film.gz").write_bytes(gzip.compress(b"\0\0\0\x20ftypisom"))
    embedded = {
        "thesis.rtf": rb"{\rtf1 {\pict\jpegblip ffd8}}",
        "analysis.ipynb": b'{"outputs": [{"data": {"image/png": "iVBORw0"}}]}',
        "page.htm": b'<p><img src="data:image/jpeg;base64,/9j/"></p>',
        "letter.eml": b"To: lab\r\nContent-Transfer-Encoding: base64\r\n\r\nSGVsbG8=\r\n",
        "card.vcf": b"BEGIN:VCARD\r\nPHOTO;ENCODING=b;TYPE=JPEG:/9j/\r\n",
        "table.mat": b"MATLAB 5.0 MAT-file, packed",
        "letter.doc": b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1",
        "history": zlib.compress(b"blob 3\0abc"),
    }
    plain = {"x.txt": b"x^2 is a parabola", "format.txt": b"image/png is a format; base64 is a code"}
    for name, content in (embedded | plain).items():
        (study / name).write_bytes(content)
    (study / "text.gz").write_bytes(gzip.compress(b"something"))
    for name, inside in (("films.zip", "a/film.mp4"), ("texts.zip", "a/notes.txt"), ("nested.zip", "films.zip")):
        with zipfile.ZipFile(study / name, "w") as archive:
            archive.writestr(inside, b"something")
    with tarfile.open(study / "photos.tar.gz", "w:gz") as packed:
        packed.add(study / "photos" / "untagged.png")
    outcome = forget(study)
    assert not outcome.complete
    listed = set(outcome.unexamined)
    name = f"sessions/{blind.name}"
    assert {f"{name}/video-front.mp4", f"{name}/audio-microphone.wav", f"{name}/photos/0001.png"} <= listed
    assert {"interviews/first.MP3", "photos/untagged.png", "torn.zip", "consent.pdf"} <= listed
    assert {"films.zip", "photos.tar.gz", "nested.zip", "film.gz", "clip.MTS", "phone.3gp", "backup"} <= listed
    assert listed.isdisjoint({"texts.zip", "text.gz", "ID3 FORM.txt", *plain})
    assert set(embedded) <= listed
    assert not any(file.startswith(f"sessions/{folder.name}/") for folder in sessions_of(study)[:2] for file in listed)
    receipt = receipt_of(study)
    assert receipt["complete"] is False
    assert set(receipt["search_after"]["not_looked_at"]) == listed
    assert outcome.review is not None
    assert decide(study, outcome.review, "keep").complete
    assert (study / "interviews" / "first.MP3").exists()


def test_texts_marked_for_removal_are_removed(study: Path) -> None:
    (study / "first.wav").write_bytes(b"RIFF")
    outcome = forget(study)
    assert outcome.unexamined == ("first.wav",)
    assert outcome.review is not None
    assert decide(study, outcome.review, "remove").complete
    assert not (study / "first.wav").exists()
    assert not outcome.review.exists()


def test_the_users_own_files_are_searched_and_cleaned(study: Path) -> None:
    home = study.parent / "home"
    for folder in ("state/said", "state/log", "config", "voice", "documents"):
        (home / folder).mkdir(parents=True)
    history = home / "state" / "said" / "0123.jsonl"
    history.write_text(f'"Fine."\n"Hello, {NAME}."\n"And you, quillfeather?"\n', encoding="utf-8")
    log = home / "state" / "log" / "console.log"
    log.write_text(f"WARNING {NAME} is said\nINFO all else\n", encoding="utf-8")
    settings = home / "config" / "settings.conf"
    settings.write_text(f"[wizards]\nlast={NAME}\n", encoding="utf-8")
    kept = home / "documents" / "other study.txt"
    kept.write_text(NAME, encoding="utf-8")
    sound = home / "voice" / "1.wav"
    sound.write_bytes(b"RIFF of a name")
    (home / "trap").symlink_to(home / "documents")
    own = OwnFiles(
        home / "state" / "said", home / "state" / "log", (home / "voice", home / "trap"),
        (home / "state", home / "config", home / "documents"), (home / "documents",),
    )  # fmt: skip
    with log.open("a", encoding="utf-8") as still_open:
        assert forget(study, own_files=own).complete
        still_open.write("INFO later\n")
    assert history.read_text(encoding="utf-8") == '"Fine."\n'
    lines = log.read_text(encoding="utf-8").splitlines()
    assert re.fullmatch(r"WARNING -+ is said", lines[0])
    assert lines[1:] == ["INFO all else", "INFO later"]
    assert settings.read_text(encoding="utf-8") == "[wizards]\nlast=[forgotten]\n"
    assert not sound.exists()
    assert kept.read_text(encoding="utf-8") == NAME
    assert {"history", "log"} <= set(receipt_of(study)["steps"])


def test_texts_of_the_users_own_wait_like_those_of_the_study(study: Path) -> None:
    note = study.parent / "own" / "scenarios" / "tour.yaml"
    note.parent.mkdir(parents=True)
    note.write_text(f"phrases: ['Hello {NAME}']\n", encoding="utf-8")
    own = OwnFiles(others=(study.parent / "own",))
    outcome = forget(study, otherwise="", own_files=own)
    assert outcome.review is not None
    assert "tour.yaml" in outcome.review.read_text(encoding="utf-8")
    assert decide(study, outcome.review, "redact", otherwise="", own_files=own).complete
    assert NAME not in note.read_text(encoding="utf-8")


def test_tables_that_were_derived_are_erased(study: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    one, two = sessions_of(study)
    (two / "derived").touch()
    for folder in (one, two):
        export_session(folder, "parquet", tmp_path / folder.name)
    (two / "derived").unlink()
    transcript = transcripts_folder(one) / "small.csv"
    transcript.parent.mkdir()
    transcript.write_text("u-1,words that nobody searches for", encoding="utf-8")
    stored = [*(one / "derived").rglob("utterances.parquet"), *(tmp_path / "cache").rglob("utterances.parquet")]
    assert len(stored) == 2
    assert all(ByteSearch(all_of((NAME,), ())).file(path).hits for path in stored)
    forgotten = forget(study, own_files=OwnFiles(others=(tmp_path / "cache",)))
    assert forgotten.complete, forgotten
    assert not list((one / "derived").rglob("*.parquet"))
    assert not transcript.exists()
    assert not list((tmp_path / "cache").rglob("*.parquet"))
    assert not hits_in(study)
