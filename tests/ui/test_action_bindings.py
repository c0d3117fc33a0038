"""Table of key bindings, and the effect of permissions on it."""

import dataclasses
from pathlib import Path

import pytest
from PySide6.QtCore import Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import intents
from caris_desktop.domain.intents import INTENTS, Intent
from caris_desktop.domain.shipped import layouts_dir
from caris_desktop.scenario.scenario_file import load_scenario
from caris_desktop.scenario.scenario_model import Permissions
from caris_desktop.ui.action_bindings import actions_for, cap_text, keyed_phrases
from caris_desktop.ui.action_rows import (
    ACTIONS,
    QUEUE_GROUP,
    REPLAY_ACTIONS,
    TIMELINE_ACTIONS,
    ActionSpec,
    gives,
    say_keyed_phrase,
    speed_after,
)
from caris_desktop.ui.key_choices import conflicts, normalized
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.marking import Marking
from caris_desktop.ui.notifications import AlarmList
from caris_desktop.ui.palette.palette_entries import QuickChoices
from caris_desktop.ui.panels.speak_panel import QueueList
from caris_desktop.ui.protocol_strip import ProtocolStrip
from caris_desktop.ui.replay.replay_bar import ReplayBar
from caris_desktop.ui.replay.timeline_commands import TimelineCommands
from caris_desktop.ui.theme import Theme, icon_names
from tests.ui import samples
from tests.ui.conftest import MemorySettings, find, open_window
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("video", "speak")

TABLE = {
    "stop": ({"Esc"}, set()),
    "emergency_stop": ({"Esc, Esc", "Pause"}, set()),
    "drive_forward": ({"Alt+W", "Alt+Up"}, {"W", "Up"}),
    "drive_back": ({"Alt+S", "Alt+Down"}, {"S", "Down"}),
    "turn_left": ({"Alt+A", "Alt+Left"}, {"A", "Left"}),
    "turn_right": ({"Alt+D", "Alt+Right"}, {"D", "Right"}),
    "strafe_left": ({"Alt+Z"}, {"Z"}),
    "strafe_right": ({"Alt+C"}, {"C"}),
    "look_up": ({"Alt+I"}, {"I"}),
    "look_down": ({"Alt+K"}, {"K"}),
    "look_left": ({"Alt+J"}, {"J"}),
    "look_right": ({"Alt+L"}, {"L"}),
    "look_ahead": ({"Alt+O"}, {"O"}),
    "nod": ({"Alt+N"}, {"N"}),
    **{f"place_{number}": ({f"Alt+{number}"}, {str(number)}) for number in range(1, 10)},
    "slower": ({"Alt+Q"}, {"Q"}),
    "faster": ({"Alt+E"}, {"E"}),
    **{f"phrase_{number}": ({f"F{number}"}, set()) for number in range(1, 9)},
    "filler": ({"F9"}, set()),
    **{f"suggestion_{number}": ({f"Ctrl+{number}"}, set()) for number in range(1, 4)},
    **{f"edit_suggestion_{number}": ({f"Ctrl+Shift+{number}"}, set()) for number in range(1, 4)},
    "no_suggestion": ({"Ctrl+0"}, set()),
    **{f"gesture_{number}": ({f"Ctrl+{number + 3}"}, set()) for number in range(1, 7)},
    "silence": ({"F12"}, set()),
    "push_to_talk": ({"Ctrl+Space"}, {"T"}),
    "dictate": ({"Ctrl+Shift+Space"}, {"Shift+T"}),
    "hear": ({"Ctrl+H"}, set()),
    "photo": ({"Ctrl+P"}, {"P"}),
    "mark": ({"Ctrl+M"}, {"M"}),
    **{f"expression_{number}": ({f"Ctrl+Shift+F{number}"}, set()) for number in range(1, 9)},
    **{f"label_{number}": ({f"Shift+F{number}"}, set()) for number in range(1, 9)},
    "stretch": ({"Ctrl+R"}, set()),
    "mark_earlier": ({"Ctrl+J"}, set()),
    "mark_undo": ({"Ctrl+Shift+J"}, set()),
    "note": ({"Ctrl+N"}, set()),
    "alarms": (set(), set()),
    "wizard_error": ({"Ctrl+Shift+M"}, {"Shift+M"}),
    "choose_place": ({"Ctrl+Shift+G"}, set()),
    "choose_wizard": (set(), set()),
    "choose_scenario": ({"Ctrl+O"}, set()),
    "name_person": ({"Ctrl+I"}, set()),
    "next_camera": ({"Ctrl+Shift+V"}, {"V"}),
    "correct_speaker": ({"Ctrl+Shift+S"}, set()),
    "find_said": ({"Ctrl+F"}, set()),
    "find": ({"Ctrl+K"}, {"/"}),
    "set_up": (set(), set()),
    "layout_undo": ({"Ctrl+Shift+D"}, set()),
    "preflight": ({"Ctrl+Shift+C"}, set()),
    "shortcuts": ({"Ctrl+/"}, {"?"}),
    "help": ({"Ctrl+F1"}, set()),
    "focus_speak": ({"Ctrl+L"}, {"Return"}),
    "focus_queue": ({"Ctrl+Shift+L"}, set()),
    "queued_above": ({"Up"}, set()),
    "queued_below": ({"Down"}, set()),
    "queued_earlier": ({"Shift+Up"}, set()),
    "queued_later": ({"Shift+Down"}, set()),
    "queued_edit": ({"Return", "Enter"}, set()),
    "queued_cancel": ({"Del", "Backspace"}, set()),
    "next_phrases": ({"F10"}, set()),
    "focus_driving": ({"Ctrl+D"}, set()),
    "answer_yes": ({"Ctrl+Return"}, {"Y"}),
    "answer_no": ({"Ctrl+Shift+Return"}, {"Shift+Y"}),
    "next_step": ({"Ctrl+PgDown"}, {"PgDown"}),
    "previous_step": ({"Ctrl+PgUp"}, {"PgUp"}),
    "skip_step": ({"Ctrl+Shift+PgDown"}, {"Shift+PgDown"}),
    "branch": ({"Ctrl+B"}, {"B"}),
    "say_step": ({"F11"}, set()),
    "go_to_step_place": ({"Alt+0"}, {"0"}),
    "all_steps": ({"Ctrl+Shift+PgUp"}, set()),
}


def test_the_table_binds_the_agreed_keys() -> None:
    assert {spec.id: (set(spec.keys), set(spec.driving_keys)) for spec in ACTIONS} == TABLE


def test_no_key_belongs_to_two_actions() -> None:
    assert conflicts(ACTIONS) == []


def test_a_conflict_would_be_found() -> None:
    first = ActionSpec("first", "First", keys=("Ctrl+M",))
    second = ActionSpec("second", "Second", driving_keys=("ctrl+m",))
    assert conflicts((first, second)) == [("Ctrl+M", ("first", "second"))]


def test_every_key_is_one_that_qt_knows() -> None:
    assert all(normalized(key) for spec in ACTIONS for key in (*spec.keys, *spec.driving_keys))
    with pytest.raises(ValueError, match="no such key"):
        normalized("")


def test_every_icon_exists() -> None:
    assert {spec.icon for spec in ACTIONS if spec.icon} <= icon_names()


@pytest.mark.parametrize(
    ("key", "cap"),
    [
        ("Ctrl+Shift+M", "⇧Ctrl M"),
        ("Shift+M", "⇧M"),
        ("Esc, Esc", "Esc Esc"),
        ("Return", "Enter"),
        ("Alt+Up", "Alt ↑"),
        ("+", "+"),
        ("Ctrl++", "Ctrl +"),
    ],
)
def test_key_caps_read_like_a_keyboard(key: str, cap: str) -> None:
    assert cap_text(key) == cap


def test_a_permission_takes_its_actions_away() -> None:
    scenario = dataclasses.replace(samples.TOUR, permissions=Permissions(photos=False, driving=False))
    ids = {spec.id for spec in actions_for(scenario)}
    assert not ids & {"photo", "drive_forward", "turn_left", "slower", "faster", "focus_driving"}
    assert {"stop", "emergency_stop"} <= ids


def test_phrases_are_named_by_the_scenario() -> None:
    texts = {spec.id: spec.text for spec in actions_for(samples.TOUR)}
    assert texts["phrase_2"] == "Please follow me."
    assert "phrase_8" not in texts
    assert texts["filler"] == "Hmm, good question."


def asked_by(window: MainWindow) -> dict[str, Intent]:
    """The present intent of each row of the table."""
    table = window.actions_table
    return {spec.id: intent for spec in table.all_specs if (intent := table.intent_of(spec)) is not None}


def test_a_row_carries_the_intent_that_it_asks_for(window: MainWindow, console: FakeConsole) -> None:
    asked = asked_by(window)
    faster = speed_after(console.state.drive.value.speed_fraction, 1)
    expected = {
        "stop": intents.Stop(),
        "emergency_stop": intents.EmergencyStop(),
        "look_ahead": intents.LookAt(0.0, 0.0),
        "nod": intents.Nod(),
        "faster": intents.SetSpeed(faster),
        "place_2": intents.GoToPlace(samples.TOUR.places[1].name),
        "phrase_2": intents.Say("Please follow me.", "phrase"),
        "filler": intents.Say("Hmm, good question.", "filler"),
        "silence": intents.Silence(),
        "photo": intents.TakePhoto(),
    }
    assert {action_id: asked.get(action_id) for action_id in expected} == expected
    console.state.places.set(samples.TOUR.places[:1])
    assert {"place_1", "place_2"} & set(asked_by(window)) == {"place_1"}


def test_nothing_is_shown_of_a_scenario_that_the_window_does_not_show_yet(
    window: MainWindow, console: FakeConsole
) -> None:
    console.scenario = dataclasses.replace(samples.TOUR, phrases=samples.TOUR.phrases[::-1])
    asked = asked_by(window)
    assert "phrase_2" not in asked and "filler" not in asked
    assert asked["emergency_stop"] == intents.EmergencyStop() and asked["stop"] == intents.Stop()
    console.state.scenario.set(console.scenario)
    assert isinstance(asked_by(window)["phrase_2"], intents.Say)
    console.scenario = dataclasses.replace(console.scenario)  # as when a place is saved
    assert "phrase_2" in asked_by(window)


def test_a_row_needs_what_its_intent_needs(window: MainWindow) -> None:
    for action_id, intent in asked_by(window).items():
        spec = window.actions_table.spec(action_id)
        if spec is not None:
            assert set(spec.permissions) >= set(INTENTS[type(intent)].permissions), action_id


def test_the_intents_of_a_row_and_their_needs_are_declared() -> None:
    rows = {spec.id: spec for spec in (*ACTIONS, *REPLAY_ACTIONS, *TIMELINE_ACTIONS)}
    for spec in rows.values():
        assert bool(spec.kinds) == (spec.intent is not None), spec.id
        for permission in spec.permissions:
            needed = all(permission in INTENTS[kind].permissions for kind in spec.kinds) and bool(spec.kinds)
            assert needed or permission == spec.permission, spec.id
    assert rows["mark"].kinds == rows["label_1"].kinds == rows["wizard_error"].kinds == (intents.Mark,)
    assert rows["stretch"].kinds == (intents.BeginMark, intents.EndMark)
    assert (rows["mark_earlier"].kinds, rows["mark_undo"].kinds) == ((intents.ChangeMark,), (intents.WithdrawMark,))
    assert (rows["queued_earlier"].kinds, rows["queued_cancel"].kinds) == (
        (intents.MoveQueued,),
        (intents.CancelQueued,),
    )
    assert set(rows["suggestion_1"].permissions) == {"assistant", "speech"}, "the table says it, and the row need not"
    assert rows["answer_yes"].permissions == (), "whom or what it answers is not said before"


def test_a_row_gives_nothing_else_than_it_says(window: MainWindow) -> None:
    marks = window.actions_table.spec("mark")
    assert marks is not None

    @gives(intents.Mark)
    def deceives(*_: object) -> Intent:
        return intents.EmergencyStop()

    with pytest.raises(TypeError, match="EmergencyStop"):
        window.actions_table.intent_of(dataclasses.replace(marks, intent=deceives))


def test_rows_without_an_intent_are_methods_of_their_owner() -> None:
    table = {ACTIONS: MainWindow, REPLAY_ACTIONS: ReplayBar, TIMELINE_ACTIONS: TimelineCommands}
    own = {"Alarms": AlarmList, "Marks": Marking, "Protocol": ProtocolStrip, QUEUE_GROUP: QueueList}
    own |= dict.fromkeys(("Places", "Scenario", "People"), QuickChoices)
    for rows, handlers in table.items():
        for spec in rows:
            assert (spec.intent is not None) + bool(spec.callback) == (spec.kind not in ("hold", "talk")), spec.id
            if spec.callback:
                answering = own.get(spec.group, handlers)
                assert callable(getattr(answering, spec.callback)), spec.id


def test_listeners_get_an_intent_before_it_is_requested(window: MainWindow, console: FakeConsole) -> None:
    asked_intents: list[tuple[Intent, int]] = []
    window.actions_table.asking.connect(lambda intent: asked_intents.append((intent, len(console.calls))))
    window.actions_table.run("silence")
    assert asked_intents == [(intents.Silence(), 0)]
    assert console.calls == [("silence", None)]


CTRL, SHIFT, NONE = (
    Qt.KeyboardModifier.ControlModifier,
    Qt.KeyboardModifier.ShiftModifier,
    Qt.KeyboardModifier.NoModifier,
)


def test_keys_work_while_typing(window: MainWindow, console: FakeConsole) -> None:
    field = find(window, "speak_field")
    field.setFocus()
    for key, modifiers, call in (
        (Qt.Key.Key_F2, NONE, ("say", ("Please follow me.", "phrase"))),
        (Qt.Key.Key_F9, NONE, ("say", ("Hmm, good question.", "filler"))),
        (Qt.Key.Key_F12, NONE, ("silence", None)),
        (Qt.Key.Key_P, CTRL, ("take_photo", None)),
        (Qt.Key.Key_M, CTRL, ("mark", ("", "mark"))),
        (Qt.Key.Key_M, CTRL | SHIFT, ("mark", ("", "wizard_error"))),
    ):
        console.calls.clear()
        QTest.keyClick(field, key, modifiers)
        assert console.calls == [call]


def test_bare_keys_work_with_the_driving_focus_only(window: MainWindow, console: FakeConsole) -> None:
    view, field = find(window, "video_view"), find(window, "speak_field")
    for key, modifiers, call in (
        (Qt.Key.Key_P, NONE, ("take_photo", None)),
        (Qt.Key.Key_M, NONE, ("mark", ("", "mark"))),
        (Qt.Key.Key_M, SHIFT, ("mark", ("", "wizard_error"))),
        (Qt.Key.Key_E, NONE, ("set_speed_fraction", 1.0)),
        (Qt.Key.Key_Q, NONE, ("set_speed_fraction", 0.6)),
    ):
        console.calls.clear()
        view.setFocus()
        QTest.keyClick(view, key, modifiers)
        assert console.calls == [call]
        field.setFocus()
        QTest.keyClick(field, key, modifiers)
        assert console.calls == [call]
    assert len(field.property("text")) == 5


def test_switched_off_photos_have_no_button_and_no_key(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> None:
    console = FakeConsole(samples.MENTAL)
    window = open_window(qtbot, console, settings, theme)
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_P)
    QTest.keyClick(view, Qt.Key.Key_P, Qt.KeyboardModifier.ControlModifier)
    window.actions_table.run("photo")
    assert console.named("take_photo") == []
    assert window.findChild(object, "photo_button") is None


def test_key_caps_show_the_binding_that_works_now(window: MainWindow) -> None:
    find(window, "video_view").setFocus()
    assert window.actions_table.key_text("mark") == "M"
    assert window.actions_table.key_text("drive_forward") == "W"
    find(window, "speak_field").setFocus()
    assert window.actions_table.key_text("mark") == "Ctrl M"
    assert window.actions_table.key_text("drive_forward") == "Alt W"
    assert find(window, "mark_button").key == "Ctrl M"  # type: ignore[attr-defined]


def test_return_goes_to_the_speak_field_and_ctrl_d_back(window: MainWindow) -> None:
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_Return)
    field = find(window, "speak_field")
    assert field.hasFocus()
    QTest.keyClick(field, Qt.Key.Key_D, Qt.KeyboardModifier.ControlModifier)
    assert view.hasFocus()


def test_marks_wait_for_a_recording(window: MainWindow, console: FakeConsole) -> None:
    console.stop_session()
    console.calls.clear()
    QTest.keyClick(find(window, "speak_field"), Qt.Key.Key_M, Qt.KeyboardModifier.ControlModifier)
    assert console.calls == []
    mark = window.findChild(QWidget, "mark_button")
    assert mark is not None and mark.isHidden()


@pytest.mark.parametrize("path", sorted(layouts_dir().glob("*.yaml")), ids=lambda path: path.stem)
def test_no_phrase_of_a_shipped_scenario_lost_its_key_to_the_table(path: Path) -> None:
    scenario = load_scenario(path)
    bound = {spec.argument for spec in actions_for(scenario) if spec.intent is say_keyed_phrase}
    assert bound == set(keyed_phrases(scenario))
