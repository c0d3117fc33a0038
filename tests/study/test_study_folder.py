"""Study folder on a real file system."""

from datetime import datetime
from pathlib import Path

import platformdirs
import pytest
from hypothesis import given
from hypothesis import strategies as st

from caris_desktop.domain.events import TrialDetails
from caris_desktop.study.study_folder import (
    StudyFolder,
    StudyFolderError,
    default_study_path,
    file_name_part,
    following,
    load_last_details,
    new_session_folder,
    open_study_folder,
    save_last_details,
)

NOW = datetime(2026, 11, 21, 10, 14, 2).astimezone()


def test_sessions_get_folders_of_their_own(tmp_path: Path) -> None:
    study = open_study_folder(tmp_path / "new" / "study")
    first = new_session_folder(study, TrialDetails(participant="P07"), now=NOW)
    second = new_session_folder(study, TrialDetails(participant="P07"), now=NOW)
    nobody = new_session_folder(study, TrialDetails(), now=NOW)
    assert first == tmp_path / "new" / "study" / "sessions" / "2026-11-21_10-14-02_P07"
    assert second.name == "2026-11-21_10-14-02_P07-2"
    assert nobody.name == "2026-11-21_10-14-02"
    assert all(folder.is_dir() and not any(folder.iterdir()) for folder in (first, second, nobody))
    assert study.people_database.parent == study.path


@given(st.text(max_size=80))
def test_no_participant_name_leaves_the_folder(text: str) -> None:
    part = file_name_part(text)
    assert len(part) <= 40
    assert set(part) <= set("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_")


@pytest.mark.parametrize(
    ("text", "part"),
    [("../../etc", "etc"), ("José Núñez", "Jose-Nunez"), ("P 07/b", "P-07-b"), ("山田", ""), ("..", "")],
)
def test_names_stay_readable(text: str, part: str) -> None:
    assert file_name_part(text) == part


def test_a_folder_that_cannot_be_used_is_reported_in_three_sentences(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StudyFolderError) as caught:
        open_study_folder(tmp_path / "file" / "study")
    assert "cannot be used: Not a directory" in caught.value.what
    assert "Driving and speaking still work" in caught.value.meaning
    assert "Choose a writable folder" in caught.value.advice


def test_a_nearly_full_disk_starts_no_session(tmp_path: Path) -> None:
    study = open_study_folder(tmp_path)
    with pytest.raises(StudyFolderError, match=r"Only .* MB are free"):
        new_session_folder(study, TrialDetails(), min_free_bytes=1 << 60)
    assert not any(study.sessions.iterdir())


def test_the_last_answers_are_remembered(tmp_path: Path) -> None:
    study = open_study_folder(tmp_path)
    assert load_last_details(study) == TrialDetails()
    details = TrialDetails("Lab tour", "Ünal", "B", "2", "Ana")
    save_last_details(study, details)
    assert load_last_details(study) == details


@pytest.mark.logs(r"last-trial\.json is ignored")
@pytest.mark.parametrize("content", ["", "[1]", '{"participant": 7, "other": "x"}', "\x00"])
def test_a_damaged_memory_is_no_obstacle(tmp_path: Path, content: str) -> None:
    study = open_study_folder(tmp_path)
    study.last_details.write_text(content)
    assert load_last_details(study) == TrialDetails()


def test_the_default_is_under_the_documents_where_there_are_any(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(platformdirs, "user_documents_dir", lambda: str(tmp_path))
    assert default_study_path() == tmp_path / "CARIS Desktop" / "default study"
    monkeypatch.setattr(platformdirs, "user_documents_dir", lambda: str(tmp_path / "none"))
    monkeypatch.setattr(platformdirs, "user_data_dir", lambda *_args, **_kwargs: str(tmp_path / "data"))
    assert default_study_path() == tmp_path / "data" / "CARIS Desktop" / "default study"
    assert isinstance(StudyFolder(default_study_path()).sessions, Path)


def test_the_next_trial_is_suggested_one_further() -> None:
    assert following(TrialDetails(participant="P1", trial="3")) == TrialDetails(participant="P1", trial="4")
    assert following(TrialDetails(trial="2 of 4")).trial == "2 of 4"
