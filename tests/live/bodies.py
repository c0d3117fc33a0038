"""Process entry points for tests of process management."""

import contextlib
import os
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from caris_desktop.conversation.sound_devices import MicrophoneAlive
from caris_desktop.domain import clock
from caris_desktop.domain.events import Marked, Problem, VoiceOutput
from caris_desktop.domain.link_commands import Say
from caris_desktop.domain.person_values import PersonLooks, PersonPortrait
from caris_desktop.domain.ports import FrameReader, FrameWriter
from caris_desktop.domain.sensing import FrameRef, People, PersonBox
from caris_desktop.perception.inference_messages import (
    DetectorAway,
    DetectorSettings,
    FrameSkipped,
    InferenceReady,
    InferenceSettings,
)


def echo(connection: Connection) -> None:
    """Echo messages, and send a farewell at the end."""
    while True:
        try:
            connection.send(connection.recv())
        except EOFError:
            connection.send(Marked(0, "farewell"))
            return


def deaf(connection: Connection) -> None:
    """Never read, and never exit."""
    connection.send(Marked(os.getpid(), "deaf"))
    while True:
        time.sleep(3600)


def crash(connection: Connection) -> None:
    connection.recv()
    os.abort()


def brightness(connection: Connection, frames: FrameReader, marker: str) -> None:
    """Detector double: one person in a bright frame; a frame of value 13 kills the process, as native code may.

    From 201 on the person has the track of that number, a good view and a constant appearance.
    """
    looks = np.eye(1, 512, dtype=np.float32)[0]
    connection.send(InferenceReady(0, f"brightness {marker}", 0.0))
    while True:
        try:
            ref: FrameRef = connection.recv().frame
        except EOFError:
            return
        image = frames.read(ref)
        value = -1 if image is None else int(image[0, 0, 0])
        if value == 13:
            os.abort()
        if value == 7:
            problem = Problem(
                0, "warning", "lab does not respond.", "No boxes.", "See whether it runs.", until="people"
            )
            connection.send(DetectorAway(0, problem))
            connection.send(FrameSkipped(ref.stamp_ns, ref.camera, ref.sequence))
            continue
        track = max(1, value - 200)
        boxes = (PersonBox(track, "", 0.0, 0.0, 8.0, 8.0, 0.9),) if value > 100 else ()
        connection.send(People(ref.stamp_ns, ref.camera, ref.sequence, ref.width_px, ref.height_px, boxes, 1.0))
        if value > 200:
            connection.send(PersonLooks(ref.stamp_ns, ref.camera, track, "clothing", "eye", looks, 0.9))
            connection.send(PersonPortrait(ref.stamp_ns, ref.camera, track, b"\xff\xd8", 0.9))


def inference_of_bright_frames(connection: Connection, frames: FrameReader, settings: InferenceSettings) -> None:
    """The real inference process with a detector double: one person in a bright frame."""
    from caris_desktop.perception import detector, inference, perceiver, tracker
    from caris_desktop.perception.backends import runtime_selection
    from caris_desktop.perception.backends.runtime_selection import Chosen
    from caris_desktop.perception.detector import Detections

    class Bright:
        label = "bright"
        class_names = ("person",)

        def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
            count = int(image_bgr[0, 0, 0] > 100)
            corners_px = np.array([[4.0, 4, 24, 44]] * count).reshape(-1, 4)
            return Detections(corners_px, np.full(count, 0.9), np.zeros(count, np.int64))

    def open_chosen(own: Path | None, settings: DetectorSettings, **given: Any) -> Chosen:
        plugin = settings.model.source.startswith("plugin:")
        return runtime_selection.open_chosen(own, settings, **given) if plugin else Chosen(Bright(), (0,), None)

    perceiver.open_chosen = open_chosen  # type: ignore[attr-defined]
    detector.LOAD_WITHIN_S = 3.0  # type: ignore[attr-defined]
    tracker.LOAD_WITHIN_S = 3.0  # type: ignore[attr-defined]
    inference.run_inference(connection, frames, settings)


def write_frames(connection: Connection, count: int, frames: FrameWriter) -> None:
    for number in range(count):
        image = np.full((6, 8, 3), number, np.uint8)
        connection.send(frames.write(image, stamp_ns=number, robot_stamp_ns=None, camera="front"))
    connection.poll(None)


def link_with_camera(connection: Connection, camera: str, frames: FrameWriter) -> None:
    """Media link double: frames at 50 Hz, and one more just before it exits."""
    number = 0
    ended = False
    while not ended:
        ended = connection.poll(0.02)
        number += 1
        image = np.full((6, 8, 3), 90, np.uint8)
        connection.send(frames.write(image, stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera=camera))


def silent_link(connection: Connection) -> None:
    """Control link double that never reaches its robot."""
    while True:
        try:
            connection.recv()
        except EOFError:
            return


def voice(connection: Connection, output: VoiceOutput) -> None:
    """Speech backend double, of the robot or this computer: speaks at once and reports it."""
    while True:
        try:
            asked = connection.recv()
        except EOFError:
            return
        if isinstance(asked, Say):
            for state in ("started", "finished"):
                connection.send(asked.reported(clock.now_ns(), state, output))


def deaf_to(connection: Connection, _request: object) -> None:
    """:func:`deaf` with a request, which is ignored."""
    deaf(connection)


def camera_that_notes(connection: Connection, notes: Path, frames: FrameWriter) -> None:
    """Send frames all the time, and write received messages to a file, one per line."""
    image = np.full((48, 64, 3), 200, np.uint8)
    while True:
        try:
            if connection.poll(0.02):
                with notes.open("a") as file:
                    file.write(f"{connection.recv()!r}\n")
            ref = frames.write(image, stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera="computer")
            connection.send(ref)
        except (EOFError, OSError):
            return


def somebody(connection: Connection, _frames: FrameReader) -> None:
    """Detector double: the same person in each frame."""
    connection.send(InferenceReady(0, "somebody", 0.0))
    while True:
        try:
            ref: FrameRef = connection.recv().frame
        except EOFError:
            return
        boxes = (PersonBox(1, "", 0.0, 0.0, 8.0, 8.0, 0.9),)
        connection.send(People(ref.stamp_ns, ref.camera, ref.sequence, ref.width_px, ref.height_px, boxes, 1.0))


def quiet_microphone(connection: Connection, *_arguments: Any) -> None:
    """Microphone double that reports success and records silence."""
    with contextlib.suppress(EOFError, OSError):
        while True:
            if connection.poll(0.5):
                connection.recv()
            connection.send(MicrophoneAlive())
