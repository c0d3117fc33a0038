"""Resume of a trial after a crash: the offer, and questions about possible changes."""

from dataclasses import replace

import pytest
from PySide6.QtCore import QEvent, Qt
from PySide6.QtWidgets import QApplication, QLabel
from pytestqt.qtbot import QtBot

from caris_desktop.domain import intents
from caris_desktop.domain.events import TrialDetails
from caris_desktop.live.status import CrashRecoveryStatus, LevelsStatus, RecordingStatus
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.panels.map_panel import MapPanel
from caris_desktop.ui.panels.people_panel import PeoplePanel
from caris_desktop.ui.widgets.inputs import CheckBox
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole
from tests.ui.preflight.test_preflight import CHECKS

pytestmark = pytest.mark.panels("people", "map", "session")

P07 = TrialDetails(participant="P07", trial="2")
OFFERED = CrashRecoveryStatus("offered", "2026-11-22_10-00-00_P07", P07)


def test_it_is_offered_and_gone_on_with(window: MainWindow, console: FakeConsole, qtbot: QtBot) -> None:
    console.state.going_on.set(OFFERED)
    card = find(window, "going_on_card")
    text = find(card, "going_on_text")
    assert isinstance(text, QLabel) and "P07, trial 2" in text.text()
    click(qtbot, find(card, "going_on_yes"))
    assert console.named("GoOnWithTrial")
    console.state.going_on.set(CrashRecoveryStatus())
    assert card.isHidden()


@pytest.mark.parametrize("size", [(1366, 768), (1920, 1080)])
def test_no_alarm_lies_over_the_question(window: MainWindow, console: FakeConsole, size: tuple[int, int]) -> None:
    """Such a start begins with a robot that does not answer yet."""
    window.resize(*size)
    console.state.link.set(replace(console.state.link.value, state="lost"))
    console.state.going_on.set(OFFERED)
    card = find(window, "going_on_card")
    problems = window.problems
    assert problems.cards
    assert problems.isHidden() or not problems.geometry().intersects(card.geometry())
    unconfirmed = ("map", "people", "permissions", "consent")
    console.state.going_on.set(replace(OFFERED, state="unconfirmed", unconfirmed=unconfirmed))
    assert problems.isHidden() or not problems.geometry().intersects(card.geometry())
    assert not problems.isHidden() or problems.line.isVisible(), "it is told all the same"


def test_the_next_part_is_recorded_once_everything_was_looked_at(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    console.state.preflight.set(())
    console.suggested = replace(P07, trial="3")
    unconfirmed = replace(OFFERED, state="unconfirmed", unconfirmed=("map", "people", "permissions", "consent"))
    console.state.going_on.set(unconfirmed)
    card = find(window, "going_on_card")
    start = find(card, "going_on_start")
    assert not start.isEnabled()
    box = find(card, "going_on_people")
    assert isinstance(box, CheckBox)
    click(qtbot, box)
    assert console.named("ConfirmAsBefore") == [intents.ConfirmAsBefore("people")]
    console.state.going_on.set(replace(unconfirmed, unconfirmed=("map", "consent")))
    assert box.isChecked() and not box.isEnabled() and not start.isEnabled()
    console.state.going_on.set(replace(unconfirmed, unconfirmed=(), state="confirmed"))
    click(qtbot, start)
    assert window.sessions._start is None, "nothing more is asked"
    assert len(console.named("start_session")) == 1
    assert (console.suggested.participant, console.suggested.trial) == ("P07", "2")


def test_an_open_check_is_asked_about_in_the_start_dialog(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    console.state.preflight.set(CHECKS)
    assert any(check.asks_first for check in CHECKS)
    console.suggested = replace(P07, trial="3")
    console.state.going_on.set(replace(OFFERED, state="confirmed"))
    click(qtbot, find(window, "going_on_start"))
    dialog = window.sessions._start
    assert dialog is not None and console.named("start_session") == []
    assert (dialog.details().participant, dialog.details().trial) == ("P07", "2")
    dialog.reject()


def test_the_rows_of_people_say_it_until_each_is_confirmed(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    panel = window.findChild(PeoplePanel)
    assert panel is not None
    persons = panel.model.persons
    first, second = persons[0].person_id, persons[1].person_id
    before = panel.list.viewport().grab(panel.list.row_rect(0)).toImage()
    unconfirmed = replace(OFFERED, state="unconfirmed", unconfirmed=("map", "people"))
    console.state.going_on.set(replace(unconfirmed, unconfirmed_people=(first, second)))

    def told(row: int) -> str:
        return str(panel.model.index(row).data(Qt.ItemDataRole.AccessibleTextRole))

    assert "not confirmed" in told(0) and "not confirmed" in told(1) and "not confirmed" not in told(2)
    row = panel.list.row_rect(0)
    assert panel.list.viewport().grab(row).toImage() != before, "in look, too"
    click(qtbot, find(panel.list.controls[first], "person_same"))
    panel.list.setFocus()
    panel.list.setCurrentIndex(panel.model.index(1))
    qtbot.keyClick(panel.list, Qt.Key.Key_Return)
    assert console.named("ConfirmAsBefore") == [
        intents.ConfirmAsBefore("people", first), intents.ConfirmAsBefore("people", second),
    ]  # fmt: skip
    console.state.going_on.set(replace(unconfirmed, unconfirmed_people=(second,)))
    assert "not confirmed" not in told(0) and "not confirmed" in told(1)
    assert "same" not in panel.list.controls[first].buttons
    console.state.going_on.set(replace(unconfirmed, unconfirmed=("map",)))
    assert "not confirmed" not in told(1)


def test_recorded_streams_are_shown_as_they_are_set_now(window: MainWindow, console: FakeConsole, qtbot: QtBot) -> None:
    console.state.going_on.set(replace(OFFERED, state="unconfirmed", unconfirmed=("permissions", "consent")))
    card = find(window, "going_on_card")
    box = find(card, "going_on_permissions")
    assert isinstance(box, CheckBox)
    permissions = console.scenario.permissions
    assert permissions.video_recording and "video" in box.text() and "No sound" in box.text()
    assert "Language models may be used, including on other computers." in box.text()
    assert "Suggested replies: Off." in box.text()
    console.state.levels.set(LevelsStatus(replies="suggest"))
    assert "Suggested replies: Suggest (I confirm by key)." in box.text()
    console.scenario = replace(
        console.scenario,
        permissions=replace(permissions, video_recording=False, cloud_models=False, transcription=True),
    )
    console.state.scenario.reset_value(console.scenario)
    assert "No video" in box.text() and "Language models are used on this computer only." in box.text()
    assert "Participants’ speech is transcribed." in box.text()
    assert card.height() >= card.layout().heightForWidth(card.width()), "all of it can be read"
    click(qtbot, box)
    assert console.named("ConfirmAsBefore") == [intents.ConfirmAsBefore("permissions")]


def test_the_record_button_asks_nobody_for_details_of_what_is_refused(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    console.state.recording.set(RecordingStatus())
    console.state.going_on.set(replace(OFFERED, state="unconfirmed", unconfirmed=("consent",)))
    click(qtbot, find(window, "record_button"))
    assert window.sessions._start is None
    assert len(console.named("start_session")) == 1, "the gate says why not"


@pytest.mark.usefixtures("screen_reader")
def test_the_map_says_it_in_words_and_look_until_it_is_confirmed(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    panel = window.findChild(MapPanel)
    assert panel is not None
    before = panel.view.grab().toImage()
    console.state.going_on.set(replace(OFFERED, state="unconfirmed", unconfirmed=("map",)))
    assert ("Position not confirmed", "warning") in panel.view.map_state.chips
    QApplication.sendEvent(panel.view, QEvent(QEvent.Type.Enter))  # the present state is announced on entering
    assert "Position not confirmed" in panel.view.accessibleDescription()
    confirm = find(panel, "map_confirm")
    confirm.hide()
    without = panel.view.map_state.chips
    panel.view.update_state(chips=[])
    pin = panel.view.grab().toImage()
    panel.view.update_state(chips=without)
    confirm.show()
    assert pin != before, "the pin is hollow and its outline dashed"
    click(qtbot, confirm)
    assert console.named("ConfirmAsBefore") == [intents.ConfirmAsBefore("map")]
    console.state.going_on.set(CrashRecoveryStatus())
    assert confirm.isHidden() and not panel.view.map_state.unconfirmed
    assert ("Position not confirmed", "warning") not in panel.view.map_state.chips
