"""Focus after each click, tab, float, close, switch and shortcut, with real key and mouse events."""

import dataclasses
import inspect
import os
import random
from collections.abc import Iterator

import pytest
import shiboken6
from PySide6.QtCore import QEvent, QPoint, QPointF, Qt, QTimer
from PySide6.QtGui import QDesktopServices, QKeyEvent, QKeySequence, QWheelEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QApplication,
    QComboBox,
    QDialog,
    QFileDialog,
    QLineEdit,
    QMenu,
    QMessageBox,
    QPlainTextEdit,
    QSlider,
    QTabBar,
    QTextEdit,
    QWidget,
)
from pytestqt.qtbot import QtBot

from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.live.status import SavedScenario, SpeechStatus, SuggestionsStatus
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.scenario.scenario_model import PanelLeaf, PanelName, SplitNode, TabNode
from caris_desktop.ui.banners import Hint
from caris_desktop.ui.focus_widget import bar_of, focused_widget, window_of
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.overlay import Overlay
from caris_desktop.ui.palette.command_palette import CommandPalette
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.popups import FloatingCard
from caris_desktop.ui.window_appearance import ENGLISH
from tests.support.window_classes import widget_classes, window_classes
from tests.ui import samples
from tests.ui.conftest import MemorySettings, find, open_window
from tests.ui.every_window import EveryWindow, Seen
from tests.ui.fake_console import FakeConsole

NONE = Qt.KeyboardModifier.NoModifier
SENTENCE = "was that a wide road 2 see?"
WORDS = [*SENTENCE.split(), "Mara", "Tom", "kitchen", "stop", "yes", "no", "/", "9", "Qt", "edge", "zoo", "can", "2"]
LONG = bool(os.environ.get("CARIS_TEST_LONG"))
SENTENCES = 200 if LONG else 1
BEGUN_IN = ["video_view", *(pytest.param(name, marks=pytest.mark.long) for name in ("speak_field", "nowhere"))]
"""Driving is the most critical state for a wrong key."""
CLICKS = 3
"""In each window besides the console's main window, without ``--long``."""
ASKED_BY_NOBODY = (
    "drive", "turn_head", "nod", "go_to_place", "go_to", "use_control", "push_to_talk", "say", "fill_gap", "say_answer",
    "say_suggestion", "say_edited_suggestion", "confirm_proposal", "open_scenario", "use_robot", "UseSimulatedRobot",
)  # fmt: skip
TABBED = dataclasses.replace(
    samples.TOUR,
    layout=SplitNode(
        "horizontal",
        (
            SplitNode("vertical", (PanelLeaf("video"), TabNode(("speak", "notes", "map"), "speak")), (0.6, 0.4)),
            TabNode(("conversation", "assistant", "people", "drive", "session", "photos"), "conversation"),
        ),
        (0.6, 0.4),
    ),
)


def focused() -> QWidget:
    widget = QApplication.focusWidget()
    assert widget is not None, "no widget has the keys"
    return widget


def panel_with_keys(window: MainWindow) -> str | None:
    holds = (name for name, dock in window.dock_host.docks.items() if dock.isAncestorOf(focused()))
    return next(holds, None)


def type_on(text: str = SENTENCE) -> None:
    """Type without looking: each key goes to the present focus, and Enter comes last."""
    for key in (*text, Qt.Key.Key_Return):
        for moved in (QTest.keyPress, QTest.keyRelease):  # a press may close its window
            target = QApplication.activePopupWidget() or focused_widget() or QApplication.activeWindow()
            if target is not None and shiboken6.isValid(target):  # otherwise its window has closed, and the key is lost
                moved(target, key)


def click(widget: QWidget, at: QPoint | None = None) -> None:
    """Click through the window, so that Qt determines the target and the focus."""
    window = window_of(widget)
    handle = window.windowHandle()
    assert handle is not None
    place = widget.mapTo(window, widget.rect().center() if at is None else at)
    QTest.mouseClick(handle, Qt.MouseButton.LeftButton, NONE, place)


def click_tab(window: MainWindow, name: PanelName) -> None:
    bar = next(bar for bar in window.dock_host.bars if name in bar.panels)
    index = bar.panels.index(name)
    if bar.isTabVisible(index):
        click(bar, bar.tabRect(index).center())
        return
    click(find(bar, "more_tabs"))  # no space for it
    menu = QApplication.activePopupWidget()
    assert isinstance(menu, QMenu)
    next(action for action in menu.actions() if action.text() == bar.tabText(index)).trigger()
    menu.close()


def asked(console: FakeConsole) -> list[str]:
    return [name for name, _arguments in console.calls if name in ASKED_BY_NOBODY]


# ---- saving in the scenario editor


@pytest.fixture
def edited(
    qtbot: QtBot, theme: Theme, settings: MemorySettings, tmp_path: object
) -> Iterator[tuple[MainWindow, FakeConsole]]:
    scenario = load_scenario(layouts_dir() / "tour-guide.yaml")
    console = FakeConsole(scenario)
    window = open_window(qtbot, console, settings, theme)
    window.editor.open()
    qtbot.waitUntil(lambda: window.editor.editor is not None)
    editor = window.editor.editor
    qtbot.waitUntil(lambda: QApplication.activeWindow() is editor)
    yield window, console
    window.editor.close()


@pytest.mark.parametrize("page", ["title", "text"])
@pytest.mark.long("title")
def test_saving_a_scenario_leaves_the_keys_in_its_editor(
    qtbot: QtBot, edited: tuple[MainWindow, FakeConsole], page: str
) -> None:
    window, console = edited
    editor = window.editor.editor
    assert editor is not None
    if page == "text":
        editor.show_page(editor.text_page)
        editor.text_page.editor.setFocus()
        QTest.keyClicks(editor.text_page.editor, "#")
    else:
        assert editor.reveal(("title",)) is not None
        QTest.keyClicks(focused(), "x")
    before = focused()
    QTest.keyClick(before, Qt.Key.Key_S, Qt.KeyboardModifier.ControlModifier)
    ((text, path, _edited, _replaces),) = console.named("save_scenario")
    console.state.saved_scenario.reset_value(SavedScenario(path, text, "1" * 64))
    changed = dataclasses.replace(console.scenario, title="Another", phrases=("One",), sha256="1" * 64)
    console.scenario = changed
    console.state.scenario.reset_value(changed)
    window.board.complete()
    QApplication.processEvents()
    assert QApplication.activeWindow() is editor
    assert focused() is before
    console.calls.clear()
    type_on()
    assert asked(console) == []


@pytest.mark.panels("video", "speak", "drive")
def test_a_scenario_that_changes_gives_the_keys_to_nobody_who_had_them_not(
    window: MainWindow, console: FakeConsole
) -> None:
    find(window, "speak_field").setFocus()
    console.state.scenario.reset_value(dataclasses.replace(console.scenario, title="Another", phrases=("One",)))
    window.board.complete()
    assert focused().objectName() == "speak_field"
    assert not window.actions_table.driving_focus


@pytest.mark.panels("video", "speak", "people")
def test_a_popup_closes_though_what_had_the_keys_before_is_gone(window: MainWindow, console: FakeConsole) -> None:
    """A changed scenario rebuilds its panels meanwhile."""
    people = window.panels["people"]
    for opened, closed in (
        (window.show_command_palette, window.hold.escape_pressed.emit),
        (window.marking.card.write_note, window.marking.card.close_card),
    ):
        field = QLineEdit(window)
        field.show()
        field.setFocus()
        opened()
        shiboken6.delete(field)
        closed()
        assert not window.findChild(CommandPalette).isVisible() and not window.marking.card.writes_note
    field = QLineEdit(window)
    field.show()
    field.setFocus()
    people.open_card(console.state.persons.value[0].person_id)
    people.card.setFocus()
    shiboken6.delete(field)
    people.card.close_card()
    assert people.card.isHidden()


def test_a_focused_widget_that_pyside_takes_for_deleted_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    field = QLineEdit()
    monkeypatch.setattr(QApplication, "focusWidget", lambda: field)
    assert focused_widget() is field
    shiboken6.delete(field)
    assert focused_widget() is None


# ---- clicks, tabs, floating and closing


@pytest.fixture
def tabbed(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> Iterator[tuple[MainWindow, FakeConsole]]:
    console = FakeConsole(TABBED, {samples.MENTAL.path: samples.MENTAL, TABBED.path: TABBED})
    yield open_window(qtbot, console, settings, theme), console


def test_a_click_on_a_tab_gives_the_keys_to_that_panels_main_field(tabbed: tuple[MainWindow, FakeConsole]) -> None:
    window, console = tabbed
    for bar in list(window.dock_host.bars):
        for name in (*bar.panels, *bar.panels):  # the second time it is already in front
            find(window, "video_view").setFocus()
            click_tab(window, name)
            panel = window.panels[name]
            assert focused() is panel.focus_target(), name
            assert window.actions_table.driving_focus == panel.drives
            if not panel.drives and name != "speak":
                console.calls.clear()
                type_on()
                assert asked(console) == [], name


def test_a_click_beside_the_tabs_gives_the_keys_to_the_panel_below(tabbed: tuple[MainWindow, FakeConsole]) -> None:
    window, _console = tabbed
    beside = 0
    for bar in list(window.dock_host.bars):
        at = QPoint(bar.width() - 4, bar.height() // 2)
        if bar.tabAt(at) < 0 and bar.childAt(at) is None:
            find(window, "speak_field").setFocus()
            QTest.mouseClick(bar, Qt.MouseButton.LeftButton, pos=at)
            assert focused() is window.panels[bar.panels[bar.currentIndex()]].focus_target()
            beside += 1
    assert beside


@pytest.mark.parametrize(
    "name",
    [
        "speak", "map", "drive",
        *(pytest.param(name, marks=pytest.mark.long) for name in ("conversation", "people", "assistant", "notes")),
    ],
)  # fmt: skip
def test_a_panel_that_floats_or_comes_back_or_is_moved_has_the_keys_in_its_main_field(
    tabbed: tuple[MainWindow, FakeConsole], name: PanelName
) -> None:
    window, _console = tabbed
    host = window.dock_host
    for act in (lambda: host.toggle_floating(name), lambda: host.toggle_floating(name),
                lambda: host.move_panel(name, "video", "below")):  # fmt: skip
        find(window, "video_view").setFocus()
        click_tab(window, name) if any(name in bar.panels for bar in host.bars) else None
        find(window, "video_view").setFocus()
        act()
        QApplication.processEvents()
        assert focused() is window.panels[name].focus_target()
        assert focused().isActiveWindow()


def test_no_panel_that_goes_leaves_the_keys_to_a_bar_or_to_driving(tabbed: tuple[MainWindow, FakeConsole]) -> None:
    window, console = tabbed
    for name in ("conversation", "assistant", "people", "session", "photos", "speak", "notes"):
        window.open_panel(name)
        window.board.focus(name)
        assert panel_with_keys(window) == name
        window.close_panel(name)
        QApplication.processEvents()
        assert bar_of(focused()) is None
        assert not window.actions_table.driving_focus
        assert focused() is window or focused().isVisible()
        console.calls.clear()
        if panel_with_keys(window) != "speak":
            type_on()
        assert asked(console) == [], name


@pytest.mark.panels("video", "speak", "people")
def test_a_field_that_goes_leaves_the_keys_in_its_panel(window: MainWindow) -> None:
    panel = window.panels["people"]
    panel._open_search()
    assert focused().objectName() == "people_search"
    panel._search.hide()
    assert focused() is panel.focus_target()


@pytest.mark.panels("video", "speak", "drive", "people")
@pytest.mark.parametrize("bar", ["top_bar", "status_bar", "dock_people", "dock_speak"])
def test_bare_keys_drive_no_longer_after_a_click_elsewhere(window: MainWindow, console: FakeConsole, bar: str) -> None:
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyPress(view, Qt.Key.Key_W)
    assert console.named("drive")
    click(find(window, bar), QPoint(find(window, bar).width() // 2, 3))
    assert console.named("release_drive")
    QTest.keyRelease(focused(), Qt.Key.Key_W)
    console.calls.clear()
    if bar != "dock_speak":
        type_on()
    assert asked(console) == []
    assert not window.actions_table.driving_focus
    click(view)
    assert window.actions_table.driving_focus


@pytest.mark.panels("video", "speak")
def test_driving_by_alt_continues_after_any_click(window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyPress(field, Qt.Key.Key_W, Qt.KeyboardModifier.AltModifier)
    click(find(window, "status_bar"), QPoint(3, 3))
    assert console.named("drive") and not console.named("release_drive")
    assert focused() is field, "a bar takes no keys"


@pytest.mark.panels("video", "speak")
def test_space_presses_what_stands_in_a_bar_only_for_who_went_there_by_tab(
    window: MainWindow, console: FakeConsole
) -> None:
    button = find(window, "window_menu_button")
    button.setFocus()
    for key in (Qt.Key.Key_Space, Qt.Key.Key_Return):
        QTest.keyClick(button, key)
        assert QApplication.activePopupWidget() is None
    button.clearFocus()
    button.setFocus(Qt.FocusReason.TabFocusReason)
    QTest.keyClick(button, Qt.Key.Key_Space)
    popup = QApplication.activePopupWidget()
    assert popup is not None
    popup.close()
    stop = find(window, "emergency_stop")
    stop.setFocus()
    QTest.keyClick(stop, Qt.Key.Key_Space)
    assert console.named("emergency_stop")


@pytest.mark.panels("video", "speak")
def test_a_window_that_comes_to_the_front_gives_nobody_the_keys_automatically(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    focused().clearFocus()
    other = QWidget()
    qtbot.addWidget(other)
    other.show()
    other.activateWindow()
    qtbot.waitUntil(lambda: QApplication.activeWindow() is other)
    window.activateWindow()
    qtbot.waitUntil(lambda: QApplication.activeWindow() is window)
    assert focused() is window
    type_on()
    assert asked(console) == []


# ---- a switch during a recording


@pytest.mark.panels("video", "speak")
def test_a_switch_that_ends_the_video_of_a_recording_asks(window: MainWindow, console: FakeConsole) -> None:
    blank, tour = layouts_dir() / "blank.yaml", layouts_dir() / "tour-guide.yaml"
    assert console.state.recording.value.state == "recording"
    window._open_scenario(blank)
    assert console.named("open_scenario") == []
    band = find(window, "question_band")
    assert "video" in band.accessibleName() and "Blank" in band.accessibleName()
    window.hold.escape_pressed.emit()
    assert not band.isVisible() and console.named("open_scenario") == []
    window._open_scenario(blank)
    click(find(window, "question_yes"))
    assert console.named("open_scenario") == [blank]
    window._open_scenario(tour)
    assert console.named("open_scenario") == [blank, tour], "it records all of it"
    console.state.recording.set(dataclasses.replace(console.state.recording.value, state="idle"))
    window._open_scenario(blank)
    assert console.named("open_scenario") == [blank, tour, blank], "nothing is recorded that would end"
    console.state.recording.set(dataclasses.replace(console.state.recording.value, state="paused"))
    window._open_scenario(samples.MENTAL.path or layouts_dir())
    assert console.named("open_scenario")[3:] == [samples.MENTAL.path], "who opens it says that it is not there"


# ---- generated: each clickable element, starting from driving, from typing, and without focus


def settle(window: MainWindow) -> None:
    """Close everything open and dismiss questions."""
    while (popup := QApplication.activePopupWidget()) is not None:
        popup.close()
    for widget in QApplication.topLevelWidgets():
        if widget.isVisible() and isinstance(widget, QDialog):
            widget.reject()
    window.hold.escape_pressed.emit()
    window.editor.close()
    for _ in range(3):
        QApplication.processEvents()
    window.activateWindow()


def clickable(window: MainWindow) -> list[QWidget]:
    """Each visible button, tab bar, panel, title bar and bar."""
    kinds = [*window.findChildren(QAbstractButton), *window.dock_host.bars, *window.panels.values()]
    kinds += [dock.title_bar for dock in window.dock_host.docks.values()]
    kinds += window.findChildren(QWidget, "top_bar") + window.findChildren(QWidget, "status_bar")
    return [widget for widget in kinds if widget.isVisible() and widget.isEnabled()]


# The first two stop the robot; a file dialog's button makes a folder in the home folder.
LEFT_OUT = {"emergency_stop", "stop_button", "newFolderButton"}


@pytest.mark.timeout(1800 if LONG else 120)
@pytest.mark.parametrize("begun_in", BEGUN_IN)
def test_after_no_click_do_sentences_drive_speak_or_switch(
    tabbed: tuple[MainWindow, FakeConsole], begun_in: str
) -> None:
    window, console = tabbed
    window.resize(1366, 768)
    chance = random.Random(25)  # noqa: S311
    count = 0
    for widget in clickable(window):
        if not shiboken6.isValid(widget) or not widget.isVisible() or widget.objectName() in LEFT_OUT:
            continue
        named = f"{type(widget).__name__} {widget.objectName()!r} {widget.accessibleName()!r}, begun in {begun_in}"
        holder = next((n for n, dock in window.dock_host.docks.items() if dock.isAncestorOf(widget)), None)
        of_a_bar = widget in window.dock_host.bars
        (window if begun_in == "nowhere" else find(window, begun_in)).setFocus()
        click(widget)
        QApplication.processEvents()
        in_front = QApplication.activePopupWidget() or QApplication.activeModalWidget()
        covered = any(card.isVisible() for card in window.findChildren(Overlay))
        assert bar_of(focused()) is None, named
        if in_front is None and not covered and QApplication.activeWindow() is window:
            asked_for = {"speak": {"say"}, "video": {"drive", "say", "turn_head", "go_to_place", "push_to_talk"}}
            drives = panel_with_keys(window) in ("video", "map", "drive")
            if drives:
                assert holder in ("video", "map", "drive") or of_a_bar, named
            may = asked_for["video"] if drives else asked_for.get(panel_with_keys(window) or "", set())
            for _ in range(SENTENCES):
                console.calls.clear()
                type_on(" ".join(chance.sample(WORDS, 5)))
                assert set(asked(console)) <= may, named
                count += 1
        settle(window)
        console.clear_emergency_stop()
    assert count >= SENTENCES * 20


# ---- impossible commands


def nobody_in_view(console: FakeConsole) -> None:
    console.state.persons.set(())


CTRL, SHIFT, ALT = (
    Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier, Qt.KeyboardModifier.AltModifier,
)  # fmt: skip


def hint_in(window: MainWindow) -> str:
    return next((hint.text() for hint in window.findChildren(Hint) if hint.isVisible()), "")


def not_recording(console: FakeConsole) -> None:
    console.state.recording.set(dataclasses.replace(console.state.recording.value, state="idle"))


def nothing_waits(console: FakeConsole) -> None:
    console.state.speech.set(SpeechStatus())
    console.state.suggestions.set(SuggestionsStatus())


def without_naming(console: FakeConsole) -> None:
    permitted = dataclasses.replace(console.scenario.permissions, naming_people=False)
    console.scenario = dataclasses.replace(console.scenario, permissions=permitted)
    console.state.scenario.reset_value(console.scenario)


IN_VAIN = {
    "name nobody": (nobody_in_view, Qt.Key.Key_I, CTRL, "Nobody is in view"),
    "name in a scenario without names": (
        without_naming,
        Qt.Key.Key_I,
        CTRL,
        "“Name the nearest person” is not available",
    ),
    "note without a recording": (not_recording, Qt.Key.Key_N, CTRL, "No recording is running"),
    "error without a recording": (not_recording, Qt.Key.Key_M, CTRL | SHIFT, "No recording is running"),
    "edit what is not suggested": (nothing_waits, Qt.Key.Key_1, CTRL | SHIFT, "suggestion is not available"),
    "say what is not suggested": (nothing_waits, Qt.Key.Key_2, CTRL, "suggestion is not available"),
    "change an empty queue": (nothing_waits, Qt.Key.Key_L, CTRL | SHIFT, "The speech queue is empty"),
}


@pytest.mark.panels("video", "speak", "people", "assistant")
@pytest.mark.parametrize("begun_in", BEGUN_IN[:2])
@pytest.mark.parametrize("case", IN_VAIN)
def test_a_refused_key_is_reported_and_types_nowhere(
    window: MainWindow, console: FakeConsole, case: str, begun_in: str
) -> None:
    happens, key, modifiers, hint = IN_VAIN[case]
    happens(console)
    window.board.complete()
    field = find(window, "speak_field")
    find(window, begun_in).setFocus()
    console.calls.clear()
    QTest.keyClick(focused(), key, modifiers)
    assert hint in hint_in(window)
    type_on("Mara Wade")
    assert field.property("plainText") == "" and asked(console) == []
    assert window.hold.key_owner == "nowhere"
    # Stops and key releases always work; Esc ends the block.
    QTest.keyClick(focused(), Qt.Key.Key_Escape)
    assert console.named("stop") and hint_in(window) == ""
    field.setFocus()
    type_on("Hello")
    assert console.named("say") == [("Hello", "typed")]
    # A click ends it too.
    happens(console)
    QTest.keyClick(focused(), key, modifiers)
    assert window.hold.keys_go_nowhere
    click(field)
    assert not window.hold.keys_go_nowhere and hint_in(window) == ""
    # And so does a pause.
    QTest.keyClick(focused(), key, modifiers)
    window.hold._nowhere.timeout.emit()
    window.hold._nowhere.stop()
    QTest.keyClicks(focused(), "x")
    assert field.property("plainText") == "x"


@pytest.mark.panels("video", "speak", "people")
def test_an_act_that_cannot_be_done_says_so_by_palette_and_gamepad_too(
    window: MainWindow, console: FakeConsole
) -> None:
    nobody_in_view(console)
    field = find(window, "speak_field")
    field.setFocus()
    console.calls.clear()
    window.show_command_palette()
    QTest.keyClicks(focused(), "name the nearest")
    QTest.keyClick(focused(), Qt.Key.Key_Return)
    assert "Nobody" in hint_in(window)
    type_on("Mara Wade")
    assert field.property("plainText") == "" and asked(console) == []
    QTest.keyClick(focused(), Qt.Key.Key_Escape)
    assert hint_in(window) == ""
    window.hold._on_gamepad_button("name_person")
    assert "Nobody" in hint_in(window)
    type_on("Hello")
    assert console.named("say") == [("Hello", "typed")], "the hands on a gamepad did not mean to type"


def test_a_panel_opened_by_the_menu_has_the_keys_in_its_main_field(tabbed: tuple[MainWindow, FakeConsole]) -> None:
    window, _console = tabbed
    find(window, "speak_field").setFocus()
    for name in ("assistant", "notes"):
        window.board.set_open(name, True)
        QApplication.processEvents()
        assert focused() is window.panels[name].focus_target()


@pytest.mark.panels("video", "speak", "people")
def test_a_key_that_drives_stays_with_driving_when_an_act_cannot_be_done(
    window: MainWindow, console: FakeConsole
) -> None:
    nobody_in_view(console)
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyPress(view, Qt.Key.Key_W)
    QTest.keyClick(view, Qt.Key.Key_I, CTRL)
    assert "Nobody is in view" in hint_in(window)
    QTest.keyPress(view, Qt.Key.Key_A)
    assert len(console.named("drive")) == 2, "who drives goes on steering"
    QTest.keyRelease(view, Qt.Key.Key_A)
    QTest.keyRelease(view, Qt.Key.Key_W)
    assert console.calls[-1] == ("release_drive", "")
    QTest.keyClick(view, Qt.Key.Key_I, CTRL)
    QTest.keyPress(view, Qt.Key.Key_W)
    assert len(console.named("drive")) == 3, "what is typed now is no driving"
    QTest.keyRelease(view, Qt.Key.Key_W)
    QTest.keyPress(view, Qt.Key.Key_W, ALT)
    assert len(console.named("drive")) == 4, "a chord is another act"
    QTest.keyRelease(view, Qt.Key.Key_W, ALT)


@pytest.mark.panels("video", "speak")
def test_keys_that_do_nothing_in_a_field_say_what_would(window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    QTest.keyPress(field, Qt.Key.Key_W)
    assert hint_in(window) == ""
    QApplication.sendEvent(field, QKeyEvent(QEvent.Type.KeyPress, Qt.Key.Key_W, NONE, 25, 0, 0, "w", True))
    assert "Hold Alt W to drive" in hint_in(window)
    window.hold.escape_pressed.emit()
    for key, character in ((Qt.Key.Key_F, "f"), (Qt.Key.Key_Space, " "), (Qt.Key.Key_7, "7")):
        QApplication.sendEvent(field, QKeyEvent(QEvent.Type.KeyPress, key, ALT, character))
        assert hint_in(window), character
        window.hold.escape_pressed.emit()
    assert field.property("plainText") in ("w", "ww")
    assert not window.hold.keys_go_nowhere and asked(console) == []


@pytest.mark.panels("video", "speak")
@pytest.mark.parametrize("modifiers", [NONE, SHIFT], ids=["talk", "dictate"])
def test_a_bare_key_opens_the_microphone_only_when_it_is_held(
    qtbot: QtBot, theme: Theme, settings: MemorySettings, modifiers: Qt.KeyboardModifier
) -> None:
    permitted = dataclasses.replace(samples.TOUR.permissions, own_voice=True, transcription=True, audio_recording=True)
    console = FakeConsole(dataclasses.replace(samples.TOUR, permissions=permitted))
    window = open_window(qtbot, console, settings, theme)
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_T, modifiers)
    assert not console.named("push_to_talk")
    assert "Hold" in hint_in(window)
    QTest.keyPress(view, Qt.Key.Key_T, modifiers)
    (timer,) = window.hold._about_to_talk.values()
    assert timer.interval() == 300
    qtbot.waitUntil(lambda: bool(console.named("push_to_talk")))
    QTest.keyRelease(view, Qt.Key.Key_T, modifiers)
    assert len(console.named("push_to_talk")) == 2
    QTest.keyPress(view, Qt.Key.Key_T, modifiers)
    find(window, "speak_field").setFocus()
    assert not window.hold._about_to_talk, "the panel in which it was pressed lost the keys"
    QTest.keyRelease(focused(), Qt.Key.Key_T, modifiers)
    assert len(console.named("push_to_talk")) == 2


# ---- the wheel


@pytest.mark.timeout(120)
def test_the_wheel_changes_nothing_that_the_pointer_only_rests_on(theme: Theme) -> None:
    """Tabs, too: a panel that is hidden loses what is typed next."""

    def value(part: QWidget) -> int:
        return part.value() if isinstance(part, QSlider) else part.currentIndex()  # type: ignore[attr-defined]

    kinds = (QSlider, QComboBox, QTabBar)
    opened = EveryWindow(theme, ENGLISH)
    turned: set[type[QWidget]] = set()
    try:
        for seen in opened.seen(with_what_is_beside=True):
            for part in [part for part in window_of(seen.part).findChildren(QWidget) if isinstance(part, kinds)]:
                if not (part.isVisible() and part.isEnabled()):
                    continue
                before = value(part)
                for turn in (120, -120):
                    turn_wheel(part, turn)
                    assert value(part) == before, f"{seen.name}: {name_of_part(part)}"
                turned.update(kind for kind in kinds if isinstance(part, kind))
    finally:
        opened.close()
    assert turned == set(kinds)


def turn_wheel(widget: QWidget, turn: int) -> None:
    at = QPointF(widget.rect().center())
    wheel = QWheelEvent(
        at, QPointF(widget.mapToGlobal(widget.rect().center())), QPoint(), QPoint(0, turn),
        Qt.MouseButton.NoButton, NONE, Qt.ScrollPhase.NoScrollPhase, False,
    )  # fmt: skip
    QApplication.sendEvent(widget, wheel)


# ---- generated: every other window, and every shortcut


class Walk:
    """Opens every window, clicks its parts and types. Before each one the focus is in ``begun_in``."""

    def __init__(self, theme: Theme, begun_in: str) -> None:
        self.opened = EveryWindow(theme, ENGLISH)
        self._begun_in = begun_in
        self._chance = random.Random(26)  # noqa: S311
        self.sentences = 0
        # Qt's file dialog blocks on its own questions.
        self._answers = QTimer(self.opened.window, interval=20)
        self._answers.timeout.connect(reject_message_box)
        self._answers.start()

    def parts(self) -> Iterator[Seen]:
        """Each part, with the focus reset before it opens."""
        parts = self.opened.seen(with_what_is_beside=True)
        while True:
            self._put_away(None)
            self.opened.window.activateWindow()
            find(self.opened.window, self._begun_in).setFocus(Qt.FocusReason.ShortcutFocusReason)
            seen = next(parts, None)
            if seen is None:
                return
            self.opened.settle()
            bring_to_front(seen.part)
            self.opened.settle()
            yield seen

    def click_in(self, seen: Seen, done: set[str]) -> None:
        """Click each part once, and type after each click, until the part is completed or closed."""
        if "" not in done and self._has_the_keys(seen.part):
            self._type(seen, "as it was opened")
        done.add("")
        parts = parts_to_click(seen.part) if is_there(seen.part) else []
        if not LONG:
            parts = self._chance.sample(parts, min(len(parts), CLICKS))
        for part in parts:
            if not is_there(part) or not can_be_clicked(part) or name_of_part(part) in done:
                continue
            done.add(named := name_of_part(part))
            click(part, part.visibleRegion().boundingRect().center())
            self.opened.settle()
            self._type(seen, named)
            if not is_there(seen.part):
                return
            self._put_away(seen.part)

    def _type(self, seen: Seen, after: str) -> None:
        for number in range(SENTENCES):
            if number and self.opened.window.actions_table.driving_focus:
                return  # Enter was the purpose of the window, and driving resumes
            consoles = self._consoles()
            may = self._may_be_asked(seen)
            for console in consoles:
                console.calls.clear()
            if number and isinstance(field := focused_widget(), QLineEdit):
                field.selectAll()  # replaced by the next sentence: each key is checked with the whole text
            type_on(" ".join(self._chance.sample(WORDS, 5)))
            self.opened.settle()
            found = {name for console in consoles for name in asked(console)} - may
            assert not found, f"{seen.name}, {after}: {sorted(found)}"
            self.sentences += 1
            if not is_there(seen.part):
                return

    def _consoles(self) -> list[FakeConsole]:
        return [self.opened.console, *([self.opened.replayed] if self.opened.replayed is not None else [])]

    def _has_the_keys(self, part: QWidget) -> bool:
        focused = QApplication.focusWidget()
        return focused is not None and (focused is part or part.isAncestorOf(focused))

    def _may_be_asked(self, seen: Seen) -> set[str]:
        window = self.opened.window
        if shiboken6.isValid(seen.part) and window.hold._is_driving_part(seen.part):
            return set(ASKED_BY_NOBODY)  # a card in the video or the map, which keeps the focus, also on closing
        speaks = (QApplication.focusWidget() or window).objectName() == "speak_field"
        return {"say"} if speaks else {"say", "go_to_place"} if seen.name == "palette" else set()

    def _put_away(self, kept: QWidget | None) -> None:
        """Close menus and file dialogs opened by a click."""
        while (popup := QApplication.activePopupWidget()) is not None:
            popup.close()
        for dialog in QApplication.topLevelWidgets():
            if isinstance(dialog, QFileDialog) and dialog.isVisible() and dialog is not kept:
                dialog.reject()
        if kept is not None:
            self.opened.settle()
            bring_to_front(kept)
            self.opened.settle()


def is_there(part: QWidget) -> bool:
    return shiboken6.isValid(part) and part.isVisible()


def bring_to_front(part: QWidget) -> None:
    window = window_of(part)
    if not window.windowFlags() & Qt.WindowType.WindowDoesNotAcceptFocus:
        window.activateWindow()


def reject_message_box() -> None:
    box = QApplication.activeModalWidget()
    if isinstance(box, QMessageBox):
        box.reject()


def parts_to_click(part: QWidget) -> list[QWidget]:
    kinds = (QAbstractButton, QLineEdit, QPlainTextEdit, QTextEdit, QComboBox, QTabBar, QAbstractItemView, QSlider)
    top = part  # deleting a floating window would make PySide drop its panels
    while (parent := top.parentWidget()) is not None:
        top = parent
    children = (child for child in top.findChildren(QWidget) if isinstance(child, kinds) and part.isAncestorOf(child))
    return [part, *(child for child in children if can_be_clicked(child))]


def can_be_clicked(part: QWidget) -> bool:
    return (
        part.isVisible() and part.isEnabled() and not part.visibleRegion().isEmpty()
        and part.objectName() not in LEFT_OUT
        and not part.testAttribute(Qt.WidgetAttribute.WA_TransparentForMouseEvents)
    )  # fmt: skip


def name_of_part(part: QWidget) -> str:
    return f"{type(part).__name__} {part.objectName() or part.accessibleName() or part.property('text')}"


NOT_WALKED = {
    "ClosingWindow": "shown while the program quits, when no key and no click is handled",
    "DragWords": "follows the pointer while a panel is dragged; it gets no click and no key",
    "Dock": "frame of a panel: walked in the main window and in a floating window",
}
"""Windows and cards that the walk omits, with the reason."""


def lies_over_the_window(kind: type[QWidget]) -> bool:
    """True if widgets of that class are raised above others and receive clicks."""
    names = {name for part in vars(kind).values() if inspect.isfunction(part) for name in part.__code__.co_names}
    if "raise_" not in names or "WA_TransparentForMouseEvents" in names or kind.__subclasses__():
        return False
    return "self.raise_()" in inspect.getsource(kind)


@pytest.mark.timeout(300)
def test_the_walk_comes_to_every_window_dialog_and_card_of_the_program(theme: Theme) -> None:
    opened = EveryWindow(theme, ENGLISH)
    try:
        walked = [seen.part for seen in opened.seen(with_what_is_beside=True)]
        kinds = {type(part).__name__ for part in walked}
        # One class of card is used in several places with different names.
        names = {part.objectName() for part in walked if isinstance(part, FloatingCard) and shiboken6.isValid(part)}
        cards = {card.objectName() for card in opened.window.findChildren(FloatingCard)}
    finally:
        opened.close()
    wanted = {kind.__name__ for kind in {*window_classes(), *filter(lies_over_the_window, widget_classes())}}
    assert wanted - kinds == set(NOT_WALKED)
    assert cards <= names


@pytest.mark.timeout(4 * 3600 if LONG else 120)
@pytest.mark.parametrize("begun_in", ["video_view", pytest.param("speak_field", marks=pytest.mark.long)])
def test_no_window_drives_speaks_or_switches_by_what_is_typed_after_a_click_in_it(
    theme: Theme, begun_in: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Any unblocked key moves the robot or is spoken. Windows closed by a click are reopened with ``--long``."""
    monkeypatch.setattr(QDesktopServices, "openUrl", lambda _url: True)
    clicked: dict[str, set[str]] = {}
    while True:
        before = sum(map(len, clicked.values()))
        walk = Walk(theme, begun_in)
        try:
            for seen in walk.parts():
                if not LONG and seen.name.startswith("scenario, ") and seen.name not in ("scenario, 0", "scenario, 12"):
                    continue  # a form like the first, and the text
                walk.click_in(seen, clicked.setdefault(seen.name, set()))
        finally:
            walk.opened.close()
        assert walk.sentences or clicked
        if not LONG or sum(map(len, clicked.values())) == before:
            break
    assert sum(map(len, clicked.values())) > 120


@pytest.mark.parametrize("begun_in", BEGUN_IN)
def test_after_each_shortcut_what_is_typed_goes_where_it_says(
    tabbed: tuple[MainWindow, FakeConsole], begun_in: str
) -> None:
    window, console = tabbed
    chance = random.Random(27)  # noqa: S311
    for spec in window.actions_table.all_specs:
        if spec.kind in ("safety", "hold", "talk") or spec.within or spec.by_position:
            continue
        for key in spec.keys:
            (window if begun_in == "nowhere" else find(window, begun_in)).setFocus()
            chord = QKeySequence(key)[0]
            QTest.keyClick(focused(), chord.key(), chord.keyboardModifiers())
            QApplication.processEvents()
            named = f"{spec.id} by {key}, begun in {begun_in}"
            covered = any(card.isVisible() for card in window.findChildren(Overlay))
            in_front = QApplication.activePopupWidget() or QApplication.activeModalWidget()
            assert bar_of(focused()) is None, named
            if in_front is None and not covered:
                panel = panel_with_keys(window)
                if begun_in != "video_view" and spec.id != "focus_driving":
                    assert not window.actions_table.driving_focus, named
                console.calls.clear()
                drives = window.actions_table.driving_focus
                type_on(" ".join(chance.sample(WORDS, 4)))
                may = {"say"} if panel == "speak" else set(ASKED_BY_NOBODY) - {"open_scenario"}
                if not drives and panel != "speak":
                    may = set()
                assert set(asked(console)) <= may, named
            settle(window)
            console.clear_emergency_stop()
