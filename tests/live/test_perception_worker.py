"""Perception worker: newest frame in, people out; a crash loses only boxes."""

from collections.abc import Iterator
from contextlib import closing
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PySide6.QtCore import QThread
from pytestqt.qtbot import QtBot

from caris_desktop.domain import clock
from caris_desktop.domain.events import PersonAppeared, PersonIdentified, PersonLeft, PersonRenamed, Problem
from caris_desktop.domain.intents import NamePerson
from caris_desktop.domain.sensing import People
from caris_desktop.live.child_process import ProcessSpec, RingsToRead
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.live.services.people_service import PerceptionWorker
from caris_desktop.people.known import KnownPeople
from caris_desktop.people.people_store import PeopleStore
from caris_desktop.people.presence import PresenceTracker
from caris_desktop.people.visit_log import Portraits
from caris_desktop.perception.inference_messages import DetectorSettings, InferenceSettings
from caris_desktop.perception.weights import DetectorChoice
from tests.live import bodies
from tests.support.plugins import install


class Setup:
    def __init__(self, target: Any = bodies.brightness, argument: Any = "test") -> None:
        self.ring = FrameRing.create(max_frame_bytes=64 * 48 * 3)
        self.published: list[Any] = []
        self.portraits = Portraits()
        self.everybody: list[Any] = []
        self.worker = PerceptionWorker(lambda: (PresenceTracker(), []), self.published.append, self.portraits)
        self.worker.use_body(ProcessSpec("inference", target, (RingsToRead((self.ring.name,)), argument)))
        self.statuses: list[str] = []
        self.rows: list[Any] = []
        self.models: list[str] = []
        self.worker.status_changed.connect(lambda status: self.statuses.append(status.state))
        self.plugins: list[Any] = []
        self.worker.status_changed.connect(lambda status: self.plugins.append(status.plugins))
        self.worker.status_changed.connect(lambda status: self.models.append(status.model))
        self.worker.persons_changed.connect(self.rows.append)
        self.worker.everybody_changed.connect(self.everybody.append)
        self.thread = QThread()
        self.worker.moveToThread(self.thread)
        self.thread.started.connect(self.worker.run)
        self.thread.start()

    def show(self, value: int, camera: str = "front") -> None:
        image = np.full((48, 64, 3), value, np.uint8)
        self.worker.offer(self.ring.write(image, stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera=camera))

    def people(self) -> list[People]:
        return [value for value in self.published if isinstance(value, People)]

    def of(self, kind: type) -> list[Any]:
        return [value for value in self.published if isinstance(value, kind)]


@pytest.fixture
def setup(qtbot: QtBot) -> Iterator[Setup]:
    setup = Setup()
    qtbot.waitUntil(lambda: "ready" in setup.statuses, timeout=20_000)
    yield setup
    setup.worker.stop()
    assert setup.thread.wait(10_000)
    setup.ring.close()


def _show_until(qtbot: QtBot, setup: Setup, value: int, condition: Any) -> None:
    def step() -> bool:
        setup.show(value)
        return bool(condition())

    qtbot.waitUntil(step, timeout=10_000)


def test_a_person_appears_is_named_and_leaves_when_the_camera_goes_black(qtbot: QtBot, setup: Setup) -> None:
    _show_until(qtbot, setup, 200, lambda: setup.rows and setup.rows[-1])
    person = setup.rows[-1][0]
    assert setup.of(PersonAppeared)[0].person_id == person.person_id
    setup.worker.ask(NamePerson(person.person_id, "Mara"))
    qtbot.waitUntil(lambda: setup.rows[-1][0].name == "Mara", timeout=5000)
    assert "Mara" not in repr(setup.of(PersonRenamed)), "names stay out of events"
    _show_until(qtbot, setup, 200, lambda: setup.people()[-1].boxes[0].person_id == person.person_id)
    _show_until(qtbot, setup, 0, lambda: not setup.rows[-1])
    assert setup.of(PersonLeft)[0].person_id == person.person_id


def test_a_returning_person_is_recognised_and_has_a_portrait(qtbot: QtBot, setup: Setup) -> None:
    _show_until(qtbot, setup, 201, lambda: setup.rows and setup.rows[-1] and setup.rows[-1][0].portrait)
    person = setup.rows[-1][0]
    setup.worker.ask(NamePerson(person.person_id, "Mara"))
    _show_until(qtbot, setup, 0, lambda: not setup.rows[-1])
    _show_until(qtbot, setup, 202, lambda: setup.rows[-1] and setup.rows[-1][0].person_id == person.person_id)
    (row,) = setup.rows[-1]
    assert (row.name, row.known) == ("Mara", True)
    # A quick return continues the visit; a later one is a new visit of a recognised person.
    found = [(event.person_id, event.is_person_id, event.by) for event in setup.of(PersonIdentified)]
    joined = row.visit_id == person.person_id
    assert found == ([] if joined else [(row.visit_id, person.person_id, "console")])
    assert setup.portraits.get(row.portrait) == b"\xff\xd8"
    (everybody,) = setup.everybody[-1]
    assert everybody.person_id == person.person_id


def test_a_person_who_stays_is_news_once(qtbot: QtBot, setup: Setup) -> None:
    _show_until(qtbot, setup, 200, lambda: setup.rows and setup.rows[-1])
    told, seen = len(setup.rows), len(setup.people())
    _show_until(qtbot, setup, 200, lambda: len(setup.people()) >= seen + 10)
    assert len(setup.rows) == told


@pytest.mark.long
def test_detections_can_be_spaced_out(qtbot: QtBot, setup: Setup) -> None:
    _show_until(qtbot, setup, 200, lambda: setup.people())
    setup.worker.limit_detection_rate(0.6)
    seen = len(setup.people())
    _show_until(qtbot, setup, 200, lambda: len(setup.people()) >= seen + 4)
    stamps = [people.stamp_ns for people in setup.people()[-3:]]
    # A slow machine detects later, never earlier.
    assert all(later - earlier >= 500_000_000 for earlier, later in pairwise(stamps))


@pytest.mark.long
def test_people_leave_also_when_no_frames_come_any_more(qtbot: QtBot, setup: Setup) -> None:
    _show_until(qtbot, setup, 200, lambda: setup.rows and setup.rows[-1])
    qtbot.waitUntil(lambda: not setup.rows[-1], timeout=5000)


@pytest.mark.logs("ended by itself with exit code")
def test_a_native_crash_is_reported_and_recognition_comes_back(qtbot: QtBot, setup: Setup) -> None:
    _show_until(qtbot, setup, 200, lambda: setup.people())
    setup.show(13)
    qtbot.waitUntil(lambda: bool(setup.of(Problem)), timeout=10_000)
    assert "recognition" in setup.of(Problem)[0].what
    seen = len(setup.people())
    _show_until(qtbot, setup, 200, lambda: len(setup.people()) > seen + 2)


def test_a_remote_detector_may_go_and_come_back(qtbot: QtBot, setup: Setup) -> None:
    _show_until(qtbot, setup, 200, lambda: setup.people())
    _show_until(qtbot, setup, 7, lambda: setup.statuses[-1] == "failed")
    assert setup.of(Problem)[0].what == "lab does not respond."
    _show_until(qtbot, setup, 200, lambda: setup.statuses[-1] == "ready")
    assert setup.models[-1] == "brightness test"


@pytest.mark.long
def test_another_detector_takes_the_place_of_the_first(qtbot: QtBot, setup: Setup) -> None:
    _show_until(qtbot, setup, 200, lambda: setup.rows and setup.rows[-1])
    first = setup.worker.child
    setup.worker.use_body(
        ProcessSpec("inference", bodies.brightness, (RingsToRead((setup.ring.name,)), "of another scenario"))
    )
    qtbot.waitUntil(lambda: setup.models[-1] == "brightness of another scenario", timeout=20_000)
    assert setup.worker.child is not first
    assert not setup.of(Problem), "nothing has gone wrong"
    seen = len(setup.people())
    _show_until(qtbot, setup, 200, lambda: len(setup.people()) > seen)


@pytest.mark.long
def test_people_before_two_cameras_stay_who_they_are(qtbot: QtBot, setup: Setup) -> None:
    setup.worker.show_camera("front")
    shown = 0

    def step() -> bool:
        nonlocal shown
        shown += 1
        setup.show(200, "front")
        setup.show(200, "rear")
        return sum(people.camera == "rear" for people in setup.people()) >= 6

    qtbot.waitUntil(step, timeout=15_000)
    assert {row.camera for row in setup.rows[-1]} == {"front", "rear"}
    assert len(setup.of(PersonAppeared)) == 2
    assert not setup.of(PersonLeft)
    front, rear = (
        {box.person_id for people in setup.people() if people.camera == camera for box in people.boxes} - {""}
        for camera in ("front", "rear")
    )
    assert len(front) == len(rear) == 1
    assert front != rear
    assert len(setup.people()) <= shown + 1, "no more than one camera alone gives to do"


def test_another_robot_begins_with_nobody(qtbot: QtBot, setup: Setup) -> None:
    _show_until(qtbot, setup, 200, lambda: setup.rows and setup.rows[-1])
    before = setup.rows[-1][0].person_id
    setup.worker.forget_cameras()
    qtbot.waitUntil(lambda: not setup.rows[-1], timeout=5000)
    assert setup.of(PersonLeft)[0].person_id == before
    _show_until(qtbot, setup, 200, lambda: setup.rows[-1])
    assert setup.rows[-1][0].person_id != before


def test_people_of_the_practice_stay_in_the_practice(qtbot: QtBot, setup: Setup, tmp_path: Path) -> None:
    def names() -> set[str]:
        return {row.name for row in setup.everybody[-1]} if setup.everybody else set()

    setup.worker._open_presence = lambda: (PresenceTracker(KnownPeople(PeopleStore(tmp_path / "people.sqlite"))), [])
    for name, practice in (("Bo", True), ("Ada", False)):
        setup.worker.practise(practice)
        setup.rows.clear()

        def somebody_is_here() -> bool:
            setup.show(200)
            return bool(setup.rows and setup.rows[-1])

        qtbot.waitUntil(somebody_is_here, timeout=20_000)
        setup.worker.ask(NamePerson(setup.rows[-1][0].person_id, name))
        qtbot.waitUntil(lambda name=name: name in names(), timeout=20_000)  # type: ignore[misc]
    assert "Bo" not in names()
    setup.worker.practise(True)
    qtbot.waitUntil(lambda: "Ada" not in names(), timeout=20_000)
    with closing(PeopleStore(tmp_path / "people.sqlite")) as store:
        assert {person.name for person in store.everybody() if person.name} == {"Ada"}


def _plugin(body: str, before: str = "") -> str:
    return f"""
import ctypes, os, time
{before}

class Plugin:
    caris_interface = 1

    def __init__(self, *, appearance):
        self.pictures = 0

    def follow(self, corners_px, confidences, frame):
        self.pictures += 1
        {body}
"""


def _run_with_tracker(name: str) -> Setup:
    settings = InferenceSettings(tracker=name, recognise_appearance=False, niceness=0)
    return Setup(bodies.inference_of_bright_frames, settings)


def _end(setup: Setup) -> None:
    setup.worker.stop()
    assert setup.thread.wait(10_000)
    setup.ring.close()


def test_a_tracker_of_others_follows_people_and_its_package_is_known(
    qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = "return [(41, row) for row in range(len(corners_px))]"
    install(tmp_path, "trackers", "steady", _plugin(body), monkeypatch)
    setup = _run_with_tracker("steady")
    try:
        qtbot.waitUntil(lambda: "ready" in setup.statuses, timeout=60_000)
        _show_until(qtbot, setup, 200, lambda: setup.people() and setup.people()[-1].boxes)
        assert setup.plugins[-1] == (("tracker steady", "lab-steady 2.1"),)
        assert not setup.of(Problem)
    finally:
        _end(setup)


@pytest.mark.timeout(200)
@pytest.mark.logs("failed", "ended by itself with exit code")
@pytest.mark.parametrize(
    ("module", "reason"),
    [
        (_plugin("raise KeyError('who')"), "it raised KeyError: 'who'"),
        (_plugin("return [(1, 5)]"), "it returned rows of no box"),
        (_plugin("print('hello'); return []"), "it printed “hello”"),
        (_plugin("time.sleep(3600)"), "it did not return within 5 s"),
        (_plugin("ctypes.PyDLL(None).sleep(3600)"), "it did not return within 5 s"),
        (_plugin("os.abort()"), "it ended its process"),
        (_plugin("pass", "time.sleep(3600)"), "it did not return within 3 s"),
        (_plugin("pass", "raise ImportError('no such library')"), "it raised ImportError: no such library"),
    ],
    ids=["raises", "nonsense", "prints", "hangs", "hangs-with-the-lock", "crashes", "import-hangs", "import-raises"],
)
@pytest.mark.long("nonsense", "prints", "hangs-with-the-lock", "import-hangs", "import-raises")
def test_a_tracker_that_fails_is_named_once_and_ours_takes_over(
    module: str, reason: str, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "trackers", "bad", module, monkeypatch)
    setup = _run_with_tracker("bad")
    try:
        qtbot.waitUntil(lambda: "ready" in setup.statuses or bool(setup.of(Problem)), timeout=60_000)

        def followed() -> bool:
            setup.show(200)
            return bool(setup.of(Problem)) and any(people.boxes for people in setup.people())

        qtbot.waitUntil(followed, timeout=60_000)
        (problem,) = setup.of(Problem)
        assert problem.what == f"The plug-in bad (lab-bad 2.1) was switched off: {reason}."
        assert setup.plugins[-1] == ()
        assert setup.worker.restarts.used == 0, "the process itself is not to blame"
    finally:
        _end(setup)


def _detector(body: str, before: str = "") -> str:
    return f"""
import os, time
{before}

class Plugin:
    caris_interface = 1
    class_names = ("chair", "person")

    def __init__(self, *, confidence, threads):
        pass

    def detect(self, image_bgr):
        {body}
"""


def _run_with_detector(name: str) -> Setup:
    detector = DetectorSettings(DetectorChoice(f"plugin:{name}"))
    settings = InferenceSettings(detector=detector, recognise_appearance=False, niceness=0)
    return Setup(bodies.inference_of_bright_frames, settings)


def test_a_detector_of_others_finds_people_and_its_package_is_known(
    qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = "return [[-5, 2, 30, 46], [40, 2, 60, 46]], [0.9, 0.8], [1, 0]"
    install(tmp_path, "detectors", "seeing", _detector(body), monkeypatch)
    setup = _run_with_detector("seeing")
    try:
        qtbot.waitUntil(lambda: "ready" in setup.statuses, timeout=60_000)
        assert setup.models[-1] == "seeing (lab-seeing 2.1)"
        _show_until(qtbot, setup, 0, lambda: setup.people() and setup.people()[-1].boxes)
        (box,) = setup.people()[-1].boxes
        assert (box.left_px, box.width_px) == (0.0, 30.0), "boxes end at the side of the picture; a chair is nobody"
        assert setup.plugins[-1] == (("detector seeing", "lab-seeing 2.1"),)
        assert not setup.of(Problem)
    finally:
        _end(setup)


@pytest.mark.timeout(200)
@pytest.mark.logs("failed", "ended by itself with exit code")
@pytest.mark.parametrize(
    ("module", "reason"),
    [
        (_detector("raise KeyError('who')"), "it raised KeyError: 'who'"),
        (_detector("return [[0, 0, 9, float('nan')]], [0.9], [1]"), "it returned corners that are no numbers"),
        (_detector("return [[0, 0, 9, 9]], [0.9], [2]"), "it returned classes that it does not name"),
        (_detector("os.abort()"), "it ended its process"),
        (_detector("time.sleep(3600)"), "it did not return within 20 s"),
        (_detector("pass", "import nothing_of_this_name"), "it raised ModuleNotFoundError"),
        (_detector("pass").replace('"person"', '"dog"'), "none of its classes is named person"),
    ],
    ids=["raises", "nan", "classes", "crashes", "hangs", "import", "no-person"],
)
@pytest.mark.long("nan", "classes", "hangs", "import", "no-person")
def test_a_detector_that_fails_is_named_once_and_the_usual_one_takes_over(
    module: str, reason: str, qtbot: QtBot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "detectors", "bad", module, monkeypatch)
    setup = _run_with_detector("bad")
    try:
        qtbot.waitUntil(lambda: "ready" in setup.statuses or bool(setup.of(Problem)), timeout=60_000)

        def found() -> bool:
            setup.show(200)
            return bool(setup.of(Problem)) and any(people.boxes for people in setup.people())

        qtbot.waitUntil(found, timeout=60_000)
        (problem,) = setup.of(Problem)
        assert problem.what.startswith(f"The plug-in bad (lab-bad 2.1) was switched off: {reason}")
        assert (setup.models[-1], setup.plugins[-1]) == ("bright", ())
        assert setup.worker.restarts.used == 0
    finally:
        _end(setup)
