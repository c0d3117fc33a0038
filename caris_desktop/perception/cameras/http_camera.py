"""HTTP cameras: authenticated requests, MJPEG images (multipart), and the clock of our camera server."""

import base64
import contextlib
import http.client
import logging
import re
import select
import ssl
import urllib.parse
from collections import deque
from collections.abc import Callable, Mapping

from caris_desktop.domain import clock
from caris_desktop.domain.address import is_encrypted_or_local, without_credentials
from caris_desktop.domain.certificates import OtherCertificateError, refusal_of, trusted_context
from caris_desktop.domain.media_checks import decode_compressed, picture_size
from caris_desktop.domain.translation import QT_TR_NOOP, joined, localized
from caris_desktop.perception.cameras.camera_source import (
    OPEN_TIMEOUT_S,
    SILENCE_S,
    CameraError,
    ChosenCamera,
    Picture,
    camera_token,
    cannot_be_reached,
    stopped_sending,
)

_LONGEST_ANSWER_BYTES = 1_000_000


class CameraConnection(contextlib.AbstractContextManager["CameraConnection"]):
    """Connection to a camera's host for sequential requests. Use as a context, or close it."""

    def __init__(self, chosen: ChosenCamera) -> None:
        """Raises CameraError if the token is missing or would be sent unencrypted, or the certificate is another."""
        self._chosen = chosen
        self._parts = urllib.parse.urlsplit(chosen.target)
        self._head = _authorization(chosen, self._parts)
        host, port = self._parts.hostname or "", self._parts.port
        if self._parts.scheme == "https":
            self._connection: http.client.HTTPConnection = http.client.HTTPSConnection(
                host, port, timeout=OPEN_TIMEOUT_S, context=self._trusted(host, port or 443)
            )
        else:
            self._connection = http.client.HTTPConnection(host, port, timeout=OPEN_TIMEOUT_S)

    def __exit__(self, *_error: object) -> None:
        self.close()

    def close(self) -> None:
        self._connection.close()

    def request(
        self, method: str, path: str = "", body: bytes | None = None, head: Mapping[str, str] | None = None
    ) -> http.client.HTTPResponse:
        """Send a request; return the response after its headers. ``path`` defaults to the camera's.
        Raises CameraError.
        """
        own_path = (self._parts.path or "/") + (f"?{self._parts.query}" if self._parts.query else "")
        try:
            self._connection.request(method, path or own_path, body, {**self._head, **(head or {})})
            self._connection.sock.settimeout(SILENCE_S)
            return self._connection.getresponse()
        except (OSError, http.client.HTTPException) as error:
            self.close()
            raise self._not_reached(error) from error

    def _trusted(self, host: str, port: int) -> ssl.SSLContext:
        try:
            return trusted_context(self._chosen.certificate_sha256, host, port)
        except OSError as error:
            raise self._not_reached(error) from error

    def _not_reached(self, error: Exception) -> CameraError:
        name = self._chosen.name
        if isinstance(error, OtherCertificateError):
            other = QT_TR_NOOP("The certificate of the camera at {name} does not match the fingerprint in its address.")
            return CameraError(
                localized(other, name=name),
                QT_TR_NOOP(
                    "Find out why on the camera's computer. Do not use the camera until then: the connection may "
                    "be intercepted."
                ),
            )
        if isinstance(error, ssl.SSLError):
            reason, advice, fingerprint = refusal_of(error, self._parts.hostname or "", self._parts.port or 443)
            if fingerprint:
                confirm = QT_TR_NOOP(
                    "If this is the right certificate, append its SHA-256 fingerprint to the address: "
                    "#certificate-sha256={fingerprint}"
                )
                advice = (*advice, localized(confirm, fingerprint=fingerprint))
            return CameraError(joined(reason), joined(advice))
        return cannot_be_reached(name)

    def ask(
        self, method: str, path: str = "", body: bytes | None = None, head: Mapping[str, str] | None = None
    ) -> tuple[http.client.HTTPResponse, bytes]:
        """Send a request; return the response and its body. Raises CameraError."""
        response = self.request(method, path, body, head)
        try:
            return response, response.read(_LONGEST_ANSWER_BYTES)
        except (OSError, http.client.HTTPException) as error:
            self.close()
            raise cannot_be_reached(self._chosen.name) from error


def _authorization(chosen: ChosenCamera, parts: urllib.parse.SplitResult) -> dict[str, str]:
    token = camera_token(chosen)
    if token and not is_encrypted_or_local(chosen.target):
        raise CameraError(
            localized(
                QT_TR_NOOP("The token for the camera at {name} is not sent: others could read it in transit."),
                name=chosen.name,
            ),
            QT_TR_NOOP("Start its camera server with --cert and --key and use https://, or use an SSH tunnel."),
        )
    if token:
        return {"Authorization": f"Bearer {token}"}
    if parts.username is None:
        return {}
    pair = f"{urllib.parse.unquote(parts.username)}:{urllib.parse.unquote(parts.password or '')}"
    return {"Authorization": f"Basic {base64.b64encode(pair.encode()).decode()}"}


_log = logging.getLogger(__name__)
_FIRST_ROUND_TRIPS = 8
_ASK_EVERY_NS = 2_000_000_000

_HISTORY = 30
# Maximum drift between ordinary computers' clocks, in ns per ns.
_DRIFT = 50e-6


class RemoteClockEstimate:
    """Remote clock estimate; ``ask`` returns the remote monotonic clock in ns, with one round trip."""

    def __init__(self, ask: Callable[[], int], *, now_ns: Callable[[], int] = clock.now_ns) -> None:
        self._ask = ask
        self._now_ns = now_ns
        self._measured: deque[tuple[int, int, int]] = deque(maxlen=_HISTORY)

    def measure(self) -> None:
        """Measure one round trip; the shortest ones are the most accurate. Raises what ``ask`` raises."""
        requested_ns = self._now_ns()
        far_ns = self._ask()
        received_ns = self._now_ns()
        self._measured.append(
            (received_ns, far_ns - (requested_ns + received_ns) // 2, (received_ns - requested_ns) // 2)
        )

    def here(self, far_ns: int) -> tuple[int, int] | None:
        """Remote time in session time, and its uncertainty; None if not known well enough."""
        if not self._measured:
            return None
        now_ns = self._now_ns()
        uncertainty_ns, offset_ns = min(
            (round(half_ns + _DRIFT * (now_ns - at_ns)), offset_ns) for at_ns, offset_ns, half_ns in self._measured
        )
        taken_ns = clock.measured_ns(far_ns, arrival_ns=now_ns, offset_ns=offset_ns, uncertainty_ns=uncertainty_ns)
        return None if taken_ns is None else (taken_ns, uncertainty_ns)


class ServedClock(RemoteClockEstimate):
    """Clock of a camera server, polled over HTTP: several times at first, then periodically."""

    def __init__(self, chosen: ChosenCamera, path: str) -> None:
        super().__init__(self._server_ns)
        self._chosen = chosen
        self._path = path
        self._connection: CameraConnection | None = None
        for _ in range(_FIRST_ROUND_TRIPS):
            self._poll()

    def here(self, far_ns: int) -> tuple[int, int] | None:
        """As :meth:`RemoteClockEstimate.here`, with an occasional round trip."""
        if clock.now_ns() - self._polled_ns >= _ASK_EVERY_NS:
            self._poll()
        return super().here(far_ns)

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()

    def _server_ns(self) -> int:
        if self._connection is None:
            self._connection = CameraConnection(self._chosen)
        return int(self._connection.ask("GET", self._path)[1])

    def _poll(self) -> None:
        self._polled_ns = clock.now_ns()
        try:
            self.measure()
        except (CameraError, ValueError):
            _log.info("the clock of %s was not told", self._chosen.name, exc_info=True)


CAPTURED_HEADER = "x-captured-monotonic-ns"
"""When our camera server took this picture, by its monotonic clock; every part has it."""
CLOCK_HEADER = "X-Clock"
"""In the answer of our camera server: where its monotonic clock can be asked for."""
_LARGEST_BYTES = 64_000_000
# Whatever else arrives in between
_PICTURE_WITHIN_S = 6.0
_LONGEST_HEAD_BYTES = 16_384


class NotMultipartError(Exception):
    """The address serves something else: a video stream, or a camera with another authentication."""


class HttpCamera:
    """MJPEG source; ``width_px`` and ``height_px`` are those of the first image."""

    fps: float | None = None
    read_at_most_bytes = 1 << 20

    def __init__(self, chosen: ChosenCamera) -> None:
        """Connect. Raises CameraError, and NotMultipartError if another source type may work."""
        self._chosen = chosen
        self._clock: ServedClock | None = None
        self._connection = CameraConnection(chosen)
        response = self._connection.request("GET")
        boundary = re.search(r'boundary="?([^";,]+)', response.headers.get("Content-Type", ""))
        if response.status != 200 or boundary is None:
            self._connection.close()
            if response.status in (401, 403) and chosen.token_env:
                raise CameraError(
                    localized(QT_TR_NOOP("The camera at {name} rejected the token."), name=chosen.name),
                    localized(
                        QT_TR_NOOP(
                            "Set the environment variable {token_env} to the token that the camera server was "
                            "started with."
                        ),
                        token_env=chosen.token_env,
                    ),
                )
            if 300 <= response.status < 400:
                there = urllib.parse.urljoin(chosen.target, response.headers.get("Location", ""))
                raise CameraError(
                    localized(QT_TR_NOOP("The camera at {name} refers to another address."), name=chosen.name),
                    localized(
                        QT_TR_NOOP("If {address} is right, enter it as the camera's address."),
                        address=without_credentials(there),
                    ),
                )
            raise NotMultipartError(f"{response.status} {response.headers.get('Content-Type')}")
        self._response = response
        self._parts = MultipartReader(boundary[1])
        path = response.headers.get(CLOCK_HEADER, "")
        if path.startswith("/"):
            self._clock = ServedClock(chosen, path)
        try:
            head, content = self._newest()
        except CameraError:
            self.close()
            raise
        self._first: tuple[dict[str, str], bytes] | None = (head, content)
        self.width_px, self.height_px = picture_size(content) or (0, 0)

    def read(self) -> Picture | None:
        head, content = self._first or self._newest()
        self._first = None
        moment = self._capture_time(head)
        image = decode_compressed(content)
        return Picture(image) if moment is None else Picture(image, taken_ns=moment[0], taken_uncertainty_ns=moment[1])

    def close(self) -> None:
        self._response.close()
        self._connection.close()
        if self._clock is not None:
            self._clock.close()

    def _newest(self) -> tuple[dict[str, str], bytes]:
        """Newest of the complete images received; earlier ones would be shown late."""
        newest: tuple[dict[str, str], bytes] | None = None
        until_ns = clock.now_ns() + round(_PICTURE_WITHIN_S * 1e9)
        try:
            while newest is None or self._more_waits():
                if newest is None and clock.now_ns() > until_ns:
                    raise stopped_sending(self._chosen.name)
                data = self._response.read1(self.read_at_most_bytes)
                if not data:
                    if newest is not None:
                        break
                    raise stopped_sending(self._chosen.name)
                newest = self._parts.add(data) or newest
        except (OSError, http.client.HTTPException) as error:
            raise stopped_sending(self._chosen.name) from error
        return newest

    def _more_waits(self) -> bool:
        return bool(select.select([self._response.fileno()], [], [], 0)[0])

    def _capture_time(self, head: dict[str, str]) -> tuple[int, int] | None:
        stamp = head.get(CAPTURED_HEADER, "")
        if self._clock is None or not stamp.isdecimal() or len(stamp) > 20:
            return None
        return self._clock.here(int(stamp))


class MultipartReader:
    """Incremental parser of a multipart stream: parts with a content length, or delimited by boundaries."""

    def __init__(self, boundary: str) -> None:
        self._mark = b"--" + boundary.removeprefix("--").encode("latin-1", "replace")
        self._buffer = bytearray()

    def add(self, data: bytes) -> tuple[dict[str, str], bytes] | None:
        """Add data; return the newest complete part with its headers by lower-case name. Raises OSError for an invalid
        stream.
        """
        self._buffer += data
        newest = None
        while (part := self._next()) is not None:
            newest = part
        if len(self._buffer) > _LARGEST_BYTES:
            raise OSError("an unterminated image")
        return newest

    def _next(self) -> tuple[dict[str, str], bytes] | None:
        buffer = self._buffer
        begin = buffer.find(self._mark)
        if begin < 0:
            return None
        head_end = buffer.find(b"\r\n\r\n", begin)
        if head_end < 0:
            if len(buffer) - begin > _LONGEST_HEAD_BYTES:
                raise OSError("a part with an unterminated header")
            return None
        lines = bytes(buffer[begin + len(self._mark) : head_end]).decode("latin-1").split("\r\n")
        head = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
        start = head_end + 4
        length = head.get("content-length", "")
        if length.isdecimal() and len(length) < 10:
            end = start + int(length)
            if end - start > _LARGEST_BYTES:
                raise OSError("an image that is too large")
            if len(buffer) < end:
                return None
        else:
            end = buffer.find(b"\r\n" + self._mark, start)
            if end < 0:
                return None
        content = bytes(buffer[start:end])
        del buffer[:end]
        return head, content
