"""Speak panel: field, phrases, queue and gaps, by mouse and by keyboard."""

import dataclasses

import pytest
from PySide6.QtCore import QEvent, Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLabel, QMenu, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.events import UtteranceChanged
from caris_desktop.domain.sound_values import WIZARD_MICROPHONE, Hearing
from caris_desktop.live.status import (
    DisplayedReply,
    OpenGap,
    SoundStatus,
    SpeechStatus,
    SuggestionsStatus,
    VoiceStatus,
)
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.phrases import Phrase, PhraseGroup
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.speak_panel import QueueList, SpeakPanel
from caris_desktop.ui.speak.speak_field import SpeakField
from caris_desktop.ui.theme import Theme
from tests.ui import samples
from tests.ui.conftest import MemorySettings, click, find, open_window
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("speak")

ALT, SHIFT, CTRL = (
    Qt.KeyboardModifier.AltModifier,
    Qt.KeyboardModifier.ShiftModifier,
    Qt.KeyboardModifier.ControlModifier,
)
GROUPED = dataclasses.replace(
    samples.TOUR,
    phrases=(
        "Hello, {name}!",
        Phrase("Goodbye.", "Ctrl+G", "wave"),
        PhraseGroup("Questions", ("Any questions?", "Shall we go on?", Phrase("Photo?", "Ctrl+P"))),
        PhraseGroup("Farewell", ("Take care.",)),
    ),
    fillers=("Well …", "Let me see."),
)


@pytest.fixture
def grouped(qtbot: QtBot, settings: MemorySettings, theme: Theme) -> tuple[MainWindow, FakeConsole]:
    console = FakeConsole(GROUPED)
    window = open_window(qtbot, console, settings, theme)
    window.resize(1900, 1040)
    console.calls.clear()
    return window, console


@pytest.fixture
def field(window: MainWindow) -> SpeakField:
    found = find(window, "speak_field")
    assert isinstance(found, SpeakField)
    found.setFocus()
    return found


def waiting(*texts: str, person_id: str = "") -> SpeechStatus:
    now = UtteranceChanged(clock.now_ns(), "u-now", "robot", "Now this.", "typed", "started")
    queued = (
        UtteranceChanged(1, f"u-{number}", "robot", text, "typed", "requested", person_id=person_id)
        for number, text in enumerate(texts, start=1)
    )
    return SpeechStatus(True, "robot", now, tuple(queued))


def queue_of(window: MainWindow) -> QueueList:
    queue = find(window, "speak_queue")
    assert isinstance(queue, QueueList)
    return queue


# Field


def test_a_refused_text_stays_in_the_field(field: SpeakField, console: FakeConsole) -> None:
    console.refuses_speech = True
    QTest.keyClicks(field, "Over there.")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert field.toPlainText() == "Over there."
    console.refuses_speech = False
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert field.toPlainText() == "" and len(console.named("say")) == 2


def test_the_voice_gets_ready_for_what_is_typed_at_its_end_and_in_a_pause(
    field: SpeakField, console: FakeConsole, qtbot: QtBot
) -> None:
    def drafts() -> list[str]:
        return [draft.text for draft in console.named("DraftSpeech")]

    QTest.keyClicks(field, "Good morning")
    assert drafts() == [], "not with each key"
    QTest.keyClicks(field, ".")
    qtbot.waitUntil(lambda: drafts() == ["Good morning."], timeout=5000)
    QTest.keyClicks(field, " And")
    qtbot.waitUntil(lambda: drafts()[1:] == ["Good morning. And"], timeout=5000)
    QTest.keyClicks(field, ".")
    QTest.keyClick(field, Qt.Key.Key_Return)
    QTest.qWait(0)
    assert field.toPlainText() == "" and len(drafts()) == 2, "it is asked for already"


def test_a_failed_text_comes_back_unless_another_was_begun(field: SpeakField, console: FakeConsole) -> None:
    failed = UtteranceChanged(1, "u-9", "robot", "Over there.", "typed", "failed", actor="wizard")
    QTest.keyClicks(field, "Over {place}.")
    QTest.keyClick(field, Qt.Key.Key_Return)
    console.state.add(failed)
    assert field.toPlainText() == "Over {place}."
    QTest.keyClick(field, Qt.Key.Key_Return)
    QTest.keyClicks(field, "And")
    console.state.add(failed)
    assert field.toPlainText() == "And"


def test_only_what_is_dictated_is_written_down(field: SpeakField, console: FakeConsole) -> None:
    def hear(utterance_id: str, committed: str) -> None:
        console.state.add(Hearing(1, WIZARD_MICROPHONE, True, "wizard", utterance_id, committed))

    console.state.sound.set(SoundStatus(talking="robot"))
    hear("w-1", "this is heard by the participant")
    console.state.sound.set(SoundStatus(talking="dictation"))
    hear("w-2", "please")
    console.state.sound.set(SoundStatus())
    hear("w-2", "please follow me")
    hear("w-3", "talking to a colleague")
    assert field.toPlainText() == "please follow me"
    QTest.keyClicks(field, ", slowly.")
    QTest.keyClick(field, Qt.Key.Key_Return)
    QTest.keyClicks(field, "Typed")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.named("say") == [("please follow me, slowly.", "dictated"), ("Typed", "typed")]


def test_typed_text_is_saved_when_another_is_brought_to_be_edited(
    field: SpeakField, window: MainWindow, console: FakeConsole
) -> None:
    panel = window.panels["speak"]
    assert isinstance(panel, SpeakPanel)
    QTest.keyClicks(field, "half a sent")
    edited: list[str] = []
    panel.edit_first("It stops.", lambda text: not edited.append(text))
    QTest.keyClicks(field, " At once.")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert edited == ["It stops. At once."] and console.named("say") == []
    panel.edit_first("It stops.", lambda text: False)
    field.selectAll()
    QTest.keyClick(field, Qt.Key.Key_Delete)
    QTest.keyClicks(field, "Mine")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.named("say") == [("Mine", "typed")], "what was to be edited is gone"


@pytest.mark.panels()
def test_a_suggestion_is_edited_in_the_field_first(window: MainWindow, console: FakeConsole, field: SpeakField) -> None:
    console.state.persons.set((PersonRow("p-1", 1, "Luis", True, 0, 0),))
    card = DisplayedReply("s-1", 2, "No, {p-1}, it stops.")
    console.state.suggestions.set(SuggestionsStatus("shown", "t-1", 1, (card,)))
    find(window, "video_view").setFocus()
    QTest.keyClick(find(window, "video_view"), Qt.Key.Key_2, CTRL | SHIFT)
    assert field.hasFocus() and field.toPlainText() == "No, Luis, it stops."
    QTest.keyClicks(field, " Look.")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.named("say_edited_suggestion") == [("s-1", "No, Luis, it stops. Look.")]
    assert field.toPlainText() == ""


# Phrases


def test_one_key_changes_the_group_that_the_keys_mean(grouped: tuple[MainWindow, FakeConsole], qtbot: QtBot) -> None:
    window, console = grouped
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_F1)
    QTest.keyClick(view, Qt.Key.Key_F10)
    QTest.keyClick(view, Qt.Key.Key_F1)
    assert find(window, "phrase_1").property("text") == "Any questions?"
    assert find(window, "phrase_group_2").property("checked")
    window.resize(1366, 700)
    assert find(window, "next_phrases").property("text") == "Farewell …", "where there is little room the next one"
    window.resize(1900, 1040)
    click(qtbot, find(window, "phrase_group_3"))
    QTest.keyClick(view, Qt.Key.Key_F1)
    assert [chip for chip in window.findChildren(QWidget, "phrase_2") if chip.isVisible()] == []
    QTest.keyClick(view, Qt.Key.Key_F2)
    QTest.keyClick(view, Qt.Key.Key_G, CTRL)
    QTest.keyClick(view, Qt.Key.Key_F10)
    QTest.keyClick(view, Qt.Key.Key_F1)
    assert [text for text, _ in console.named("say")] == [
        "Hello, {name}!", "Any questions?", "Take care.", "Goodbye.", "Hello, {name}!",
    ]  # fmt: skip


def test_a_phrase_shows_its_own_key_and_one_that_is_taken_is_reported(grouped: tuple[MainWindow, FakeConsole]) -> None:
    window, _console = grouped
    assert window.actions_table.key_text("phrase_2") == "F2 · Ctrl G"
    assert [spec.id for spec in window.actions_table.specs if "Ctrl+P" in spec.keys] == ["photo"]
    told = [label.text() for label in window.panels["speak"].findChildren(QLabel)]
    assert "Ctrl P already has another function: “Photo?” has no key." in told


def test_every_phrase_of_every_group_is_found(grouped: tuple[MainWindow, FakeConsole]) -> None:
    window, _console = grouped
    entries = {entry.text: entry.key for entry in window.palette_entries() if entry.kind == "Say"}
    assert {
        "Hello, {name}!": "F1",
        "Goodbye.": "Ctrl G",
        "Take care.": "",
        "Any questions?": "",
    }.items() <= entries.items()


def test_the_filler_key_shows_and_says_the_next_one(grouped: tuple[MainWindow, FakeConsole]) -> None:
    window, console = grouped
    shown = []
    for count in range(3):
        console.state.fillers_spoken.set(count)
        shown.append(find(window, "filler").property("text"))
        QTest.keyClick(find(window, "video_view"), Qt.Key.Key_F9)
    assert shown == ["Hmm, good question.", "Well …", "Let me see."]
    assert [text for text, _ in console.named("say")] == shown


# Queue


def test_a_double_click_says_a_phrase_once(window: MainWindow, console: FakeConsole) -> None:
    phrase, handle = find(window, "phrase_1"), window.windowHandle()
    at = phrase.mapTo(window, phrase.rect().center())
    QTest.mouseDClick(handle, Qt.MouseButton.LeftButton, Qt.KeyboardModifier.NoModifier, at)
    assert len(console.named("say")) == 1


def test_the_queue_is_changed_by_mouse(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    console.state.speech.set(waiting("One.", "Two.", "Three."))
    queue = queue_of(window)

    def button(row: int, name: str) -> QWidget:
        found = queue.layout().itemAt(row).widget().findChild(QWidget, name)
        assert isinstance(found, QWidget)
        return found

    click(qtbot, button(2, "queued_earlier"))
    assert queue.texts == ["“One.”", "“Three.”", "“Two.”"]
    click(qtbot, button(0, "queued_cancel"))
    assert console.calls[-2:] == [("move_queued", ("u-3", 1)), ("cancel_queued", "u-1")]
    assert queue.texts == ["“Three.”", "“Two.”"]


@pytest.mark.panels()
def test_the_queue_is_changed_by_keys_alone_while_driving(window: MainWindow, console: FakeConsole) -> None:
    console.state.speech.set(waiting("One.", "Two.", "Three."))
    view, queue = find(window, "video_view"), queue_of(window)
    view.setFocus()
    QTest.keyClick(view, Qt.Key.Key_L, CTRL | SHIFT)
    assert queue.hasFocus()
    drive = QKeyEvent(QEvent.Type.KeyPress, Qt.Key.Key_W, ALT, "w")
    QApplication.sendEvent(queue, drive)
    QTest.keyClick(queue, Qt.Key.Key_Down)
    QTest.keyClick(queue, Qt.Key.Key_Up, SHIFT)
    assert queue.texts == ["“Two.”", "“One.”", "“Three.”"]
    QTest.keyClick(queue, Qt.Key.Key_Down, SHIFT)
    QTest.keyClick(queue, Qt.Key.Key_Delete)
    assert queue.texts == ["“One.”", "“Three.”"]
    QTest.keyClick(queue, Qt.Key.Key_Return)
    editor = find(window, "queue_editor")
    assert editor.hasFocus() and editor.property("text") == "Three."
    QTest.keyClicks(editor, "Four.")
    QTest.keyClick(editor, Qt.Key.Key_Return)
    assert queue.texts == ["“One.”", "“Four.”"] and queue.hasFocus()
    assert "release_drive" not in [name for name, _ in console.calls], "the robot drove all the while"
    QApplication.sendEvent(queue, QKeyEvent(QEvent.Type.KeyRelease, Qt.Key.Key_W, ALT, "w"))
    assert console.calls[-1][0] == "release_drive"
    QTest.keyClick(queue, Qt.Key.Key_D, CTRL)
    assert view.hasFocus()


@pytest.mark.parametrize("key", [Qt.Key.Key_Delete, Qt.Key.Key_Backspace])
def test_a_held_delete_removes_one_sentence(window: MainWindow, console: FakeConsole, key: Qt.Key) -> None:
    console.state.speech.set(waiting("One.", "Two.", "Three."))
    queue = queue_of(window)
    queue.setFocus()
    for repeated in (False, True, True):
        press = QKeyEvent(QEvent.Type.KeyPress, key, Qt.KeyboardModifier.NoModifier, "", repeated)
        QApplication.sendEvent(queue, press)
    assert queue.texts == ["“Two.”", "“Three.”"]


def test_a_correction_of_a_text_already_spoken_goes_into_the_field(window: MainWindow, console: FakeConsole) -> None:
    console.state.speech.set(waiting("One."))
    queue = queue_of(window)
    queue.setFocus()
    QTest.keyClick(queue, Qt.Key.Key_Return)
    QTest.keyClicks(find(window, "queue_editor"), "Something longer.")
    console.state.speech.set(waiting())
    field = find(window, "speak_field")
    assert field.property("text") == "Something longer."
    assert not queue.isVisible()


def test_escape_gives_the_editing_up(window: MainWindow, console: FakeConsole) -> None:
    console.state.speech.set(waiting("One."))
    queue = queue_of(window)
    queue.setFocus()
    QTest.keyClick(queue, Qt.Key.Key_Return)
    QTest.keyClicks(find(window, "queue_editor"), "Other")
    QTest.keyClick(find(window, "queue_editor"), Qt.Key.Key_Escape)
    assert queue.hasFocus() and queue.texts == ["“One.”"] and console.named("edit_queued") == []
    assert find(window, "speak_field").property("text") == ""


def test_the_last_one_taken_back_leaves_the_cursor_in_the_field(window: MainWindow, console: FakeConsole) -> None:
    console.state.speech.set(waiting("One."))
    queue = queue_of(window)
    queue.setFocus()
    QTest.keyClick(queue, Qt.Key.Key_Backspace)
    assert find(window, "speak_field").hasFocus()


def test_a_name_is_shown_where_the_record_has_an_id(window: MainWindow, console: FakeConsole) -> None:
    console.state.persons.set((PersonRow("p-1", 1, "Luis", True, 0, 0),))
    speech = waiting("Bye, {p-1}.", person_id="p-1")
    console.state.speech.set(dataclasses.replace(speech, now=dataclasses.replace(speech.now, text="Hello, {p-1}!")))  # type: ignore[type-var]
    assert queue_of(window).texts == ["“Bye, Luis.”"]
    assert window.panels["speak"].fact[0].startswith("now saying “Hello, Luis!”")
    queue_of(window).setFocus()
    QTest.keyClick(queue_of(window), Qt.Key.Key_Return)
    assert find(window, "queue_editor").property("text") == "Bye, {name}."


def test_the_title_shows_how_long_it_will_take(window: MainWindow, console: FakeConsole) -> None:
    speech = waiting()
    console.state.speech.set(dataclasses.replace(speech, ends_ns=clock.now_ns() + 3_600_000_000_000))
    fact = window.panels["speak"].fact[0]
    assert fact.startswith("now saying “Now this.” 3") and fact.endswith(" s left")
    console.state.speech.set(dataclasses.replace(speech, ends_ns=clock.now_ns() - 1))
    assert window.panels["speak"].fact[0] == "now saying “Now this.”"


# Gaps


def asked(console: FakeConsole, gap: str = "name") -> None:
    console.state.speech.set(dataclasses.replace(SpeechStatus(True), gap=OpenGap("Hello, {name}!", gap)))


def test_a_gap_is_requested_in_place(window: MainWindow, console: FakeConsole, field: SpeakField) -> None:
    asked(console)
    gap = find(window, "gap_field")
    assert gap.hasFocus()
    QTest.keyClick(gap, Qt.Key.Key_Return)
    QTest.keyClicks(gap, "Ada")
    QTest.keyClick(gap, Qt.Key.Key_Return)
    assert console.named("fill_gap") == ["Ada"]
    assert not gap.isVisible() and field.hasFocus()


def test_escape_leaves_it_unsaid_and_what_was_typed_comes_back(
    window: MainWindow, console: FakeConsole, field: SpeakField
) -> None:
    QTest.keyClicks(field, "Hello, {name}!")
    QTest.keyClick(field, Qt.Key.Key_Return)
    asked(console)
    QTest.keyClick(find(window, "gap_field"), Qt.Key.Key_Escape)
    assert console.named("fill_gap") == [""]
    assert field.toPlainText() == "Hello, {name}!"


@pytest.mark.panels()
def test_driving_by_bare_keys_continues(window: MainWindow, console: FakeConsole) -> None:
    view = find(window, "video_view")
    view.setFocus()
    QTest.keyPress(view, Qt.Key.Key_W)
    asked(console)
    assert view.hasFocus() and "release_drive" not in [name for name, _ in console.calls]
    QTest.keyRelease(view, Qt.Key.Key_W)
    QTest.keyClick(view, Qt.Key.Key_L, CTRL)
    assert find(window, "gap_field").hasFocus()


# Voice


def test_the_voice_is_chosen_in_the_panel(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> None:
    console.state.voice.set(VoiceStatus("computer", used="piper:joe", choices=(("piper:joe", "en"),)))
    click(qtbot, find(window, "voice_button"))
    menu = window.findChild(QMenu, "voice_menu")
    assert menu is not None
    quickly = next(action for action in menu.actions() if action.text() == "Quickly")
    quickly.trigger()
    menu.close()
    assert console.named("set_voice") == [("computer", "", "", 1.25, 1.0)]
    assert "At normal speed" in {entry.text for entry in window.palette_entries() if entry.kind == "Voice"}
