"""Connecting a robot without a profile: exploring, mapping, checking, naming, saving; with an in-memory explorer."""

from collections.abc import Callable, Iterator
from typing import Any

import pytest
import shiboken6
from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLineEdit, QMenu, QTabBar, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.robot.discovery import Exploration, Resemblance, StreamCheck
from caris_desktop.robot.profile import ListedProfile, load_profile, user_robots_dir
from caris_desktop.robot.profile_model import RobotProfile, SecuritySettings
from caris_desktop.robot.profile_proposal import RobotOffer, propose
from caris_desktop.ros.dialect import Dialect
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.robot_dialog import RobotDialog
from caris_desktop.ui.widgets.labels import ElidedLabel
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("drive")

OFFER = RobotOffer(
    {
        "/cmd_vel": "geometry_msgs/Twist", "/scan": "sensor_msgs/LaserScan", "/scan_rear": "sensor_msgs/LaserScan",
        "/odom": "nav_msgs/Odometry", "/amcl_pose": "geometry_msgs/PoseWithCovarianceStamped",
    },
    {"/rosapi/topics": "rosapi/Topics"},
    {"/move_base": "move_base_msgs/MoveBase"},
    Dialect.ROS1,
    "noetic",
)  # fmt: skip
ADDRESS = "ws://lab-robot:9090"


class MemoryExplorer:
    """Explorer with answers controlled by the test."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, Any]] = []
        self.done: Callable[[Any], None] = lambda _result: None
        self.progress: Callable[[Any], None] = lambda _words: None
        self.cancelled = 0

    def explore(self, address: str, *, security: SecuritySettings, progress: Any, done: Any) -> None:
        self.asked.append(("explore", (address, security)))
        self.progress, self.done = progress, done

    def check(self, profile: RobotProfile, *, progress: Any, done: Any) -> None:
        self.asked.append(("check", profile))
        self.progress, self.done = progress, done

    def save(self, profile: RobotProfile, title: str, *, done: Any) -> None:
        self.asked.append(("save", (profile, title)))
        self.done = done

    def read(self, name: str, *, done: Any) -> None:
        self.asked.append(("read", name))
        self.done = done

    def cancel(self) -> None:
        self.cancelled += 1


@pytest.fixture
def explorer() -> MemoryExplorer:
    return MemoryExplorer()


@pytest.fixture
def dialog(qtbot: QtBot, window: MainWindow, console: FakeConsole, explorer: MemoryExplorer) -> Iterator[RobotDialog]:
    console.state.recording.set(type(console.state.recording.value)())
    console.state.goal.set(None)
    console.state.drive.set(type(console.state.drive.value)(allowed=True, reason=""))
    console.calls.clear()
    window.use_explorer(explorer)
    window.robots.open_dialog()
    found = window.findChild(RobotDialog)
    assert isinstance(found, RobotDialog)
    qtbot.waitUntil(found.isVisible)
    yield found
    if shiboken6.isValid(found):
        found.close()


def type_into(dialog: QWidget, name: str, text: str) -> None:
    field = find(dialog, name)
    assert isinstance(field, QLineEdit)
    field.setFocus()
    field.selectAll()
    QTest.keyClicks(field, text)


def look(dialog: RobotDialog, explorer: MemoryExplorer, address: str = ADDRESS) -> None:
    type_into(dialog, "robot_address", address)
    QTest.keyClick(find(dialog, "robot_address"), Qt.Key.Key_Return)


def find_it(dialog: RobotDialog, explorer: MemoryExplorer, offer: RobotOffer = OFFER, *likes: Resemblance) -> None:
    look(dialog, explorer)
    explorer.done(Exploration(ADDRESS, offer, propose(offer), likes))


def test_looking_shows_what_is_proposed_and_all_that_is_offered(
    qtbot: QtBot, dialog: RobotDialog, explorer: MemoryExplorer
) -> None:
    look(dialog, explorer, "lab-robot:9090")
    assert explorer.asked == [("explore", (ADDRESS, SecuritySettings()))]
    explorer.progress("Querying the robot")
    assert dialog.note_text == "Querying the robot…"
    explorer.done(Exploration(ADDRESS, OFFER, propose(OFFER), ()))
    scan = dialog.row("scan")
    assert scan is not None
    assert [scan.box.itemText(index) for index in range(scan.box.count())] == ["– not used –", "/scan", "/scan_rear"]
    assert scan.value == "/scan"
    bar = find(dialog, "robot_pages").findChild(QTabBar)
    QTest.mouseClick(bar, Qt.MouseButton.LeftButton, pos=bar.tabRect(1).center())
    type_into(dialog, "robot_filter", "scan")
    assert [dialog.offer_list.item(row).text() for row in range(dialog.offer_list.count())] == [
        "topic   /scan   sensor_msgs/LaserScan",
        "topic   /scan_rear   sensor_msgs/LaserScan",
    ]


def test_a_chosen_topic_is_checked_and_saved_and_then_the_robot_is_used(
    qtbot: QtBot, dialog: RobotDialog, explorer: MemoryExplorer, console: FakeConsole
) -> None:
    find_it(dialog, explorer)
    assert not find(dialog, "robot_save").isEnabled(), "it has no name yet"
    scan = dialog.row("scan")
    assert scan is not None
    scan.box.setFocus()
    QTest.keyClick(scan.box, Qt.Key.Key_Down)
    assert scan.value == "/scan_rear"
    click(qtbot, find(dialog, "robot_check"))
    name, profile = explorer.asked[-1]
    assert (name, profile.scan.topic, profile.address) == ("check", "/scan_rear", ADDRESS)
    good = StreamCheck("scan", "LIDAR", "/scan_rear", "good", 10.0, 0.05, "720 beams.")
    explorer.progress(good)
    assert scan._verdict.text() == "active, 10.0 Hz, 50 ms old · 720 beams."
    wrong = StreamCheck("odometry", "Odometry", "/odom", "nothing", None, None, "")
    explorer.progress(wrong)
    explorer.done((good, wrong))
    assert dialog.note_text == "Not working yet: Odometry. Choose another topic or leave it out."
    type_into(dialog, "robot_name", "Lab robot")
    click(qtbot, find(dialog, "robot_save"))
    name, (profile, title) = explorer.asked[-1]
    assert (name, profile.scan.topic, title) == (
        "save",
        "/scan_rear",
        "Lab robot",
    )
    explorer.done(ListedProfile("lab-robot", "Lab robot", ADDRESS))
    assert console.named("use_robot") == ["lab-robot"]
    assert not dialog.isVisible()


def test_a_known_robot_gives_its_whole_profile_for_this_address(
    qtbot: QtBot, dialog: RobotDialog, explorer: MemoryExplorer
) -> None:
    find_it(dialog, explorer, OFFER, Resemblance("generic-ros1", "Generic ROS 1 base", 0.8))
    dialog.start_from.setFocus()
    QTest.keyClick(dialog.start_from, Qt.Key.Key_Down)
    click(qtbot, find(dialog, "robot_check"))
    assert explorer.asked[-1] == ("read", "generic-ros1")
    explorer.done(UserFacingError("The profile cannot be used.", "Line 3.", "Choose another."))
    assert "Line 3." in dialog.note_text
    click(qtbot, find(dialog, "robot_check"))
    assert dialog.note_text == "Reading the robot profile…", "the disk has not told yet"
    explorer.done(load_profile("generic-ros1"))
    name, profile = explorer.asked[-1]
    assert (name, profile.address, profile.velocity.topic) == ("check", ADDRESS, "/cmd_vel")
    explorer.progress(StreamCheck("scan", "LIDAR", "/scan", "good", 10.0, 0.05, ""))
    row = dialog.row("scan")
    assert row is not None
    assert row._verdict.text() == "active, 10.0 Hz, 50 ms old"


@pytest.mark.parametrize(
    ("typed", "asked"),
    [
        ("192.168.1.20", "ws://192.168.1.20:9090"),
        ("lab-robot/", "ws://lab-robot:9090/"),
        ("lab-robot:9191", "ws://lab-robot:9191"),
        ("[fe80::1]", "ws://[fe80::1]:9090"),
        ("wss://lab-robot", "wss://lab-robot"),
    ],
)
def test_a_bare_name_or_number_is_asked_at_the_usual_port(
    dialog: RobotDialog, explorer: MemoryExplorer, typed: str, asked: str
) -> None:
    look(dialog, explorer, typed)
    assert explorer.asked == [("explore", (asked, SecuritySettings()))]


def test_the_file_that_its_speeds_are_to_be_set_in_is_named(dialog: RobotDialog, explorer: MemoryExplorer) -> None:
    find_it(dialog, explorer)
    assert "in the file" in dialog.note_text
    told = dialog.findChild(ElidedLabel, "robot_file")
    assert told is not None and not told.isVisible(), "it has no name yet"
    type_into(dialog, "robot_name", "Lab robot")
    assert told.isVisible() and str(user_robots_dir() / "lab-robot.yaml") in told.text()


def test_failures_are_words_and_nothing_is_lost(dialog: RobotDialog, explorer: MemoryExplorer) -> None:
    look(dialog, explorer, "http://lab")
    assert explorer.asked == []
    assert "is not a robot address" in dialog.note_text
    look(dialog, explorer)
    explorer.done(UserFacingError("No response from ws://lab-robot:9090.", "The robot was not asked.", "Check it."))
    assert dialog.note_text == "No response from ws://lab-robot:9090. The robot was not asked. Check it."
    assert dialog.address_field.text() == ADDRESS
    look(dialog, explorer)
    explorer.done(UserFacingError("The certificate of lab-robot is not trusted.", "", "Name its file."))
    assert find(dialog, "robot_certificates").isVisible(), "there it can be named"


def test_another_address_forgets_what_was_found(dialog: RobotDialog, explorer: MemoryExplorer) -> None:
    find_it(dialog, explorer)
    type_into(dialog, "robot_address", "ws://other:9090")
    assert dialog.row("scan") is None
    assert not find(dialog, "robot_check").isEnabled()


def test_escape_closes_the_dialog_and_stops_the_robot(
    qtbot: QtBot, window: MainWindow, dialog: RobotDialog, explorer: MemoryExplorer, console: FakeConsole
) -> None:
    dialog.activateWindow()
    qtbot.waitUntil(lambda: QApplication.activeWindow() is dialog)
    QTest.keyClick(find(dialog, "robot_address"), Qt.Key.Key_Escape)
    assert console.named("stop") == [None]
    assert not dialog.isVisible()
    assert explorer.cancelled
    window.robots.open_dialog()
    assert [each for each in window.findChildren(RobotDialog) if each.isVisible()]


def test_the_list_of_robots_on_show_has_what_the_disk_lists_meanwhile(
    window: MainWindow, console: FakeConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    window.robots.choices.renew()
    console.disk_is_slow = True
    window.menus.open_window_menu()
    title = f"Robot: {console.state.link.value.robot}"
    menus = [menu for menu in window.findChildren(QMenu) if menu.title() == title]
    menus[-1].popup(QPoint(0, 0))
    listed = [*console.robots(), ListedProfile("bad", "bad.yaml", "", error="line 3: 'limits' must be ...")]
    monkeypatch.setattr(console, "robots", lambda: listed)
    try:
        console.answer_of_disk()
        assert "bad.yaml · cannot be used" in [action.text() for action in menus[-1].actions()]
    finally:
        console.disk_is_slow = False
        for menu in window.findChildren(QMenu):
            menu.close()
