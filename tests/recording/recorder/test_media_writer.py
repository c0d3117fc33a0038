"""Encoders that fail or hang, and a recorder that falls behind."""

import time
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from caris_desktop.domain import clock
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import Problem
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.live.frame_ring import FrameRings
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.recorder.disk_watch import DiskLimits
from caris_desktop.recording.recorder.media_writer import MediaFailed, MediaWriter
from caris_desktop.recording.recorder.session_recorder import SessionRecorder
from caris_desktop.recording.recorder.video_writer import Encoder, Encoders, VideoFileWriter
from caris_desktop.recording.session.session_header import SessionClock
from tests.recording.driving import mark, picture, start
from tests.recording.recorder.test_recorder_process import video_times_s

CARD = Encoder("libx264", (("preset", "ultrafast"), ("tune", "zerolatency")), title="a card")


class HungStream:
    """Double of PyAV's stream."""

    time_base = Fraction(1, 90_000)

    def encode(self, _frame: object) -> list[object]:
        raise OSError(5, "the card hangs")


def record(folder: Path, cameras: tuple[str, ...], frames: int) -> tuple[MediaWriter, list[MediaFailed]]:
    encoders = Encoders((CARD,))
    encoders.probe()
    writer = MediaWriter(folder, SessionClock(ClockAnchor(0, 0), 0), encoders, on_full=lambda: False)
    for number in range(frames):
        for camera in cameras:
            assert writer.wants(camera)
            ref = FrameRef(number * 50_000_000, None, camera, "ring", 0, number, 64, 48)
            assert writer.add_frame(ref, picture(number, width_px=64, height_px=48))
    writer.close(timeout_s=20)
    return writer, [result for result in writer.results() if isinstance(result, MediaFailed)]


@pytest.mark.logs(r"recorder\.media_writer: ")
def test_an_encoder_that_fails_midway_costs_a_moment_and_not_the_video(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = VideoFileWriter.write

    def fail_at_fifteen(self: VideoFileWriter, image_bgr: np.ndarray, ref: FrameRef) -> None:
        if self.encoder == CARD and ref.sequence == 15:
            self._stream = HungStream()
        write(self, image_bgr, ref)

    monkeypatch.setattr(VideoFileWriter, "write", fail_at_fifteen)
    writer, failures = record(tmp_path, ("front",), 30)
    first, second = writer.infos()
    assert first.encoder == "a card"
    assert second.encoder.startswith("libx264 "), "whichever preset this machine keeps up with"
    assert first.file_name == "video-front.mp4"
    assert second.file_name == "video-front-2.mp4"
    assert second.frames == 14
    assert len(video_times_s(tmp_path / first.file_name)[0]) == first.frames
    (failure,) = failures
    assert failure.kind == "encoder"
    assert first.frames + failure.lost + second.frames == 30
    assert len((tmp_path / first.index_file).read_text().splitlines()) == 1 + first.frames


@pytest.mark.logs(r"recorder\.media_writer: ")
def test_a_disk_that_takes_no_more_pictures_has_no_lines_for_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = DiskFile.write

    def fill(self: DiskFile, data: bytes) -> int:
        if self.path.suffix == ".mp4" and self.size_bytes > 5000:
            raise OSError(28, "No space left on device")
        return write(self, data)

    monkeypatch.setattr(DiskFile, "write", fill)
    writer, failures = record(tmp_path, ("front",), 40)
    (info,) = writer.infos()
    assert failures[0].disk_full
    assert 0 < info.frames == len(video_times_s(tmp_path / info.file_name)[0])
    assert len((tmp_path / info.index_file).read_text().splitlines()) == 1 + info.frames
    assert info.frames + sum(failure.lost for failure in failures) == 40


@pytest.mark.logs(r"recorder\.media_writer: ")
def test_with_one_hardware_encoder_the_other_camera_gets_the_processor(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[str] = []
    begin = VideoFileWriter.__init__

    def open_once(self: VideoFileWriter, path: Path, *, encoder: Encoder, **options: object) -> None:
        if encoder == CARD:
            if opened:
                raise OSError(12, "no session left")
            opened.append(path.name)
        begin(self, path, encoder=encoder, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(VideoFileWriter, "__init__", open_once)
    writer, failures = record(tmp_path, ("front", "side"), 5)
    assert not failures
    assert {info.encoder == "a card" for info in writer.infos()} == {True, False}
    assert [info.frames for info in writer.infos()] == [5, 5]


@pytest.mark.logs(r"recorder\.session_recorder: ")
def test_a_recorder_that_is_behind_says_so_once(tmp_path: Path) -> None:
    reports: list[object] = []
    recorder = SessionRecorder(
        start(tmp_path / "s"), frames=FrameRings(()), report=reports.append, limits=DiskLimits(reserve_bytes=4096)
    )
    for _ in range(2):
        recorder.write(mark("late"), clock.now_ns() - 3_000_000_000)
        time.sleep(0.5)  # the next check of the disk is due by then
        recorder.tick()
    assert "the recorder is behind" in recorder.status().detail
    recorder.close("wizard")
    (problem,) = [event for event in reports if isinstance(event, Problem)]
    assert problem.what == "The recording is 3.0 s behind."
