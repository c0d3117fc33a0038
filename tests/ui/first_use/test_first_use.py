"""First-use page: its steps, and the hint about driving."""

import dataclasses
from collections.abc import Iterator
from dataclasses import replace

import pytest
from PySide6.QtCore import QPoint, QRect, Qt
from PySide6.QtWidgets import QApplication, QLabel, QProgressBar, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock, intents
from caris_desktop.domain.geometry import Pose2D, Twist2D
from caris_desktop.domain.sensing import Odometry
from caris_desktop.live.status import (
    AssistantSetup,
    AssistantStatus,
    DriveStatus,
    LinkStatus,
    MicrophoneStatus,
    ModelChoice,
    PreflightCheck,
)
from caris_desktop.robot.profile import ListedProfile, load_profile
from caris_desktop.scenario.scenario_model import Permissions
from caris_desktop.ui.banners import QuestionBanner
from caris_desktop.ui.first_use import DRIVEN_KEY, SET_UP_KEY, DriveHint, FirstUse
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.robot_dialog import RobotDialog
from caris_desktop.ui.set_up_page import LivePicture, SetUpPage, steps_for
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.windows import RobotChooser
from tests.ui import samples
from tests.ui.conftest import MemorySettings, click, find
from tests.ui.fake_console import FakeConsole
from tests.ui.test_robot_dialog import MemoryExplorer

ROBOT = PreflightCheck("robot", "Robot is connected", "major", "The model does not respond.", "Switch it on.")
VIDEO = PreflightCheck("video", "Video arrives", "passed", "Video arrives from front.")
VOICE = PreflightCheck("voice", "Robot can speak", "passed", "The voice is ready.")
SOUND = PreflightCheck(
    "microphone", "Microphone works", "not checked", "The microphone has not been tested yet.", "Try it."
)
MODEL = PreflightCheck("model", "Language model answers", "pending", "The model is being loaded.")
CHECKS = (ROBOT, VIDEO, VOICE, SOUND, MODEL)


@pytest.fixture
def console() -> Iterator[FakeConsole]:
    made = FakeConsole(replace(samples.TOUR, permissions=Permissions(audio_recording=True)))
    made.state.preflight.set(CHECKS)
    made.inputs = ("Jabra",)
    yield made
    made.state.close()


@pytest.fixture
def ground(qtbot: QtBot) -> QWidget:
    made = QWidget()
    qtbot.addWidget(made)
    made.resize(1366, 768)
    made.show()
    return made


@pytest.fixture
def page(theme: Theme, ground: QWidget, console: FakeConsole) -> SetUpPage:
    robots = RobotChooser(theme, console, QuestionBanner(theme), ground)
    made = SetUpPage(theme, ground, console, robots)
    made.open_welcome()
    return made


def texts(widget: QWidget) -> list[str]:
    return [label.text() for label in widget.findChildren(QLabel) if label.isVisible()]


def test_only_what_the_scenario_needs_is_set_up() -> None:
    assert [step.name for step in steps_for(CHECKS)] == ["robot", "camera", "sound", "model"]
    assert [step.name for step in steps_for((ROBOT, VOICE))] == ["robot", "sound"]


def test_the_simulated_robot_is_one_key_away(qtbot: QtBot, page: SetUpPage) -> None:
    asked: list[bool] = []
    page.simulated_requested.connect(lambda: asked.append(True))
    focused = page.window().focusWidget()
    assert focused is not None and focused.accessibleName() == "Try it with the simulated robot"
    qtbot.keyClick(focused, Qt.Key.Key_Space)
    assert asked == [True]
    assert page.isHidden()


def test_enter_presses_what_has_the_focus_as_space_does(qtbot: QtBot, page: SetUpPage) -> None:
    find(page, "first_use_own").setFocus()
    qtbot.keyClick(find(page, "first_use_own"), Qt.Key.Key_Return)
    assert page.step == "robot"
    qtbot.keyClick(find(page, "first_use_next"), Qt.Key.Key_Enter)
    assert page.step == "camera"


def test_the_red_button_stays_free_and_a_click_next_to_the_page_closes_nothing(qtbot: QtBot, page: SetUpPage) -> None:
    assert page.geometry().top() == 56, "below the bar with the emergency stop"
    qtbot.mouseClick(page, Qt.MouseButton.LeftButton, pos=page.rect().bottomLeft())
    assert page.isVisible()


def test_each_step_says_how_it_stands_and_can_be_skipped(qtbot: QtBot, page: SetUpPage, console: FakeConsole) -> None:
    told: list[bool] = []
    page.finished.connect(told.append)
    click(qtbot, find(page, "first_use_own"))
    assert page.step == "robot"
    assert find(page, "first_use_to_robot").accessibleName() == "Robot: Major"
    assert find(page, "first_use_to_camera").accessibleName() == "Camera: Passed"
    assert {"The model does not respond.", "Switch it on."} <= set(texts(page))
    next_one = find(page, "first_use_next")
    assert next_one.accessibleName() == "Skip for now"
    console.state.preflight.set((replace(ROBOT, state="passed", detail="TIAGo is connected."), *CHECKS[1:]))
    assert next_one.accessibleName() == "Next"
    assert "TIAGo is connected." in texts(page)
    for step in ("camera", "sound", "model"):
        qtbot.keyClick(next_one, Qt.Key.Key_Space)
        assert page.step == step
    assert next_one.accessibleName() == "Done"
    click(qtbot, find(page, "first_use_back"))
    assert page.step == "sound"
    page.show_step("model")
    qtbot.keyClick(next_one, Qt.Key.Key_Space)
    assert page.isHidden() and told == [True]


def test_the_buttons_of_the_robots_stay_where_they_are_while_one_is_tried(
    qtbot: QtBot, page: SetUpPage, console: FakeConsole
) -> None:
    click(qtbot, find(page, "first_use_own"))
    tiago = find(page, "first_use_robot_tiago")
    places = []
    for told in (replace(ROBOT, state="pending", detail="", advice=""), replace(ROBOT, advice="A long way. " * 20)):
        console.state.preflight.set((told, *CHECKS[1:]))
        QApplication.sendPostedEvents()
        QApplication.processEvents()
        places.append(tiago.mapTo(page, QPoint()))
    assert places[0] == places[1]


def test_a_robot_whose_profile_was_just_saved_has_its_button(
    qtbot: QtBot, theme: Theme, ground: QWidget, console: FakeConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    robots = RobotChooser(theme, console, QuestionBanner(theme), ground)
    robots.use_explorer(MemoryExplorer())
    page = SetUpPage(theme, ground, console, robots)
    page.open_welcome()
    click(qtbot, find(page, "first_use_own"))
    robots.open_dialog()
    dialog = ground.findChild(RobotDialog)
    assert dialog is not None
    saved = ListedProfile("lab-robot", "Lab robot", "ws://lab-robot:9090")
    listed = [*console.robots(), saved]
    monkeypatch.setattr(console, "robots", lambda: listed)
    dialog.accept()
    dialog.saved.emit(saved)
    button = page.findChild(QWidget, "first_use_robot_lab-robot")
    assert button is not None, "the list was not read anew"
    qtbot.waitUntil(button.isVisible)


def test_a_robot_is_chosen_from_the_list(qtbot: QtBot, page: SetUpPage, console: FakeConsole) -> None:
    click(qtbot, find(page, "first_use_own"))
    click(qtbot, find(page, "first_use_robot_tiago"))
    assert console.named("use_robot") == ["tiago"]


def test_the_camera_is_seen_and_an_old_picture_never(qtbot: QtBot, page: SetUpPage, console: FakeConsole) -> None:
    click(qtbot, find(page, "first_use_own"))
    page.show_step("camera")
    picture = find(page, "first_use_picture")
    assert isinstance(picture, LivePicture)
    image_bgr, boxes = next(samples.video_frames())
    samples.show_frame(console, image_bgr, boxes)
    picture.refresh()
    assert not picture.pixmap().isNull()
    console.state.frame.clear()
    picture.refresh()
    assert picture.pixmap().isNull()


def test_sound_is_tested_in_both_directions(qtbot: QtBot, page: SetUpPage, console: FakeConsole) -> None:
    click(qtbot, find(page, "first_use_own"))
    page.show_step("sound")
    click(qtbot, find(page, "first_use_say"))
    assert console.named("say")[-1][1] == "phrase"
    click(qtbot, find(page, "preflight_try_microphone"))
    assert console.named("try_microphone") == [True]
    level = find(page, "first_use_level")
    assert isinstance(level, QProgressBar)
    console.state.microphone.set(MicrophoneStatus("on", level=0.25))
    assert level.value() == 50
    console.state.microphone.set(MicrophoneStatus("off", level=0.25))
    assert level.value() == 0


def test_a_microphone_is_chosen_where_the_robot_that_was_chosen_before_has_none(
    qtbot: QtBot, page: SetUpPage, console: FakeConsole
) -> None:
    console.state.robot.set(load_profile("simulated"))
    click(qtbot, find(page, "first_use_own"))
    page.show_step("sound")
    choice = page.findChild(QWidget, "first_use_microphone")
    assert choice is not None and not choice.isVisible(), "the simulated robot hears by itself"
    console.state.robot.set(load_profile("turtlebot3"))
    assert choice.isVisible()


def test_a_model_is_chosen_and_asked(qtbot: QtBot, page: SetUpPage, console: FakeConsole) -> None:
    models = (ModelChoice("embedded", "SmolLM2", "this computer"), ModelChoice("ollama:phi", "phi", "Ollama"))
    console.state.assistant_setup.set(AssistantSetup("embedded", models=models))
    click(qtbot, find(page, "first_use_own"))
    page.show_step("model")
    choice = find(page, "first_use_model")
    choice.activated.emit(1)  # type: ignore[attr-defined]
    assert console.named("choose_model") == ["ollama:phi"]
    click(qtbot, find(page, "first_use_ask"))
    console.state.assistant.set(AssistantStatus("ready", "phi", answer="Hello there."))
    assert "“Hello there.”" in texts(page)


def test_it_comes_once_automatically_and_later_when_it_is_requested(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, settings: MemorySettings
) -> None:
    console.state.link.set(LinkStatus("connecting"))
    use: FirstUse = window.first_use
    use.begin(with_simulated_robot=False)
    assert find(window, "first_use").isVisible()
    qtbot.keyClick(window, Qt.Key.Key_Escape)
    assert window.findChild(SetUpPage).isHidden()
    assert settings.values[SET_UP_KEY] == "skipped"
    use.begin(with_simulated_robot=False)
    assert window.findChild(SetUpPage).isHidden(), "once is enough"
    window.actions_table.run("set_up")
    click(qtbot, find(window, "first_use_simulated"))
    assert console.calls[-1] == ("UseSimulatedRobot", intents.UseSimulatedRobot())
    assert settings.values[SET_UP_KEY] == "done"
    hint = find(window, "drive_hint")
    assert hint.accessibleName() == "Connecting to the robot…"
    assert hint.isVisible()
    console.state.link.set(LinkStatus("lost", "Simulated robot"))
    assert not hint.isVisible(), "an alarm says so"
    console.state.link.set(LinkStatus("connected", "Simulated robot"))
    window.focus_driving()
    assert hint.accessibleName() == "Hold W to drive, A or D to turn. Release the key to stop."
    window.focus_speak()
    assert "Alt" in hint.accessibleName(), "the keys that work now"


@pytest.mark.long("*-size1", "*-size2")
@pytest.mark.parametrize("size", [(683, 384), (1366, 768), (1920, 1080)])
@pytest.mark.parametrize("alarm_first", [True, False])
def test_an_alarm_is_seen_next_to_the_page(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, size: tuple[int, int], alarm_first: bool
) -> None:
    def lose_the_robot() -> None:
        console.state.link.set(replace(console.state.link.value, state="lost"))

    def in_sight(part: QWidget) -> bool:
        """True if nothing covers the part at its corners and its centre."""
        place = QRect(part.mapTo(window, QPoint()), part.size()).adjusted(4, 4, -4, -4)
        under = [window.childAt(at) for at in (place.topLeft(), place.center(), place.bottomRight())]
        return all(found is part or part.isAncestorOf(found) for found in under)

    window.resize(*size)
    acts = (lose_the_robot, window.show_set_up) if alarm_first else (window.show_set_up, lose_the_robot)
    for act in acts:
        act()
        for _ in range(5):
            QApplication.processEvents()
    page, line = window.findChild(SetUpPage), window.problems.line
    assert page.isVisible() and window.problems.isVisible() is not line.isVisible()
    seen = line if line.isVisible() else window.problems
    card = QRect(page.card.mapTo(window, QPoint()), page.card.size())
    assert in_sight(seen)
    assert not QRect(seen.mapTo(window, QPoint()), seen.size()).intersects(card)
    if seen is line:
        click(qtbot, line)
        assert page.isVisible() and in_sight(window.problems), "asked for, it is seen above the page"
        click(qtbot, line)
        assert not window.problems.isVisible()
    for choice in ("first_use_simulated", "first_use_own"):
        assert in_sight(find(page, choice)) or size[0] < 700
    page.close_overlay()
    assert in_sight(line if line.isVisible() else window.problems)


def drive(console: FakeConsole, x_m: float) -> None:
    console.state.add(Odometry(clock.now_ns(), None, Pose2D(x_m, 0.0, 0.0), Twist2D(0.3, 0.0, 0.0)))


def test_there_is_no_hint_where_nobody_may_drive(
    window: MainWindow, console: FakeConsole, settings: MemorySettings
) -> None:
    hint: DriveHint = window.first_use.hint
    window.first_use.begin(with_simulated_robot=True)
    assert hint.isVisible()
    may_drive = console.scenario
    permissions = dataclasses.replace(may_drive.permissions, driving=False)
    console.scenario = dataclasses.replace(may_drive, permissions=permissions)
    console.state.scenario.reset_value(console.scenario)
    assert not hint.isVisible()
    assert DRIVEN_KEY not in settings.values, "it is told as soon as somebody may"
    console.scenario = may_drive
    console.state.scenario.reset_value(console.scenario)
    assert hint.isVisible()


def test_the_hint_gives_way_to_an_emergency_stop(window: MainWindow, console: FakeConsole) -> None:
    window.first_use.hint.begin()
    assert window.first_use.hint.isVisible()
    console.emergency_stop()
    assert not window.first_use.hint.isVisible()
    console.clear_emergency_stop()
    assert window.first_use.hint.isVisible()
    console.set_guard(on=False)
    QApplication.processEvents()
    for name in ("guard_band", "drive_hint"):
        band = find(window, name)
        (words,) = band.findChildren(QLabel)
        assert words.height() >= words.heightForWidth(words.width()), "its whole text"


def test_the_hint_goes_with_the_first_metre(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, settings: MemorySettings
) -> None:
    hint: DriveHint = window.first_use.hint
    window.first_use.begin(with_simulated_robot=True)
    assert hint.isVisible()
    console.state.drive.set(DriveStatus(allowed=True))
    for x_m in (0.0, 2.0):
        drive(console, x_m)
    assert DRIVEN_KEY not in settings.values, "whoever carries it has not driven"
    console.state.drive.set(DriveStatus(allowed=True, target_forward_mps=0.3))
    for x_m in (2.2, 2.6, 2.9):
        drive(console, x_m)
    assert DRIVEN_KEY not in settings.values
    drive(console, 3.2)
    assert settings.values[DRIVEN_KEY] == "yes"
    assert "first metre" in hint.accessibleName()
    wanted: list[bool] = []
    hint.practise_requested.connect(lambda: wanted.append(True))
    click(qtbot, find(hint, "drive_hint_practise"))
    assert wanted == [True] and not hint.isVisible()
    window.first_use.begin(with_simulated_robot=True)
    assert not hint.isVisible(), "told once"
