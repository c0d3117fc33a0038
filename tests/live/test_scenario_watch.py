"""Watch on a scenario file: one report per complete change, for each way of writing."""

import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.services import scenario_service
from caris_desktop.live.services.scenario_service import ScenarioWatch


class AtOnce:
    """Executes background work immediately."""

    def do(self, work: Callable[[], Any], done: Callable[[Any], None], _failed: object) -> None:
        done(work())


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "mine.yaml"
    path.write_text("title: First")
    return path


def sum_of(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture
def told() -> list[Path]:
    return []


@pytest.fixture
def watch(qapp: QApplication, file: Path, told: list[Path]) -> ScenarioWatch:
    watch = ScenarioWatch(AtOnce(), told.append)  # type: ignore[arg-type]
    watch.use(file, sum_of(file))
    return watch


def test_a_file_written_in_pieces_is_reported_when_complete(watch: ScenarioWatch, file: Path, told: list[Path]) -> None:
    for piece in ("title: Sec", "title: Second", "title: Second\nlay"):
        file.write_text(piece)
        watch.check_contents()
        assert told == [], "it was not like that a moment ago"
    watch.check_contents()
    assert told == [file]
    watch.check_contents()
    watch.check_contents()
    assert told == [file], "once"


def test_a_file_that_the_program_wrote_is_no_change(watch: ScenarioWatch, file: Path, told: list[Path]) -> None:
    file.write_text("title: Saved")
    watch.check_contents()
    watch.use(file, sum_of(file))
    watch.check_contents()
    watch.check_contents()
    assert told == []
    file.write_text("title: First")
    watch.check_contents()
    watch.check_contents()
    assert told == [file], "as it was before is another content now"


def test_a_file_that_is_away_for_a_moment_is_waited_for(watch: ScenarioWatch, file: Path, told: list[Path]) -> None:
    file.unlink()
    watch.check_contents()
    watch.check_contents()
    assert told == []
    file.write_text("title: Again")
    watch.check_contents()
    watch.check_contents()
    assert told == [file]


@pytest.fixture
def slow_work(qapp: QApplication) -> Iterator[BackgroundWorker]:
    owner = QObject()
    slow_work = BackgroundWorker(owner)
    yield slow_work
    slow_work.finish(lambda _what, work: work())


def test_an_editor_that_puts_another_file_in_its_place_is_noticed_each_time(
    qtbot: QtBot, slow_work: BackgroundWorker, file: Path, told: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scenario_service, "FILE_AT_REST_MS", 20)
    monkeypatch.setattr(scenario_service, "WATCH_EVERY_MS", 20)
    watch = ScenarioWatch(slow_work, told.append)
    watch.use(file, sum_of(file))
    watch.start()
    for number in (1, 2):
        new = file.with_suffix(".new")
        new.write_text(f"title: Version {number}")
        new.replace(file)
        qtbot.waitUntil(lambda: len(told) == number, timeout=20_000)  # noqa: B023
    file.write_text("title: Written in place")
    qtbot.waitUntil(lambda: len(told) == 3, timeout=20_000)
    watch.stop()
