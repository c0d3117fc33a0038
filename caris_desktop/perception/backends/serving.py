"""Detection server for other computers: receives images over a websocket and answers with boxes."""

import contextlib
import hmac
import http
import json
import logging
import ssl
from collections.abc import AsyncIterator, Callable

import numpy as np
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from caris_desktop.domain.limited_listener import is_own_host, listen_limited, quiet_handshakes
from caris_desktop.domain.picture_checks import PictureError, decoded
from caris_desktop.perception.backends.remote import PROTOCOL, encode_answer
from caris_desktop.perception.detector import Detector

log = logging.getLogger(__name__)

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
            return _response(http.HTTPStatus.UNAUTHORIZED)
        if not token and not is_own_host(request.headers.get_all("Host")):
            return _response(http.HTTPStatus.FORBIDDEN)
        listener.admit(connection.remote_address)
        if "Upgrade" not in request.headers:  # a health check, or a person with a browser
            return _response(http.HTTPStatus.OK, hello.encode())
        return _response(http.HTTPStatus.SERVICE_UNAVAILABLE) if len(clients) >= _CLIENTS_AT_MOST else None

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


def _response(status: http.HTTPStatus, body: bytes = b"") -> Response:
    headers = Headers([("Content-Length", str(len(body))), ("Connection", "close")])
    return Response(status.value, status.phrase, headers, body)


def _name(connection: ServerConnection) -> str:
    address = connection.remote_address
    return str(address[0]) if isinstance(address, tuple) else "Somebody"
