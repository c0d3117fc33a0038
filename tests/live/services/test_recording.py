"""What the recorder is told of a scenario: whom to cover, who agreed to be filmed, and who is in a photo."""

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication

from caris_desktop.app.composition import find_scenario
from caris_desktop.domain import clock
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.sensing import FrameRef, People, PersonBox, RobotPose
from caris_desktop.live.bus import Bus
from caris_desktop.live.child_process import ProcessBody, RingsToRead
from caris_desktop.live.services.recording import RecordingService
from caris_desktop.live.slow_work import SlowWork
from caris_desktop.live.state import LiveState
from caris_desktop.people.presence import PersonRow
from caris_desktop.recording.recorder.messages import BlurDemand, TakePhoto, UseConsents
from caris_desktop.scenario.model import BlurSettings
from tests.support.polling import wait_for


class Recorder:
    """Takes down what a recorder would be told; as the children that make it, too."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    def new(self, *_: object, **__: object) -> "Recorder":
        return self

    def start(self) -> None:
        """It runs all the while."""

    def send_raw_waiting(self, raw: bytes) -> bool:
        self.messages.append(pickle.loads(raw[9:]))  # noqa: S301 - made here
        return True

    def stop(self, *, grace_s: float) -> None:
        """Nothing to end."""

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
        self.service = RecordingService(
            self.state, self.bus, self.recorder, ProcessBody("recorder", print), SlowWork(owner),  # type: ignore[arg-type]
            rings=RingsToRead(()), parent=owner,
        )  # fmt: skip
        self.use(BlurSettings("without_consent", "faces"))
        self.service.start()

    def use(self, blur: BlurSettings) -> None:
        self.service.use_scenario(replace(find_scenario("tour-guide"), blur=blur))


@pytest.fixture
def bench(qapp: QApplication) -> Any:
    bench = Bench()
    yield bench
    bench.service.end()
    bench.state.close()


def person(person_id: str, *consents: Any) -> PersonRow:
    return PersonRow(person_id, 1, "Ada", True, 0, 0, consents=consents)


def people() -> People:
    boxes = tuple(PersonBox(track, f"p-{track}", 1.0, 2.0, 30.0, 60.0, 0.9) for track in (1, 2))
    return People(clock.now_ns(), "front", 7, 640, 480, boxes, 50.0)


def test_who_agreed_to_be_filmed_is_told_as_soon_as_it_is_known_and_taken_back(bench: Bench) -> None:
    bench.state.persons.set((person("p-1", "video"), person("p-2", "face", "photo"), person("p-3")))
    assert bench.recorder.of(UseConsents) == [UseConsents(frozenset({"p-1"}), frozenset({"p-2"}))]
    bench.state.persons.set((person("p-1"),))
    assert bench.recorder.of(UseConsents, 2)[-1] == UseConsents()


def test_a_photo_goes_with_whom_to_cover_who_is_in_it_and_where_it_was(bench: Bench, tmp_path: Path) -> None:
    now_ns = clock.now_ns()
    ref = FrameRef(now_ns, None, "front", "ring", 0, 7, 640, 480)
    for value in (ref, people(), RobotPose(now_ns, None, Pose2D(1.0, 2.0, 0.5))):
        bench.state.take(value)
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
