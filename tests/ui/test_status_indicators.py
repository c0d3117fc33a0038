"""Status indicators of the observer window, and how the robot moves as the wizard sees it."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from PySide6.QtCore import QEvent, QPoint
from PySide6.QtGui import QImage
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import Odometry
from caris_desktop.live.state import LiveState, PresentClock
from caris_desktop.live.status import DriveStatus, LinkStatus, MicrophoneStatus, RecordingStatus, SpeechStatus
from caris_desktop.ui import text_formatting
from caris_desktop.ui.banners import EmergencyBanner
from caris_desktop.ui.event_watch import EventWatch
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.observer_window import StatusIndicators
from caris_desktop.ui.panels.video_panel import VideoPanel
from caris_desktop.ui.status_bar import StatusItem
from caris_desktop.ui.theme import Theme
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

ALL_OFF = ["Still", "Silent", "Not recorded", "Not listening"]
ALL_ON = ["Moving", "Speaking", "Recording", "Listening"]


@pytest.fixture
def state() -> Iterator[LiveState]:
    state = LiveState()
    state.close()
    state.link.set(LinkStatus("connected"))
    yield state


@pytest.fixture
def signs(qtbot: QtBot, theme: Theme, state: LiveState) -> StatusIndicators:
    signs = StatusIndicators(theme, state)
    qtbot.addWidget(signs)
    signs.show()
    return signs


def drive(state: LiveState, forward_mps: float) -> None:
    state.add(Odometry(clock.now_ns(), None, Pose2D(0, 0, 0), Twist2D(forward_mps)))


def turn_all_on(state: LiveState) -> None:
    drive(state, 0.3)
    state.speech.set(SpeechStatus(now=UtteranceChanged(1, "u", "robot", "Hi", "typed", "started")))
    state.recording.set(RecordingStatus("recording"))
    state.microphone.set(MicrophoneStatus("on"))


def said(signs: StatusIndicators) -> list[str]:
    return [sign.word for sign in signs.signs.values()]


def picture(signs: StatusIndicators) -> QImage:
    QApplication.processEvents()
    return signs.grab().toImage().convertToFormat(QImage.Format.Format_Grayscale8)


def test_each_sign_shows_what_is_so(qtbot: QtBot, signs: StatusIndicators, state: LiveState) -> None:
    assert said(signs)[0] == "Unknown", "no odometry has come yet"
    drive(state, 0.0)
    assert said(signs) == ALL_OFF
    turn_all_on(state)
    assert said(signs) == ALL_ON
    assert signs.accessibleName() == "Robot status: Moving, Speaking, Recording, Listening"
    drive(state, 0.0)
    qtbot.waitUntil(lambda: said(signs)[0] == "Still", timeout=10_000)
    state.recording.set(RecordingStatus("paused"))
    state.link.set(LinkStatus("lost"))
    assert said(signs) == ["No link", "Speaking", "Paused", "Listening"], "nobody knows whether it moves"


def test_no_sign_says_still_without_knowledge(qtbot: QtBot, theme: Theme) -> None:
    now_ns = clock.now_ns()
    state = LiveState(present=PresentClock(now_ns=lambda: now_ns))
    state.close()
    state.link.set(LinkStatus("connected"))
    signs = StatusIndicators(theme, state)
    qtbot.addWidget(signs)
    state.add(Odometry(now_ns, None, Pose2D(0, 0, 0), Twist2D()))
    assert said(signs)[0] == "Still"
    now_ns += 2_500_000_000
    state.check_freshness()
    assert said(signs)[0] == "Unknown", "the odometry is gone"
    state.drive.set(DriveStatus(True, "", target_forward_mps=0.3))
    assert said(signs)[0] == "Unknown", "and it was there before"
    state.add(Odometry(now_ns, None, Pose2D(0, 0, 0), Twist2D()))
    state.drive.set(DriveStatus(True, "", target_turn_radps=-0.5, movement="not_following"))
    assert (said(signs)[0], text_formatting.drive_line(state.drive.value)) == (
        "Not driving", "turning right 29°/s commanded, but the robot is not following"
    )  # fmt: skip
    state.add(Odometry(now_ns, None, Pose2D(0, 0, 0), Twist2D(0.3)))
    state.drive.set(DriveStatus(True, "", movement="uncommanded"))
    assert (said(signs)[0], text_formatting.drive_line(state.drive.value)) == (
        "Moving",
        "Moving without a console command",
    )
    state.drive.set(DriveStatus(True, "", emergency_stop=True, movement="uncommanded"))
    assert text_formatting.drive_line(state.drive.value) == "Moving without a console command"


def test_the_sign_is_as_the_last_odometry_reports(qtbot: QtBot, theme: Theme) -> None:
    now_ns = clock.now_ns()
    state = LiveState(present=PresentClock(now_ns=lambda: now_ns))
    state.close()
    state.link.set(LinkStatus("connected"))
    signs = StatusIndicators(theme, state)
    qtbot.addWidget(signs)
    state.drive.set(DriveStatus(True, "", movement="moving"))
    for forward_mps, word in ((0.3, "Moving"), (0.0, "Still"), (-0.03, "Moving"), (0.004, "Still"), (0.3, "Moving")):
        state.add(Odometry(now_ns, None, Pose2D(0, 0, 0), Twist2D(forward_mps)))
        assert said(signs)[0] == word, f"{forward_mps} m/s are shown beside it"
    now_ns += 1_500_000_000
    state.check_freshness()
    assert state.odometry.freshness == "stale"
    qtbot.wait(700)
    assert said(signs)[0] == "Moving", "the last that is known of it"


def test_a_robot_whose_odometry_reports_no_speeds_moves_as_its_poses_do(
    signs: StatusIndicators, state: LiveState
) -> None:
    drive(state, 0.0)
    state.drive.set(DriveStatus(True, "", movement="moving"))
    assert said(signs)[0] == "Moving"
    state.drive.set(DriveStatus(True, "", movement="standing"))
    assert said(signs)[0] == "Still"


def test_a_robot_without_odometry_is_never_called_still(signs: StatusIndicators, state: LiveState) -> None:
    assert said(signs)[0] == "Unknown"
    state.drive.set(DriveStatus(True, "", target_forward_mps=0.3))
    assert said(signs)[0] == "Moving", "as it was asked to"
    state.drive.set(DriveStatus(True, ""))
    assert (said(signs)[0], text_formatting.drive_line(state.drive.value)) == ("Unknown", "Nothing commanded")


def test_on_and_off_differ_without_colour_and_move_nothing(signs: StatusIndicators, state: LiveState) -> None:
    drive(state, 0.0)
    width = signs.width()
    off = picture(signs)
    turn_all_on(state)
    on = picture(signs)
    assert signs.width() == width

    def ground(image: QImage) -> list[int]:
        """Brightness of the background at the upper edge of each sign."""
        left, grounds = 0, []
        for sign_px in signs._widths:
            grounds.append(image.pixelColor(left + sign_px // 2, 4).lightness())
            left += sign_px + 8
        return grounds

    assert all(abs(one - other) > 40 for one, other in zip(ground(off), ground(on), strict=True)), "filled, and not"
    icons = [sign.icon for sign in signs.signs.values()]
    state.link.set(LinkStatus("lost"))
    assert len({*icons, *(sign.icon for sign in signs.signs.values())}) == 5


def inked_px(image: QImage, left: int, right: int) -> tuple[int, int]:
    """Width and height of the painted area between two columns, without the frame."""
    ground = image.pixelColor(left, 4).lightness()
    inked = [
        (x, y)
        for x in range(left, right)
        for y in range(4, image.height() - 4)
        if abs(image.pixelColor(x, y).lightness() - ground) > 50
    ]
    assert inked
    (left, right), (top, bottom) = ((min(axis), max(axis)) for axis in zip(*inked, strict=True))
    return right - left + 1, bottom - top + 1


@pytest.mark.parametrize("choice", ["dark", "light"])
def test_they_are_large_enough_for_two_metres(
    signs: StatusIndicators, state: LiveState, theme: Theme, choice: str
) -> None:
    """A pixel of a common screen is 0.277 mm. Icons are legible from 5.5 mm on, capital letters from 4.5 mm."""
    theme.set_choice("light" if choice == "light" else "dark")
    signs.resize(signs.width(), 34)
    for all_on in (False, True):
        if all_on:
            turn_all_on(state)
        for room_px, compact in ((900, False), (900, True), (400, True)):
            signs.use_room(room_px, compact=compact)
            assert signs.width() <= room_px
            image, left = picture(signs), 0
            for width_px in signs._widths:
                word = left + 12 + 30 + 8
                assert max(inked_px(image, left + 10, word - 10)) * 0.277 >= 5.5, (all_on, compact)
                if not compact:
                    assert inked_px(image, word - 2, word + 14)[1] * 0.277 >= 4.5, (all_on, compact)
                left += width_px + 8
    assert signs.toolTip() == signs.accessibleName() == f"Robot status: {', '.join(ALL_ON)}"
    theme.set_choice("dark")


def test_nothing_is_painted_while_nothing_changes(qtbot: QtBot, signs: StatusIndicators, state: LiveState) -> None:
    painted: list[object] = []
    EventWatch(signs, painted.append, QEvent.Type.Paint).add(signs)
    qtbot.waitExposed(signs)
    turn_all_on(state)
    QApplication.processEvents()
    painted.clear()
    for _ in range(30):
        drive(state, 0.3)
        QApplication.processEvents()
    assert painted == []


@pytest.mark.parametrize("width_px", [1366, 1920])
def test_the_motion_stays_in_sight_of_what_waits_for_the_wizard(
    window: MainWindow, console: FakeConsole, width_px: int
) -> None:
    window.resize(width_px, 768)
    QApplication.processEvents()
    panel = window.panels["video"]
    assert isinstance(panel, VideoPanel)
    motion = panel.view.chips[0][1]
    console.state.drive.set(replace(console.state.drive.value, emergency_stop=True))
    QApplication.processEvents()
    panel._refresh()
    assert panel.view.chips[0][1] == motion
    band = find(window, "emergency_band")
    assert isinstance(band, EmergencyBanner)
    chip = panel.view._chip_places()[0][2].toRect().translated(panel.view.mapTo(window, QPoint()))
    assert not chip.intersects(band.rect().translated(band.mapTo(window, QPoint())))
    needed = band.text.fontMetrics().horizontalAdvance(band.text.text())
    assert band.text.width() >= needed, "and the whole sentence of it"


def test_the_picture_says_how_the_robot_moves_and_the_status_bar_where_there_is_none(
    window: MainWindow, console: FakeConsole
) -> None:
    state, item = console.state, find(window, "status_bar").findChild(StatusItem, "status_motion")
    assert item is not None
    video = window.panels["video"]
    assert isinstance(video, VideoPanel)

    def said() -> tuple[str, str]:
        QApplication.processEvents()
        video._refresh()
        window.status_bar.refresh()
        return (video.view.chips[0][0] if video.in_view else "", item.text)

    console.state.goal.set(None)
    drive(state, 0.3)
    assert said() == ("Moving · 0.30 m/s · 0°/s", "")
    drive(state, 0.0)
    assert said() == ("Still", ""), "once"
    for movement, words in (
        ("uncommanded", "Moving without a console command"),
        ("not_following", "Not driving · turning right 29°/s commanded, but the robot is not following"),
    ):
        state.drive.set(DriveStatus(True, "", target_turn_radps=-0.5, movement=movement))
        assert said() == (words, "")
    state.drive.set(DriveStatus(True, ""))
    state.link.set(LinkStatus("lost"))
    assert said() == ("No link", "")
    window.close_panel("video")
    assert said() == ("", "No link")
    state.link.set(LinkStatus("connected"))
    assert said() == ("", "Still")
    assert item.isVisible()
    console.go_to_place("Kitchen")
    assert item.text.startswith("Still · Going to Kitchen")
    window.open_panel("video")
    assert said() == ("Still", "")
