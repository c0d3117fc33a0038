"""Announcements to screen readers, as accessibility notifications."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from PySide6.QtCore import QEvent, QObject
from PySide6.QtGui import QAccessible, QAccessibleInterface
from PySide6.QtWidgets import QApplication, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.actor import OTHER_WIZARD, WIZARD
from caris_desktop.domain.events import (
    ANSWER,
    EmergencyStopChanged,
    GoalChanged,
    Marked,
    PersonRenamed,
    PhotoTaken,
    PlacesChanged,
    Problem,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.live.status import Alarm, DriveStatus, RecordingStatus
from caris_desktop.ui.accessibility import KEPT_MS, Announcement
from caris_desktop.ui.main_window import MainWindow
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

pytestmark = [pytest.mark.panels("video"), pytest.mark.usefixtures("screen_reader")]

REFUSAL = Problem(0, "warning", "Ana drives now.", "Nothing was sent.", "Ask Ana.", cause=ANSWER)
ALARM = Alarm("camera", "camera", "error", "No picture.", "The camera is silent.", "Drive with care.", 5)


@pytest.fixture
def window(window: MainWindow) -> MainWindow:
    """Remove the announcements of the window's start."""
    for one in window.findChildren(Announcement):
        one.deleteLater()
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete.value)
    return window


def announced(window: QWidget) -> list[str]:
    root = QAccessible.queryAccessibleInterface(window)
    assert root is not None
    QApplication.processEvents()
    return [
        one.text(QAccessible.Text.Name)
        for one in _shown(root)
        if one.role() == QAccessible.Role.Notification and not one.state().invisible
    ]


def _shown(node: QAccessibleInterface) -> Iterator[QAccessibleInterface]:
    for number in range(node.childCount()):
        child = node.child(number)
        if child is not None:
            yield child


class Heard(QObject):
    """Records each announcement."""

    def __init__(self, app: QApplication) -> None:
        super().__init__()
        self.said: list[str] = []
        app.installEventFilter(self)

    def eventFilter(self, watched: object, event: QEvent) -> bool:
        if event.type() == QEvent.Type.Show and isinstance(watched, Announcement):
            self.said.append(watched.accessibleName())
        return False


def test_a_refusal_is_announced_each_time(window: MainWindow, console: FakeConsole, qapp: QApplication) -> None:
    listener = Heard(qapp)
    whole = "Problem: Ana drives now. Nothing was sent. Ask Ana."
    console.state.add(REFUSAL)
    assert announced(window) == listener.said == [whole]
    console.state.add(REFUSAL)
    assert (
        listener.said[0] == whole
        and len(listener.said) == 2
        and listener.said[1].startswith("Problem: Ana drives now.")
    )


def test_an_alarm_is_announced_once_and_again_when_it_blocks(
    window: MainWindow, console: FakeConsole, qapp: QApplication
) -> None:
    listener = Heard(qapp)
    whole = "Serious problem: No picture. The camera is silent. Drive with care."
    console.state.alarms.set((ALARM,))
    assert listener.said == [whole]
    console.state.alarms.set((ALARM, Alarm("disk", "disk", "warning", "The disk is nearly full.", "", "", 7)))
    assert listener.said[1:] == ["Problem: The disk is nearly full."]
    console.state.alarms.set((replace(ALARM, asked_ns=9),))
    assert listener.said[2:] == [whole]


def test_the_emergency_stop_is_announced_and_its_release(window: MainWindow, console: FakeConsole) -> None:
    console.state.drive.set(DriveStatus(emergency_stop=True))
    assert announced(window) == ["Emergency stop active. No motion commands until you release it."]
    console.state.drive.set(DriveStatus(emergency_stop=True, movement="uncommanded"))
    moves = "Emergency stop active, but the robot is moving. Use the stop on the robot itself."
    assert announced(window)[-1] == moves
    console.state.drive.set(DriveStatus(emergency_stop=True, movement="uncommanded", stopped=True))
    assert announced(window).count(moves) == 1
    console.state.drive.set(DriveStatus(allowed=True))
    console.state.add(EmergencyStopChanged(clock.now_ns(), latched=False, by="wizard", actor=WIZARD))
    assert announced(window)[-1] == "Emergency stop released"


def test_a_question_is_announced(window: MainWindow) -> None:
    band = window._question
    band.ask("Close the window?", "Close", lambda: None)
    band.ask("Leave the robot?", "Leave", lambda: None)
    assert announced(window) == ["Close the window?", "Leave the robot?"]


def test_goals_are_announced_and_actions_of_another_wizard(window: MainWindow, console: FakeConsole) -> None:
    at, here = clock.now_ns(), Pose2D(1.0, 2.0, 0.0)
    console.state.add(GoalChanged(at, "g1", "reached", here, "Kitchen", actor=WIZARD))
    console.state.add(PlacesChanged(at, "Door", here, actor=WIZARD))
    assert announced(window) == ["Arrived at Kitchen"], "a place that this wizard saves is no news"
    console.state.add(PhotoTaken(at, "front", 1, "photos/0001.png", actor=WIZARD))
    console.state.add(Marked(at, "Slip", actor=WIZARD))
    console.state.add(PlacesChanged(at, "Door", here, actor=f"{OTHER_WIZARD}Ana"))
    assert announced(window)[1:3] == ["Photo taken (0001.png)", "Marked: Slip"]
    assert announced(window)[3:] == ["Place Door saved · by wizard Ana"]


def test_the_start_the_pauses_and_the_end_of_a_recording_are_announced(
    console: FakeConsole, qapp: QApplication, window: MainWindow, qtbot: QtBot
) -> None:
    recording = console.state.recording
    recording.set(RecordingStatus("idle"))
    qtbot.waitUntil(lambda: bool(announced(window)))
    listener = Heard(qapp)
    for state in ("starting", "recording", "paused", "recording", "stopping", "idle"):
        recording.set(RecordingStatus(state, Path("/study/sessions/S7")))
    wanted = ["Recording started (S7)", "Recording paused", "Recording resumed", "Recording ended (S7)"]
    qtbot.waitUntil(lambda: listener.said == wanted)


def test_a_name_is_announced_as_it_was_given(window: MainWindow, console: FakeConsole) -> None:
    person = console.state.persons.value[0]
    console.state.add(PersonRenamed(clock.now_ns(), person.person_id, actor=WIZARD))
    console.state.persons.set((replace(person, name="Mara"), *console.state.persons.value[1:]))
    assert announced(window) == ["Named Mara"]


def test_an_announcement_goes_and_shows_nothing(window: MainWindow, console: FakeConsole, qtbot: QtBot) -> None:
    console.state.add(REFUSAL)
    one = find(window, "announcement")
    assert isinstance(one, Announcement) and (one.width(), one.height()) == (1, 1)
    assert one._goes.interval() == KEPT_MS and one._goes.isActive()
    one._goes.timeout.emit()
    qtbot.waitUntil(lambda: announced(window) == [])


def test_nothing_comes_up_without_a_screen_reader(window: MainWindow, console: FakeConsole) -> None:
    QAccessible.setActive(False)
    console.state.add(REFUSAL)
    console.state.drive.set(DriveStatus(emergency_stop=True))
    assert window.findChildren(Announcement) == []
