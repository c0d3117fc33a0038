"""Camera sources with the real process entry point (in a thread)."""

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from caris_desktop.domain import clock
from caris_desktop.domain.events import Problem
from caris_desktop.domain.media_checks import PictureError
from caris_desktop.domain.sensing import AudioChunk, CameraState, DepthGrid, FrameRef
from caris_desktop.perception.cameras import camera_process, camera_source
from caris_desktop.perception.cameras.camera_process import PlayVideo, StreamSound, open_camera
from caris_desktop.perception.cameras.camera_source import (
    CameraError,
    CameraSource,
    ChosenCamera,
    Picture,
    parse_camera,
    picture_of,
)
from caris_desktop.perception.cameras.device_camera import DeviceCamera
from caris_desktop.perception.cameras.stream_camera import StreamCamera
from tests.perception.cameras.running_camera import FPS, PICTURES, RunningCamera, has, has_state, write_video

Start = Callable[..., RunningCamera]


def test_a_video_plays_whole_in_order_and_at_its_rate(video: Path, start: Start) -> None:
    camera = start(str(video))
    camera.until(has_state("connected"))
    camera.connection.send(PlayVideo())
    camera.until(has_state("ended"))
    assert camera.states() == ["connecting", "connected", "ended"]
    ready = camera.of(CameraState)[1]
    assert (ready.camera, ready.width_px, ready.height_px, ready.fps) == ("corridor-walk", 320, 240, FPS)
    refs = camera.of(FrameRef)
    assert [ref.sequence for ref in refs] == list(range(1, PICTURES + 1))
    assert camera.frames.brightness == sorted(camera.frames.brightness)
    assert len(set(camera.frames.brightness)) == PICTURES
    # Never early: each frame comes no sooner than its time after the first. The delay depends on the machine.
    for index, ref in enumerate(refs):
        assert ref.stamp_ns - refs[0].stamp_ns >= (index / FPS) * 1e9 - 3e6


def test_a_video_waits_for_the_command_to_play(video: Path, start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = start(str(video))
    camera.until(has_state("connected"))
    assert camera.frames.brightness == []
    camera.connection.send(PlayVideo())
    camera.until(has(FrameRef))

    monkeypatch.setattr(camera_process, "PLAY_AFTER_S", 0.05)
    start(str(video)).until(has(FrameRef))


def test_a_looped_video_continues_until_the_console_ends_it(video: Path, start: Start) -> None:
    camera = start(f"{video}?loop")
    camera.until(has_state("connected"))
    camera.connection.send(PlayVideo())
    camera.until(has(FrameRef, 2 * PICTURES + 3))
    brightness = camera.frames.brightness
    assert brightness[PICTURES : PICTURES + 3] == pytest.approx(brightness[:3], abs=2.0)
    camera.close()


@pytest.mark.logs(r"camera_process: camera")
@pytest.mark.parametrize("name", ["missing.mp4", "notes.txt"])
def test_a_file_that_cannot_be_played_is_a_problem(tmp_path: Path, start: Start, name: str) -> None:
    (tmp_path / "notes.txt").write_text("no video")
    camera = start(str(tmp_path / name))
    camera.until(has_state("ended"))
    (problem,) = camera.of(Problem)
    assert problem.severity == "error"
    assert name in problem.what


@pytest.mark.logs(r"camera_process: camera")
def test_an_absent_camera_is_reported_once_and_retried(start: Start, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_process, "_RETRY_AFTER_S", (0.02,))
    attempts = []

    def counting_open(chosen: ChosenCamera) -> CameraSource:
        attempts.append(chosen)
        return open_camera(chosen)

    camera = start("/dev/video97", open_one=counting_open)
    camera.until(has_state("lost"))
    deadline_s = time.monotonic() + 20.0
    while len(attempts) < 4 and time.monotonic() < deadline_s:
        camera.thread.join(0.01)
    assert len(attempts) >= 4
    assert not camera.connection.poll()
    (problem,) = camera.of(Problem)
    assert problem.severity == "warning"
    assert "/dev/video97" in problem.what
    lost = camera.of(CameraState)[-1]
    assert (lost.state, lost.detail, lost.advice) == ("lost", problem.what, problem.advice)


@pytest.mark.logs("cannot be reached")
def test_no_password_of_a_camera_is_logged(
    start: Start, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(camera_process, "_RETRY_AFTER_S", (0.02,))
    tries = threading.Semaphore(0)

    def counting_open(chosen: ChosenCamera) -> CameraSource:
        tries.release()
        return open_camera(chosen)

    camera = start("rtsp://user:sesame@127.0.0.1:9/x", open_one=counting_open)
    camera.until(has_state("lost"))
    assert all(tries.acquire(timeout=20.0) for _ in range(4))
    assert "127.0.0.1 cannot be reached" in caplog.text
    assert "sesame" not in caplog.text
    assert caplog.text.count("cannot be reached") == 1, "the log does not grow while a camera is away"


def test_a_device_delivers_until_it_is_unplugged(video: Path) -> None:
    # OpenCV reads a file through the same calls as a device; its end looks like an unplugged cable.
    camera = DeviceCamera(ChosenCamera("device", str(video), "desk"))
    for _ in range(PICTURES):
        picture = camera.read()
        assert picture is not None
        assert picture.image.shape == (240, 320, 3)
    with pytest.raises(CameraError, match="stopped"):
        camera.read()
    camera.close()


def test_large_pictures_are_made_to_fit_the_ring(tmp_path: Path) -> None:
    path = tmp_path / "large.mp4"
    write_video(path, size_px=(2560, 1440))
    camera = StreamCamera(parse_camera(str(path)))
    picture = camera.read()
    assert picture is not None
    assert picture.image.shape == (camera.height_px, camera.width_px, 3) == (1080, 1920, 3)
    camera.close()


class ToldCamera:
    """Camera double that returns these frames and raises these errors in sequence."""

    width_px, height_px, fps = 64, 48, None

    def __init__(self, told: Iterator[Any]) -> None:
        self._told = told
        self.closed = False

    def read(self) -> Picture | None:
        given = next(self._told)
        if isinstance(given, Exception):
            raise given
        return Picture(given) if isinstance(given, np.ndarray) else given

    def close(self) -> None:
        self.closed = True


GOOD = np.full((48, 64, 3), 77, np.uint8)


def test_any_picture_of_a_camera_is_fitted_or_left_out_with_one_message(start: Start) -> None:
    odd: list[Any] = [
        np.full((1, 1, 3), 9, np.uint8),
        np.full((1, 1, 3), 9, np.uint8),
        np.full((4320, 7680), 200, np.uint8),
        np.full((48, 64), 50 << 8, np.uint16),
        np.full((48, 64, 4), 60, np.uint8),
        PictureError("is damaged"),
        PictureError("is damaged"),
        np.zeros((48, 64, 3), np.float32),
        GOOD,
        None,
    ]
    camera = start("clip.mp4?fast", open_one=lambda _chosen: ToldCamera(iter(odd)))
    camera.until(has_state("connected"))
    camera.connection.send(PlayVideo())
    camera.until(has_state("ended"))
    assert [round(grey) for grey in camera.frames.brightness] == [200, 50, 60, 77]
    assert [(ref.width_px, ref.height_px) for ref in camera.of(FrameRef)] == [(1920, 1080), *[(64, 48)] * 3]
    told = [problem.what for problem in camera.of(Problem)]
    assert len(told) == 3
    assert ["1 x 1" in told[0], "is damaged" in told[1], "float32" in told[2]] == [True] * 3
    assert all(problem.severity == "warning" for problem in camera.of(Problem))


@pytest.mark.logs(r"camera_process: camera")
def test_a_camera_that_sends_nothing_but_waste_is_lost_and_retried(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_process, "_RETRY_AFTER_S", (0.02,))
    rounds = iter([[np.zeros((1, 1, 3), np.uint8)] * 100, [GOOD, GOOD, CameraError("Gone.", "Look.")], []])

    def open_one(_chosen: ChosenCamera) -> CameraSource:
        told = next(rounds, [])
        if not told:
            raise CameraError("Gone.", "Look.")
        return ToldCamera(iter(told))

    camera = start("0", open_one=open_one, name="desk")
    camera.until(has_state("lost", 2))
    assert camera.states() == ["connecting", "lost", "connected", "lost"]
    assert [ref.camera for ref in camera.of(FrameRef)] == ["desk", "desk"]
    assert "desk" in camera.of(Problem)[1].what


def test_a_video_can_be_played_as_fast_as_it_is_read(tmp_path: Path, start: Start) -> None:
    path = tmp_path / "slow.mp4"
    write_video(path, fps=1)
    camera = start(f"{path}?fast")
    camera.connection.send(PlayVideo())
    began_s = time.monotonic()
    camera.until(has_state("ended"))
    assert len(camera.of(FrameRef)) == PICTURES
    assert time.monotonic() - began_s < PICTURES / 2, "at its own rate it takes twice as long"


def test_the_time_of_a_driver_counts_where_it_is_of_the_session_clock(
    start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_ns = clock.now_ns()
    monkeypatch.setattr(camera_source.clock, "now_ns", lambda: now_ns)
    assert picture_of(GOOD, device_ns=now_ns - 30_000_000).taken_ns == now_ns - 30_000_000
    for other_ns in (now_ns + 1, now_ns - 2_000_000_000, 40_000_000, 1_700_000_000_000_000_000):
        assert picture_of(GOOD, device_ns=other_ns).taken_ns is None
    monkeypatch.undo()
    pictures = iter([picture_of(GOOD, device_ns=clock.now_ns() - 20_000_000), Picture(GOOD)])

    class Timed(ToldCamera):
        def read(self) -> Picture | None:
            return next(pictures, None)

    camera = start("clip.mp4?fast", open_one=lambda _chosen: Timed(iter(())))
    camera.connection.send(PlayVideo())
    camera.until(has_state("ended"))
    timed, untimed = camera.of(FrameRef)
    assert timed.taken_ns is not None and timed.stamp_ns - timed.taken_ns >= 20_000_000
    assert (timed.shown_ns, untimed.taken_ns) == (timed.taken_ns, None)


def test_depth_goes_along_with_its_picture_in_few_points(start: Start) -> None:
    depth_mm = np.full((180, 320), 3000, np.uint16)
    depth_mm[:, :160] = 1500
    pictures = iter([Picture(GOOD), Picture(GOOD, depth_mm=depth_mm), Picture(GOOD)])

    class WithDepth(ToldCamera):
        def read(self) -> Picture | None:
            return next(pictures, None)

    camera = start("clip.mp4?fast", open_one=lambda _chosen: WithDepth(iter(())), name="mast")
    camera.connection.send(PlayVideo())
    camera.until(has_state("ended"))
    (grid,) = camera.of(DepthGrid)
    assert (grid.stamp_ns, grid.camera) == (camera.of(FrameRef)[1].stamp_ns, "mast")
    assert grid.depths_mm.shape == (45, 80)
    assert (grid.depths_mm[20, 5], grid.depths_mm[20, 70]) == (1500, 3000)


class HearingCamera:
    """Camera double with sound for each frame."""

    width_px, height_px, fps = 64, 48, None

    def __init__(self) -> None:
        self.on_sound: Callable[[int, Any], None] = lambda _stamp_ns, _samples: None

    def read(self) -> Picture:
        time.sleep(0.005)
        self.on_sound(clock.now_ns(), np.full((320, 1), 7, np.int16))
        return Picture(np.zeros((48, 64, 3), np.uint8))

    def close(self) -> None: ...


def test_a_cameras_microphone_is_heard_only_while_it_is_requested(start: Start) -> None:
    camera = start("0", open_one=lambda _chosen: HearingCamera())
    camera.until(has(FrameRef))
    assert camera.of(AudioChunk) == []
    camera.connection.send(StreamSound(True))
    camera.until(has(AudioChunk))
    chunk = camera.of(AudioChunk)[0]
    assert (chunk.source, chunk.sample_rate_hz, chunk.samples.shape) == ("robot microphone", 16000, (320, 1))
    camera.connection.send(StreamSound(False))
    camera.until(lambda received: all(isinstance(each, FrameRef) for each in received[-5:]))
