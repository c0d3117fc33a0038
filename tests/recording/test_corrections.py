"""Corrections of utterances: used by everything derived from a session, with the recognised text kept."""

import csv
import shutil
from pathlib import Path
from typing import Any

import pytest

from caris_desktop.domain.events import Speaker, UtteranceChanged, UtteranceCorrected, UtteranceOrigin
from caris_desktop.recording.forgetting.person_tracks import PersonTracks
from caris_desktop.recording.forgetting.study_erasure import ForgetRequest, forget_person
from caris_desktop.recording.forgetting.text_erasure import speech_in
from caris_desktop.recording.session.session_data import read_data, spoken
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import export_session
from caris_desktop.recording.studies.study_index import StudyIndex
from caris_desktop.recording.studies.study_query import SessionQuery
from tests.recording.told_session import at, tell

NAME = "Quillfeather"


def said(turn_id: str, speaker: Speaker, text: str, from_s: float, to_s: float) -> list[Any]:
    origin: UtteranceOrigin = "heard" if speaker == "participant" else "typed"
    return [
        UtteranceChanged(at(from_s), turn_id, speaker, "" if origin == "heard" else text, origin, "started"),
        UtteranceChanged(at(to_s), turn_id, speaker, text, origin, "finished"),
    ]


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Path:
    study = tmp_path_factory.mktemp("corrected") / "study"
    events = [
        *said("p1", "participant", "I am quill feather.", 1.0, 2.5), *said("r1", "robot", "Hello.", 3.0, 3.6),
        *said("p2", "participant", "Hello.", 3.2, 3.7), *said("p3", "participant", "Who was that?", 5.0, 6.0),
        *said("r2", "robot", "Me.", 6.9, 7.4),
        UtteranceChanged(at(2.6), "noise", "participant", "", "heard", "started"),
        UtteranceChanged(at(3.4), "noise", "participant", "", "heard", "failed", detail="no words"),
        UtteranceCorrected(at(4.0), "p1", text=f"I am {NAME}.", tags=("greets",), actor="wizard"),
        UtteranceCorrected(at(4.1), "p1", person_id="p-7", actor="console"),
        UtteranceCorrected(at(4.5), "p2", speaker="robot", actor="console"),
        UtteranceCorrected(at(8.0), "p3", speaker="", actor="wizard"),
    ]  # fmt: skip
    tell(study / "sessions" / "s", events, lasts_s=12)
    return study


@pytest.fixture(scope="module")
def session(study: Path) -> Path:
    return study / "sessions" / "s"


def test_utterances_are_as_corrected_with_what_was_made_out(session: Path) -> None:
    found = {item.utterance_id: item for item in spoken(open_session(session))}
    assert (found["p1"].text, found["p1"].heard_text, found["p1"].person_id, found["p1"].tags) == (
        f"I am {NAME}.", "I am quill feather.", "p-7", ("greets",),
    )  # fmt: skip
    assert [found[name].speaker for name in ("p1", "p2", "p3")] == ["participant", "robot", ""]


def test_noise_has_no_speaker(session: Path) -> None:
    noise = next(item for item in spoken(open_session(session)) if item.utterance_id == "noise")
    assert (noise.state, noise.said) == ("failed", False)


def test_a_speaker_who_was_no_participant_was_not_answered(session: Path) -> None:
    found = read_data(open_session(session)).responses
    assert [(one.turn_id, one.reply_id, round(one.gap_s, 3), one.person_id) for one in found] == [
        ("p1", "r1", 0.5, "p-7")
    ]


def test_tables_have_both(session: Path, tmp_path: Path) -> None:
    export_session(session, "csv", tmp_path / "csv")
    with (tmp_path / "csv" / "utterances.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["utterance_id"]: row for row in csv.DictReader(file)}
    assert (rows["p1"]["text"], rows["p1"]["heard_text"]) == (f"I am {NAME}.", "I am quill feather.")
    assert (rows["p2"]["speaker"], rows["p3"]["speaker"], rows["r1"]["heard_text"]) == ("robot", "", "")
    with (tmp_path / "csv" / "responses.csv").open(encoding="utf-8", newline="") as file:
        (row,) = csv.DictReader(file)
    assert (row["turn_id"], row["means"], float(row["gap_s"])) == ("p1", "typed", 0.5)
    assert (tmp_path / "csv" / "event_utterance_corrected.csv").is_file()


def test_tiers_have_both(session: Path, tmp_path: Path) -> None:
    for name in ("eaf", "textgrid"):
        export_session(session, name, tmp_path / name)
        (file,) = [path for path in (tmp_path / name).iterdir() if path.suffix.casefold() in (".eaf", ".textgrid")]
        text = file.read_text(encoding="utf-8")
        for told in (f"I am {NAME}.", "I am quill feather.", "Speech before correction", "Speech tags", "greets"):
            assert told in text, (name, told)


def test_captions_have_both(session: Path, tmp_path: Path) -> None:
    export_session(session, "vtt", tmp_path / "vtt")
    text = (tmp_path / "vtt" / "captions.vtt").read_text(encoding="utf-8")
    assert f"<v Participant>I am {NAME}." in text
    assert "NOTE p1 was corrected. Original transcript: I am quill feather." in text
    assert "<v Somebody>Who was that?" in text


def test_the_report_has_both(session: Path, tmp_path: Path) -> None:
    export_session(session, "html", tmp_path / "html")
    (page,) = (tmp_path / "html").glob("*.html")
    text = page.read_text(encoding="utf-8")
    assert f"I am {NAME}." in text
    assert "corrected from “I am quill feather.”" in text
    assert "median 0.50 s, quartiles 0.50 and 0.50 s, 100 % under 1 s, 0 of 1 overlapping" in text


def test_the_methods_sheet_reports_gaps(session: Path, tmp_path: Path) -> None:
    export_session(session, "methods", tmp_path / "methods")
    text = " ".join(path.read_text(encoding="utf-8") for path in (tmp_path / "methods").iterdir())
    assert "median 0.50 s, quartiles 0.50 and 0.50 s, 100 % under 1 s, 0 of 1 overlapping" in text
    assert "Median by means of speech: typed 0.50 s (n = 1)." in text


def test_search_finds_what_was_corrected(study: Path) -> None:
    index = StudyIndex.of_study(study)
    index.update()
    assert [hit.kind for hit in index.search(SessionQuery(text=NAME))] == ["participant"]
    assert list(index.search(SessionQuery(text="feather quill"))) == []
    index.close()


def test_a_name_that_came_in_by_a_correction_is_forgotten(study: Path, tmp_path: Path) -> None:
    """The name is erased from texts, and the person's speech is silenced, even if attributed only by the correction."""
    copy = Path(shutil.copytree(study, tmp_path / "study"))
    session = open_session(copy / "sessions" / "s")
    assert speech_in(session, frozenset({"p-7"}), PersonTracks({}, {}, [])).theirs == {"p1"}
    forget_person(ForgetRequest(copy, ("p-7",), names=(NAME,), otherwise="redact"), lambda: None)
    left = [path for path in (copy / "sessions").rglob("*") if path.is_file() and NAME.encode() in path.read_bytes()]
    assert left == []
    found = {item.utterance_id: item for item in spoken(open_session(copy / "sessions" / "s"))}
    assert found["p1"].text == "[forgotten]"
