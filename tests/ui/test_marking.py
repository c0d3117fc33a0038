"""Marks by key: moments, intervals, corrections, notes and wizard errors, in every focus."""

import dataclasses

import pytest
from PySide6.QtCore import QEvent, QPoint, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.events import Marked, Problem
from caris_desktop.robot.profile import load_profile
from caris_desktop.robot.profile_model import HeadInterface
from caris_desktop.scenario.scenario_model import ERROR_KEYS, ErrorKind, RecordingSettings
from caris_desktop.ui.action_rows import ACTIONS
from caris_desktop.ui.dock_area import PanelTitleBar
from caris_desktop.ui.key_choices import position_codes
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.frame_view import FrameView
from tests.ui import samples
from tests.ui.conftest import MemorySettings, click, find, open_window, with_marked_panels
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("video", "speak", "session")

LABELS = ("Interested", "Confused", "Laughs")
CTRL, SHIFT, ALT, NONE = (
    Qt.KeyboardModifier.ControlModifier,
    Qt.KeyboardModifier.ShiftModifier,
    Qt.KeyboardModifier.AltModifier,
    Qt.KeyboardModifier.NoModifier,
)


@pytest.fixture
def console(request: pytest.FixtureRequest) -> FakeConsole:
    tour = with_marked_panels(request, samples.TOUR)
    return FakeConsole(dataclasses.replace(tour, recording=RecordingSettings(LABELS)))


@pytest.fixture
def window(qtbot: QtBot, console: FakeConsole, settings: MemorySettings, theme: Theme) -> MainWindow:
    window = open_window(qtbot, console, settings, theme)
    console.marks.clear()
    return window


@pytest.fixture(params=["video_view", "typing and driving", "the number pad drives"])
def focused(request: pytest.FixtureRequest, window: MainWindow, console: FakeConsole) -> QWidget:
    """Typing, driving, and typing while a drive key is held."""
    widget = find(window, "video_view" if request.param == "video_view" else "speak_field")
    widget.setFocus()
    if request.param == "typing and driving":
        QTest.keyPress(widget, Qt.Key.Key_W, ALT)
    elif request.param == "the number pad drives":
        QTest.keyPress(widget, Qt.Key.Key_Up, Qt.KeyboardModifier.KeypadModifier)
    console.calls.clear()
    return widget


def alt_of(console: FakeConsole, window: MainWindow) -> Qt.KeyboardModifier:
    """Alt if it is held for Alt+W, so that it modifies each key."""
    return ALT if "drive_forward" in window.hold.held else NONE


@pytest.mark.parametrize("size", [(1366, 768), (1920, 1080)])
def test_no_mark_hides_what_a_glance_reads(
    window: MainWindow, console: FakeConsole, qtbot: QtBot, size: tuple[int, int]
) -> None:
    window.resize(*size)
    QTest.keyClick(find(window, "speak_field"), Qt.Key.Key_M, CTRL)
    card, view = find(window, "mark_card"), window.panels["video"].focus_target()
    assert isinstance(view, FrameView)
    for _text, _role, chip in view._chip_places():
        assert not card.geometry().intersects(chip.toRect().translated(view.mapTo(window, QPoint())))
    recording = find(window, "record_button")
    assert card.geometry().top() > recording.mapTo(window, recording.rect().bottomLeft()).y()


@pytest.mark.panels("video", "map", "conversation", "speak")
@pytest.mark.parametrize("pictured", [True, False])
@pytest.mark.parametrize("size", [(1366, 768), (1920, 1080)])
def test_a_mark_covers_no_title_or_control_of_a_panel(
    window: MainWindow, console: FakeConsole, size: tuple[int, int], pictured: bool
) -> None:
    if not pictured:
        window.board.close("video")
    window.resize(*size)
    QApplication.processEvents()
    for key in (Qt.Key.Key_M, Qt.Key.Key_N):
        QTest.keyClick(find(window, "speak_field"), key, CTRL)
        QApplication.processEvents()
        card = find(window, "mark_card")
        assert card.isVisible()
        for bar in window.dock_host.findChildren(PanelTitleBar):
            for part in (part for part in bar.findChildren(QWidget) if part.isVisible()):
                place = part.rect().translated(part.mapTo(window, QPoint()))
                assert not card.geometry().intersects(place), f"{bar.parent().objectName()}: {part.objectName()}"
        if pictured:
            dock = find(window, "dock_video")
            assert dock.rect().translated(dock.mapTo(window, QPoint())).contains(card.geometry())
        for text in (text for text in card.findChildren(QLabel) if text.isVisible()):
            assert text.height() >= text.heightForWidth(text.width()), "the whole text is shown"


@pytest.mark.panels("video", "speak")
def test_a_mark_covers_no_alarm(window: MainWindow, console: FakeConsole) -> None:
    window.resize(640, 700)
    console.state.add(Problem(1, "error", "No video from the camera.", "You cannot see.", "Do not drive."))
    QApplication.processEvents()
    assert window.problems.isVisible()
    QTest.keyClick(find(window, "speak_field"), Qt.Key.Key_M, CTRL)
    QApplication.processEvents()
    card, alarms = find(window, "mark_card"), window.problems
    place = alarms.rect().translated(alarms.mapTo(window, QPoint()))
    assert alarms.isHidden() or not place.intersects(card.geometry())
    assert alarms.isVisible() or find(window, "problem_line").isVisible()


def present(console: FakeConsole) -> list[Marked]:
    return [mark for mark in console.marks.values() if mark.state != "withdrawn"]


def hold(qtbot: QtBot, widget: QWidget, key: Qt.Key, modifiers: Qt.KeyboardModifier, console: FakeConsole) -> None:
    """Hold the key with its repeats until the interval has started, and release it."""
    QTest.keyPress(widget, key, modifiers)
    for _ in range(3):
        repeat = QKeyEvent(QEvent.Type.KeyPress, key, modifiers, "", True)
        QApplication.sendEvent(widget, repeat)
    qtbot.waitUntil(lambda: bool(console.named("stretch_mark")), timeout=2000)
    QTest.keyRelease(widget, key, modifiers)


@pytest.mark.long("video_view", "the number pad drives")
def test_a_tap_marks_the_moment_at_once(focused: QWidget, window: MainWindow, console: FakeConsole) -> None:
    held = window.hold.held
    alt = alt_of(console, window)
    QTest.keyPress(focused, Qt.Key.Key_M, CTRL | alt)
    assert console.calls == [("mark", ("", "mark"))], "at the press, not at the release"
    QTest.keyRelease(focused, Qt.Key.Key_M, CTRL | alt)
    QTest.keyClick(focused, Qt.Key.Key_F2, SHIFT | alt)
    assert console.calls == [("mark", ("", "mark")), ("mark", ("Confused", "mark"))]
    assert window.hold.held == held, "driving goes on"
    assert "Marked: Confused" in window.marking.card.text
    assert QApplication.focusWidget() is focused, "the card takes no focus"


@pytest.mark.long("video_view", "the number pad drives")
def test_a_held_key_is_an_interval(qtbot: QtBot, focused: QWidget, window: MainWindow, console: FakeConsole) -> None:
    hold(qtbot, focused, Qt.Key.Key_F1, SHIFT | alt_of(console, window), console)
    assert [name for name, _ in console.calls] == ["mark", "stretch_mark", "end_mark"]
    (stretch,) = present(console)
    assert (stretch.label, stretch.state) == ("Interested", "done")
    assert stretch.start_ns is not None
    assert stretch.end_ns is not None
    assert (stretch.end_ns - stretch.start_ns) / 1e9 > 0.3, "it began with the press"


def test_the_bare_key_marks_with_the_driving_focus(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyPress(view, Qt.Key.Key_W)
    hold(qtbot, view, Qt.Key.Key_M, NONE, console)
    assert window.hold.held == {"drive_forward"}
    assert [mark.state for mark in present(console)] == ["done"]
    QTest.keyRelease(view, Qt.Key.Key_W)


@pytest.mark.long("video_view", "the number pad drives")
def test_an_interval_by_two_presses(focused: QWidget, window: MainWindow, console: FakeConsole) -> None:
    alt = alt_of(console, window)
    QTest.keyClick(focused, Qt.Key.Key_R, CTRL | alt)
    assert console.state.marks.value.open
    assert "Interval · 0:0" in window.marking.card.text
    QTest.keyClick(focused, Qt.Key.Key_R, CTRL | alt)
    assert [name for name, _ in console.calls] == ["begin_mark", "end_mark"]
    assert not console.state.marks.value.open


@pytest.mark.long("video_view", "the number pad drives")
def test_it_was_earlier_and_earlier_still(focused: QWidget, window: MainWindow, console: FakeConsole) -> None:
    alt = alt_of(console, window)
    QTest.keyClick(focused, Qt.Key.Key_F1, SHIFT | alt)
    (mark,) = present(console)
    QTest.keyClick(focused, Qt.Key.Key_J, CTRL | alt)
    QTest.keyClick(focused, Qt.Key.Key_J, CTRL | alt)
    (moved,) = present(console)
    assert moved.start_ns == mark.stamp_ns - 6_000_000_000
    assert "moved 6 s earlier" in window.marking.card.text
    QTest.keyClick(focused, Qt.Key.Key_J, CTRL | SHIFT | alt)
    assert present(console) == []
    assert "Mark removed" in window.marking.card.text


def test_alt_is_for_driving_also_when_driving_has_ended_automatically(window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyPress(field, Qt.Key.Key_W, ALT)
    window.hold.release_all("The console stopped responding for a moment")
    console.calls.clear()
    QTest.keyClick(field, Qt.Key.Key_N, CTRL | ALT)
    assert window.marking.card.writes_note
    QTest.keyRelease(field, Qt.Key.Key_W, ALT)


@pytest.mark.long("video_view", "the number pad drives")
def test_a_note_keeps_the_moment_of_its_key(
    qtbot: QtBot, focused: QWidget, window: MainWindow, console: FakeConsole
) -> None:
    held = window.hold.held if focused.objectName() != "video_view" else frozenset()
    QTest.keyClick(focused, Qt.Key.Key_N, CTRL | alt_of(console, window))
    field = find(window, "note_field")
    assert field.hasFocus()
    QTest.keyPress(field, Qt.Key.Key_A, ALT)
    assert window.hold.held == held | {"turn_left"}, "driving by Alt goes on"
    QTest.keyRelease(field, Qt.Key.Key_A, ALT)
    qtbot.wait(60)
    QTest.keyClicks(field, "looks at the door")
    QTest.keyClick(field, Qt.Key.Key_Return)
    (note,) = present(console)
    assert (note.kind, note.note) == ("note", "looks at the door")
    assert note.start_ns is not None
    assert note.start_ns <= note.stamp_ns - 60_000_000
    assert QApplication.focusWidget() is focused


def test_escape_leaves_a_note(window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyClick(field, Qt.Key.Key_N, CTRL)
    note = find(window, "note_field")
    QTest.keyClicks(note, "nothing")
    QTest.keyClick(note, Qt.Key.Key_Escape)
    assert console.calls == [("stop", None)]
    assert not window.marking.card.isVisible()
    assert field.hasFocus()


@pytest.mark.long("video_view", "the number pad drives")
def test_a_wizard_error_takes_two_keystrokes(focused: QWidget, window: MainWindow, console: FakeConsole) -> None:
    held, alt = window.hold.held, alt_of(console, window)
    for key, modifiers, label in (
        (Qt.Key.Key_F, NONE, "slip"),
        (Qt.Key.Key_G, SHIFT, "late"),
        (Qt.Key.Key_H, CTRL | SHIFT, "wrong branch"),
    ):
        console.calls.clear()
        console.marks.clear()
        QTest.keyClick(focused, Qt.Key.Key_M, CTRL | SHIFT | alt)
        (error,) = present(console)
        assert (error.kind, error.label) == ("wizard_error", "")
        QTest.keyClick(focused, key, modifiers | alt)
        (told,) = present(console)
        assert (told.label, told.start_ns) == (label, error.stamp_ns)
        assert window.hold.held == held
        assert [name for name, _ in console.calls] == ["mark", "change_mark"]
        assert find(window, "speak_field").property("text") == "", "the letter is not typed"
    QTest.keyClick(focused, Qt.Key.Key_G, alt)
    assert len(console.named("change_mark")) == 1, "the next one is a letter again"


def test_drive_keys_drive_while_a_wizard_error_is_reported(window: MainWindow, console: FakeConsole) -> None:
    head = HeadInterface("joint_trajectory", "/head", "pan", "tilt")
    console.state.robot.set(dataclasses.replace(load_profile("simulated"), head=head))
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_M, SHIFT)
    assert window.marking.card.text.startswith("Wizard error · what kind?")
    console.calls.clear()
    for key in "WASDIJKL":
        code = Qt.Key(ord(key))
        QTest.keyPress(view, code)
        assert len(window.hold.held) == 1, f"{key} belongs to driving"
        QTest.keyRelease(view, code)
    assert len(console.named("drive")) == 4
    assert console.named("change_mark") == []
    QTest.keyPress(view, Qt.Key.Key_W)
    QTest.keyClick(view, Qt.Key.Key_H)
    assert [label for _, label, *_ in console.named("change_mark")] == ["wrong branch"], "driving is no answer"
    assert window.hold.held == {"drive_forward"}
    QTest.keyRelease(view, Qt.Key.Key_W)


def test_no_kind_of_wizard_error_has_a_key_of_anything_else() -> None:
    bare = {key for spec in ACTIONS for key in spec.driving_keys}
    assert bare >= {"W", "S", "L", "1", "M"}
    assert not bare & set(ERROR_KEYS)
    assert set(ERROR_KEYS) <= set(position_codes("linux")), "known by their place, as those are"


def test_a_scenario_has_kinds_of_wizard_error_of_its_own(window: MainWindow, console: FakeConsole) -> None:
    errors = ("Interrupts", ErrorKind("Too close", "You drove closer than a metre."), "Wrong language", "Other")
    console.scenario = dataclasses.replace(console.scenario, recording=RecordingSettings(LABELS, errors=errors))
    console.state.scenario.set(console.scenario)
    view = find(window, "video_view")
    view.setFocus()
    for key, label in ((Qt.Key.Key_G, "Too close"), (Qt.Key.Key_R, "Other")):
        QTest.keyClick(view, Qt.Key.Key_M, SHIFT)
        assert find(window, "mark_card_Too_close").toolTip() == "You drove closer than a metre."
        QTest.keyClick(view, key)
        assert console.named("change_mark")[-1][1] == label
    QTest.keyClick(view, Qt.Key.Key_M, SHIFT)
    QTest.keyClick(view, Qt.Key.Key_U)
    assert len(console.named("change_mark")) == 2, "there is no fifth kind"


def test_the_card_shows_the_keys_that_work(window: MainWindow, console: FakeConsole) -> None:
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_M, SHIFT)
    caps = [find(window, f"mark_card_{name}") for name in ("slip", "late", "wrong_branch")]
    assert [cap.key for cap in caps] == ["F", "G", "H"]  # type: ignore[attr-defined]
    window.actions_table.use_letters({"F": "Φ"})
    assert caps[0].key == "Φ"  # type: ignore[attr-defined]
    # If the layout types another letter with that key, the key still works.
    press = QKeyEvent(QEvent.Type.KeyPress, Qt.Key.Key_U, NONE, position_codes("linux")["F"], 0, 0, "")
    assert window.hold.eventFilter(view, press)
    assert [label for _, label, *_ in console.named("change_mark")] == ["slip"]


def test_any_other_key_does_what_it_always_does(window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    for key, modifiers, expected in (
        (Qt.Key.Key_F2, NONE, ("say", ("Please follow me.", "phrase"))),
        (Qt.Key.Key_P, CTRL, ("take_photo", None)),
    ):
        console.calls.clear()
        QTest.keyClick(field, Qt.Key.Key_M, CTRL | SHIFT)
        QTest.keyClick(field, key, modifiers)
        assert console.calls == [("mark", ("", "wizard_error")), expected]
        assert not window.marking.card.isVisible()
        QTest.keyClick(field, Qt.Key.Key_F)
    QTest.keyClick(field, Qt.Key.Key_M, CTRL | SHIFT)
    QTest.keyClick(field, Qt.Key.Key_A)
    QTest.keyClick(field, Qt.Key.Key_G)
    assert field.property("text") == "ffag"
    QTest.keyClick(field, Qt.Key.Key_M, CTRL | SHIFT)
    QTest.keyPress(field, Qt.Key.Key_W, ALT)
    assert window.hold.held == {"drive_forward"}
    QTest.keyRelease(field, Qt.Key.Key_W, ALT)


def test_the_answer_is_waited_for_five_seconds(window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyClick(field, Qt.Key.Key_M, CTRL | SHIFT)
    assert window.marking._answer_time.interval() == 5000
    window.marking._answer_time.timeout.emit()
    QTest.keyClick(field, Qt.Key.Key_F)
    assert field.property("text") == "f"
    assert console.named("change_mark") == []


def test_a_click_into_a_field_ends_the_question_for_the_kind(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    view, field = find(window, "video_view"), find(window, "speak_field")
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_M, SHIFT)
    click(qtbot, field)
    QTest.keyClicks(field, "fine")
    assert field.property("text") == "fine"
    assert console.named("change_mark") == []


def test_the_card_corrects_a_mark_with_the_mouse(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_M)
    click(qtbot, find(window, "mark_card_label_3"))
    click(qtbot, find(window, "mark_card_earlier"))
    (mark,) = present(console)
    assert (mark.label, mark.start_ns) == ("Laughs", mark.start_ns)
    click(qtbot, find(window, "mark_card_note"))
    QTest.keyClicks(find(window, "note_field"), "at the arm")
    click(qtbot, find(window, "note_keep"))
    (mark,) = present(console)
    assert (mark.label, mark.note, mark.kind) == ("Laughs", "at the arm", "mark")
    click(qtbot, find(window, "mark_card_undo"))
    assert present(console) == []
    assert not window.actions_table.driving_focus, "bare keys drive no longer after a click elsewhere"


@pytest.mark.long
def test_labels_that_the_scenario_does_not_have_have_no_key(window: MainWindow, console: FakeConsole) -> None:
    assert window.actions_table.spec("label_3") is not None
    assert window.actions_table.spec("label_4") is None
    QTest.keyClick(find(window, "speak_field"), Qt.Key.Key_F4, SHIFT)
    assert console.calls == []


def test_an_interval_ends_when_another_program_gets_the_release(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyPress(field, Qt.Key.Key_F1, SHIFT)
    qtbot.waitUntil(lambda: bool(console.named("stretch_mark")), timeout=2000)
    window.hold._on_application_state_changed(Qt.ApplicationState.ApplicationInactive)
    assert not console.state.marks.value.open
    assert [mark.state for mark in present(console)] == ["done"]


def test_the_end_of_the_recording_ends_what_the_card_offers(window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyClick(field, Qt.Key.Key_M, CTRL)
    console.stop_session()
    assert not window.marking.card.isVisible()
    console.state.recording.set(dataclasses.replace(console.state.recording.value, state="recording"))
    QTest.keyClick(field, Qt.Key.Key_N, CTRL)
    console.stop_session()
    note = find(window, "note_field")
    QTest.keyClicks(note, "too late")
    console.calls.clear()
    QTest.keyClick(note, Qt.Key.Key_Return)
    assert console.calls == []
    assert window.marking.card.text == "The note was not saved. No recording is running."


def test_nothing_is_marked_while_paused(window: MainWindow, console: FakeConsole) -> None:
    console.pause_session(paused=True)
    console.calls.clear()
    field = find(window, "speak_field")
    for key, modifiers in ((Qt.Key.Key_M, CTRL), (Qt.Key.Key_F1, SHIFT), (Qt.Key.Key_N, CTRL), (Qt.Key.Key_R, CTRL)):
        QTest.keyClick(field, key, modifiers)
    assert console.calls == []
    assert not window.marking.card.isVisible()
