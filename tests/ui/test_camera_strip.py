"""Several cameras in the video panel: one large, the others in a strip, each with its own age."""

import numpy as np
import pytest
from PySide6.QtCore import QSize, Qt
from PySide6.QtGui import QColor, QImage
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication

from caris_desktop.domain import clock
from caris_desktop.domain.sensing import CameraState, People, PersonBox
from caris_desktop.live.status import LoadStatus
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.video_panel import VideoPanel
from caris_desktop.ui.widgets.camera_strip import SmallPicture, strip_place
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("video")

COLORS = {"front": (40, 40, 200), "desk": (40, 200, 40), "rear": (200, 40, 40)}


@pytest.fixture
def panel(window: MainWindow, console: FakeConsole) -> VideoPanel:
    found = window.panels["video"]
    assert isinstance(found, VideoPanel)
    found.resize(900, 420)
    return found


def show(console: FakeConsole, *cameras: str, age_s: float = 0.0, shade: int = 0) -> None:
    for camera in cameras:
        image = np.full((120, 160, 3), np.array(COLORS[camera]) + shade, np.uint8)
        console.state.add(console.frames.add(image, stamp_ns=clock.now_ns() - int(age_s * 1e9), camera=camera))


def small(panel: VideoPanel, camera: str) -> SmallPicture:
    return next(picture for picture in panel.strip.pictures if picture.camera == camera)


def middle(picture: QImage) -> tuple[int, int, int]:
    color = QColor(picture.pixel(picture.width() // 2, picture.height() * 3 // 5))
    return color.blue(), color.green(), color.red()


def test_the_strip_is_where_the_picture_stays_the_largest() -> None:
    assert strip_place(QSize(900, 420), 1, 4 / 3).side == "right"
    assert strip_place(QSize(600, 700), 2, 4 / 3).side == "below"
    assert strip_place(QSize(260, 150), 2, 4 / 3).side == "", "a small panel keeps its one picture"
    assert strip_place(QSize(900, 420), 0, 4 / 3).side == ""
    for room, count in ((QSize(830, 380), 3), (QSize(500, 300), 3), (QSize(640, 900), 5), (QSize(1900, 900), 9)):
        place = strip_place(room, count, 16 / 9)
        length = place.picture.height() if place.side == "right" else place.picture.width()
        assert count * (length + 6) <= (room.height() if place.side == "right" else room.width())


def test_one_camera_alone_has_no_strip(panel: VideoPanel, console: FakeConsole) -> None:
    show(console, "front")
    assert not panel.strip.isVisible()
    assert panel.view.width() == panel.width()


def test_the_others_are_small_and_a_click_or_key_swaps_them(
    panel: VideoPanel, console: FakeConsole, window: MainWindow
) -> None:
    show(console, "front", "desk", "rear")
    show(console, "front", "desk", "rear")
    assert [picture.camera for picture in panel.strip.pictures] == ["desk", "rear"]
    assert panel.strip.isVisible()
    assert middle(small(panel, "desk").grab().toImage()) == COLORS["desk"]
    QTest.mouseClick(small(panel, "rear"), Qt.MouseButton.LeftButton)
    assert console.state.camera.value == "rear"
    assert [picture.camera for picture in panel.strip.pictures] == ["front", "desk"]
    assert middle(panel.view.grab().toImage()) == COLORS["rear"], "at once, not with its next picture"
    window.actions_table.run("next_camera")
    assert console.state.camera.value == "front"


def test_a_lost_camera_says_so_in_its_own_picture_and_returns(panel: VideoPanel, console: FakeConsole) -> None:
    show(console, "front", "desk", "rear")
    show(console, "desk", age_s=1.0)
    console.state.check_freshness()
    assert small(panel, "desk").words()[0] == "1.0 s old"
    show(console, "desk", age_s=3.2)
    show(console, "front", "rear")
    console.state.check_freshness()
    panel._refresh()
    desk = small(panel, "desk")
    assert not desk.shows_picture, "no old picture passes for the present"
    assert desk.words()[1] == "No picture for 3.2 s. The console is trying again."
    assert "3.2 s" in desk.accessibleDescription()
    assert small(panel, "rear").words() == ("", "")
    console.state.choose_camera("desk")
    head, sub = panel.view.words_without_picture()
    assert head == "Desk camera"
    assert sub.startswith("No picture for 3.")
    assert "The console is trying again" in sub
    show(console, "desk")
    assert middle(panel.view.grab().toImage()) == COLORS["desk"]


def test_a_camera_that_never_came_says_why(panel: VideoPanel, console: FakeConsole) -> None:
    console.state.own_cameras.set({"desk": None})
    show(console, "front")
    console.state.add(CameraState(clock.now_ns(), "desk", "lost", "There is no device /dev/video7."))
    assert small(panel, "desk").words()[1] == (
        "No picture yet. The console is trying again. There is no device /dev/video7."
    )
    show(console, "desk")
    assert small(panel, "desk").words() == ("", "")
    console.state.add(CameraState(clock.now_ns(), "desk", "ended", "The video was played to its end."))
    show(console, "desk", age_s=4.0)
    console.state.check_freshness()
    assert small(panel, "desk").words()[1] == "The video was played to its end."
    console.state.forget_camera("desk")
    console.state.add(CameraState(clock.now_ns(), "desk", "ended", "This scenario does not use this camera."))
    assert console.state.cameras.value == ("front",)


def test_a_small_picture_changes_rarely_and_never_while_nobody_sees_it(
    panel: VideoPanel, console: FakeConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s = [100.0]
    monkeypatch.setattr("caris_desktop.ui.widgets.camera_strip.time.monotonic", lambda: now_s[0])
    read: list[str] = []
    really = console.frames.read
    monkeypatch.setattr(console.frames, "read", lambda ref: read.append(ref.camera) or really(ref))
    show(console, "front", "desk")

    def reads_of_desk(seconds: int) -> int:
        read.clear()
        for _ in range(seconds * 20):
            now_s[0] += 0.05
            show(console, "desk")
        return read.count("desk")

    assert 3 <= reads_of_desk(1) <= 5
    console.state.load.set(LoadStatus(1, "The machine is busy"))
    assert 2 <= reads_of_desk(3) <= 4, "of all that costs time it is the least missed"
    panel.resize(300, 160)
    QApplication.sendPostedEvents()
    assert reads_of_desk(2) == 0


def test_people_are_boxed_in_the_small_picture(panel: VideoPanel, console: FakeConsole) -> None:
    show(console, "front", "desk")
    frame = console.state.frame_of("desk").value
    before = small(panel, "desk").grab().toImage()
    box = PersonBox(1, "", 40.0, 30.0, 60.0, 70.0, 0.9)
    console.state.add(People(frame.stamp_ns, "desk", frame.sequence, 160, 120, (box,), 9.0))
    after = small(panel, "desk").grab().toImage()
    x, y = round(after.width() * 40 / 160), round(after.height() * 60 / 120)
    assert any(before.pixel(x + dx, y) != after.pixel(x + dx, y) for dx in range(-2, 3))
    assert middle(after) == COLORS["desk"]


def test_a_camera_that_is_gone_takes_its_picture_along(panel: VideoPanel, console: FakeConsole) -> None:
    show(console, "front", "desk")
    console.state.forget_cameras()
    assert panel.strip.pictures == ()
    assert not panel.strip.isVisible()


@pytest.mark.panels()
def test_the_people_panel_continues_while_another_camera_sees(
    panel: VideoPanel, console: FakeConsole, window: MainWindow
) -> None:
    people = window.panels["people"]
    show(console, "front", "desk")
    show(console, "front", age_s=4.0)
    console.state.check_freshness()
    people.update_view()
    assert "no picture" not in people.fact[0]
    show(console, "desk", age_s=4.0)
    console.state.check_freshness()
    people.update_view()
    assert people.fact[0].startswith("no picture")
