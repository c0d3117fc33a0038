"""Photos: listing, tagging, deletion and restoring, and images for a language model."""

import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication

from caris_desktop.app.composition import find_scenario
from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import PhotoDeleted, PhotoTagged, PhotoTaken, Problem, SessionEnded, SessionStarted
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.live.background_worker import BackgroundWorker
from caris_desktop.live.bus import Bus
from caris_desktop.live.services.assistant_service import ReadPictures
from caris_desktop.live.services.photos_service import PhotosService
from caris_desktop.live.state import LiveState
from caris_desktop.recording.photo_file import texts_of, with_texts
from tests.support.polling import wait_for
from tests.support.service_context import context_of

pytestmark = pytest.mark.logs(r"live\.bus: ", r"services\.photos_service: ")


class Recording:
    session_folder: Path | None = None


@dataclass
class Assistant:
    refusal: UserFacingError | None = None
    asked: list[Any] = field(default_factory=list)
    refused: list[UserFacingError] = field(default_factory=list)
    read: ReadPictures | None = None

    def use_pictures(self, read: ReadPictures) -> None:
        self.read = read

    def ask(self, asked: intents.Ask) -> None:
        if self.refusal is not None:
            raise self.refusal
        assert self.read is not None
        self.read(asked.pictures, lambda jpegs: self.asked.append((asked, jpegs)), self.refused.append)


class Frames:
    """Camera frames as provided to other windows and programs."""

    def read_to_give(self, ref: FrameRef) -> NDArray[np.uint8] | None:
        return np.full((ref.height_px, ref.width_px, 3), 90, np.uint8)


class Bench:
    """The service with real files, and its reports."""

    def __init__(self, study: Path) -> None:
        self.study = study
        self.owner = QObject()
        self.state = LiveState(self.owner)
        bus = self.bus = Bus(self.state, self.owner)
        self.recording, self.assistant = Recording(), Assistant()
        self.slow_work = BackgroundWorker(self.owner)
        self.service = PhotosService(
            context_of(self.state, bus, self.owner, slow_work=self.slow_work), self.recording, self.assistant,  # type: ignore[arg-type]
            frames=Frames(), study=study,  # type: ignore[arg-type]
        )  # fmt: skip
        bus.follow(self.service.follows())
        self.happened: list[Any] = []
        self.state.event_happened.connect(self.happened.append)
        self.service.use_scenario(find_scenario("tour-guide"))

    def until(self, seen: Callable[[], Any]) -> Any:
        def look() -> Any:
            QApplication.processEvents()
            return seen()

        return wait_for(look, "what was asked", timeout_s=10.0)

    def do(self, intent: Intent) -> None:
        self.service.handlers()[type(intent)](intent)

    def begin_session(self) -> Path:
        folder = self.recording.session_folder = self.study / "sessions" / "s1"
        self.bus.publish(SessionStarted(1, "s1"))
        return folder

    def take(self, folder: Path, file_name: str, **texts: str) -> None:
        path = folder / file_name
        path.parent.mkdir(parents=True, exist_ok=True)
        picture = np.random.default_rng(1).integers(0, 256, (480, 1280, 3), np.uint8)
        path.write_bytes(with_texts(cv2.imencode(".png", picture)[1].tobytes(), texts))

    def taken(self, folder: Path, file_name: str = "photos/0001.png") -> str:
        self.take(folder, file_name)
        self.bus.publish(PhotoTaken(2, "front", 7, file_name, "wizard", "", ("p-1",), Pose2D(1.0, 2.0, 0.0)))
        self.until(lambda: [entry for entry in self.state.photos.value if entry.file_name == file_name])
        return file_name

    def told(self, kind: type[Any]) -> Any:
        return self.until(lambda: next((each for each in self.happened if isinstance(each, kind)), None))


@pytest.fixture
def bench(qapp: QApplication, tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.service.stop()
    bench.slow_work.finish(lambda _what, work: work())
    bench.service.end()
    bench.state.close()


def test_a_photo_is_listed_with_who_and_where_and_a_picture_for_the_window(bench: Bench) -> None:
    bench.taken(bench.begin_session())
    (entry,) = bench.state.photos.value
    assert (entry.camera, entry.person_ids, entry.pose_in_map) == ("front", ("p-1",), Pose2D(1.0, 2.0, 0.0))
    preview = cv2.imdecode(np.frombuffer(entry.preview_jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert preview.shape == (360, 960, 3)


def test_tags_are_in_the_file_and_in_the_record(bench: Bench) -> None:
    session = bench.begin_session()
    photo = bench.taken(session)
    bench.do(intents.TagPhoto(photo, (" robot  arm", "door", "door", ""), actor="wizard:b"))
    event = bench.told(PhotoTagged)
    assert (event.file_name, event.tags, event.actor) == (photo, ("robot arm", "door"), "wizard:b")
    assert bench.state.photos.value[0].tags == ("robot arm", "door")
    assert texts_of((session / photo).read_bytes())["Keywords"] == "robot arm, door"
    with pytest.raises(UserFacingError, match="was not tagged"):
        bench.do(intents.TagPhoto(photo, ("x" * 41,)))


def test_a_deleted_photo_is_not_in_the_session_and_comes_back_until_it_ends(bench: Bench) -> None:
    session = bench.begin_session()
    photo = bench.taken(session)
    content = (session / photo).read_bytes()
    bench.do(intents.DeletePhoto(photo))
    bench.told(PhotoDeleted)
    assert bench.state.photos.value[0].deleted
    assert not list(session.rglob("*.png"))
    with pytest.raises(UserFacingError, match="photo does not exist"):
        bench.do(intents.TagPhoto(photo, ("door",)))
    bench.do(intents.RestorePhoto(photo))
    bench.until(lambda: not bench.state.photos.value[0].deleted)
    assert (session / photo).read_bytes() == content
    bench.until(lambda: [each.restored for each in bench.happened if isinstance(each, PhotoDeleted)] == [False, True])


def test_when_the_session_ends_what_was_deleted_is_gone_and_the_rest_stays_as_it_is(bench: Bench) -> None:
    session = bench.begin_session()
    deleted, kept = bench.taken(session, "photos/0001.png"), bench.taken(session, "photos/0002.png")
    bench.do(intents.DeletePhoto(deleted))
    bench.told(PhotoDeleted)
    bench.bus.publish(SessionEnded(3, "s1", "wizard"))
    bench.until(lambda: list(bench.study.rglob("*.png")) == [session / kept])
    assert [(entry.file_name, entry.changeable) for entry in bench.state.photos.value] == [(kept, False)]
    for asked in (intents.DeletePhoto(kept), intents.TagPhoto(kept, ("door",)), intents.RestorePhoto(deleted)):
        with pytest.raises(UserFacingError):
            bench.do(asked)
    bench.bus.publish(SessionStarted(4, "s2"))
    bench.until(lambda: not bench.state.photos.value)


def test_photos_without_a_session_are_found_again_with_their_tags(bench: Bench) -> None:
    bench.take(bench.study, "photos/2026-11-01_10-00-00.png", Camera="rear", Keywords="door, lab", People="p-3")
    bench.take(bench.study, "photos/2026-11-02_10-00-00.png")
    os.utime(bench.study / "photos/2026-11-01_10-00-00.png", (1, 1))
    (bench.study / "photos" / "torn.png").write_bytes(b"\x89PNG\r\n\x1a\n and no more")
    aside = bench.study / "photos" / ".deleted"
    aside.mkdir()
    (aside / "study 2026-10-01_10-00-00.png").write_bytes(b"of a run that broke off")
    bench.service.list_earlier()
    bench.until(lambda: len(bench.state.photos.value) == 2)
    newer, older = bench.state.photos.value
    assert (newer.file_name, newer.tags) == ("photos/2026-11-02_10-00-00.png", ())
    assert (older.camera, older.tags, older.person_ids) == ("rear", ("door", "lab"), ("p-3",))
    assert not aside.exists()


def test_without_the_permission_there_are_none(bench: Bench) -> None:
    photo = bench.taken(bench.begin_session())
    tour = find_scenario("tour-guide")
    bench.service.use_scenario(replace(tour, permissions=replace(tour.permissions, photos=False)))
    assert bench.state.photos.value == ()
    with pytest.raises(UserFacingError, match="does not allow photos"):
        bench.do(intents.AskAboutPhoto(photo, "What is this?"))


def test_the_model_gets_the_picture_where_it_may_and_can_see(bench: Bench) -> None:
    photo = bench.taken(bench.begin_session())
    bench.do(intents.AskAboutPhoto(photo, "What is this?", actor="wizard:b"))
    ((asked, (jpeg,)),) = bench.until(lambda: bench.assistant.asked)
    assert asked == intents.Ask("What is this?", pictures=(photo,), actor="wizard:b")
    assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).shape[1] == 1024
    bench.assistant.refusal = UserFacingError("It cannot see.", "", "")
    with pytest.raises(UserFacingError, match="cannot see"):
        bench.do(intents.AskAboutPhoto(photo, "What is this?"))


def test_the_model_gets_what_a_camera_shows_now(bench: Bench) -> None:
    asked = intents.Ask("What is this?", pictures=("camera front",))
    with pytest.raises(UserFacingError, match="has no video now"):
        bench.assistant.ask(asked)
    bench.state.add(FrameRef(clock.now_ns(), None, "front", "", 0, 1, 1280, 720))
    bench.assistant.ask(asked)
    ((_, (jpeg,)),) = bench.until(lambda: bench.assistant.asked)
    assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).shape == (576, 1024, 3)


def test_a_file_that_cannot_be_changed_is_reported_of(bench: Bench) -> None:
    session = bench.begin_session()
    photo = bench.taken(session)
    (session / photo).unlink()
    bench.do(intents.DeletePhoto(photo))
    assert bench.told(Problem).what == "The photo was not deleted."
    assert not bench.state.photos.value[0].deleted
