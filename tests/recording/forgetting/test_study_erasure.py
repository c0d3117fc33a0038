"""Erasure of a person in a whole study: video, sound, photos, texts and exports; other people stay unchanged."""

import errno
import io
import json
import shutil
import subprocess
import sys
import wave
import zipfile
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.forgetting.byte_search import ByteSearch
from caris_desktop.recording.forgetting.person_tracks import messages_of
from caris_desktop.recording.forgetting.study_erasure import (
    ForgetRequest,
    Forgotten,
    forget_person,
    unfinished_erasures,
)
from caris_desktop.recording.forgetting.text_erasure import ErasureStoppedError, all_of, read_review
from caris_desktop.recording.photo_file import PEOPLE, TAGS, change_texts, texts_of
from caris_desktop.recording.recorder.media_writer import write_photo
from caris_desktop.recording.session.folder_lock import hold
from caris_desktop.recording.session.manifest import verify_manifest, write_manifest
from caris_desktop.recording.session.media_files import content_of
from caris_desktop.recording.session.session_data import spoken
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import ExportRequest, export_all
from tests.recording.forgetting.named_study import NAME, OTHER, PERSON, every_file, make_study, portrait
from tests.support.recorded_session import make_session

FACE = portrait()
VECTOR = np.random.default_rng(3).normal(size=128).astype("<f4").tobytes()
CANARIES = all_of([NAME], [FACE, VECTOR])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """To be copied."""
    return make_study(tmp_path_factory.mktemp("made") / "study", sessions=2)


@pytest.fixture
def study(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "study"))


def forget(study: Path, **fields: Any) -> Forgotten:
    asked = {"names": (NAME,), "pictures": (FACE, VECTOR), "otherwise": "redact", **fields}
    return forget_person(ForgetRequest(study, (PERSON,), **asked), lambda: None)


def hits_in(study: Path) -> dict[str, int]:
    search = ByteSearch(CANARIES)
    found = {path: search.file(path) for path in study.rglob("*") if path.is_file()}
    return {path.name: len(searched.hits) for path, searched in found.items() if searched.hits}


def sessions_of(study: Path) -> list[Path]:
    return sorted((study / "sessions").iterdir())


def messages_in(folder: Path) -> list[tuple[str, bytes]]:
    return list(messages_of(folder / "events.mcap", lambda _topic: True))


def receipt_of(study: Path) -> dict[str, Any]:
    receipt: dict[str, Any] = json.loads((study / "forgotten" / "RECEIPT.json").read_bytes())["receipts"][-1]
    return receipt


def frames_of(video: Path) -> list[NDArray[np.uint8]]:
    with av.open(str(video)) as container:
        return [frame.to_ndarray(format="bgr24") for frame in container.decode(video=0)]


def test_nothing_of_them_is_found_any_more_and_the_receipt_proves_it(study: Path) -> None:
    (study / "notes.txt").write_text(f"{NAME} was early. {OTHER} was late.\n", encoding="utf-8")
    before = hits_in(study)
    assert {"events.mcap", "speech.txt", "notes.txt"} <= set(before)
    outcome = forget(study)
    assert outcome.complete
    assert hits_in(study) == {}
    receipt = receipt_of(study)
    assert receipt["search_before"]["names"] >= sum(before.values())
    assert receipt["search_after"]["names"] == receipt["search_after"]["pictures"] == 0
    assert receipt["search_after"]["bytes"] >= sum(map(len, every_file(study / "sessions").values()))
    assert PERSON not in unfinished_erasures(study)
    assert (study / "notes.txt").read_text(encoding="utf-8") == f"[forgotten] was early. {OTHER} was late.\n"
    # Later exports contain no data of the person either.
    export_all(ExportRequest(tuple(sessions_of(study)), ("csv", "eaf", "html", "parquet"), study / "exported"))
    assert (study / "exported").is_dir()
    assert hits_in(study) == {}


@pytest.mark.long
def test_every_session_is_complete_and_says_that_a_person_was_forgotten(study: Path) -> None:
    told = {folder.name: spoken(open_session(folder)) for folder in sessions_of(study)}
    recorded = {folder.name: messages_in(folder) for folder in sessions_of(study)}
    forget(study)
    for folder in sessions_of(study):
        assert verify_manifest(folder) == []
        session = open_session(folder)
        assert session.closed_properly
        assert session.losses == ()
        assert len(session.header.to_json()["forgotten"]) == 1
        assert PERSON not in json.dumps(session.header.to_json())
        # All other recorded data is unchanged, byte for byte.
        pairs = zip(messages_in(folder), recorded[folder.name], strict=True)
        # Unattributed speech during the presence is erased too.
        named = ("Quillfeather", NAME, json.dumps(NAME)[1:-1], "What can you show me?")
        different = [old for new, old in pairs if new != old]
        assert different
        assert all(any(name in old[1].decode() for name in named) for old in different)
        utterances = spoken(session)
        assert [one.utterance_id for one in utterances] == [one.utterance_id for one in told[folder.name]]
        changed = [new.text for new, old in zip(utterances, told[folder.name], strict=True) if new.text != old.text]
        assert changed == ["Hello [forgotten], welcome to our laboratory.", "[forgotten]", "[forgotten]"]


def test_in_the_film_they_are_covered_where_they_were_and_frames_keep_their_times(study: Path) -> None:
    folder = sessions_of(study)[0]
    video = folder / "video-front.mp4"
    old_frames, old_content, index = (
        frames_of(video),
        content_of(video),
        (folder / "video-front.frames.csv").read_bytes(),
    )
    looks = [value for _, value in open_session(folder).values("people")]
    forget(study)
    new_frames, new_content = frames_of(video), content_of(video)
    assert old_content is not None
    assert new_content is not None
    assert new_content.times_s == old_content.times_s
    assert (folder / "video-front.frames.csv").read_bytes() == index
    header = open_session(folder).header.to_json()["videos"][0]
    first_ns = header["first_stamp_ns"]
    for number in range(2, len(new_frames), 10):
        at_ns = first_ns + round(new_content.times_s[number] * 1e9)
        look = min(looks, key=lambda value: abs(value.stamp_ns - at_ns))
        for box in look.boxes:
            x, y = int(box.left_px + box.width_px / 2), int(box.top_px + box.height_px / 2)
            part = new_frames[number][y - 20 : y + 20, x - 8 : x + 8].astype(int)
            if box.person_id == PERSON:
                assert np.abs(part - 112).max() <= 6
        # Pixels far from the person are unchanged, apart from the second encoding.
        mine = [box for box in look.boxes if box.person_id == PERSON]
        far = np.ones(new_frames[number].shape[1], bool)
        for box in mine:
            far[max(0, int(box.left_px) - 60) : int(box.left_px + box.width_px) + 60] = False
        difference = np.abs(new_frames[number][:, far].astype(int) - old_frames[number][:, far].astype(int))
        assert difference.mean() < 6


def test_a_photo_is_covered_and_where_they_were_named_nothing_is_heard(study: Path) -> None:
    folder = sessions_of(study)[0]
    photo = folder / "photos" / "0001.png"
    before = cv2.imread(str(photo))
    session = open_session(folder)
    utterances = {one.text: one for one in spoken(session)}
    forget(study)
    after = cv2.imread(str(photo))
    assert after.shape == before.shape
    assert (after == 112).all(axis=2).mean() > 0.05
    sound = next(one for one in session.header.to_json()["audio"] if one["source"] == "robot voice")
    named, other = utterances[f"Hello {NAME}, welcome to our laboratory."], utterances[f"{OTHER} is here too."]
    with wave.open(str(folder / sound["file_name"])) as file:
        rate_hz = file.getframerate()
        samples = np.frombuffer(file.readframes(file.getnframes()), "<i2")
    for utterance, silent in ((named, True), (other, False)):
        begin = round((utterance.start_ns - sound["first_stamp_ns"]) / 1e9 * rate_hz)  # type: ignore[operator]
        end = round((utterance.end_ns - sound["first_stamp_ns"]) / 1e9 * rate_hz)  # type: ignore[operator]
        assert bool(samples[begin:end].any()) is not silent


@pytest.mark.long
def test_texts_wait_for_a_person_to_decide_and_the_rest_is_done(study: Path) -> None:
    (study / "notes.txt").write_text("A Quillfeather is a kind of pen.\n", encoding="utf-8")
    first = forget(study, otherwise="")
    assert first.review is not None
    assert first.waiting
    assert not first.complete
    assert set(hits_in(study)) == {"events.mcap", "speech.txt", "notes.txt", first.review.name}
    lines = first.review.read_text(encoding="utf-8").splitlines()
    written = [
        line.replace("?", "keep" if "kind of pen" in line else "redact", 1) if line.startswith("?") else line
        for line in lines
    ]
    decided = study.parent / "decided.txt"
    decided.write_text("\n".join(written), encoding="utf-8")
    review = read_review(decided)
    assert review.names == (NAME,)
    video = (sessions_of(study)[0] / "video-front.mp4").read_bytes()
    second = forget(study, names=review.names, pictures=(), otherwise="", decisions=review.decisions, only_texts=True)
    assert second.complete
    assert hits_in(study) == {"notes.txt": 1}
    assert receipt_of(study)["search_after"]["kept_by_decision"] == 1
    assert (sessions_of(study)[0] / "video-front.mp4").read_bytes() == video
    assert not first.review.exists()


def test_film_and_photos_are_removed_where_asked(study: Path) -> None:
    forget(study, recordings="remove")
    for folder in sessions_of(study):
        assert not list(folder.rglob("*.mp4"))
        assert not list(folder.rglob("*.png"))
        assert not (folder / "audio-microphone.wav").exists()
        assert verify_manifest(folder) == []
        session = open_session(folder)
        assert session.losses == ()
        assert session.header.to_json()["videos"] == []
    assert hits_in(study) == {}


def test_unrelated_files_stay_byte_for_byte(study: Path) -> None:
    stranger = sessions_of(study)[1]
    # A session in which the person was neither seen nor named.
    shutil.rmtree(stranger)
    make_session(stranger, seconds=4.0, cameras=("front",), fps=5.0, people=0, audio=(), utterance_every_s=0.0)
    (study / "plan.md").write_text("Nobody in particular.\n", encoding="utf-8")
    before = every_file(stranger) | {"plan.md": (study / "plan.md").read_bytes()}
    forget(study)
    assert every_file(stranger) | {"plan.md": (study / "plan.md").read_bytes()} == before


@pytest.mark.long
def test_exports_that_name_or_show_them_go_and_what_others_wrote_stays(study: Path) -> None:
    mine = sessions_of(study)[0]
    export_all(ExportRequest((mine,), ("csv", "frames"), study / "analysis" / mine.name, folder_per_session=False))
    script = study / "analysis" / mine.name / "csv" / "plot.R"
    script.write_text(f"# {NAME} is an outlier\n", encoding="utf-8")
    (study / "analysis" / "other").mkdir()
    (study / "analysis" / "other" / "captions.vtt").write_text("WEBVTT\n", encoding="utf-8")
    (study / "analysis" / "figure.png").write_bytes(FACE[:40])
    (study / "backup.zip").write_bytes(b"PK")
    (mine / "export-frames").mkdir()
    (mine / "export-frames" / "0001.jpg").write_bytes(FACE)
    outcome = forget(study)
    assert outcome.unexamined == ("analysis/figure.png",)
    assert outcome.waiting == 1
    left = {path.relative_to(study).as_posix() for path in study.rglob("*") if path.is_file()}
    assert {name for name in left if not name.startswith(("sessions/", "forgotten/"))} == {
        f"analysis/{mine.name}/csv/plot.R",
        f"analysis/{mine.name}/frames/README.md",
        # Boxes with opaque ids, without an image.
        f"analysis/{mine.name}/frames/yolo/boxes.csv",
        f"analysis/{mine.name}/frames/yolo/data.yaml",
        "analysis/other/captions.vtt",
        "analysis/figure.png",
        "backup.zip",
    }
    assert script.read_text(encoding="utf-8") == "# [forgotten] is an outlier\n"
    assert not (mine / "export-frames").exists()
    assert f"analysis/{mine.name}/csv" in receipt_of(study)["exports_concerned"]
    assert outcome.review is not None
    assert set(hits_in(study)) == {outcome.review.name}


def test_nobody_is_forgotten_while_a_session_is_recorded(study: Path) -> None:
    before = every_file(study)
    with (
        hold(sessions_of(study)[1]),
        pytest.raises(ErasureStoppedError, match="is currently being recorded or repaired"),
    ):
        forget(study)
    assert every_file(study) == before


@pytest.mark.long
def test_a_full_disk_is_reported_loses_nothing_and_is_gone_on_from(
    study: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = every_file(study)
    written = 0
    really = DiskFile.write

    def write(self: DiskFile, data: bytes) -> int:
        nonlocal written
        written += len(data)
        if written > 5000:
            raise OSError(errno.ENOSPC, "No space left on device")
        return really(self, data)

    monkeypatch.setattr(DiskFile, "write", write)
    with pytest.raises(ErasureStoppedError, match=r"The disk is full\..*erasing resumes where it stopped"):
        forget(study)
    now = every_file(study)
    assert {name: now.get(name) for name in before} == before
    assert not [name for name in now if name.endswith(".part")]
    assert PERSON in unfinished_erasures(study)
    monkeypatch.undo()
    assert forget(study).complete
    assert receipt_of(study)["resumed"]
    assert hits_in(study) == {}


@pytest.mark.long
def test_a_kill_at_any_step_leaves_it_to_continue_from(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    small = make_study(tmp_path / "small", seconds=7.0, fps=4.0)
    step = "1" if request.config.getoption("--long") else "14"
    script = ("-m", "tests.recording.forgetting.forget_and_die", str(small), str(tmp_path / "copies"), "1", step)
    command = [sys.executable, *script]
    told = subprocess.run(
        command, check=False, capture_output=True, text=True, timeout=110, cwd=Path(__file__).parents[3]
    )
    assert told.returncode == 0, told.stderr
    assert int(told.stdout) > 20


@pytest.mark.long
def test_photos_without_a_session_go_and_tags_are_text(study: Path) -> None:
    folder = sessions_of(study)[0]
    tagged = folder / "photos" / "0001.png"
    change_texts(tagged, {TAGS: f"arm, {NAME}", PEOPLE: PERSON})
    write_manifest(folder)
    (study / "photos").mkdir()
    mine, theirs = study / "photos" / "a.png", study / "photos" / "b.png"
    for path, people in ((mine, f"{PERSON} p-2"), (theirs, "p-2")):
        write_photo(np.zeros((8, 8, 3), np.uint8), path, texts={PEOPLE: people})
    kept = theirs.read_bytes()
    assert forget(study, recordings="mask").complete
    assert not mine.exists()
    assert theirs.read_bytes() == kept
    assert texts_of(tagged.read_bytes()) == {PEOPLE: PERSON, TAGS: "arm, [forgotten]"}
    assert verify_manifest(folder) == []


@pytest.mark.long
def test_names_of_files_are_changed_too(study: Path) -> None:
    folder = sessions_of(study)[0]
    (folder / "annotations").mkdir()
    (folder / "annotations" / f"{NAME}.json").write_bytes(b"{}")
    outcome = forget(study)
    assert outcome.complete
    assert [path.name for path in (folder / "annotations").iterdir()] == ["[forgotten].json"]
    assert NAME not in (study / "forgotten" / "RECEIPT.json").read_text(encoding="utf-8")


@pytest.mark.long
def test_a_file_that_cannot_be_changed_inside_waits_for_a_decision(study: Path) -> None:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("word/document.xml", f"<w:t>{NAME}</w:t>")
    (study / "thesis.docx").write_bytes(packed.getvalue())
    first = forget(study)
    assert first.waiting == 1
    assert first.review is not None
    key = next(
        line.split()[1] for line in first.review.read_text(encoding="utf-8").splitlines() if line.startswith("?")
    )
    second = forget(study, decisions={key: "remove"}, only_texts=True)
    assert second.complete
    assert not (study / "thesis.docx").exists()


def test_people_called_like_words_of_the_program_damage_no_value(tmp_path: Path) -> None:
    plan = {"cameras": (), "audio": (), "people": 0, "scans_hz": 1.0, "llm_every_s": 2.0}
    folder = make_session(tmp_path / "sessions" / "s", seconds=8.0, **plan).folder  # type: ignore[arg-type] # by name
    note = tmp_path / "notes.json"
    note.write_text('{"speaker": "max", "max_words": "Max said: Mark!", "kind": "mark"}', encoding="utf-8")
    (tmp_path / "tour.yaml").write_text("max_mps: 0.6\nphrases: [Hello Max]\n", encoding="utf-8")
    before = messages_in(folder)
    assert forget(tmp_path, names=("Max", "Mark"), pictures=()).complete
    assert messages_in(folder) == before
    said = '{"speaker": "[forgotten]", "max_words": "[forgotten] said: [forgotten]!", "kind": "mark"}'
    assert note.read_text("utf-8") == said
    assert (tmp_path / "tour.yaml").read_text("utf-8") == "max_mps: 0.6\nphrases: [Hello (forgotten)]\n"


def test_a_person_called_by_a_number_takes_nobody_elses_label(tmp_path: Path) -> None:
    folder = make_session(tmp_path / "sessions" / "s", seconds=8.0, cameras=(), audio=(), people=0).folder
    note = tmp_path / "notes.txt"
    note.write_text(
        "Participant 7, participant_7, Participant 71, Anna 2, Anna 21, any participant\n", encoding="utf-8"
    )
    before, header = messages_in(folder), (folder / "session.json").read_bytes()
    assert forget(tmp_path, names=("Participant 7", "Anna 2", "Person A"), pictures=()).complete
    assert messages_in(folder) == before
    assert (folder / "session.json").read_bytes() == header
    said = "[forgotten], [forgotten], Participant 71, [forgotten], Anna 21, any participant\n"
    assert note.read_text("utf-8") == said
