"""Erasure from the window: refused during a recording, run in a child process, and reported."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path

import psutil
import pytest
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.app import process_entry_points
from caris_desktop.domain import intents
from caris_desktop.domain.events import PersonForgotten, Problem
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import QT_TR_NOOP, localized, tr
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessSpec
from caris_desktop.live.erasure_run import ErasureRequest, ForgettingEnded, ForgettingProgress
from caris_desktop.live.service import ProcessManager
from caris_desktop.live.services.forgetting_service import ForgettingService
from caris_desktop.live.state import LiveState
from caris_desktop.people.people_store import About, PeopleStore
from caris_desktop.recording.forgetting import media
from caris_desktop.recording.forgetting.study_erasure import Forgotten
from tests.support.service_context import context_of


def fail(connection: Connection) -> None:
    connection.send(ForgettingProgress(0.5, "Session 1 of 2"))
    connection.send(
        ForgettingEnded(None, ("The disk is full.", "Forgetting stopped in the middle.", "Free some room."))
    )


def take_long(_connection: Connection) -> None:
    time.sleep(100.0)


def die(_connection: Connection) -> None:
    os.abort()


def leave_one(connection: Connection) -> None:
    connection.send(ForgettingEnded(Forgotten(Path("receipt"), Path("review"), 2, ("thesis.docx",), ())))


def leave_a_photo(connection: Connection, photo: Path) -> None:
    try:
        media.covered_picture(photo, photo.with_suffix(".part"), ())
    except media.UnreadableMediaError as error:
        removed = localized(QT_TR_NOOP("{why}; it was removed."), why=error)
        connection.send(ForgettingEnded(Forgotten(Path("receipt"), None, 0, (), (removed,))))


class Bench:
    """The service with real child processes; ``body`` is the entry point of the next one."""

    def __init__(self) -> None:
        self.state = LiveState()
        self.bus = Bus(self.state, self.state)
        self.told: list[str] = []
        self.forgotten: list[intents.ForgetPerson] = []
        self.refuses: UserFacingError | None = None
        self.bus.tap(lambda value, _raw: self.told.append(f"{value.what} {value.meaning} {value.advice}"), (Problem,))
        self.body = ProcessSpec("forgetting", fail)
        self.service = ForgettingService(
            context_of(self.state, self.bus, self.state, children=ProcessManager(self.bus, self.state)),
            lambda _person_id: self.body,
            then=self.forget,
        )
        self.ask: Callable[[intents.ForgetPerson], None] = self.service.handlers()[intents.ForgetPerson]

    def forget(self, asked: intents.ForgetPerson) -> None:
        if self.refuses is not None:
            raise self.refuses
        self.forgotten.append(asked)

    def over(self) -> bool:
        return not self.service.processes()


@pytest.fixture
def bench(qapp: QApplication) -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.service.stop()
    bench.service.end()
    bench.bus.end()
    bench.state.close()
    bench.state.deleteLater()


def test_a_person_is_forgotten_in_the_study_and_then_in_the_console(bench: Bench, qtbot: QtBot, tmp_path: Path) -> None:
    with closing(PeopleStore(tmp_path / "people.sqlite")) as store:
        person_id = store.add().person_id
        store.describe(person_id, About(name="Zoë Quillfeather"))
    (tmp_path / "notes.txt").write_text("Zoë Quillfeather came early.\n", encoding="utf-8")
    asked = ErasureRequest(tmp_path, tmp_path / "people.sqlite", person_id, texts="redact")
    bench.body = ProcessSpec("forgetting", process_entry_points.forgetting, (asked,))
    wish = intents.ForgetPerson(person_id)
    bench.ask(wish)
    assert "is being erased" in bench.told[0]
    with pytest.raises(UserFacingError, match="already"):
        bench.ask(wish)
    qtbot.waitUntil(bench.over, timeout=30_000)
    assert bench.forgotten == [wish]
    assert "no data about them is found" in bench.told[-1]
    assert (tmp_path / "notes.txt").read_text(encoding="utf-8") == "[forgotten] came early.\n"
    with closing(PeopleStore(tmp_path / "people.sqlite")) as store:
        assert store.everybody() == ()


@pytest.mark.parametrize("state", ["starting", "recording", "paused"])
def test_nobody_is_forgotten_while_a_session_is_recorded(bench: Bench, state: str) -> None:
    bench.state.recording.set(replace(bench.state.recording.value, state=state))
    with pytest.raises(UserFacingError, match="End the recording"):
        bench.ask(intents.ForgetPerson("p-1"))
    assert bench.over()


@pytest.mark.logs("live.bus", "forgetting ended by itself")
@pytest.mark.parametrize(("body", "words"), [(fail, "The disk is full."), (die, "stopped unexpectedly")])
def test_a_failure_is_reported_and_the_person_stays_known(
    bench: Bench, qtbot: QtBot, body: Callable[[Connection], None], words: str
) -> None:
    bench.body = ProcessSpec("forgetting", body)
    bench.ask(intents.ForgetPerson("p-1"))
    qtbot.waitUntil(bench.over, timeout=30_000)
    assert words in bench.told[-1]
    assert bench.forgotten == []


@pytest.mark.logs("did not end within")
def test_a_console_that_closes_ends_it_and_it_can_be_requested_again(bench: Bench) -> None:
    bench.body = ProcessSpec("forgetting", take_long)
    bench.ask(intents.ForgetPerson("p-1"))
    (child,) = bench.service.processes().values()
    bench.service.stop()
    bench.service.end()
    assert child.pid is not None
    assert not psutil.pid_exists(child.pid)
    assert bench.forgotten == []


@pytest.mark.logs("live.bus")
def test_without_a_people_panel_it_is_still_reported(bench: Bench, qtbot: QtBot) -> None:
    happened: list[PersonForgotten] = []
    bench.bus.tap(lambda value, _raw: happened.append(value), (PersonForgotten,))
    bench.refuses = UserFacingError(
        "People detection is not available here.", "Nothing was changed.", "Start with detection."
    )
    bench.body = ProcessSpec("forgetting", leave_one)
    bench.ask(intents.ForgetPerson("p-1", actor="wizard:Ann"))
    qtbot.waitUntil(bench.over, timeout=30_000)
    assert [(event.person_id, event.actor) for event in happened] == [("p-1", "wizard:Ann")]
    assert "still found in thesis.docx" in bench.told[-1]
    assert "except for 2 places" in bench.told[-2]


@pytest.mark.logs("photo.png")
@pytest.mark.usefixtures("trial_language")
def test_a_failed_step_is_reported_in_the_wizards_language(bench: Bench, qtbot: QtBot, tmp_path: Path) -> None:
    (tmp_path / "photo.png").write_bytes(b"no picture")
    bench.body = ProcessSpec("forgetting", leave_a_photo, (tmp_path / "photo.png",))
    bench.ask(intents.ForgetPerson("p-01"))
    qtbot.waitUntil(bench.over, timeout=30_000)
    why = tr("{file} cannot be read as an image").format(file="photo.png")
    assert bench.told[-1].startswith(tr("{why}; it was removed.").format(why=why)), bench.told
