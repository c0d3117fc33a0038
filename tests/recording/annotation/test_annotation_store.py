"""Annotation files: written atomically, and never over an unreadable file."""

import json
import random
import subprocess
import sys
from pathlib import Path

import pytest

from caris_desktop.domain.schema_validation import problems
from caris_desktop.recording.annotation import annotation_editing, annotation_store
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument, Vocabulary, VocabularyEntry
from caris_desktop.recording.annotation.annotation_store import Coding, annotation_files, load_documents, save_coder
from tests.recording.told_session import tell
from tests.support.invalid_data import with_mistake
from tests.support.schemas import schema_validator


def coded(coder: str, value: str = "robot", *, at_ms: int = 0) -> AnnotationDocument:
    gaze = Vocabulary("Gaze", (VocabularyEntry("robot", "at it"), VocabularyEntry("away")), "Where people look.")
    document = annotation_editing.add_vocabulary(AnnotationDocument(duration_ms=60_000), gaze)
    document = annotation_editing.add_tier(document, "Looks", coder, "Gaze", participant="P07")
    document = annotation_editing.add_tier(document, "Notes", coder)
    document = annotation_editing.add_annotation(document, document.tiers[0].tier_id, at_ms, at_ms + 50, value)
    return annotation_editing.add_annotation(document, document.tiers[1].tier_id, 7, 9, 'ü\n"\U0001f916 <&')


def test_a_saved_document_comes_back_identical(tmp_path: Path) -> None:
    document = coded("anna")
    path = save_coder(tmp_path, document, "anna")
    assert path == tmp_path / "annotations" / "anna.json"
    assert load_documents(tmp_path) == document
    fewer = annotation_editing.remove_tier(document, document.tiers[1].tier_id)
    save_coder(tmp_path, fewer, "anna")
    assert load_documents(tmp_path) == fewer
    assert [file.name for file in path.parent.iterdir()] == ["anna.json"]
    assert load_documents(tmp_path / "nowhere") == AnnotationDocument()


def test_the_session_shows_how_long_it_is(tmp_path: Path) -> None:
    folder = tell(tmp_path / "s", [], lasts_s=12.3456)
    assert load_documents(folder).duration_ms == 12_346


def test_coders_have_files_of_their_own_for_any_name(tmp_path: Path) -> None:
    coders = ["anna", "Anna", "../../etc/passwd", "Zoë M.", "con", "李", "a" * 90]
    for number, coder in enumerate(coders):
        save_coder(tmp_path, coded(coder, at_ms=number), coder)
    # A second time into the same files.
    for number, coder in enumerate(coders):
        save_coder(tmp_path, coded(coder, at_ms=number), coder)
    files = annotation_files(tmp_path)
    assert len(files) == len(coders)
    assert len({path.name.casefold() for path in files}) == len(coders)
    assert {path.parent for path in files} == {tmp_path / "annotations"}
    document = load_documents(tmp_path)
    assert set(annotation_editing.coders_of(document)) == set(coders)
    starts = {tier.coder: document.of_tier(tier.tier_id)[0].start_ms for tier in document.tiers if tier.name == "Looks"}
    assert starts == {coder: number for number, coder in enumerate(coders)}
    annotation_editing.check_document(document)


@pytest.mark.logs(r"annotation\.annotation_store: ")
@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("", "is damaged"),
        ('{"format": "caris-desktop annotations", "format_version": 2}', "Update CARIS Desktop"),
        ("[]", "is damaged: the file as a whole"),
        ("overlap", "is damaged. Two annotations on the tier “Looks” overlap"),
        ("value", "is not in the vocabulary"),
        ("time", "is damaged: tiers/0/annotations/0/start_ms"),
        ("cut", "is damaged"),
        ("deep", "is damaged"),
    ],
)
def test_a_damaged_file_is_reported_and_never_overwritten(tmp_path: Path, content: str, told: str) -> None:
    save_coder(tmp_path, coded("ben"), "ben")
    path = save_coder(tmp_path, coded("anna"), "anna")
    data = json.loads(path.read_text())
    annotations = data["tiers"][0]["annotations"]
    match content:
        case "overlap":
            annotations.append({**annotations[0], "annotation_id": "c-anna-9"})
        case "value":
            annotations[0]["value"] = "floor"
        case "time":
            annotations[0]["start_ms"] = -1
    whole = json.dumps(data)
    special = {"cut": path.read_text()[:-30], "deep": "[" * 100_000}
    path.write_text(special.get(content, whole if content in ("overlap", "value", "time") else content))
    before = path.read_bytes()
    with pytest.raises(AnnotationError, match=told):
        load_documents(tmp_path)
    with pytest.raises(AnnotationError, match=told):
        save_coder(tmp_path, coded("anna"), "anna")
    assert path.read_bytes() == before
    messages: list[str] = []
    assert annotation_editing.coders_of(load_documents(tmp_path, on_damaged=messages.append)) == ("ben",)
    assert [told in message and str(path) in message for message in messages] == [True]


def test_the_schema_refuses_what_the_program_refuses() -> None:
    validator = schema_validator("annotations.schema.json")
    data = annotation_store.coding_jsonable(coded("anna"), "anna")
    assert list(problems(Coding, data)) == []
    assert validator.is_valid(data)
    chance = random.Random(9)  # noqa: S311 - a test, not cryptography
    refused = 0
    for _ in range(300):
        tried = with_mistake(data, chance, ["unknown", "participant", "value"])
        wrong = list(problems(Coding, tried))
        assert validator.is_valid(tried) == (not wrong), (tried, wrong)
        refused += bool(wrong)
    assert 100 < refused < 300


def test_only_what_keeps_the_rules_is_saved(tmp_path: Path) -> None:
    document = coded("anna")
    broken = AnnotationDocument(document.tiers, (), document.annotations, document.duration_ms)
    with pytest.raises(AnnotationError, match="which does not exist"):
        save_coder(tmp_path, broken, "anna")
    assert not (tmp_path / "annotations").exists()


def test_a_full_disk_leaves_the_last_saved_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    save_coder(tmp_path, coded("anna"), "anna")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(annotation_store, "replace_file", full)
    with pytest.raises(AnnotationError, match=r"The disk is full: anna\.json was not saved"):
        save_coder(tmp_path, coded("anna", "away"), "anna")
    assert load_documents(tmp_path) == coded("anna")


_READ_ONLY = """
import subprocess, sys
from pathlib import Path
folder = Path(sys.argv[1])
subprocess.run(["mount", "--bind", str(folder), str(folder)], check=True)
subprocess.run(["mount", "-o", "remount,ro,bind", str(folder)], check=True)
from caris_desktop.recording.annotation.annotation_editing import AnnotationError
from tests.recording.annotation.test_annotation_store import coded, load_documents, save_coder
assert load_documents(folder) == coded("anna")
try:
    save_coder(folder, coded("anna", "away"), "anna")
except AnnotationError as error:
    print(error)
"""


def test_a_read_only_disk_is_reported(tmp_path: Path) -> None:
    save_coder(tmp_path, coded("anna"), "anna")
    able = subprocess.run(["unshare", "-m", "true"], capture_output=True, check=False)
    if able.returncode:
        pytest.skip("this user may not mount anything, so there is no read-only disk to try")
    done = subprocess.run(
        ["unshare", "-m", sys.executable, "-c", _READ_ONLY, str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
        cwd=Path(__file__).parents[3],
    )
    assert "cannot be written to (Read-only file system): the annotations were not saved" in done.stdout, done.stderr
    assert load_documents(tmp_path) == coded("anna")
