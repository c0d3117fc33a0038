"""Card of a person: reading and editing data, merging, splitting and erasure."""

import dataclasses
import time
from collections.abc import Iterator
from datetime import datetime

import pytest
from PySide6.QtCore import QRect, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QLabel, QLineEdit, QPlainTextEdit
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.events import PersonIdentified
from caris_desktop.people.people_store import HistoryEntry
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.people_panel import PeoplePanel
from caris_desktop.ui.people.person_card import PersonCard, how_known, tags_of, what, when, who_stays
from tests.ui import people_samples
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole
from tests.ui.panels.test_people_panel import press

pytestmark = pytest.mark.panels("people")

NOW_NS = round(datetime(2026, 11, 22, 14, 30).timestamp() * 1e9)
MINUTE_NS = people_samples.MINUTE_NS
HISTORY = (
    HistoryEntry("heard", NOW_NS - 2 * MINUTE_NS, "s2", "Can it hurt people?"),
    HistoryEntry("said", NOW_NS - 3 * MINUTE_NS, "s2", "Over there is our robot arm, {p-luis}."),
    HistoryEntry("visit", NOW_NS - 1440 * MINUTE_NS, "s1", until_utc_ns=NOW_NS - 1432 * MINUTE_NS),
)


@pytest.fixture
def panel(window: MainWindow, console: FakeConsole) -> Iterator[PeoplePanel]:
    panel = window.panels["people"]
    assert isinstance(panel, PeoplePanel)
    console.history["p-luis"] = HISTORY
    people_samples.show_people(console, people_samples.people_of_a_tour())
    console.calls.clear()
    yield panel


def opened(panel: PeoplePanel, console: FakeConsole, person_id: str) -> PersonCard:
    panel.open_card(person_id)
    card = panel.card
    assert card is not None
    console.calls.clear()
    return card


def field(window: MainWindow, name: str) -> QLineEdit:
    found = find(window, name)
    assert isinstance(found, QLineEdit)
    return found


def history(card: PersonCard) -> list[str]:
    entries = card.about.history.entries
    return [str(entries.index(row, 0).data()) for row in range(entries.rowCount())]


def asked(console: FakeConsole) -> list[tuple[str, object]]:
    return [call for call in console.calls if call[0] != "look_up_person"]


@pytest.mark.panels()
def test_the_card_opens_next_to_the_row_and_leaves_the_keys_in_its_panel(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    view = find(window, "video_view")
    view.setFocus()
    press(qtbot, panel, "p-luis", "card")
    card = panel.card
    assert card is not None
    assert card.isVisible()
    assert card.person_id == "p-luis"
    assert not card.isWindow()
    assert panel.focus_target().hasFocus()
    place = QRect(card.pos(), card.size())
    assert window.rect().contains(place)
    assert not place.intersects(QRect(view.mapTo(window, view.rect().topLeft()), view.size()))
    click(qtbot, find(window, "person_card_close"))
    assert card.isHidden()


def test_the_card_shows_who_it_is_and_how_that_is_known(
    window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    opened(panel, console, "p-luis")
    assert find(window, "person_card_name").property("text") == "Luis"
    assert find(window, "person_how").property("text") == "Recognised by clothing, today only (94 %)."
    assert field(window, "person_group").text() == "Group 1"
    assert field(window, "person_tags").text() == "asks a lot"
    opened(panel, console, "p-3")
    assert find(window, "person_card_name").property("text") == "Person 3"
    assert field(window, "person_card_name_field").text() == ""


def test_the_card_grows_old_with_the_person(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    opened(panel, console, "p-luis")
    rows = console.state.persons.value
    earlier = dataclasses.replace(rows[0], since_ns=rows[0].since_ns - 60 * MINUTE_NS)
    # As after an hour, without a notification of the change.
    console.state.persons.value = (earlier, *rows[1:])
    qtbot.waitUntil(lambda: "here for 63 min" in str(find(window, "person_card_seen").property("text")))


def test_an_uncertain_promise_is_stated() -> None:
    luis, ana, third, *_ = people_samples.people_of_a_tour(10**12)
    agreed = dataclasses.replace(ana, consents=("face",))
    clothing, both = ("clothing",), ("clothing", "face")
    assert "Nobody is recognised on other days" in how_known(third, "clothing", both)
    assert "by face on other days requires consent" in how_known(third, "faces", both)
    assert "by face" in how_known(agreed, "faces", both)
    assert "no face recognition model" in how_known(agreed, "faces", clothing)
    assert "this computer has no recognition model" in how_known(third, "clothing", ())
    assert "by face" not in how_known(dataclasses.replace(luis, consents=("face",)), "clothing", both)
    assert how_known(third, "nobody", both).startswith("People are not recognised in this scenario")
    assert how_known(dataclasses.replace(luis, confidence=0.0), "clothing", both) == "Identified by you."


@pytest.mark.panels()
def test_a_note_is_saved_when_the_field_is_left(window: MainWindow, panel: PeoplePanel, console: FakeConsole) -> None:
    opened(panel, console, "p-4")
    name = field(window, "person_card_name_field")
    name.setFocus()
    QTest.keyClicks(name, " Eva  Lind ")
    QTest.keyClick(name, Qt.Key.Key_Return)
    group = field(window, "person_group")
    group.setFocus()
    QTest.keyClicks(group, "Group 9")
    tags = field(window, "person_tags")
    tags.setFocus()
    QTest.keyClicks(tags, "shy, tall,shy , ")
    note = find(window, "person_note")
    assert isinstance(note, QPlainTextEdit)
    note.setFocus()
    QTest.keyClicks(note, "Likes trains")
    find(window, "speak_field").setFocus()
    assert asked(console) == [
        ("rename_person", ("p-4", "Eva Lind")),
        ("set_person_group", ("p-4", "Group 9")),
        ("tag_person", ("p-4", ("shy", "tall"))),
        ("note_person", ("p-4", "Likes trains")),
    ]


def test_esc_stops_the_robot_and_leaves_what_was_not_finished(
    window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    card = opened(panel, console, "p-luis")
    group = field(window, "person_group")
    group.setFocus()
    group.selectAll()
    QTest.keyClicks(group, "Elsewhere")
    QTest.keyClick(group, Qt.Key.Key_Escape)
    assert asked(console) == [("stop", None)]
    assert card.isHidden()
    opened(panel, console, "p-luis")
    assert field(window, "person_group").text() == "Group 1"


def test_updates_take_nothing_that_is_being_typed(window: MainWindow, panel: PeoplePanel, console: FakeConsole) -> None:
    opened(panel, console, "p-luis")
    tags = field(window, "person_tags")
    tags.setFocus()
    tags.selectAll()
    QTest.keyClicks(tags, "tal")
    console.set_person_group("p-luis", "Group 3")
    QTest.keyClicks(tags, "l")
    assert tags.text() == "tall"
    assert field(window, "person_group").text() == "Group 3"


def test_a_group_that_exists_completes_itself_without_a_popup(
    window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    opened(panel, console, "p-4")
    group = field(window, "person_group")
    group.setFocus()
    QTest.keyClicks(group, "gro")
    assert group.text().lower().startswith("group ")
    assert group.selectedText(), "the rest can be typed over"


def test_a_consent_is_noted_with_a_click(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    opened(panel, console, "p-luis")
    click(qtbot, find(window, "consent_photo"))
    assert asked(console) == [("note_consent", ("p-luis", "photo", True))]
    click(qtbot, find(window, "consent_photo"))
    assert asked(console)[1:] == [("note_consent", ("p-luis", "photo", False))]


def test_both_who_are_likeliest_can_be_chosen(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    card = opened(panel, console, "p-3")
    labels = [find(window, f"person_suggestion_{number}").findChild(QLabel) for number in (0, 1)]
    assert [label.text() for label in labels] == ["Maybe Mara Silva (82 %)", "or Guest 003 (11 %)"]
    click(qtbot, find(window, "person_suggestion_yes_1"))
    assert asked(console)[0] == ("confirm_person", ("p-3", "p-k3"))
    console.state.add(PersonIdentified(clock.now_ns(), "p-3", "p-k3", "wizard", 0.1))
    assert card.person_id in ("p-3", "p-k3")
    assert find(window, "person_card_name").property("text") == "Guest 003", "the card stays with who stands there"


def test_a_wrong_recognition_and_two_merged_people_are_corrected(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    opened(panel, console, "p-luis")
    click(qtbot, find(window, "person_not"))
    click(qtbot, find(window, "person_split"))
    assert asked(console) == [("reject_person", ("p-luis", "p-luis")), ("split_person", "p-luis")]


# History


def test_the_history_over_all_sessions_is_shown_and_searched(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    panel.open_card("p-luis")
    card = panel.card
    assert card is not None
    assert console.named("look_up_person") == [("p-luis", "")]
    assert history(card) == ["“Can it hurt people?”", "Robot: “Over there is our robot arm, Luis.”", "Visit, 8 min"]
    search = field(window, "person_history_search")
    search.setFocus()
    QTest.keyClicks(search, "arm")
    qtbot.waitUntil(lambda: history(card) == ["Robot: “Over there is our robot arm, Luis.”"])
    assert console.named("look_up_person")[-1] == ("p-luis", "arm"), "asked once the typing pauses"
    QTest.keyClicks(search, "x")
    qtbot.waitUntil(lambda: history(card) == [])
    assert find(window, "person_no_history").property("text") == "No matches in the history."
    panel.open_card("p-ana")
    assert search.text() == ""
    assert find(window, "person_no_history").property("text") == "No earlier entries."


def test_times_are_reported_as_a_person_reports_them() -> None:
    today = datetime(2026, 11, 22, 15, 0)
    assert when(NOW_NS, today) == "14:30"
    assert when(NOW_NS - 1440 * MINUTE_NS, today) == "21 Nov, 14:30"
    assert when(round(datetime(2025, 3, 1, 9, 5).timestamp() * 1e9), today) == "1 Mar 2025, 09:05"
    assert what(HistoryEntry("photo", NOW_NS, "s", "photos/photo-0003.png")) == "Photo photo-0003.png"
    assert what(HistoryEntry("note", NOW_NS, "s", "Likes trains")) == "Likes trains"


# One person, two, none


def test_two_are_merged_after_both_were_seen_side_by_side(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    card = opened(panel, console, "p-4")
    click(qtbot, find(window, "person_merge"))
    assert find(window, "merge_title").property("text") == "Who is the same person as Person 4?"
    search = field(window, "merge_field")
    search.setFocus()
    QTest.keyClicks(search, "mara")
    click(qtbot, find(window, "merge_with_0"))
    assert asked(console) == [], "nothing is done before both were seen"
    told = find(window, "merge_told").property("text")
    assert told == "The visits, photos and notes of Person 4 are moved to Mara Silva. You can undo this."
    click(qtbot, find(window, "merge_do"))
    assert asked(console) == [("merge_people", ("p-4", "p-mara"))]
    assert card.person_id == "p-mara"
    assert card.page == "about"


def test_the_suggested_person_is_offered_first_to_merge_with(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    opened(panel, console, "p-3")
    click(qtbot, find(window, "person_merge"))
    assert find(window, "merge_with_0").property("text") == "Mara Silva · Group 2"
    assert find(window, "merge_with_1").property("text") == "Guest 003 · Group 3"


def test_of_two_the_one_with_a_name_stays() -> None:
    luis, ana, third, fourth, *_ = people_samples.people_of_a_tour(10**12)

    def ids(pair: tuple[PersonRow, PersonRow]) -> tuple[str, str]:
        return pair[0].person_id, pair[1].person_id

    assert ids(who_stays(third, luis)) == ("p-3", "p-luis")
    assert ids(who_stays(luis, third)) == ("p-3", "p-luis")
    assert ids(who_stays(ana, luis)) == ("p-luis", "p-ana"), "of two with names the one whose card it is"
    assert ids(who_stays(third, fourth)) == ("p-4", "p-3")


def test_forgetting_asks_and_esc_stops_the_robot_meanwhile(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    console.stop_session()
    card = opened(panel, console, "p-luis")
    click(qtbot, find(window, "person_forget"))
    assert "cannot be undone" in find(window, "forget_what").property("text")
    assert not window.findChild(QLabel, "forget_not_now").isVisible()
    QTest.keyClick(window, Qt.Key.Key_Escape)
    assert asked(console) == [("stop", None)]
    assert card.isVisible()
    assert card.page == "about", "the question went away, and nothing was forgotten"
    click(qtbot, find(window, "person_forget"))
    click(qtbot, find(window, "forget_keep"))
    assert card.page == "about"
    click(qtbot, find(window, "person_forget"))
    click(qtbot, find(window, "forget_do"))
    assert asked(console)[1:] == [("forget_person", "p-luis")]
    assert card.isHidden()
    assert "p-luis" not in [person.person_id for person in panel.everyone]


def test_nobody_is_forgotten_while_a_session_is_recorded(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    opened(panel, console, "p-luis")
    click(qtbot, find(window, "person_forget"))
    assert find(window, "forget_not_now").property("text") == "A session is being recorded. Stop the recording first."
    click(qtbot, find(window, "forget_do"))
    assert asked(console) == []


def test_the_card_goes_with_its_panel(window: MainWindow, panel: PeoplePanel, console: FakeConsole) -> None:
    card = opened(panel, console, "p-luis")
    window.dock_host.close_panel("people")
    assert card.isHidden()


def test_tags_are_words_between_commas() -> None:
    assert tags_of(" a,  b  c ,,a ") == ("a", "b c")
    assert tags_of("") == ()


def test_the_card_stays_in_a_window_that_shrinks(
    qtbot: QtBot, window: MainWindow, panel: PeoplePanel, console: FakeConsole
) -> None:
    card = opened(panel, console, "p-luis")
    window.resize(1024, 640)
    deadline_s = time.monotonic() + 5
    while not window.rect().contains(QRect(card.pos(), card.size())) and time.monotonic() < deadline_s:
        qtbot.wait(10)
    assert window.rect().contains(QRect(card.pos(), card.size()))


def test_the_fields_of_a_card_have_one_left_edge(panel: PeoplePanel, console: FakeConsole, window: MainWindow) -> None:
    card = opened(panel, console, "p-luis")
    names = ("person_card_name_field", "person_group", "person_tags", "person_history_search")
    assert len({find(card, name).x() for name in names}) == 1
