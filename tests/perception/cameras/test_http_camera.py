"""Cameras that send JPEGs over HTTP, with small servers in this process."""

import base64
import contextlib
import http.server
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from caris_desktop.domain import clock
from caris_desktop.domain.events import Problem
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.perception.cameras import camera_process, http_camera
from caris_desktop.perception.cameras.camera_process import open_camera
from caris_desktop.perception.cameras.camera_source import CameraError, parse_camera
from caris_desktop.perception.cameras.http_camera import HttpCamera, MultipartReader, RemoteClockEstimate
from caris_desktop.perception.cameras.stream_camera import StreamCamera
from tests.perception.cameras.running_camera import RunningCamera, has_state, write_video


def jpeg(grey: int, *, width_px: int = 320, height_px: int = 240) -> bytes:
    return bytes(cv2.imencode(".jpg", np.full((height_px, width_px, 3), grey, np.uint8))[1].tobytes())


class Served:
    """Scripted answer of a server, and its requests."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.status = 200
        self.content_type = "multipart/x-mixed-replace; boundary=frame"
        self.authorizations: list[str | None] = []
        self.location = ""
        self.port = 0

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.port}/video.mjpg"


@pytest.fixture
def served() -> Iterator[Served]:
    told = Served()

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            told.authorizations.append(self.headers.get("Authorization"))
            self.send_response(told.status)
            self.send_header("Content-Type", told.content_type)
            if told.location:
                self.send_header("Location", told.location)
            self.end_headers()
            with contextlib.suppress(OSError):
                for part in told.parts:
                    self.wfile.write(part)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002 - name in the base class
            pass

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    told.port = server.server_port
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    yield told
    server.shutdown()
    server.server_close()
    thread.join(5.0)


def part(content: bytes, *, head: str = "") -> bytes:
    length = f"Content-Length: {len(content)}\r\n"
    return f"--frame\r\nContent-Type: image/jpeg\r\n{length}{head}\r\n".encode() + content + b"\r\n"


@pytest.mark.logs(r"camera_process: camera")
def test_a_camera_that_breaks_off_is_reported_and_comes_back(
    served: Served, start: Callable[..., RunningCamera], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(camera_process, "_RETRY_AFTER_S", (0.05,))
    served.parts = [part(jpeg(120))] * 30
    camera = start(f"http://wizard:secret@127.0.0.1:{served.port}/video.mjpg")
    camera.until(has_state("connected", 2))
    assert camera.states()[:4] == ["connecting", "connected", "lost", "connected"]
    problem = camera.of(Problem)[0]
    assert "127.0.0.1" in problem.what
    assert "secret" not in repr(camera.received)
    assert camera.of(FrameRef)[0].height_px == 240
    assert served.authorizations[0] == "Basic " + base64.b64encode(b"wizard:secret").decode()


@pytest.mark.logs(r"camera_process: camera")
def test_torn_and_odd_pictures_are_left_out_and_the_others_are_shown(
    served: Served, start: Callable[..., RunningCamera]
) -> None:
    whole = jpeg(200)
    odd = [
        whole[: len(whole) // 2],
        b"no picture",
        jpeg(9, width_px=1, height_px=1),
        jpeg(90, width_px=7680, height_px=4320),
    ]
    served.parts = [part(content) for content in [whole, *odd, whole]]
    # Each of them is processed, as if the network was slower than this computer.
    camera = start(served.address, open_one=OneByOne)
    camera.until(has_state("lost"))
    assert [(ref.width_px, ref.height_px) for ref in camera.of(FrameRef)] == [(320, 240), (1920, 1080), (320, 240)]
    assert len(camera.of(Problem)) == 3, "the torn ones, the one of a single pixel, and the end"


class OneByOne(HttpCamera):
    read_at_most_bytes = 50

    def _more_waits(self) -> bool:
        return False


def test_the_newest_picture_that_has_come_wins(served: Served) -> None:
    served.parts = [part(jpeg(grey)) for grey in range(10, 250, 10)]
    camera = HttpCamera(parse_camera(served.address))
    shown = []
    with pytest.raises(CameraError, match="stopped"):
        while (picture := camera.read()) is not None:
            shown.append(round(float(picture.image.mean())))
    camera.close()
    assert shown == sorted(shown)
    assert shown[-1] == 240


def test_parts_are_distinguished_with_and_without_their_length_however_they_come() -> None:
    contents = [b"first \r\n--other", b"", b"third"]
    with_length = b"preface" + b"".join(part(content) for content in contents)
    without = b"".join(b"--frame\r\nX-A: b\r\n\r\n" + content + b"\r\n" for content in contents) + b"--frame"
    for stream in (with_length, without):
        parts = MultipartReader("frame")
        found = [parts.add(stream[at : at + 1]) for at in range(len(stream))]
        assert [each[1] for each in found if each is not None] == contents
    assert MultipartReader("frame").add(with_length) == (
        {"": "", "content-type": "image/jpeg", "content-length": "5"},
        b"third",
    )
    with pytest.raises(OSError, match="too large"):
        MultipartReader("frame").add(b"--frame\r\nContent-Length: 999999999\r\n\r\n")
    with pytest.raises(OSError, match="unterminated"):
        MultipartReader("frame").add(b"--frame\r\n" + b"a" * 20_000)


def test_a_token_goes_with_the_request_and_its_refusal_is_reported(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PI_CAMERA", "abc")
    served.parts = [part(jpeg(10))]
    HttpCamera(parse_camera(f"{served.address}#token-env=PI_CAMERA")).close()
    assert served.authorizations == ["Bearer abc"]
    served.status = 401
    with pytest.raises(CameraError, match="rejected the token") as caught:
        open_camera(parse_camera(f"{served.address}#token-env=PI_CAMERA"))
    assert "PI_CAMERA" in caught.value.advice


def test_a_video_at_such_an_address_is_played_too(served: Served, tmp_path: Path) -> None:
    path = tmp_path / "walk.ts"
    write_video(path)
    served.content_type = "video/mp2t"
    served.parts = [path.read_bytes()]
    camera = open_camera(parse_camera(served.address))
    picture = camera.read()
    camera.close()
    assert picture is not None and picture.image.shape == (240, 320, 3)


@pytest.mark.parametrize("where", ["/elsewhere", "file:///dev/zero", "//user:sesame@localhost:{port}/x", "/video.mjpg"])
def test_no_redirection_is_followed(served: Served, tmp_path: Path, where: str) -> None:
    """The user has confirmed an address, and no other that its server may name."""
    served.status, served.location = 302, where.format(port=served.port)
    with pytest.raises(CameraError, match="refers to another address") as caught:
        open_camera(parse_camera(served.address))
    assert served.authorizations == [None]
    assert "sesame" not in caught.value.advice
    with pytest.raises(CameraError, match="cannot be reached"):
        StreamCamera(parse_camera(served.address))
    assert served.authorizations == [None, None]


def test_one_that_sends_anything_but_pictures_is_lost(served: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_camera, "_PICTURE_WITHIN_S", 0.05)
    served.parts = [b"no picture, and no end of it " * 1000] * 2000
    with pytest.raises(CameraError, match="stopped"):
        HttpCamera(parse_camera(served.address))


def test_without_aiortc_the_message_names_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "aiortc", None)
    with pytest.raises(CameraError, match="aiortc") as caught:
        open_camera(parse_camera("whep+http://127.0.0.1:9/whep"))
    assert "pip install" in caught.value.advice


def test_a_remote_clock_is_known_best_by_the_quickest_exchange() -> None:
    ahead_ns = 5_000_000_000_000
    here_ns = 1_000_000_000
    ways_ns = iter([(30_000_000, 1_000_000), (1_000_000, 1_000_000), (50_000_000, 2_000_000)])

    def now_ns() -> int:
        return here_ns

    def ask() -> int:
        nonlocal here_ns
        there_ns, back_ns = next(ways_ns)
        here_ns += there_ns
        far_ns = here_ns + ahead_ns
        here_ns += back_ns
        return far_ns

    far = RemoteClockEstimate(ask, now_ns=now_ns)
    assert far.here(5) is None
    for _ in range(3):
        far.measure()
    taken_ns = here_ns - 40_000_000
    found = far.here(taken_ns + ahead_ns)
    assert found is not None
    assert abs(found[0] - taken_ns) <= found[1] < 1_100_000
    assert far.here(7) is None, "a stamp of another clock says nothing"


def test_an_unreachable_server_is_reported() -> None:
    before_ns = clock.now_ns()
    with pytest.raises(CameraError, match="cannot be reached"):
        HttpCamera(parse_camera("http://127.0.0.1:9/video.mjpg"))
    assert clock.now_ns() > before_ns
