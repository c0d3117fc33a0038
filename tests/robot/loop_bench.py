"""Link and rosbridge server on one asyncio loop, for fast tests that need no separate process."""

import asyncio
import contextlib
import json
import time
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any, TypeVar

from websockets.asyncio.server import Server, ServerConnection, serve

from caris_desktop.domain import link_commands
from caris_desktop.domain.events import LinkChanged
from caris_desktop.robot.control_link import ControlLink
from caris_desktop.robot.handled_operations import HANDLED_TOPIC, NO_SERVICE
from caris_desktop.robot.media_link import MediaLink
from caris_desktop.robot.profile_model import RobotProfile
from caris_desktop.ros.rosbridge import encode_cbor, encode_json

V = TypeVar("V")
_SUBSCRIPTION_READS = 100
"""A subscription that is under way is read meanwhile; without one a message goes to the main connection."""
Answer = dict[str, Any] | Callable[[dict[str, Any]], dict[str, Any] | str | None]


class Outbox:
    """Records the values that a link sends to the console."""

    def __init__(self) -> None:
        self.values: list[Any] = []

    def put(self, value: Any) -> None:
        self.values.append(value)

    def of(self, kind: type[V]) -> list[V]:
        return [value for value in self.values if isinstance(value, kind)]


class NoFrames:
    """Frame ring without a writer."""

    def write(self, *_: Any, **__: Any) -> Any:
        raise ValueError("no frames here")


class Bridge:
    """Rosbridge server that answers the services in ``answers`` and sends given messages.

    An answer may be a function of the request; a text means a failed call, None no answer. Other services do not exist.
    Messages go to subscribers of their topic, answers to the caller, other operations to the clients that subscribe to
    a topic of the robot. Liveness checks of the link are not in ``lines``.
    """

    def __init__(self) -> None:
        self.lines: list[dict[str, Any]] = []
        self.answers: dict[str, Answer] = {}
        self.on_operation: Callable[[dict[str, Any]], Awaitable[None] | None] | None = None
        self.clients: dict[ServerConnection, set[str]] = {}
        # Reject the internal topics and services of the link, as topics_glob and services_glob of rosbridge may.
        self.restricted = False
        self.port = 0
        self._asked_by: dict[str, ServerConnection] = {}
        self._server: Server | None = None

    def operations(self, op: str, name: str | None = None) -> list[dict[str, Any]]:
        """Received operations of a topic, service or action."""
        return [
            line
            for line in self.lines
            if line.get("op") == op
            and name in (None, *(line.get(key) for key in ("topic", "service", "action") if key in line))
        ]

    def published(self, topic: str) -> list[dict[str, Any]]:
        return [line["msg"] for line in self.operations("publish", topic)]

    async def publish(self, topic: str, message: Any, *, cbor: bool = False) -> None:
        operation = {"op": "publish", "topic": topic, "msg": message}
        payload = encode_cbor(operation) if cbor else encode_json(operation)
        for _ in range(_SUBSCRIPTION_READS):
            if self._subscribers(topic):
                break
            await asyncio.sleep(0.002)
        await self._send(payload, self._subscribers(topic) or self._main())

    async def send(self, payload: str | bytes) -> None:
        asked_by = None
        with contextlib.suppress(ValueError, TypeError, KeyError, RecursionError):
            asked_by = self._asked_by.get(json.loads(payload)["id"])
        await self._send(payload, self._main() if asked_by is None else [asked_by])

    async def _send(self, payload: str | bytes, to: list[ServerConnection]) -> None:
        for client in to:
            with contextlib.suppress(Exception):
                await client.send(payload)

    def _subscribers(self, topic: str) -> list[ServerConnection]:
        return [client for client, topics in self.clients.items() if topic in topics]

    def _main(self) -> list[ServerConnection]:
        apart = [client for client, topics in self.clients.items() if topics and HANDLED_TOPIC not in topics]
        return apart or list(self.clients)

    async def open(self) -> None:
        """Listen on the same port as before."""
        # Read everything and answer pings even while an operation blocks the others.
        self._server = await serve(self.handle, "127.0.0.1", self.port, max_size=None, max_queue=None, compression=None)
        self.port = self._server.sockets[0].getsockname()[1]

    async def drop(self) -> None:
        """Close every connection; clients may reconnect."""
        for client in list(self.clients):
            client.transport.abort()

    async def close(self) -> None:
        """Close every connection and refuse new ones until :meth:`open`."""
        if self._server is not None:
            server, self._server = self._server, None
            server.close(close_connections=False)
            await self.drop()
            await server.wait_closed()

    async def handle(self, client: ServerConnection) -> None:
        topics = self.clients[client] = set()
        with contextlib.suppress(Exception):
            async for text in client:
                operation = json.loads(text)
                if operation.get("topic", operation.get("service")) not in (HANDLED_TOPIC, NO_SERVICE):
                    self.lines.append(operation)
                elif self.restricted:
                    continue
                if "id" in operation:
                    self._asked_by[operation["id"]] = client
                if operation["op"] == "subscribe":
                    topics.add(operation["topic"])
                elif operation["op"] == "publish":
                    await self._send(json.dumps({**operation, "id": None}), self._subscribers(operation["topic"]))
                if self.on_operation is not None:
                    reaction = self.on_operation(operation)
                    if reaction is not None and not await self._reacts(client, reaction):
                        # Drop the unhandled operations of a client that has left.
                        break
                if operation["op"] == "call_service":
                    answer = self.answers.get(operation["service"], lambda _: "there is no such service")
                    values = answer(operation.get("args", {})) if callable(answer) else answer
                    if values is not None:
                        worked = not isinstance(values, str)
                        response = {"op": "service_response", "id": operation["id"], "values": values, "result": worked}
                        await client.send(json.dumps({**response, "service": operation["service"]}))
        del self.clients[client]

    async def _reacts(self, client: ServerConnection, reaction: Awaitable[None]) -> bool:
        """Wait for the reaction while the client is connected; later operations of this client wait too."""
        reacting, leaving = asyncio.ensure_future(reaction), asyncio.ensure_future(client.wait_closed())
        await asyncio.wait({reacting, leaving}, return_when=asyncio.FIRST_COMPLETED)
        reacted = reacting.done()
        for task in (reacting, leaving):
            task.cancel()
        return reacted


class LoopBench:
    """Connected link; ``outbox`` records the values for the console."""

    def __init__(self, bridge: Bridge, link: ControlLink | MediaLink, outbox: Outbox) -> None:
        self.bridge = bridge
        self.link = link
        self.outbox = outbox

    def send(self, *orders: link_commands.RobotCommand) -> None:
        self.link.process_commands(list(orders))

    def of(self, kind: type[V]) -> list[V]:
        return self.outbox.of(kind)

    @property
    def state(self) -> str:
        """Last reported state of the link."""
        return self.of(LinkChanged)[-1].state

    async def until(self, observe: Callable[[], V], what: str, *, timeout_s: float = 20.0) -> V:
        """Return the first truthy observation; AssertionError with ``what`` after ``timeout_s``."""
        until_s = time.monotonic() + timeout_s
        while not (observed := observe()):
            if time.monotonic() > until_s:
                raise AssertionError(f"not within {timeout_s:.0f} s: {what}")
            await asyncio.sleep(0.002)
        return observed


def with_link(
    profile: RobotProfile,
    test: Callable[[LoopBench], Coroutine[Any, Any, None]],
    *,
    media: bool = False,
    follows_crash: bool = False,
    prepare: Callable[[Bridge], None] = lambda _: None,
) -> None:
    """Run ``test`` with a link connected to a new bridge, which ``prepare`` may configure first."""

    async def run() -> None:
        bridge = Bridge()
        prepare(bridge)
        await bridge.open()
        outbox = Outbox()
        address = f"ws://127.0.0.1:{bridge.port}"
        box: Any = outbox
        link: Any = (
            MediaLink(profile, address, box, NoFrames())
            if media
            else ControlLink(profile, address, box, follows_crash=follows_crash)
        )
        bench = LoopBench(bridge, link, outbox)
        link.start()
        try:
            await bench.until(lambda: "connected" in [change.state for change in outbox.of(LinkChanged)], "a link")
            # The subscriptions are written before the link reports the connection.
            await bench.until(lambda: bridge.clients, "the server knows it")
            await test(bench)
        finally:
            await link.finish()
            await bridge.close()

    asyncio.run(run())


def inventory(topics: dict[str, str] | None = None, services: tuple[str, ...] = ()) -> dict[str, Answer]:
    """Answers of the listing services of rosapi."""
    told = topics or {}
    return {
        "/rosapi/topics": {"topics": list(told), "types": list(told.values())},
        "/rosapi/services": {"services": list(services)},
    }
