"""Camera server: MJPEG and WebRTC with capture times.

It runs on the robot's computer, hence without Qt and torch, and implements only the HTTP that its clients use: the
console, browsers, and other MJPEG or WHEP clients.
"""

import asyncio
import base64
import contextlib
import fractions
import functools
import hmac
import http
import json
import logging
import secrets
import socket
import ssl
import time
import urllib.parse
from collections import deque
from collections.abc import Callable, Coroutine
from dataclasses import field
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain import clock
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.limited_listener import LimitedListener, is_own_host, listen_limited
from caris_desktop.domain.media_checks import PictureError, fitted, jpeg_of
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.perception.cameras.camera_source import CameraError, CameraSource, ChosenCamera

_JPEG_QUALITY = 80
_RETRY_AFTER_S = (1.0, 2.0, 5.0)
_log = logging.getLogger(__name__)
T = TypeVar("T")


@dataclass(slots=True, eq=False)
class Frame:
    """Frame as uint8 BGR. ``captured_ns`` is this computer's monotonic clock."""

    image_bgr: NDArray[np.uint8]
    captured_ns: int
    sequence: int
    _jpeg: "asyncio.Task[bytes] | None" = field(default=None, init=False)

    async def jpeg(self) -> bytes:
        """JPEG, encoded once for all clients."""
        if self._jpeg is None:
            self._jpeg = asyncio.create_task(asyncio.to_thread(jpeg_of, self.image_bgr, quality=_JPEG_QUALITY))
        return await asyncio.shield(self._jpeg)


class NewestFrame:
    """Reads a camera while ``run`` runs, and reconnects."""

    def __init__(self, chosen: ChosenCamera, open_one: Callable[[ChosenCamera], CameraSource]) -> None:
        self._chosen = chosen
        self._open = open_one
        self._frame: Frame | None = None
        self._came = asyncio.Event()
        self.state = "connecting"
        self.detail = ""

    @property
    def sequence(self) -> int:
        """Number of images so far."""
        return 0 if self._frame is None else self._frame.sequence

    async def after(self, sequence: int) -> Frame:
        """Wait for a frame newer than ``sequence``."""
        while self._frame is None or self._frame.sequence <= sequence:
            await self._came.wait()
        return self._frame

    async def run(self) -> None:
        """Read until cancelled. A file is looped at its own rate."""
        failures = 0
        while True:
            camera: CameraSource | None = None
            try:
                camera = await _finished(asyncio.to_thread(self._open, self._chosen))
                await self._read(camera)
                failures = 0
            except CameraError as error:
                if (self.state, self.detail) != ("lost", str(error)):
                    _log.warning("%s %s", error, error.advice)
                self.state, self.detail = "lost", str(error)
                await asyncio.sleep(_RETRY_AFTER_S[min(failures, len(_RETRY_AFTER_S) - 1)])
                failures += 1
            finally:
                if camera is not None:
                    camera.close()

    async def _read(self, camera: CameraSource) -> None:
        """Read until a recorded video ends. Raises CameraError."""
        began_ns = clock.now_ns()
        while True:
            try:
                picture = await _finished(asyncio.to_thread(camera.read))
                if picture is None:
                    return
                image_bgr = fitted(picture.image)
            except PictureError as error:
                _log.info("a picture %s", error)
                continue
            now_ns = clock.now_ns()
            if picture.due_s is not None:
                await asyncio.sleep(max(0.0, picture.due_s - (now_ns - began_ns) / 1e9))
                now_ns = clock.now_ns()
            if self.state != "connected":
                _log.warning("%s delivers.", self._chosen.name)
                self.state, self.detail = "connected", ""
            captured_ns = now_ns if picture.taken_ns is None else picture.taken_ns
            self._frame = Frame(image_bgr, captured_ns, self.sequence + 1)
            self._came.set()
            self._came = asyncio.Event()


async def _finished(work: Coroutine[Any, Any, T]) -> T:
    """Await a thread's result even when cancelled: a camera must not be closed while it is read."""
    task = asyncio.ensure_future(work)
    try:
        return await asyncio.shield(task)
    except asyncio.CancelledError:
        await asyncio.wait([task])
        raise


RATE_HZ = 48_000
PIECE = 960
"""Samples of one packet, 20 ms."""
_MOST_PIECES = 10
Take = Callable[[NDArray[np.int16]], None]
_Pieces = asyncio.Queue[tuple[int, NDArray[np.int16]]]
"""Numbered chunks for one client."""


class LocalSound:
    """Audio input of this computer, by a part of its name; empty: the system default.

    It delivers chunks of ``PIECE`` samples of one channel, shape (PIECE,), at ``RATE_HZ``, in any thread.
    """

    def __init__(self, name: str) -> None:
        self._name = name or None
        self._stream: Any = None

    def begin(self, take: Take) -> None:
        """Start. Raises OSError without audio input."""
        try:
            import sounddevice

            self._stream = sounddevice.InputStream(
                samplerate=RATE_HZ, channels=1, dtype="int16", device=self._name, blocksize=PIECE,
                callback=lambda samples, _frames, _times, _status: take(samples[:, 0].copy()),
            )  # fmt: skip
            self._stream.start()
        except Exception as error:
            # PortAudio raises its own types, and ValueError for a missing device.
            raise OSError(" ".join(str(error).split()) or type(error).__name__) from error

    def end(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            with contextlib.suppress(Exception):
                stream.abort()
                stream.close()


class ServedSound:
    """One source for all clients, open only while there is one. In one event loop."""

    def __init__(self, source: LocalSound) -> None:
        self._source = source
        self._number = 0
        self._listeners: set[_Pieces] = set()
        self._loop: asyncio.AbstractEventLoop | None = None

    def track(self) -> Any:
        """Audio track for one client. Raises OSError without audio input."""
        self._loop = asyncio.get_running_loop()
        if not self._listeners:
            self._source.begin(self._take)
        pieces: _Pieces = asyncio.Queue(_MOST_PIECES)
        self._listeners.add(pieces)
        return _audio_track(pieces, lambda: self._leave(pieces))

    def _leave(self, pieces: _Pieces) -> None:
        if pieces in self._listeners:
            self._listeners.discard(pieces)
            if not self._listeners:
                self._source.end()

    def _take(self, samples: NDArray[np.int16]) -> None:  # the source's thread
        if self._loop is not None:
            with contextlib.suppress(RuntimeError):  # the event loop has ended
                self._loop.call_soon_threadsafe(self._give, samples)

    def _give(self, samples: NDArray[np.int16]) -> None:
        self._number += 1
        for pieces in self._listeners:
            if pieces.full():
                pieces.get_nowait()  # the client is slow
            pieces.put_nowait((self._number, samples))


def _audio_track(pieces: _Pieces, ended: Callable[[], None]) -> Any:
    import aiortc
    import av

    class MicrophoneTrack(aiortc.MediaStreamTrack):  # type: ignore[misc]
        """Audio track; dropped chunks leave gaps in the frame times."""

        kind = "audio"

        async def recv(self) -> Any:
            number, samples = await pieces.get()
            frame = av.AudioFrame.from_ndarray(samples[None, :], format="s16", layout="mono")
            frame.sample_rate = RATE_HZ
            frame.pts = number * PIECE
            frame.time_base = fractions.Fraction(1, RATE_HZ)
            return frame

        def stop(self) -> None:
            super().stop()
            ended()

    return MicrophoneTrack()


MOST_CLIENTS = 16
_LONGEST_HEAD_BYTES = 16_384
_LONGEST_BODY_BYTES = 65_536
_REQUEST_WITHIN_S = 5.0
# A client that accepts nothing for this long counts as lost.
_STALLED_S = 10.0
# What the system buffers for a slow client is shown late there.
_SEND_BUFFER_BYTES = 131_072
_BOUNDARY = "frame"
MOST_WEBRTC_CONNECTIONS = 4
"""Each encodes for itself, which costs the small computer on a robot about half a core."""
CLOCK_RATE_HZ = 90_000
_MAX_STAMPS = 300


class WebRtcError(Exception):
    """Failed connection; ``status`` is the HTTP status."""

    def __init__(self, status: int, what: str) -> None:
        super().__init__(what)
        self.status = status


class WebRtcServer:
    """One connection for each client. In one event loop."""

    def __init__(self, frames: NewestFrame, sound: ServedSound | None = None) -> None:
        self._frames = frames
        self._sound = sound
        self._connections: dict[str, tuple[Any, deque[int]]] = {}

    async def connect(self, offer_sdp: str) -> tuple[str, str]:
        """Accept an offer; return the key of the connection and the answer.

        Raises WebRtcError, and ValueError for an invalid offer.
        """
        try:
            import aiortc
        except ImportError as error:
            raise WebRtcError(501, "WebRTC requires the package aiortc: pip install aiortc") from error
        if len(self._connections) >= MOST_WEBRTC_CONNECTIONS:
            raise WebRtcError(503, "Too many clients.")
        # Without external STUN or TURN servers: clients are in the same network.
        connection = aiortc.RTCPeerConnection(aiortc.RTCConfiguration(iceServers=[]))
        key = secrets.token_urlsafe(12)
        stamps: deque[int] = deque(maxlen=_MAX_STAMPS)
        self._connections[key] = connection, stamps

        async def on_state_change() -> None:
            if connection.connectionState in ("failed", "closed"):
                await self.end(key)

        connection.on("connectionstatechange", on_state_change)
        try:
            await connection.setRemoteDescription(aiortc.RTCSessionDescription(sdp=offer_sdp, type="offer"))
            connection.addTrack(_track(self._frames, stamps))
            if self._sound is not None and any(each.kind == "audio" for each in connection.getTransceivers()):
                try:
                    connection.addTrack(self._sound.track())
                except OSError as error:
                    _log.warning("the microphone cannot be heard: %s", error)
            await connection.setLocalDescription(await connection.createAnswer())
        except Exception as error:
            await self.end(key)
            # aiortc raises many kinds of errors for an unusable offer.
            raise ValueError("the offer cannot be used") from error
        return key, connection.localDescription.sdp

    def stamps(self, key: str) -> list[int] | None:
        """Capture times of the connection's recent frames, in ticks of its frame clock."""
        return list(self._connections[key][1]) if key in self._connections else None

    async def end(self, key: str) -> bool:
        """Close a connection; False if there was none."""
        connection, _stamps = self._connections.pop(key, (None, None))
        if connection is not None:
            for sender in connection.getSenders():
                if sender.track is not None:
                    sender.track.stop()
            await connection.close()
        return connection is not None

    async def close(self) -> None:
        await asyncio.gather(*(self.end(key) for key in tuple(self._connections)))


def ticks_of(monotonic_ns: int) -> int:
    return monotonic_ns * 9 // 100_000


def _track(frames: NewestFrame, stamps: deque[int]) -> Any:
    import aiortc
    import av

    class CameraTrack(aiortc.MediaStreamTrack):  # type: ignore[misc]
        """Video track whose frame times are capture times."""

        kind = "video"

        def __init__(self) -> None:
            super().__init__()
            self._sequence = 0

        async def recv(self) -> Any:
            frame = await frames.after(self._sequence)
            self._sequence = frame.sequence
            height_px, width_px = (length_px // 2 * 2 for length_px in frame.image_bgr.shape[:2])
            video = av.VideoFrame.from_ndarray(frame.image_bgr[:height_px, :width_px], format="bgr24")
            video.pts = ticks_of(frame.captured_ns)
            video.time_base = fractions.Fraction(1, CLOCK_RATE_HZ)
            stamps.append(video.pts)
            return video

    return CameraTrack()


class _Request(Value):
    method: str
    path: str
    head: dict[str, str]
    body: bytes


class _Answer(Value):
    status: int
    content: bytes = b""
    content_type: str = "text/plain; charset=utf-8"
    head: dict[str, str] = field(default_factory=dict)


class _BadRequestError(Exception):
    """Malformed request."""


class CameraServer:
    """Serves one camera. Clients authenticate with ``token``, as bearer or as any user's password; without a token,
    only this computer is served.
    """

    def __init__(self, frames: NewestFrame, *, token: str = "", sound: ServedSound | None = None) -> None:
        self._frames = frames
        self._token = token
        self._webrtc = WebRtcServer(frames, sound)
        self._clients: set[asyncio.Task[None]] = set()
        # Authenticated clients.
        self._known: set[asyncio.StreamWriter] = set()

    async def serve(self, host: str, port: int, tls: ssl.SSLContext | None = None) -> asyncio.Server:
        """Raises OSError where the address is not free."""
        listener = listen_limited(host, port)
        return await asyncio.start_server(
            functools.partial(self._on_client, listener),
            sock=listener,
            limit=_LONGEST_HEAD_BYTES,
            ssl=tls,
            ssl_handshake_timeout=None if tls is None else _REQUEST_WITHIN_S,
        )

    async def close(self) -> None:
        for task in tuple(self._clients):
            task.cancel()
        await asyncio.gather(*self._clients, return_exceptions=True)
        await self._webrtc.close()

    async def _on_client(
        self, listener: LimitedListener, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        task = cast("asyncio.Task[None]", asyncio.current_task())
        self._clients.add(task)
        try:
            while await self._answer_one(listener, reader, writer):
                pass
        except (OSError, asyncio.IncompleteReadError, TimeoutError, asyncio.CancelledError):
            pass  # Client or server ended: asyncio would print a traceback for each client.
        except _BadRequestError as error:
            with contextlib.suppress(OSError, TimeoutError):
                await _send(writer, _Answer(400, str(error).encode()))
        finally:
            self._clients.discard(task)
            self._known.discard(writer)
            writer.close()

    async def _answer_one(
        self, listener: LimitedListener, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> bool:
        """Answer one request; True if the connection stays open."""
        # Not wait_for, which can lose a cancellation in Python 3.11.
        async with asyncio.timeout(_REQUEST_WITHIN_S):
            request = await _request(reader)
        refusal = self._refusal(request)
        if refusal is None and len(self._known) >= MOST_CLIENTS and writer not in self._known:
            refusal = _Answer(503, b"Too many clients.")
        if refusal is not None:
            await _send(writer, refusal)
            return False
        self._known.add(writer)
        listener.admit(writer.get_extra_info("peername"))
        if (request.method, request.path) == ("GET", "/video.mjpg"):
            await self._stream(reader, writer)
            return False
        await _send(writer, await self._answer(request))
        return True

    def _refusal(self, request: _Request) -> _Answer | None:
        if not self._token:
            # A web page in a local browser must not reach us under its own name (DNS rebinding).
            known = is_own_host([request.head.get("host", "")], only_loopback=True)
            return None if known else _Answer(403, b"Without a token, only this computer has access.")
        if hmac.compare_digest(_given_token(request.head.get("authorization", "")), self._token.encode()):
            return None
        return _Answer(401, b"A token is required.", head={"WWW-Authenticate": 'Basic realm="camera"'})

    async def _answer(self, request: _Request) -> _Answer:
        match request.method, request.path:
            case "GET", "/":
                about = {"state": self._frames.state, "detail": self._frames.detail, "pictures": self._frames.sequence}
                return _Answer(200, json.dumps(about).encode(), "application/json")
            case "GET", "/clock":
                return _Answer(200, str(clock.now_ns()).encode())
            case "GET", "/picture.jpg":
                async with asyncio.timeout(_REQUEST_WITHIN_S):
                    frame = await self._frames.after(0)
                return _Answer(200, await frame.jpeg(), "image/jpeg", _when(frame.captured_ns))
            case "POST", "/whep" | "/offer":
                return await self._offered(request)
        of_one = request.path.removeprefix("/whep/").split("/")
        if request.path.startswith("/whep/") and request.method == "DELETE" and len(of_one) == 1:
            return _Answer(204) if await self._webrtc.end(of_one[0]) else _Answer(404)
        if request.method == "GET" and len(of_one) == 2 and of_one[1] == "stamps":
            stamps = self._webrtc.stamps(of_one[0])
            if stamps is not None:
                return _Answer(200, json.dumps(stamps).encode(), "application/json")
        return _Answer(404, b"Not found. Available: /video.mjpg, /picture.jpg, /whep, /offer, /clock and /.")

    async def _offered(self, request: _Request) -> _Answer:
        plain = request.path == "/offer"
        media_type = "application/json" if plain else "application/sdp"
        if request.head.get("content-type", "").partition(";")[0].strip().lower() != media_type:
            return _Answer(415, f"The offer must be {media_type}.".encode())
        try:
            offer = parse_json(request.body)["sdp"] if plain else request.body.decode()
            key, answer = await self._webrtc.connect(str(offer))
        except (ValueError, KeyError, TypeError, UnicodeDecodeError):
            return _Answer(400, b"This offer cannot be parsed.")
        except WebRtcError as error:
            return _Answer(error.status, str(error).encode())
        head = {"Location": f"/whep/{key}", "X-Clock": "/clock"}
        if plain:
            return _Answer(200, json.dumps({"sdp": answer, "type": "answer"}).encode(), "application/json", head)
        return _Answer(201, answer.encode(), "application/sdp", head)

    async def _stream(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Stream images until the client leaves; those that arrive while one is being sent are skipped."""
        connection = writer.get_extra_info("socket")
        if connection is not None:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        writer.transport.set_write_buffer_limits(high=0)
        writer.write(
            b"HTTP/1.1 200 OK\r\nCache-Control: no-store\r\nConnection: close\r\nX-Clock: /clock\r\n"
            b"Content-Type: multipart/x-mixed-replace; boundary=" + _BOUNDARY.encode() + b"\r\n\r\n"
        )
        sequence = 0
        # Nothing is written to a client of a lost camera, so that no error tells that it has left.
        left = asyncio.gather(reader.read(1), return_exceptions=True)
        while True:
            newer = asyncio.ensure_future(self._frames.after(sequence))
            await asyncio.wait((newer, left), return_when=asyncio.FIRST_COMPLETED)
            if left.done():
                newer.cancel()
                return
            frame = newer.result()
            sequence = frame.sequence
            content = await frame.jpeg()
            head = {"Content-Type": "image/jpeg", "Content-Length": str(len(content)), **_when(frame.captured_ns)}
            lines = "".join(f"{name}: {value}\r\n" for name, value in head.items())
            writer.write(f"--{_BOUNDARY}\r\n{lines}\r\n".encode() + content + b"\r\n")
            async with asyncio.timeout(_STALLED_S):
                await writer.drain()


def _when(captured_ns: int) -> dict[str, str]:
    """Time headers: ``X-Timestamp`` as in other MJPEG servers (UTC seconds), and the exact monotonic clock, which
    ``/clock`` serves.
    """
    utc_ns = time.time_ns() - (clock.now_ns() - captured_ns)
    return {"X-Timestamp": f"{utc_ns / 1e9:.6f}", "X-Captured-Monotonic-Ns": str(captured_ns)}


def _given_token(authorization: str) -> bytes:
    kind, _, credentials = authorization.strip().partition(" ")
    if kind.lower() == "bearer":
        return credentials.strip().encode()
    if kind.lower() == "basic":
        with contextlib.suppress(ValueError):
            return base64.b64decode(credentials, validate=True).partition(b":")[2]
    return b""


async def _request(reader: asyncio.StreamReader) -> _Request:
    """Read a request. Raises _BadRequestError, and IncompleteReadError at the end."""
    try:
        lines = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
    except asyncio.LimitOverrunError as error:
        raise _BadRequestError("The header of this request is too long.") from error
    words = lines[0].split(" ")
    if len(words) != 3 or not words[2].startswith("HTTP/1."):
        raise _BadRequestError("This is not HTTP.")
    head = {
        name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in lines[1:] if line)
    }
    length = head.get("content-length", "0")
    if not length.isdecimal() or len(length) > 9 or int(length) > _LONGEST_BODY_BYTES or "transfer-encoding" in head:
        raise _BadRequestError("The body of this request is too long, or its length is missing.")
    try:
        path = urllib.parse.urlsplit(words[1]).path
    except ValueError as error:
        raise _BadRequestError("This is not a path.") from error
    body = await reader.readexactly(int(length))
    return _Request(words[0], path, head, body)


async def _send(writer: asyncio.StreamWriter, answer: _Answer) -> None:
    head = {"Content-Type": answer.content_type, "Content-Length": str(len(answer.content)),
            "Cache-Control": "no-store", **answer.head}  # fmt: skip
    lines = "".join(f"{name}: {value}\r\n" for name, value in head.items())
    writer.write(
        f"HTTP/1.1 {answer.status} {http.HTTPStatus(answer.status).phrase}\r\n{lines}\r\n".encode() + answer.content
    )
    async with asyncio.timeout(_STALLED_S):
        await writer.drain()
