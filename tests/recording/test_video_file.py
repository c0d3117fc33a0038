"""Video files: names, odd sizes, uneven times, and a kill in the middle."""

from fractions import Fraction
from pathlib import Path

import av
import pytest

from caris_desktop.recording.video_file import VideoFile, video_file_name
from tests.recording.driving import picture
from tests.recording.test_recorder_process import video_times_s


def write(path: Path, stamps_ms: list[int], *, width_px: int = 64, height_px: int = 48) -> VideoFile:
    video = VideoFile(path, width_px=width_px, height_px=height_px, on_full=lambda: False)
    for number, stamp_ms in enumerate(stamps_ms):
        image_bgr = picture(number, width_px=width_px, height_px=height_px)
        video.write(image_bgr, stamp_ns=1_000_000_000 + stamp_ms * 1_000_000)
    return video


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
        assert (stream.width, stream.height, stream.frames) == (64, 46, len(stamps_ms))
        assert stream.codec_context.pix_fmt == "yuv420p"
        assert container.duration / av.time_base == pytest.approx(2.6, abs=0.2)


def test_a_closed_video_is_an_ordinary_mp4_and_an_abandoned_one_is_readable(tmp_path: Path) -> None:
    stamps_ms = list(range(0, 3000, 66))
    write(tmp_path / "closed.mp4", stamps_ms).close()
    write(tmp_path / "abandoned.mp4", stamps_ms).abandon()
    assert b"moof" not in boxes(tmp_path / "closed.mp4")
    assert b"moof" in boxes(tmp_path / "abandoned.mp4")
    assert len(video_times_s(tmp_path / "closed.mp4")[0]) == len(stamps_ms)
    lost = len(stamps_ms) - len(video_times_s(tmp_path / "abandoned.mp4")[0])
    assert 0 <= lost * 0.066 <= 0.5


def boxes(path: Path) -> set[bytes]:
    data, offset, found = path.read_bytes(), 0, set()
    while offset + 8 <= len(data):
        size = int.from_bytes(data[offset : offset + 4], "big")
        if size == 1:
            size = int.from_bytes(data[offset + 8 : offset + 16], "big")
        found.add(data[offset + 4 : offset + 8])
        offset += size
    return found


def test_seeking_lands_where_asked(tmp_path: Path) -> None:
    write(tmp_path / "v.mp4", list(range(0, 6000, 66))).close()
    with av.open(str(tmp_path / "v.mp4")) as container:
        stream = container.streams.video[0]
        container.seek(int(Fraction(4) / stream.time_base), stream=stream)
        frame = next(container.decode(stream))
        assert 3.5 <= frame.time <= 4.0
