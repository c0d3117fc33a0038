"""Connection to one client: sends at once, or at the rate of a slow link, and logs deliveries."""

import asyncio
from collections import deque
from collections.abc import Callable
from typing import Protocol

from caris_desktop.simulator.client_outbox import Published

BUFFER_BYTES = 256 * 1024
"""What a slow link holds before its sender has to wait, as the buffers of a system and of a router do."""

_STEP_S = 0.1


class Socket(Protocol):
    """Destination of messages; ``send`` waits for the peer."""

    async def send(self, message: str | bytes) -> None: ...


Delivered = Callable[[Published, int], None]
"""Receives each message of a topic and its size in bytes, once its last piece has been sent."""


class ClientWire:
    """Sends to ``socket`` in order.

    ``rate_bytes_s`` is queried before each message; None is unlimited. With a rate, messages are delayed by their size,
    one after the other, and none is dropped.
    """

    def __init__(
        self, socket: Socket, *, rate_bytes_s: Callable[[], float | None], delivered: Delivered | None = None
    ) -> None:
        self._socket = socket
        self._rate_bytes_s = rate_bytes_s
        self._delivered = delivered
        self._waiting: deque[tuple[str | bytes, Published | None]] = deque()
        self._held_bytes = 0
        self._changed = asyncio.Condition()
        self._error: Exception | None = None
        self._pump: asyncio.Task[None] | None = None

    async def send(self, message: str | bytes, of: Published | None = None) -> None:
        """Send, or queue on the slow link when there is space; ``of`` is the message that this piece completes.

        Raises
        ------
        Exception
            What the socket raises, also when that happened to an earlier message.
        """
        if self._rate_bytes_s() is None and not self._held_bytes:
            await self._socket.send(message)
            self._note(message, of)
            return
        if self._pump is None:
            self._pump = asyncio.create_task(self._pump_all())
        async with self._changed:
            await self._changed.wait_for(lambda: self._error is not None or self._held_bytes < BUFFER_BYTES)
            if self._error is not None:
                raise self._error
            self._waiting.append((message, of))
            self._held_bytes += _size(message)
            self._changed.notify_all()

    def close(self) -> None:
        """Drop unsent messages."""
        if self._pump is not None:
            self._pump.cancel()

    async def _pump_all(self) -> None:
        while True:
            async with self._changed:
                await self._changed.wait_for(lambda: bool(self._waiting))
            message, of = self._waiting[0]
            await self._transmit(_size(message))
            try:
                await self._socket.send(message)
            except Exception as error:  # raised to the next sender
                self._error = error
            else:
                self._note(message, of)
            async with self._changed:
                self._waiting.popleft()
                self._held_bytes -= _size(message)
                self._changed.notify_all()
            if self._error is not None:
                return

    async def _transmit(self, left_bytes: float) -> None:
        # in small steps, so that a rate change applies to the present message, too
        while left_bytes > 0.0 and (rate_bytes_s := self._rate_bytes_s()) is not None:
            step_s = min(left_bytes / rate_bytes_s, _STEP_S)
            await asyncio.sleep(step_s)
            left_bytes -= step_s * rate_bytes_s

    def _note(self, message: str | bytes, of: Published | None) -> None:
        if of is not None and self._delivered is not None:
            self._delivered(of, of.size_bytes(message))


def _size(message: str | bytes) -> int:
    # JSON is almost all ASCII, so counting characters is accurate enough and free
    return len(message)
