"""Display and requests of each panel."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from PySide6.QtCore import (
    QAbstractItemModel,
    QEvent,
    QIdentityProxyModel,
    QModelIndex,
    QObject,
    QPersistentModelIndex,
    QPoint,
    Qt,
)
from PySide6.QtGui import QColor
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QAbstractItemView, QApplication, QLabel, QLineEdit, QPlainTextEdit, QPushButton, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.conversation.spoken_text import spoken
from caris_desktop.domain import clock
from caris_desktop.domain.events import LinkChanged, Marked, PhotoTaken, TrialDetails, UtteranceChanged
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import FrameRef, OccupancyGrid, People, PersonBox, RobotPose
from caris_desktop.domain.translation import localized, tr
from caris_desktop.live.status import (
    AssistantStatus,
    DriveStatus,
    MicrophoneStatus,
    PerceptionStatus,
    RecordingStatus,
    SpeechStatus,
)
from caris_desktop.robot.profile_model import NavigationServer, RobotProfile, VelocityTopic
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.map.map_state import scan_points_in_map
from caris_desktop.ui.panel import PanelContext
from caris_desktop.ui.panels.map_panel import MapPanel
from caris_desktop.ui.panels.people_panel import PeoplePanel
from caris_desktop.ui.panels.session_panel import LOG_LEAST_LINES, LOG_LINE_PX, LOG_ROWS, SessionPanel
from caris_desktop.ui.panels.speak_panel import QueueList
from caris_desktop.ui.panels.video_panel import VideoPanel
from caris_desktop.ui.status_bar import StatusItem
from caris_desktop.ui.text_formatting import microphone_facts
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.frame_view import (
    BOXES_GONE_S,
    BOXES_SOLID_S,
    FrameView,
    box_strength,
    detections_fit,
    moved_since,
)
from caris_desktop.ui.widgets.pictures import PhotoThumbnail
from tests.ui import samples
from tests.ui.conftest import click, find, freshen
from tests.ui.fake_console import FakeConsole, FakeLibrary


def pixel(view: FrameView, x: float, y: float) -> QColor:
    """Colour at a position in the image, as shares of its size."""
    rect = view.picture_rect()
    return (
        view.grab()
        .toImage()
        .pixelColor(QPoint(round(rect.left() + x * rect.width()), round(rect.top() + y * rect.height())))
    )


class PaintCount(QObject):
    """Counts paint events of a widget."""

    def __init__(self, watched: QWidget) -> None:
        super().__init__(watched)
        QApplication.processEvents()
        self.count = 0
        watched.installEventFilter(self)

    def eventFilter(self, _watched: QObject, event: QEvent) -> bool:
        self.count += event.type() == QEvent.Type.Paint
        return False


def video(window: MainWindow) -> tuple[VideoPanel, FrameView]:
    panel = window.panels["video"]
    assert isinstance(panel, VideoPanel)
    return panel, panel.view


def show_flat(console: FakeConsole, color_bgr: tuple[int, int, int], *, age_s: float = 0.0) -> FrameRef:
    image = np.full((480, 640, 3), color_bgr, np.uint8)
    frame = console.frames.add(image, stamp_ns=clock.now_ns() - int(age_s * 1e9))
    console.state.add(frame)
    return frame


# Video


def test_the_newest_frame_is_painted(window: MainWindow, console: FakeConsole) -> None:
    _, view = video(window)
    show_flat(console, (200, 30, 10))
    assert pixel(view, 0.5, 0.3).getRgb()[:3] == (10, 30, 200)
    show_flat(console, (10, 160, 30))
    assert pixel(view, 0.5, 0.3).getRgb()[:3] == (30, 160, 10)


@pytest.mark.panels("video")
def test_a_stale_picture_is_dimmed_and_a_lost_one_is_gone(window: MainWindow, console: FakeConsole) -> None:
    panel, view = video(window)
    show_flat(console, (255, 255, 255), age_s=0.9)
    console.state.check_freshness()
    assert pixel(view, 0.5, 0.2).lightness() < 140
    assert panel.fact == ("delayed · 0.9 s old", "amber")
    show_flat(console, (255, 255, 255), age_s=3.0)
    console.state.check_freshness()
    assert view.frame is None
    assert pixel(view, 0.5, 0.2) == window.theme.color("video_ground")
    assert panel.fact[0].startswith("no picture for 3")


@pytest.mark.panels("video")
def test_a_lost_robot_is_not_waited_for_in_silence(window: MainWindow, console: FakeConsole) -> None:
    _, view = video(window)
    console.state.clear_robot_streams()
    waiting = view.grab().toImage()
    console.state.link.set(dataclasses.replace(console.state.link.value, state="lost"))
    assert view.out_of_reach
    assert view.grab().toImage() != waiting


@pytest.mark.panels("video", "map")
def test_a_lost_link_is_said_once_on_the_picture_and_nowhere_on_the_map(
    window: MainWindow, console: FakeConsole
) -> None:
    panel, view = video(window)
    console.state.clear_robot_streams()
    console.state.link.set(dataclasses.replace(console.state.link.value, state="lost"))
    console.state.drive.set(DriveStatus(False, "Not connected to the robot"))
    panel._refresh()
    chips = [text for text, _role in view.chips]
    assert "No link" in chips and not any("Driving is off" in text for text in chips)
    assert view.words_without_picture() == ("No picture", "The robot is out of reach. The console keeps trying.")
    map_panel = window.panels["map"]
    map_panel._refresh()  # type: ignore[attr-defined]
    assert map_panel.view.map_state.waiting == "No map"  # type: ignore[attr-defined]
    assert map_panel.fact[0] == ""


@pytest.mark.panels("video")
def test_only_a_late_picture_says_its_age(window: MainWindow, console: FakeConsole) -> None:
    panel, _ = video(window)
    show_flat(console, (9, 9, 9), age_s=0.041)
    panel._refresh()
    assert panel.fact == ("", "")
    console.state.check_freshness()
    show_flat(console, (9, 9, 9), age_s=0.9)
    console.state.check_freshness()
    panel._refresh()
    assert panel.fact == ("delayed · 0.9 s old", "amber")


def test_boxes_belong_to_about_the_frame_on_show() -> None:
    frame = FrameRef(1, None, "front", "r", 0, 100, 640, 480)
    people = People(1, "front", 1, 640, 480, (), 30.0)
    assert detections_fit(people, frame), "other cameras count frames too"
    assert not detections_fit(people, dataclasses.replace(frame, stamp_ns=1 + round(BOXES_GONE_S * 1e9)))
    assert not detections_fit(dataclasses.replace(people, camera="rear"), frame)
    assert not detections_fit(None, frame)


def frame_at(stamp_s: float) -> FrameRef:
    return FrameRef(round(stamp_s * 1e9), None, "front", "fake", 0, 100, 640, 480)


def people_at(stamp_s: float, left_px: float) -> People:
    box = PersonBox(7, "p7", left_px, 50.0, 100.0, 200.0, 0.9)
    return People(round(stamp_s * 1e9), "front", 100, 640, 480, (box,), 30.0)


def test_boxes_that_fall_behind_the_picture_fade() -> None:
    people = people_at(10.0, 200.0)
    assert box_strength(people, frame_at(10.0 + BOXES_SOLID_S)) == 1.0
    assert 0.0 < box_strength(people, frame_at(10.5)) < 1.0
    assert box_strength(people, frame_at(10.0 + BOXES_GONE_S)) == 0.0
    assert box_strength(people, frame_at(9.9)) == 1.0


def test_boxes_keep_up_with_a_turning_robot() -> None:
    before, now = people_at(10.0, 200.0), people_at(10.1, 230.0)
    assert moved_since(before, now, frame_at(10.2)) == pytest.approx({7: 30.0})
    assert moved_since(before, now, frame_at(12.0)) == pytest.approx({7: 75.0}), "not for ever"
    assert moved_since(people_at(10.0, 229.0), now, frame_at(10.2)) == {}, "trembling is no movement"
    assert moved_since(people_at(8.0, 200.0), now, frame_at(10.2)) == {}
    assert moved_since(None, now, frame_at(10.2)) == {}


@pytest.mark.panels("video")
def test_boxes_carry_names_and_are_solid_only_with_one(window: MainWindow, console: FakeConsole) -> None:
    _, view = video(window)
    frame = show_flat(console, (0, 0, 0))
    boxes = [(60.0, 100.0, 120.0, 300.0), (260.0, 100.0, 120.0, 300.0), (460.0, 100.0, 120.0, 300.0)]
    console.state.add(samples.people_for(frame.sequence, 640, 480, boxes))
    assert view.visible_detections() == [("Luis", True), ("Ana Torres", True), ("Person 3", False)]
    named, unnamed = window.theme.color("box_named"), window.theme.color("box_unnamed")
    image, rect = view.grab().toImage(), view.picture_rect()

    def edge(left_px: float) -> list[QColor]:
        x = round(rect.left() + left_px / 640 * rect.width())
        rows = range(round(rect.top() + 0.35 * rect.height()), round(rect.top() + 0.7 * rect.height()))
        columns = range(x - 2, x + 3)
        return [max((image.pixelColor(column, row) for column in columns), key=QColor.lightness) for row in rows]

    assert all(abs(color.green() - named.green()) < 30 for color in edge(60.0))
    dashes = [abs(color.blue() - unnamed.blue()) < 40 for color in edge(460.0)]
    assert any(dashes)
    assert not all(dashes)


@pytest.mark.panels("video")
def test_black_frames_without_people_have_no_boxes(window: MainWindow, console: FakeConsole) -> None:
    _, view = video(window)
    frame = show_flat(console, (0, 0, 0))
    console.state.add(samples.people_for(frame.sequence, 640, 480, []))
    assert view.visible_detections() == []


# Map


def test_scan_points_land_on_the_walls() -> None:
    pose = Pose2D(2.0, 4.0, 0.7)
    points = scan_points_in_map(samples.scan_at(pose), pose)
    on_wall = (np.abs(points[:, 0]) < 0.1) | (np.abs(points[:, 1] - 8.0) < 0.1) | (np.abs(points[:, 1]) < 0.1)
    assert on_wall.mean() > 0.5
    nowhere = dataclasses.replace(samples.scan_at(pose), robot_from_laser=None)
    assert len(scan_points_in_map(nowhere, pose)) == 0


def test_a_click_on_a_place_offers_to_go_there(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = window.panels["map"]
    assert isinstance(panel, MapPanel)
    console.cancel_goal()
    console.calls.clear()
    where = panel.view.place_position("Kitchen")
    assert where is not None
    panel.view.grab()
    qtbot.mouseClick(panel.view.viewport(), Qt.MouseButton.LeftButton, pos=where)
    assert console.calls == []
    click(qtbot, find(window, "go_to_Kitchen"))
    assert console.calls == [("go_to_place", "Kitchen")]
    video, item = window.panels["video"], find(window, "status_bar").findChild(StatusItem, "status_motion")
    assert isinstance(video, VideoPanel) and item is not None
    going = "Going to Kitchen, 3.2 m left"
    qtbot.waitUntil(lambda: going in dict(video.view.chips))
    assert "Kitchen" not in panel.fact[0] + item.text, "said once"
    window.close_panel("video")
    window.status_bar.refresh()
    assert going in item.text and "Kitchen" not in panel.fact[0], "also without the picture"
    click(qtbot, find(window, "goal_cancel"))
    assert console.calls[-1] == ("cancel_goal", None)


@pytest.mark.panels("map")
def test_the_map_is_painted_at_its_own_pace(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = window.panels["map"]
    assert isinstance(panel, MapPanel)
    painted = PaintCount(panel.view.viewport())
    for _ in range(20):
        state = console.state
        state.add(RobotPose(clock.now_ns(), None, Pose2D(6.6, 3.4, 0.55)))
        state.add(dataclasses.replace(samples.scan_at(Pose2D(6.6, 3.4, 0.55)), stamp_ns=clock.now_ns()))
    QApplication.processEvents()
    assert painted.count <= 1
    qtbot.waitUntil(lambda: painted.count >= 1)


@pytest.mark.panels("map")
def test_the_map_view_turns_clicks_back_into_metres(window: MainWindow) -> None:
    panel = window.panels["map"]
    assert isinstance(panel, MapPanel)
    point = panel.view.to_map(panel.view.to_view(3.25, -1.5))
    assert (point.x(), point.y()) == pytest.approx((3.25, -1.5))


@pytest.mark.panels("map")
def test_the_map_follows_the_robot_until_it_is_dragged(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = window.panels["map"]
    assert isinstance(panel, MapPanel)
    next(action for action in panel.fill_menu().actions() if action.objectName() == "map_follow").trigger()
    freshen(console)
    middle = panel.view.to_view(6.6, 3.4)
    assert (middle.x(), middle.y()) == pytest.approx((panel.view.width() / 2, panel.view.height() / 2), abs=1)
    start = QPoint(panel.view.width() - 30, 30)
    QTest.mousePress(panel.view.viewport(), Qt.MouseButton.LeftButton, pos=start)
    QTest.mouseMove(panel.view.viewport(), start + QPoint(-60, 20))
    QTest.mouseRelease(panel.view.viewport(), Qt.MouseButton.LeftButton, pos=start + QPoint(-60, 20))
    assert not panel.view.follow


@pytest.mark.panels("map")
def test_a_lost_link_takes_the_robot_off_the_map(window: MainWindow, console: FakeConsole) -> None:
    panel = window.panels["map"]
    assert isinstance(panel, MapPanel)
    console.state.goal.set(None)
    before = panel.view.grab().toImage()
    console.state.clear_robot_streams()
    assert panel.view.grab().toImage() != before
    assert panel.fact[0] == "no LIDAR yet"


# Drive


def test_the_drive_panel_says_what_happens(window: MainWindow, console: FakeConsole) -> None:
    line, reason = find(window, "drive_line"), find(window, "drive_reason")
    assert isinstance(line, QLabel)
    assert isinstance(reason, QLabel)
    assert line.text() == "0.35 m/s forward"
    console.state.drive.set(DriveStatus(True, "", target_turn_radps=math.radians(30)))
    assert line.text() == "turning left 30°/s"
    console.state.goal.set(None)
    console.state.drive.set(DriveStatus(True, "", movement="standing"))
    assert line.text() == "Standing still"
    console.state.drive.set(DriveStatus(True, ""))
    assert line.text() == "Nothing commanded"
    console.state.drive.set(DriveStatus(True, "", 0.5, "the picture is late"))
    assert reason.text() == "Limited to 50 %: the picture is late"
    console.state.drive.set(DriveStatus(False, "The robot is unreachable"))
    assert (line.text(), reason.text()) == ("Driving is off", "The robot is unreachable")
    assert not find(window, "drive_pad").isEnabled()


@pytest.mark.panels("drive")
def test_the_drive_panel_says_where_the_robot_goes_automatically(window: MainWindow, console: FakeConsole) -> None:
    line = find(window, "drive_line")
    assert isinstance(line, QLabel)
    console.state.drive.set(DriveStatus(True, ""))
    console.go_to_place("Kitchen")
    assert line.text() == "Navigating", "the picture says where to"
    console.cancel_goal()
    assert line.text() == "Nothing commanded"


@pytest.mark.panels("drive")
def test_the_speed_of_a_goal_is_stated(window: MainWindow, console: FakeConsole) -> None:
    navigation = NavigationServer("move_base", "/move_base", 0.6)
    velocity = VelocityTopic(timeout_s=0.5, timeout_source="its driver")
    console.state.robot.set(RobotProfile("lab", "Lab", velocity=velocity, navigation=navigation))
    console.state.drive.set(DriveStatus(True, "", speed_fraction=0.6, max_forward_mps=0.5, goal_limit_mps=0.3))
    console.go_to_place("Kitchen")
    now, reason = find(window, "status_motion"), find(window, "drive_reason")
    assert now.accessibleName().endswith(" · Going to Kitchen, 3.2 m left · 0.30 m/s at most")
    assert reason.property("text") == "Esc stops the robot.", "the title bar has the speed"
    assert window.panels["drive"].fact == ("0.30 m/s at most", "dim")
    console.state.drive.set(dataclasses.replace(console.state.drive.value, goal_limit_mps=None))
    assert now.accessibleName().endswith("at the robot’s navigation speed, up to 0.60 m/s")
    assert reason.property("text") == "At the robot’s navigation speed, up to 0.60 m/s. Esc stops the robot."
    assert window.panels["drive"].fact == ("goals: own speed", "amber")


@pytest.mark.panels("drive")
def test_the_speed_has_three_steps(window: MainWindow, console: FakeConsole) -> None:
    steps = find(window, "speed_steps")
    console.set_speed_fraction(0.6)
    assert steps.accessibleName() == "Top speed: Normal"
    console.calls.clear()
    fast = next(step for step in steps.findChildren(QPushButton) if step.text() == "Fast")
    QTest.mouseClick(fast, Qt.MouseButton.LeftButton)
    assert console.calls == [("set_speed_fraction", 1.0)]
    assert steps.accessibleName() == "Top speed: Fast"
    assert window.panels["drive"].fact[0] == "0.50 m/s at most"


# People


def people(window: MainWindow) -> PeoplePanel:
    panel = window.panels["people"]
    assert isinstance(panel, PeoplePanel)
    return panel


def names(panel: PeoplePanel) -> list[str]:
    return [str(panel.model.index(row).data()) for row in range(panel.model.rowCount())]


def press_name_button(qtbot: QtBot, panel: PeoplePanel, person_id: str) -> QWidget:
    row = panel.model.row_of(person_id)
    assert row is not None
    panel.list.scrollTo(panel.model.index(row))
    button = find(panel.list.controls[person_id], "person_name")
    click(qtbot, button)
    return find(panel, "person_name_field")


def test_people_have_rows_with_names_or_numbers(qtbot: QtBot, window: MainWindow) -> None:
    panel = people(window)
    assert panel.fact[0] == "3 here"
    assert names(panel) == ["Luis", "Ana Torres", "Person 3"]
    left = find(window, "people_unfold")
    assert left.isVisible() and left.property("text") == "+ 1 left", "who left without a name is only counted"
    click(qtbot, left)
    assert names(panel) == ["Luis", "Ana Torres", "Person 3", "Person 4"]
    told = panel.model.index(3).data(Qt.ItemDataRole.AccessibleTextRole)
    assert str(told).startswith("Person 4, left 4")


@pytest.mark.panels("people", "video")
def test_a_person_is_named_in_the_row(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = people(window)
    field = press_name_button(qtbot, panel, "p3")
    assert field.hasFocus()
    QTest.keyClicks(field, "  Mara  Silva ")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.calls == [("rename_person", ("p3", "Mara Silva"))]
    assert names(panel)[2] == "Mara Silva"
    assert not field.isVisible()


@pytest.mark.panels()
def test_an_unfinished_name_changes_nothing(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = people(window)
    QTest.keyClicks(press_name_button(qtbot, panel, "p3"), "Mar")
    find(window, "speak_field").setFocus()
    assert console.calls == []
    assert names(panel)[2] == "Person 3"


@pytest.mark.panels("people", "video")
def test_the_field_for_a_name_stays_with_its_person(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = people(window)
    field = press_name_button(qtbot, panel, "p3")
    QTest.keyClicks(field, "Mara")
    qtbot.mouseMove(field)
    place = field.geometry()
    persons = console.state.persons.value
    console.state.persons.set(tuple(person for person in persons if person.person_id != "p1"))
    assert names(panel) == ["Luis", "Ana Torres", "Person 3"], "no row moves while a name is typed"
    assert field.geometry() == place
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.calls == [("rename_person", ("p3", "Mara"))]
    assert names(panel) == ["Luis", "Ana Torres", "Mara"], "nor while the mouse is still on them"
    QApplication.sendEvent(panel.list.viewport(), QEvent(QEvent.Type.Leave))
    assert names(panel) == ["Ana Torres", "Mara"]
    # The pointer keeps its position after the test.
    qtbot.mouseMove(window, QPoint(1, 1))


@pytest.mark.panels()
def test_letters_for_a_person_who_is_no_more_go_nowhere(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = people(window)
    field = press_name_button(qtbot, panel, "p3")
    assert isinstance(field, QLineEdit)
    QTest.keyClicks(field, "Mar")
    persons = console.state.persons.value
    for left in (persons[:1], ()):
        console.state.persons.set(tuple(person for person in left if person.person_id != "p3"))
        focused = QApplication.focusWidget()
        assert focused is field, "letters that are still typed reach nothing else"
        QTest.keyClicks(focused, "a Silva wasd")
        assert (field.text(), field.placeholderText()) == ("", "Cannot be named: this person has left")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert not field.isVisible()
    assert panel.isAncestorOf(QApplication.focusWidget()) or QApplication.focusWidget() is None
    assert names(panel) == []
    assert console.calls == []
    assert find(window, "speak_field").property("text") == ""


@pytest.mark.panels("people", "video")
def test_after_a_name_no_key_drives_or_speaks(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = people(window)
    for key in (Qt.Key.Key_Return, Qt.Key.Key_Escape):
        field = press_name_button(qtbot, panel, "p3")
        QTest.keyClick(field, key)
        assert not field.isVisible()
        focused = QApplication.focusWidget()
        assert focused is panel.list
        QTest.keyClicks(focused, "wasd")
    assert [name for name, _ in console.calls] == ["stop"], "Esc gave up the second name"


@pytest.mark.panels("people", "video")
def test_no_row_moves_under_the_mouse(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = people(window)
    viewport = panel.list.viewport()
    luis, ana, third, gone = console.state.persons.value
    pointed = panel.model.row_of(third.person_id)
    assert pointed is not None
    place = panel.list.row_rect(pointed)
    qtbot.mouseMove(viewport, place.center())
    new = dataclasses.replace(luis, person_id="p9", name="Person 9", since_ns=luis.since_ns + 1)
    console.state.persons.set((dataclasses.replace(luis, here=False), third, new, gone))
    assert names(panel) == ["Luis", "Ana Torres", "Person 3", "Person 9"]
    assert panel.list.row_rect(pointed) == place
    assert panel.model.row_of(ana.person_id) is not None
    assert not panel.list.controls[ana.person_id].buttons, "who is gone cannot be named"
    QApplication.sendEvent(viewport, QEvent(QEvent.Type.Leave))
    assert names(panel) == ["Person 9", "Person 3", "Luis"], "those who left go to the end"
    # The pointer keeps its position after the test.
    qtbot.mouseMove(window, QPoint(1, 1))


@pytest.mark.panels("people", "video")
def test_people_are_named_with_the_keyboard(window: MainWindow, console: FakeConsole) -> None:
    panel = people(window)
    panel.list.setFocus()
    panel.list.setCurrentIndex(panel.model.index(1))
    QTest.keyClick(panel.list, Qt.Key.Key_Return)
    field = find(panel, "person_name_field")
    assert isinstance(field, QLineEdit)
    assert field.text() == "Ana Torres"
    QTest.keyClicks(field, "Eva")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.calls == [("rename_person", ("p2", "Eva"))]


@pytest.mark.panels("people", "video")
def test_invisible_changes_draw_no_row_again(window: MainWindow, console: FakeConsole) -> None:
    panel = people(window)
    changed: list[int] = []
    panel.model.dataChanged.connect(lambda first, _last: changed.append(first.row()))
    persons = console.state.persons.value
    later = tuple(dataclasses.replace(person, last_seen_ns=person.last_seen_ns + 40_000_000) for person in persons[:3])
    console.state.persons.set((*later, persons[3]))
    assert not {0, 1, 2} & set(changed), "seen once more says nothing new of who is here"
    console.state.persons.set((dataclasses.replace(later[0], name="Eva"), *later[1:], persons[3]))
    assert 0 in changed


@pytest.mark.panels("people", "video")
def test_an_empty_room_is_stated(window: MainWindow, console: FakeConsole) -> None:
    console.state.persons.set(())
    empty = find(window, "people_empty")
    assert isinstance(empty, QLabel)
    assert empty.text().startswith("Nobody in view.")
    show_flat(console, (0, 0, 0), age_s=3.0)
    console.state.check_freshness()
    console.state.persons.set(())
    assert empty.text() == "No picture, so nobody can be seen."
    console.state.perception.set(PerceptionStatus("failed", "", "No model file was found."))
    assert "No model file was found." in empty.text()


# Speak


def test_enter_says_the_line_and_empties_the_field(window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyClicks(field, "Over there is our  robot arm.")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.calls == [("say", ("Over there is our robot arm.", "typed"))]
    assert field.property("text") == ""
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert len(console.calls) == 1


@pytest.mark.panels("speak")
def test_shift_enter_begins_a_line_and_says_nothing(window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyClicks(field, "Over there")
    QTest.keyClick(field, Qt.Key.Key_Return, Qt.KeyboardModifier.ShiftModifier)
    QTest.keyClicks(field, "is our robot arm.")
    assert console.calls == [] and field.property("text") == "Over there\nis our robot arm."
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.calls == [("say", ("Over there is our robot arm.", "typed"))]


@pytest.mark.panels("speak")
def test_arrow_keys_bring_earlier_lines_back(window: MainWindow) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    for line in ("one", "two"):
        QTest.keyClicks(field, line)
        QTest.keyClick(field, Qt.Key.Key_Return)
    QTest.keyClicks(field, "draft")
    seen = []
    for key in (Qt.Key.Key_Up, Qt.Key.Key_Up, Qt.Key.Key_Up, Qt.Key.Key_Down, Qt.Key.Key_Down):
        QTest.keyClick(field, key)
        seen.append(field.property("text"))
    assert seen == ["two", "one", "one", "two", "draft"]


@pytest.mark.panels("speak")
def test_a_phrase_is_one_click_and_keeps_the_cursor(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    click(qtbot, find(window, "phrase_1"))
    assert console.calls == [("say", ("Hello! Welcome to the lab.", "phrase"))]
    assert field.hasFocus()
    click(qtbot, find(window, "silence_button"))
    assert console.calls[-1] == ("silence", None)


@pytest.mark.panels("speak")
def test_current_and_waiting_utterances_are_shown(window: MainWindow, console: FakeConsole) -> None:
    assert window.panels["speak"].fact[0].startswith("now saying “Over there")
    queue = find(window, "speak_queue")
    assert isinstance(queue, QueueList)
    assert queue.texts == ["“It can lift five kilos.”"]
    console.state.speech.set(SpeechStatus(True, "robot"))
    assert window.panels["speak"].fact[0] == "quiet"
    assert not queue.isVisible()


# Assistant


def test_an_answer_streams_and_can_be_spoken(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    field, answer = find(window, "assistant_field"), find(window, "assistant_answer")
    assert isinstance(answer, QPlainTextEdit)
    field.setFocus()
    QTest.keyClicks(field, "What can it lift?")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.calls == [("ask_assistant", "What can it lift?")]
    assert answer.toPlainText() == ""
    status: AssistantStatus = console.state.assistant.value
    for text in ("Five", "Five kilos", "Five kilos."):
        console.state.assistant.set(dataclasses.replace(status, answer=text))
        assert answer.toPlainText() == text
    assert find(window, "assistant_cancel").isVisible()
    console.state.assistant.set(dataclasses.replace(status, answer="Five kilos.", state="ready"))
    click(qtbot, find(window, "assistant_say"))
    assert console.calls[-1] == ("say_answer", "Five kilos.")


@pytest.mark.panels("assistant", "speak")
def test_an_answer_can_be_edited_first(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    click(qtbot, find(window, "assistant_edit"))
    answer = find(window, "assistant_answer")
    assert answer.hasFocus()
    QTest.keyClicks(answer, " Really.")
    click(qtbot, find(window, "assistant_say"))
    assert console.calls[-1][1].endswith("safety zone around it. Really.")


@pytest.mark.panels("assistant", "speak")
def test_enter_says_an_answer_that_is_edited(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    answer = find(window, "assistant_answer")
    QTest.keyClick(answer, Qt.Key.Key_Return)
    assert console.calls == [], "nothing is said by a key before it is edited"
    click(qtbot, find(window, "assistant_edit"))
    QTest.keyClicks(answer, " Really.")
    QTest.keyClick(answer, Qt.Key.Key_Return, Qt.KeyboardModifier.ShiftModifier)
    QTest.keyClicks(answer, "Yes.")
    QTest.keyClick(answer, Qt.Key.Key_Return)
    assert [name for name, _ in console.calls] == ["say_answer"]
    answered = console.calls[0][1]
    assert answered.endswith("safety zone around it. Really.\nYes."), "Shift+Enter began a line"
    assert spoken(answered).endswith("safety zone around it. Really. Yes."), "and the voice goes on without one"


@pytest.mark.panels("assistant", "speak")
def test_a_failed_answer_is_explained_in_place(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    console.state.assistant.set(AssistantStatus("failed", "SmolLM2", "x2", "Why?", "", "The model ended. Ask again."))
    note = find(window, "assistant_note")
    assert isinstance(note, QLabel)
    assert note.text() == "The model ended. Ask again."
    assert not window.findChild(QWidget, "assistant_say").isVisible()  # type: ignore[union-attr]
    click(qtbot, find(window, "assistant_again"))
    field = find(window, "assistant_field")
    assert isinstance(field, QLineEdit)
    assert field.text() == "Why?" and field.hasFocus(), "nothing of the question is lost"


# Session


def session(window: MainWindow) -> SessionPanel:
    window.dock_host.show_panel("session")
    panel = window.panels["session"]
    assert isinstance(panel, SessionPanel)
    return panel


@pytest.mark.panels("assistant", "speak")
def test_a_question_that_is_too_long_is_reported_and_not_cut(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    console.state.assistant.set(dataclasses.replace(console.state.assistant.value, state="ready"))
    field, note = find(window, "assistant_field"), window.findChild(QLabel, "assistant_note")
    assert isinstance(field, QLineEdit)
    assert isinstance(note, QLabel)
    field.setText("x" * 2200)
    assert "700 characters too long" in note.text()
    assert not find(window, "assistant_ask").isEnabled()
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.named("ask_assistant") == []
    assert len(field.text()) == 2200, "it is still there to be shortened"
    field.setText("x" * 1500)
    assert "too long" not in note.text()
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.named("ask_assistant") == ["x" * 1500]


def test_the_log_reports_events_in_sentences(window: MainWindow, console: FakeConsole) -> None:
    console.state.add(LinkChanged(clock.now_ns(), "robot", "lost", "ws://x", "no answer for 1 s"))
    console.state.add(Marked(clock.now_ns(), "laughed"))
    lines = session(window).log_lines()
    assert lines[-2:] == ["The robot is unreachable: no answer for 1 s", "Marked: laughed"]


@pytest.mark.panels("session")
def test_the_log_can_be_narrowed(window: MainWindow, console: FakeConsole) -> None:
    panel = session(window)
    console.state.add(UtteranceChanged(clock.now_ns(), "u", "robot", "Hello", "typed", "started"))
    console.state.add(Marked(clock.now_ns(), ""))
    panel.show_category("Said")
    assert panel.log_lines() == ["Robot: “Hello”"]
    panel.show_category("")
    assert panel.log_lines() == ["Robot: “Hello”", "Marked"]


@pytest.mark.panels("session")
def test_the_log_stays_at_its_newest_line(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    log = session(window).findChild(QAbstractItemView, "event_log")
    assert isinstance(log, QAbstractItemView)
    bar = log.verticalScrollBar()
    for number in range(60):
        console.state.add(Marked(clock.now_ns(), str(number)))
    qtbot.waitUntil(lambda: bar.maximum() > 0 and bar.value() == bar.maximum())
    log.resize(log.width() - 60, log.height() - 20)
    QApplication.processEvents()
    assert bar.value() == bar.maximum(), "also when there is less room"
    bar.setValue(10)
    console.state.add(Marked(clock.now_ns(), "later"))
    QApplication.processEvents()
    assert bar.value() == 10, "the wizard is reading"


@pytest.mark.panels("session")
def test_the_log_is_in_order_of_time(window: MainWindow, console: FakeConsole) -> None:
    panel = session(window)
    now_ns = clock.now_ns()
    # Reports of the recorder or a link arrive a moment after the event.
    for later_ns, label in ((0, "one"), (3, "three"), (2, "two"), (3, "three, too")):
        console.state.add(Marked(now_ns + later_ns, label))
    expected = ["Marked: one", "Marked: two", "Marked: three", "Marked: three, too"]
    assert panel.log_lines()[-4:] == expected
    panel.show_category("Session")
    console.state.add(Marked(now_ns + 1, "between"))
    assert panel.log_lines()[-5:] == [expected[0], "Marked: between", *expected[1:]]
    panel.restore_state(list(reversed(panel.save_state())))
    assert panel.log_lines()[-3] == "Marked: two"


@pytest.mark.panels("session")
@pytest.mark.long
def test_the_log_is_bounded(window: MainWindow, console: FakeConsole) -> None:
    panel = session(window)
    for number in range(LOG_ROWS + 20):
        console.state.add(Marked(clock.now_ns(), str(number)))
    lines = panel.log_lines()
    assert len(lines) == LOG_ROWS
    assert lines[-1] == f"Marked: {LOG_ROWS + 19}"


@pytest.mark.panels("session")
def test_in_a_low_panel_some_lines_of_the_log_stay(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, theme: Theme
) -> None:
    panel = SessionPanel(PanelContext(console, theme, window.actions_table, window.hold))
    qtbot.addWidget(panel)
    panel.show()
    log = panel.findChild(QAbstractItemView, "event_log")
    button = panel.findChild(QWidget, "session_toggle")
    assert log is not None and button is not None
    for recording in ("idle", "recording", "paused", "failed"):
        console.state.recording.set(dataclasses.replace(console.state.recording.value, state=recording))
        for height in (panel.minimumSizeHint().height(), 160, 240, 500):
            for width in (240, 420, 900):
                panel.resize(width, height)
                QApplication.processEvents()
                assert log.height() >= LOG_LEAST_LINES * LOG_LINE_PX, (recording, width, height)
                assert log.geometry().bottom() <= panel.height(), (recording, width, height)
    assert button.isVisible(), "what starts and stops is there where it has room"


class LookedAt(QIdentityProxyModel):
    """Counts the data requests of each row."""

    def __init__(self, source: QAbstractItemModel) -> None:
        super().__init__(source)
        self.rows: list[int] = []
        self.setSourceModel(source)

    def data(self, index: QModelIndex | QPersistentModelIndex, role: int = int(Qt.ItemDataRole.DisplayRole)) -> object:
        self.rows.append(index.row())
        return super().data(index, role)


@pytest.mark.panels("session")
@pytest.mark.long
def test_a_new_line_costs_the_same_in_a_long_log(window: MainWindow, console: FakeConsole) -> None:
    panel = session(window)
    log = panel.findChild(QAbstractItemView, "event_log")
    assert isinstance(log, QAbstractItemView)
    looked_at = LookedAt(log.model())
    log.setModel(looked_at)
    for number in range(LOG_ROWS):
        console.state.add(Marked(clock.now_ns(), str(number)))
    QApplication.processEvents()
    looked_at.rows.clear()
    console.state.add(Marked(clock.now_ns(), "one more, and as long as a sentence can be. " * 5))
    QApplication.processEvents()
    in_view = log.viewport().height() // LOG_LINE_PX + 2
    assert looked_at.rows, "the newest line is in view"
    assert min(looked_at.rows) >= LOG_ROWS - 2 * in_view
    assert len(set(looked_at.rows)) <= 2 * in_view


@pytest.mark.panels("session")
def test_recording_starts_and_stops_in_the_panel(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = session(window)
    click(qtbot, find(panel, "session_toggle"))
    assert console.calls == [("stop_session", None)]
    click(qtbot, find(panel, "session_toggle"))
    assert find(window, "start_dialog").isVisible()
    find(window, "start_dialog").close()


@pytest.mark.panels("session")
def test_an_ended_session_can_be_exported(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    window.dock_host.show_panel("session")
    assert not any(button.isVisible() for button in window.findChildren(QWidget, "session_export"))
    console.start_session(TrialDetails("P07"))
    assert not any(button.isVisible() for button in window.findChildren(QWidget, "session_export"))
    console.stop_session()
    window.use_library(FakeLibrary())
    click(qtbot, find(window, "session_export"))
    dialog = window.findChild(QWidget, "export_dialog")
    assert dialog is not None and dialog.isVisible()
    dialog.close()


@pytest.mark.panels("session")
@pytest.mark.usefixtures("trial_language")
def test_the_reason_of_a_failed_recording_is_in_the_wizards_language(window: MainWindow, console: FakeConsole) -> None:
    why = localized("The disk failed: {why}.", why="EIO")
    console.state.recording.set(RecordingStatus("failed", Path("/s"), detail=why))
    what = find(session(window), "session_what")
    assert isinstance(what, QLabel)
    assert what.text() == tr("The disk failed: {why}.").format(why="EIO") != why
    window.status_bar.refresh()
    assert window.status_bar.items["recording"].toolTip() == what.text()


@pytest.mark.panels("video", "speak", "people")
@pytest.mark.usefixtures("trial_language")
def test_the_reason_of_missing_data_is_in_the_wizards_language(window: MainWindow, console: FakeConsole) -> None:
    """Statuses are English, as in the recording."""
    why, state = localized("The file {file} is damaged.", file="a.onnx"), console.state
    message = tr("The file {file} is damaged.").format(file="a.onnx")
    state.perception.set(PerceptionStatus("failed", detail=why))
    state.speech.set(SpeechStatus(ready=False, detail=why))
    state.drive.set(DriveStatus(allowed=False, reason=why))
    window.status_bar.refresh()
    assert message in window.status_bar.items["perception"].toolTip()
    assert microphone_facts(MicrophoneStatus("failed", detail=why)).count(message) == 1
    people, video = window.panels["people"], window.panels["video"]
    assert isinstance(people, PeoplePanel) and isinstance(video, VideoPanel)
    assert message in people._why_empty(blind=False)
    assert [text for text, _role in video._hints()] == [tr("Driving is off: {reason}").format(reason=message)]
    state.drive.set(DriveStatus(allowed=True, cap_reason=why))
    assert [text for text, _role in video._hints()] == [tr("Slowed down: {reason}").format(reason=message)]


@pytest.mark.panels("session")
def test_a_failed_recording_is_reported(window: MainWindow, console: FakeConsole) -> None:
    panel = session(window)
    console.state.recording.set(RecordingStatus("failed", Path("/s"), detail="The disk is full."))
    what = find(panel, "session_what")
    assert isinstance(what, QLabel)
    assert what.text() == "The disk is full."
    assert panel.fact == ("not recording", "red")


def test_a_large_map_is_drawn_in_pieces(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = window.panels["map"]
    assert isinstance(panel, MapPanel)
    console.state.goal.set(None)
    cells = np.full((1500, 1500), -1, np.int8)
    cells[700:1300, 200:1400] = 0
    cells[700:1300, 200:260] = 100
    grid = OccupancyGrid(clock.now_ns(), None, 0.02, Pose2D(-2.0, -12.0, 0.0), cells)
    console.state.add(grid)
    qtbot.waitUntil(lambda: panel.view.grid.displayed_grid is grid)
    panel.view.fit()
    image = panel.view.grab().toImage()
    expected = {"map_wall": (2.6, 3.0), "map_free": (5.0, 12.5), "map_unknown": (1.0, 3.0)}
    for role, (x_m, y_m) in expected.items():
        assert image.pixelColor(panel.view.to_view(x_m, y_m).toPoint()) == window.theme.color(role)


def test_a_hidden_picture_comes_back_with_the_present_one(window: MainWindow, console: FakeConsole) -> None:
    _, view = video(window)
    show_flat(console, (0, 0, 255))
    window.dock_host.close_panel("video")
    show_flat(console, (0, 255, 0))
    window.dock_host.show_panel("video")
    assert pixel(view, 0.5, 0.3).getRgb()[:3] == (0, 255, 0)


def test_a_click_on_a_title_takes_the_focus_there(qtbot: QtBot, window: MainWindow) -> None:
    title = window.dock_host.docks["speak"].title_bar
    qtbot.mouseClick(title, Qt.MouseButton.LeftButton, pos=QPoint(40, 15))
    assert find(window, "speak_field").hasFocus()


def test_the_picture_says_why_the_robot_does_not_drive(window: MainWindow, console: FakeConsole) -> None:
    panel, _ = video(window)
    assert panel._hints() == [("W A S D or arrows drive", "hint")]
    find(window, "speak_field").setFocus()
    assert panel._hints() == [("Alt+W A S D drives while you type", "hint")]
    console.state.drive.set(DriveStatus(True, "", 0.5, "the picture is late"))
    assert panel._hints() == [("Slowed down: the picture is late", "warning")]
    console.state.drive.set(DriveStatus(False, "The robot is unreachable"))
    assert panel._hints() == [("Driving is off: The robot is unreachable", "warning")]


@pytest.mark.panels("video")
def test_a_photo_that_was_saved_is_shown_small(window: MainWindow, console: FakeConsole) -> None:
    _panel, view = video(window)
    frame = show_flat(console, (20, 200, 40))
    window.actions_table.run("photo")
    assert console.named("take_photo") == [None]
    show_flat(console, (200, 20, 20))
    small = window.findChild(PhotoThumbnail, "photo_thumbnail")
    assert small is not None
    assert not small.isVisible(), "it is not kept yet"
    console.state.add(PhotoTaken(clock.now_ns(), "front", frame.sequence, "photos/0001.png"))
    assert small.isVisible()
    assert small.accessibleName() == "Photo saved with the session: photos/0001.png"
    middle = small.grab().toImage().pixelColor(small.width() // 2, 60)
    assert (middle.blue(), middle.green(), middle.red()) == (20, 200, 40), "the one that was taken"
    assert view.rect().contains(small.geometry())
    small._going.timeout.emit()
    assert not small.isVisible()
    console.state.recording.set(RecordingStatus())
    console.state.add(PhotoTaken(clock.now_ns(), "front", 999, "photos/0002.png"))
    assert small.accessibleName() == "Photo saved in the study’s folder: photos/0002.png"
    assert small.image is None, "that picture was not seen here"


@pytest.mark.panels("video")
def test_a_photo_is_offered_whether_recording_or_not_but_never_in_a_pause(
    window: MainWindow, console: FakeConsole
) -> None:
    button, recording = find(window, "photo_button"), console.state.recording.value
    for state, offered in (("idle", True), ("recording", True), ("paused", False), ("failed", True)):
        console.state.recording.set(dataclasses.replace(recording, state=state))
        assert button.isEnabled() is offered, state
