"""Entries of the command palette, and protection against accidental execution."""

import dataclasses
import json
from pathlib import Path

import pytest
from PySide6.QtCore import QEvent, QPoint, Qt
from PySide6.QtGui import QAction, QCursor, QKeyEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QMenu, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.control_definitions import CallService, Choice, RobotControl
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.live.status import LibraryStatus, LiveRobotsStatus, MapStatus, RecordingStatus
from caris_desktop.recording.studies.study_query import SessionEntry, SessionQuery
from caris_desktop.scenario.protocol_steps import ProtocolSettings, ProtocolStep
from caris_desktop.scenario.scenario_model import AssistanceSettings, Place
from caris_desktop.ui.action_rows import go_to_nth_place
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.palette.command_palette import CommandPalette, Finder, PaletteItem
from caris_desktop.ui.text_formatting import local_time
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.window_appearance import ENGLISH, TRIAL, Language
from tests.ui import samples
from tests.ui.conftest import MemorySettings, find, open_window
from tests.ui.fake_console import FakeConsole, FakeLibrary
from tests.ui.fake_replay import FakeReplay

RELEASE = "Release emergency stop"


def palette_of(window: MainWindow, typed: str = "") -> CommandPalette:
    """Open the palette and type a text."""
    window.show_command_palette()
    palette = window.findChild(CommandPalette)
    assert palette is not None
    QTest.keyClicks(palette.field, typed)
    return palette


def texts(palette: CommandPalette) -> list[str]:
    return [entry.text for entry in palette.list.entries]


@pytest.mark.parametrize("typed", ["release", "pleese", "navigate to the kichen", "go to the recepshun", "helo"])
@pytest.mark.long
def test_a_guess_never_speaks_or_moves(window: MainWindow, console: FakeConsole, typed: str) -> None:
    palette = palette_of(window, typed)
    assert not [entry.text for entry in palette.list.entries if entry.acts]
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert console.named("say") == []
    assert console.named("go_to_place") == []


@pytest.mark.long
def test_speech_and_motion_are_found_by_their_own_words_only(window: MainWindow, console: FakeConsole) -> None:
    call = CallService("/do", "std_srvs/Trigger", {})
    console.state.controls.set((RobotControl("wave", "Wave", "button", call),))
    acting = {entry.text for entry in window.palette_entries() if entry.acts}
    assert {"Please follow me.", "Hmm, good question.", "Go to Kitchen", "Robot: Wave"} <= acting
    for entry in window.palette_entries():
        before = list(console.calls)
        if entry.acts or entry.text in (RELEASE, "Start recording", "All shortcuts"):
            continue
        entry.do()
        moved = [name for name, _ in console.calls[len(before) :] if name in ("say", "go_to_place", "use_control")]
        assert moved == [], f"{entry.text} says or moves something and can be found by a guess"
        window.hold.escape_pressed.emit()


def test_other_things_are_still_found_where_they_are_misspelt(window: MainWindow) -> None:
    assert texts(palette_of(window, "diagnotics")) == ["Diagnostics"]
    guess = PaletteItem("Kitchen", "Panel", "", lambda: None, id="Panel: Kitchen")
    assert Finder([guess]).matching("kichen") == [guess]
    assert Finder([dataclasses.replace(guess, acts=True)]).matching("kichen") == []
    assert Finder([dataclasses.replace(guess, acts=True)]).matching("kitch")


@pytest.mark.parametrize(
    ("typed", "found"),
    [
        ("dark mode", "Appearance: Dark"), ("bigger text", "Size: 150 % after a restart"),
        ("help", "All shortcuts"), ("help", "Practise on the simulated robot"), ("recrod", "Stop recording"),
        ("finish", "Stop recording"), ("shrotc", "All shortcuts"), ("errors", "Active alarms"),
    ],
)  # fmt: skip
@pytest.mark.long
def test_synonyms_and_a_misspelt_unfinished_word_find_it(window: MainWindow, typed: str, found: str) -> None:
    assert found in texts(palette_of(window, typed))


def test_the_release_stands_first_and_is_never_chosen_beforehand(window: MainWindow, console: FakeConsole) -> None:
    assert RELEASE not in texts(palette_of(window))
    window.hold.escape_pressed.emit()
    console.emergency_stop()
    for typed in ("", "release", "emergency stop", "rel"):
        palette = palette_of(window, typed)
        assert texts(palette)[0] == RELEASE, typed
        assert palette.list.current is None, typed
        for _ in range(3):
            QTest.keyClick(palette.field, Qt.Key.Key_Return)
        assert palette.isVisible(), "Enter alone does nothing"
        assert console.state.drive.value.emergency_stop
        window.hold.escape_pressed.emit()


def test_the_release_wants_to_be_chosen_and_enter_twice(window: MainWindow, console: FakeConsole) -> None:
    console.emergency_stop()
    palette = palette_of(window, "release")
    QTest.keyClick(palette.field, Qt.Key.Key_Down)
    assert palette.list.current is not None
    QTest.keyPress(palette.field, Qt.Key.Key_Return)
    for _ in range(5):  # held: some systems report repeats as presses
        QApplication.sendEvent(
            palette.field, QKeyEvent(QEvent.Type.KeyPress, Qt.Key.Key_Return, Qt.KeyboardModifier.NoModifier)
        )
    assert console.state.drive.value.emergency_stop
    QTest.keyRelease(palette.field, Qt.Key.Key_Return)
    # Any other key cancels it.
    QTest.keyClick(palette.field, Qt.Key.Key_Backspace)
    QTest.keyClick(palette.field, Qt.Key.Key_Down)
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert console.state.drive.value.emergency_stop
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert not console.state.drive.value.emergency_stop
    assert not palette.isVisible()


def test_a_double_click_is_one_act(window: MainWindow, console: FakeConsole) -> None:
    console.emergency_stop()
    palette = palette_of(window, "release")
    first = QPoint(60, 20)
    QTest.mouseClick(palette.list.viewport(), Qt.MouseButton.LeftButton, pos=first)
    QTest.mouseDClick(palette.list.viewport(), Qt.MouseButton.LeftButton, pos=first)
    QTest.mouseRelease(palette.list.viewport(), Qt.MouseButton.LeftButton, pos=first)
    assert console.state.drive.value.emergency_stop
    assert palette.isVisible()
    QTest.mouseClick(palette.list.viewport(), Qt.MouseButton.LeftButton, pos=first)
    assert not console.state.drive.value.emergency_stop


def test_a_stop_while_the_palette_is_open_shows_in_it(window: MainWindow, console: FakeConsole) -> None:
    palette = palette_of(window)
    assert RELEASE not in texts(palette)
    console.emergency_stop()
    assert texts(palette)[0] == RELEASE
    assert palette.list.current is None
    console.clear_emergency_stop()
    assert RELEASE not in texts(palette)


def test_everything_that_can_be_done_now_is_in_it_and_nothing_else(window: MainWindow, console: FakeConsole) -> None:
    state = console.state
    state.goal.set(None)
    state.recording.set(RecordingStatus())
    shown = {entry.text for entry in window.palette_entries()}
    assert not {text for text in shown if text.startswith(("Mark", "Write a note", "Wizard error"))}, "nothing records"
    assert "Start recording" in shown
    console.go_to_place("Kitchen")
    state.recording.set(RecordingStatus("recording"))
    state.cameras.set(("front", "rear"))
    state.camera.set("front")
    drive = state.drive.value
    state.drive.set(dataclasses.replace(drive, guard="clear", emergency_stop=True))
    shown = {entry.text for entry in window.palette_entries()}
    for spec in window.actions_table.specs:
        if spec.runs and spec.intent is not go_to_nth_place and spec.id not in ("find", "layout_undo"):
            assert (spec.text in shown) == window.actions_table.available(spec.id), spec.text
    assert shown >= {
        RELEASE, "Stop going to Kitchen", "Show the camera rear", "Layout: Reset to the original layout",
        "Pause recording", "Stop recording", "Turn off the obstacle guard", "Close Map",
    }  # fmt: skip
    assert "Show the camera front" not in shown
    for text in ("Stop going to Kitchen", "Show the camera rear"):
        next(entry for entry in window.palette_entries() if entry.text == text).do()
    assert console.named("cancel_goal") == [None]
    assert state.camera.value == "rear"
    off = next(entry for entry in window.palette_entries() if entry.text == "Turn off the obstacle guard")
    assert off.deliberate, "as the button, which has to be held"


@pytest.mark.long
def test_a_replay_finds_what_a_replay_can_do(window: MainWindow, console: FakeConsole) -> None:
    replay = FakeReplay()
    window.use_replay(replay)
    console.emergency_stop()  # as in the recording
    entries = window.palette_entries()
    assert not [entry.text for entry in entries if entry.acts or entry.deliberate]
    shown = {entry.text for entry in entries}
    assert {"Play or pause", "Map"} <= shown
    assert not {"Stop the robot", "Emergency stop", "Silence"} & shown, "there is no robot"
    replay.live_robots.set(LiveRobotsStatus(("Simulated robot",)))
    assert {"Stop the robot", "Emergency stop"} <= {entry.text for entry in window.palette_entries()}
    assert not {text for text in shown if "record" in text or text.startswith(("Open scenario", "Save", "Connect to"))}


def test_the_palette_lies_below_the_red_button(window: MainWindow, console: FakeConsole) -> None:
    console.emergency_stop()
    palette = palette_of(window)
    button = find(window, "emergency_stop")
    place = button.mapTo(window, QPoint()) + QPoint(button.width() // 2, button.height() // 2)
    assert window.childAt(place) is button
    assert isinstance(palette, QWidget)


def test_recent_entries_come_first_but_a_quick_enter_neither_speaks_nor_moves(
    window: MainWindow, console: FakeConsole
) -> None:
    palette = palette_of(window, "silence")
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    palette = palette_of(window)
    assert texts(palette)[0] == "Silence"
    assert palette.field.accessibleDescription() == "Silence, Do, F12"
    window.hold.escape_pressed.emit()
    palette = palette_of(window, "go to kitchen")
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert console.named("go_to_place") == ["Kitchen"]
    palette = palette_of(window)
    assert texts(palette)[:2] == ["Go to Kitchen", "Silence"]
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert console.named("go_to_place") == ["Kitchen"], "nothing was typed that means it"
    QTest.keyClick(palette.field, Qt.Key.Key_Down)
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert console.named("go_to_place") == ["Kitchen", "Kitchen"], "it was chosen"
    window.wizards.choose("Ana")
    assert texts(palette_of(window))[0] == "Go to Kitchen", "whoever gives her name goes on from there"


def test_remembered_entries_of_a_person_do_not_name_them(
    window: MainWindow, console: FakeConsole, settings: MemorySettings
) -> None:
    named = {entry.text: entry for entry in window.palette_entries() if entry.kind in ("Select", "Person")}
    who = next(person for person in console.state.persons.value if f"Rename {person.name}" in named)
    for text in (who.name, f"Details of {who.name}", f"Rename {who.name}"):
        palette = palette_of(window, text)
        palette.choose(named[text])
        window.hold.escape_pressed.emit()
    kept = str(settings.values["wizards/*/palette/used"])
    assert who.person_id in kept
    assert who.name not in kept


def test_settings_are_found_and_those_that_hold_already_are_not(window: MainWindow, console: FakeConsole) -> None:
    console.inputs = ("Headset",)
    permissions = dataclasses.replace(console.scenario.permissions, own_voice=True)
    console.scenario = dataclasses.replace(console.scenario, permissions=permissions)
    found = {entry.text: entry for entry in window.palette_entries()}
    found["Your microphone: Headset"].do()
    assert console.named("use_microphone") == [("Headset", "wizard")]
    assert "Your microphone: Headset" not in {entry.text for entry in window.palette_entries()}


@pytest.mark.long
def test_the_newest_sessions_are_found_and_open_in_replay(window: MainWindow, console: FakeConsole) -> None:
    library = FakeLibrary()
    window.use_library(library)
    console.state.recording.set(RecordingStatus("recording"))
    palette_of(window)
    window.hold.escape_pressed.emit()
    assert library.named("find") == [], "what is recorded comes before what is looked for"
    console.state.recording.set(RecordingStatus())
    palette = palette_of(window, "p07")
    assert library.named("find") == [SessionQuery()]
    session = SessionEntry(Path("/study/sessions/s-7"), "2026-11-22T14:05:00+00:00", 60.0, participant="P07")
    library.found.set(LibraryStatus(SessionQuery(), (session,)))
    assert texts(palette) == [f"Replay P07 · {local_time(session.started_utc)}"], "it comes while the list is open"
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert [call[0] for call in library.named("open_replay")] == [session.folder]
    palette_of(window)
    assert library.named("find") == [SessionQuery()], "asked once"


ALL_LEVELS = AssistanceSettings(replies="act", fillers="act", actions="act")
CONTROLS = (
    RobotControl("wave", "Wave", "button", CallService("/do", "std_srvs/Trigger", {})),
    RobotControl("lamp", "Lamp", "toggle", CallService("/do", "std_srvs/SetBool", {}), group="Lights"),
    RobotControl("eyes", "Eyes", "choice", CallService("/do", "x/Y", {}), choices=(Choice("Blue", "blue"),)),
    RobotControl("arm", "Arm", "slider", CallService("/do", "x/Y", {}), range=(0.0, 1.0)),
)


def fill(window: MainWindow, console: FakeConsole) -> None:
    """Fill the state so that every kind of palette entry exists; ``others`` selects a second state."""
    state, scenario = console.state, console.scenario
    console.inputs = ("Headset",)
    console.scenario = dataclasses.replace(
        scenario, assistance=ALL_LEVELS, sound=dataclasses.replace(scenario.sound, hear=True),
        permissions=dataclasses.replace(scenario.permissions, own_voice=True),
    )  # fmt: skip
    state.controls.set(CONTROLS)
    state.cameras.set(("front", "rear"))
    state.camera.set("front")
    state.voice.set(dataclasses.replace(state.voice.value, output="computer", choices=(("piper:joe", "en"),), rate=1.5))
    state.mapping.set(dataclasses.replace(state.mapping.value, can_save=True, can_switch=True, mapping=None))
    state.drive.set(dataclasses.replace(state.drive.value, guard="clear"))
    console.go_to_place("Kitchen")
    library = FakeLibrary()
    window.use_library(library)
    window.wizards.choose("Ana")
    window.wizards.choose("")
    session = SessionEntry(Path("/study/sessions/s-7"), "2026-11-22T14:05:00+00:00", 60.0, participant="P07")
    window.show_command_palette()
    library.found.set(LibraryStatus(SessionQuery(), (session,)))
    window.hold.escape_pressed.emit()
    window.board.close("map")


def seen(window: MainWindow, console: FakeConsole) -> list[PaletteItem]:
    """All palette entries in these states and in a replay."""
    state, found = console.state, list[PaletteItem]()
    for recording, latched in (("recording", False), ("paused", True), ("idle", False)):
        state.recording.set(RecordingStatus(recording, folder=Path("/study/sessions/s-8")))  # type: ignore[arg-type]
        state.drive.set(
            dataclasses.replace(state.drive.value, emergency_stop=latched, guard="overridden" if latched else "clear")
        )
        window.layout_keeper.set_locked(latched)
        found += window.palette_entries()
    return found


OWN = ("row ", "person ", "session ", "save map")
"""Prefixes of ids that are not derived from texts of the window."""

REWORDED = (
    (": to a separate window, or back", ": into a window of its own, or back"),
    ("Scenario: Export this scenario as one file", "Scenario: Write this scenario as one file"),
    ("% after a restart", "% from the next start"),
    ("Do: Resume recording", "Do: Go on recording"),
    ("Do: Turn on the obstacle guard", "Do: Switch the obstacle guard on"),
    ("Layout: Save to the scenario", "Layout: Save into the scenario"),
    ("Layout: Reset to the original layout", "Layout: Reset: as the scenario came"),
    (": Suggest (I confirm by key)", ": Suggest: my key does it"),
    (": Automatic (after a countdown)", ": By itself, after a countdown"),
    ("Voice: At normal speed", "Voice: At usual speed"),
    ("Appearance: Same as system", "Appearance: Like the system"),
)
"""Texts whose ids contain their wording, and which stay as settings have them."""


def first_wording(text: str) -> str:
    for new, old in REWORDED:
        text = text.replace(new, old)
    return text


@pytest.mark.long
def test_each_is_known_again_in_every_language_and_by_the_words_it_always_had_in_english(
    window: MainWindow, console: FakeConsole, settings: MemorySettings
) -> None:
    fill(window, console)
    english = seen(window, console)
    assert len({entry.id for entry in english}) > 140
    told = [entry for entry in english if not entry.deliberate and not entry.id.startswith(OWN)]
    # From before ids existed: settings still contain them.
    worded = {entry.id: first_wording(f"{entry.kind}: {entry.text}") for entry in told}
    assert {known: text for known, text in worded.items() if known.casefold() != text.casefold()} == {}
    assert [new for new, _ in REWORDED if not any(new in f"{entry.kind}: {entry.text}" for entry in told)] == []
    before = json.dumps({"recent": ["Do: Undo the last change to people", "Panel: Close Video"], "counts": {}})
    settings.setValue("wizards/*/palette/used", before)
    language = Language()
    language.use(TRIAL)
    try:
        trial = seen(window, console)
        assert [entry.id for entry in trial] == [entry.id for entry in english]
        same = [entry.text for entry, other in zip(trial, english, strict=True) if entry.text != other.text]
        assert len(same) > 80, "the language is another one"
        palette = palette_of(window)
        assert [entry.id for entry in palette.list.entries[:2]] == json.loads(before)["recent"]
        window.hold.escape_pressed.emit()
        window.use_replay(FakeReplay())
        trial = window.palette_entries()
    finally:
        language.use(ENGLISH)
    assert [entry.id for entry in trial] == [entry.id for entry in window.palette_entries()]


@pytest.mark.long
def test_each_act_of_the_layout_has_one_line_that_says_what_it_does(window: MainWindow) -> None:
    def undoing() -> list[tuple[str, str]]:
        return [(entry.text, entry.key) for entry in window.palette_entries() if "undo" in entry.text.casefold()]

    others = [
        ("Undo the last mark", window.actions_table.key_text("mark_undo")),
        ("Undo the last change to people", ""),
    ]
    assert undoing() == others, "nothing was changed"
    window.board.close("map")
    assert undoing() == [*others, ("Layout: Undo: Close Map", window.actions_table.key_text("layout_undo"))]
    next(entry for entry in window.palette_entries() if entry.text.startswith("Layout: Undo")).do()
    QApplication.processEvents()
    assert window.board.is_open("map")


def leaves(menu: QMenu) -> list[QAction]:
    found: list[QAction] = []
    for action in menu.actions():
        below = action.menu()
        if isinstance(below, QMenu) and below.title() != "Focused panel":  # one of each panel
            found += leaves(below)
        elif below is None and not action.isSeparator():
            found.append(action)
    return found


def test_entries_of_every_menu_are_found_too(window: MainWindow, console: FakeConsole) -> None:
    permissions = dataclasses.replace(console.scenario.permissions, own_voice=True)
    sound = dataclasses.replace(console.scenario.sound, hear=True)
    console.scenario = dataclasses.replace(console.scenario, permissions=permissions, sound=sound)
    window.use_library(FakeLibrary())
    window.wizards.choose("Ana")
    found = [entry.text.casefold() for entry in window.palette_entries()]
    missing = []
    for open_menu, name in (
        (window.menus.open_scenario_menu, "scenario_menu"),
        (window.menus.open_window_menu, "window_menu"),
        (window.menus.open_robot_menu, "robot_menu"),
    ):
        open_menu()
        menu = window.findChild(QMenu, name)
        assert menu is not None
        offered = [action for action in leaves(menu) if action.isEnabled() and not action.isChecked()]
        missing += [
            each.text() for each in offered if not any(each.text().rstrip("…").casefold() in text for text in found)
        ]
        menu.close()
    assert missing == []


KITCHEN = dataclasses.replace(
    samples.TOUR,
    protocol=ProtocolSettings((ProtocolStep("Kitchen"), ProtocolStep("Kitchen again"), ProtocolStep("Close"))),
)


def entered(window: MainWindow, typed: str) -> None:
    QTest.keyClick(palette_of(window, typed).field, Qt.Key.Key_Return)
    window.hold.escape_pressed.emit()


@pytest.mark.panels("video", "speak", "map")
def test_an_object_is_found_before_what_would_act_on_something_that_is_called_so(
    qtbot: QtBot, theme: Theme, settings: MemorySettings
) -> None:
    call = CallService("/do", "std_srvs/Trigger", {})
    console = FakeConsole(KITCHEN, {KITCHEN.path: KITCHEN})
    window = open_window(qtbot, console, settings, theme)
    console.state.controls.set((RobotControl("blue", "Light blue", "button", call, group="Lights"),))
    console.state.mapping.set(MapStatus(can_save=True, can_switch=True))
    console.calls.clear()
    for typed in ("kitch", "kitchen", "Kitchen"):
        entered(window, typed)
        assert console.calls == [("go_to_place", "Kitchen")], typed
        console.calls.clear()
    entered(window, "light")
    assert window.theme.choice == "light"
    console.calls.clear()
    for typed in ("light blue", "lights", "blue", "map-", "the map", "follow", "hello", "kitchen again", "1: kit"):
        entered(window, typed)
        acted = [
            name for name, _ in console.calls if name in ("use_control", "say", "protocol", "SaveMap", "SetMapping")
        ]
        assert acted == [], f"{typed!r} has no word for what is done"
        console.calls.clear()
    for typed, act in (
        ("robot light blue", "use_control"), ("say follow", "say"), ("step kitchen again", "protocol"),
        ("please follow me.", "say"),
    ):  # fmt: skip
        entered(window, typed)
        assert [name for name, _ in console.calls] == [act], typed
        console.calls.clear()


@pytest.mark.panels("video", "speak", "map")
def test_enter_runs_nothing_that_moves_or_speaks_where_several_fit(window: MainWindow, console: FakeConsole) -> None:
    places = tuple(Place(name, Pose2D(1, 1, 0)) for name in ("Kitchen", "Kiosk", "Video room", "Hall", "Hall 2"))
    console.scenario = dataclasses.replace(console.scenario, places=places)
    console.state.places.set(places)
    console.state.scenario.set(console.scenario)
    console.calls.clear()
    for typed in ("k", "ki", "go ki", "vide", "say", "voice", "v"):
        entered(window, typed)
        acted = [name for name, _ in console.calls if name in ("go_to_place", "say", "set_voice")]
        assert acted == [], f"{typed!r} fits several things"
    for typed, place in (("kit", "Kitchen"), ("go v", "Video room"), ("hall", "Hall"), ("go hall", "Hall")):
        console.calls.clear()
        entered(window, typed)
        assert console.named("go_to_place") == [place], typed


@pytest.mark.panels("video", "speak", "map")
def test_the_pointer_does_not_choose_what_enter_runs(window: MainWindow, console: FakeConsole) -> None:
    palette = palette_of(window, "say")
    console.calls.clear()
    rows, view = palette.list.model(), palette.list
    for row in (0, 1):
        QTest.mouseMove(view.viewport(), view.visualRect(rows.index(row, 0)).center())
        QApplication.processEvents()
    assert view.current is None
    QTest.keyClick(palette.field, Qt.Key.Key_Return)
    assert console.named("say") == []
    QTest.mouseClick(view.viewport(), Qt.MouseButton.LeftButton, pos=view.visualRect(rows.index(1, 0)).center())
    assert len(console.named("say")) == 1
    QCursor.setPos(0, 0)  # the next test's rows and buttons begin without a pointer over them


@pytest.mark.panels("video", "speak", "map")
def test_a_short_word_is_no_misspelt_one(window: MainWindow, console: FakeConsole) -> None:
    console.calls.clear()
    for typed in ("mara", "redo"):  # not Mark, and not video
        entered(window, typed)
    assert console.calls == [] and window.board.is_open("video")


@pytest.mark.panels("video", "speak", "people")
def test_enter_runs_no_guess_and_ends_no_recording_without_a_verb(window: MainWindow, console: FakeConsole) -> None:
    console.calls.clear()
    for typed in ("charge", "peoples", "recrod", "recording", "record", "quiet"):
        entered(window, typed)
        assert console.calls == [], typed
    entered(window, "pause")
    entered(window, "stop recording")
    assert [name for name, _ in console.calls] == ["pause_session", "stop_session"]


@pytest.mark.panels("video", "speak", "map")
def test_close_needs_the_name_of_a_panel(window: MainWindow, console: FakeConsole) -> None:
    for typed in ("close", "clo", "hide", "remove", "close panel"):
        entered(window, typed)
        assert all(window.board.is_open(name) for name in ("video", "speak", "map")), typed
    entered(window, "close map")
    assert not window.board.is_open("map") and window.board.is_open("video")


@pytest.mark.panels("video", "speak", "drive")
@pytest.mark.parametrize(("typed", "found"), [("speed", "Faster"), ("joystick", "Drive"), ("camera", "Video")])
def test_another_word_for_it_finds_it(window: MainWindow, console: FakeConsole, typed: str, found: str) -> None:
    assert found in texts(palette_of(window, typed))


@pytest.mark.panels("video", "speak", "map")
def test_words_are_taken_as_they_stand_before_they_are_taken_apart(window: MainWindow, console: FakeConsole) -> None:
    console.state.mapping.set(MapStatus(can_save=True, can_switch=True))
    window.open_panel("people")  # creates a change to save
    palette = palette_of(window, "save to")
    assert texts(palette)[0] == "Layout: Save to the scenario"
    assert palette.list.current is palette.list.entries[0]
