"""Offer of an unfinished trial: once, for the same study, and only after a crash."""

import json
import os
from pathlib import Path

import psutil
import pytest

from caris_desktop.study.unfinished_trial import UnfinishedTrial, forget, save_unfinished, take_newest
from tests.support.crashed_trial import assign_to_ended_process


@pytest.fixture
def study(tmp_path: Path) -> Path:
    (tmp_path / "study" / "sessions" / "one").mkdir(parents=True)
    return tmp_path / "study"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "trials"


def _trial(study: Path) -> UnfinishedTrial:
    return UnfinishedTrial(study / "sessions" / "one", "tour.yaml", "pepper", ("p-1", "p-2"), "p-2", "ask")


def test_a_crashed_trial_is_reported_once(folder: Path, study: Path) -> None:
    save_unfinished(folder, _trial(study))
    assign_to_ended_process(folder)
    assert take_newest(folder, study) == _trial(study)
    assert take_newest(folder, study) is None


def test_a_program_that_still_runs_keeps_its_own(folder: Path, study: Path) -> None:
    save_unfinished(folder, _trial(study))
    assert take_newest(folder, study) is None
    assert list(folder.iterdir())


def test_another_program_with_the_same_number_is_not_taken_for_it(folder: Path, study: Path) -> None:
    save_unfinished(folder, _trial(study))
    path = folder / f"{os.getpid()}.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"began": psutil.Process().create_time() - 100}))
    assert take_newest(folder, study) == _trial(study)


def test_nothing_is_left_of_an_end_in_order(folder: Path, study: Path) -> None:
    save_unfinished(folder, _trial(study))
    forget(folder)
    forget(folder)
    assert list(folder.iterdir()) == [] and take_newest(folder, study) is None


def test_a_power_cut_is_an_end_that_nobody_wanted(folder: Path, study: Path) -> None:
    """The computer was restarted since, and all PIDs belong to other programs."""
    save_unfinished(folder, _trial(study))
    path = folder / f"{os.getpid()}.json"
    data = json.loads(path.read_text()) | {"began": psutil.boot_time() - 3600, "boot": "of an older program"}
    path.write_text(json.dumps(data))
    assert take_newest(folder, study) == _trial(study)
    assert list(folder.iterdir()) == []


def test_another_study_is_not_asked_about_it(folder: Path, study: Path, tmp_path: Path) -> None:
    save_unfinished(folder, _trial(study))
    assign_to_ended_process(folder)
    assert take_newest(folder, tmp_path / "another") is None
    assert take_newest(folder, study) == _trial(study)


@pytest.mark.parametrize("text", ["", "[]", "{", '{"session": 3}', '{"session": "/", "people": 5}'])
def test_a_broken_file_goes(folder: Path, study: Path, text: str, caplog: pytest.LogCaptureFixture) -> None:
    folder.mkdir()
    (folder / "77.json").write_text(text)
    with caplog.at_level("ERROR"):
        assert take_newest(folder, study) is None
    assert list(folder.iterdir()) == []
    caplog.clear()


def test_a_trial_of_an_older_program_has_no_step(folder: Path, study: Path) -> None:
    save_unfinished(folder, _trial(study))
    assign_to_ended_process(folder)
    (path,) = folder.iterdir()
    data = json.loads(path.read_text())
    del data["step"]
    path.write_text(json.dumps(data))
    found = take_newest(folder, study)
    assert found is not None and found.step == "" and found.attended == "p-2"
