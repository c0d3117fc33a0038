"""Program that runs one process entry point with all features as the console does.

``python -m tests.app.traced_body``. Arguments: name of the entry point, a folder for its files, the robot's address,
and the seconds to continue after its work, as libraries connect from background threads.
"""

import queue
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np

from caris_desktop.app import process_entry_points
from caris_desktop.conversation.embedded_server import EmbeddedReady, ModelAdded, find_embedded_weights
from caris_desktop.conversation.face.page import PageOpened, run_face_page
from caris_desktop.conversation.listening.recogniser_messages import RecogniserReady, RecogniserSettings
from caris_desktop.conversation.sound_devices import BeginPlaying, MicrophoneList, OpenMicrophone, PlayThis
from caris_desktop.conversation.synthesis_messages import SynthesisReady, SynthesisSettings, UseVoice
from caris_desktop.domain import clock
from caris_desktop.domain.events import LinkChanged, SessionEnded, SessionStarted, UtteranceChanged
from caris_desktop.domain.link_commands import Say
from caris_desktop.domain.sensing import AudioChunk, FrameRef, People
from caris_desktop.live.child_process import ChildProcess, ProcessSpec, RingsToRead, RingToWrite
from caris_desktop.live.erasure_run import ErasureRequest, ForgettingEnded
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.people.people_store import PeopleStore
from caris_desktop.perception.backends import runtime_selection
from caris_desktop.perception.cameras.camera_source import parse_camera
from caris_desktop.perception.inference_messages import DetectionRequest, InferenceReady, InferenceSettings
from caris_desktop.recording.annotation.timeline_builder import run_overview
from caris_desktop.recording.annotation.timeline_overview import SessionOverview
from caris_desktop.recording.recorder.recorder_messages import StopRecording, TakePhoto
from caris_desktop.recording.session.session_reader import open_session
from caris_desktop.recording.session_export import FORMATS, ExportFinished, ExportRequest, run_exports
from caris_desktop.robot.link import LinkSettings
from caris_desktop.robot.profile import load_profile
from tests.perception.cameras.running_camera import write_video
from tests.recording.driving import start
from tests.support.recorded_session import make_session

PATIENCE_S = 120.0
RATE_HZ = 16_000


class Body:
    """Child process with its messages."""

    def __init__(self, target: Callable[..., None], *arguments: Any) -> None:
        self._told: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._child = ChildProcess(
            ProcessSpec("traced", target, arguments),
            on_message=lambda value, _raw: self._told.put(value),
            on_exit=lambda code: self._told.put(code),
        )
        self._child.start()
        self.send = self._child.send

    def until(self, *kinds: type[Any]) -> Any:
        while not isinstance(value := self._told.get(timeout=PATIENCE_S), kinds):
            assert not isinstance(value, int) or value == 0, f"it ended with {value}"
        return value

    def end(self) -> None:
        self._child.stop(grace_s=20.0)


def sound() -> AudioChunk:
    noise = np.random.default_rng(1).integers(-3000, 3000, (RATE_HZ // 2, 1), np.int16)
    return AudioChunk(clock.now_ns(), "microphone", RATE_HZ, noise)


class Driven:
    """One method per process entry point: lets it do its work and returns it still running."""

    def __init__(self, folder: Path, robot: str) -> None:
        self.folder = folder
        self.link = LinkSettings(load_profile("simulated"), robot)
        self.ring = FrameRing.create()

    def picture(self) -> FrameRef:
        (photo, *_) = runtime_selection._photos()
        image = np.asarray(cv2.resize(photo, (640, 480)), np.uint8)
        return self.ring.write(image, stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera="front")

    def recorder(self) -> Body:
        body = Body(process_entry_points.recorder, RingsToRead((self.ring.name,)))
        body.send(start(self.folder / "session"))
        body.until(SessionStarted)
        for value in (self.picture(), sound(), TakePhoto(self.picture(), self.folder)):
            body.send(value)
        body.send(StopRecording())
        body.until(SessionEnded)
        return body

    def inference(self) -> Body:
        body = Body(process_entry_points.inference, RingsToRead((self.ring.name,)), InferenceSettings())
        body.until(InferenceReady)
        body.send(DetectionRequest(self.picture(), faces=True, to_cover=True))
        body.until(People)
        return body

    def camera(self) -> Body:
        write_video(self.folder / "walk.mp4")
        body = Body(
            process_entry_points.camera, parse_camera(f"{self.folder / 'walk.mp4'}?loop"), RingToWrite(self.ring.name)
        )
        body.until(FrameRef)
        return body

    def speech(self) -> Body:
        body = Body(process_entry_points.speech)
        body.send(UseVoice(SynthesisSettings("piper:en_US-joe-medium", "en", at_hand=True)))
        body.until(SynthesisReady)
        body.send(Say(clock.now_ns(), "u1", "Hello, and welcome."))
        while body.until(UtteranceChanged).state not in ("finished", "failed"):
            pass
        return body

    def microphone(self) -> Body:
        body = Body(process_entry_points.microphone)
        body.until(MicrophoneList)
        body.send(OpenMicrophone(""))
        body.until(object)
        return body

    def recogniser(self) -> Body:
        body = Body(process_entry_points.recogniser, RecogniserSettings())
        body.until(RecogniserReady)
        for _ in range(4):
            body.send(sound())
        return body

    def playback(self) -> Body:
        body = Body(process_entry_points.playback)
        body.send(BeginPlaying("s"))
        body.send(PlayThis(RATE_HZ, sound().samples))
        body.until(object)
        return body

    def language_model(self) -> Body:
        body = Body(process_entry_points.language_model)
        ready = body.until(EmbeddedReady)
        asked = {"messages": [{"role": "user", "content": "Hello."}], "max_tokens": 3}
        answer = httpx.post(
            f"{ready.url}/v1/chat/completions", json=asked, headers={"Authorization": f"Bearer {ready.key}"},
            timeout=PATIENCE_S, trust_env=False,
        )  # fmt: skip
        assert answer.status_code == 200
        return body

    def model_addition(self) -> Body:
        weights = find_embedded_weights()
        assert weights is not None
        body = Body(process_entry_points.model_addition, weights, "tried")
        body.until(ModelAdded)
        return body

    def forgetting(self) -> Body:
        make_session(self.folder / "study" / "sessions" / "one", seconds=2.0, utterance_every_s=0.5)
        database = self.folder / "study" / "people.sqlite"
        PeopleStore(database).close()
        body = Body(
            process_entry_points.forgetting,
            ErasureRequest(self.folder / "study", database, "P-1", texts="redact", unknown=True),
        )
        body.until(ForgettingEnded)
        return body

    def control_link(self) -> Body:
        body = Body(process_entry_points.control_link, self.link)
        while body.until(LinkChanged).state != "connected":
            pass
        return body

    def media_link(self) -> Body:
        body = Body(process_entry_points.media_link, self.link, RingToWrite(self.ring.name))
        body.until(FrameRef)
        return body

    def run_exports(self) -> Body:
        made = make_session(self.folder / "one", seconds=2.0, utterance_every_s=0.5, photo_every_s=1.0)
        formats = tuple(fmt.name for fmt in FORMATS)
        body = Body(run_exports, ExportRequest((made.folder,), formats, self.folder / "out"))
        assert body.until(ExportFinished).written
        return body

    def run_overview(self) -> Body:
        made = make_session(self.folder / "one", seconds=2.0, utterance_every_s=0.5)
        body = Body(run_overview, open_session(made.folder))
        body.until(SessionOverview)
        return body

    def run_face_page(self) -> Body:
        body = Body(run_face_page, False)
        assert httpx.get(body.until(PageOpened).address, trust_env=False).status_code == 200
        return body


if __name__ == "__main__":
    name, folder, robot, lives_s = sys.argv[1:]
    driven = Driven(Path(folder), robot)
    running: Body = getattr(driven, name)()
    time.sleep(float(lives_s))
    running.end()
    driven.ring.close()
    print("it did its work")
