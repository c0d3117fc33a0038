"""Content and gaze of the robot's face."""

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np
import psutil
import pytest
from PySide6.QtCore import QObject
from PySide6.QtWidgets import QApplication
from websockets.asyncio.client import connect

from caris_desktop.app.composition import find_scenario
from caris_desktop.conversation.face.drawing import Box, Drawing, Lips, Words
from caris_desktop.conversation.face.face_file import load_face, save_face
from caris_desktop.domain import clock, intents
from caris_desktop.domain.events import FaceChanged, Problem, UtteranceChanged
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.sensing import FrameRef, People, PersonBox
from caris_desktop.domain.sound_values import ROBOT_MICROPHONE, Hearing, PlayedSound
from caris_desktop.live.background_worker import AsyncioThread, BackgroundWorker
from caris_desktop.live.bus import Bus
from caris_desktop.live.service import ProcessManager
from caris_desktop.live.services.face_service import FaceService
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import PhotoEntry
from caris_desktop.people.presence import PersonRow
from tests.support.polling import wait_for
from tests.support.service_context import context_of

pytestmark = pytest.mark.logs(r"live\.bus: ")


class Frames:
    def read(self, _ref: FrameRef) -> Any:
        return np.full((60, 80, 3), 90, np.uint8)


class Bench:
    def __init__(self, folder: Path) -> None:
        self.owner = QObject()
        self.state = LiveState(self.owner)
        self.bus = Bus(self.state, self.owner)
        self.slow_work = BackgroundWorker(self.owner)
        self.asyncio = AsyncioThread()
        self.children = ProcessManager(self.bus, self.owner)
        self.service = FaceService(
            context_of(self.state, self.bus, self.owner, children=self.children, slow_work=self.slow_work),
            self.asyncio, frames=Frames(),
            load=lambda name: load_face(name, folder), save=lambda face: save_face(face, folder),
        )  # fmt: skip
        self.bus.follow(self.service.follows())
        self.happened: list[Any] = []
        self.state.event_happened.connect(self.happened.append)
        scenario = find_scenario("tour-guide")
        self.scenario = replace(scenario, face=replace(scenario.face, live_picture=True))
        self.service.use_scenario(self.scenario)
        self.until(lambda: isinstance(self.shown, Drawing))

    @property
    def shown(self) -> Any:
        return self.state.face_drawing.value

    def shapes(self, kind: type[Any]) -> list[Any]:
        return [shape for shape in self.shown.shapes if isinstance(shape, kind)]

    def until(self, seen: Callable[[], Any]) -> Any:
        def look() -> Any:
            QApplication.processEvents()
            return seen()

        return wait_for(look, "what was asked", timeout_s=10.0)

    def do(self, intent: Intent) -> None:
        self.service.handlers()[type(intent)](intent)

    def end(self) -> None:
        self.service.stop()
        self.slow_work.finish(lambda _what, work: work())
        self.service.end()
        self.children.end()
        self.asyncio.stop()
        self.state.close()


@pytest.fixture
def bench(qapp: QApplication, tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path)
    yield bench
    bench.end()


def says(text: str, state: Any, stamp_ns: int | None = None, utterance_id: str = "u-1") -> UtteranceChanged:
    return UtteranceChanged(stamp_ns or clock.now_ns(), utterance_id, "robot", text, "typed", state)


def test_a_scenario_without_a_face_has_none_and_one_with_it_begins_calm(bench: Bench) -> None:
    assert bench.state.face.value.expressions[0] == bench.state.face.value.expression == "calm"
    forbidding = replace(bench.scenario, permissions=replace(bench.scenario.permissions, face=False))
    bench.service.use_scenario(forbidding)
    assert (bench.state.face.value.what, bench.shown) == ("off", None)
    with pytest.raises(UserFacingError, match="not ready"):
        bench.do(intents.ShowExpression("happy"))


def test_an_expression_shows_and_is_on_record_and_an_unknown_one_is_refused(bench: Bench) -> None:
    before = bench.shapes(Lips)[0]
    bench.do(intents.ShowExpression("happy", actor="wizard:b"))
    bench.until(lambda: bench.shapes(Lips)[0].lower > before.lower + 1)
    bench.until(lambda: [each for each in bench.happened if isinstance(each, FaceChanged)][-1].expression == "happy")
    assert bench.happened[-1].actor == "wizard:b"
    with pytest.raises(UserFacingError, match="no expression"):
        bench.do(intents.ShowExpression("dancing"))


def test_it_speaks_with_the_sound_and_says_the_name_that_the_record_does_not_have(bench: Bench) -> None:
    row = PersonRow("p-1", 1, "Luis", here=True, since_ns=0, last_seen_ns=0, known=True)
    bench.state.everybody.set((row,))
    now_ns = clock.now_ns()
    sound = (8000 * np.sin(np.arange(16_000) / 5)).astype(np.int16)[:, None]
    bench.bus.publish(PlayedSound(now_ns, "u-1", "Hello", 16_000, sound))
    bench.bus.publish(says("Hello {p-1}!", "started", now_ns))
    bench.until(lambda: bench.shapes(Lips)[0].lower - bench.shapes(Lips)[0].upper > 5)
    assert bench.shapes(Words)[0].text == "Hello Luis!" and bench.state.face.value.speaking
    bench.bus.publish(says("Hello {p-1}!", "finished"))
    bench.until(lambda: not bench.shapes(Words) and not bench.state.face.value.speaking)


def test_a_sentence_that_is_reported_in_pieces_is_spoken_from_its_first_one_on(bench: Bench) -> None:
    now_ns = clock.now_ns()
    sound = (8000 * np.sin(np.arange(160_000) / 5)).astype(np.int16)[:, None]
    bench.bus.publish(says("Well.", "started", now_ns, "u-9"))
    bench.bus.publish(PlayedSound(now_ns, "u-9", "Well.", 16_000, sound))
    bench.bus.publish(PlayedSound(now_ns + 10_500_000_000, "u-9", "Well.", 16_000, np.zeros_like(sound)))
    bench.until(lambda: bench.shapes(Lips)[0].lower - bench.shapes(Lips)[0].upper > 5)
    bench.bus.publish(says("Well.", "finished", utterance_id="u-9"))
    bench.until(lambda: not bench.state.face.value.speaking)


def test_it_listens_while_a_person_speaks_and_not_to_itself(bench: Bench) -> None:
    eyes = len(bench.shapes(Box))
    bench.bus.publish(Hearing(clock.now_ns(), ROBOT_MICROPHONE, speaking=True, speaker="robot"))
    bench.until(lambda: bench.state.hearing_of(ROBOT_MICROPHONE).value is not None)
    assert not bench.state.face.value.listening
    bench.bus.publish(Hearing(clock.now_ns(), ROBOT_MICROPHONE, speaking=True, speaker="participant"))
    bench.until(lambda: bench.state.face.value.listening and len(bench.shapes(Box)) == eyes + 1)


def test_the_eyes_follow_whom_the_wizard_means_or_who_is_nearest_as_seen_from_there(bench: Bench) -> None:
    def box(person_id: str, left_px: float, height_px: float) -> PersonBox:
        return PersonBox(1, person_id, left_px, 100, 60, height_px, 0.9)

    def middle() -> float:
        return sum(shape.x for shape in bench.shapes(Box)[:2]) / 2

    people = People(clock.now_ns(), "front", 1, 640, 480, (box("p-1", 0, 300), box("p-2", 580, 200)), 5.0)
    bench.bus.publish(people)
    bench.until(lambda: middle() > 1.5)  # at the left of the image: right on the robot's screen
    bench.state.selected_person.set("p-2")
    bench.bus.publish(people)
    bench.until(lambda: middle() < -1.5)


def test_a_text_a_photo_and_the_live_picture_stand_in_place_of_the_face(bench: Bench) -> None:
    bench.do(intents.ShowOnFace("text", "  Back   in a moment "))
    bench.until(lambda: [shape.text for shape in bench.shapes(Words)] == ["Back in a moment"])
    jpeg = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    bench.state.photos.set((PhotoEntry("photos/1.png", 1, preview_jpeg=jpeg),))
    bench.do(intents.ShowOnFace("photo", "photos/1.png"))
    assert bench.shown == jpeg
    bench.do(intents.ShowOnFace("live"))
    bench.bus.publish(FrameRef(clock.now_ns(), None, "front", "r", 0, 1, 80, 60))
    bench.until(lambda: isinstance(bench.shown, np.ndarray))
    bench.do(intents.ShowOnFace("face"))
    bench.until(lambda: isinstance(bench.shown, Drawing) and bench.shapes(Lips))
    for refused in (intents.ShowOnFace("text", "  "), intents.ShowOnFace("photo", "photos/2.png")):
        with pytest.raises(UserFacingError):
            bench.do(refused)
    bench.service.use_scenario(replace(bench.scenario, face=replace(bench.scenario.face, live_picture=False)))
    with pytest.raises(UserFacingError, match="does not show"):
        bench.do(intents.ShowOnFace("live"))


def test_a_face_of_ones_own_is_retained_and_worn_and_a_broken_one_refused(bench: Bench) -> None:
    text = 'version: 1\ntitle: Green\nink: "#00ff00"\n'
    bench.do(intents.KeepFace("green", text))
    bench.until(lambda: bench.state.face.value.face == "green" and bench.shapes(Box)[0].ink == "#00ff00")
    with pytest.raises(UserFacingError, match="line 3"):
        bench.do(intents.KeepFace("green", text.replace("#00ff00", "green")))
    bench.do(intents.UseFace("nobody-has-it"))
    problem = bench.until(lambda: next((one for one in bench.happened if isinstance(one, Problem)), None))
    assert "calm" in problem.advice and bench.state.face.value.face == "green"


def test_nothing_is_drawn_while_nothing_moves(bench: Bench) -> None:
    bench.do(intents.KeepFace("still", "version: 1\ntitle: Still\nblink_every_s: 0\n"))
    bench.until(lambda: bench.state.face.value.face == "still" and not bench.service._drawing.isActive())
    bench.do(intents.ShowExpression("sad"))
    assert bench.service._drawing.isActive()
    bench.until(lambda: not bench.service._drawing.isActive())


def test_the_page_exists_while_it_is_served_and_viewers_are_counted(bench: Bench) -> None:
    bench.do(intents.ServeFace(on=True))
    address = bench.until(lambda: bench.state.face_page.value)
    assert httpx.get(address).status_code == 200 and bench.state.face.value.served
    bench.do(intents.ServeFace(on=False))
    assert (bench.state.face_page.value, bench.state.face.value.served) == ("", False)
    bench.until(lambda: _gone(address))


@pytest.mark.logs(r"face page ended by itself")
def test_the_face_page_is_another_process_whose_end_is_reported(bench: Bench) -> None:
    bench.do(intents.ServeFace(on=True))
    address = bench.until(lambda: bench.state.face_page.value)
    port = httpx.URL(address).port
    (child,) = (one for one in psutil.Process().children() if _listens(one, port))
    assert not _listens(psutil.Process(), port)
    child.kill()
    problem = bench.until(lambda: next((one for one in bench.happened if isinstance(one, Problem)), None))
    assert "stopped unexpectedly" in problem.what
    assert (bench.state.face_page.value, bench.state.face.value.served) == ("", False)
    bench.do(intents.ServeFace(on=True))
    assert httpx.get(bench.until(lambda: bench.state.face_page.value)).status_code == 200


def _listens(process: psutil.Process, port: int | None) -> bool:
    return any(one.laddr.port == port and one.status == "LISTEN" for one in process.net_connections("tcp"))


def test_a_face_that_moves_fast_ends_as_the_newest(bench: Bench) -> None:
    """The page's process gets the updates in order, and always the last one."""
    bench.do(intents.ServeFace(on=True))
    address = bench.until(lambda: bench.state.face_page.value)
    for number in range(300):
        bench.service._show_on_page(f"picture {number}".encode())
    bench.service._show_on_page(b"the last")

    async def seen() -> bytes | str:
        async with asyncio.timeout(20), connect(f"{address.replace('http', 'ws')}face") as socket:
            while (told := await socket.recv()) != b"the last":
                pass
            return told

    assert asyncio.run(seen()) == b"the last"


def _gone(address: str) -> bool:
    try:
        httpx.get(address)
    except httpx.HTTPError:
        return True
    return False
