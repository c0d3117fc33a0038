"""After an end that nobody wanted the window offers the trial, and asks about what may not be as before."""

from dataclasses import replace

from PySide6.QtWidgets import QLabel
from pytestqt.qtbot import QtBot

from caris_desktop.domain import intents
from caris_desktop.domain.trial import TrialDetails
from caris_desktop.live.status import GoingOnStatus
from caris_desktop.ui.main_window import MainWindow
from caris_desktop.ui.widgets.check_box import CheckBox
from tests.ui.conftest import click, find
from tests.ui.fake_console import FakeConsole

P07 = TrialDetails(participant="P07", trial="2")
OFFERED = GoingOnStatus("offered", "2026-11-22_10-00-00_P07", P07)


def test_it_is_offered_and_gone_on_with(window: MainWindow, console: FakeConsole, qtbot: QtBot) -> None:
    console.state.going_on.set(OFFERED)
    card = find(window, "going_on_card")
    text = find(card, "going_on_text")
    assert isinstance(text, QLabel) and "P07, trial 2" in text.text()
    click(qtbot, find(card, "going_on_yes"))
    assert console.named("GoOnWithTrial")
    console.state.going_on.set(GoingOnStatus())
    assert card.isHidden()


def test_the_next_part_is_recorded_once_everything_was_looked_at(
    window: MainWindow, console: FakeConsole, qtbot: QtBot
) -> None:
    console.suggested = replace(P07, trial="3")
    unconfirmed = replace(OFFERED, state="unconfirmed", unconfirmed=("map", "people", "consent"))
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
    dialog = window.sessions._start
    assert dialog is not None
    assert (dialog.details().participant, dialog.details().trial) == ("P07", "2")
    dialog.reject()
