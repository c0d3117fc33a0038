"""MJPEG camera: JPEG images over HTTP (multipart), from network cameras and our camera server."""

import http.client
import re
import select

from caris_desktop.domain import clock
from caris_desktop.domain.picture_checks import decode_compressed, picture_size
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.perception.cameras.camera_source import CameraError, ChosenCamera, Picture
from caris_desktop.perception.cameras.http_request import CameraConnection
from caris_desktop.perception.cameras.remote_clock import ServedClock

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
                    raise self._lost()
                data = self._response.read1(self.read_at_most_bytes)
                if not data:
                    if newest is not None:
                        break
                    raise self._lost()
                newest = self._parts.add(data) or newest
        except (OSError, http.client.HTTPException) as error:
            raise self._lost() from error
        return newest

    def _more_waits(self) -> bool:
        return bool(select.select([self._response.fileno()], [], [], 0)[0])

    def _lost(self) -> CameraError:
        return CameraError(
            localized(QT_TR_NOOP("The camera at {name} stopped sending images."), name=self._chosen.name),
            QT_TR_NOOP("Check the camera and its network connection."),
        )

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
