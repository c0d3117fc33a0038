"""``caris-desktop camera-server`` as a separate process: light, and compatible with the console's cameras."""

import os
import re
import signal
import socket
import ssl
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import pytest

from caris_desktop.app import command_table
from caris_desktop.domain import clock
from caris_desktop.domain.certificates import fingerprint_of
from caris_desktop.perception.cameras.camera_process import open_camera
from caris_desktop.perception.cameras.camera_source import CameraError, CameraSource, parse_camera
from tests.perception.cameras.running_camera import write_video
from tests.support.certificates import Authority

pytest.importorskip("aiortc")
TOKEN = "0123456789abcdef"
ALLOWED = {
    "caris_desktop", "numpy", "cv2", "av", "platformdirs", "setproctitle",  # the program's own
    "aiortc", "aioice", "pyee", "pylibsrtp", "OpenSSL", "cryptography", "dns", "google_crc32c", "ifaddr", "idna",
    "_cffi_backend", "cffi", "typing_extensions",  # of aiortc
    "_cyutil",  # of av, in some builds
    "_distutils_hack",  # of the installer, in every Python
}  # fmt: skip
PROGRAM = textwrap.dedent("""
    import sys
    from caris_desktop.__main__ import main
    status = main()
    files = {name.partition(".")[0]: getattr(module, "__file__", None) or "" for name, module in sys.modules.items()}
    print("modules:", *sorted(name for name, file in files.items() if "site-packages" in file or name == "PySide6"))
    sys.exit(status)
""")


@dataclass(frozen=True, slots=True)
class Serving:
    """A camera server with a token, and its address."""

    process: "subprocess.Popen[str]"
    address: str

    def open(self, kind: str) -> CameraSource:
        prefix, path = {"mjpeg": ("", "video.mjpg"), "whep": ("whep+", "whep"), "offer": ("webrtc+", "offer")}[kind]
        return open_camera(parse_camera(f"{prefix}{self.address}/{path}#token-env=CAMERA_TOKEN"))


@pytest.fixture(scope="module")
def serving(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Serving]:
    video = tmp_path_factory.mktemp("camera") / "walk.mp4"
    write_video(video)
    words = ["camera-server", "--source", str(video), "--port", "0", "--token-env", "CAMERA_TOKEN"]
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "CAMERA_TOKEN": TOKEN},
    )
    assert process.stdout is not None
    try:
        found = re.search(r"http://127\.0\.0\.1:\d+", process.stdout.readline())
        assert found is not None
        yield Serving(process, found[0])
    finally:
        process.kill()
        process.communicate()


@pytest.fixture(autouse=True)
def _token(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAMERA_TOKEN", TOKEN)


@pytest.mark.parametrize("kind", ["mjpeg", "whep", "offer"])
@pytest.mark.long("whep", "offer")
def test_the_console_sees_its_pictures_and_when_they_were_taken(serving: Serving, kind: str) -> None:
    camera = serving.open(kind)
    try:
        assert (camera.width_px, camera.height_px) == (320, 240)
        greys, taken = [], []
        until_ns = clock.now_ns() + 20_000_000_000
        while len(taken) < 10:
            assert clock.now_ns() < until_ns
            picture = camera.read()
            arrived_ns = clock.now_ns()
            assert picture is not None
            greys.append(round(float(picture.image.mean())))
            if picture.taken_ns is not None:
                assert picture.taken_uncertainty_ns is not None
                # Both run on one computer here, so the clocks are equal.
                assert picture.taken_ns <= arrived_ns
                taken.append(picture.taken_ns)
        assert taken == sorted(taken)
        assert arrived_ns - taken[-1] < 5e9
        assert all(10 <= grey <= 200 for grey in greys) and len(set(greys)) > 3
    finally:
        camera.close()


def test_several_look_at_the_same_time(serving: Serving) -> None:
    cameras = [serving.open("mjpeg"), serving.open("whep"), serving.open("mjpeg")]
    try:
        for _ in range(3):
            assert all(camera.read() is not None for camera in cameras)
    finally:
        for camera in cameras:
            camera.close()


def test_without_its_token_nothing_is_seen(serving: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAMERA_TOKEN", "something else")
    for kind in ("mjpeg", "whep"):
        with pytest.raises(CameraError, match="rejected the token"):
            serving.open(kind)


def test_it_ends_cleanly_and_has_loaded_neither_qt_nor_torch(serving: Serving) -> None:
    """Last test, as it ends the server."""
    serving.process.send_signal(signal.SIGTERM)
    told, errors = serving.process.communicate(timeout=30)
    assert serving.process.returncode == 0, errors
    assert "Traceback" not in errors and "never awaited" not in errors
    (line,) = [line for line in told.splitlines() if line.startswith("modules:")]
    modules = set(line.split()[1:])
    assert {"aiortc", "cv2", "av"} <= modules
    assert modules - ALLOWED == set()


def test_others_are_served_over_tls_and_the_token_goes_to_the_right_one_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A self-signed certificate pinned by its fingerprint; an impostor gets no token."""
    authority = Authority(tmp_path)
    ours, other = authority.issue("127.0.0.1", self_signed=True), authority.issue("127.0.0.1", self_signed=True)
    video = tmp_path / "walk.mp4"
    write_video(video)
    words = ["camera-server", "--source", str(video), "--port", "0", "--token-env", "CAMERA_TOKEN"]
    monkeypatch.setenv("CAMERA_TOKEN", TOKEN)
    files = ["--cert", str(ours.certificate), "--key", str(ours.key)]
    with subprocess.Popen(
        [sys.executable, "-m", "caris_desktop", *words, "--host", "0.0.0.0", *files], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            port = int(process.stdout.readline().split("/video.mjpg")[0].rpartition(":")[2])
            fingerprint, wrong = (
                fingerprint_of(ssl.PEM_cert_to_DER_cert(one.certificate.read_text())) for one in (ours, other)
            )
            address = f"https://127.0.0.1:{port}/video.mjpg#token-env=CAMERA_TOKEN"
            with closing(open_camera(parse_camera(f"{address}&certificate-sha256={fingerprint}"))) as camera:
                assert camera.read() is not None
            for confirmed, message in (
                ("", "is not trusted"),
                (f"&certificate-sha256={wrong}", "does not match the fingerprint"),
            ):
                with pytest.raises(CameraError, match=message) as refused:
                    open_camera(parse_camera(f"{address}{confirmed}"))
                assert bool(confirmed) or fingerprint in refused.value.advice
            with pytest.raises(CameraError):
                open_camera(parse_camera(f"http://127.0.0.1:{port}/video.mjpg#token-env=CAMERA_TOKEN"))
        finally:
            process.terminate()


@pytest.mark.parametrize("scheme", ["http", "whep+http", "webrtc+http"])
def test_a_token_is_not_sent_where_others_read_along(scheme: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def connected(*_arguments: object, **_more: object) -> NoReturn:
        raise AssertionError("somebody was asked")

    monkeypatch.setenv("CAMERA_TOKEN", TOKEN)
    monkeypatch.setattr(socket, "create_connection", connected)
    with pytest.raises(CameraError, match="is not sent: others could read it"):
        open_camera(parse_camera(f"{scheme}://192.0.2.7:8090/whep#token-env=CAMERA_TOKEN"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--source", "0", "--host", "0.0.0.0"], "--token-env"),
        (["--source", "0", "--token-env", "NOT_SET_AT_ALL"], "NOT_SET_AT_ALL"),
        (["--source", "0", "--token-env", "CAMERA_TOKEN", "--host", "0.0.0.0"], "--cert and --key"),
        (["--source", "0", "--cert", "missing.pem"], "must be given together"),
        (["--source", "0", "--cert", "missing.pem", "--key", "missing.pem"], "cannot be used"),
        (["--source", "robot"], "not a camera"),
        (["--source", "missing.mp4"], "missing.mp4"),
        (["--source", "ftp://camera"], "ftp://"),
    ],
)
def test_a_refused_start_is_reported(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAMERA_TOKEN", TOKEN)
    assert command_table.run(["camera-server", *words]) == 2
    assert said in capsys.readouterr().err


def test_the_service_file_starts_it_as_a_user_of_its_own_with_a_token() -> None:
    unit = (Path(__file__).parents[2] / "packaging" / "camera-server.service").read_text(encoding="utf-8")
    assert re.search(r"^ExecStart=\S*caris-desktop camera-server .*--token-env CAMERA_TOKEN", unit, re.MULTILINE)
    assert re.search(r"^EnvironmentFile=", unit, re.MULTILINE)
    assert re.search(r"^(DynamicUser=yes|User=)", unit, re.MULTILINE)
    assert "Restart=on-failure" in unit
