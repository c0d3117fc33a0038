"""Rotation of video files used as cameras."""

import struct
from pathlib import Path

import av
import numpy as np
import pytest

from caris_desktop.perception.cameras.camera_source import CameraError, parse_camera
from caris_desktop.perception.cameras.stream_camera import StreamCamera
from caris_desktop.perception.recorded_video import VideoFile

_ONE = 1 << 16
_MATRICES = {0: (1, 0, 0, 1), 90: (0, 1, -1, 0), 180: (-1, 0, 0, -1), 270: (0, -1, 1, 0)}


def _video(path: Path, clockwise_deg: int) -> Path:
    """Landscape frames with a white upper left corner, and a rotation in the file's metadata."""
    with av.open(str(path), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt = 320, 160, "yuv420p"
        image = np.zeros((160, 320, 3), np.uint8)
        image[:60, :60] = 255
        for _ in range(5):
            for packet in stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    content = bytearray(path.read_bytes())
    at = content.index(b"tkhd") + 4 + 40
    a, b, c, d = (part * _ONE for part in _MATRICES[clockwise_deg])
    content[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(content)
    return path


def test_a_playlist_shows_no_other_file(tmp_path: Path) -> None:
    private = _video(tmp_path / "private.mp4", 0)
    shared = tmp_path / "shared" / "camera.m3u8"
    shared.parent.mkdir()
    shared.write_text(f"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:1,\n{private}\n#EXT-X-ENDLIST\n")
    with pytest.raises(CameraError):
        StreamCamera(parse_camera(str(shared)))


def test_a_file_is_that_of_its_name_and_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _video(tmp_path / "private.mp4", 90)
    (tmp_path / "shared" / "file:..").mkdir(parents=True)
    _video(tmp_path / "shared" / "file:.." / "private.mp4", 0)
    monkeypatch.chdir(tmp_path / "shared")
    camera = StreamCamera(parse_camera("file:../private.mp4"))
    assert (camera.width_px, camera.height_px) == (320, 160)
    camera.close()


@pytest.mark.parametrize(
    ("clockwise_deg", "size_px", "corner"),
    [(0, (320, 160), (0, 0)), (90, (160, 320), (0, -1)), (180, (320, 160), (-1, -1)), (270, (160, 320), (-1, 0))],
)
def test_a_video_is_turned_as_its_file_says(
    tmp_path: Path, clockwise_deg: int, size_px: tuple[int, int], corner: tuple[int, int]
) -> None:
    path = _video(tmp_path / "phone.mp4", clockwise_deg)
    camera = StreamCamera(parse_camera(str(path)))
    picture = camera.read()
    camera.close()
    assert (camera.width_px, camera.height_px) == size_px
    assert picture is not None
    with VideoFile(path) as video:
        _, tracked = next(video.pictures())
    for image in (picture.image, tracked):
        assert image.shape[:2] == (size_px[1], size_px[0])
        assert [at for at in ((0, 0), (0, -1), (-1, 0), (-1, -1)) if image[at].mean() > 128] == [corner]
