"""Change of an open scenario file: applied unless that is impossible."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QObject
from pytestqt.qtbot import QtBot

from caris_desktop.app import composition
from caris_desktop.domain import intents
from caris_desktop.domain.actor import CONSOLE
from caris_desktop.domain.events import Problem, ScenarioOpened
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.bus import Bus
from caris_desktop.live.services import scenario_service
from caris_desktop.live.services.scenario_service import ScenarioService
from caris_desktop.live.state import LiveState
from caris_desktop.scenario.scenario_file import load_scenario
from tests.support.service_context import context_of

TEXT = """\
version: 1
title: Mine
permissions:
  photos: true
layout:
  panel: video
"""


class Bench:
    """The service with a real file, and its reports."""

    def __init__(self, path: Path, parent: QObject) -> None:
        self.path = path
        self.state = LiveState()
        self.bus = Bus(self.state, parent)
        self.told: list[Any] = []
        self.bus.tap(lambda value, _raw: self.told.append(value))
        self.slow_work = BackgroundWorker(parent)
        parts = composition.parts(study=composition.open_study(path.parent / "study")).scenario
        self.applied: list[bool] = []
        self.service = ScenarioService(
            context_of(self.state, self.bus, parent, slow_work=self.slow_work), parts, load_scenario(path),
            apply=lambda scenario: self.applied.append(scenario.permissions.photos),
        )  # fmt: skip
        self.service.start()

    def events(self, kind: type[Any]) -> list[Any]:
        return [event for event in self.told if isinstance(event, kind)]


@pytest.fixture
def bench(qapp: QObject, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(scenario_service, "FILE_AT_REST_MS", 20)
    path = tmp_path / "mine.yaml"
    path.write_text(TEXT, encoding="utf-8")
    parent = QObject()
    bench = Bench(path, parent)
    yield bench
    bench.service.stop()
    bench.slow_work.finish(lambda _words, wait: wait())
    bench.state.close()


def test_a_changed_file_applies_and_is_recorded(bench: Bench, qtbot: QtBot) -> None:
    bench.path.write_text(TEXT.replace("photos: true", "photos: false"), encoding="utf-8")
    qtbot.waitUntil(lambda: bench.applied == [False], timeout=20_000)
    assert bench.service.current.permissions.photos is False
    bench.service.use_scenario(bench.service.current)  # as the console does for each service
    (opened,) = bench.events(ScenarioOpened)
    assert (opened.actor, opened.file_name) == (CONSOLE, "mine.yaml")
    assert opened.sha256 == hashlib.sha256(bench.path.read_bytes()).hexdigest()
    assert "photos: false" in opened.content


@pytest.mark.logs(r"live\.bus: ")
def test_an_error_is_reported_with_its_line_and_the_old_scenario_stays(bench: Bench, qtbot: QtBot) -> None:
    before = bench.service.current
    bench.path.write_text(TEXT.replace("photos: true", "photos: perhaps"), encoding="utf-8")
    qtbot.waitUntil(lambda: bool(bench.events(Problem)), timeout=20_000)
    (problem,) = bench.events(Problem)
    assert "mine.yaml, line 4: 'permissions.photos' must be true or false" in problem.meaning
    assert bench.service.current is before and bench.applied == []
    bench.path.write_text(TEXT.replace("Mine", "Corrected"), encoding="utf-8")
    qtbot.waitUntil(lambda: bench.service.current.title == "Corrected", timeout=20_000)


def test_a_file_that_the_console_saves_is_not_opened_again(bench: Bench, qtbot: QtBot) -> None:
    bench.service.handlers()[intents.SavePlace](intents.SavePlace("Here", Pose2D(1.0, 2.0, 0.0)))
    qtbot.waitUntil(lambda: len(bench.service.current.places) == 1, timeout=20_000)
    for _ in range(2):
        bench.service._watch.check_contents()
        done: list[None] = []
        bench.slow_work.do(lambda: None, done.append, pytest.fail)
        qtbot.waitUntil(lambda: done == [None], timeout=20_000)  # noqa: B023
    assert bench.applied == [] and bench.events(Problem) == []
