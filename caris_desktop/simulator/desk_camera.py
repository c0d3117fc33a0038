"""Network camera on the reception desk, not on the robot: MJPEG over HTTP."""

import asyncio
import contextlib
import math

from caris_desktop.domain.geometry import Pose2D
from caris_desktop.simulator.robot_simulation import View
from caris_desktop.simulator.simulated_people import Seen

STANDS_IN_MAP = Pose2D(5.2, 2.6, math.radians(-170.0))
HEIGHT_M, TILT_RAD = 1.5, 0.25
RATE_HZ = 7.5
_BOUNDARY = b"frame"
_REQUEST_WITHIN_S = 5.0


def desk_view(people: tuple[Seen, ...]) -> View:
    """Its view: the hall in front of the desk, where visitors stand when the robot waits at the reception."""
    return View(STANDS_IN_MAP, people, TILT_RAD, HEIGHT_M)


class DeskCamera:
    """Sends the newest image to each client whenever it can accept another one."""

    def __init__(self) -> None:
        self._server: asyncio.Server | None = None
        self._clients: set[asyncio.StreamWriter] = set()
        self._changed = asyncio.Condition()
        self._picture = b""
        self._number = 0

    @property
    def watched(self) -> bool:
        """True if there are clients."""
        return bool(self._clients)

    async def start(self, port: int) -> int:
        """Listen on this computer only; return the port. Raises OSError."""
        self._server = await asyncio.start_server(self._on_client, "127.0.0.1", port)
        opened: int = self._server.sockets[0].getsockname()[1]
        return opened

    async def show(self, jpeg: bytes) -> None:
        async with self._changed:
            self._picture = jpeg
            self._number += 1
            self._changed.notify_all()

    def stop(self) -> None:
        if self._server is not None:
            self._server.close()
        for client in self._clients:
            client.close()

    async def _on_client(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            request = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _REQUEST_WITHIN_S)
            if not request.startswith(b"GET "):
                writer.write(b"HTTP/1.1 405 Method Not Allowed\r\nContent-Length: 0\r\nConnection: close\r\n\r\n")
                return
            self._clients.add(writer)
            kind = b"multipart/x-mixed-replace; boundary=" + _BOUNDARY
            writer.write(b"HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Type: " + kind + b"\r\n\r\n")
            await self._send_pictures(writer)
        except (OSError, EOFError, asyncio.LimitOverrunError, TimeoutError):
            pass  # the client left, or speaks another protocol
        finally:
            self._clients.discard(writer)
            writer.close()
            with contextlib.suppress(OSError, asyncio.CancelledError):
                await writer.wait_closed()

    async def _send_pictures(self, writer: asyncio.StreamWriter) -> None:
        sent = self._number
        while True:
            async with self._changed:
                while self._number == sent:
                    await self._changed.wait()
                sent, picture = self._number, self._picture
            head = f"Content-Type: image/jpeg\r\nContent-Length: {len(picture)}\r\n\r\n".encode()
            writer.write(b"--" + _BOUNDARY + b"\r\n" + head + picture + b"\r\n")
            await writer.drain()
