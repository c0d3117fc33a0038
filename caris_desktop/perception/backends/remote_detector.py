"""Remote detector: sends JPEG images to another machine and receives boxes as JSON, one at a time.

The server's greeting describes its detector. Then each binary message is an image, and each answer its boxes.
"""

import contextlib
import hmac
import http
import json
import logging
import os
import socket
import ssl
import time
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from typing import Any
from urllib.parse import SplitResult, urlsplit

import cv2
import numpy as np
from numpy.typing import NDArray
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus, InvalidURI, WebSocketException
from websockets.http11 import Request, Response
from websockets.sync.client import ClientConnection, connect

from caris_desktop.domain.address import is_loopback, is_same_server, without_credentials
from caris_desktop.domain.certificates import OtherCertificateError, refusal_of, trusted_context
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.limited_listener import is_own_host, listen_limited, quiet_handshakes
from caris_desktop.domain.media_checks import PictureError, decoded
from caris_desktop.domain.translation import QT_TR_NOOP, joined, localized
from caris_desktop.perception.detector import Detections, Detector, DetectorAwayError

log = logging.getLogger(__name__)

PROTOCOL = 1
FINGERPRINT_VARIABLE = "CARIS_PERCEPTION_SHA256"
TOKEN_VARIABLE = "CARIS_PERCEPTION_TOKEN"  # noqa: S105 - the name of a variable, not what is in it
SERVER_VARIABLE = "CARIS_PERCEPTION_SERVER"
_CONNECT_WITHIN_S = 3.0
ANSWER_WITHIN_S = 3.0
# Larger images do not improve detection, and cost bandwidth.
_LONGEST_PX = 1280
_JPEG_QUALITY = 90
_MESSAGE_AT_MOST_BYTES = 4_000_000
_TRY_AGAIN_AFTER_S = 2.0


class RemoteDetector:
    """``Detector`` on a server. Without it, ``detect`` raises DetectorAwayError and retries every two seconds.

    Raises
    ------
    DetectorAwayError
        When the server cannot be reached, or is none that can be used; trying again may help.
    """

    def __init__(
        self,
        address: str,
        *,
        confidence: float,
        answer_within_s: float = ANSWER_WITHIN_S,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._address = address
        self._server = urlsplit(without_credentials(address)).netloc or address
        self._confidence = confidence
        self._answer_within_s = answer_within_s
        self._monotonic_s = monotonic_s
        self._connection: ClientConnection | None = None
        self._open = contextlib.ExitStack()
        self._tried_s = monotonic_s()
        hello = self._connect()
        self.label = f"{hello['label']}, on {self._server}"
        self.class_names = tuple(str(name) for name in hello["class_names"])
        self.people = tuple(int(row) for row in hello["people"])

    def detect(self, image_bgr: NDArray[np.uint8]) -> Detections:
        if not image_bgr.size:
            return _read({"boxes": []}, 1.0)
        if self._connection is None:
            now_s = self._monotonic_s()
            if now_s - self._tried_s < _TRY_AGAIN_AFTER_S:
                raise self._away(QT_TR_NOOP("{shown} does not respond"))
            self._tried_s = now_s
            hello = self._connect()
            if tuple(hello["class_names"]) != self.class_names:
                self.close()
                raise self._away(QT_TR_NOOP("{shown} now uses a different detector"))
        scale = min(1.0, _LONGEST_PX / max(image_bgr.shape[:2]))
        sent = image_bgr
        if scale < 1.0:
            size = (max(1, round(image_bgr.shape[1] * scale)), max(1, round(image_bgr.shape[0] * scale)))
            sent = np.asarray(cv2.resize(image_bgr, size, interpolation=cv2.INTER_AREA), np.uint8)
        _, jpeg = cv2.imencode(".jpg", sent, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
        try:
            answer = self._ask(jpeg.tobytes())
            found = _read(answer, scale)
        except (KeyError, TypeError, ValueError, RecursionError) as error:
            self.close()
            raise self._away(QT_TR_NOOP("The response from {shown} cannot be read")) from error
        known = (found.classes >= 0) & (found.classes < len(self.class_names)) & (found.confidences > self._confidence)
        found, limits = found.at(known), [image_bgr.shape[1], image_bgr.shape[0]] * 2
        return replace(found, corners_px=found.corners_px.clip(0.0, limits))

    def close(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            # At once: an unresponsive server would not answer a close either.
            connection.close_socket()
        self._open.close()

    def _away(self, what: str) -> DetectorAwayError:
        return DetectorAwayError(localized(what, shown=self._server))

    def _connect(self) -> dict[str, Any]:
        address = urlsplit(self._address)
        if address.scheme == "ws" and not is_loopback(self._address):
            raise self._away(QT_TR_NOOP("Images are not sent to {shown} over an unencrypted connection: use wss://"))
        # The scenario names the server; the user decides which server may get the token.
        for_this = is_same_server(os.environ.get(SERVER_VARIABLE, ""), self._address)
        token = os.environ.get(TOKEN_VARIABLE, "") if for_this else ""
        try:
            host, port = address.hostname or "", address.port or (80 if address.scheme == "ws" else 443)
            trusted = None if address.scheme == "ws" else _trusted(host, port)
            # With a socket that is there, connect follows no redirection to another computer.
            reached = socket.create_connection((host, port), _CONNECT_WITHIN_S)
            reached.settimeout(None)
            self._connection = self._open.enter_context(
                connect(
                    self._address,
                    sock=reached,
                    additional_headers={"Authorization": f"Bearer {token}"} if token else None,
                    open_timeout=_CONNECT_WITHIN_S,
                    close_timeout=1.0,
                    max_size=_MESSAGE_AT_MOST_BYTES,
                    compression=None,
                    proxy=None,
                    ssl=trusted,
                )
            )
            hello = _greeting(self._connection.recv(timeout=_CONNECT_WITHIN_S))
        except InvalidStatus as error:
            refused = error.response.status_code in (401, 403)
            words = (
                QT_TR_NOOP(
                    "{shown} rejected the token: set {token} and {server} (its address) before starting the program"
                )
                if refused
                else QT_TR_NOOP("{shown} is not a perception server")
            )
            advice = localized(words, shown=self._server, token=TOKEN_VARIABLE, server=SERVER_VARIABLE)
            raise DetectorAwayError(advice) from error
        except OtherCertificateError as error:
            other = QT_TR_NOOP("The certificate of {shown} is not the one that was confirmed")
            raise DetectorAwayError(localized(other, shown=self._server)) from error
        except ssl.SSLError as error:
            raise DetectorAwayError(_not_proven(error, address, self._server)) from error
        except (OSError, TimeoutError, socket.gaierror, InvalidHandshake, InvalidURI, WebSocketException) as error:
            self.close()
            raise self._away(QT_TR_NOOP("{shown} does not respond")) from error
        except (KeyError, TypeError, ValueError) as error:
            self.close()
            raise self._away(QT_TR_NOOP("{shown} is not a perception server, or has a different version")) from error
        log.info("people are looked for by %s at %s", hello["label"], self._server)
        return hello

    def _ask(self, jpeg: bytes) -> dict[str, Any]:
        connection = self._connection
        assert connection is not None  # noqa: S101
        try:
            connection.send(jpeg)
            answer = parse_json(connection.recv(timeout=self._answer_within_s))
        except (OSError, TimeoutError, WebSocketException) as error:
            # A late answer would be mistaken for that to the next image.
            self.close()
            self._tried_s = self._monotonic_s()
            raise self._away(QT_TR_NOOP("{shown} does not respond")) from error
        return dict(answer)


def _trusted(host: str, port: int) -> ssl.SSLContext:
    """TLS context, pinned to a fingerprint if the user confirmed one."""
    confirmed = os.environ.get(FINGERPRINT_VARIABLE, "").strip()
    try:
        return trusted_context(confirmed, host, port)
    except ValueError as error:
        unknown = QT_TR_NOOP("{variable} does not contain a SHA-256 fingerprint")
        raise DetectorAwayError(localized(unknown, variable=FINGERPRINT_VARIABLE)) from error


def _not_proven(error: ssl.SSLError, address: SplitResult, server: str) -> str:
    reason, _, fingerprint = refusal_of(error, address.hostname or "", address.port or 443)
    if fingerprint:
        confirm = QT_TR_NOOP(
            "If this is the right certificate, set {variable} to its SHA-256 fingerprint: {fingerprint}"
        )
        reason = (*reason, localized(confirm, variable=FINGERPRINT_VARIABLE, fingerprint=fingerprint))
    return localized(QT_TR_NOOP("The identity of {shown} cannot be verified. {why}"), shown=server, why=joined(reason))


def _greeting(message: str | bytes) -> dict[str, Any]:
    """Parse the greeting. Raises KeyError, TypeError and ValueError if it is invalid."""
    greeting = parse_json(message)
    if greeting["caris_perception"] != PROTOCOL:
        raise ValueError("another version")
    return {
        "label": str(greeting["label"]),
        "class_names": list(greeting["class_names"]),
        "people": list(greeting["people"]),
    }


def _read(answer: dict[str, Any], scale: float) -> Detections:
    boxes = np.array(answer["boxes"], np.float64).reshape(-1, 6)
    keypoints = answer.get("keypoints")
    points = None
    if keypoints is not None:
        points = np.array(keypoints, np.float64).reshape(len(boxes), 17, 3)
        points[..., :2] /= scale
    return Detections(boxes[:, :4] / scale, boxes[:, 4], boxes[:, 5].astype(np.int64), points)


def encode_answer(found: Detections) -> str:
    """Answer of the server."""
    boxes = np.column_stack([found.corners_px.round(2), found.confidences.round(4), found.classes])
    keypoints = None if found.keypoints is None else found.keypoints.round(2).tolist()
    return json.dumps({"boxes": boxes.tolist(), "keypoints": keypoints})


# Detection server for other computers: receives images over a websocket and answers with boxes.

_PICTURE_AT_MOST_BYTES = 8_000_000
_CLIENTS_AT_MOST = 4
_OPENS_WITHIN_S = 5.0


@contextlib.asynccontextmanager
async def serving(
    detector: Detector,
    people: tuple[int, ...],
    *,
    host: str,
    port: int,
    token: str,
    tls: ssl.SSLContext | None,
    note: Callable[[str], None] = lambda _words: None,
) -> AsyncIterator[Server]:
    """Serve while the context lasts. ``people`` are the class rows that mean a person.

    Images of all clients are processed in sequence: a detector is for one thread. Clients without ``token``, and web
    pages, are refused.
    """
    listener = listen_limited(host, port)
    clients: set[ServerConnection] = set()
    hello = json.dumps(
        {
            "caris_perception": PROTOCOL,
            "label": detector.label,
            "class_names": list(detector.class_names),
            "people": list(people),
        }
    )

    def admit(connection: ServerConnection, request: Request) -> Response | None:
        given_token = "".join(request.headers.get_all("Authorization")).encode("utf-8", "surrogateescape")
        if token and not hmac.compare_digest(given_token, f"Bearer {token}".encode()):
            return connection.respond(http.HTTPStatus.UNAUTHORIZED, "")
        if not token and not is_own_host(request.headers.get_all("Host")):
            return connection.respond(http.HTTPStatus.FORBIDDEN, "")
        listener.admit(connection.remote_address)
        if "Upgrade" not in request.headers:  # a health check, or a person with a browser
            return connection.respond(http.HTTPStatus.OK, hello)
        full = len(clients) >= _CLIENTS_AT_MOST
        return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, "") if full else None

    async def answer(connection: ServerConnection) -> None:
        clients.add(connection)
        note(f"{_name(connection)} connected.")
        try:
            await connection.send(hello)
            async for message in connection:
                await connection.send(_answer_request(detector, message))
        except ConnectionClosed:
            pass
        finally:
            clients.discard(connection)
            note(f"{_name(connection)} disconnected.")

    async with serve(
        answer,
        sock=listener,
        ssl=tls,
        open_timeout=_OPENS_WITHIN_S,
        logger=quiet_handshakes(__name__),
        ssl_handshake_timeout=None if tls is None else _OPENS_WITHIN_S,
        origins=[None],
        process_request=admit,
        max_size=_PICTURE_AT_MOST_BYTES,
        max_queue=2,
        compression=None,
        server_header=None,
    ) as server:
        yield server


def _answer_request(detector: Detector, message: str | bytes) -> str:
    if isinstance(message, str) or len(message) < 4:
        return json.dumps({"error": "This is not an image."})
    try:
        image = decoded(message)
    except PictureError:
        return json.dumps({"error": "The image cannot be read."})
    try:
        return encode_answer(detector.detect(np.asarray(image, np.uint8)))
    except Exception:  # a failed image does not end the server
        log.exception("a picture of %s pixels could not be looked at", image.shape[:2])
        return json.dumps({"error": "The detector failed on this image."})


def _name(connection: ServerConnection) -> str:
    address = connection.remote_address
    return str(address[0]) if isinstance(address, tuple) else "Somebody"
