"""Model server on loopback that answers correctly, misbehaves or vanishes."""

import asyncio
import contextlib
import json
import ssl
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field

import pytest

from caris_desktop.conversation.models.chat import ChatTimeouts, Retries, stream_chat
from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint
from caris_desktop.domain.events import ChatMessage

QUESTION = (ChatMessage("system", "You guide tours."), ChatMessage("user", "Where is the café?"))
SSE_HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: text/event-stream\r\nConnection: close\r\n\r\n"
LINES_HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: application/x-ndjson\r\nConnection: close\r\n\r\n"
# No test depends on the speed of the machine, except tests of timeouts.
PATIENT = ChatTimeouts(connect_s=20.0, first_token_s=20.0, between_tokens_s=20.0)
AT_ONCE = Retries(at_most=0)


@dataclass
class Served:
    """One server: its requests, and whether a client disconnected before the end of an answer."""

    url: str = ""
    heads: list[str] = field(default_factory=list)
    bodies: list[dict[str, object]] = field(default_factory=list)
    client_gone: asyncio.Event = field(default_factory=asyncio.Event)


Answer = Callable[[asyncio.StreamWriter], Awaitable[None]]


@asynccontextmanager
async def serving(answer: Answer, *, tls: ssl.SSLContext | None = None) -> AsyncIterator[Served]:
    served = Served()

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        # Cancelled tasks at the end of the loop and disconnected clients are errors to a stream server.
        with contextlib.suppress(asyncio.CancelledError, asyncio.IncompleteReadError, ConnectionError):
            await converse(reader, writer)

    async def converse(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        head = (await reader.readuntil(b"\r\n\r\n")).decode()
        lengths = [int(line.split(":")[1]) for line in head.splitlines() if line.lower().startswith("content-len")]
        served.heads.append(head)
        if lengths:
            served.bodies.append(json.loads(await reader.readexactly(lengths[0])))
        speaking = asyncio.ensure_future(answer(writer))
        reading = asyncio.ensure_future(reader.read())
        await asyncio.wait([speaking, reading], return_when=asyncio.FIRST_COMPLETED)
        if reading.done() and not speaking.done():
            served.client_gone.set()
        reading.cancel()
        # A client that has gone while it speaks is no error.
        if not speaking.cancel() and not speaking.cancelled():
            speaking.exception()
        writer.close()

    server = await asyncio.start_server(handle, "127.0.0.1", 0, ssl=tls)
    host, port = server.sockets[0].getsockname()
    served.url = f"{'http' if tls is None else 'https'}://{host}:{port}"
    try:
        yield served
    finally:
        server.close()


def sends(*parts: bytes, then_waits: bool = False) -> Answer:
    async def answer(writer: asyncio.StreamWriter) -> None:
        for part in parts:
            writer.write(part)
            await writer.drain()
            await asyncio.sleep(0.002)
        if then_waits:
            await asyncio.Event().wait()

    return answer


def delta(text: str, finish: str | None = None, **more: str) -> bytes:
    choice = {"index": 0, "delta": {"content": text, **more}, "finish_reason": finish}
    return b"data: " + json.dumps({"choices": [choice]}, ensure_ascii=False).encode() + b"\n\n"


def ollama_line(text: str, *, done: bool = False) -> bytes:
    message = {"message": {"role": "assistant", "content": text}, "done": done}
    return json.dumps(message, ensure_ascii=False).encode() + b"\n"


async def collect(
    endpoint: ModelEndpoint,
    timeouts: ChatTimeouts = PATIENT,
    pieces: list[str] | None = None,
    *,
    retries: Retries = AT_ONCE,
) -> list[str]:
    pieces = [] if pieces is None else pieces
    async for piece in stream_chat(
        endpoint, QUESTION, local_only=False, max_tokens=20, temperature=0.5, timeouts=timeouts, retries=retries
    ):
        pieces.append(piece)
    return pieces


def ask(
    answer: Answer,
    *,
    provider: str = "openai",
    key_env: str | None = None,
    pieces: list[str] | None = None,
    timeouts: ChatTimeouts = PATIENT,
    retries: Retries = AT_ONCE,
) -> tuple[list[str], Served]:
    async def run() -> tuple[list[str], Served]:
        async with serving(answer) as served:
            endpoint = ModelEndpoint(provider, served.url, "some-model", (key_env,) if key_env else ())  # type: ignore[arg-type]
            return await collect(endpoint, timeouts, pieces, retries=retries), served

    return asyncio.run(run())


def refused(
    answer: Answer, *, provider: str = "openai", key_env: str | None = None, timeouts: ChatTimeouts = PATIENT
) -> LanguageModelError:
    with pytest.raises(LanguageModelError) as caught:
        ask(answer, provider=provider, key_env=key_env, timeouts=timeouts)
    return caught.value
