"""Camera server in this process over real sockets: authorised clients, answers and their age."""

import asyncio
import base64
import json
import threading
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from caris_desktop.domain import clock
from caris_desktop.perception.cameras import camera_server
from caris_desktop.perception.cameras.camera_server import PIECE, RATE_HZ, CameraServer, NewestFrame, ServedSound, Take
from caris_desktop.perception.cameras.camera_source import (
    CameraError,
    CameraSource,
    ChosenCamera,
    Picture,
    parse_camera,
)
from caris_desktop.perception.cameras.http_camera import MultipartReader
from caris_desktop.perception.cameras.webrtc_camera import WebRtcCamera

TOKEN = "0123456789abcdef"


class NumberedCamera:
    """Camera double with a limited number of frames, each with its number as grey value."""

    width_px, height_px, fps = 64, 48, None

    def __init__(self, *, size_px: tuple[int, int] = (64, 48), at_most: int = 1_000_000) -> None:
        self.number = 0
        self.size_px = size_px
        self.at_most = at_most
        self.closed = False

    def read(self) -> Picture | None:
        assert not self.closed
        self.number += 1
        if self.number > self.at_most:
            raise CameraError("It was unplugged.", "Plug it in.")
        width_px, height_px = self.size_px
        noise = np.random.default_rng(self.number).integers(0, 256, (height_px, width_px, 3), np.uint8)
        return Picture(noise if width_px > 64 else np.full((height_px, width_px, 3), self.number % 256, np.uint8))

    def close(self) -> None:
        self.closed = True


class Client:
    """One connection that sends scripted requests."""

    def __init__(self, port: int) -> None:
        self._port = port

    async def open(self) -> None:
        self.reader, self.writer = await asyncio.open_connection("127.0.0.1", self._port)

    async def send(self, content: bytes) -> None:
        self.writer.write(content)
        await self.writer.drain()

    async def ask(self, method: str, path: str, body: bytes = b"", **head: str) -> tuple[int, dict[str, str], bytes]:
        head = {"Host": "127.0.0.1", "Content-Length": str(len(body)), **head}
        lines = "".join(f"{name.replace('_', '-')}: {value}\r\n" for name, value in head.items())
        await self.send(f"{method} {path} HTTP/1.1\r\n{lines}\r\n".encode() + body)
        return await self.answer()

    async def answer(self) -> tuple[int, dict[str, str], bytes]:
        status, *lines = (await self.reader.readuntil(b"\r\n\r\n")).decode().split("\r\n")
        head = {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in lines)}
        content = await self.reader.readexactly(int(head.get("content-length", "0")))
        return int(status.split()[1]), head, content

    async def close(self) -> None:
        self.writer.close()


def served(
    test: Callable[[NewestFrame, Callable[[], Awaitable[Client]]], Awaitable[None]],
    *,
    token: str = "",
    sound: ServedSound | None = None,
    open_one: Callable[[ChosenCamera], CameraSource] | None = None,
) -> None:
    """Run ``test(frames, new_client)`` with a running server."""

    async def run() -> None:
        frames = NewestFrame(parse_camera("0"), open_one or (lambda _chosen: NumberedCamera()))
        server = CameraServer(frames, token=token, sound=sound)
        listening = await server.serve("127.0.0.1", 0)
        reading = asyncio.create_task(frames.run())
        clients: list[Client] = []

        async def new_client() -> Client:
            clients.append(Client(listening.sockets[0].getsockname()[1]))
            await clients[-1].open()
            return clients[-1]

        try:
            await asyncio.wait_for(test(frames, new_client), 20.0)
        finally:
            for client in clients:
                await client.close()
            listening.close()
            reading.cancel()
            await asyncio.gather(reading, return_exceptions=True)
            await server.close()

    asyncio.run(run())


pytestmark = pytest.mark.logs("camera_server: .* delivers")


def test_pictures_come_one_after_the_other_with_the_time_at_which_they_were_taken() -> None:
    async def test(_frames: NewestFrame, new_client: Callable[[], Awaitable[Client]]) -> None:
        one, other = await new_client(), await new_client()
        for client in (one, other):
            status, head, _ = await client.ask("GET", "/video.mjpg")
            assert (status, head["x-clock"]) == (200, "/clock")
            parts = MultipartReader(head["content-type"].partition("boundary=")[2])
            captured = []
            while len(captured) < 5:
                part = parts.add(await client.reader.read(4096))
                if part is not None:
                    told, content = part
                    assert cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR).shape == (48, 64, 3)
                    captured.append(int(told["x-captured-monotonic-ns"]))
                    assert abs(float(told["x-timestamp"]) * 1e9 - clock.ClockAnchor.take().utc_ns) < 20e9
            assert captured == sorted(set(captured))
            assert 0 <= clock.now_ns() - captured[-1] < 20e9
        asker = await new_client()
        before_ns = clock.now_ns()
        told_ns = [int((await asker.ask("GET", "/clock"))[2]) for _ in range(2)]
        assert before_ns <= told_ns[0] <= told_ns[1] <= clock.now_ns()
        status, head, content = await asker.ask("GET", "/picture.jpg")
        assert (status, head["content-type"], content[:2]) == (200, "image/jpeg", b"\xff\xd8")
        about = json.loads((await asker.ask("GET", "/"))[2])
        assert (about["state"], about["pictures"] > 0) == ("connected", True)

    served(test)


def test_a_slow_client_gets_the_newest_picture_and_not_the_missed_ones() -> None:
    async def test(frames: NewestFrame, new_client: Callable[[], Awaitable[Client]]) -> None:
        client = await new_client()
        _, head, _ = await client.ask("GET", "/video.mjpg")
        parts = MultipartReader(head["content-type"].partition("boundary=")[2])
        stalled_at = frames.sequence
        await frames.after(stalled_at + 15)
        went_on_ns = clock.now_ns()
        captured: list[int] = []
        while not captured or captured[-1] < went_on_ns:
            part = parts.add(await client.reader.read(65_536))
            if part is not None:
                captured.append(int(part[0]["x-captured-monotonic-ns"]))
        assert len(captured) <= 5, "of the fifteen that it missed only what was on its way already"

    served(test, open_one=lambda _chosen: NumberedCamera(size_px=(1280, 720)))


def test_without_a_token_only_this_computer_is_answered() -> None:
    async def test(_frames: NewestFrame, new_client: Callable[[], Awaitable[Client]]) -> None:
        assert (await (await new_client()).ask("GET", "/", Host="localhost:8090"))[0] == 200
        assert (await (await new_client()).ask("GET", "/", Host="camera.example"))[0] == 403

    served(test)


def test_with_a_token_nobody_else_is_answered() -> None:
    basic = base64.b64encode(f"any:{TOKEN}".encode()).decode()
    wrong = base64.b64encode(b"any:other").decode()

    async def test(_frames: NewestFrame, new_client: Callable[[], Awaitable[Client]]) -> None:
        for path in ("/", "/video.mjpg", "/picture.jpg", "/clock", "/whep/x/stamps"):
            for told in (
                {},
                {"Authorization": "Bearer no"},
                {"Authorization": f"Basic {wrong}"},
                {"Authorization": "Basic §"},
            ):
                status, head, content = await (await new_client()).ask("GET", path, **told)
                assert (status, "basic" in head["www-authenticate"].lower()) == (401, True)
                assert TOKEN.encode() not in content
        for told in (f"Bearer {TOKEN}", f"Basic {basic}"):
            status, _, _ = await (await new_client()).ask("GET", "/", Host="camera.example", Authorization=told)
            assert status == 200

    served(test, token=TOKEN)


def test_a_malformed_request_is_refused_and_the_others_continue() -> None:
    async def test(_frames: NewestFrame, new_client: Callable[[], Awaitable[Client]]) -> None:
        for sent in (
            b"GARBAGE\r\n\r\n",
            b"GET / SMTP/1\r\n\r\n",
            b"GET / HTTP/1.1\r\nX: " + b"a" * 20_000 + b"\r\n\r\n",
            b"POST /whep HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 99999999\r\n\r\n",
            b"POST /whep HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\n\r\n",
        ):
            client = await new_client()
            await client.send(sent)
            assert (await client.answer())[0] == 400, sent[:40]
        (await new_client()).writer.transport.abort()
        good = await new_client()
        assert (await good.ask("GET", "/nothing"))[0] == 404
        assert (await good.ask("POST", "/whep", b"v=0", Content_Type="text/plain"))[0] == 415
        assert (await good.ask("POST", "/whep", b"no sdp", Content_Type="application/sdp"))[0] == 400
        for body in (b"{}", b"[]", b"\xff", json.dumps({"sdp": "v=0", "type": "offer"}).encode()):
            assert (await good.ask("POST", "/offer", body, Content_Type="application/json"))[0] == 400
        assert (await good.ask("DELETE", "/whep/nobody"))[0] == 404
        assert (await good.ask("GET", "/"))[0] == 200

    served(test)


def test_more_clients_than_it_can_bear_are_reported_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_server, "MOST_CLIENTS", 2)

    async def test(_frames: NewestFrame, new_client: Callable[[], Awaitable[Client]]) -> None:
        for _ in range(2):
            assert (await (await new_client()).ask("GET", "/video.mjpg"))[0] == 200
        third = await new_client()
        assert (await third.ask("GET", "/video.mjpg"))[0] == 503

    served(test)


@pytest.mark.logs("camera_server: It was unplugged")
def test_those_who_leave_a_lost_camera_make_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_server, "MOST_CLIENTS", 2)

    def unplugged(_chosen: ChosenCamera) -> CameraSource:
        raise CameraError("It was unplugged.", "")

    async def test(_frames: NewestFrame, new_client: Callable[[], Awaitable[Client]]) -> None:
        for _ in range(5):
            client = await new_client()
            assert (await client.ask("GET", "/video.mjpg"))[0] == 200
            await client.close()
            await asyncio.sleep(0.1)
        assert (await (await new_client()).ask("GET", "/"))[0] == 200

    served(test, open_one=unplugged)


@pytest.mark.logs("camera_server: It was unplugged", "camera_server: .* delivers")
def test_a_camera_that_is_lost_comes_back_to_those_who_still_look(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(camera_server, "_RETRY_AFTER_S", (0.02,))
    cameras: list[NumberedCamera] = []

    def open_one(_chosen: ChosenCamera) -> CameraSource:
        cameras.append(NumberedCamera(at_most=3))
        return cameras[-1]

    async def test(frames: NewestFrame, _new_client: Callable[[], Awaitable[Client]]) -> None:
        states: list[Any] = []
        while len(cameras) < 3:
            await frames.after(frames.sequence)
            states.append(frames.state)
        assert frames.sequence >= 6
        assert set(states) <= {"connected", "lost"}

    served(test, open_one=open_one)
    assert all(camera.closed for camera in cameras)


class Tone:
    """Source of a 440 Hz tone while a client listens."""

    def __init__(self) -> None:
        self.ended = threading.Event()
        self._thread: threading.Thread | None = None

    def begin(self, take: Take) -> None:
        self.ended.clear()
        self._thread = threading.Thread(target=self._run, args=(take,))
        self._thread.start()

    def end(self) -> None:
        self.ended.set()
        if self._thread is not None:
            self._thread.join()

    @property
    def open(self) -> bool:
        return self._thread is not None and not self.ended.is_set()

    def _run(self, take: Take) -> None:
        number = 0
        while not self.ended.wait(PIECE / RATE_HZ):
            at = np.arange(number * PIECE, (number + 1) * PIECE)
            take((np.sin(at * 2 * np.pi * 440 / RATE_HZ) * 8000).astype(np.int16))
            number += 1


@pytest.mark.logs("aioice|webrtc")
def test_sound_comes_next_to_the_picture_where_permitted_and_opens_the_microphone_only_then() -> None:
    source = Tone()

    def look(port: int, *, listen: bool) -> list[tuple[int, Any]]:
        chosen = replace(parse_camera(f"whep+http://127.0.0.1:{port}/whep"), sound=listen)
        camera, chunks = WebRtcCamera(chosen), list[tuple[int, Any]]()
        camera.on_sound = lambda stamp_ns, samples: chunks.append((stamp_ns, samples))
        try:
            until_ns = clock.now_ns() + 8_000_000_000
            while clock.now_ns() < until_ns and sum(len(samples) for _, samples in chunks) < (16000 if listen else 1):
                assert camera.read() is not None
                if not listen:
                    break
        finally:
            camera.close()
        return chunks

    async def test(_frames: NewestFrame, new_client: Callable[[], Awaitable[Client]]) -> None:
        port = (await new_client())._port
        assert await asyncio.to_thread(look, port, listen=False) == []
        assert not source.open
        chunks = await asyncio.to_thread(look, port, listen=True)
        samples = np.concatenate([piece[:, 0] for _, piece in chunks]).astype(float)
        assert np.argmax(np.abs(np.fft.rfft(samples[-8000:]))) * 2 == pytest.approx(440, abs=6)
        length_ns = (len(samples) - len(chunks[-1][1])) * 1_000_000_000 // 16000
        assert chunks[-1][0] - chunks[0][0] == pytest.approx(length_ns, rel=0.1)
        assert await asyncio.to_thread(source.ended.wait, 10.0), "nobody listens any more"

    served(test, sound=ServedSound(source))
