"""Exploration of the simulated robot from the GUI thread: exploring, checking, saving, and error messages."""

import threading
from collections.abc import Iterator
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.background_worker import AsyncioThread
from caris_desktop.live.robot_explorer import LiveRobotExplorer
from caris_desktop.robot.discovery import Exploration, StreamCheck
from caris_desktop.robot.profile import ListedProfile, load_profile, user_robots_dir
from caris_desktop.robot.profile_model import RobotProfile, SecuritySettings
from caris_desktop.robot.profile_proposal import profile_of
from tests.support.simulated_robot import SimulatedRobot


@pytest.fixture
def explorer(qtbot: QtBot) -> Iterator[LiveRobotExplorer]:
    asyncio_thread = AsyncioThread()
    yield LiveRobotExplorer(asyncio_thread)
    asyncio_thread.stop()


class Answers:
    """Records results with their thread."""

    def __init__(self) -> None:
        self.steps: list[Any] = []
        self.results: list[Any] = []
        self.threads: set[int] = set()

    def progress(self, step: Any) -> None:
        self.threads.add(threading.get_ident())
        self.steps.append(step)

    def done(self, result: Any) -> None:
        self.threads.add(threading.get_ident())
        self.results.append(result)


@pytest.mark.long
def test_a_robot_is_looked_at_listened_to_and_saved(qtbot: QtBot, explorer: LiveRobotExplorer) -> None:
    with SimulatedRobot() as robot:
        answers = Answers()
        explorer.explore(robot.address, security=SecuritySettings(), progress=answers.progress, done=answers.done)
        qtbot.waitUntil(lambda: bool(answers.results), timeout=15_000)
        found = answers.results[0]
        assert isinstance(found, Exploration), found
        assert answers.steps[0] == "Connecting"
        assert answers.threads == {threading.get_ident()}, "panels are touched in the GUI thread alone"
        profile = profile_of(found.offer, found.proposal.chosen, name="x", title="X", address=robot.address)
        checks = Answers()
        explorer.check(profile, progress=checks.progress, done=checks.done)
        qtbot.waitUntil(lambda: bool(checks.results), timeout=20_000)
    states = {check.field: check.state for check in checks.steps if isinstance(check, StreamCheck)}
    assert states["scan"] == "good"
    assert states["odometry"] == "good"
    saved = save(qtbot, explorer, profile, "Lab robot")
    assert isinstance(saved, ListedProfile)
    assert (saved.name, saved.title) == ("lab-robot", "Lab robot")
    assert load_profile("lab-robot").scan == profile.scan
    again = save(qtbot, explorer, profile, "Lab robot")
    assert isinstance(again, UserFacingError)
    assert "already" in again.what
    assert [path.name for path in user_robots_dir().glob("*.yaml")] == ["lab-robot.yaml"]


def save(qtbot: QtBot, explorer: LiveRobotExplorer, profile: RobotProfile, title: str) -> Any:
    answers = Answers()
    explorer.save(profile, title, done=answers.done)
    qtbot.waitUntil(lambda: bool(answers.results), timeout=10_000)
    return answers.results[0]


def test_nobody_there_is_reported_in_words(qtbot: QtBot, explorer: LiveRobotExplorer) -> None:
    answers = Answers()
    explorer.explore("ws://127.0.0.1:9", security=SecuritySettings(), progress=answers.progress, done=answers.done)
    qtbot.waitUntil(lambda: bool(answers.results), timeout=15_000)
    failure = answers.results[0]
    assert isinstance(failure, UserFacingError)
    assert failure.what
    assert failure.advice


def test_a_cancelled_exploration_reports_nothing_more(qtbot: QtBot, explorer: LiveRobotExplorer) -> None:
    dropped, answers = Answers(), Answers()
    explorer.explore("ws://127.0.0.1:9", security=SecuritySettings(), progress=dropped.progress, done=dropped.done)
    explorer.cancel()
    explorer.save(load_profile("simulated"), "Another", done=answers.done)
    qtbot.waitUntil(lambda: bool(answers.results), timeout=10_000)
    assert dropped.results == []
