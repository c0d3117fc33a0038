"""Camera sources, through the same process body that the console starts (here in a thread)."""

import contextlib
import http.server
import multiprocessing
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from numpy.typing import NDArray

from caris_desktop.domain.events import Problem
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.perception import cameras
from caris_desktop.perception.cameras import (
    CameraEnded,
    CameraError,
    CameraReady,
    DeviceCamera,
    OakCamera,
    PlayVideo,
    StreamCamera,
    fitting_size,
    open_camera,
    parse_source,
    run_camera,
)

FPS = 25
PICTURES = 12


class KeptFrames:
    """A frame writer that keeps the mean brightness of each picture."""

    def __init__(self) -> None:
        self.brightness: list[float] = []

    def write(
        self, image_bgr: NDArray[np.uint8], *, stamp_ns: int, robot_stamp_ns: int | None, camera: str
    ) -> FrameRef:
        assert image_bgr.dtype == np.uint8
        self.brightness.append(float(image_bgr.mean()))
        height_px, width_px = image_bgr.shape[:2]
        number = len(self.brightness)
        return FrameRef(stamp_ns, robot_stamp_ns, camera, "ring", 0, number, width_px, height_px)


class RunningCamera:
    """``run_camera`` in a thread, and what it sent."""

    def __init__(self, source: str) -> None:
        self.frames = KeptFrames()
        self.connection, theirs = multiprocessing.Pipe()
        self.thread = threading.Thread(target=self._run, args=(theirs, source), daemon=True)
        self.received: list[Any] = []
        self.thread.start()

    def _run(self, connection: Connection, source: str) -> None:
        run_camera(connection, source, self.frames)
        connection.close()

    def until(self, condition: Callable[[list[Any]], bool], *, within_s: float = 20.0) -> list[Any]:
        deadline_s = time.monotonic() + within_s
        while not condition(self.received):
            assert self.connection.poll(max(0.0, deadline_s - time.monotonic())), self.received[-3:]
            self.received.append(self.connection.recv())
        return self.received

    def of(self, kind: type[Any]) -> list[Any]:
        return [message for message in self.received if isinstance(message, kind)]

    def close(self) -> None:
        self.connection.close()
        self.thread.join(10.0)
        assert not self.thread.is_alive()


@pytest.fixture
def start() -> Iterator[Callable[[str], RunningCamera]]:
    running: list[RunningCamera] = []

    def start_one(source: str) -> RunningCamera:
        running.append(RunningCamera(source))
        return running[-1]

    yield start_one
    for camera in running:
        camera.close()


def _has(kind: type[Any], count: int = 1) -> Callable[[list[Any]], bool]:
    return lambda received: sum(isinstance(message, kind) for message in received) >= count


def _write_video(path: Path, *, size_px: tuple[int, int] = (320, 240)) -> None:
    """Each picture is a little brighter than the one before."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=FPS)
        stream.width, stream.height = size_px
        for number in range(PICTURES):
            image = np.full((size_px[1], size_px[0], 3), 20 + 15 * number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode(None))


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "corridor walk.mp4"
    _write_video(path)
    return path


@pytest.mark.parametrize(
    ("text", "kind", "target", "name", "loop"),
    [
        ("0", "device", "0", "camera-0", False),
        ("/dev/video2", "device", "/dev/video2", "camera-2", False),
        ("oak", "oak", "", "oak", False),
        ("oak:14442C10D13EABCE00", "oak", "14442C10D13EABCE00", "oak", False),
        ("videos/walk 1.mp4", "file", "videos/walk 1.mp4", "walk-1", False),
        ("walk.mp4?loop", "file", "walk.mp4", "walk", True),
        ("rtsp://user:secret@10.0.0.7:554/main", "url", "rtsp://user:secret@10.0.0.7:554/main", "10.0.0.7", False),
    ],
)
def test_sources_are_understood(text: str, kind: str, target: str, name: str, loop: bool) -> None:
    source = parse_source(text)
    assert (source.kind, source.target, source.name, source.loop) == (kind, target, name, loop)


@pytest.mark.parametrize("text", ["", "ftp://host/file.mp4", "rtsp://"])
def test_other_sources_are_refused_in_words(text: str) -> None:
    with pytest.raises(CameraError) as caught:
        parse_source(text)
    assert caught.value.advice


def test_a_video_plays_whole_in_order_and_at_its_rate(video: Path, start: Callable[[str], RunningCamera]) -> None:
    camera = start(str(video))
    camera.until(_has(CameraReady))
    camera.connection.send(PlayVideo())
    camera.until(_has(CameraEnded))
    (ready,) = camera.of(CameraReady)
    assert (ready.camera, ready.width_px, ready.height_px, ready.fps) == ("corridor-walk", 320, 240, FPS)
    refs = camera.of(FrameRef)
    assert [ref.sequence for ref in refs] == list(range(1, PICTURES + 1))
    assert camera.frames.brightness == sorted(camera.frames.brightness)
    assert len(set(camera.frames.brightness)) == PICTURES
    # Never early: each picture comes no sooner than its time after the first. How late, this machine decides.
    for index, ref in enumerate(refs):
        assert ref.stamp_ns - refs[0].stamp_ns >= (index / FPS) * 1e9 - 3e6


def test_a_video_waits_for_being_told_to_play(
    video: Path, start: Callable[[str], RunningCamera], monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = start(str(video))
    camera.until(_has(CameraReady))
    assert camera.frames.brightness == []
    camera.connection.send(PlayVideo())
    camera.until(_has(FrameRef))

    monkeypatch.setattr(cameras, "PLAY_AFTER_S", 0.05)
    start(str(video)).until(_has(FrameRef))


def test_a_looped_video_goes_on_until_the_console_ends_it(video: Path, start: Callable[[str], RunningCamera]) -> None:
    camera = start(f"{video}?loop")
    camera.until(_has(CameraReady))
    camera.connection.send(PlayVideo())
    camera.until(_has(FrameRef, 2 * PICTURES + 3))
    brightness = camera.frames.brightness
    assert brightness[PICTURES : PICTURES + 3] == pytest.approx(brightness[:3], abs=2.0)
    camera.close()


@pytest.mark.logs(r"perception\.cameras: camera")
@pytest.mark.parametrize("name", ["missing.mp4", "notes.txt"])
def test_a_file_that_cannot_be_played_is_a_problem(
    tmp_path: Path, start: Callable[[str], RunningCamera], name: str
) -> None:
    (tmp_path / "notes.txt").write_text("no video")
    camera = start(str(tmp_path / name))
    camera.until(_has(CameraEnded))
    (problem,) = camera.of(Problem)
    assert problem.severity == "error"
    assert name in problem.what


def test_a_source_that_is_not_understood_is_a_problem(start: Callable[[str], RunningCamera]) -> None:
    camera = start("gopher://camera")
    camera.until(_has(CameraEnded))
    assert "gopher" in camera.of(Problem)[0].what


class MjpegCamera(http.server.BaseHTTPRequestHandler):
    """A network camera that breaks off after some pictures, each time it is asked."""

    picture = b""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        part = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(self.picture)
        with contextlib.suppress(OSError):
            for _ in range(30):
                self.wfile.write(part + self.picture + b"\r\n")

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - the base class names it so
        pass


@pytest.mark.logs(r"perception\.cameras: camera")
def test_a_network_camera_that_breaks_off_is_reported_and_comes_back(
    start: Callable[[str], RunningCamera], monkeypatch: pytest.MonkeyPatch
) -> None:
    import cv2

    monkeypatch.setattr(cameras, "_RETRY_AFTER_S", (0.05,))
    MjpegCamera.picture = cv2.imencode(".jpg", np.full((240, 320, 3), 120, np.uint8))[1].tobytes()
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), MjpegCamera)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        camera = start(f"http://wizard:secret@127.0.0.1:{server.server_port}/video.mjpg")
        camera.until(_has(CameraReady, 2))
        problem = camera.of(Problem)[0]
        assert "127.0.0.1" in problem.what
        assert "secret" not in repr(camera.received)
        assert camera.of(FrameRef)[0].height_px == 240
        camera.close()
    finally:
        server.shutdown()
        server.server_close()
        thread.join(5.0)


@pytest.mark.logs(r"perception\.cameras: camera")
def test_an_absent_camera_is_reported_once_and_retried(
    start: Callable[[str], RunningCamera], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cameras, "_RETRY_AFTER_S", (0.02,))
    attempts = []
    real_open = open_camera

    def counting_open(source: cameras.CameraSource) -> cameras.OpenCamera:
        attempts.append(source)
        return real_open(source)

    monkeypatch.setattr(cameras, "open_camera", counting_open)
    camera = start("/dev/video97")
    camera.until(_has(Problem))
    deadline_s = time.monotonic() + 20.0
    while len(attempts) < 4 and time.monotonic() < deadline_s:
        camera.thread.join(0.01)
    assert len(attempts) >= 4
    assert not camera.connection.poll()
    (problem,) = camera.of(Problem)
    assert problem.severity == "warning"
    assert "/dev/video97" in problem.what


def test_a_device_delivers_until_it_is_unplugged(video: Path) -> None:
    # OpenCV reads a file through the same calls as a device; its end looks like an unplugged cable.
    camera = DeviceCamera(str(video))
    for _ in range(PICTURES):
        picture = camera.read()
        assert picture is not None
        assert picture.image_bgr.shape == (240, 320, 3)
    with pytest.raises(CameraError, match="stopped"):
        camera.read()
    camera.close()


def test_large_pictures_are_made_to_fit_the_ring(tmp_path: Path) -> None:
    assert fitting_size(1920, 1080) == (1920, 1080)
    assert fitting_size(1080, 1920) == (1080, 1920)
    width_px, height_px = fitting_size(3840, 2160)
    assert (width_px, height_px) == (1920, 1080)
    path = tmp_path / "large.mp4"
    _write_video(path, size_px=(2560, 1440))
    camera = StreamCamera(parse_source(str(path)))
    picture = camera.read()
    assert picture is not None
    assert picture.image_bgr.shape == (camera.height_px, camera.width_px, 3) == (1080, 1920, 3)
    camera.close()


class ReplayedOak:
    """depthai's own host-side replay of a video, behind the few calls that need a real device."""

    def __init__(self, video: Path) -> None:
        import depthai

        self.calls: list[Any] = []
        self.pipeline = depthai.Pipeline(False)
        self.replay = self.pipeline.create(depthai.node.ReplayVideo)
        self.replay.setReplayVideoFile(video)
        self.replay.setOutFrameType(depthai.ImgFrame.Type.BGR888i)
        self.replay.setLoop(False)

    def create(self, node: Any) -> "ReplayedOak":
        self.calls.append(node)
        return self

    def build(self) -> "ReplayedOak":
        return self

    def requestOutput(self, size: tuple[int, int], *, type: Any, fps: float) -> Any:  # noqa: A002 - depthai names it so
        self.calls.append((size, type, fps))
        return self.replay.out

    def start(self) -> None:
        self.pipeline.start()

    def stop(self) -> None:
        self.pipeline.stop()


def test_an_oak_camera_delivers_through_depthai_until_it_ends(video: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    depthai = pytest.importorskip("depthai")
    replayed = ReplayedOak(video)
    monkeypatch.setattr(depthai, "Device", lambda device_id: f"device {device_id}")
    monkeypatch.setattr(depthai, "Pipeline", lambda device: replayed)
    camera = OakCamera("14442C10D13EABCE00")
    picture = camera.read()
    assert picture is not None
    assert picture.image_bgr.shape == (240, 320, 3)
    with pytest.raises(CameraError, match="stopped"):
        for _ in range(PICTURES + 1):
            camera.read()
    camera.close()
    assert replayed.calls == [depthai.node.Camera, ((1280, 720), depthai.ImgFrame.Type.BGR888i, 30)]


def test_no_oak_camera_is_said_so() -> None:
    depthai = pytest.importorskip("depthai")
    if depthai.Device.getAllAvailableDevices():
        pytest.skip("an OAK camera is attached")
    with pytest.raises(CameraError, match="No OAK"):
        OakCamera()
