import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

import httpx
import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from caris_desktop.conversation.face.drawing import FaceState, drawing_of
from caris_desktop.conversation.face.face_file import Face
from caris_desktop.conversation.face.page import FacePage, drawn

FACE = Face("A")


@asynccontextmanager
async def served(told: Callable[[int], None] = lambda _pages: None) -> AsyncIterator[tuple[FacePage, str]]:
    page = FacePage(told)
    address = await page.open(network=False)
    try:
        yield page, address
    finally:
        await page.close()


def run(story: Callable[[], Awaitable[None]]) -> None:
    asyncio.run(asyncio.wait_for(story(), 20))


def test_the_page_is_served_to_its_address_and_to_nobody_else() -> None:
    async def story() -> None:
        async with served() as (_page, address), httpx.AsyncClient() as client:
            found = await client.get(address)
            assert found.status_code == 200 and "WebSocket" in found.text and "NONCE" not in found.text
            policy = found.headers["content-security-policy"]
            assert "default-src 'none'" in policy and "unsafe-eval" not in policy
            assert found.headers["referrer-policy"] == "no-referrer"
            host = address.split("/")[2]
            for path in ("/", "/wrong/", f"/{address.split('/')[3]}/other", "/wrong/face", "/../etc/passwd"):
                assert (await client.get(f"http://{host}{path}")).status_code == 404, path
            with pytest.raises(InvalidStatus):
                await connect(f"ws://{host}/wrong/face")
            assert host.startswith("127.0.0.1:")

    run(story)


def test_a_page_gets_what_is_shown_now_each_change_and_a_sign_of_life() -> None:
    told: list[int] = []

    async def story() -> None:
        async with served(told.append) as (page, address):
            page.show(drawn(drawing_of(FACE, FaceState())))
            async with connect(address.replace("http", "ws") + "face") as socket:
                first = json.loads(await socket.recv())
                assert [shape["kind"] for shape in first["drawing"]["shapes"]] == ["box", "box", "lips"]
                page.show(drawn(drawing_of(FACE, FaceState(), caption="Hello")))
                assert json.loads(await socket.recv())["drawing"]["shapes"][-1]["text"] == "Hello"
                page.show(b"\xff\xd8 a picture")
                assert await socket.recv() == b"\xff\xd8 a picture"
                assert await socket.recv() == b"\xff\xd8 a picture", "though nothing changed"
                assert told == [1]
        assert told == [1, 0]

    run(story)


def test_a_page_that_does_not_read_holds_up_nobody_and_gets_the_newest() -> None:
    async def story() -> None:
        async with (
            served() as (page, address),
            connect(address.replace("http", "ws") + "face", max_queue=1) as slow,
        ):
            for number in range(1000):
                page.show(drawn(drawing_of(FACE, FaceState(), caption=f"{number} " + 2000 * "word ")))
                await asyncio.sleep(0)
            seen: list[str] = []
            while not seen or not seen[-1].startswith("999 "):
                told = json.loads(await slow.recv())
                seen += [told["drawing"]["shapes"][-1]["text"]] if told else []
            assert len(seen) < 1000, "what came between was left out"

    run(story)
