"""Scenario data for the recorder: blurring, consent, and people in photos."""

import json
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication
from pytestqt.qtbot import QtBot

from caris_desktop.app.composition import find_scenario
from caris_desktop.domain import clock
from caris_desktop.domain.events import Problem
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import FrameRef, People, PersonBox, RobotPose, StatusShown
from caris_desktop.domain.translation import localized, tr
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessSpec, RingsToRead
from caris_desktop.live.services.recording_service import RecordingService
from caris_desktop.live.state import LiveState, tap_status
from caris_desktop.people.presence import PersonRow
from caris_desktop.recording.recorder.recorder_messages import BlurDemand, RecorderReport, TakePhoto, UseConsents
from caris_desktop.scenario.scenario_model import BlurSettings
from caris_desktop.study.study_folder import StudyFolderError
from tests.support.polling import wait_for
from tests.support.service_context import context_of


class Recorder:
    """Double of the recorder, and of the process manager that starts it; records messages."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    def new(self, *_: object, **__: object) -> "Recorder":
        return self

    def start(self) -> None:
        """Nothing to start."""

    def send_raw_waiting(self, raw: bytes) -> bool:
        self.messages.append(pickle.loads(raw[9:]))  # noqa: S301 - written by this test
        return True

    def stop(self, *, grace_s: float) -> None:
        """Nothing to stop."""

    def of(self, kind: type[Any], count: int = 1) -> list[Any]:
        def told() -> list[Any]:
            found = [each for each in self.messages if isinstance(each, kind)]
            return found if len(found) >= count else []

        return list(wait_for(told, f"a {kind.__name__}", timeout_s=5.0))


class Bench:
    def __init__(self) -> None:
        owner = self.owner = QObject()
        self.state = LiveState(owner)
        self.bus = Bus(self.state, owner)
        self.recorder = Recorder()
        self.slow_work = BackgroundWorker(owner)
        self.service = RecordingService(
            context_of(self.state, self.bus, owner, children=self.recorder, slow_work=self.slow_work),
            ProcessSpec("recorder", print), rings=RingsToRead(()),
        )  # fmt: skip
        self.use(BlurSettings("without_consent", "faces"))
        self.service.start()

    def use(self, blur: BlurSettings) -> None:
        self.service.use_scenario(replace(find_scenario("tour-guide"), blur=blur))


@pytest.fixture
def bench(qapp: QApplication) -> Any:
    bench = Bench()
    yield bench
    bench.slow_work.finish(lambda _words, wait: wait())
    bench.service.end()
    bench.state.close()


def person(person_id: str, *consents: Any) -> PersonRow:
    return PersonRow(person_id, 1, "Ada", True, 0, 0, consents=consents)


def people() -> People:
    boxes = tuple(PersonBox(track, f"p-{track}", 1.0, 2.0, 30.0, 60.0, 0.9) for track in (1, 2))
    return People(clock.now_ns(), "front", 7, 640, 480, boxes, 50.0)


def test_consent_to_filming_is_reported_when_known_and_withdrawn(bench: Bench) -> None:
    bench.state.persons.set((person("p-1", "video"), person("p-2", "face", "photo"), person("p-3")))
    assert bench.recorder.of(UseConsents) == [UseConsents(frozenset({"p-1"}), frozenset({"p-2"}))]
    bench.state.persons.set((person("p-1"),))
    assert bench.recorder.of(UseConsents, 2)[-1] == UseConsents()


def test_a_photo_goes_with_whom_to_cover_who_is_in_it_and_where_it_was(bench: Bench, tmp_path: Path) -> None:
    now_ns = clock.now_ns()
    ref = FrameRef(now_ns, None, "front", "ring", 0, 7, 640, 480)
    for value in (ref, people(), RobotPose(now_ns, None, Pose2D(1.0, 2.0, 0.5))):
        bench.state.add(value)
    bench.service.take_photo(without_session=tmp_path / "photo.png")
    (told,) = bench.recorder.of(TakePhoto)
    assert told.blur == BlurDemand("without_consent", "faces")
    assert (told.ref, told.person_ids, told.pose_in_map) == (ref, ("p-1", "p-2"), Pose2D(1.0, 2.0, 0.5))
    assert told.person_id == "", "it could be of several"
    bench.state.persons.set((person("p-1"), person("p-2")))
    bench.state.selected_person.set("p-1")
    bench.service.take_photo(without_session=tmp_path / "photo.png")
    assert bench.recorder.of(TakePhoto, 2)[1].person_id == "p-1"


def test_without_a_recording_the_recorder_hears_of_people_only_where_a_photo_has_to_wait_for_them(bench: Bench) -> None:
    bench.use(BlurSettings())
    bench.bus.publish(people())
    bench.use(BlurSettings("everybody"))
    bench.bus.publish(people())
    assert len(bench.recorder.of(People)) == 1


@pytest.fixture
def details(bench: Bench) -> list[str]:
    """Reasons for missing recordings, as written in a file."""
    kept: list[str] = []

    def record(shown: StatusShown) -> None:
        if shown.name == "recording":
            kept.append(json.loads(json.dumps(shown.content))["detail"])

    tap_status(bench.state, record)
    return kept


@pytest.mark.usefixtures("trial_language")
def test_the_reason_of_spared_disk_writes_is_english_in_the_record(
    bench: Bench, details: list[str], tmp_path: Path
) -> None:
    slow = localized("every second frame is recorded: {why}", why=localized("the disk is slow"))
    bench.service.on_report(RecorderReport(1, "recording", tmp_path, detail=slow))
    assert details[-1] == "every second frame is recorded: the disk is slow"
    assert tr(slow) == tr(bench.state.recording.value.detail) != slow


@pytest.mark.usefixtures("trial_language")
@pytest.mark.logs(r"live\.bus: ", r"services\.recording_service: a session was not begun")
@pytest.mark.parametrize(
    ("raised", "what"),
    [
        (StudyFolderError("The disk is full.", "No session was started.", "Make room."), "The disk is full."),
        (ValueError("of no kind"), "The session folder could not be created."),
    ],
)
def test_the_reason_of_a_refused_session_is_english_in_the_record_and_translated(
    bench: Bench, details: list[str], qtbot: QtBot, raised: Exception, what: str
) -> None:
    problems: list[Problem] = []
    bench.bus.tap(lambda value, _raw: problems.append(value) if isinstance(value, Problem) else None)

    def new_session() -> Any:
        raise raised

    assert bench.service.announce_session(())
    bench.service.begin_session(new_session, "wizard", refused=lambda: None)
    qtbot.waitUntil(lambda: bench.state.recording.value.state == "failed")
    assert details[-1] == what
    assert [problem.what for problem in problems] == [tr(what)] != [what]
