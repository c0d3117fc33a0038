"""Sessions of a study: errors are reported, and the window never waits for the disk."""

import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.domain.translation import tr
from caris_desktop.live.session_library import LiveSessionLibrary
from caris_desktop.recording import session_export
from caris_desktop.recording.studies.study_index import StudyIndex
from caris_desktop.recording.studies.study_query import SessionQuery
from tests.live import bodies

Told = list[tuple[str, str, str, str]]
Library = Callable[..., LiveSessionLibrary]


@pytest.fixture
def told() -> Told:
    return []


@pytest.fixture
def make_library(tmp_path: Path, told: Told, qtbot: QtBot) -> Iterator[Library]:
    made: list[LiveSessionLibrary] = []

    def make(**given: Any) -> LiveSessionLibrary:
        made.append(LiveSessionLibrary(tmp_path, lambda *words: told.append(words), **given))
        return made[-1]

    yield make
    for library in made:
        library.shutdown()


@pytest.mark.logs("the replay of .* ended with 1")
def test_a_replay_that_does_not_open_reports_why(make_library: Library, told: Told, qtbot: QtBot) -> None:
    script = "import sys; print('Qt says something'); sys.exit(f'{sys.argv[2]} is damaged {sys.argv[3]}')"
    library = make_library(program=(sys.executable, "-c", script))
    library.open_replay(Path("/study/one"))
    qtbot.waitUntil(lambda: bool(told), timeout=10_000)
    why = "/study/one is damaged --told-in-window"
    assert [told[0][0], told[0][1], told[0][2]] == ["error", "The replay of one ended unexpectedly.", why]
    assert not library._replay_watch.isActive()


def test_a_replay_that_is_closed_is_no_news(make_library: Library, told: Told, qtbot: QtBot) -> None:
    script = "import sys; print('a warning', file=sys.stderr)"
    library = make_library(program=(sys.executable, "-c", script))
    library.open_replay(Path("/study/one"), at_ns=5)
    qtbot.waitUntil(library._replay_watch.isActive, timeout=10_000)
    qtbot.waitUntil(lambda: not library._replay_watch.isActive(), timeout=10_000)
    assert told == []


def test_a_cancelled_export_is_ended_behind_the_window(
    make_library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, qtbot: QtBot
) -> None:
    may_remove, removed_in = threading.Event(), list[str]()

    def remove(out: Path) -> None:
        assert may_remove.wait(10.0)
        removed_in.append(threading.current_thread().name)
        shutil.rmtree(out)

    out = tmp_path / "out"
    out.mkdir()
    monkeypatch.setattr(session_export, "run_exports", bodies.deaf_to)
    monkeypatch.setattr(session_export, "remove_partial_exports", remove)
    library = make_library()
    library.start_export([tmp_path / "one"], ["csv"], out)
    exporter = library._exporter
    assert exporter is not None
    library.cancel_export()
    assert library.export.value.state == "cancelled"
    assert out.is_dir(), "nothing was waited for"
    may_remove.set()
    library.shutdown()
    assert not out.exists() and removed_in == ["slow-work"]


def test_a_cancelled_export_reports_nothing_of_the_next(
    make_library: Library, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, qtbot: QtBot
) -> None:
    monkeypatch.setattr(session_export, "run_exports", bodies.deaf_to)
    library = make_library()
    library.start_export([tmp_path / "one"], ["csv"], tmp_path / "out")
    first = library._exporter
    library.cancel_export()
    library.start_export([tmp_path / "one"], ["csv"], tmp_path / "out")
    library._exporter_spoke.emit(first, session_export.ExportFinished((tmp_path,), ()))
    qtbot.wait(10)
    assert library.export.value.state == "running"


def test_a_folder_for_an_export_is_one_that_is_not_there_yet(
    make_library: Library, tmp_path: Path, qtbot: QtBot
) -> None:
    library, found = make_library(), list[Path]()
    one = [tmp_path / "sessions" / "one"]
    (tmp_path / "exports" / "one").mkdir(parents=True)
    (tmp_path / "empty").mkdir()
    (tmp_path / "full" / "one").mkdir(parents=True)
    library.choose_export_folder(one, found.append)
    assert found == [], "the disk is not waited for"
    library.choose_export_folder(one, found.append, chosen=tmp_path / "empty")
    library.choose_export_folder(one, found.append, chosen=tmp_path / "full")
    library.choose_export_folder(one, found.append, chosen=tmp_path / "nowhere")
    qtbot.waitUntil(lambda: len(found) == 4, timeout=10_000)
    assert found == [
        tmp_path / "exports" / "one-2",
        tmp_path / "empty",
        tmp_path / "full" / "one-2",
        tmp_path / "nowhere",
    ]


@pytest.mark.logs("the replay of /study/one")
def test_a_program_that_cannot_be_begun_is_reported(make_library: Library, told: Told, qtbot: QtBot) -> None:
    make_library(program=("/nowhere/caris-desktop",)).open_replay(Path("/study/one"))
    assert told == [], "the disk is not waited for"
    qtbot.waitUntil(lambda: bool(told), timeout=10_000)
    assert told[0][:2] == ("error", "The replay did not open (No such file or directory).")


@pytest.mark.logs("looking for sessions in")
def test_an_index_that_cannot_be_opened_is_reported(
    make_library: Library, monkeypatch: pytest.MonkeyPatch, qtbot: QtBot, tmp_path: Path
) -> None:
    of_study = StudyIndex.of_study

    def refuse(_study: Path) -> StudyIndex:
        raise OSError("no index today")

    monkeypatch.setattr(StudyIndex, "of_study", refuse)
    library = make_library()
    library.find(SessionQuery())
    qtbot.waitUntil(lambda: "no index today" in library.found.value.detail, timeout=5_000)
    assert not library.found.value.updating
    monkeypatch.setattr(StudyIndex, "of_study", of_study)
    library.find(SessionQuery(wizard="W1"))
    qtbot.waitUntil(lambda: not library.found.value.updating, timeout=5_000)
    assert library.found.value.detail == ""


@pytest.mark.usefixtures("trial_language")
def test_exports_and_refusals_are_reported_in_the_wizards_language(
    make_library: Library, tmp_path: Path, qtbot: QtBot
) -> None:
    library, shown = make_library(), list[str]()
    library.export.changed.connect(lambda status: shown.append(status.what))
    library.start_export([tmp_path / "one"], ["csv", "eaf"], tmp_path / "out")
    assert shown == [tr("starting")] != ["starting"]
    qtbot.waitUntil(lambda: library.export.value.state == "failed", timeout=30_000)
    no_folder = "{folder} is not a folder. A session is a folder that contains session.json and events.mcap."
    why = tr(no_folder).format(folder=tmp_path / "one")
    assert library.export.value.detail == tr("{name}: {told}").format(name="one", told=why)
    assert tr("done") in shown
