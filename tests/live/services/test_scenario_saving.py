"""Saving of an edited scenario: the file in use afterwards, and the reports to the window."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from PySide6.QtCore import QObject, QTimer
from pytestqt.qtbot import QtBot

from caris_desktop.domain import intents
from caris_desktop.domain.events import Problem, ScenarioOpened
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.bus import Bus
from caris_desktop.live.services.scenario_service import Imported, ScenarioAdapters, ScenarioService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import RecordingStatus, SavedScenario
from caris_desktop.scenario.bundle import BundledFile, ImportQuestion, NameConflict
from caris_desktop.scenario.scenario_file import OtherFileError
from caris_desktop.scenario.scenario_model import PanelLeaf, Scenario
from tests.support.service_context import context_of

OPEN = Scenario("Open", PanelLeaf("map"), path=Path("/scenarios/open.yaml"))


class Bench:
    """The service with files in memory."""

    def __init__(self, parent: QObject) -> None:
        self.files = {OPEN.path: "Open"}
        self.conflicts: tuple[NameConflict, ...] = ()
        self.decided: list[tuple[intents.SameName, ...]] = []
        self.applied: list[str] = []
        self.shown_then: list[str] = []
        self.state = LiveState()
        self.bus = Bus(self.state, parent)
        self.slow_work = BackgroundWorker(parent)
        parts = ScenarioAdapters(
            load=lambda path: replace(OPEN, title=self.files[path], path=path),
            save_places=lambda scenario: scenario,
            text=lambda scenario: scenario.title,
            save_text=self.write,
            unpack=self.unpack,
            conflicts=lambda _path: self.conflicts,
        )
        self.service = ScenarioService(
            context_of(self.state, self.bus, parent, slow_work=self.slow_work), parts, OPEN, apply=self.apply
        )

    def write(self, text: str, path: Path, _edited: Path | None, replaces: str) -> str:
        if replaces == "wrong":
            failure = UserFacingError("The scenario was not saved.", "It was changed by somebody else.", "Compare.")
            raise failure from OtherFileError()
        self.files[path] = text
        return text

    def unpack(self, path: Path, decided: Sequence[intents.SameName]) -> Imported:
        self.decided.append(tuple(decided))
        self.files[path] = "Theirs"
        return Imported(path, put_aside="/scenarios/replaced/open-1.yaml" if decided else "")

    def apply(self, scenario: Scenario) -> None:
        self.applied.append(scenario.title)
        QTimer.singleShot(0, lambda: self.shown_then.append(self.state.scenario.value.title))

    def save(self, qtbot: QtBot, *given: object) -> SavedScenario:
        asked = intents.SaveScenario(*given)  # type: ignore[arg-type]
        with qtbot.waitSignal(self.state.saved_scenario.changed):
            self.service.handlers()[intents.SaveScenario](asked)
        saved = self.state.saved_scenario.value
        assert isinstance(saved, SavedScenario)
        return saved


@pytest.fixture
def bench(qapp: QObject) -> Iterator[Bench]:
    parent = QObject()
    bench = Bench(parent)
    yield bench
    bench.slow_work.finish(lambda _words, wait: wait())
    bench.state.close()


def test_the_scenario_in_force_is_so_as_it_was_saved(bench: Bench, qtbot: QtBot) -> None:
    assert bench.save(qtbot, "Edited", OPEN.path, OPEN.path).text == "Edited"
    assert bench.files[OPEN.path] == "Edited"
    assert bench.applied == ["Edited"]
    qtbot.waitUntil(lambda: bench.state.scenario.value.title == "Edited")


def test_a_key_gets_its_turn_between_what_follows_and_what_is_shown(bench: Bench, qtbot: QtBot) -> None:
    other = Path("/scenarios/other.yaml")
    bench.files[other] = "Other"
    with qtbot.waitSignal(bench.state.scenario.changed):
        bench.service.handlers()[intents.OpenScenario](intents.OpenScenario(other))
    assert (bench.applied, bench.shown_then) == (["Other"], ["Open"])
    assert bench.state.scenario.value.title == "Other"


def test_the_picture_waits_for_the_panels_of_another_scenario_and_not_for_an_edited_one(
    bench: Bench, qtbot: QtBot, monkeypatch: pytest.MonkeyPatch
) -> None:
    held_s: list[float] = []
    monkeypatch.setattr(bench.bus, "hold_back", held_s.append)
    bench.save(qtbot, "Edited", OPEN.path, OPEN.path)
    assert held_s == [], "somebody may drive"
    other = Path("/scenarios/other.yaml")
    bench.files[other] = "Other"
    bench.service.handlers()[intents.OpenScenario](intents.OpenScenario(other))
    qtbot.waitUntil(lambda: bench.applied[-1:] == ["Other"])  # the signal of the first change may still be on its way
    assert len(held_s) == 1 and 0.0 < held_s[0] <= 0.3
    assert bench.applied == ["Edited", "Other"]


def test_a_copy_of_the_one_in_force_takes_its_place(bench: Bench, qtbot: QtBot) -> None:
    copy = Path("/scenarios/copy.yaml")
    bench.save(qtbot, "Copy", copy, OPEN.path)
    assert bench.files == {OPEN.path: "Open", copy: "Copy"}
    qtbot.waitUntil(lambda: bench.state.scenario.value.path == copy)


def test_a_recording_continues_with_the_scenario_that_it_has(bench: Bench, qtbot: QtBot) -> None:
    bench.state.recording.set(RecordingStatus("recording"))
    copy = Path("/scenarios/copy.yaml")
    bench.save(qtbot, "Copy", copy, OPEN.path)
    assert bench.files[copy] == "Copy"
    assert bench.applied == [] and bench.state.scenario.value is OPEN
    # An edit of its own file is applied at once, as always.
    bench.save(qtbot, "Edited", OPEN.path, OPEN.path)
    assert bench.applied == ["Edited"]


def test_another_file_is_written_and_the_scenario_in_force_stays(bench: Bench, qtbot: QtBot) -> None:
    other = Path("/scenarios/other.yaml")
    bench.save(qtbot, "Other", other, other)
    assert bench.files[other] == "Other"
    assert bench.applied == []
    assert bench.state.scenario.value is OPEN


@pytest.mark.logs(r"live\.bus: The scenario was not saved\.")
def test_a_failed_save_is_reported_to_the_editor_and_the_wizard(bench: Bench, qtbot: QtBot) -> None:
    told: list[object] = []
    bench.state.event_happened.connect(told.append)
    saved = bench.save(qtbot, "Edited", OPEN.path, OPEN.path, "wrong")
    assert (saved.text, saved.problem, saved.taken) == ("", "It was changed by somebody else.", True)
    bench.bus.take_in()
    assert [event.what for event in told if isinstance(event, Problem)] == ["The scenario was not saved."]
    assert not any(isinstance(event, ScenarioOpened) for event in told)
    assert bench.files == {OPEN.path: "Open"}


def test_names_that_are_taken_are_asked_about_before_anything_is_done(bench: Bench, qtbot: QtBot) -> None:
    told: list[Problem] = []
    bench.state.event_happened.connect(lambda event: told.append(event) if isinstance(event, Problem) else None)
    received = Path("/received/open.caris")
    bench.conflicts = (
        NameConflict(BundledFile("scenario", "open", "Theirs"), OPEN.path or Path(), "Open", True, "open-2"),
    )
    do = bench.service.handlers()[intents.ImportScenario]
    for incomplete in ((), (intents.SameName("robot", "open"),)):
        with qtbot.waitSignal(bench.state.import_question.changed):
            do(intents.ImportScenario(received, incomplete))
        assert bench.state.import_question.value == ImportQuestion(received, bench.conflicts)
    assert (bench.decided, bench.applied) == ([], []), "nothing was done"
    decided = (intents.SameName("scenario", "open"),)
    do(intents.ImportScenario(received, decided))
    qtbot.waitUntil(lambda: bench.applied == ["Theirs"])
    assert bench.decided == [decided]
    qtbot.waitUntil(lambda: any("/scenarios/replaced/open-1.yaml" in problem.meaning for problem in told))


def test_an_import_is_reported_also_without_a_conflict(bench: Bench, qtbot: QtBot) -> None:
    told: list[Problem] = []
    bench.state.event_happened.connect(lambda event: told.append(event) if isinstance(event, Problem) else None)
    bench.service.handlers()[intents.ImportScenario](intents.ImportScenario(Path("/received/open.caris")))
    qtbot.waitUntil(lambda: bool(told))
    assert [(one.severity, one.what) for one in told] == [("info", "“Theirs” was imported and is open.")]
