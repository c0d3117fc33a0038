"""Suggested replies and proposals in the window: each with a key, at a constant place that blocks nothing."""

from dataclasses import replace

import pytest
from PySide6.QtCore import QEvent, Qt
from PySide6.QtTest import QTest
from PySide6.QtWidgets import QAbstractButton, QApplication, QLabel, QMenu, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.live.status import DisplayedReply, LevelsStatus, ProposalStatus, SuggestionsStatus
from caris_desktop.people.presence import PersonRow
from caris_desktop.scenario.scenario_model import AssistanceSettings
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.conversation_panel import LevelsButton, SuggestionCards
from caris_desktop.ui.people.shown_people import IdentityQuestion
from tests.support.window_check import painted_by
from tests.ui.conftest import find
from tests.ui.fake_console import FakeConsole

pytestmark = pytest.mark.panels("video", "speak")

CTRL, SHIFT = Qt.KeyboardModifier.ControlModifier, Qt.KeyboardModifier.ShiftModifier
TEXTS = ("It stops as soon as it touches something.", "Good question, {p-9}!", "Shall we go there?")
SHOWN = SuggestionsStatus(
    "shown", "t-1", 1, tuple(DisplayedReply(f"s-{rank}", rank, text) for rank, text in enumerate(TEXTS, 1)),
    "SmolLM2", 3, "Kitchen",
)  # fmt: skip
GO = ProposalStatus("a-1", "Go to Kitchen", True, "SmolLM2", 0, 2**62)


@pytest.fixture
def cards(window: MainWindow, console: FakeConsole) -> SuggestionCards:
    window.open_panel("conversation")
    console.state.levels.set(LevelsStatus("suggest", "suggest", "suggest"))
    console.state.suggestions.set(SHOWN)
    # Each new driving panel binds its keys again; only a running event loop deletes the old ones.
    QApplication.sendPostedEvents(None, QEvent.Type.DeferredDelete)
    QApplication.processEvents()
    found = window.findChild(SuggestionCards)
    assert found is not None
    return found


def driving(window: MainWindow) -> QWidget:
    assert window.focus_driving()
    focused = QApplication.focusWidget()
    assert focused is not None
    return focused


def test_the_keys_say_the_replies_while_typing_and_while_driving(
    cards: SuggestionCards, window: MainWindow, console: FakeConsole
) -> None:
    window.focus_speak()
    QTest.keyClick(find(window, "speak_field"), Qt.Key.Key_2, CTRL)
    QTest.keyClick(driving(window), Qt.Key.Key_1, CTRL)
    assert console.named("say_suggestion") == [(2, "s-2"), (1, "s-1")]
    QTest.keyClick(driving(window), Qt.Key.Key_0, CTRL)
    assert console.named("dismiss_suggestions") == [None]
    QTest.mouseClick(cards.cards[2], Qt.MouseButton.LeftButton)
    assert console.named("say_suggestion")[2:] == [(3, "s-3")]


def test_one_is_edited_in_the_speak_field_and_enter_says_it(
    cards: SuggestionCards, window: MainWindow, console: FakeConsole
) -> None:
    QTest.keyClick(driving(window), Qt.Key.Key_1, CTRL | SHIFT)
    field = find(window, "speak_field")
    assert field.hasFocus()
    QTest.keyClicks(field, " At once.")
    QTest.keyClick(field, Qt.Key.Key_Return)
    assert console.named("say_edited_suggestion") == [("s-1", f"{TEXTS[0]} At once.")]
    assert console.named("say") == []


def test_a_new_suggestion_is_not_spoken_at_once(
    cards: SuggestionCards, window: MainWindow, console: FakeConsole
) -> None:
    late = tuple(replace(card, from_ns=clock.now_ns() + 10**12) for card in SHOWN.cards)
    console.state.suggestions.set(replace(SHOWN, cards=late))
    QTest.keyClick(driving(window), Qt.Key.Key_1, CTRL)
    assert console.named("say_suggestion") == []


def test_none_of_them_moves_when_another_is_shown(cards: SuggestionCards, console: FakeConsole) -> None:
    def places() -> list[tuple[int, int]]:
        QApplication.processEvents()
        return [(card.mapTo(cards.window(), card.rect().topLeft()).y(), card.height()) for card in cards.cards]

    console.state.suggestions.set(replace(SHOWN, state="asking", cards=()))
    asked = places()
    console.state.suggestions.set(replace(SHOWN, cards=SHOWN.cards[:1]))
    assert places() == asked
    long = replace(SHOWN.cards[1], text="This is a rather long sentence. " * 3)
    console.state.suggestions.set(replace(SHOWN, cards=(SHOWN.cards[0], long)))
    assert places() == asked
    assert [card.text() for card in cards.cards] == [TEXTS[0], long.text, ""]


def test_it_says_what_they_are_made_from_and_shows_names(
    cards: SuggestionCards, window: MainWindow, console: FakeConsole
) -> None:
    console.state.persons.set((*console.state.persons.value, PersonRow("p-9", 9, "Mara", True, 0, 0)))
    console.state.suggestions.set(replace(SHOWN, person_id="p-9"))
    cards.fit(400)
    label = window.findChild(QLabel, "suggestions_from")
    assert label is not None
    assert "Suggested by SmolLM2, based on the last 3 turns, Kitchen, Mara" in label.text()
    assert cards.cards[1].text() == "Good question, Mara!"


def test_a_countdown_is_seen_and_a_late_reply_points_at_its_key(
    cards: SuggestionCards, window: MainWindow, console: FakeConsole
) -> None:
    label = window.findChild(QLabel, "suggestions_from")
    assert label is not None
    before = cards.cards[0].grab().toImage()
    console.state.suggestions.set(replace(SHOWN, says_ns=clock.now_ns() + 2 * 10**9))
    assert cards.cards[0].grab().toImage() != before
    console.state.suggestions.set(SuggestionsStatus("idle", filler_ns=clock.now_ns() - 1))
    assert label.text() == f"The reply is late: press F9 to say “{console.scenario.filler}”"
    console.state.levels.set(LevelsStatus("suggest", "act", "suggest"))
    console.state.suggestions.set(SuggestionsStatus("idle", filler_ns=clock.now_ns() + 10**12))
    assert label.text().startswith(f"“{console.scenario.filler}” will be said in ")
    QTest.keyClick(driving(window), Qt.Key.Key_0, CTRL)
    assert console.named("dismiss_suggestions") == [None]


def test_without_suggestions_nothing_stands_there(cards: SuggestionCards, console: FakeConsole) -> None:
    console.state.suggestions.set(SuggestionsStatus("idle"))
    assert not cards.isVisible()
    console.state.suggestions.set(SuggestionsStatus("failed", detail="The server is busy."))
    assert cards.isVisible() and not cards.cards[0].isVisible()


def test_one_key_confirms_a_proposal_another_rejects_it_and_a_question_about_a_person_goes_first(
    cards: SuggestionCards, window: MainWindow, console: FakeConsole
) -> None:
    console.state.proposal.set(GO)
    yes = find(window, "proposal_yes")
    assert isinstance(yes, QAbstractButton)
    field = driving(window)
    QTest.keyClick(field, Qt.Key.Key_Y)
    QTest.keyClick(field, Qt.Key.Key_Y, SHIFT)
    window.focus_speak()
    QTest.keyClick(find(window, "speak_field"), Qt.Key.Key_Return, CTRL)
    QTest.keyClick(find(window, "speak_field"), Qt.Key.Key_Return, CTRL | SHIFT)
    assert console.named("confirm_proposal") == ["a-1", "a-1"] and console.named("veto_proposal") == ["a-1", "a-1"]
    console.state.asked_person.set(IdentityQuestion("p3", "p1"))
    QTest.keyClick(find(window, "speak_field"), Qt.Key.Key_Return, CTRL)
    assert len(console.named("confirm_proposal")) == 2 and console.named("confirm_person") == [("p3", "p1")]
    console.state.asked_person.set(None)
    console.state.proposal.set(ProposalStatus())
    assert not yes.isVisible()


def test_a_proposal_that_has_only_just_come_up_is_not_confirmed(
    cards: SuggestionCards, window: MainWindow, console: FakeConsole
) -> None:
    console.state.proposal.set(replace(GO, from_ns=clock.now_ns() + 10**12))
    QTest.keyClick(driving(window), Qt.Key.Key_Y)
    assert console.named("confirm_proposal") == []


def test_levels_are_set_up_to_what_the_scenario_allows(
    cards: SuggestionCards, window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    console.scenario = replace(console.scenario, assistance=AssistanceSettings("act", "off", "suggest"))
    button = window.findChild(LevelsButton)
    assert button is not None
    button.fill()
    menu = button.findChild(QMenu, "levels_menu")
    assert menu is not None
    labels = [action.text() for action in menu.actions()]
    off, suggest, act = "Off", "Suggest (I confirm by key)", "Automatic (after a countdown)"
    assert labels == ["Suggested replies", off, suggest, act, "Proposed actions", off, suggest]
    menu.actions()[3].trigger()
    assert console.named("set_level") == [("replies", "act")]


def test_a_long_reply_has_two_lines_and_is_elided(cards: SuggestionCards, console: FakeConsole) -> None:
    long = "Good question, and there is a safety zone around the arm that stops it as soon as somebody comes near. " * 4
    replies = tuple(DisplayedReply(f"s-{rank}", rank, long if rank == 2 else "Yes.") for rank in (1, 2, 3))
    console.state.suggestions.set(replace(SHOWN, cards=replies))
    QApplication.processEvents()
    card = cards.cards[1]
    lines = [text for text in painted_by(card) if text.text.split() and text.text.split()[0] in long + "…"]
    assert len(lines) == 2 and lines[-1].text.rstrip().endswith("…")
    assert all(card.rect().toRectF().contains(line.box) for line in lines)
