"""A TCP proxy in a separate process that does to a connection what networks do: delay, slowness, silence, cuts.

``TcpProxy(port)`` in a test; ``python -m tests.support.tcp_proxy PORT`` is what runs. It takes one JSON object a line
on standard input, such as ``{"delay_s": 0.3}``, and answers ``ok``.
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
# A router's buffer: when it is full, what comes next has to wait at the sender.
_BUFFER_BYTES = 32 * 1024


class Conditions:
    """How the network is at present; the same for both directions of every connection."""

    def __init__(self) -> None:
        self.delay_s = 0.0
        self.bytes_per_s: float | None = None
        # "there" (to the server), "back", "both" or nothing
        self.swallowing = ""
        self.refusing = False
        # All connections share one network.
        self.free_at_s = {"there": 0.0, "back": 0.0}


class Direction:
    """From one socket to the other, with what is on its way in between."""

    def __init__(
        self, name: str, conditions: Conditions, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
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
    def _swallowing(self) -> bool:
        return self._conditions.swallowing in ("both", self._name)

    async def take(self) -> None:
        while data := await self._reader.read(_CHUNK_BYTES):
            if self._swallowing:
                # Half-open: what is sent is acknowledged by nobody that matters and comes out nowhere.
                continue
            self._waiting.append((asyncio.get_running_loop().time() + self._conditions.delay_s, data))
            self._waiting_bytes += len(data)
            self._changed.set()
            while self._waiting_bytes > _BUFFER_BYTES and not self._swallowing:  # noqa: ASYNC110 (ended from outside)
                await asyncio.sleep(0.005)
        self._ended = True
        self._changed.set()

    async def give(self) -> None:
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
            if not self._swallowing:
                self._writer.write(data)
                await self._writer.drain()


async def _serve(target_port: int) -> None:
    conditions = Conditions()
    open_writers: set[asyncio.StreamWriter] = set()

    async def connect(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if conditions.refusing:
            writer.transport.abort()
            return
        far = socket.socket()
        far.setblocking(False)
        # The system's own buffers would hide seconds of a slow network.
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
        there = Direction("there", conditions, reader, far_writer)
        back = Direction("back", conditions, far_reader, writer)
        tasks = [asyncio.create_task(work()) for work in (there.take, there.give, back.take, back.give)]
        with contextlib.suppress(OSError):
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if not conditions.swallowing:
                # What is still on its way arrives before the end does.
                await asyncio.wait(tasks, timeout=conditions.delay_s + 0.05)
        while conditions.swallowing:  # noqa: ASYNC110 (ended from outside)
            # Nobody learns that the other side is gone.
            await asyncio.sleep(0.05)
        for task in tasks:
            task.cancel()
        for each in (writer, far_writer):
            open_writers.discard(each)
            each.transport.abort()

    async def obey() -> None:
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
        await obey()


class TcpProxy:
    """In front of ``port`` on this machine; a context manager that kills it afterwards."""

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
        """Everything takes that much longer, in each direction."""
        self._notify(delay_s=seconds)

    def limit(self, bytes_per_s: float | None) -> None:
        """No more than that in each direction; None lifts it."""
        self._notify(bytes_per_s=bytes_per_s)

    def swallow(self, direction: Literal["there", "back", "both", ""]) -> None:
        """Nothing comes out any more on the way there, back, or both; nobody is told. Nothing lifts it."""
        self._notify(swallowing=direction)

    def cut(self, *, refuse: bool = False) -> None:
        """Reset every connection; with ``refuse`` new ones, too."""
        self._notify(refusing=refuse, cut=True)

    def restore(self) -> None:
        """A network without any fault, for new connections at least."""
        self._notify(delay_s=0.0, bytes_per_s=None, swallowing="", refusing=False)

    def _notify(self, **order: Any) -> None:
        if self._process.stdin is None:
            raise RuntimeError("the proxy was started without a pipe")
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()
        answer = self._read()
        if answer != "ok":
            raise RuntimeError(f"the proxy says {answer!r}")

    def _read(self) -> str:
        if self._process.stdout is None:
            raise RuntimeError("the proxy was started without a pipe")
        return self._process.stdout.readline().strip()


if __name__ == "__main__":
    asyncio.run(_serve(int(sys.argv[1])))
