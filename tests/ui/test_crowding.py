"""Small laptop: share of the picture, controls before anything is done, and what stays in its place."""

import dataclasses
import itertools
from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from PySide6.QtCore import QPoint, QRect, Qt
from PySide6.QtGui import QCursor
from PySide6.QtTest import QTest
from PySide6.QtWidgets import (
    QAbstractButton,
    QApplication,
    QComboBox,
    QGraphicsSimpleTextItem,
    QLabel,
    QLineEdit,
    QPlainTextEdit,
    QPushButton,
    QTabBar,
    QTextEdit,
    QWidget,
)
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.events import PhotoTaken, TrialDetails
from caris_desktop.domain.sensing import People, PersonBox
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.status import DriveStatus, FaceStatus, LinkStatus, RecordingStatus
from caris_desktop.robot.profile import load_profile
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.ui.dock_area import PanelTitleBar
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.map.map_state import Tool
from caris_desktop.ui.panels.map_panel import MapPanel
from caris_desktop.ui.panels.video_panel import VideoPanel
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.labels import ElidedLabel
from tests.support.window_check import painted_by
from tests.ui import samples
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

SIZE = (1366, 768)
_TAKES_INPUT = (QAbstractButton, QLineEdit, QComboBox, QTextEdit, QPlainTextEdit, QTabBar)
Open = Callable[[str], tuple[MainWindow, FakeConsole]]


@pytest.fixture
def opened(qtbot: QtBot, theme: Theme) -> Open:
    """A shipped scenario in the window as it is when the robot is connected, before anything is done."""

    def open_scenario(name: str) -> tuple[MainWindow, FakeConsole]:
        console = FakeConsole(load_scenario(layouts_dir() / f"{name}.yaml"))
        console.state.close()
        QCursor.setPos(0, 0)  # over no panel, wherever another test left it
        console.state.link.set(LinkStatus("connected", "Simulated robot"))
        console.state.robot.set(load_profile("simulated"))
        window = MainWindow(console, theme=theme)
        qtbot.addWidget(window)
        window.resize(*SIZE)
        window.show()
        qtbot.waitExposed(window)
        return window, console

    return open_scenario


def show_picture(console: FakeConsole, width_px: int, height_px: int) -> None:
    console.state.add(console.frames.add(np.full((height_px, width_px, 3), 90, np.uint8)))
    QApplication.processEvents()


def share_of_window(window: MainWindow) -> float:
    panel = window.panels["video"]
    assert isinstance(panel, VideoPanel) and panel.view.frame is not None
    picture = panel.view.picture_rect()
    return picture.width() * picture.height() / (window.width() * window.height())


def place_of(part: QWidget, window: QWidget) -> QRect:
    return QRect(part.mapTo(window, QPoint()), part.size())


def controls(window: QWidget) -> list[str]:
    """Everything visible that takes a click or text, each tab and each step on its own."""
    found = []
    for part in window.findChildren(QWidget):
        if not part.isVisible() or part.visibleRegion().isEmpty():
            continue
        name = part.objectName() or part.accessibleName()
        if isinstance(part, QTabBar):
            found += [f"tab {part.tabText(index)}" for index in range(part.count()) if part.isTabVisible(index)]
        elif isinstance(part, ActionButton):
            found += [name] if part.is_seen else []
        elif isinstance(part, _TAKES_INPUT):
            found.append(name)
    return found


@pytest.mark.parametrize("size", [(960, 540), pytest.param((1280, 720), marks=pytest.mark.long), (1707, 960)])
@pytest.mark.parametrize(("width_px", "height_px", "least"), [(640, 480, 0.20), (1280, 720, 0.28)])
def test_the_picture_of_a_tour_is_large_on_a_scaled_screen(
    opened: Open, width_px: int, height_px: int, least: float, size: tuple[int, int]
) -> None:
    window, console = opened("tour-guide")
    window.resize(*size)
    QApplication.processEvents()
    show_picture(console, width_px, height_px)
    assert share_of_window(window) >= least
    video = window.panels["video"]
    assert isinstance(video, VideoPanel) and video.view.width() - video.view.picture_rect().width() <= 4
    assert window.panels["speak"].isVisible() and window.panels["conversation"].isVisible()


@pytest.mark.parametrize(("width_px", "height_px", "least"), [(640, 480, 0.20), (1280, 720, 0.28)])
def test_the_picture_of_a_tour_is_large_and_has_no_bars_beside_it(
    opened: Open, width_px: int, height_px: int, least: float
) -> None:
    window, console = opened("tour-guide")
    show_picture(console, width_px, height_px)
    assert (window.width(), window.height()) == SIZE
    assert share_of_window(window) >= least
    view = window.panels["video"].focus_target()
    assert isinstance(window.panels["video"], VideoPanel)
    picture = window.panels["video"].view.picture_rect()
    assert view.width() - picture.width() <= 4 and view.height() - picture.height() <= 4
    assert {"video", "speak", "conversation"} <= set(window.dock_host.arrangement.in_front)  # type: ignore[union-attr]
    assert place_of(window.panels["speak"], window).top() > place_of(view, window).bottom(), "Speak lies below"
    console.state.choose_camera("rear")
    before = place_of(window.panels["video"], window)
    square = console.frames.add(np.full((480, 480, 3), 90, np.uint8))
    console.state.add(dataclasses.replace(square, camera="rear"))
    QApplication.processEvents()
    assert place_of(window.panels["video"], window) == before, "another camera moves nothing"


@pytest.mark.parametrize("name", ["tour-guide", "mental-health-check"])
def test_the_hint_on_driving_takes_no_room_and_covers_no_title(opened: Open, name: str) -> None:
    window, console = opened(name)
    show_picture(console, 640, 480)
    before = {panel: place_of(part, window) for panel, part in window.panels.items()}
    window.first_use.hint.begin()
    QApplication.processEvents()
    assert {panel: place_of(part, window) for panel, part in window.panels.items()} == before
    hint, video = find(window, "drive_hint"), window.panels["video"]
    assert isinstance(video, VideoPanel)
    covered = place_of(hint, window)
    assert before["video"].contains(covered), "whole, on the picture"
    assert not any(covered.intersects(place_of(part, window)) for part in video.findChildren(ActionButton))


@pytest.mark.parametrize("name", ["tour-guide", "mental-health-check"])
def test_the_hint_on_driving_covers_no_tab_on_a_small_screen(opened: Open, name: str) -> None:
    window, console = opened(name)
    window.resize(911, 512)
    show_picture(console, 640, 480)
    window.first_use.hint.begin()
    QApplication.processEvents()
    covered = place_of(find(window, "drive_hint"), window)
    bars = window.dock_host.bars
    assert any("video" in bar.panels for bar in bars), "the picture is one of several tabs here"
    assert not any(covered.intersects(place_of(bar, window)) for bar in bars)


def test_a_tour_begins_with_few_controls(opened: Open) -> None:
    window, console = opened("tour-guide")
    show_picture(console, 640, 480)
    visible = controls(window)
    assert len(visible) <= 34, ", ".join(visible)
    top_bar, strip = find(window, "top_bar"), find(window, "protocol_strip")
    assert (top_bar.height(), strip.height()) == (44, 36)
    assert place_of(window.panels["video"], window).top() <= 44 + 36 + 8, "nothing else is above the panels"


def test_the_health_check_has_conversation_and_speech_largest_and_the_hand_over_in_sight(
    qtbot: QtBot, opened: Open
) -> None:
    window, console = opened("mental-health-check")
    show_picture(console, 640, 480)
    areas = {name: dock.width() * dock.height() for name, dock in window.dock_host.docks.items() if dock.isVisible()}
    assert set(sorted(areas, key=lambda name: areas[name])[-2:]) == {"conversation", "speak"}
    assert share_of_window(window) >= 0.13

    for _group in range(3):
        shown = [part for part in window.panels["speak"].findChildren(ActionButton) if part.isVisible()]
        over = [part for part in shown if part.text().startswith("I would like to ask a person to join us now")]
        assert len(over) == 1 and "Ctrl U" in over[0].key
        assert over[0].visibleRegion().boundingRect() == over[0].rect(), "not below the edge"
        window.show_next_phrases()
        QApplication.processEvents()
    console.calls.clear()
    QTest.keyClick(find(window, "speak_field"), Qt.Key.Key_U, Qt.KeyboardModifier.ControlModifier)
    assert console.calls, "its key works in every group"


@pytest.mark.parametrize("name", ["tour-guide", "mental-health-check"])
def test_the_names_of_scenario_and_trial_are_whole_while_recording(opened: Open, name: str) -> None:
    window, console = opened(name)
    console.state.recording.set(RecordingStatus("recording", started_ns=clock.now_ns() - 3_600_000_000_000))
    window._top_bar.show_details(TrialDetails("Lab visit", "P07", "B", "2", "Kim"))
    QApplication.processEvents()
    trial, scenario = find(window, "trial_label"), find(window, "scenario_button")
    assert trial.accessibleName() == "P07 · condition B · trial 2"
    for part in (trial, scenario, find(window, "mark_button"), find(window, "wizard_error_button")):
        assert part.isVisible() and part.width() >= part.sizeHint().width(), part.objectName()


@pytest.mark.parametrize("size", [(1920, 1080), (2560, 1440)])
@pytest.mark.parametrize("name", ["tour-guide", "mental-health-check"])
@pytest.mark.parametrize("picture_px", [(640, 480), (1280, 720)])
def test_on_larger_screens_no_bars_lie_beside_the_picture(
    opened: Open, name: str, size: tuple[int, int], picture_px: tuple[int, int]
) -> None:
    window, console = opened(name)
    window.resize(*size)
    QApplication.processEvents()
    show_picture(console, *picture_px)
    panel = window.panels["video"]
    assert isinstance(panel, VideoPanel)
    picture = panel.view.picture_rect()
    assert panel.view.width() - picture.width() <= 4 and panel.view.height() - picture.height() <= 4
    assert not window.layout_keeper.is_own, "nobody has changed the layout"


def test_buttons_keep_their_place_when_the_focus_moves(window: MainWindow) -> None:
    def places() -> dict[str, QRect]:
        QApplication.processEvents()
        buttons = [part for part in window.findChildren(ActionButton) if part.isVisible()]
        return {part.objectName(): place_of(part, window) for part in buttons if part.objectName()}

    window.focus_driving()
    QApplication.processEvents()
    caps = {name: part.key for part in window.findChildren(ActionButton) if (name := part.objectName())}
    driving = places()
    window.focus_speak()
    assert places() == driving
    changed = [part for part in window.findChildren(ActionButton) if caps.get(part.objectName(), "") != part.key]
    assert {"mark_button", "photo_button"} <= {part.objectName() for part in changed}, "their key caps are others"


def test_a_saved_photo_hides_no_hint_on_driving(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = window.panels["video"]
    assert isinstance(panel, VideoPanel)
    frame = console.state.frame.value
    console.state.add(PhotoTaken(clock.now_ns(), "front", frame.sequence, "photos/0001.png"))
    note = find(window, "photo_thumbnail")
    for _text, _role, chip in panel.view._chip_places():
        assert not note.geometry().intersects(chip.toRect())
    photo = find(window, "photo_button")
    assert not place_of(note, window).intersects(place_of(photo, window))


def test_a_banner_covers_neither_the_controls_on_the_picture_nor_its_labels(
    window: MainWindow, console: FakeConsole
) -> None:
    photo, panel = find(window, "photo_button"), window.panels["video"]
    assert isinstance(panel, VideoPanel)
    before = place_of(photo, window)
    console.state.add(PhotoTaken(clock.now_ns(), "front", 1, "photos/0001.png"))
    console.set_guard(on=False)
    QApplication.processEvents()
    covered = place_of(find(window, "notice_strip"), window)
    assert not covered.intersects(place_of(photo, window))
    assert not place_of(find(window, "photo_thumbnail"), window).intersects(place_of(photo, window))
    for _text, _role, chip in panel.view._chip_places():
        assert not covered.intersects(chip.toRect().translated(panel.view.mapTo(window, QPoint())))
    window.resize(1500, 800)
    QApplication.processEvents()
    assert not covered.intersects(place_of(photo, window))
    window.resize(*SIZE)
    console.set_guard(on=True)
    QApplication.processEvents()
    assert place_of(photo, window) == before


@pytest.mark.parametrize("pictured", [True, False])
@pytest.mark.parametrize("scenario", ["tour-guide", pytest.param("mental-health-check", marks=pytest.mark.long)])
def test_banners_cover_no_title_field_or_button(opened: Open, scenario: str, pictured: bool) -> None:
    window, console = opened(scenario)
    show_picture(console, 640, 480)
    if not pictured:
        window.board.close("video")
    for size in (SIZE, (1920, 1080), (911, 512)):
        window.resize(*size)
        for show in (
            console.emergency_stop, partial(console.set_guard, on=False),
            partial(window._question.ask, "Connect to TIAGo now? The present link ends.", "Connect", lambda: None),
        ):  # fmt: skip
            show()
            for _ in range(10):
                QApplication.processEvents()
            strip = find(window, "notice_strip")
            for part in window.dock_host.findChildren(QWidget):
                is_title = isinstance(part.parent(), PanelTitleBar) and isinstance(part, ElidedLabel)
                is_seen = part.isVisible() and not (isinstance(part, ActionButton) and not part.is_seen)
                if is_seen and (is_title or isinstance(part, _TAKES_INPUT)) and not strip.isAncestorOf(part):
                    assert not place_of(strip, window).intersects(place_of(part, window)), part.objectName()
            for text in (text for text in strip.findChildren(QLabel) if text.isVisible()):
                assert text.height() >= text.heightForWidth(text.width()), "the whole text is shown"
        console.clear_emergency_stop()
        console.set_guard(on=True)
        window._question.put_away()


@pytest.mark.parametrize("guard", ["clear", "overridden"])
def test_the_drive_panel_fits_into_its_tab(opened: Open, guard: str) -> None:
    window, console = opened("tour-guide")
    window.resize(*SIZE)
    window.board.open("drive")
    console.state.drive.set(DriveStatus(True, "", guard=guard))  # type: ignore[arg-type]
    for _ in range(3):
        QApplication.processEvents()
    panel = window.panels["drive"]
    for part in (part for part in panel.findChildren(QWidget) if part.isVisible()):
        assert panel.rect().contains(part.rect().translated(part.mapTo(panel, QPoint()))), part.objectName()
    for step in panel.findChildren(QPushButton, "speed_step"):
        assert step.fontMetrics().horizontalAdvance(step.text()) <= step.width() - 10, f"{step.text()} is cut off"


def test_the_emergency_stop_is_said_by_its_banner_and_its_button(opened: Open) -> None:
    window, console = opened("tour-guide")
    show_picture(console, 640, 480)
    window.resize(*SIZE)
    console.emergency_stop()
    says = []
    for name in ("drive", "robot", "video"):
        window.board.open(name)  # type: ignore[arg-type]
        QApplication.processEvents()
        video = window.panels["video"]
        assert isinstance(video, VideoPanel)
        says += [text for text, _role, _place in video.view._chip_places() if "mergency" in text]
        for part in window.findChildren(QWidget):
            if (
                isinstance(part, QLabel | QAbstractButton)
                and part.isVisible()
                and "mergency stop active" in part.text()
            ):
                says.append(part.text())
    assert sorted({*says}) == [
        "Emergency stop active", "Emergency stop active. No motion commands until you release it."
    ]  # fmt: skip


def test_a_narrow_conversation_says_what_is_proposed(opened: Open) -> None:
    window, console = opened("tour-guide")
    samples.suggest(console)
    QApplication.processEvents()
    card = find(window, "proposal_card")
    words, yes = card.findChildren(ElidedLabel)[0], find(window, "proposal_yes")
    assert isinstance(yes, ActionButton)
    window.resize(683, 384)
    QApplication.processEvents()
    assert card.isVisible() and words.width() > 90 and yes.width() >= yes.sizeHint().width()


def test_a_picture_has_room_for_motion_goal_and_obstacle(opened: Open) -> None:
    window, console = opened("mental-health-check")
    show_picture(console, 1280, 720)
    panel = window.panels["video"]
    assert isinstance(panel, VideoPanel) and panel.view.width() < 450
    words = ("Moving · 0.35 m/s · 4°/s", "Going to Out of the way, 6.2 m left", "Obstacle 3.3 m ahead")
    panel.view.show_chips([(text, "video_text") for text in words])
    places = {text: place for text, _role, place in panel.view._chip_places()}
    assert set(places) == set(words), "none is left out where another row has room"
    assert not any(one.intersects(other) for one, other in itertools.combinations(places.values(), 2))


def test_on_a_small_screen_the_speak_panel_keeps_its_width(opened: Open) -> None:
    window, console = opened("tour-guide")
    window.resize(911, 512)
    show_picture(console, 640, 480)
    assert window.panels["speak"].width() >= 380
    assert "video" in window.dock_host.arrangement.in_front  # type: ignore[union-attr]


def test_the_state_of_the_face_is_not_cut(opened: Open) -> None:
    window, console = opened("mental-health-check")
    show_picture(console, 640, 480)
    console.state.face.set(FaceStatus("calm", "Calm", "calm", ("calm", "happy"), "face"))
    QApplication.processEvents()
    fact = find(window, "dock_face").findChild(QWidget, "panel_fact")
    assert fact is not None and fact.accessibleName() == "calm · not on a screen"
    assert fact.fontMetrics().horizontalAdvance(fact.accessibleName()) <= fact.width()


def test_the_speed_limit_is_whole_in_a_narrow_and_high_drive_panel(opened: Open) -> None:
    window, console = opened("mental-health-check")
    window.resize(2560, 1440)
    console.state.drive.set(DriveStatus(True, "", max_forward_mps=0.3, speed_fraction=0.6))
    show_picture(console, 640, 480)
    fact = find(window, "dock_drive").findChild(QWidget, "panel_fact")
    assert fact is not None and fact.accessibleName() == "0.18 m/s at most"
    assert fact.fontMetrics().horizontalAdvance(fact.accessibleName()) <= fact.width()
    assert find(window, "drive_stick").isVisible() and find(window, "drive_pad").isVisible()
    assert find(window, "drive_stick").y() > find(window, "drive_pad").geometry().bottom()


@pytest.mark.parametrize(("width_px", "height_px"), [(911, 512), (683, 384)])
def test_a_picture_behind_a_tab_bar_has_no_bars_on_small_screens(opened: Open, width_px: int, height_px: int) -> None:
    window, console = opened("mental-health-check")
    window.resize(width_px, height_px)
    show_picture(console, 640, 480)
    panel = window.panels["video"]
    assert isinstance(panel, VideoPanel)
    picture = panel.view.picture_rect()
    assert panel.view.width() - picture.width() <= 4 and panel.view.height() - picture.height() <= 4


def test_the_hint_on_driving_leaves_photo_button_and_names_alone(opened: Open) -> None:
    window, console = opened("tour-guide")
    show_picture(console, 640, 480)
    photo, panel = find(window, "photo_button"), window.panels["video"]
    assert isinstance(panel, VideoPanel)
    before = place_of(photo, window)
    window.first_use.hint.begin()
    QApplication.processEvents()
    assert place_of(photo, window) == before
    hint = find(window, "drive_hint")
    covered = QRect(panel.view.mapFromGlobal(hint.mapToGlobal(QPoint())), hint.size())
    assert panel.covered == covered
    frame = console.state.frame.value
    for left_px, over in ((60.0, covered), (520.0, place_of(photo, panel.view))):
        near = PersonBox(5, "", left_px, 10.0, 100.0, 300.0, 0.9)
        panel.view.show_people(People(frame.stamp_ns, frame.camera, frame.sequence, 640, 480, (near,), 10.0))
        words = [text for text in painted_by(panel.view) if text.text == "Person 5"]
        assert words and not words[0].box.intersects(over.toRectF())


def test_every_place_of_a_tour_has_its_name_on_a_small_map(opened: Open) -> None:
    window, console = opened("tour-guide")
    samples.fill_console(console)
    show_picture(console, 640, 480)
    panel = window.panels["map"]
    assert isinstance(panel, MapPanel)
    panel.view.fit()
    panel.view.grab()
    places = {place.name for place in console.state.places.value}
    assert len(places) == 10 and places <= set(panel.view.map_items.labels())


def test_a_key_cap_is_whole_in_the_narrowest_speak_panel(opened: Open) -> None:
    window, _console = opened("tour-guide")
    window.focus_speak()
    dock = window.dock_host.docks["speak"]
    bar = dock.title_bar
    bar.setFixedWidth(dock.least()[0])
    QApplication.processEvents()
    for name in ("talk_button", "silence_button"):
        button = find(window, name)
        assert button.width() >= button.minimumSizeHint().width() and bar.rect().contains(button.geometry()), name


@pytest.mark.parametrize("tool", ["goal", "pose", "place", "measure"])
def test_the_hint_of_a_map_tool_is_whole_on_a_small_map(opened: Open, tool: Tool) -> None:
    window, console = opened("tour-guide")
    samples.fill_console(console)
    show_picture(console, 640, 480)
    panel = window.panels["map"]
    assert isinstance(panel, MapPanel)
    panel.tools.use(tool)
    panel.view.grab()
    items = panel.view.scene().items()
    shown = [item.text() for item in items if isinstance(item, QGraphicsSimpleTextItem) and item.isVisible()]
    assert any("Esc " in text for text in shown) and not any("…" in text for text in shown), shown
