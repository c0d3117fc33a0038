"""A new user drives within a minute and completes the practice by visible information alone."""

import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from PySide6.QtCore import QSettings
from PySide6.QtGui import QAccessible
from pytestqt.qtbot import QtBot

from caris_desktop.app.console_command import ConsoleRun, default_arguments
from tests.app.newcomer import Newcomer, drives_a_metre, practises

pytestmark = [pytest.mark.alone, pytest.mark.logs(r"live\\.", r"caris_desktop\\.")]


class Sitting:
    """A new user with the window of the demonstration."""

    def __init__(self, folder: Path) -> None:
        QAccessible.setActive(True)  # as for a screen reader: it reads the window
        settings = QSettings(str(folder / "settings.ini"), QSettings.Format.IniFormat)
        self.run = ConsoleRun(default_arguments(demo=True, study=folder / "study"), settings=settings)
        self._driven_m = 0.0
        self._at: tuple[float, float] | None = None
        self.run.console.state.odometry.changed.connect(self._on_odometry)
        self.run.window.resize(1366, 768)
        self.opened_s = time.monotonic()
        self.run.show()
        self.run.window.activateWindow()
        self.newcomer = Newcomer(self.run.window, patience_s=120.0)

    def driven_m(self) -> float:
        return self._driven_m

    def _on_odometry(self, odometry: object) -> None:
        pose = getattr(odometry, "pose_in_odom", None)
        if pose is not None:
            before, self._at = self._at, (pose.x_m, pose.y_m)
            self._driven_m += math.dist(before, self._at) if before is not None else 0.0


@pytest.fixture
def sitting(qtbot: QtBot, tmp_path: Path) -> Iterator[Callable[[], Sitting]]:
    begun: list[Sitting] = []

    def begin() -> Sitting:
        begun.append(Sitting(tmp_path))
        qtbot.addWidget(begun[-1].run.window)
        return begun[-1]

    yield begin
    for one in begun:
        one.run.close()


@pytest.mark.long
@pytest.mark.timeout(900)
def test_a_newcomer_drives_a_metre_and_finishes_the_practice(sitting: Callable[[], Sitting]) -> None:
    here = sitting()
    drives_a_metre(here.newcomer, here.driven_m)
    first_metre_s = time.monotonic() - here.opened_s
    print(f"first metre after {first_metre_s:.1f} s")
    steps = practises(here.newcomer, here.driven_m)
    status = here.run.console.state.practice.value
    assert (len(steps), status.done, status.state) == (10, 10, "ended"), here.newcomer.log
    print(f"practice: {status.minutes:.1f} min, {status.score} points")
