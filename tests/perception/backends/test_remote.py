"""Detector on another machine over loopback: boxes, authorised clients, and failures."""

import ssl
import threading
from collections.abc import Iterator
from http import HTTPStatus
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from websockets.http11 import Request, Response
from websockets.sync.client import connect
from websockets.sync.server import ServerConnection, serve

from caris_desktop.perception.backends import remote_detector
from caris_desktop.perception.backends.remote_detector import SERVER_VARIABLE, TOKEN_VARIABLE, RemoteDetector
from caris_desktop.perception.backends.runtime_selection import open_chosen
from caris_desktop.perception.detector import Detections, DetectorAwayError
from caris_desktop.perception.inference_messages import DetectorSettings
from caris_desktop.perception.weights import WeightsError
from tests.perception.served import POINTS, TOKEN, Serving, picture
from tests.support.certificates import Authority


@pytest.fixture
def server() -> Iterator[Serving]:
    running = Serving()
    yield running
    running.stop()


@pytest.fixture
def guarded() -> Iterator[Serving]:
    running = Serving(TOKEN)
    yield running
    running.stop()


def test_it_finds_what_the_other_machine_finds(server: Serving) -> None:
    detector = RemoteDetector(server.address, confidence=0.1)
    try:
        assert detector.label == f"bright, torch on CUDA, on 127.0.0.1:{server.port}"
        assert (detector.class_names, detector.people) == (("chair", "person"), (1,))
        for _ in range(3):
            found = detector.detect(picture())
            assert found.classes.tolist() == [1, 0]
            # JPEG blurs an edge by a pixel or two.
            np.testing.assert_allclose(found.corners_px[0], [40, 30, 80, 60], atol=3)
            np.testing.assert_allclose(found.confidences, [0.8, 0.15])
            assert found.keypoints is not None
            np.testing.assert_allclose(found.keypoints[0], POINTS[0])
        assert detector.detect(np.zeros((0, 0, 3), np.uint8)).corners_px.shape == (0, 4)
    finally:
        detector.close()


def test_detections_below_the_requested_confidence_are_left_out(server: Serving) -> None:
    detector = RemoteDetector(server.address, confidence=0.2)
    assert detector.detect(picture()).classes.tolist() == [1]
    detector.close()


def test_a_large_picture_travels_smaller_and_its_boxes_do_not(server: Serving) -> None:
    detector = RemoteDetector(server.address, confidence=0.1)
    found = detector.detect(picture(2160, 3840))
    detector.close()
    assert server.detector.sizes == [(720, 1280, 3)]
    np.testing.assert_allclose(found.corners_px[0], [960, 540, 1920, 1080], atol=9)
    assert found.keypoints is not None
    np.testing.assert_allclose(found.keypoints[0, :, :2], POINTS[0, :, :2] * 3)
    np.testing.assert_allclose(found.keypoints[0, :, 2], POINTS[0, :, 2])


def test_only_who_knows_the_token_is_answered(guarded: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(SERVER_VARIABLE, guarded.address)
    for token in (None, "another token of enough characters"):
        monkeypatch.delenv(TOKEN_VARIABLE, raising=False)
        if token is not None:
            monkeypatch.setenv(TOKEN_VARIABLE, token)
        with pytest.raises(DetectorAwayError, match="rejected the token"):
            RemoteDetector(guarded.address, confidence=0.1)
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    detector = RemoteDetector(guarded.address, confidence=0.1)
    assert len(detector.detect(picture()).confidences) == 2
    detector.close()
    assert TOKEN not in "".join(guarded.notes)


def test_the_token_goes_to_no_server_that_only_a_scenario_names(
    guarded: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(TOKEN_VARIABLE, TOKEN)
    for server in (
        "",
        "wss://lab.example:8768",
        guarded.address.replace("127.0.0.1", "localhost"),
        "[::",
        "ws://127.0.0.1",
    ):
        monkeypatch.setenv(SERVER_VARIABLE, server)
        with pytest.raises(DetectorAwayError, match="rejected the token"):
            RemoteDetector(guarded.address, confidence=0.1)


@pytest.mark.logs("could not be looked at", "opening handshake failed")
def test_a_page_in_a_browser_and_what_is_no_picture_are_turned_away(server: Serving) -> None:
    with pytest.raises(Exception, match="403"), connect(server.address, origin="https://example.org"):  # type: ignore[arg-type]
        pass
    with connect(server.address) as client:
        assert '"caris_perception": 1' in str(client.recv())
        dark = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
        for message in ("words", b"", b"no picture at all", dark):
            client.send(message)
            assert '"error"' in str(client.recv(timeout=20))
        client.send(cv2.imencode(".jpg", picture())[1].tobytes())
        assert '"boxes"' in str(client.recv(timeout=20))


@pytest.mark.logs("could not be looked at")
def test_a_server_that_goes_is_reported_and_found_again(server: Serving) -> None:
    now = [0.0]
    detector = RemoteDetector(server.address, confidence=0.1, monotonic_s=lambda: now[0])
    detector.detect(picture())
    server.stop()
    for _ in range(2):
        with pytest.raises(DetectorAwayError, match="does not respond"):
            detector.detect(picture())
    now[0] += 10.0
    with pytest.raises(DetectorAwayError, match="does not respond"):
        detector.detect(picture())
    server.start()
    with pytest.raises(DetectorAwayError, match="does not respond"):
        detector.detect(picture())
    now[0] += 10.0
    assert len(detector.detect(picture()).confidences) == 2
    with pytest.raises(DetectorAwayError, match=r"The response from .* cannot be read"):
        detector.detect(np.zeros((8, 8, 3), np.uint8))
    detector.close()


def test_a_late_answer_is_not_taken_for_that_to_another_picture(
    server: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, released, found = [0.0], threading.Event(), server.detector.detect
    detector = RemoteDetector(server.address, confidence=0.1, answer_within_s=0.2, monotonic_s=lambda: now[0])

    def slow(image_bgr: NDArray[np.uint8]) -> Detections:
        released.wait(20)
        return found(image_bgr)

    monkeypatch.setattr(server.detector, "detect", slow)
    with pytest.raises(DetectorAwayError, match="does not respond"):
        detector.detect(picture())
    released.set()
    monkeypatch.setattr(detector, "_answer_within_s", 20.0)
    now[0] += 10.0
    np.testing.assert_allclose(detector.detect(picture(60, 80)).corners_px[0], [20, 15, 40, 30], atol=3)
    detector.close()


def test_a_silent_server_is_reported_and_pictures_go_nowhere_in_the_clear() -> None:
    with pytest.raises(DetectorAwayError, match=r"127\.0\.0\.1:1 does not respond"):
        RemoteDetector("ws://127.0.0.1:1", confidence=0.1)
    with pytest.raises(DetectorAwayError, match="use wss://"):
        RemoteDetector("ws://192.0.2.7:8768", confidence=0.1)


def test_no_picture_follows_a_server_to_another(server: Serving) -> None:
    """A server on this computer could otherwise pass the pictures of a study without cloud models on."""

    def redirect(connection: ServerConnection, _request: Request) -> Response:
        answer = connection.respond(HTTPStatus.TEMPORARY_REDIRECT, "")
        answer.headers["Location"] = server.address
        return answer

    with serve(lambda _connection: None, "127.0.0.1", 0, process_request=redirect) as other:
        thread = threading.Thread(target=other.serve_forever)
        thread.start()
        with pytest.raises(DetectorAwayError, match="not a perception server"):
            RemoteDetector(f"ws://127.0.0.1:{other.socket.getsockname()[1]}", confidence=0.3)
        other.shutdown()
        thread.join()
    assert server.notes == []


def test_over_tls_the_server_has_to_prove_who_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    authority = Authority(tmp_path)
    files = authority.issue("127.0.0.1")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(files.certificate, files.key)
    running = Serving(tls=context)
    try:
        with pytest.raises(DetectorAwayError, match="cannot be verified") as refused:
            RemoteDetector(running.address, confidence=0.1)
        fingerprint = str(refused.value).rpartition(" ")[2]
        assert "this computer does not know its issuer" in str(refused.value) and fingerprint.count(":") == 31
        with monkeypatch.context() as confirmed:
            confirmed.setenv("CARIS_PERCEPTION_SHA256", fingerprint)
            RemoteDetector(running.address, confidence=0.1).close()
            for wrong, told in (
                ("00" + fingerprint[2:], "is not the one that was confirmed"),
                ("AB", "does not contain a SHA-256"),
            ):
                confirmed.setenv("CARIS_PERCEPTION_SHA256", wrong)
                with pytest.raises(DetectorAwayError, match=told):
                    RemoteDetector(running.address, confidence=0.1)
        monkeypatch.setenv("SSL_CERT_FILE", str(authority.file))
        detector = RemoteDetector(running.address, confidence=0.1)
        assert len(detector.detect(picture()).confidences) == 2
        detector.close()
    finally:
        running.stop()


def test_another_protocol_is_refused(monkeypatch: pytest.MonkeyPatch, server: Serving) -> None:
    monkeypatch.setattr(remote_detector, "PROTOCOL", 2)
    with pytest.raises(DetectorAwayError, match="a different version"):
        RemoteDetector(server.address, confidence=0.1)


def test_a_scenario_without_cloud_models_has_pictures_leave_this_computer_to_nobody() -> None:
    for server in ("wss://lab.example:8768", "ws://192.0.2.1", "wss://localhost.example.org"):
        settings = DetectorSettings(server=server, other_computers=False)
        with pytest.raises(WeightsError, match="does not permit models on other computers"):
            open_chosen(None, settings, confidence=0.1, threads=1, allow_download=False)
