"""Preflight checks in the window and in the start dialog."""

from collections.abc import Iterator
from dataclasses import replace

import pytest
from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication, QLabel, QWidget
from pytestqt.qtbot import QtBot

from caris_desktop.domain.actor import WIZARD
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import PreflightChecked, TrialDetails
from caris_desktop.live.state import PresentClock
from caris_desktop.live.status import MicrophoneStatus, PreflightCheck, RecordingStatus
from caris_desktop.live.wizard_console import BeforeRecording
from caris_desktop.scenario.scenario_model import Permissions
from caris_desktop.ui.event_messages import check_line, check_state, checks_summary, worst_check
from caris_desktop.ui.preflight_list import PreflightButton, PreflightCard, PreflightRow
from caris_desktop.ui.start_dialog import StartDialog
from caris_desktop.ui.theme import Theme
from tests.ui import samples
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

ROBOT = PreflightCheck("robot", "Robot is connected", "passed", "TIAGo is connected.")
STOPPED = PreflightCheck("emergency_stop", "Emergency stop is released", "major", "It is pressed.", "Release it.")
SOUND = PreflightCheck(
    "microphone", "Microphone works", "not checked", "The microphone has not been tested yet.", "Try it."
)
FORM = PreflightCheck("by hand: Form", "Consent form signed", advice="Give them the form.", manual=True, needed=True)
CHECKS = (ROBOT, STOPPED, SOUND, FORM)
READY = (ROBOT, replace(STOPPED, state="passed"), replace(SOUND, state="passed"), replace(FORM, state="passed"))


@pytest.fixture
def console() -> Iterator[FakeConsole]:
    made = FakeConsole(replace(samples.TOUR, permissions=Permissions(audio_recording=True)))
    made.state.preflight.set(CHECKS)
    yield made
    made.state.close()


@pytest.fixture
def window(qtbot: QtBot) -> QWidget:
    made = QWidget()
    qtbot.addWidget(made)
    made.resize(1366, 768)
    made.show()
    return made


@pytest.fixture
def card(theme: Theme, window: QWidget, console: FakeConsole) -> PreflightCard:
    made = PreflightCard(theme, window, console)
    made.open()
    return made


def test_a_list_that_nobody_sees_is_made_when_a_person_does(
    theme: Theme, window: QWidget, console: FakeConsole, qtbot: QtBot
) -> None:
    made = PreflightCard(theme, window, console)
    console.state.preflight.set(READY)
    assert made.list.findChildren(PreflightRow) == [], "another scenario has other checks: each switch would make rows"
    made.open()
    qtbot.waitUntil(lambda: len(made.list.findChildren(PreflightRow)) == len(READY))
    assert STOPPED.detail not in texts(made)


def texts(widget: QWidget) -> list[str]:
    return [label.text() for label in widget.findChildren(QLabel) if label.isVisible() and label.text()]


def test_the_summary_counts_what_is_open_and_names_the_worst() -> None:
    assert (checks_summary(CHECKS), worst_check(CHECKS)) == ("3 of 4 to check", "major")
    assert (checks_summary(READY), worst_check(READY)) == ("All 4 checks passed", "passed")


def test_the_button_follows_and_is_away_while_a_recording_runs(
    qtbot: QtBot, theme: Theme, window: QWidget, console: FakeConsole
) -> None:
    button = PreflightButton(theme, console)
    button.setParent(window)
    button.show()
    assert (button.text(), button.role, button.isVisible()) == ("3 of 4 to check", "red", True)
    assert "Major" in button.accessibleName()
    console.state.preflight.set(READY)
    assert (button.text(), button.role) == ("All 4 checks passed", "green")
    console.state.recording.set(RecordingStatus("recording"))
    assert not button.isVisible()
    console.state.recording.set(RecordingStatus("idle"))
    assert button.isVisible()


def test_each_check_says_how_it_stands_and_what_to_do(card: PreflightCard) -> None:
    assert list(card.list.rows) == ["by hand: Form", "robot", "emergency_stop", "microphone"], "what waits comes first"
    assert texts(card.list.rows["emergency_stop"]) == [STOPPED.title, "It is pressed.", "Release it.", "Major"]
    assert texts(card.list.rows["robot"]) == [ROBOT.title, "Passed"]
    assert card.list.rows["emergency_stop"].accessibleName() == "Emergency stop is released: Major"


def test_the_card_is_as_high_as_its_rows(qtbot: QtBot, card: PreflightCard, window: QWidget) -> None:
    last = list(card.list.rows.values())[-1]
    card.close_overlay()
    window.resize(240, 768)
    card.open()
    QApplication.processEvents()
    card.close_overlay()
    window.resize(1366, 768)
    card.open()
    qtbot.waitUntil(last.isVisible)
    assert 0 <= card.card.height() - last.mapTo(card.card, last.rect().bottomLeft()).y() < 48 < window.height() / 2


def test_a_reason_that_a_status_gives_reads_as_a_sentence() -> None:
    blind = PreflightCheck("guard", "Guard", "major", "the laser is covered")
    assert check_state(blind, ClockAnchor(0, 0)) == "The laser is covered."
    assert check_state(replace(blind, detail=""), ClockAnchor(0, 0)) == ""


def test_a_check_by_hand_is_ticked_by_keyboard(qtbot: QtBot, card: PreflightCard, console: FakeConsole) -> None:
    row = card.list.rows[FORM.id]
    assert row.box is not None
    qtbot.keyClick(row.box, Qt.Key.Key_Space)
    assert console.named("tick_check") == [(FORM.id, True)]
    assert row.box.isChecked()
    assert any(text.startswith("Ticked by you at ") for text in texts(row))
    qtbot.keyClick(row.box, Qt.Key.Key_Space)
    assert console.named("tick_check")[-1] == (FORM.id, False)


def test_the_microphone_is_tried_from_the_list(qtbot: QtBot, card: PreflightCard, console: FakeConsole) -> None:
    click(qtbot, find(card, "preflight_try_microphone"))
    assert console.named("try_microphone") == [True]
    console.state.microphone.set(MicrophoneStatus("on"))
    console.state.preflight.set((ROBOT, STOPPED, replace(SOUND, state="pending"), FORM))
    assert not card.list.rows["microphone"].try_button.isVisible()  # type: ignore[union-attr]


def test_another_scenario_has_other_rows(card: PreflightCard, console: FakeConsole) -> None:
    console.state.preflight.set((ROBOT,))
    assert list(card.list.rows) == ["robot"]
    assert "Check yourself" not in texts(card)


def test_a_replay_shows_the_recorded_checks_and_changes_nothing(
    qtbot: QtBot, theme: Theme, window: QWidget, console: FakeConsole
) -> None:
    console.state.present = PresentClock(live=False)
    console.state.recording.set(RecordingStatus("recording"))
    button = PreflightButton(theme, console)
    button.setParent(window)
    button.show()
    assert button.text() == "3 of 4 checks were open"
    card = PreflightCard(theme, window, console)
    card.open()
    assert "3 of 4 checks were open when this recording started." in texts(card)
    row = card.list.rows[FORM.id]
    assert row.box is not None and not row.box.isEnabled()
    assert card.list.rows["microphone"].try_button is not None
    assert not card.list.rows["microphone"].try_button.isVisible()


class Dialog:
    def __init__(self, qtbot: QtBot, theme: Theme, window: QWidget, console: FakeConsole) -> None:
        self.begun: list[tuple[TrialDetails, bool]] = []
        self.dialog = StartDialog(theme, window, console)
        self.dialog.know(BeforeRecording(TrialDetails(participant="P1")))
        self.dialog.begin.connect(lambda details, anyway: self.begun.append((details, anyway)))
        self.dialog.open()
        self.qtbot = qtbot

    def start(self) -> None:
        click(self.qtbot, find(self.dialog, "start_dialog_begin"))


@pytest.fixture
def dialog(qtbot: QtBot, theme: Theme, window: QWidget, console: FakeConsole) -> Dialog:
    return Dialog(qtbot, theme, window, console)


@pytest.mark.usefixtures("screen_reader")
def test_failed_checks_are_asked_about_once(dialog: Dialog) -> None:
    dialog.start()
    assert dialog.begun == []
    asked = find(dialog.dialog, "start_asked")
    assert isinstance(asked, QLabel)
    assert "“Emergency stop is released”, “Consent form signed”" in asked.text()
    assert find(dialog.dialog, "announcement").accessibleName() == asked.text()
    dialog.start()
    assert dialog.begun == [(TrialDetails(participant="P1"), True)]


def test_a_question_that_is_answered_meanwhile_is_asked_no_more(dialog: Dialog, console: FakeConsole) -> None:
    dialog.start()
    console.state.preflight.set(READY)
    assert not dialog.dialog._question.isVisible()
    dialog.start()
    assert dialog.begun == [(TrialDetails(participant="P1"), False)]


def test_the_dialog_fits_the_screen_and_its_buttons_are_never_cut_off(dialog: Dialog, window: QWidget) -> None:
    room = window.screen().availableGeometry()
    assert dialog.dialog.height() <= room.height()
    dialog.dialog.resize(600, 320)  # as on a small screen at 200 %
    button = find(dialog.dialog, "start_dialog_begin")
    assert dialog.dialog.rect().contains(button.geometry())


def test_minor_things_do_not_keep_anybody(dialog: Dialog, console: FakeConsole) -> None:
    console.state.preflight.set((ROBOT, SOUND, replace(STOPPED, state="minor"), replace(FORM, needed=False)))
    dialog.start()
    assert [anyway for _, anyway in dialog.begun] == [False]


def test_the_log_has_ticks_and_what_was_open() -> None:
    def line(**told: object) -> tuple[str, str] | None:
        return check_line(replace(PreflightChecked(1, "robot", "Robot is connected", "passed"), **told))

    assert line() == ("Session", "Checked: Robot is connected")
    assert line(state="not checked") == ("Session", "No longer checked: Robot is connected")
    assert line(at_start=True) is None
    assert line(at_start=True, state="minor") == ("Session", "Started with: Robot is connected (minor)")
    assert line(at_start=True, state="major", accepted=True) == (
        "Session",
        "Started despite: Robot is connected (major)",
    )
    ticked = replace(FORM, state="passed", actor=WIZARD, checked_ns=60_000_000_000)
    assert check_state(ticked, ClockAnchor(0, 0)).startswith("Ticked by you at ")
    assert check_state(replace(ticked, actor="wizard:b"), ClockAnchor(0, 0)).startswith("Ticked by another wizard at")


def test_items_to_tick_are_read_to_their_end(qtbot: QtBot, theme: Theme, console: FakeConsole) -> None:
    title = "The participant knows that they can stop at any time, and who sees and hears what is recorded of them"
    console.state.preflight.set((*CHECKS, replace(FORM, id="by hand: stop", title=title)))
    parent = QWidget()
    qtbot.addWidget(parent)
    parent.resize(1366, 768)
    parent.show()
    dialog = StartDialog(theme, parent, console)
    dialog.open()
    row = next(row for row in dialog.findChildren(PreflightRow) if row.accessibleName().startswith(title))
    assert row.box is not None
    box = row.box
    qtbot.waitUntil(box.isVisible)
    assert box.heightForWidth(box.width()) > box.fontMetrics().height() * 1.5, "it does not fit into one line here"
    qtbot.waitUntil(lambda: box.height() >= box.heightForWidth(box.width()))
    dialog.reject()
