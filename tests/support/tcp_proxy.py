"""TCP proxy in a separate process that simulates network faults: delay, low bandwidth, packet loss and disconnection.

Tests use ``TcpProxy(port)``, which runs ``python -m tests.support.tcp_proxy PORT``. The program reads one JSON object
per line on standard input, such as ``{"delay_s": 0.3}``, and answers ``ok``.
"""

import asyncio
import contextlib
import json
import socket
import subprocess
import sys
from collections import deque
from typing import Any, Literal

_CHUNK_BYTES = 4096
# Buffer of a router: when it is full, the sender has to wait.
_BUFFER_BYTES = 32 * 1024


class NetworkConditions:
    """Present network conditions of all connections, in both directions."""

    def __init__(self) -> None:
        self.delay_s = 0.0
        self.bytes_per_s: float | None = None
        # "to_server", "to_client", "both" or ""
        self.discarding = ""
        self.refusing = False
        # All connections share one network.
        self.free_at_s = {"to_server": 0.0, "to_client": 0.0}


class Direction:
    """One direction of a connection, with a queue of delayed data."""

    def __init__(
        self, name: str, conditions: NetworkConditions, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        self._name = name
        self._conditions = conditions
        self._reader = reader
        self._writer = writer
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._waiting_bytes = 0
        self._changed = asyncio.Event()
        self._ended = False

    @property
    def _discarding(self) -> bool:
        return self._conditions.discarding in ("both", self._name)

    async def receive(self) -> None:
        while data := await self._reader.read(_CHUNK_BYTES):
            if self._discarding:
                # Half-open connection: the data is acknowledged, but never forwarded.
                continue
            self._waiting.append((asyncio.get_running_loop().time() + self._conditions.delay_s, data))
            self._waiting_bytes += len(data)
            self._changed.set()
            while self._waiting_bytes > _BUFFER_BYTES and not self._discarding:  # noqa: ASYNC110 (ended from outside)
                await asyncio.sleep(0.005)
        self._ended = True
        self._changed.set()

    async def forward(self) -> None:
        loop = asyncio.get_running_loop()
        free_at_s = self._conditions.free_at_s
        while True:
            while not self._waiting:
                if self._ended:
                    return
                self._changed.clear()
                await self._changed.wait()
            due_s, data = self._waiting.popleft()
            await asyncio.sleep(max(0.0, due_s - loop.time()))
            rate = self._conditions.bytes_per_s
            if rate is not None:
                free_at_s[self._name] = max(free_at_s[self._name], loop.time()) + len(data) / rate
                await asyncio.sleep(max(0.0, free_at_s[self._name] - loop.time()))
            self._waiting_bytes -= len(data)
            if not self._discarding:
                self._writer.write(data)
                await self._writer.drain()


async def _serve(target_port: int) -> None:
    conditions = NetworkConditions()
    open_writers: set[asyncio.StreamWriter] = set()

    async def connect(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if conditions.refusing:
            writer.transport.abort()
            return
        far = socket.socket()
        far.setblocking(False)
        # The buffers of the operating system would hide seconds of a slow network.
        far.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
        writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
        try:
            await asyncio.get_running_loop().sock_connect(far, ("127.0.0.1", target_port))
            far_reader, far_writer = await asyncio.open_connection(sock=far, limit=_BUFFER_BYTES)
        except OSError:
            far.close()
            writer.transport.abort()
            return
        open_writers.update((writer, far_writer))
        to_server = Direction("to_server", conditions, reader, far_writer)
        to_client = Direction("to_client", conditions, far_reader, writer)
        tasks = [
            asyncio.create_task(work())
            for work in (to_server.receive, to_server.forward, to_client.receive, to_client.forward)
        ]
        with contextlib.suppress(OSError):
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if not conditions.discarding:
                # Deliver queued data before closing.
                await asyncio.wait(tasks, timeout=conditions.delay_s + 0.05)
        while conditions.discarding:  # noqa: ASYNC110 (ended from outside)
            # Neither side notices that the other has closed.
            await asyncio.sleep(0.05)
        for task in tasks:
            task.cancel()
        for each in (writer, far_writer):
            open_writers.discard(each)
            each.transport.abort()

    async def read_commands() -> None:
        lines = asyncio.StreamReader()
        await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
        while line := await lines.readline():
            for name, value in json.loads(line).items():
                if name == "cut":
                    for each in list(open_writers):
                        each.transport.abort()
                else:
                    setattr(conditions, name, value)
            print("ok", flush=True)

    async with await asyncio.start_server(connect, "127.0.0.1", 0, limit=_BUFFER_BYTES) as server:
        print(server.sockets[0].getsockname()[1], flush=True)
        await read_commands()


class TcpProxy:
    """Context manager of a proxy in front of ``port`` on this machine."""

    def __init__(self, port: int) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.support.tcp_proxy", str(port)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.port = int(self._read())

    @property
    def address(self) -> str:
        return f"ws://127.0.0.1:{self.port}"

    def __enter__(self) -> "TcpProxy":
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()

    def delay(self, seconds: float) -> None:
        """Delay all data, in each direction."""
        self._send(delay_s=seconds)

    def limit(self, bytes_per_s: float | None) -> None:
        """Limit the bandwidth of each direction; None removes the limit."""
        self._send(bytes_per_s=bytes_per_s)

    def discard(self, direction: Literal["to_server", "to_client", "both", ""]) -> None:
        """Silently discard all data of a direction; "" ends it."""
        self._send(discarding=direction)

    def cut(self, *, refuse: bool = False) -> None:
        """Reset every connection, and with ``refuse`` new ones, too."""
        self._send(refusing=refuse, cut=True)

    def restore(self) -> None:
        """Remove all faults, at least for new connections."""
        self._send(delay_s=0.0, bytes_per_s=None, discarding="", refusing=False)

    def _send(self, **settings: Any) -> None:
        if self._process.stdin is None:
            raise RuntimeError("the proxy was started without a pipe")
        self._process.stdin.write(json.dumps(settings) + "\n")
        self._process.stdin.flush()
        answer = self._read()
        if answer != "ok":
            raise RuntimeError(f"unexpected answer of the proxy: {answer!r}")

    def _read(self) -> str:
        if self._process.stdout is None:
            raise RuntimeError("the proxy was started without a pipe")
        return self._process.stdout.readline().strip()


if __name__ == "__main__":
    asyncio.run(_serve(int(sys.argv[1])))
