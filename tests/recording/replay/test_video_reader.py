"""Frames of a session by time and number, verified by their pixels."""

import json
import random
import shutil
from pathlib import Path

import av
import numpy as np
import pytest

from caris_desktop.domain.sensing import FrameRef
from caris_desktop.recording.recorder.video_writer import FASTEST, VideoFileWriter
from caris_desktop.recording.replay.video_reader import VideoReader
from caris_desktop.recording.session.session_header import SessionClock
from caris_desktop.recording.session.session_reader import open_session
from tests.support.recorded_session import RecordedSession, number_in, picture_of


@pytest.fixture
def folder(whole_session: RecordedSession, tmp_path: Path) -> Path:
    shutil.copytree(whole_session.folder, tmp_path / "session")
    return tmp_path / "session"


def test_the_frame_of_a_moment_is_the_newest_until_then(whole_session: RecordedSession) -> None:
    chosen = random.Random(2)  # noqa: S311 - a test, not cryptography
    with VideoReader(open_session(whole_session.folder)) as videos:
        assert videos.cameras == ("front", "rear")
        for camera in videos.cameras:
            stamps_ns = whole_session.plan.frame_stamps_ns(camera).tolist()
            assert videos.frame_times_ns(camera) == stamps_ns
            refs = [
                value for _, value in whole_session.values if isinstance(value, FrameRef) and value.camera == camera
            ]
            for number in chosen.sample(range(len(stamps_ns) - 1), 25):
                for at_ns in (stamps_ns[number], stamps_ns[number + 1] - 1):
                    found = videos.frame_at(camera, at_ns)
                    assert found is not None
                    assert found.info == videos.info_at(camera, at_ns)
                    assert (found.info.number, found.info.stamp_ns) == (number, stamps_ns[number])
                    assert found.info.robot_stamp_ns == refs[number].robot_stamp_ns
                    assert number_in(found.image_bgr) == number
            assert videos.frame_at(camera, stamps_ns[0] - 1) is None
            last = videos.frame_at(camera, stamps_ns[-1] + 10**12)
            assert last is not None
            assert number_in(last.image_bgr) == len(stamps_ns) - 1
        assert videos.frame_at("no such camera", stamps_ns[0]) is None
        assert videos.problems == []


def test_forwards_backwards_and_by_key_frames(whole_session: RecordedSession) -> None:
    with VideoReader(open_session(whole_session.folder)) as videos:
        count = len(videos.frame_times_ns("front"))
        for numbers in (range(100), range(60, 0, -7), range(0, count, 31)):
            for number in numbers:
                found = videos.frame("front", number)
                assert found is not None
                assert number_in(found.image_bgr) == found.info.number == number
        for number in range(0, count, 5):
            key = videos.frame("front", number, nearest_key=True)
            assert key is not None
            assert number_in(key.image_bgr) == key.info.number <= number
            assert number - key.info.number < 0.5 * whole_session.plan.fps + 1
        assert videos.frame("front", -1) is None
        assert videos.frame("front", count) is None
        stamp_ns = videos.frame_times_ns("front")[100]
        small = videos.thumbnail("front", stamp_ns, 96)
        assert small is not None
        assert small.shape == (54, 96, 3)
        assert 100 - 9 < number_in(small) <= 100
        assert videos.thumbnail("front", 0, 96) is None


def test_several_files_of_a_camera_are_one(folder: Path, whole_session: RecordedSession) -> None:
    """The camera changed its resolution after a pause."""
    session = open_session(folder)
    begin_ns = whole_session.plan.ended_ns + 5 * 10**9
    video = VideoFileWriter(
        folder / "video-front-2.mp4",
        width_px=320,
        height_px=180,
        encoder=FASTEST,
        clock=SessionClock(session.clock.anchor, session.started_ns),
        on_full=lambda: False,
    )
    for number in range(20):
        ref = FrameRef(begin_ns + number * 10**8, None, "front", "ring", 0, number, 320, 180)
        video.write(picture_of(0, 5000 + number, (320, 180)), ref)
    video.close()
    header = json.loads((folder / "session.json").read_text())
    first = next(entry for entry in header["videos"] if entry["camera"] == "front")
    header["videos"].append({**first, "file_name": "video-front-2.mp4", "first_stamp_ns": begin_ns})
    (folder / "session.json").write_text(json.dumps(header))
    with VideoReader(open_session(folder)) as videos:
        before = len(whole_session.plan.frame_stamps_ns("front"))
        assert len(videos.frame_times_ns("front")) == before + 20
        in_pause = videos.frame_at("front", begin_ns - 1)
        assert in_pause is not None
        assert number_in(in_pause.image_bgr) == before - 1
        later = videos.frame_at("front", begin_ns + 10**9)
        assert later is not None
        assert (later.info.number, later.info.file_name) == (before + 10, "video-front-2.mp4")
        assert number_in(later.image_bgr) == 5010
        assert later.image_bgr.shape == (180, 320, 3)


def test_without_side_index_the_times_of_the_video_count(folder: Path, whole_session: RecordedSession) -> None:
    for path in folder.glob("*.frames.csv"):
        path.unlink()
    with VideoReader(open_session(folder)) as videos:
        stamps_ns = whole_session.plan.frame_stamps_ns("rear")
        assert np.abs(np.array(videos.frame_times_ns("rear")) - stamps_ns).max() < 20_000
        found = videos.frame_at("rear", int(stamps_ns[77]) + 10**6)
        assert found is not None
        assert number_in(found.image_bgr) == 77


@pytest.mark.parametrize("indexed", [True, False])
def test_a_video_that_another_program_encoded_again_shows_the_same_frames(
    folder: Path, whole_session: RecordedSession, indexed: bool
) -> None:
    """Most encoders add B frames, which are not stored in the order in which they are shown."""
    path, again = folder / "video-front.mp4", folder / "again.mp4"
    with av.open(str(path)) as old, av.open(str(again), "w") as new:
        stream = new.add_stream("libx264", rate=30, options={"g": "20", "x264-params": "bframes=3:b-adapt=0"})
        stream.width, stream.height = whole_session.plan.size_px
        for frame in old.decode(video=0):
            frame.pict_type = av.video.frame.PictureType.NONE
            new.mux(stream.encode(frame))
        new.mux(stream.encode(None))
    again.replace(path)
    if not indexed:
        (folder / "video-front.frames.csv").unlink()
    stamps_ns = whole_session.plan.frame_stamps_ns("front")
    session = open_session(folder)
    assert not any("cut off" in loss for loss in session.losses)
    with VideoReader(session) as videos:
        assert np.abs(np.array(videos.frame_times_ns("front")) - stamps_ns).max() < 20_000_000
        for number in (50, 7, 21, 8, 40, 39, 99, 19, 20):
            found = videos.frame("front", number)
            assert found is not None
            assert number_in(found.image_bgr) == found.info.number == number
            key = videos.frame("front", number, nearest_key=True)
            assert key is not None
            assert number_in(key.image_bgr) == key.info.number == number // 20 * 20
        assert list(videos.packets("front")) == [], "a topic of such frames cannot be played"
        assert videos.problems == []


def test_a_killed_session_is_seen_without_repair_too(killed_session: RecordedSession) -> None:
    with VideoReader(open_session(killed_session.folder, repair=False)) as videos:
        assert sorted(videos.cameras) == ["front", "rear"]
        for camera in videos.cameras:
            stamps_ns = videos.frame_times_ns(camera)
            assert set(stamps_ns) <= set(killed_session.plan.frame_stamps_ns(camera).tolist())
            last = videos.frame(camera, len(stamps_ns) - 1)
            assert last is not None
            assert number_in(last.image_bgr) == len(stamps_ns) - 1


@pytest.mark.logs(r"replay\.video_reader: ")
def test_missing_and_damaged_videos_are_reported(folder: Path, tmp_path: Path) -> None:
    (folder / "video-front.mp4").write_bytes(b"no video" * 100)
    with VideoReader(open_session(folder)) as videos:
        assert videos.frame("front", 3) is None
        assert videos.frame("rear", 3) is not None
    (folder / "video-front.frames.csv").unlink()
    with VideoReader(open_session(folder)) as videos:
        assert videos.frame_times_ns("front") == []
        assert any("video-front.mp4 cannot be read" in problem for problem in videos.problems)
    (folder / "video-rear.mp4").rename(tmp_path / "outside.mp4")
    (folder / "video-rear.mp4").symlink_to(tmp_path / "outside.mp4")
    header = json.loads((folder / "session.json").read_text())
    header["videos"] += [{"file_name": "../outside.mp4", "camera": "x", "first_stamp_ns": 0}, {"file_name": 3}, None]
    (folder / "session.json").write_text(json.dumps(header))
    with VideoReader(open_session(folder)) as videos:
        assert videos.cameras == ("front",)
        assert sum("is outside the session folder" in problem for problem in videos.problems) == 2
    (folder / "video-front.mp4").unlink()
    with VideoReader(open_session(folder)) as videos:
        assert videos.cameras == ()
        assert "video-front.mp4 is missing." in videos.problems
