"""Closed session that was damaged later: every report states the same number of missing values."""

import json
import re
import shutil
from pathlib import Path

import pytest

from caris_desktop.app.export_command import _verify
from caris_desktop.recording.measures.session_measures import measure, read_facts
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import ExportRequest, export_all
from caris_desktop.recording.studies.data_quality import data_quality_problems
from caris_desktop.recording.studies.study_index import StudyIndex
from tests.recording.methods_sheets import sheet_of
from tests.support.recorded_session import RecordedSession

_TOLD = re.compile(r"(\d+) of the (\d+) recorded values are missing from events\.mcap")


@pytest.fixture(scope="module")
def damaged(whole_session: RecordedSession, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A chunk and its message index are overwritten, the index at the end is intact."""
    folder = tmp_path_factory.mktemp("study") / "sessions" / "s"
    shutil.copytree(whole_session.folder, folder)
    path = folder / "events.mcap"
    index = events_file.read_index(path)
    content = bytearray(path.read_bytes())
    content[int(index.offsets[5]) + 60 : int(index.offsets[6]) + 60] = b"\xff" * int(
        index.offsets[6] - index.offsets[5]
    )
    path.write_bytes(content)
    return folder


def _told(sentences: list[str]) -> list[tuple[str, ...]]:
    return [match.groups() for sentence in sentences if (match := _TOLD.search(str(sentence)))]


@pytest.mark.logs(r"session\.(session_reader|events_file): ", "export")
def test_missing_data_is_reported_alike_wherever_a_session_is_read(damaged: Path, tmp_path: Path) -> None:
    recorded = sum(json.loads((damaged / "session.json").read_text("utf-8"))["counts"].values())
    session = open_session(damaged)
    gone = recorded - sum(1 for _ in session.values())
    assert gone > 0
    expected = [(str(gone), str(recorded))]
    assert _told(list(session.losses)) == expected
    facts = read_facts(session)
    measures = measure(facts)
    assert _told(list(data_quality_problems(facts, measures))) == expected  # report
    assert measures["missing_values"] == gone  # statistics and its tables
    answers = list(sheet_of([session]).answers.values())
    assert _told(answers) == expected
    assert "No missing data was recorded" not in " ".join(answers)
    index = StudyIndex(damaged.parent, tmp_path / "index.sqlite")
    index.update()
    (entry,) = index.sessions()
    index.close()
    assert _told(list(entry.losses)) == expected  # list of sessions and command
    assert _told(_verify([damaged])) == expected
    told = export_all(ExportRequest((damaged,), ("csv",), tmp_path / "out"))
    assert _told([*told.notices, *told.problems]) == expected
