"""Conversation panel: transcript, search, corrections, and the participant's waiting time."""

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PySide6.QtCore import QEvent, QObject, QPoint, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QApplication, QLineEdit, QVBoxLayout, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.conversation.conversation_transcript import Transcript
from caris_desktop.domain import clock
from caris_desktop.domain.events import UtteranceChanged, UtteranceCorrected
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE, Hearing
from caris_desktop.live.state import LiveState, PresentClock
from caris_desktop.live.status import PhotoEntry
from caris_desktop.ui.conversation.transcript_view import BUTTONS, TranscriptRow, TranscriptView, words_rect
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.conversation_panel import ConversationPanel
from caris_desktop.ui.theme import Theme, icon_names
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.inputs import SubmitTextEdit
from caris_desktop.ui.widgets.pictures import PhotoThumbnail
from tests.support.yardstick import in_yardsticks
from tests.ui import samples
from tests.ui.conftest import MemorySettings, click, find
from tests.ui.fake_console import FakeConsole
from tests.ui.fake_replay import STARTED_NS, FakeReplay

pytestmark = pytest.mark.panels("speak")


@pytest.fixture
def panel(qtbot: QtBot, window: MainWindow, console: FakeConsole) -> Iterator[ConversationPanel]:
    window.open_panel("conversation")
    found = window.panels["conversation"]
    assert isinstance(found, ConversationPanel)
    samples.converse(console)
    qtbot.waitUntil(lambda: found.in_view and found.view.height() > 60)
    console.calls.clear()
    yield found


def said(panel: ConversationPanel) -> list[tuple[str, str]]:
    return [(row.who, row.words) for row in panel.view.rows]


def press(qtbot: QtBot, panel: ConversationPanel, key: Qt.Key) -> None:
    panel.view.setFocus()
    qtbot.waitUntil(panel.view.hasFocus)
    QTest.keyClick(panel.view, key)


def go_to(panel: ConversationPanel, utterance_id: str) -> None:
    rows = [row.utterance_id for row in panel.view.rows]
    panel.view.show_turn(rows.index(utterance_id))


def utterance(number: int, *, text: str = "", state: str = "finished", stamp_ns: int | None = None) -> UtteranceChanged:
    stamp_ns = clock.now_ns() if stamp_ns is None else stamp_ns
    speaker = "participant" if number % 2 else "robot"
    origin = "heard" if number % 2 else "typed"
    text = text or f"Turn {number}: " + "word " * (number % 30)
    return UtteranceChanged(stamp_ns, f"n{number}", speaker, text, origin, state)  # type: ignore[arg-type]


def test_it_shows_utterances_with_their_speakers(panel: ConversationPanel) -> None:
    assert said(panel) == [
        ("Luis", "Hi, is this where the tour begins?"),
        ("robot", "Hello! Welcome to our lab. I am going to show you around."),
        ("participant", "Oh nice, it talks."),
        ("robot", "Over there is our robot arm."),
        ("Luis", "Can it hurt people when it moves?"),
    ]
    assert panel.view.rows[2].tags == ("amused",)


def test_a_name_stands_where_the_record_has_an_id(panel: ConversationPanel, console: FakeConsole) -> None:
    console.say_turn(utterance(8, text="Hello {p-7}!"), utterance(10, text="Hello {p-8}!"))
    assert [row.text for row in panel.view.rows[-2:]] == ["Hello somebody!"] * 2
    known = replace(console.state.persons.value[0], person_id="p-7", name="Noor")
    console.state.everybody.set((known,))
    assert [row.text for row in panel.view.rows[-2:]] == ["Hello Noor!", "Hello somebody!"]


def test_partial_words_are_there_before_the_turn_is_over(panel: ConversationPanel, console: FakeConsole) -> None:
    begun = utterance(1, text="-", state="started")
    console.say_turn(replace(begun, text=""))
    console.state.add(Hearing(clock.now_ns(), ROBOT_MICROPHONE, True, "participant", "n1", "And how", "heavy his"))
    assert (panel.view.rows[-1].text, panel.view.rows[-1].tentative) == ("And how", "heavy his")
    assert panel.fact == ("The participant is talking", "green")
    console.say_turn(replace(begun, stamp_ns=clock.now_ns(), state="finished", text="And how heavy is it?"))
    assert (panel.view.rows[-1].text, panel.view.rows[-1].tentative) == ("And how heavy is it?", "")
    failed = utterance(3, text="noise", state="started")
    console.say_turn(failed, replace(failed, state="failed"))
    assert panel.view.rows[-1].utterance_id == "n1", "what turned out to be nothing is not there"


def test_the_robots_own_voice_is_not_shown_as_the_participants(panel: ConversationPanel, console: FakeConsole) -> None:
    before, fact = said(panel), panel.fact
    console.say_turn(replace(utterance(1, text="-", state="started"), text=""))
    hearing = Hearing(clock.now_ns(), ROBOT_MICROPHONE, True, "participant", "n1", "", "That's him")
    console.state.add(hearing)
    assert said(panel) == [*before, ("participant", "That's him")]
    console.state.add(replace(hearing, speaker="robot", committed="That is", tentative="a good question."))
    assert said(panel) == before
    assert panel.fact[0].rpartition(" s ")[2] == fact[0].rpartition(" s ")[2], "nobody else is waited for"
    console.state.add(replace(hearing, committed="That is", tentative="a good idea."))
    assert said(panel)[-1] == ("participant", "That is a good idea."), "it was somebody after all"


def test_the_title_says_how_long_a_person_has_been_waiting(panel: ConversationPanel, console: FakeConsole) -> None:
    text, role = panel.fact
    assert text.endswith(" s since Luis stopped talking"), text
    assert role == "amber", "that is late"
    just = utterance(5, text="Hello?", state="finished")
    console.say_turn(replace(just, stamp_ns=clock.now_ns(), person_id="p2"))
    assert panel.fact == ("0.1 s since Ana Torres stopped talking", "green")
    answer = replace(just, utterance_id="n6", speaker="robot", origin="typed", state="started")
    console.say_turn(replace(answer, stamp_ns=clock.now_ns()))
    assert panel.fact[0].endswith(" until the answer")


def test_the_scenario_sets_the_bound_of_a_late_answer(panel: ConversationPanel, console: FakeConsole) -> None:
    patient = replace(console.scenario.assistance, fillers="suggest", filler_after_s=9.0)
    console.scenario = replace(console.scenario, assistance=patient)
    panel.update_view()
    assert panel.fact[1] == "green"


def test_suggestions_stand_under_the_newest_turn(qtbot: QtBot, panel: ConversationPanel, console: FakeConsole) -> None:
    """Suggestions are visible even after scrolling back."""
    console.say_turn(*(utterance(number) for number in range(30)))
    samples.suggest(console)
    qtbot.waitUntil(find(panel.window(), "suggestion_cards").isVisible)
    panel.view.verticalScrollBar().setValue(0)
    card = find(panel.window(), "suggestion_1")
    assert card.mapTo(panel, QPoint()).y() >= panel.view.geometry().bottom()
    assert card.mapTo(panel, card.rect().bottomLeft()).y() <= panel.height()
    assert panel.view.height() >= 40, "the newest turn has its place"


def test_it_stays_at_the_newest_unless_scrolled_back(
    qtbot: QtBot, panel: ConversationPanel, console: FakeConsole
) -> None:
    console.say_turn(*(utterance(number) for number in range(30)))
    bar = panel.view.verticalScrollBar()
    qtbot.waitUntil(lambda: bar.maximum() > 0)
    assert bar.value() == bar.maximum()
    bar.setValue(bar.maximum() // 2)
    top = panel.view.row_rect(10).top()
    console.say_turn(*(utterance(number) for number in range(30, 33)))
    assert panel.view.row_rect(10).top() == top, "what is read stays where it is"
    button = find(panel.window(), "new_below")
    assert (button.isVisible(), button.text()) == (True, "3 new below")  # type: ignore[attr-defined]
    click(qtbot, button)
    assert bar.value() == bar.maximum()
    assert not button.isVisible()


@pytest.mark.parametrize("words", ["Hello! Welcome to our lab.", "word " * 60], ids=["short", "long"])
@pytest.mark.parametrize("width_px", [300, 470, 640])
def test_a_short_transcript_comes_to_rest(qtbot: QtBot, theme: Theme, words: str, width_px: int) -> None:
    """A scroll bar that appeared with the estimated height and disappeared with the real one caused endless layouts."""
    room = QWidget()
    qtbot.addWidget(room)
    column, view = QVBoxLayout(room), TranscriptView(theme, may_change=True, empty="")
    column.addWidget(view, 1)
    column.addStretch(0)
    room.resize(width_px, 400)
    room.show()
    view.show_rows([TranscriptRow("u1", 0, "21:06:48", "robot", "robot", words)])
    for _ in range(50):
        QApplication.processEvents()
    resized = Resizes(view.viewport())
    for _ in range(50):
        QApplication.processEvents()
    assert resized.count == 0
    assert not view.verticalScrollBar().isVisible()
    assert view.height() == view.row_rect(0).height()


class Resizes(QObject):
    """Counts resize events of a widget."""

    def __init__(self, widget: QWidget) -> None:
        super().__init__(widget)
        self.count = 0
        widget.installEventFilter(self)

    def eventFilter(self, _watched: QObject, event: QEvent) -> bool:
        self.count += event.type() == QEvent.Type.Resize
        return False


def test_an_hour_stays_quick(qtbot: QtBot, panel: ConversationPanel, console: FakeConsole) -> None:
    """Adding a turn and scrolling are fast with two thousand turns."""
    begin_ns = clock.now_ns() - 3_600_000_000_000
    turns = [utterance(number, stamp_ns=begin_ns + number * 1_000_000_000) for number in range(2_000)]
    for turn in turns:
        console.transcript.add(turn)
    console.state.transcript.reset_value(console.transcript.turns)
    qtbot.waitUntil(lambda: len(panel.view.rows) == 2_005)
    qtbot.waitUntil(lambda: not panel.view._rest.isActive())
    numbers = iter(range(3_000, 4_000))

    def another() -> None:
        number = next(numbers)
        console.say_turn(utterance(number))
        panel.view.verticalScrollBar().setValue(number * 37 % 50_000)
        panel.view.viewport().repaint()

    # About 9 alone, 14 beside three other tests on two cores; to lay all turns out again takes hundreds.
    assert in_yardsticks(another) < 20


def test_words_are_corrected_in_place_by_keyboard_alone(
    qtbot: QtBot, panel: ConversationPanel, console: FakeConsole
) -> None:
    go_to(panel, "t5")
    press(qtbot, panel, Qt.Key.Key_Return)
    field = find(panel.window(), "transcript_field")
    assert isinstance(field, SubmitTextEdit)
    assert field.toPlainText() == "Can it hurt people when it moves?"
    field.setPlainText("Can it hurt puppies?")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.named("correct_utterance") == [("t5", {"text": "Can it hurt puppies?"})]
    row = panel.view.rows[-1]
    assert (row.text, row.heard_text) == ("Can it hurt puppies?", "Can it hurt people when it moves?")
    assert not field.isVisible()
    assert panel.view.hasFocus(), "and nothing that is typed next goes elsewhere"


def test_robot_utterances_are_not_corrected(qtbot: QtBot, panel: ConversationPanel) -> None:
    go_to(panel, "t4")
    press(qtbot, panel, Qt.Key.Key_Return)
    assert not panel.view.writing


def test_one_key_says_who_it_was(qtbot: QtBot, panel: ConversationPanel, console: FakeConsole) -> None:
    go_to(panel, "t3")
    for _ in range(7):
        press(qtbot, panel, Qt.Key.Key_S)
    told = [(made["speaker"], made["person_id"]) for _id, made in console.named("correct_utterance")]
    here = [("participant", person_id) for person_id in ("p1", "p2", "p3")]
    assert told == [*here, ("robot", ""), ("wizard", ""), ("", ""), ("participant", "")]


def test_tags_and_a_mark(qtbot: QtBot, panel: ConversationPanel, console: FakeConsole) -> None:
    go_to(panel, "t1")
    press(qtbot, panel, Qt.Key.Key_T)
    field = find(panel.window(), "transcript_field")
    assert isinstance(field, SubmitTextEdit)
    field.setPlainText("greeting,  polite , greeting")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert panel.view.rows[0].tags == ("greeting", "polite")
    press(qtbot, panel, Qt.Key.Key_M)
    (mark,) = console.named("mark")
    assert mark == ("", "mark")
    made = next(iter(console.marks.values()))
    assert made.start_ns == pytest.approx(panel.view.rows[0].begins_ns, abs=100_000_000), "it is where the turn began"


def test_words_left_without_enter_are_as_they_were(
    qtbot: QtBot, panel: ConversationPanel, console: FakeConsole
) -> None:
    go_to(panel, "t5")
    for leave in (Qt.Key.Key_Escape, Qt.Key.Key_Tab):
        press(qtbot, panel, Qt.Key.Key_Return)
        field = find(panel.window(), "transcript_field")
        QTest.keyClicks(field, " and dance")
        QTest.keyClick(field, leave)
        assert not panel.view.writing
    assert console.named("correct_utterance") == []


def ink(panel: ConversationPanel, row: int, role: str) -> int:
    """Number of pixels of a turn's text that have nearly this colour."""
    rect = words_rect(panel.view.row_rect(row))
    image = panel.view.viewport().grab(rect).toImage()
    color = panel.theme.color(role)
    return sum(
        abs(pixel.red() - color.red()) + abs(pixel.green() - color.green()) + abs(pixel.blue() - color.blue()) < 30
        for pixel in (image.pixelColor(x, y) for x in range(image.width()) for y in range(image.height()))
    )


def test_words_that_may_change_are_dim_and_those_that_are_found_stand_out(
    panel: ConversationPanel, console: FakeConsole
) -> None:
    last = len(panel.view.rows)
    console.say_turn(replace(utterance(1, text="-", state="started"), text=""))
    console.state.add(Hearing(clock.now_ns(), ROBOT_MICROPHONE, True, "participant", "n1", "And how", "heavy his"))
    assert ink(panel, last, "text") > 20 < ink(panel, last, "dim")
    assert ink(panel, last - 1, "text") > 20
    assert ink(panel, last - 1, "amber") == 0
    panel.search("moves")
    assert ink(panel, last - 1, "amber") > 20 < ink(panel, last - 1, "text")


def test_search_finds_turns_and_goes_through_them(qtbot: QtBot, panel: ConversationPanel) -> None:
    panel.open_search()
    field = find(panel.window(), "transcript_search")
    assert isinstance(field, QLineEdit)
    field.setText("TALKS")
    assert panel.view.current == "t3"
    field.setText("robot")
    assert (panel.view.current, found_label(panel)) == ("t4", "2 of 2")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert (panel.view.current, found_label(panel)) == ("t2", "1 of 2"), "what the robot said is found by who said it"
    field.setText("no such words")
    assert found_label(panel) == "0 turns"
    QTest.keyClick(field, Qt.Key.Key_Escape)
    assert not field.isVisible()


def found_label(panel: ConversationPanel) -> str:
    return str(find(panel.window(), "transcript_found").text())  # type: ignore[attr-defined]


def test_a_click_selects_a_turn_and_gives_the_list_the_keys(qtbot: QtBot, panel: ConversationPanel) -> None:
    panel.view.follow()
    last = len(panel.view.rows) - 1
    QTest.mouseClick(
        panel.view.viewport(), Qt.MouseButton.LeftButton, pos=panel.view.row_rect(last).topLeft() + QPoint(60, 12)
    )
    assert panel.view.current == "t5"
    assert panel.view.hasFocus()
    assert panel.view.acts("t5") == ("text", "who", "tags", "mark")
    shown = [part for part in panel.view.viewport().findChildren(ActionButton) if part.isVisible()]
    assert [part.objectName() for part in shown] == ["turn_text", "turn_who", "turn_tags", "turn_mark"]
    assert all(panel.view.row_rect(last).contains(part.parentWidget().geometry()) for part in shown)
    assert {icon for icon, _tip in BUTTONS.values()} <= icon_names()


def test_the_console_is_not_believed_over_the_wizard(panel: ConversationPanel, console: FakeConsole) -> None:
    console.say_turn(UtteranceCorrected(clock.now_ns(), "t3", person_id="p2", actor="wizard"))
    console.say_turn(UtteranceCorrected(clock.now_ns(), "t3", person_id="p1", actor="console"))
    assert said(panel)[2] == ("Ana Torres", "Oh nice, it talks.")


def test_two_keys_work_from_everywhere(qtbot: QtBot, panel: ConversationPanel, console: FakeConsole) -> None:
    """The newest heard turn, whoever spoke since, and the search field."""
    window = panel.window()
    console.say_turn(utterance(8))
    QTest.keyClick(window, Qt.Key.Key_S, Qt.KeyboardModifier.ControlModifier | Qt.KeyboardModifier.ShiftModifier)
    assert console.named("correct_utterance") == [("t5", {"speaker": "participant", "person_id": "p2"})]
    assert panel.view.rows[-2].who == "Ana Torres"
    QTest.keyClick(window, Qt.Key.Key_F, Qt.KeyboardModifier.ControlModifier)
    qtbot.waitUntil(find(window, "transcript_search").hasFocus)


def test_a_click_shows_the_photo_of_that_moment_if_there_is_one(
    qtbot: QtBot, panel: ConversationPanel, console: FakeConsole
) -> None:
    _, jpeg = cv2.imencode(".jpg", np.full((60, 100, 3), 90, np.uint8))
    begins_ns = {row.utterance_id: row.begins_ns for row in panel.view.rows}
    utc_ns = console.state.present.anchor.utc_ns_at(begins_ns["t4"]) + 500_000_000
    console.state.photos.set((PhotoEntry("photos/photo-0003.png", utc_ns, thumbnail_jpeg=jpeg.tobytes()),))
    shown = panel.view.findChild(PhotoThumbnail, "photo_thumbnail")
    assert isinstance(shown, PhotoThumbnail)
    for utterance_id, there in (("t4", True), ("t2", False)):
        panel.view.picked.emit(utterance_id)
        assert shown.isVisible() is there
    assert (shown.image is not None, shown.accessibleName()) == (True, "Photo of this moment: photos/photo-0003.png")


# In a replay


@pytest.fixture
def past(
    qtbot: QtBot, settings: MemorySettings, theme: Theme
) -> Iterator[tuple[ConversationPanel, FakeReplay, list[int]]]:
    """A replay of thirty turns of 4 s, and the displayed time, which a test changes."""
    replay, now_ns = FakeReplay(), [STARTED_NS]
    console = FakeConsole(samples.TOUR)
    console.state = LiveState(present=PresentClock(lambda: now_ns[0], replay.session.clock.anchor, live=False))
    window = MainWindow(console, settings=settings, theme=theme)
    qtbot.addWidget(window)
    window.use_replay(replay)
    window.resize(1366, 768)
    window.show()
    window.open_panel("conversation")
    found = window.panels["conversation"]
    assert isinstance(found, ConversationPanel)
    turns = [utterance(number, stamp_ns=STARTED_NS + number * 4_000_000_000) for number in range(30)]
    console.transcript = Transcript()
    for turn in turns:
        console.transcript.add(turn)
    console.state.transcript.reset_value(console.transcript.turns)
    qtbot.waitUntil(lambda: len(found.view.rows) == 30)
    yield found, replay, now_ns


def test_a_replay_has_all_turns_and_stays_at_the_moment_on_show(
    qtbot: QtBot, past: tuple[ConversationPanel, FakeReplay, list[int]]
) -> None:
    panel, _replay, now_ns = past
    now_ns[0] = STARTED_NS + 50_000_000_000
    qtbot.waitUntil(lambda: panel.view.row_rect(12).intersects(panel.view.viewport().rect()))
    assert panel.view.row_rect(12).bottom() <= panel.view.viewport().height()
    assert not find_all(panel, "new_below"), "nothing is new in what is over"
    panel.open_search()
    panel.search("29")
    assert panel.view.current == "n29", "what lies ahead is found too"


def find_all(panel: ConversationPanel, name: str) -> list[QWidget]:
    return [widget for widget in panel.findChildren(QWidget, name) if widget.isVisible()]


def test_a_click_goes_to_where_the_turn_begins(
    qtbot: QtBot, past: tuple[ConversationPanel, FakeReplay, list[int]]
) -> None:
    panel, replay, now_ns = past
    now_ns[0] = STARTED_NS + 50_000_000_000
    panel.view.show_turn(10)
    at = panel.view.row_rect(10).topLeft() + QPoint(60, 12)
    QTest.mouseClick(panel.view.viewport(), Qt.MouseButton.LeftButton, pos=at)
    assert replay.named("seek") == [STARTED_NS + 40_000_000_000]
    panel.view.setFocus()
    qtbot.waitUntil(panel.view.hasFocus)
    QTest.keyClick(panel.view, Qt.Key.Key_Down)
    QTest.keyClick(panel.view, Qt.Key.Key_Return)
    assert replay.named("seek")[-1] == STARTED_NS + 44_000_000_000
    assert not panel.view.writing, "what was said is not changed any more"


def test_a_replay_shows_the_words_as_they_came(
    qtbot: QtBot, past: tuple[ConversationPanel, FakeReplay, list[int]]
) -> None:
    """Turn 5 lasts from 20 s to 22 s of the session."""
    panel, _replay, now_ns = past
    begun = utterance(5, text="-", state="started", stamp_ns=STARTED_NS + 20_000_000_000)
    transcript = Transcript()
    for event in (begun, replace(begun, stamp_ns=begun.stamp_ns + 2_000_000_000, state="finished", text="All of it.")):
        transcript.add(event)
    panel.state.transcript.reset_value(transcript.turns)
    now_ns[0] = begun.stamp_ns + 1_000_000_000
    panel.state.add(Hearing(now_ns[0], ROBOT_MICROPHONE, True, "participant", "n5", "All", "off"))
    assert (panel.view.rows[0].text, panel.view.rows[0].tentative) == ("All", "off")
    assert panel.fact == ("The participant is talking", "green")
    now_ns[0] = begun.stamp_ns + 2_600_000_000
    qtbot.waitUntil(lambda: panel.view.rows[0].text == "All of it.")
    assert panel.fact == ("0.6 s since the participant stopped talking", "green")
