"""Outbox of a client: bounded, keeps the newest messages, never drops answers."""

import asyncio
from typing import Any

import pytest

from caris_desktop.ros.rosbridge import decode_json
from caris_desktop.simulator.server import UNBOUNDED_LENGTH, ClientOutbox, Published, Subscription


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


class Socket:
    """Records sent messages; blocks the sender while ``closed_gate``."""

    def __init__(self) -> None:
        self.gate = asyncio.Event()
        self.gate.set()
        self.sent: list[Any] = []

    async def send(self, message: str | bytes, of: Published | None = None) -> None:
        await self.gate.wait()
        self.sent.append(decode_json(message) if isinstance(message, str) else message)

    @property
    def numbers(self) -> list[int]:
        return [operation["msg"]["n"] for operation in self.sent if operation["op"] == "publish"]


async def drain(outbox: ClientOutbox, socket: Socket) -> None:
    """Let the outbox send all pending messages."""
    sender = asyncio.create_task(outbox.send_all(socket))
    for _ in range(1000):
        await asyncio.sleep(0)
    sender.cancel()


def message(number: int, topic: str = "/t") -> Published:
    return Published(topic, {"n": number})


@pytest.mark.parametrize(("length", "kept"), [(1, [9]), (3, [7, 8, 9]), (0, list(range(10)))])
def test_the_newest_of_a_full_queue_stay(length: int, kept: list[int]) -> None:
    async def scenario() -> None:
        outbox, socket = ClientOutbox(Clock()), Socket()
        outbox.subscribe("/t", "", Subscription(queue_length=length))
        for number in range(10):
            outbox.put(message(number))
        await drain(outbox, socket)
        assert socket.numbers == kept

    asyncio.run(scenario())


def test_even_an_unbounded_queue_has_an_end() -> None:
    async def scenario() -> None:
        outbox, socket = ClientOutbox(Clock()), Socket()
        outbox.subscribe("/t", "", Subscription())
        for number in range(UNBOUNDED_LENGTH + 50):
            outbox.put(message(number))
        assert outbox.dropped == 50
        await drain(outbox, socket)
        assert socket.numbers == list(range(50, UNBOUNDED_LENGTH + 50))

    asyncio.run(scenario())


def test_a_throttle_with_a_queue_sends_the_newest_when_it_may() -> None:
    async def scenario() -> None:
        clock = Clock()
        outbox, socket = ClientOutbox(clock), Socket()
        outbox.subscribe("/t", "", Subscription(throttle_s=50.0, queue_length=1))
        for number in range(3):
            outbox.put(message(number))
            await drain(outbox, socket)
        assert socket.numbers == [0]
        clock.now_s += 51.0
        await drain(outbox, socket)
        assert socket.numbers == [0, 2]

    asyncio.run(scenario())


def test_a_throttle_without_a_queue_drops_what_comes_too_soon() -> None:
    async def scenario() -> None:
        clock = Clock()
        outbox, socket = ClientOutbox(clock), Socket()
        outbox.subscribe("/t", "", Subscription(throttle_s=1.0))
        for number in range(3):
            outbox.put(message(number))
        clock.now_s += 1.1
        outbox.put(message(3))
        await drain(outbox, socket)
        assert socket.numbers == [0, 3]

    asyncio.run(scenario())


def test_the_order_across_topics_is_retained_and_answers_go_first() -> None:
    async def scenario() -> None:
        outbox, socket = ClientOutbox(Clock()), Socket()
        for topic in ("/a", "/b"):
            outbox.subscribe(topic, "", Subscription())
        for number, topic in enumerate(("/b", "/a", "/a", "/b")):
            outbox.put(message(number, topic))
        outbox.answer({"op": "service_response"})
        await drain(outbox, socket)
        assert socket.sent[0] == {"op": "service_response"}
        assert socket.numbers == [0, 1, 2, 3]

    asyncio.run(scenario())


def test_a_message_is_encoded_once_for_everybody() -> None:
    published = message(1)
    assert published.json is published.json
    assert published.cbor is published.cbor
