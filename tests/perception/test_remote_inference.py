"""Inference with a detector on another machine: waits, reports, and continues when it is back."""

import multiprocessing
import threading
from collections.abc import Iterator
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.domain.events import Problem
from caris_desktop.domain.sensing import FrameRef, People, ThingBox
from caris_desktop.perception import inference
from caris_desktop.perception.backends import remote_detector
from caris_desktop.perception.inference import run_inference
from caris_desktop.perception.inference_messages import (
    DetectionRequest,
    DetectorAway,
    DetectorSettings,
    FrameSkipped,
    InferenceReady,
    InferenceSettings,
)
from tests.perception.served import Serving, picture


class Frames:
    def read(self, _ref: FrameRef) -> NDArray[np.uint8]:
        return picture()


class Running:
    """Inference in a thread of the test, with a pipe as in the console."""

    def __init__(self, detector: DetectorSettings) -> None:
        self.connection, theirs = multiprocessing.Pipe()
        settings = InferenceSettings(detector=detector, recognise_appearance=False, niceness=0, max_load=1.0)
        self._thread = threading.Thread(target=self._run, args=(theirs, settings))
        self._thread.start()
        self._number = 0

    def _run(self, theirs: Connection, settings: InferenceSettings) -> None:
        with theirs:
            run_inference(theirs, Frames(), settings)

    def next(self, kind: type) -> Any:
        """Next message of this kind; embeddings and portraits may come in between."""
        while True:
            assert self.connection.poll(20)
            value = self.connection.recv()
            if isinstance(value, kind):
                return value
            assert not isinstance(value, Problem | FrameSkipped | People | InferenceReady), value

    def ask(self) -> None:
        self._number += 1
        stamp_ns = self._number * 100_000_000
        self.connection.send(DetectionRequest(FrameRef(stamp_ns, None, "front", "", 0, self._number, 160, 120)))

    def close(self) -> None:
        self.connection.close()
        self._thread.join()


@pytest.fixture
def server() -> Iterator[Serving]:
    running = Serving()
    yield running
    running.stop()


@pytest.mark.logs("pictures are passed over")
def test_it_waits_for_the_other_machine_says_so_and_continues(server: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inference, "_ASK_AGAIN_AFTER_S", 0.02)
    monkeypatch.setattr(remote_detector, "_TRY_AGAIN_AFTER_S", 0.0)
    server.stop()
    running = Running(DetectorSettings(server=server.address))
    try:
        problem = running.next(DetectorAway).problem
        assert problem.what == f"127.0.0.1:{server.port} does not respond."
        assert "remove perception.server" in problem.advice
        server.start()
        ready = running.next(InferenceReady)
        assert ready.model == f"bright, torch on CUDA, on 127.0.0.1:{server.port}"
        assert ready.server == server.address
        running.ask()
        assert running.next(People).camera == "front"
        server.stop()
        running.ask()
        assert "does not respond" in running.next(DetectorAway).problem.what
        running.next(FrameSkipped)
        running.ask()
        running.next(FrameSkipped)
        server.start()
        running.ask()
        assert len(running.next(People).boxes) == 1
    finally:
        running.close()


def test_things_and_poses_are_reported_next_to_people(server: Serving) -> None:
    server.detector.class_names = ("chair", "person")
    running = Running(DetectorSettings(server=server.address, things=("Chair", "unicorn", "person")))
    try:
        running.next(InferenceReady)
        problem = running.next(Problem)
        assert problem.what == "Classes unknown to the detector: unicorn, person."
        assert "Classes of this detector: chair, person" in problem.advice
        server.detector.confidences = (0.8, 0.5)
        for _ in range(12):
            running.ask()
            people = running.next(People)
        (thing,) = people.things
        assert thing == ThingBox("chair", 0.0, 0.0, 160.0, 120.0, 0.5)
        (person,) = people.boxes
        assert (person.hand_raised, person.facing) == (False, False)
    finally:
        running.close()


def test_its_end_is_noticed_while_it_waits() -> None:
    running = Running(DetectorSettings(server="ws://127.0.0.1:1"))
    running.next(DetectorAway)
    running.close()
