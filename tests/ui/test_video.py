"""Video: clicks on the floor, and the reason if the robot may not move."""

import dataclasses

import numpy as np
import pytest
from PySide6.QtCore import QPoint, Qt
from PySide6.QtGui import QColor, QImage, QPainter, QRegion
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QLabel, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.camera_projection import CameraModel
from caris_desktop.domain.events import LinkQuality
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import HeadState, People, PersonBox, RobotPose, ThingBox
from caris_desktop.live.status import DriveStatus
from caris_desktop.people.presence import PersonRow
from caris_desktop.robot.profile_model import CameraTopic, NavigationServer, RobotProfile
from caris_desktop.ui import text_formatting
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.people_panel import PeoplePanel
from caris_desktop.ui.panels.video_panel import VideoPanel, guard_chip
from caris_desktop.ui.widgets.frame_view import FARTHEST_M, FloorSpot, ring_px, spot_at
from tests.support.yardstick import in_yardsticks
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("video")

# Half the size of the frames, to which the model is scaled.
MODEL = dataclasses.replace(
    CameraModel.from_field_of_view(width_px=320, height_px=240, horizontal_rad=1.2), x_m=0.1, z_m=1.0, tilt_rad=0.2
)
ROBOT = RobotProfile(
    "simulated", "Simulated robot", navigation=NavigationServer("move_base", "/move_base"),
    cameras=(CameraTopic("front", "/camera", model=MODEL),),
)  # fmt: skip
FRAME_MODEL = MODEL.scaled_to(640, 480)


@pytest.fixture
def panel(window: MainWindow, console: FakeConsole) -> VideoPanel:
    found = window.panels["video"]
    assert isinstance(found, VideoPanel)
    console.state.robot.set(ROBOT)
    console.state.goal.set(None)
    show_frame(console)
    return found


def show_frame(console: FakeConsole, *, age_s: float = 0.0) -> None:
    image = np.full((480, 640, 3), (90, 90, 90), np.uint8)
    console.state.add(console.frames.add(image, stamp_ns=clock.now_ns() - int(age_s * 1e9)))
    console.state.add(RobotPose(clock.now_ns(), None, Pose2D(6.6, 3.4, 0.5)))


def pixel_of_floor(panel: VideoPanel, x_m: float, y_m: float, model: CameraModel = FRAME_MODEL) -> QPoint:
    pixel = model.pixel_of(x_m, y_m, 0.0)
    assert pixel is not None
    return panel.view.to_view(*pixel).toPoint()


def test_a_pixel_becomes_a_point_of_the_floor_or_a_reason() -> None:
    pixel = FRAME_MODEL.pixel_of(3.0, -0.4, 0.0)
    assert pixel is not None
    spot = spot_at(FRAME_MODEL, *pixel)
    assert isinstance(spot, FloorSpot)
    assert (spot.x_m, spot.y_m) == pytest.approx((3.0, -0.4))
    assert spot_at(FRAME_MODEL, 320.0, 0.0) == "That is not on the floor"
    far = FRAME_MODEL.pixel_of(FARTHEST_M + 2.0, 0.0, 0.0)
    assert far is not None
    assert str(spot_at(FRAME_MODEL, *far)).startswith("Too far")
    assert len(ring_px(FRAME_MODEL, spot)) == 32


def test_a_click_on_the_floor_asks_and_then_goes(
    qtbot: QtBot, panel: VideoPanel, window: MainWindow, console: FakeConsole
) -> None:
    where = pixel_of_floor(panel, 3.0, 0.4)
    QTest.mouseMove(panel.view, where)
    assert panel.view.spot is not None
    assert panel.view.spot.distance_m == pytest.approx(3.03, abs=0.03)
    QTest.mouseClick(panel.view, Qt.MouseButton.LeftButton, pos=where)
    assert console.calls == []
    # The speed is stated before.
    assert find(window, "video_card_line").property("text") == "3.0 m from the robot · at the robot’s navigation speed"
    click(qtbot, find(window, "video_go_there"))
    (target,) = console.named("go_to")
    expected = Pose2D(6.6, 3.4, 0.5) @ Pose2D(3.0, 0.4, 0.1326)
    assert (target.x_m, target.y_m) == pytest.approx((expected.x_m, expected.y_m), abs=0.05)
    assert target.heading_rad == pytest.approx(expected.heading_rad, abs=0.02), "the direction of travel"


def test_the_ring_is_painted_on_the_floor(panel: VideoPanel) -> None:
    before = panel.view.grab().toImage()
    QTest.mouseMove(panel.view, pixel_of_floor(panel, 2.5, 0.0))
    edge = pixel_of_floor(panel, 2.5, 0.25)
    after = panel.view.grab().toImage()
    square = [edge + QPoint(dx, dy) for dx in range(-2, 3) for dy in range(-2, 3)]
    assert any(before.pixel(point) != after.pixel(point) for point in square)


def test_the_point_asked_about_stays_on_the_floor(panel: VideoPanel, console: FakeConsole) -> None:
    QTest.mouseClick(panel.view, Qt.MouseButton.LeftButton, pos=pixel_of_floor(panel, 3.0, 0.0))
    ahead = Pose2D(6.6, 3.4, 0.5) @ Pose2D(1.0, 0.0, 0.0)
    console.state.add(RobotPose(clock.now_ns(), None, ahead))
    image = np.full((480, 640, 3), (90, 90, 90), np.uint8)
    console.state.add(console.frames.add(image))
    assert panel.view.spot is not None
    assert panel.view.spot.distance_m == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize(
    ("share_y", "age_s", "words"),
    [(0.02, 0.0, "That is not on the floor"), (0.9, 0.9, "The picture is too old to choose a target")],
)
def test_an_impossible_aim_is_refused_with_the_reason(
    panel: VideoPanel, console: FakeConsole, share_y: float, age_s: float, words: str
) -> None:
    show_frame(console, age_s=age_s)
    console.state.check_freshness()
    picture = panel.view.picture_rect()
    where = QPoint(round(picture.center().x()), round(picture.top() + share_y * picture.height()))
    QTest.mouseClick(panel.view, Qt.MouseButton.LeftButton, pos=where)
    assert (words, "warning") in panel.view.chips
    assert [card for card in panel.findChildren(QWidget, "video_card") if card.isVisible()] == []
    assert console.calls == []


def test_a_picture_long_in_transit_is_not_live(panel: VideoPanel, console: FakeConsole) -> None:
    console.state.frame.robot_clock = LinkQuality(
        clock.now_ns(), 40.0, clock_offset_ms=5000.0, clock_uncertainty_ms=8.0
    )
    arrived = console.frames.add(np.full((480, 640, 3), 255, np.uint8))
    # The robot's clock is five seconds ahead; the frame was taken 0.9 s before it arrived.
    console.state.add(dataclasses.replace(arrived, robot_stamp_ns=arrived.stamp_ns + 5_000_000_000 - 900_000_000))
    assert console.state.frame.freshness == "stale"
    panel._refresh()
    assert panel.fact == ("delayed · 0.9 s old", "amber")
    picture = panel.view.picture_rect()
    image = panel.view.grab().toImage()
    assert image.pixelColor(round(picture.center().x()), round(picture.top() + 20)).lightness() < 140


def test_a_camera_on_the_head_points_where_the_head_does(panel: VideoPanel, console: FakeConsole) -> None:
    on_head = dataclasses.replace(MODEL, on_head=True)
    console.state.robot.set(dataclasses.replace(ROBOT, cameras=(CameraTopic("front", "/camera", model=on_head),)))
    show_frame(console)
    assert panel.view.model is None, "a head that may be turned anywhere points nowhere"
    console.state.add(HeadState(clock.now_ns(), None, 0.3, 0.1))
    show_frame(console)
    model = FRAME_MODEL.scaled_to(640, 480)
    turned = dataclasses.replace(model, on_head=True).with_head_at(pan_rad=0.3, tilt_rad=0.1)
    QTest.mouseMove(panel.view, pixel_of_floor(panel, 2.5, 0.8, turned))
    assert panel.view.spot is not None
    assert (panel.view.spot.x_m, panel.view.spot.y_m) == pytest.approx((2.5, 0.8), abs=0.03)


@pytest.mark.parametrize(
    ("drive", "words"),
    [
        (DriveStatus(True, "", guard="blocked", guard_distance_m=0.14), "Blocked"),
        (DriveStatus(True, "", guard="slowing", guard_distance_m=0.52), "0.5 m left"),
        (DriveStatus(True, "", guard="overridden"), "guard is off"),
        (DriveStatus(True, "", 0.5, "the picture is late"), "the picture is late"),
    ],
)
def test_the_limit_of_the_robot_is_named_in_the_video(
    panel: VideoPanel, console: FakeConsole, qtbot: QtBot, drive: DriveStatus, words: str
) -> None:
    console.state.drive.set(drive)
    qtbot.waitUntil(lambda: any(words in text for text, _role in panel.view.chips))


def test_each_state_of_the_guard_has_its_own_shape() -> None:
    chips = [guard_chip(DriveStatus(True, "", guard=state)) for state in ("blocked", "slowing", "overridden")]
    assert len({chip[1] for chip in chips if chip is not None}) == 3
    assert guard_chip(DriveStatus(True, "", guard="clear")) is None


def test_the_title_names_the_camera_on_show(window: MainWindow, panel: VideoPanel, console: FakeConsole) -> None:
    assert panel.shown_title == "Front camera"
    frame = console.state.frame.value
    console.state.add(dataclasses.replace(frame, camera="rear"))
    console.state.choose_camera("rear")
    assert panel.shown_title == "Rear camera"
    dock = window.dock_host.docks["video"]
    assert dock.windowTitle() == "Rear camera"
    titles = [label.text() for label in dock.title_bar.findChildren(QLabel)]
    assert "Rear camera" in titles
    console.state.forget_cameras()
    assert panel.shown_title == "Video"


@pytest.mark.panels()
def test_the_people_panel_says_who_is_seen_by_another_camera_only(
    window: MainWindow, panel: VideoPanel, console: FakeConsole
) -> None:
    people = window.panels["people"]
    assert isinstance(people, PeoplePanel)
    now_ns = clock.now_ns()
    rows = tuple(
        PersonRow(f"p-{camera}", number, f"Person {number}", True, now_ns, now_ns, camera)
        for number, camera in enumerate(("front", "rear"), 1)
    )
    console.state.persons.set(rows)
    assert [people.model.seen(row) for row in rows] == ["here just now", "rear camera · here just now"]
    assert people.fact[0] == "2 here · 1 in another camera"
    console.state.add(dataclasses.replace(console.state.frame.value, camera="rear"))
    console.state.choose_camera("rear")
    assert [people.model.seen(row) for row in rows] == ["front camera · here just now", "here just now"]


@pytest.mark.long
def test_boxes_and_words_cost_no_more_than_the_picture_under_them(panel: VideoPanel, console: FakeConsole) -> None:
    show_frame(console)
    view = panel.view
    view.resize(1200, 900)
    frame = console.state.frame.value
    boxes = tuple(
        PersonBox(number, f"p{number}", 40.0 + 150.0 * number, 80.0, 100.0, 300.0, 0.9) for number in range(4)
    )
    view.show_people(People(frame.stamp_ns, frame.camera, frame.sequence, 640, 480, boxes, 60.0))
    view.show_names({"p0": ("Ada", True)})
    view.show_chips([("0.30 m/s · 12°/s", "video_text"), ("Driving is off", "warning"), ("W A S D drives", "hint")])
    onto = QImage(view.size(), QImage.Format.Format_RGB32)
    pixels = np.full((480, 640, 3), (90, 90, 90), np.uint8)
    picture = QImage(pixels.data, 640, 480, 3 * 640, QImage.Format.Format_BGR888)

    def whole() -> None:
        view.render(onto, QPoint(), QRegion(), QWidget.RenderFlag(0))

    def bare() -> None:
        painter = QPainter(onto)
        painter.drawImage(view.picture_rect(), picture)
        painter.end()

    whole()
    assert len(view.visible_detections()) == 4
    ratio = in_yardsticks(whole, tries=60) / in_yardsticks(bare, tries=60)
    assert ratio < 2.0


def test_named_people_have_a_solid_box_and_others_a_dashed_one(panel: VideoPanel, console: FakeConsole) -> None:
    show_frame(console)
    view, frame = panel.view, console.state.frame.value
    boxes = (PersonBox(1, "p1", 60, 120, 120, 300, 0.9), PersonBox(2, "p2", 400, 120, 120, 300, 0.9))
    view.show_people(People(frame.stamp_ns, frame.camera, frame.sequence, 640, 480, boxes, 60.0))
    view.show_names({"p1": ("Ada", True)})
    image = view.grab().toImage()

    def colors_beside(left_px: float) -> set[str]:
        at = view.to_view(left_px, 0)
        rows = range(round(view.to_view(0, 200).y()), round(view.to_view(0, 400).y()))
        return {image.pixelColor(round(at.x()), row).name() for row in rows}

    named, unnamed = panel.theme.color("box_named").name(), panel.theme.color("box_unnamed").name()
    assert colors_beside(60) == {named}
    assert colors_beside(400) == {unnamed, "#5a5a5a"}, "dashes, and the picture between them"


def test_things_are_boxed_thinly_and_named_and_people_say_what_they_do(panel: VideoPanel, console: FakeConsole) -> None:
    frame = console.state.frame.value
    console.state.add(People(frame.stamp_ns, "front", frame.sequence, 640, 480, (), 9.0))
    before = panel.view.grab().toImage()
    chair = ThingBox("chair", 60.0, 200.0, 120.0, 150.0, 0.8)
    person = PersonBox(1, "", 400.0, 100.0, 120.0, 250.0, 0.9, "sitting", hand_raised=True, facing=False)
    console.state.add(People(frame.stamp_ns, "front", frame.sequence, 640, 480, (person,), 9.0, (chair,)))
    panel.view.update()
    after = panel.view.grab().toImage()
    differing = {
        (x, y)
        for x in range(0, after.width(), 1)
        for y in range(0, after.height(), 4)
        if before.pixel(x, y) != after.pixel(x, y)
    }
    edge = panel.view.to_view(60.0, 330.0).toPoint()
    row = edge.y() // 4 * 4
    assert 1 <= sum((edge.x() + dx, row) in differing for dx in range(-4, 5)) <= 2, "a thin line"
    assert QColor(after.pixel(edge.x(), row)).saturation() < 60, "a grey one"
    inside = panel.view.to_view(120.0, 300.0).toPoint()
    assert (inside.x(), inside.y() // 4 * 4) not in differing
    assert text_formatting.person_state(person) == "sitting · hand raised"
    assert text_formatting.person_state(PersonBox(1, "", 0, 0, 1, 1, 0.9, "standing", False, True)) == "faces robot"
    assert text_formatting.person_state(PersonBox(1, "", 0, 0, 1, 1, 0.9)) == ""
