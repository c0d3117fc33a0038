"""Foreign images and videos: format and size are checked before decoding."""

import zlib
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from caris_desktop.domain.media_checks import FILM_OPTIONS, PictureError, decode_compressed, decoded
from caris_desktop.perception.backends import remote_detector
from caris_desktop.perception.recorded_video import VideoFile, VideoFileError
from caris_desktop.recording.exporters import html
from caris_desktop.recording.foreign import bag_values
from caris_desktop.recording.forgetting.media import UnreadableMediaError, covered_picture
from caris_desktop.recording.photo_file import PhotoFileError, previews
from caris_desktop.recording.replay.video_reader import _Video
from caris_desktop.ros.message_fields import MessageError
from caris_desktop.ui.widgets.pictures import image_of

WHOLE = np.full((48, 64, 3), 90, np.uint8)


def coded(ending: str) -> bytes:
    done, content = cv2.imencode(ending, WHOLE)
    assert done
    return bytes(content.tobytes())


def claiming(content: bytes, width_px: int, height_px: int) -> bytes:
    """The same file with another size in its header."""
    changed = bytearray(content)
    if content[:2] == b"\xff\xd8":
        at = next(at for at in range(2, len(content)) if content[at : at + 2] in (b"\xff\xc0", b"\xff\xc2"))
        changed[at + 5 : at + 9] = height_px.to_bytes(2) + width_px.to_bytes(2)
    else:
        changed[16:24] = width_px.to_bytes(4) + height_px.to_bytes(4)
    return bytes(changed)


def with_chunk(length: int, kind: bytes, data: bytes = b"") -> bytes:
    """A PNG with an additional chunk after its header, with a right or wrong length."""
    content = coded(".png")
    return content[:33] + length.to_bytes(4) + kind + data + zlib.crc32(kind + data).to_bytes(4) + content[33:]


HOSTILE = {
    "a chunk of gigabytes": with_chunk(0x98002000, b"IDAT"),
    "a second head": with_chunk(13, b"IHDR", (60_000).to_bytes(4) * 2 + b"\x08\x02\0\0\0"),
    "a torn png": coded(".png")[:-20],
    "webp": coded(".webp"),
    "bmp": coded(".bmp"),
    "tiff": coded(".tiff"),
    "pnm": coded(".ppm"),
    "svg": b'<svg xmlns="http://www.w3.org/2000/svg"><image href="file:///etc/passwd"/></svg>',
    "gif": b"GIF89a" + bytes(40),
    "hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 60000 +X 60000\n",
    "a large png": claiming(coded(".png"), 60_000, 60_000),
    "a large jpeg": claiming(coded(".jpg"), 65_000, 65_000),
    "a jpeg of no size": claiming(coded(".jpg"), 0, 10),
    "a png in disguise": b"\x89PNG\r\n\x1a\n" + coded(".webp"),
    "a jpeg in disguise": b"\xff\xd8" + coded(".webp"),
    "nothing": b"",
}


def in_file(content: bytes, folder: Path) -> Path:
    path = folder / "photo.png"
    path.write_bytes(content)
    return path


def refused_by_erasure(content: bytes, folder: Path) -> None:
    with pytest.raises(UnreadableMediaError):
        covered_picture(in_file(content, folder), folder / "new.png", [])


def refused_by_photos(content: bytes, folder: Path) -> None:
    with pytest.raises(PhotoFileError):
        previews(in_file(content, folder), 100)


def refused_by_pages(content: bytes, folder: Path) -> None:
    assert html._thumbnail(folder, in_file(content, folder).name) == ""


def refused_by_bags(content: bytes, _folder: Path) -> None:
    with pytest.raises(MessageError):
        bag_values._decoded_image(content)


def refused_by_robots_and_cameras(content: bytes, _folder: Path) -> None:
    with pytest.raises(PictureError):
        decode_compressed(content)


def refused_by_the_detector(content: bytes, _folder: Path) -> None:
    assert "error" in remote_detector._answer_request(None, content)  # type: ignore[arg-type]


def refused_by_the_window(content: bytes, _folder: Path) -> None:
    assert image_of(content).isNull()


PLACES: tuple[Callable[[bytes, Path], None], ...] = (
    refused_by_erasure, refused_by_photos, refused_by_pages, refused_by_bags, refused_by_robots_and_cameras,
    refused_by_the_detector, refused_by_the_window,
)  # fmt: skip


@pytest.mark.logs("cannot be read")
@pytest.mark.parametrize("kind", HOSTILE)
def test_nothing_but_a_jpeg_or_png_of_a_size_that_fits_reaches_a_decoder(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def reached(*_: object) -> None:
        raise AssertionError("it was decoded")

    monkeypatch.setattr(cv2, "imdecode", reached)
    for refused in PLACES:
        refused(HOSTILE[kind], tmp_path)


@pytest.mark.parametrize("ending", [".jpg", ".png"])
def test_complete_pictures_are_shown_everywhere(ending: str, tmp_path: Path) -> None:
    content = coded(ending)
    assert decoded(content).shape == (48, 64, 3)
    assert decode_compressed(content).shape == (48, 64, 3)
    assert (image_of(content).width(), image_of(content).height()) == (64, 48)
    assert previews(in_file(content, tmp_path), 100)
    assert bag_values._decoded_image(content).shape == (48, 64, 3)
    padded = content[:2] + b"\xff\xff\xff" + content[2:] if ending == ".jpg" else content
    assert decoded(padded).shape == (48, 64, 3), "a JPEG may have fill bytes before its markers"


def film(path: Path) -> Path:
    with av.open(str(path), "w", format="mp4") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for _ in range(5):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(WHOLE, format="bgr24")))
        container.mux(stream.encode())
    return path


@pytest.mark.logs("cannot be read|could not open")
def test_a_playlist_that_calls_itself_a_film_leads_to_no_other_file(tmp_path: Path) -> None:
    private = film(tmp_path / "private.mp4")
    with av.open(str(private), options=FILM_OPTIONS) as container:
        assert sum(1 for _ in container.decode(video=0)) == 5
    for number, playlist in enumerate((
        f"ffconcat version 1.0\nfile '{private.name}'\n",
        f"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:1,\n{private}\n#EXT-X-ENDLIST\n",
        "v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video 5004 RTP/AVP 96\n",
    )):  # fmt: skip
        path = tmp_path / f"camera{number}.mp4"
        path.write_text(playlist)
        reader = _Video(path, 0, None)
        assert list(reader.packets()) == []
        reader.close()
        with pytest.raises(VideoFileError):
            VideoFile(path)
