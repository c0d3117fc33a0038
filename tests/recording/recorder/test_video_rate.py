"""Overloaded machine: frames are dropped evenly, reported once, counted, and recorded again later."""

import itertools
import json
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from caris_desktop.domain import clock
from caris_desktop.domain.events import Gap, Problem
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.live.frame_ring import FrameRing
from caris_desktop.recording.recorder import media_writer, video_writer
from caris_desktop.recording.recorder.media_writer import VideoRate
from caris_desktop.recording.recorder.recorder_messages import RecorderReport
from caris_desktop.recording.session.session_reader import open_session
from tests.recording.driving import RecorderUnderTest, mark, picture, start
from tests.recording.recorder.test_recorder_process import video_times_s

SECOND = 1_000_000_000


def encode(rate: VideoRate, seconds: float, *, took_s: float, at_ns: int = 0) -> tuple[list[int], int]:
    """Camera with 30 Hz and an encoder with this time per frame: the steps, and the final time."""
    steps, free_ns, now_ns = [rate.step], at_ns, at_ns
    for number in range(int(seconds * 30)):
        now_ns = at_ns + number * SECOND // 30
        if not rate.wants():
            continue
        free_ns = max(free_ns, now_ns) + int(took_s * SECOND)
        if rate.observe(free_ns, waited_s=(free_ns - now_ns) / SECOND - took_s, took_s=took_s):
            steps.append(rate.step)
    return steps, max(now_ns, free_ns)


def test_an_encoder_in_time_gets_every_frame() -> None:
    assert encode(VideoRate(), 60, took_s=0.03)[0] == [1]


def test_half_or_a_quarter_of_the_frames_is_what_a_slow_encoder_gets() -> None:
    assert encode(VideoRate(), 60, took_s=0.05)[0] == [1, 2]
    assert encode(VideoRate(), 60, took_s=0.1)[0] == [1, 2, 4]


def test_the_frames_come_back_when_there_is_time_for_them() -> None:
    rate = VideoRate()
    _, at_ns = encode(rate, 20, took_s=0.1)
    assert rate.step == 4
    steps, _ = encode(rate, 60, took_s=0.01, at_ns=at_ns)
    assert steps == [4, 2, 1]


def test_a_machine_at_its_limit_is_not_asked_again_and_again() -> None:
    rate = VideoRate()
    changes = 0
    _, at_ns = encode(rate, 10, took_s=0.05)
    for second in itertools.takewhile(lambda second: second < 300, itertools.count(0, 10)):
        # Each return to all frames causes overload again.
        steps, at_ns = encode(rate, 10, took_s=0.05 if rate.step == 1 else 0.01, at_ns=at_ns)
        changes += len(steps) - 1
        assert second < 300
    assert changes <= 12


def test_an_outer_limit_holds_for_any_encoder() -> None:
    rate = VideoRate()
    rate.least_step = 2
    assert [rate.wants() for _ in range(6)] == [False, True] * 3
    rate.least_step = 1
    assert all(rate.wants() for _ in range(6))


def test_when_no_more_frames_can_wait_nobody_waits_a_second() -> None:
    rate = VideoRate()
    assert rate.observe(10 * SECOND, waited_s=0.2, took_s=0.05, crowded=True) == "lowered"
    assert rate.observe(10 * SECOND + 1, waited_s=0.2, took_s=0.05, crowded=True) == ""


@pytest.fixture
def slow_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Encoding takes 70 ms for each of the first frames, the timeout is 1.5 s, and the encoder is the fastest."""
    write = video_writer.VideoFileWriter.write
    left = itertools.count(36, -1)

    def write_slowly(self: video_writer.VideoFileWriter, image_bgr: np.ndarray, ref: FrameRef) -> None:
        if next(left) > 0:
            time.sleep(0.07)
        write(self, image_bgr, ref)

    monkeypatch.setattr(video_writer.VideoFileWriter, "write", write_slowly)
    monkeypatch.setattr(media_writer, "_CALM_NS", 1_500_000_000)
    monkeypatch.setattr(video_writer, "_SHARE_OF_IDLE", 0.0)


@pytest.fixture
def ring() -> Iterator[FrameRing]:
    ring = FrameRing.create(640 * 480 * 3)
    yield ring
    ring.close()


@pytest.mark.logs(r"recorder\.session_recorder: ")
@pytest.mark.usefixtures("slow_machine")
@pytest.mark.long
def test_a_machine_that_cannot_keep_up_leaves_out_frames_evenly_and_reports_it_once(
    tmp_path: Path, ring: FrameRing
) -> None:
    recorder = RecorderUnderTest(ring, in_thread=True)
    recorder.send(start(tmp_path / "s"))
    recorder.wait_for(RecorderReport)
    sent, deadline, details = 0, time.monotonic() + 40, set()
    while time.monotonic() < deadline:
        recorder.send(ring.write(picture(sent), stamp_ns=clock.now_ns(), robot_stamp_ns=None, camera="front"))
        recorder.send(mark(str(sent)))
        sent += 1
        recorder.drain()
        details |= {message.detail for message in recorder.heard if isinstance(message, RecorderReport)}
        if len(details) > 1 and lately_whole(recorder):
            break
        time.sleep(1 / 30)
    recorder.stop_session()
    recorder.close()
    assert "front: every second frame is recorded" in details
    (problem,) = [message for message in recorder.heard if isinstance(message, Problem)]
    assert problem.what == "This computer cannot keep up with the video of front."
    head = json.loads((tmp_path / "s" / "session.json").read_text())
    frames = sum(video["frames"] for video in head["videos"])
    assert frames + head["dropped"]["frame"] == sent
    assert sum(video["left_out"] for video in head["videos"]) > 0
    assert frames == sum(len(video_times_s(tmp_path / "s" / video["file_name"])[0]) for video in head["videos"])
    session = open_session(tmp_path / "s")
    gaps = [value for _, value in session.values("event/gap")]
    assert all(isinstance(gap, Gap) and gap.stream == "frame" for gap in gaps)
    assert sum(gap.count for gap in gaps) == head["dropped"]["frame"]
    # Events are never lost, whatever happens to the video.
    assert head["counts"]["event/marked"] == sent


def lately_whole(recorder: RecorderUnderTest) -> bool:
    """True if every frame is recorded again."""
    return [message.detail for message in recorder.heard if isinstance(message, RecorderReport)][-1] == ""
