"""Web page of the robot's face for phones and tablets, updated over a websocket.

It runs in a separate process, since strangers can reach it if the scenario opens it to a network.
"""

import asyncio
import contextlib
import functools
import hmac
import json
import logging
import secrets
import socket
from collections.abc import Callable
from http import HTTPStatus
from multiprocessing.connection import Connection

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from caris_desktop.conversation.face.drawing import Drawing
from caris_desktop.domain.limited_listener import LimitedListener, is_own_host, listen_limited, quiet_handshakes
from caris_desktop.domain.process_settings import step_back
from caris_desktop.domain.shipped import resources_dir
from caris_desktop.domain.value_class import Value

_log = logging.getLogger(__name__)
HEARTBEAT_EVERY_S = 1.0
"""Keep-alive interval in s."""
_MOST_PAGES = 8
_CLOSES_WITHIN_S = 1.0
# Time for a request, before the connection is dropped.
_OPENS_WITHIN_S = 3.0
# The window comes before work that strangers cause.
_NICENESS = 5


class PageOpened(Value):
    """The page is served at this secret address."""

    address: str


class PageFailed(Value):
    """The page cannot be served; the process ends."""

    why: str


class PagesOpen(Value):
    """Number of open pages."""

    pages: int


def run_face_page(connection: Connection, network: bool) -> None:
    """Process body: serve what arrives, a drawing's text or a JPEG, until the connection ends."""
    step_back(_NICENESS)
    asyncio.run(_serve_what_comes(connection, network))


async def _serve_what_comes(connection: Connection, network: bool) -> None:
    def send(message: PageOpened | PageFailed | PagesOpen) -> None:
        with contextlib.suppress(OSError):  # the console has ended, which ends this process too
            connection.send(message)

    page = FacePage(lambda pages: send(PagesOpen(pages)))
    try:
        send(PageOpened(await page.open(network=network)))
    except OSError as error:
        send(PageFailed(error.strerror or str(error)))
        return
    try:
        while True:
            page.show(await asyncio.to_thread(connection.recv))
    except (EOFError, OSError):
        await page.close()


def drawn(drawing: Drawing) -> str:
    """The message of a drawing to the page."""
    return json.dumps({"drawing": drawing.plain()})


class FacePage:
    """Serves the face page. Pages show the newest of ``show``; a slow one skips intermediate values.

    The address contains a secret token. ``told`` is called with the number of open pages.
    """

    def __init__(self, on_page_count: Callable[[int], None]) -> None:
        self._on_page_count = on_page_count
        self._token = secrets.token_urlsafe(12)
        self._server: Server | None = None
        self._newest: str | bytes = b""
        self._pages: set[asyncio.Event] = set()

    async def open(self, *, network: bool) -> str:
        """Start the server; returns the address for a browser. Raises OSError."""
        host = "0.0.0.0" if network else "127.0.0.1"  # noqa: S104 - the scenario asks for it
        listener = listen_limited(host, 0)
        self._server = await serve(
            self._serve, sock=listener, process_request=functools.partial(self._answer, listener), max_size=4096,
            compression=None, server_header=None, open_timeout=_OPENS_WITHIN_S, close_timeout=_CLOSES_WITHIN_S,
            logger=quiet_handshakes(__name__),
        )  # fmt: skip
        port = next(iter(self._server.sockets)).getsockname()[1]
        return f"http://{_address_in_network() if network else '127.0.0.1'}:{port}/{self._token}/"

    async def close(self) -> None:
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()
            self._server = None

    def show(self, newest: str | bytes) -> None:
        """Show a drawing as :func:`drawn` gives it, or JPEG data."""
        self._newest = newest
        for page in self._pages:
            page.set()

    def _answer(self, listener: LimitedListener, connection: ServerConnection, request: Request) -> Response | None:
        """Answer an HTTP request; None for the page's websocket."""
        token, _, rest = request.path.removeprefix("/").partition("/")
        known = hmac.compare_digest(token.encode("utf-8", "surrogateescape"), self._token.encode())
        if not known or not is_own_host(request.headers.get_all("host")):
            return _response(HTTPStatus.NOT_FOUND, "There is nothing here.\n", "text/plain")
        listener.admit(connection.remote_address)
        if rest == "face":
            if len(self._pages) >= _MOST_PAGES:
                return _response(HTTPStatus.SERVICE_UNAVAILABLE, "Too many pages are open.\n", "text/plain")
            return None
        if rest:
            return _response(HTTPStatus.NOT_FOUND, "There is nothing here.\n", "text/plain")
        nonce = secrets.token_urlsafe(12)
        page = (resources_dir() / "faces" / "page.html").read_text("utf-8").replace("NONCE", nonce)
        policy = (
            f"default-src 'none'; script-src 'nonce-{nonce}'; style-src 'unsafe-inline'; img-src blob:; "
            "connect-src 'self' ws:; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
        )
        return _response(HTTPStatus.OK, page, "text/html", {"Content-Security-Policy": policy})

    async def _serve(self, connection: ServerConnection) -> None:
        """Serve a page until it is closed; its messages are ignored."""
        changed = asyncio.Event()
        changed.set()
        self._pages.add(changed)
        self._on_page_count(len(self._pages))
        try:
            while True:
                with contextlib.suppress(TimeoutError):
                    async with asyncio.timeout(HEARTBEAT_EVERY_S):
                        await changed.wait()
                changed.clear()
                await connection.send(self._newest or "{}")
        except ConnectionClosed:
            _log.debug("a page with the face was closed")
        finally:
            self._pages.discard(changed)
            self._on_page_count(len(self._pages))


def _response(status: HTTPStatus, text: str, kind: str, more: dict[str, str] | None = None) -> Response:
    body = text.encode()
    headers = Headers({
        "Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body)), "Cache-Control": "no-store",
        "Referrer-Policy": "no-referrer", "X-Content-Type-Options": "nosniff", "Connection": "close", **(more or {}),
    })  # fmt: skip
    return Response(status.value, status.phrase, headers, body)


def _address_in_network() -> str:
    """This computer's address in its network. Sends nothing."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))
        except OSError:
            return socket.gethostname()
        return str(probe.getsockname()[0])
