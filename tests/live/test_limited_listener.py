"""Limit of idle foreign connections, so that legitimate clients can still connect."""

import asyncio
import logging
import random
import socket
from collections import Counter
from contextlib import closing, suppress
from typing import Any

import pytest

from caris_desktop.conversation.face.page import FacePage
from caris_desktop.domain import limited_listener
from caris_desktop.domain.limited_listener import is_own_host, listen_limited
from caris_desktop.perception.cameras.camera_process import open_camera
from caris_desktop.perception.cameras.camera_server import CameraServer, NewestFrame
from caris_desktop.perception.cameras.camera_source import ChosenCamera

pytestmark = pytest.mark.logs("more than can be served")


def test_an_address_has_so_many_and_one_more_replaces_one_of_them(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(limited_listener, "_place_of", lambda _host: "192.0.2.1")

    async def test() -> None:
        served: asyncio.Queue[asyncio.StreamWriter] = asyncio.Queue()
        tasks: list[asyncio.Task[None] | None] = []
        listener = listen_limited("127.0.0.1", 0)

        async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            tasks.append(asyncio.current_task())
            served.put_nowait(writer)
            await reader.read(1)
            writer.close()
            with suppress(OSError):
                await writer.wait_closed()

        server = await asyncio.start_server(serve, sock=listener)
        port = server.sockets[0].getsockname()[1]
        held = [await asyncio.open_connection("127.0.0.1", port) for _ in range(200)]
        pending = {asyncio.ensure_future(reader.read(1)) for reader, _ in held}
        while len(pending) > limited_listener.PER_ADDRESS:
            _, pending = await asyncio.wait(pending, return_when=asyncio.FIRST_COMPLETED)
        while not served.empty():
            served.get_nowait()
        again = await asyncio.open_connection("127.0.0.1", port)  # while the others are idle
        newest = await served.get()
        assert newest.get_extra_info("peername") == again[1].get_extra_info("sockname")
        await asyncio.wait(pending, return_when=asyncio.FIRST_COMPLETED)
        assert len(listener._waiting) == limited_listener.PER_ADDRESS
        for _, writer in (*held, again):
            writer.close()
        await asyncio.gather(*filter(None, tasks))
        assert not listener._waiting
        server.close()
        await server.wait_closed()

    asyncio.run(test())
    assert len([one for one in caplog.records if "more than can be served" in one.message]) <= 8


class _Network:
    """Connections to a listener, each from the address that the test says."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._place = ""
        monkeypatch.setattr(limited_listener, "_place_of", lambda _host: self._place)
        self.listener = listen_limited("127.0.0.1", 0, chance=random.Random(1))  # noqa: S311 - a test, not cryptography
        self._clients: list[socket.socket] = []
        self._accepted: list[socket.socket] = []

    def connect(self, place: str) -> Any:
        """The new connection's peer name."""
        self._place = place
        client = socket.create_connection(self.listener.getsockname())
        self._clients.append(client)
        for _ in range(2):  # the first attempt may only end the turn
            with suppress(BlockingIOError):
                self._accepted.append(self.listener.accept()[0])
        held = Counter(one.place for one in self.listener._waiting)
        assert held.pop(limited_listener._HERE, 0) <= limited_listener.IN_ALL
        assert held.total() <= limited_listener.IN_ALL
        assert max(held.values(), default=0) <= limited_listener.PER_ADDRESS
        return client.getsockname()

    def is_served(self, peer_name: Any) -> bool:
        return any(one.peer_name == peer_name for one in self.listener._waiting)

    def close(self) -> None:
        for one in (*self._clients, *self._accepted, self.listener):
            one.close()
        assert not self.listener._waiting


@pytest.mark.parametrize("hostile", [1, 2, 26, limited_listener.IN_ALL - 1])
def test_hostile_addresses_cannot_end_the_only_connection_of_another(
    monkeypatch: pytest.MonkeyPatch, hostile: int
) -> None:
    order = random.Random(2)  # noqa: S311 - a test, not cryptography
    with closing(_Network(monkeypatch)) as network:
        for _ in range(100):
            network.connect(f"hostile {order.randrange(hostile)}")
        owner = network.connect("owner")
        assert network.is_served(owner)
        for _ in range(300):
            network.connect(f"hostile {order.randrange(hostile)}")
            assert network.is_served(owner)


def test_among_hundreds_of_hostile_addresses_most_attempts_succeed_and_each_after_the_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    order = random.Random(3)  # noqa: S311 - a test, not cryptography
    with closing(_Network(monkeypatch)) as network:

        def attempt(place: str) -> bool:
            owner = network.connect(place)
            for _ in range(4):  # connections until the owner's request is read
                network.connect(f"hostile {order.randrange(500)}")
            served = network.is_served(owner)
            network.listener.admit(owner)
            assert not network.is_served(owner)
            return served

        for number in range(100):
            network.connect(f"hostile {number}")
        assert sum(attempt(f"owner {number}") for number in range(100)) >= 80
        assert all(attempt("owner 99") for _ in range(100))


def test_strangers_and_other_users_of_this_computer_leave_room_for_its_user(monkeypatch: pytest.MonkeyPatch) -> None:
    with closing(_Network(monkeypatch)) as network:
        stranger = network.connect("192.0.2.100")
        for number in range(40):
            network.connect(limited_listener._HERE)
            network.connect(f"192.0.2.{number % 26}")
            assert network.is_served(network.connect(limited_listener._HERE))
        assert network.is_served(stranger)


@pytest.mark.parametrize(
    ("host", "place"),
    [
        ("127.0.0.1", "this computer"), ("::1", "this computer"), ("::ffff:127.0.0.1", "this computer"),
        ("192.0.2.7", "192.0.2.7"), ("::ffff:192.0.2.7", "192.0.2.7"),
        ("2001:db8::1", "2001:db8::/64"), ("2001:db8::ffff:1", "2001:db8::/64"), ("fe80::1%eth0", "fe80::/64"),
    ],
)  # fmt: skip
def test_listeners_are_counted_by_address(host: str, place: str) -> None:
    assert limited_listener._place_of(host) == place


@pytest.mark.parametrize(
    ("hosts", "own"),
    [
        (["127.0.0.1:80"], True), (["localhost"], True), (["192.168.1.20:8000"], True), (["[::1]:9"], True),
        (["evil.example"], False), (["127.0.0.1.evil.example"], False), (["localhost", "localhost"], False),
        ([], False), (["[::"], False), ([""], False), (["127.0.0.1@evil.example"], False), (["\udcff"], False),
    ],
)  # fmt: skip
def test_a_page_under_another_name_is_not_answered(hosts: list[str], own: bool) -> None:
    assert is_own_host(hosts) is own


async def _raw(port: int, request: bytes) -> bytes:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(request)
    try:
        async with asyncio.timeout(20):
            return await reader.read(65_536)
    finally:
        writer.close()


def _mutations(path: str, host: str) -> list[bytes]:
    good = f"GET {path} HTTP/1.1\r\nHost: {host}\r\n\r\n".encode()
    bad = [
        b"\x00\x01\x02\r\n\r\n", b"GET //[ HTTP/1.1\r\nHost: x\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: [::\r\n\r\n", b"GET /\xff\xfe HTTP/1.1\r\nHost: x\r\n\r\n",
        b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n", b"GET / HTTP/1.1\r\nAuthorization: \xff\r\nHost: x\r\n\r\n",
        b"GET / HTTP/1.1\r\nContent-Length: -1\r\n\r\n", b"POST /whep HTTP/1.1\r\nContent-Length: 99999999999\r\n\r\n",
        b"GET " + b"/" * 20_000 + b" HTTP/1.1\r\n\r\n",
    ]  # fmt: skip
    for number in range(200):
        changed = bytearray(good)
        changed[number * 7 % (len(good) - 4)] = (number * 37) % 256
        bad.append(bytes(changed))
    return bad


def test_no_request_ends_the_page_of_the_face_or_fills_the_log(caplog: pytest.LogCaptureFixture) -> None:
    async def test() -> None:
        page = FacePage(lambda _pages: None)
        address = await page.open(network=False)
        host, token = address.split("/")[2:4]
        port = int(host.rpartition(":")[2])
        for request in _mutations(f"/{token}/", host):
            if request.endswith(b"\r\n\r\n"):
                await _raw(port, request)
        named = await _raw(port, f"GET /{token}/ HTTP/1.1\r\nHost: evil.example:{port}\r\n\r\n".encode())
        assert b"404" in named.split(b"\r\n")[0]
        assert (
            b"200" in (await _raw(port, f"GET /{token}/ HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())).split(b"\r\n")[0]
        )
        await page.close()

    with caplog.at_level(logging.INFO):
        asyncio.run(test())
    assert sum(len(record.getMessage()) for record in caplog.records) < 10_000


@pytest.mark.parametrize("token", ["", "a-token-of-enough-characters"])
def test_no_request_ends_the_camera_server(caplog: pytest.LogCaptureFixture, token: str) -> None:
    async def test() -> None:
        frames = NewestFrame(ChosenCamera("simulated", "", "s"), open_camera)
        server = CameraServer(frames, token=token)
        listening = await server.serve("127.0.0.1", 0)
        port = listening.sockets[0].getsockname()[1]
        for request in _mutations("/clock", f"127.0.0.1:{port}"):
            if request.endswith(b"\r\n\r\n"):
                await _raw(port, request.replace(b"HTTP/1.1\r\n", b"HTTP/1.1\r\nContent-Length: 0\r\n", 1))
        head = f"Host: 127.0.0.1:{port}\r\nAuthorization: Bearer {token}\r\n"
        assert b"200 OK" in await _one(port, f"GET /clock HTTP/1.1\r\n{head}\r\n".encode())
        listening.close()
        await server.close()

    async def _one(port: int, request: bytes) -> bytes:
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(request)
        line = await reader.readline()
        writer.close()
        return line

    asyncio.run(test())
    assert not [one for one in caplog.records if one.levelno >= logging.ERROR]
