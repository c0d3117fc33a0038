"""Notes panel: written while driving, stamped with the start of typing, edited and restored."""

from dataclasses import replace

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.live.status import RecordingStatus
from caris_desktop.recording.session.session_marks import FinalMark
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.notes_panel import NotesPanel
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("speak")

KEYPAD, CTRL = Qt.KeyboardModifier.KeypadModifier, Qt.KeyboardModifier.ControlModifier


@pytest.fixture
def panel(window: MainWindow, console: FakeConsole) -> NotesPanel:
    console.state.recording.set(RecordingStatus("recording"))
    window.open_panel("notes")
    panel = window.panels["notes"]
    assert isinstance(panel, NotesPanel)
    panel.field.setFocus()
    console.calls.clear()
    return panel


def write(panel: NotesPanel, text: str) -> None:
    QTest.keyClicks(panel.field, text)
    QTest.keyClick(panel.field, Qt.Key.Key_Return)


def shown(panel: NotesPanel) -> list[str]:
    return [str(panel.model.index(row, 0).data()) for row in range(panel.model.rowCount())]


def choose(panel: NotesPanel, row: int) -> None:
    place = panel.view.visualRect(panel.model.index(row, 0)).center()
    QTest.mouseClick(panel.view.viewport(), Qt.MouseButton.LeftButton, pos=place)


def test_a_note_is_written_while_driving_and_is_of_the_moment_at_which_it_began(
    panel: NotesPanel, window: MainWindow, console: FakeConsole
) -> None:
    QTest.keyPress(panel.field, Qt.Key.Key_Up, KEYPAD)
    assert window.hold.held == {"drive_forward"}
    QTest.keyClicks(panel.field, "A")
    began_ns = console.state.present.now_ns()
    QTest.keyClicks(panel.field, "sks twice #confused")
    QTest.keyClick(panel.field, Qt.Key.Key_Return)
    assert window.hold.held == {"drive_forward"}
    QTest.keyRelease(panel.field, Qt.Key.Key_Up, KEYPAD)
    (note,) = console.state.notes.value
    assert (note.kind, note.note, note.tags) == ("note", "Asks twice #confused", ("confused",))
    assert note.start_ns <= began_ns < note.marked_ns
    assert shown(panel) == ["Asks twice #confused"]
    assert (panel.field.text(), panel.fact[0]) == ("", "1 note")


def test_changed_and_removed_notes_can_be_restored(panel: NotesPanel, console: FakeConsole) -> None:
    write(panel, "Asks twise")
    write(panel, "Laughs")
    assert panel.field.hasFocus()
    choose(panel, 0)
    assert panel.field.hasFocus(), "a click takes the keys from nothing"
    panel.change_current()
    panel.field.clear()
    write(panel, "Asks twice")
    assert shown(panel) == ["Asks twice", "Laughs"]
    assert console.state.notes.value[0].rewritten
    choose(panel, 1)
    panel.view.setFocus()
    QTest.keyClick(panel.view, Qt.Key.Key_Delete)
    assert shown(panel) == ["Asks twice"]
    QTest.keyClick(panel.view, Qt.Key.Key_Z, CTRL)
    assert shown(panel) == ["Asks twice", "Laughs"]
    panel.undo()
    assert shown(panel) == ["Asks twise", "Laughs"]


def test_without_a_recording_what_was_written_stays_in_the_line(panel: NotesPanel, console: FakeConsole) -> None:
    console.state.recording.set(RecordingStatus("idle"))
    write(panel, "Asks twice")
    assert (panel.field.text(), shown(panel)) == ("Asks twice", [])


def test_escape_gives_up_changing(panel: NotesPanel, console: FakeConsole) -> None:
    write(panel, "Laughs")
    choose(panel, 0)
    panel.change_current()
    assert panel.field.text() == "Laughs"
    QTest.keyClick(panel.field, Qt.Key.Key_Escape)
    assert (panel.field.text(), shown(panel), console.named("change_note")) == ("", ["Laughs"], [])


def test_a_click_in_a_replay_goes_to_the_moment(qtbot: QtBot, panel: NotesPanel, console: FakeConsole) -> None:
    state = console.state
    state.present = replace(state.present, live=False)
    state.notes.set((FinalMark("m-1", "Laughs", "mark", 5_000_000_000, None, "at the arm", 6_000_000_000),))
    assert shown(panel) == ["Laughs: at the arm"]
    assert not panel.field.isVisible()
    with qtbot.waitSignal(panel.moment_requested) as wanted:
        choose(panel, 0)
    assert wanted.args == [5_000_000_000]


def test_notes_of_the_scenario_fold_away(window: MainWindow, console: FakeConsole) -> None:
    console.scenario = replace(console.scenario, notes="Hand over at once when somebody asks for a person.")
    window.show_scenario(console.scenario)
    window.open_panel("notes")
    panel = window.panels["notes"]
    text, fold = panel.findChild(QWidget, "notes_of_study"), find(window, "notes_fold")
    assert text is not None
    shown = text.isVisible()
    for expected in (not shown, shown):
        QTest.mouseClick(fold, Qt.MouseButton.LeftButton)
        assert text.isVisible() is expected
        assert fold.accessibleName().startswith("Hide" if expected else "Show")
