"""Messages in the windows are in the wizard's language from the start."""

import dataclasses
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from PySide6.QtCore import QObject, QSettings
from PySide6.QtWidgets import QAbstractButton
from pytestqt.qtbot import QtBot

from caris_desktop.app import composition
from caris_desktop.app.console_command import ConsoleRun, default_arguments
from caris_desktop.app.demo_robot import DemoRobot
from caris_desktop.app.replay_command import ReplayRun
from caris_desktop.app.user_settings import VERSION
from caris_desktop.domain.actor import WIZARD
from caris_desktop.domain.events import Problem
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import use_translator
from caris_desktop.live.console import Adapters
from caris_desktop.scenario.scenario_file import parse_scenario
from caris_desktop.ui.window_appearance import ENGLISH, LANGUAGE_KEY, TRIAL, Language, in_trial_language
from tests.app.test_replay_command import _arguments
from tests.support.recorded_session import make_session
from tests.support.trial_language_check import StudyTexts, is_unmarked

CAMERAS = """version: 1
title: A
layout: {panel: video}
cameras:
  - {source: "ftp://there"}
  - {source: "0", name: desk, place: nowhere, mount: {width_px: 1280, height_px: 720, horizontal_fov_deg: 70, x_m: 0.2}}
"""
BROKEN = "version: 1\ntitle: A\nlayout: {panel: nothing}\n"
OF_THE_TEST = StudyTexts("ftp", "there", "desk", "nowhere", "panel", "nothing", "layout", "nobody", "Tour guide")


@pytest.fixture(autouse=True)
def english_again() -> Iterator[None]:
    yield
    Language().use(ENGLISH)


@pytest.fixture
def settings(tmp_path: Path) -> QSettings:
    settings = QSettings(str(tmp_path / "settings.ini"), QSettings.Format.IniFormat)
    settings.setValue("version", VERSION)
    settings.setValue(LANGUAGE_KEY, TRIAL)
    return settings


def plain(told: Problem | UserFacingError) -> list[str]:
    return [text for text in (told.what, told.meaning, told.advice) if is_unmarked(text, OF_THE_TEST)]


@pytest.fixture
def parts(tmp_path: Path) -> Adapters:
    (tmp_path / "broken.yaml").write_text(BROKEN, "utf-8")
    study = composition.open_study(tmp_path / "study")
    study.people_database.write_bytes(b"no database at all")
    use_translator(in_trial_language)
    return composition.parts(study=study)


@pytest.mark.logs("people database")
@pytest.mark.parametrize(
    "fails",
    [
        lambda parts, folder: parts.scenario.load(folder / "broken.yaml"),
        lambda parts, folder: parts.scenario.save_text(BROKEN, folder / "new.yaml", None, ""),
        lambda parts, _folder: parts.robots.connect_to("nobody"),
        lambda parts, _folder: parts.practice.robot(WIZARD),
    ],
    ids=["scenario not opened", "scenario not saved", "robot not known", "nothing to practise on"],
)
def test_failed_commands_are_reported_in_the_language(
    parts: Adapters, tmp_path: Path, fails: Callable[[Adapters, Path], object]
) -> None:
    with pytest.raises(UserFacingError) as told:
        fails(parts, tmp_path)
    assert plain(told.value) == []


@pytest.mark.logs("people database")
def test_cameras_that_cannot_be_used_and_people_that_cannot_be_read(parts: Adapters) -> None:
    failures = parts.cameras(parse_scenario(CAMERAS, path=Path("cameras.yaml"))).failures
    assert [plain(failure) for failure in failures] == [[], []]
    _presence, problems = parts.people.open_presence()
    (problem,) = problems
    assert isinstance(problem, Problem) and plain(problem) == []


class ProblemRecorder(QObject):
    """Console double that records problems."""

    def __init__(self) -> None:
        super().__init__()
        self.problems: list[Problem] = []

    def problem(self, severity: str, what: str, meaning: str, advice: str, *, until: str = "") -> None:
        self.problems.append(Problem(0, severity, what, meaning, advice, until=until))  # type: ignore[arg-type]


def test_a_simulated_robot_that_does_not_start(qtbot: QtBot) -> None:
    use_translator(in_trial_language)
    console = ProblemRecorder()
    robot = DemoRobot(console)  # type: ignore[arg-type]
    robot._on_failed(in_trial_language("it ended with exit code 3"))
    qtbot.waitUntil(lambda: bool(console.problems))
    assert plain(console.problems[0]) == []


@pytest.fixture
def run(qtbot: QtBot, tmp_path: Path, settings: QSettings) -> Iterator[Callable[[], ConsoleRun]]:
    runs: list[ConsoleRun] = []

    def start(**arguments: object) -> ConsoleRun:
        run = ConsoleRun(default_arguments(study=tmp_path / "study", **arguments), settings=settings)
        runs.append(run)
        qtbot.addWidget(run.window)
        return run

    yield start
    for each in runs:
        each.close()


def problems_of(run: ConsoleRun) -> list[Problem]:
    told: list[Problem] = []
    run.console.state.event_happened.connect(lambda event: told.append(event) if isinstance(event, Problem) else None)
    return told


@pytest.mark.logs("live.bus: ")
def test_a_scenario_of_last_time_that_was_broken_meanwhile(
    run: Callable[[], ConsoleRun], settings: QSettings, tmp_path: Path, qtbot: QtBot
) -> None:
    (tmp_path / "broken.yaml").write_text(BROKEN, "utf-8")
    settings.setValue("scenario/last", str(tmp_path / "broken.yaml"))
    console = run()
    told = problems_of(console)
    console.report_scenario()
    qtbot.waitUntil(lambda: bool(told))
    assert "broken.yaml" in told[0].meaning
    assert plain(told[0]) == []


@pytest.mark.logs(r"app\.user_settings: |live\.bus: ")
def test_settings_that_could_not_be_read(
    run: Callable[..., ConsoleRun], settings: QSettings, tmp_path: Path, qtbot: QtBot
) -> None:
    settings.setValue("version", VERSION + 1)
    console = run(language=TRIAL)
    told = problems_of(console)
    console.report_settings()
    qtbot.waitUntil(lambda: bool(told))
    assert plain(dataclasses.replace(told[0], advice=told[0].advice.replace(str(tmp_path), ""))) == []


def test_a_replay(settings: QSettings, tmp_path: Path, qtbot: QtBot) -> None:
    made = make_session(tmp_path / "sessions" / "one")
    replay = ReplayRun(_arguments(made.folder), settings=settings)
    qtbot.addWidget(replay.window)
    try:
        stop = replay.window.findChild(QAbstractButton, "emergency_stop")
        assert stop is not None and not is_unmarked(stop.text() or stop.toolTip(), OF_THE_TEST)
        assert not is_unmarked(stop.toolTip(), OF_THE_TEST)
    finally:
        replay.close()
