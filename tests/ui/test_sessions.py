"""Sessions: start, pause, search and export, with reports of disk space and missing data."""

import dataclasses
import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from PySide6.QtCore import QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QComboBox, QFileDialog, QLabel, QLineEdit, QProgressBar, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.events import Marked, StopRequested, TrialDetails, UtteranceChanged
from caris_desktop.domain.translation import tr
from caris_desktop.live.services.load_shedding_service import STEPS
from caris_desktop.live.status import ExportStatus, LibraryStatus, LoadStatus, RecordingStatus
from caris_desktop.live.wizard_console import BeforeRecording
from caris_desktop.recording.csv_cells import SHOWN, CsvStyle
from caris_desktop.recording.session.loss_messages import read_loss
from caris_desktop.recording.session_export import FORMATS
from caris_desktop.recording.studies.study_query import SearchHit, SessionEntry, SessionQuery
from caris_desktop.robot.profile_model import AudioInterface, RobotProfile
from caris_desktop.scenario.scenario_model import (
    BlurSettings,
    PanelLeaf,
    Permissions,
    RecordingSettings,
    SplitNode,
    panels_in,
)
from caris_desktop.ui.export_dialog import ExportDialog
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.session_panel import SessionPanel
from caris_desktop.ui.sessions_window import COLUMNS, SessionsWindow, lacks_words
from caris_desktop.ui.start_dialog import StartDialog, contents_sentence, last_details
from caris_desktop.ui.text_formatting import local_time
from caris_desktop.ui.theme import Theme
from tests.support.window_check import cut_off
from tests.ui import samples
from tests.ui.conftest import MemorySettings, click, find, open_window
from tests.ui.fake_console import FakeConsole, FakeLibrary
from tests.ui.preflight.test_preflight import CHECKS
from tests.ui.test_window import choose, choose_from_window_menu

pytestmark = pytest.mark.panels("session")


def change(console: FakeConsole, **values: object) -> None:
    console.state.recording.set(dataclasses.replace(console.state.recording.value, **values))  # type: ignore[arg-type]


def session_panel(window: MainWindow) -> SessionPanel:
    window.open_panel("session")
    panel = window.panels["session"]
    assert isinstance(panel, SessionPanel)
    return panel


def entry(number: int, **values: object) -> SessionEntry:
    first = SessionEntry(
        Path(f"/study/sessions/s{number}"), f"2026-11-{number:02}T10:00:00+00:00", 60.0 * number, f"P{number}",
        "A" if number % 2 else "B", "1", "1", "Kim", "Tour guide", "", True, number * 1_000_000, 10, number,
    )  # fmt: skip
    return dataclasses.replace(first, **values)  # type: ignore[arg-type]


SESSIONS = (
    entry(1),
    entry(2, closed_properly=False, problems=2),
    entry(3, purpose="practice"),
    entry(12, condition="A", wizard="Lee"),
)
HITS = (
    SearchHit(SESSIONS[0].folder, 5_000_000_000, 12.5, "participant", "…can the robot arm lift me…"),
    SearchHit(SESSIONS[1].folder, 9_000_000_000, 40.0, "note", "the Robot stands still"),
)


@pytest.fixture
def library() -> FakeLibrary:
    return FakeLibrary(SESSIONS, HITS)


# Recording


def test_a_recording_is_paused_and_continues(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    panel = session_panel(window)
    click(qtbot, find(panel, "session_pause"))
    assert console.calls == [("pause_session", True)]
    button = find(window, "record_button")
    assert str(button.property("text")).startswith("Paused 00:00")
    assert panel.fact[0] == "", "the button says it"
    window.status_bar.refresh()
    assert window.status_bar.items["recording"].text == "paused, 184 MB"
    assert "Recording paused" in panel.log_lines()
    click(qtbot, button)
    choose(window, "record_menu", "Resume recording")
    assert console.calls[-1] == ("pause_session", False)
    assert str(button.property("text")).startswith("Recording")
    click(qtbot, find(panel, "session_toggle"))
    assert console.calls[-1] == ("stop_session", None)


def test_the_room_that_is_left_is_reported_in_time(window: MainWindow, console: FakeConsole) -> None:
    items = window.status_bar.items
    for room_s, text, role in (
        (19_200.0, "room for 5 h 20 min", "dim"),
        (29 * 60.0, "room for 29 min only", "amber"),
        (3 * 60.0, "disk almost full: room for 3 min", "red"),
    ):
        change(console, room_s=room_s, bytes_per_s=333_000.0)
        window.status_bar.refresh()  # as it does four times a second
        assert (items["disk"].text, items["disk"].role) == (text, role)
    assert "1.2 GB per hour" in items["disk"].toolTip()
    assert items["dropped"].text == ""
    change(console, dropped={"frame": 3})
    window.status_bar.refresh()  # as it does four times a second
    assert items["dropped"].text == "3 frames not recorded"
    change(console, dropped={"frame": 3, "audio": 1})
    window.status_bar.refresh()  # as it does four times a second
    assert items["dropped"].text == "4 values not recorded"
    assert "1 audio chunk was not recorded" in items["dropped"].toolTip()


@pytest.mark.panels()
def test_long_words_do_not_make_the_window_wider(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    change(console, room_s=200.0, dropped={"frame": 12_345})
    window.status_bar.refresh()  # as it does four times a second
    console.begin_mark("Asks a long question about it")
    QApplication.processEvents()
    assert window.width() == 1366
    assert window.status_bar.items["disk"].isVisible()
    assert window.status_bar.items["dropped"].isVisible()
    change(console, room_s=None, dropped={})
    window.status_bar.refresh()  # as it does four times a second
    assert not window.status_bar.items["disk"].isVisible()
    assert not window.status_bar.items["dropped"].isVisible()
    assert find(window, "stretch_button").width() >= find(window, "stretch_button").sizeHint().width()


def test_an_open_interval_is_ended_from_the_top_bar(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    assert window.findChild(QWidget, "stretch_button").isHidden()  # type: ignore[union-attr]
    mark_id = console.begin_mark("Laughs")
    button = find(window, "stretch_button")
    assert str(button.property("text")) == "Laughs · 0:00 · End"
    click(qtbot, button)
    assert console.calls[-1] == ("end_mark", mark_id)
    assert button.isHidden()


def test_a_mark_is_one_line_of_the_log_also_after_changes(window: MainWindow, console: FakeConsole) -> None:
    panel = session_panel(window)
    before = len(panel.log_lines())
    mark_id = console.begin_mark("Laughs")
    assert panel.log_lines()[before:] == ["Laughs started"]
    console.state.add(StopRequested(clock.now_ns()))
    began_ns = console.marks[mark_id].start_ns or 0
    console.state.add(Marked(began_ns + 1, "Laughs", "mark", mark_id, began_ns, began_ns + 12_000_000_000))
    assert panel.log_lines()[before:] == ["Marked: Laughs, 12 s", "Stop"]
    console.withdraw_mark(mark_id)
    assert panel.log_lines()[before:] == ["Mark removed: Laughs", "Stop"]


def test_a_jump_in_time_rebuilds_the_log(window: MainWindow, console: FakeConsole) -> None:
    panel = session_panel(window)
    console.state.time_jumped.emit(
        (
            Marked(5, "Laughs", "mark", "m1", 5, state="open"),
            UtteranceChanged(6, "u", "robot", "Hello", "typed", "started"),
            Marked(7_000_000_005, "Laughs", "mark", "m1", 5, 7_000_000_005),
        )
    )
    assert panel.log_lines() == ["Marked: Laughs, 7.0 s", "Robot: “Hello”"]


@pytest.mark.panels()
def test_a_replay_records_and_marks_nothing(window: MainWindow, console: FakeConsole) -> None:
    panel = session_panel(window)
    window.actions_table.drop_all_but(("Window",))
    window.actions_table.rebuild(console.scenario)
    change(console, written_bytes=1_000_000)
    for name in ("session_toggle", "session_pause", "session_note", "session_label_1"):
        assert not [each for each in panel.findChildren(QWidget, name) if each.isVisible()]
    QTest.keyClick(find(window, "speak_field"), Qt.Key.Key_M, Qt.KeyboardModifier.ControlModifier)
    assert console.calls == []
    console.state.add(StopRequested(clock.now_ns()))
    assert panel.log_lines() == ["Stop"]


def test_labels_mark_from_the_panel(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> None:
    scenario = dataclasses.replace(
        samples.TOUR, layout=PanelLeaf("session"), recording=RecordingSettings(("Interested", "Confused"))
    )
    console = FakeConsole(scenario)
    window = open_window(qtbot, console, settings, theme)
    button = find(window, "session_label_2")
    assert button.key == "⇧F2"  # type: ignore[attr-defined]
    click(qtbot, button)
    assert console.calls == [("mark", ("Confused", "mark"))]
    console.pause_session(paused=True)
    assert not button.isVisible()


# Start dialog


def test_the_retention_is_stated(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    console.scenario = dataclasses.replace(
        console.scenario, permissions=Permissions(photos=False, audio_recording=True)
    )
    console.bytes_per_hour, console.free = 1.2e9, 64_000_000_000
    console.inputs, console.input = ("", "Desk microphone"), "Desk microphone"
    console.stop_session()
    window.sessions.open_start_dialog()
    kept, room = find(window, "start_kept"), find(window, "start_room")
    assert isinstance(kept, QLabel)
    assert isinstance(room, QLabel)
    assert "sound" in kept.text()
    assert kept.text().endswith("No photos.")
    assert room.text() == "About 1.2 GB per hour; 64.0 GB free: room for 53 h"
    microphones = find(window, "start_microphone")
    assert isinstance(microphones, QComboBox)
    names = [microphones.itemText(index) for index in range(microphones.count())]
    assert names == ["No microphone", "System’s default microphone", "Desk microphone"]
    assert microphones.currentText() == "Desk microphone"
    microphones.setCurrentIndex(0)
    assert kept.text().endswith("No photos or sound.")
    console.calls.clear()
    click(qtbot, find(window, "start_dialog_begin"))
    assert [name for name, _ in console.calls] == ["use_microphone", "start_session"]
    assert console.input is None


def test_a_scenario_without_sound_requests_no_microphone(window: MainWindow, console: FakeConsole) -> None:
    console.inputs = ("", "Desk microphone")
    window.sessions.open_start_dialog()
    assert window.findChild(QWidget, "start_microphone") is None
    find(window, "start_dialog").close()
    assert contents_sentence(Permissions(audio_recording=False), "x", BlurSettings()).endswith("No sound.")


def test_a_microphone_of_this_computer_is_requested_unless_the_robot_has_one(
    window: MainWindow, console: FakeConsole
) -> None:
    console.scenario = dataclasses.replace(console.scenario, permissions=Permissions(audio_recording=True))
    console.state.robot.set(RobotProfile("eared", "Eared", audio=AudioInterface("/audio")))
    console.inputs, console.input = ("Desk microphone",), ""
    console.stop_session()
    window.sessions.open_start_dialog()
    assert window.findChild(QWidget, "start_microphone") is None
    kept = find(window, "start_kept")
    assert isinstance(kept, QLabel) and "sound" in kept.text()
    find(window, "start_dialog").close()


def test_pixelation_of_people_is_stated() -> None:
    film = Permissions(photos=False, audio_recording=False)
    assert "video (people pixelated)" in contents_sentence(film, None, BlurSettings("everybody"))
    faces = contents_sentence(film, None, BlurSettings("without_consent", "faces"))
    assert "video (faces of people without consent pixelated)" in faces
    nothing = Permissions(video_recording=False, photos=False)
    assert "pixelated" not in contents_sentence(nothing, None, BlurSettings("everybody"))


def test_another_participant_begins_with_trial_1(qtbot: QtBot, theme: Theme, console: FakeConsole) -> None:
    parent = QWidget()
    qtbot.addWidget(parent)
    dialog = StartDialog(theme, parent, console)
    dialog.know(BeforeRecording(TrialDetails(participant="P07", trial="3")))
    dialog.show()
    participant, trial = find(dialog, "start_participant"), find(dialog, "start_trial")
    participant.selectAll()
    QTest.keyClicks(participant, "P08")
    assert dialog.details().trial == "1"
    participant.selectAll()
    QTest.keyClicks(participant, "P07")
    assert dialog.details().trial == "3", "the trial that is next for this one"
    trial.selectAll()
    QTest.keyClicks(trial, "pilot")
    QTest.keyClicks(participant, "x")
    assert dialog.details().trial == "pilot", "what was typed stays"


def test_the_checks_are_beside_the_details_or_below_them(qtbot: QtBot, theme: Theme, console: FakeConsole) -> None:
    parent = QWidget()
    qtbot.addWidget(parent)
    console.state.preflight.set(CHECKS)
    dialog = StartDialog(theme, parent, console)
    dialog.show()
    details, checks = find(dialog, "start_participant"), find(dialog, "preflight_list")

    def beside() -> bool:
        return checks.mapTo(dialog, QPoint()).x() > details.mapTo(dialog, QPoint()).x() + details.width()

    for width_px in (1100, 667, 1100):
        dialog.resize(width_px, 700)
        qtbot.waitUntil(lambda wide=width_px > 1000: beside() is wide and cut_off(dialog) == [])


def test_the_same_trial_again_and_practice(qtbot: QtBot, theme: Theme, console: FakeConsole) -> None:
    parent = QWidget()
    qtbot.addWidget(parent)
    suggested = TrialDetails("Lab visit", "P07", "B", "3", "Kim", recording="1")
    last = last_details(suggested, None)
    assert last is not None
    dialog = StartDialog(theme, parent, console)
    dialog.know(BeforeRecording(suggested), last)
    begun: list[TrialDetails] = []
    dialog.begin.connect(lambda details, _anyway: begun.append(details))
    dialog.show()
    again, practice = find(dialog, "start_again"), find(dialog, "start_practice")
    assert again.property("text") == "Same trial again: P07, trial 2 (2nd recording)"
    trial = find(dialog, "start_trial")
    assert isinstance(trial, QLineEdit)
    click(qtbot, again)
    assert trial.text() == "2"
    trial.selectAll()
    QTest.keyClicks(trial, "7")
    assert not again.isChecked()  # type: ignore[attr-defined]
    click(qtbot, again)
    click(qtbot, practice)
    click(qtbot, find(dialog, "start_dialog_begin"))
    assert begun == [TrialDetails("Lab visit", "P07", "B", "2", "Kim", purpose="practice")]
    assert last_details(TrialDetails(), None) is None


def test_it_opens_before_the_disk_responds_and_keeps_what_is_typed_meanwhile(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    console.suggested = TrialDetails("Lab visit", "P07", "B", "3", "Kim")
    console.bytes_per_hour, console.free = 1.2e9, 64_000_000_000
    console.disk_is_slow = True
    console.stop_session()
    window.sessions.open_start_dialog()
    dialog = find(window, "start_dialog")
    assert isinstance(dialog, StartDialog)
    assert dialog.details() == TrialDetails()
    QTest.keyClicks(find(dialog, "start_participant"), "P08")
    console.answer_of_disk()
    assert dialog.details() == TrialDetails("Lab visit", "P08", "B", "1", "Kim"), "another participant begins anew"
    room = find(dialog, "start_room")
    assert isinstance(room, QLabel) and "64.0 GB free" in room.text()
    assert find(dialog, "start_again").property("text") == "Same trial again: P07, trial 2 (2nd recording)"
    dialog.close()


def test_an_early_start_uses_the_result_of_the_disk(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    console.suggested = TrialDetails("Lab visit", "P07", "B", "3", "Kim")
    console.disk_is_slow = True
    console.stop_session()
    console.calls.clear()
    window.sessions.open_start_dialog()
    click(qtbot, find(window, "start_dialog_begin"))
    room = find(window, "start_room")
    assert isinstance(room, QLabel) and "still being read" in room.text()
    assert console.calls == []
    console.answer_of_disk()
    assert [name for name, _ in console.calls] == ["start_session"]
    assert console.suggested == TrialDetails("Lab visit", "P07", "B", "3", "Kim"), "what it was started with"


def test_the_same_trial_is_repeated_before_the_disk_responds(
    qtbot: QtBot, window: MainWindow, console: FakeConsole
) -> None:
    console.suggested = TrialDetails("Lab visit", "P07", "B", "3", "Kim")
    console.disk_is_slow = True
    console.stop_session()
    window.sessions.record_next_part()
    console.answer_of_disk()
    dialog = find(window, "start_dialog")
    assert isinstance(dialog, StartDialog) and dialog.details().trial == "2"
    dialog.close()
    console.disk_is_slow = True
    window.sessions.open_start_dialog()
    find(window, "start_dialog").close()
    console.answer_of_disk()
    assert window.sessions._start is None, "the one that it was for has gone"


# All sessions


@pytest.fixture
def sessions(qtbot: QtBot, theme: Theme, library: FakeLibrary) -> SessionsWindow:
    window = SessionsWindow(theme, library)
    qtbot.addWidget(window)
    window.show()
    return window


def shown(window: SessionsWindow, column: str = "Participant") -> list[str]:
    number = next(index for index, each in enumerate(COLUMNS) if each.title == column)
    return [str(window.model.index(row, number).data()) for row in range(window.model.rowCount())]


def test_the_list_is_sorted_and_filtered(sessions: SessionsWindow, library: FakeLibrary) -> None:
    assert shown(sessions) == ["P12", "P3", "P2", "P1"], "newest first"
    assert shown(sessions, "State") == [
        "Complete",
        "Practice · Complete",
        "Ended unexpectedly · 2 problems",
        "Complete",
    ]
    sessions.table.sortByColumn(1, Qt.SortOrder.AscendingOrder)
    assert shown(sessions) == ["P1", "P2", "P3", "P12"]
    choice = find(sessions, "sessions_wizard")
    assert isinstance(choice, QComboBox)
    choice.setCurrentIndex(choice.findData("Lee"))
    assert shown(sessions) == ["P12"]
    assert library.named("find")[-1] == SessionQuery(wizard="Lee")
    assert choice.findData("Kim") > 0, "the others can still be chosen"
    QTest.mouseClick(find(sessions, "sessions_show_all"), Qt.MouseButton.LeftButton)
    assert len(shown(sessions)) == 4
    assert find(sessions, "sessions_status").property("text") == "4 sessions"


def test_utterances_are_found_and_replayed(qtbot: QtBot, sessions: SessionsWindow, library: FakeLibrary) -> None:
    assert not sessions.hit_list.isVisible()
    QTest.keyClicks(sessions.search, "robot")
    qtbot.waitUntil(lambda: sessions.hits.rowCount() == 4, timeout=2000)
    assert len(library.named("find")) <= 3, "not one search for each letter"
    assert shown(sessions) == ["P2", "P1"]
    assert find(sessions, "sessions_found").property("text") == "2 matches for “robot”"
    rect = sessions.hit_list.visualRect(sessions.hits.index(3, 0))
    for act in (QTest.mouseClick, QTest.mouseDClick):
        act(sessions.hit_list.viewport(), Qt.MouseButton.LeftButton, pos=rect.center())
    assert library.named("open_replay") == [(SESSIONS[1].folder, 9_000_000_000)]
    sessions.search.setText("zebra")
    qtbot.waitUntil(lambda: sessions.model.rowCount() == 0, timeout=2000)
    assert "No session matches" in str(find(sessions, "sessions_empty").property("text"))


def test_the_list_is_used_with_keys_alone(sessions: SessionsWindow, library: FakeLibrary) -> None:
    exported: list[list[Path]] = []
    sessions.export_requested.connect(exported.append)
    assert not find(sessions, "sessions_replay").isEnabled()
    sessions.search.setFocus()
    sessions.activateWindow()
    QTest.keyClick(sessions.search, Qt.Key.Key_Down)
    assert [each.participant for each in sessions.selected()] == ["P12"], "the newest is chosen at once"
    QTest.keyClick(sessions.table, Qt.Key.Key_Down)
    QTest.keyClick(sessions.table, Qt.Key.Key_Return)
    assert library.named("open_replay") == [(SESSIONS[2].folder, None)]
    QTest.keyClick(sessions.table, Qt.Key.Key_Down, Qt.KeyboardModifier.ShiftModifier)
    QTest.mouseClick(find(sessions, "sessions_export"), Qt.MouseButton.LeftButton)
    assert exported == [[SESSIONS[2].folder, SESSIONS[1].folder]]
    library.found.set(dataclasses.replace(library.found.value, updating=True))
    assert [each.participant for each in sessions.selected()] == ["P3", "P2"], "an update keeps the selection"
    assert "updating" in str(find(sessions, "sessions_status").property("text"))


def test_a_session_that_is_being_recorded_waits(sessions: SessionsWindow, library: FakeLibrary) -> None:
    sessions.show_recording(SESSIONS[1].folder)
    assert shown(sessions, "State")[2] == "Recording now"
    sessions.table.selectRow(2)
    assert not find(sessions, "sessions_replay").isEnabled()
    assert not find(sessions, "sessions_export").isEnabled()
    QTest.keyClick(sessions.table, Qt.Key.Key_Return)
    assert library.named("open_replay") == []
    sessions.show_recording(None)
    assert find(sessions, "sessions_replay").isEnabled()


def test_gaps_of_a_session_and_copies_are_reported(sessions: SessionsWindow, library: FakeLibrary) -> None:
    lost = "4671 of the 4673 recorded values are missing from events.mcap."
    cut, copy = entry(5, losses=(lost,)), entry(6, copy_of="s1")
    library.found.set(LibraryStatus(sessions=(entry(1), cut, copy), total=3))
    states = dict(zip(shown(sessions, "Date"), shown(sessions, "State"), strict=True))
    assert sorted(states.values()) == ["Complete", "Copy", "Incomplete"]
    label = sessions.findChild(QWidget, "sessions_lacks")
    assert label is not None
    for session, words in ((cut, lost), (copy, "This is a copy of s1 and is not counted again."), (entry(1), "")):
        row = sessions.model.row_of(session.folder)
        assert row is not None
        sessions.table.selectRow(row)
        assert (label.property("text"), label.isHidden()) == (words, not words)


@pytest.mark.usefixtures("trial_language")
def test_gaps_of_a_session_are_reported_in_the_wizards_language() -> None:
    told = read_loss("audio.wav is missing: 3.0 s of audio.")
    assert lacks_words(entry(5, losses=(told,))).startswith("[audio.wav îš mîššîñğ: 3.0 š")


def test_a_study_without_sessions_and_one_that_cannot_be_read(sessions: SessionsWindow, library: FakeLibrary) -> None:
    library.found.set(LibraryStatus(updating=True))
    assert find(sessions, "sessions_empty").property("text") == "Reading the sessions of this study…"
    library.found.set(LibraryStatus())
    assert str(find(sessions, "sessions_empty").property("text")).startswith("No sessions yet.")
    library.found.set(LibraryStatus(detail="The folder of the study cannot be read: /study."))
    assert "cannot be read" in str(find(sessions, "sessions_status").property("text"))


def test_five_hundred_sessions_are_shown_quickly(sessions: SessionsWindow, library: FakeLibrary) -> None:
    many = tuple(dataclasses.replace(entry(1 + number % 28), folder=Path(f"/study/{number}")) for number in range(500))
    started_ns = clock.now_ns()
    library.found.set(LibraryStatus(sessions=many, total=500))
    sessions.table.scrollToBottom()
    QApplication.processEvents()
    assert sessions.model.rowCount() == 500
    assert (clock.now_ns() - started_ns) / 1e9 < 1.0


# Export


@pytest.fixture
def dialog(qtbot: QtBot, theme: Theme, library: FakeLibrary) -> Iterator[ExportDialog]:
    parent = QWidget()
    qtbot.addWidget(parent)
    dialog = ExportDialog(theme, library, [SESSIONS[0].folder, SESSIONS[1].folder], parent)
    dialog.show()
    dialog.activateWindow()
    yield dialog
    parent.close()


def test_sessions_are_exported_as_chosen(qtbot: QtBot, dialog: ExportDialog, library: FakeLibrary) -> None:
    assert [find(dialog, f"export_format_{fmt.name}").property("text") for fmt in FORMATS] == [
        fmt.title for fmt in FORMATS
    ]
    for name in dialog.formats:
        click(qtbot, find(dialog, f"export_format_{name}"))
    assert not find(dialog, "export_start").isEnabled()
    for name in ("eaf", "csv"):
        click(qtbot, find(dialog, f"export_format_{name}"))
    folder = find(dialog, "export_folder")
    assert folder.property("text") == "/exports/several"
    licence = find(dialog, "export_licence")
    assert isinstance(licence, QComboBox)
    licence.setCurrentIndex(licence.findData("CC-BY-4.0"))
    click(qtbot, find(dialog, "export_start"))
    folders = (SESSIONS[0].folder, SESSIONS[1].folder)
    assert library.named("start_export") == [
        (folders, ("csv", "eaf"), Path("/exports/several"), "CC-BY-4.0", False, SHOWN)
    ]
    library.export.set(ExportStatus("running", 0.42, "s1: ELAN"))
    bar = find(dialog, "export_progress")
    assert isinstance(bar, QProgressBar)
    assert bar.value() == 420
    assert find(dialog, "export_what").property("text") == "42 % · s1: ELAN"
    assert not folder.isEnabled()
    click(qtbot, find(dialog, "export_cancel"))
    assert library.named("cancel_export") == [None]
    assert find(dialog, "export_what").property("text") == "Cancelled. Nothing was saved."


def test_the_folder_of_a_typed_name_is_known(qtbot: QtBot, dialog: ExportDialog, library: FakeLibrary) -> None:
    find(dialog, "export_folder").setProperty("text", "out")
    click(qtbot, find(dialog, "export_start"))
    assert library.named("start_export")[0][2] == Path.cwd() / "out", "as the message after it names it"


def test_csv_files_are_written_as_chosen(qtbot: QtBot, dialog: ExportDialog, library: FakeLibrary) -> None:
    for name in ("export_plain_csv", "export_csv_bom"):
        click(qtbot, find(dialog, name))
        assert find(dialog, name).toolTip()
    click(qtbot, find(dialog, "export_start"))
    assert library.named("start_export")[0][5] == CsvStyle(plain=True, byte_order_mark=True)
    assert not find(dialog, "export_plain_csv").isEnabled(), "while it runs"


def test_the_end_of_an_export_is_reported_in_words(qtbot: QtBot, dialog: ExportDialog, library: FakeLibrary) -> None:
    licence, other = find(dialog, "export_licence"), dialog.findChild(QLineEdit, "export_other_licence")
    assert isinstance(licence, QComboBox)
    assert other is not None
    licence.setCurrentIndex(licence.count() - 1)
    QTest.keyClicks(other, "ODC-By 1.0")
    click(qtbot, find(dialog, "export_start"))
    assert library.named("start_export")[0][3] == "ODC-By 1.0"
    written = (Path("/exports/several/s1-csv"), Path("/exports/several/s2-csv"))
    library.export.set(ExportStatus("done", 1.0, "", written))
    assert find(dialog, "export_what").property("text") == "Done: 2 exports in /exports/several."
    assert find(dialog, "export_open").isVisible()
    library.export.set(ExportStatus("failed", 0.5, "", written[:1], "The disk is full."))
    assert find(dialog, "export_what").property("text") == "The disk is full. Finished exports remain (1 export)."


def test_names_leave_the_study_only_where_that_is_chosen(
    qtbot: QtBot, dialog: ExportDialog, library: FakeLibrary
) -> None:
    box = find(dialog, "export_with_names")
    assert not box.property("checked")
    assert "W1, C1" in box.property("text")
    click(qtbot, box)
    click(qtbot, find(dialog, "export_start"))
    assert library.named("start_export")[0][4] is True
    assert not box.isEnabled(), "not while it is being written"


def test_another_export_goes_next_to_the_first(dialog: ExportDialog, library: FakeLibrary, tmp_path: Path) -> None:
    asked: list[Callable[[Path], None]] = []
    library.choose_export_folder = lambda _sessions, told, **_chosen: asked.append(told)  # type: ignore[method-assign]
    dialog.show_sessions([SESSIONS[0].folder])
    folder = find(dialog, "export_folder")
    asked.pop()(tmp_path / "s1")
    assert folder.property("text") == str(tmp_path / "s1")
    QTest.mouseClick(find(dialog, "export_start"), Qt.MouseButton.LeftButton)
    (tmp_path / "s1").mkdir()
    library.export.set(ExportStatus("done", 1.0, "", (tmp_path / "s1",)))
    asked.pop()(tmp_path / "s1-2")
    assert folder.property("text") == str(tmp_path / "s1-2")
    assert find(dialog, "export_what").property("text") == f"Done: 1 export in {tmp_path / 's1'}."


def test_a_folder_that_is_typed_before_the_disk_responds_stays(dialog: ExportDialog, library: FakeLibrary) -> None:
    asked: list[Callable[[Path], None]] = []
    library.choose_export_folder = lambda _sessions, told, **_chosen: asked.append(told)  # type: ignore[method-assign]
    dialog.show_sessions([SESSIONS[0].folder])
    folder = find(dialog, "export_folder")
    assert isinstance(folder, QLineEdit)
    folder.selectAll()
    QTest.keyClicks(folder, "/mine")
    asked.pop()(Path("/exports/s1"))
    assert folder.text() == "/mine"


def test_a_folder_is_chosen_without_a_system_dialog(qtbot: QtBot, dialog: ExportDialog, tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    click(qtbot, find(dialog, "export_choose"))
    files = dialog.findChild(QFileDialog)
    assert files is not None
    assert files.testOption(QFileDialog.Option.DontUseNativeDialog)
    assert not files.isModal()
    files.fileSelected.emit(str(tmp_path))
    assert find(dialog, "export_folder").property("text") == str(tmp_path / "several")
    files.fileSelected.emit(str(tmp_path / "other"))
    assert find(dialog, "export_folder").property("text") == str(tmp_path / "other")
    files.close()


def test_the_window_opens_sessions_and_exports(
    qtbot: QtBot, window: MainWindow, console: FakeConsole, library: FakeLibrary
) -> None:
    assert "All sessions…" not in [each.text for each in window.palette_entries()]
    window.use_library(library)
    console.stop_session()
    choose_from_window_menu(qtbot, window, "All sessions…")
    sessions = window.findChild(SessionsWindow)
    assert sessions is not None
    assert sessions.isVisible()
    assert library.named("find"), "the list is brought up to date when it opens"
    assert window.hold.key_owner != "dialog", "Alt still drives"
    QTest.keyPress(sessions.search, Qt.Key.Key_W, Qt.KeyboardModifier.AltModifier)
    assert window.hold.held == {"drive_forward"}
    QTest.keyRelease(sessions.search, Qt.Key.Key_W, Qt.KeyboardModifier.AltModifier)
    assert sessions.search.text() == ""
    panel = session_panel(window)
    click(qtbot, find(panel, "session_export"))
    export = window.findChild(ExportDialog)
    assert export is not None
    assert export.isVisible()
    assert find(export, "export_sessions").property("text") == "2026-11-21_14-02_P07"
    export.activateWindow()
    qtbot.waitUntil(export.isActiveWindow)
    QTest.keyClick(export, Qt.Key.Key_Escape)
    assert not export.isVisible()
    assert console.calls[-1] == ("stop", None)
    window.close()
    assert not sessions.isVisible()


# Dock layout


@pytest.mark.panels()
@pytest.mark.long
def test_a_layout_is_reported_once_it_is_at_rest(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    def settle() -> None:
        qtbot.waitUntil(lambda: not window.layout_keeper.rest.isActive(), timeout=5000)

    assert window.layout_keeper.rest.interval() == 1000
    window.layout_keeper.rest.setInterval(100)
    settle()
    assert console.named("keep_layout") == [], "as the scenario says, whatever the sizes on this screen"
    for name in ("diagnostics", "motion"):
        window.open_panel(name)  # type: ignore[arg-type]
    settle()
    (tree,) = console.named("keep_layout")
    assert isinstance(tree, SplitNode)
    assert {"diagnostics", "motion"} <= set(panels_in(tree))
    window.layout_keeper.record_layout()
    assert len(console.named("keep_layout")) == 1, "nothing has changed since"
    window.show_scenario(console.scenario)
    settle()
    assert console.named("keep_layout") == [tree, tree], "again as the wizard had it, not as in the file"


def test_a_failed_recording_is_reported_in_full(window: MainWindow, console: FakeConsole) -> None:
    console.state.recording.set(RecordingStatus("failed", detail="The disk is full."))
    assert find(window, "record_button").property("text") == "Recording failed"
    panel = session_panel(window)
    assert panel.fact == ("not recording", "red")


@pytest.mark.usefixtures("trial_language")
def test_the_load_of_the_machine_is_in_the_wizards_language(window: MainWindow, console: FakeConsole) -> None:
    console.state.load.set(LoadStatus(2, STEPS[2].detail))
    window.status_bar.refresh()
    assert window.status_bar.items["load"].text == tr("busy: {what}").format(what=tr(STEPS[2].detail))


def test_a_busy_machine_leaves_room_for_the_recording(window: MainWindow, console: FakeConsole) -> None:
    change(console, room_s=19_200.0, bytes_per_s=333_000.0)
    console.state.load.set(LoadStatus(len(STEPS) - 1, STEPS[-1].detail))
    window.status_bar.refresh()
    QApplication.processEvents()
    items = window.status_bar.items
    assert items["load"].text.startswith("busy: people detection much less often")
    shown = sorted((item.geometry() for item in items.values() if item.isVisible()), key=lambda place: place.left())
    assert all(left.right() < right.left() for left, right in itertools.pairwise(shown)), "nothing lies over another"
    assert items["load"].isVisible() and window.width() == 1366


def hit_lines(sessions: SessionsWindow) -> list[str]:
    """Accessible texts of the rows."""
    rows = (sessions.hits.index(row, 0) for row in range(sessions.hits.rowCount()))
    return [str(index.data(Qt.ItemDataRole.AccessibleTextRole)) for index in rows]


def test_hits_are_grouped_by_session_under_headings_that_the_keys_skip(
    qtbot: QtBot, sessions: SessionsWindow, library: FakeLibrary
) -> None:
    first, second = HITS
    library.hits = (first, replace(first, at_ns=6_000_000_000), second)
    QTest.keyClicks(sessions.search, "robot")
    qtbot.waitUntil(lambda: sessions.hits.rowCount() == 5, timeout=2000)
    lines = hit_lines(sessions)
    assert [lines[0], lines[3]] == [
        f"P1 · {local_time(SESSIONS[0].started_utc)} · 2 matches",
        f"P2 · {local_time(SESSIONS[1].started_utc)} · 1 match",
    ]
    assert lines[4].startswith("P2") and lines[4].endswith("Note: the Robot stands still")
    hits = sessions.hit_list
    hits.setFocus()
    reached = [hits.currentIndex().row()]
    for key in (*[Qt.Key.Key_Down] * 3, *[Qt.Key.Key_Up] * 3, Qt.Key.Key_End, Qt.Key.Key_Home):
        QTest.keyClick(hits, key)
        reached.append(hits.currentIndex().row())
    assert reached == [1, 2, 4, 4, 2, 1, 1, 4, 1]
    # The length of a page depends on the height of the list.
    for key, last in ((Qt.Key.Key_PageDown, 4), (Qt.Key.Key_PageUp, 1)):
        rows = set[int]()
        for _ in range(4):
            QTest.keyClick(hits, key)
            rows.add(hits.currentIndex().row())
        assert rows <= {1, 2, 4} and hits.currentIndex().row() == last
    QTest.keyClick(hits, Qt.Key.Key_Return)
    heading = hits.visualRect(sessions.hits.index(3, 0)).center()
    for act in (QTest.mouseClick, QTest.mouseDClick):
        act(hits.viewport(), Qt.MouseButton.LeftButton, pos=heading)
    assert hits.currentIndex().row() == 1 and not hits.selectionModel().isRowSelected(3)
    assert library.named("open_replay") == [(SESSIONS[0].folder, 5_000_000_000)], "a heading is no place to go to"


def test_all_that_is_found_is_counted_and_comes_as_one_scrolls_there(
    qtbot: QtBot, sessions: SessionsWindow, library: FakeLibrary
) -> None:
    hit = replace(HITS[0], quoted=2)
    library.hits = tuple(
        replace(hit, session_s=float(number), folder=SESSIONS[number // 600].folder) for number in range(1200)
    )
    QTest.keyClicks(sessions.search, "robot")
    qtbot.waitUntil(lambda: sessions.hits.rowCount() == 501, timeout=2000)
    assert find(sessions, "sessions_found").property("text") == "1200 matches for “robot”"
    bar = sessions.hit_list.verticalScrollBar()

    def scrolled_to_the_end() -> bool:
        bar.setValue(bar.maximum())
        return sessions.hits.rowCount() == 1202

    assert hit_lines(sessions)[0].endswith("600 matches"), "also those that are not shown yet"
    qtbot.waitUntil(scrolled_to_the_end, timeout=5000)
    headings = [row for row, line in enumerate(hit_lines(sessions)) if line.endswith(" matches")]
    assert headings == [0, 601], "a page that goes on in the same session has no heading of its own"
    assert [sessions.hits.hit(row).session_s for row in (1, 500, 501, 1201)] == [0.0, 499.0, 500.0, 1199.0]
    tip = sessions.hits.data(sessions.hits.index(1, 0), Qt.ItemDataRole.ToolTipRole)
    assert "2 prompt(s) to the language model" in tip
