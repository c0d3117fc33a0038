"""Video files: names, odd sizes, uneven times, kills, and the index file."""

import csv
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import pytest

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.recording.recorder.video_writer import FASTEST, Encoder, Encoders, VideoFileWriter, works, x264
from caris_desktop.recording.session.media_files import (
    content_of,
    index_lines,
    moments_words,
    read_frame_times,
    video_file_name,
)
from caris_desktop.recording.session.session_header import SessionClock, VideoInfo
from tests.recording.driving import picture
from tests.recording.recorder.test_recorder_process import video_times_s

SECOND = 1_000_000_000
CLOCK = SessionClock(ClockAnchor(monotonic_ns=0, utc_ns=1_795_000_000 * SECOND), started_ns=SECOND)


def write(path: Path, stamps_ms: list[int], *, width_px: int = 64, height_px: int = 48) -> VideoFileWriter:
    video = VideoFileWriter(
        path, width_px=width_px, height_px=height_px, encoder=FASTEST, clock=CLOCK, on_full=lambda: False
    )
    for number, stamp_ms in enumerate(stamps_ms):
        image_bgr = picture(number, width_px=width_px, height_px=height_px)
        robot_stamp_ns = 7 * SECOND + number if number % 2 else None
        stamp_ns = SECOND + stamp_ms * 1_000_000
        video.write(image_bgr, FrameRef(stamp_ns, robot_stamp_ns, "front", "r", 0, 100 + number, width_px, height_px))
    return video


def index_of(video: Path) -> list[dict[str, Any]]:
    with video.with_suffix(".frames.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(
    ("camera", "name"),
    [
        ("front", "video-front.mp4"),
        ("../../etc/passwd", "video-etc-passwd.mp4"),
        ("", "video-camera.mp4"),
        ("..", "video-camera.mp4"),
        ("a/b\\c:d", "video-a-b-c-d.mp4"),
        ("x" * 300, f"video-{'x' * 40}.mp4"),
    ],
)
def test_file_names_stay_in_the_folder(camera: str, name: str) -> None:
    assert video_file_name(camera, set()) == name
    assert video_file_name(camera, {name}) == name.replace(".mp4", "-2.mp4")


def test_uneven_and_equal_times_and_odd_sizes(tmp_path: Path) -> None:
    stamps_ms = [0, 10, 10, 300, 301, 2000, 2600]
    write(tmp_path / "v.mp4", stamps_ms, width_px=65, height_px=47).close()
    times_s, keys_s = video_times_s(tmp_path / "v.mp4")
    assert times_s == pytest.approx([stamp_ms / 1000 for stamp_ms in stamps_ms], abs=0.001)
    assert keys_s == pytest.approx([0.0, 2.0, 2.6])
    with av.open(str(tmp_path / "v.mp4")) as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height, len(stream.index_entries)) == (64, 46, len(stamps_ms))
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert container.duration / av.time_base == pytest.approx(2.6, abs=0.2)


def test_a_closed_video_is_complete_and_an_abandoned_one_lacks_half_a_second_at_most(tmp_path: Path) -> None:
    stamps_ms = list(range(0, 3000, 66))
    write(tmp_path / "closed.mp4", stamps_ms).close()
    write(tmp_path / "abandoned.mp4", stamps_ms).abandon()
    assert len(video_times_s(tmp_path / "closed.mp4")[0]) == len(stamps_ms)
    times_s = video_times_s(tmp_path / "abandoned.mp4")[0]
    assert 0 <= (len(stamps_ms) - len(times_s)) * 0.066 <= 0.5
    assert [float(row["video_s"]) for row in index_of(tmp_path / "abandoned.mp4")] == pytest.approx(times_s, abs=1e-4)


def test_the_index_reports_each_frame_when_it_is_shown_and_when_it_was_taken(tmp_path: Path) -> None:
    stamps_ms = [0, 10, 10, 300, 301, 900, 2000, 2600]
    video = write(tmp_path / "video-front.mp4", stamps_ms)
    # As after a kill: every frame in the video is in the index too.
    with av.open(str(tmp_path / "video-front.mp4")) as container:
        assert sum(1 for _ in container.decode(video=0)) <= len(index_of(video.path))
    assert len(index_of(video.path)) == len(stamps_ms) - 1
    video.close()
    rows = index_of(video.path)
    assert [int(row["frame"]) for row in rows] == list(range(len(stamps_ms)))
    assert [int(row["stamp_ns"]) - SECOND for row in rows] == [stamp_ms * 1_000_000 for stamp_ms in stamps_ms]
    assert [row["robot_stamp_ns"] for row in rows][:3] == ["", "7000000001", ""]
    assert rows[3]["utc"] == CLOCK.utc(SECOND + 300_000_000)
    assert [int(row["sequence"]) for row in rows] == list(range(100, 108))
    assert [float(row["video_s"]) for row in rows] == pytest.approx(video_times_s(video.path)[0], abs=1e-4)
    assert video.frames == len(stamps_ms)
    assert video.lost == 0


def test_frames_are_shown_when_they_were_taken_as_far_as_that_is_known(tmp_path: Path) -> None:
    """Taken every 100 ms with increasing delay; the time of the first one is unknown."""
    path = tmp_path / "video-front.mp4"
    video = VideoFileWriter(path, width_px=64, height_px=48, encoder=FASTEST, clock=CLOCK, on_full=lambda: False)
    taken_ms, came_ms = [None, 100, 200, 300, 400], [80, 140, 260, 380, 500]
    for number, (taken, came) in enumerate(zip(taken_ms, came_ms, strict=True)):
        ref = FrameRef(SECOND + came * 1_000_000, 5, "front", "r", 0, number, 64, 48)
        if taken is not None:
            ref = replace(ref, taken_ns=SECOND + taken * 1_000_000, taken_uncertainty_ns=1_000_000 + number * 100_000)
        video.write(picture(number, width_px=64, height_px=48), ref)
    video.close()
    assert video.first_stamp_ns == SECOND + 80_000_000
    assert video.last_stamp_ns == SECOND + 400_000_000
    assert video_times_s(path)[0] == pytest.approx([0.0, 0.02, 0.12, 0.22, 0.32], abs=1e-3)
    assert (video.info("front").delay_ms, video.info("front").uncertainty_ms) == (70.0, 1.4)
    rows = index_of(path)
    assert [row["taken_ns"] for row in rows] == ["", *(str(SECOND + ms * 1_000_000) for ms in (100, 200, 300, 400))]
    assert [row["uncertainty_ms"] for row in rows] == ["", "1.100", "1.200", "1.300", "1.400"]
    assert rows[2]["taken_utc"] == CLOCK.utc(SECOND + 200_000_000)
    times = read_frame_times(path.with_suffix(".frames.csv"))
    assert (times.shown_ns - SECOND).tolist() == [ms * 1_000_000 for ms in (80, 100, 200, 300, 400)]
    assert (times.delay_ms, times.worst_uncertainty_ms) == (70.0, 1.4)


def test_a_lost_index_is_made_again_with_the_moments_of_the_record(tmp_path: Path) -> None:
    path = tmp_path / "video-front.mp4"
    video = VideoFileWriter(path, width_px=64, height_px=48, encoder=FASTEST, clock=CLOCK, on_full=lambda: False)
    refs = []
    for number in range(6):
        taken_ns = SECOND + number * 100_000_000
        came_ns = taken_ns + 40_000_000 + number % 3 * 50_000_000
        refs.append(FrameRef(came_ns, 5, "front", "r", 0, number, 64, 48, taken_ns, 1_000_000))
        video.write(picture(number, width_px=64, height_px=48), refs[-1])
    video.close()
    index = path.with_suffix(".frames.csv")
    whole = index.read_bytes()
    content = content_of(path)
    assert content is not None
    for kept in (0, 1, 3):
        index.write_bytes(b"".join(whole.splitlines(keepends=True)[: kept + 1]))
        lines = index_lines(path, content, refs, CLOCK)
        assert lines is not None
        index.write_bytes(lines)
        times = read_frame_times(index)
        assert times.taken_ns.tolist() == [ref.taken_ns for ref in refs]
        assert times.stamps_ns.tolist() == [ref.stamp_ns for ref in refs]


def test_an_index_of_before_reports_when_frames_came(tmp_path: Path) -> None:
    index = tmp_path / "video-front.frames.csv"
    index.write_text("frame,video_s,stamp_ns,robot_stamp_ns,utc,sequence\n0,0.0,1000,7,x,1\n1,0.1,2000,,x,2\n")
    times = read_frame_times(index)
    assert times.shown_ns.tolist() == times.stamps_ns.tolist() == [1000, 2000]
    assert (times.delay_ms, times.worst_uncertainty_ms) == (None, None)
    assert "capture time is unknown" in moments_words(VideoInfo("video-front.mp4", "front"))
    assert "accurate to 1.4 ms; they reached the computer 70 ms later" in moments_words(
        VideoInfo("video-front.mp4", "front", delay_ms=70.0, uncertainty_ms=1.4)
    )


def test_an_encoder_is_used_only_if_it_really_makes_a_video() -> None:
    assert works(FASTEST)
    assert works(x264("veryfast"))
    assert not works(Encoder("h264_of_another_world", ()))
    # It works, but delays frames, which a kill would lose.
    assert not works(Encoder("libx264", (("preset", "medium"), ("rc-lookahead", "40"))))
    encoders = Encoders((Encoder("h264_of_another_world", ()), FASTEST))
    encoders.probe()
    assert encoders.choose(64, 48, fast=True) == (FASTEST,)


def test_an_encoder_that_failed_is_not_chosen_again() -> None:
    card = Encoder("libx264", (("preset", "ultrafast"), ("tune", "zerolatency")), title="a card")
    encoders = Encoders((card,))
    encoders.probe()
    assert encoders.choose(64, 48, fast=True) == (card, FASTEST)
    encoders.note_failure(card)
    assert encoders.choose(64, 48, fast=True) == (FASTEST,)


def test_a_file_that_no_encoder_opens_leaves_nothing_behind(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="another_world"):
        VideoFileWriter(
            tmp_path / "v.mp4",
            width_px=64,
            height_px=48,
            encoder=Encoder("h264_of_another_world", ()),
            clock=CLOCK,
            on_full=lambda: False,
        )
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("share", [0.25, 0.5, 0.9])
def test_a_closed_video_that_was_cut_shows_what_is_left_of_it(tmp_path: Path, share: float) -> None:
    stamps_ms = list(range(0, 6000, 66))
    video = tmp_path / "v.mp4"
    write(video, stamps_ms).close()
    content = video.read_bytes()
    video.write_bytes(content[: int(len(content) * share)])
    found = content_of(video)
    assert found is not None
    assert found.times_s == pytest.approx([ms / 1000 for ms in stamps_ms[: len(found.times_s)]], abs=0.001)
    assert share - 0.15 < len(found.times_s) / len(stamps_ms) < share + 0.1
    with av.open(str(video)) as container:
        shown = [frame for _, frame in zip(range(len(found.times_s)), container.decode(video=0), strict=False)]
    assert len(shown) == len(found.times_s)


def test_seeking_lands_where_asked(tmp_path: Path) -> None:
    write(tmp_path / "v.mp4", list(range(0, 6000, 66))).close()
    with av.open(str(tmp_path / "v.mp4")) as container:
        stream = container.streams.video[0]
        container.seek(int(Fraction(4) / stream.time_base), stream=stream)
        frame = next(container.decode(stream))
        assert 3.5 <= frame.time <= 4.0
