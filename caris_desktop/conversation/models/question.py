"""Questions, requests and answer chunks, independent of the dialect, and messages of a streamed response."""

import asyncio
import base64
import codecs
import json
import re
import zlib
from collections.abc import AsyncGenerator, Sequence
from contextlib import aclosing
from typing import TYPE_CHECKING, Any, Literal
from urllib.parse import urlsplit

from caris_desktop.conversation.models.endpoint import ModelEndpoint, shortened, without
from caris_desktop.conversation.models.failures import nonsense, unusable
from caris_desktop.domain.events import ChatMessage
from caris_desktop.domain.value_class import Value

if TYPE_CHECKING:
    import httpx

Schema = dict[str, Any]
Cut = Literal["", "length", "filter"]
"""Why an answer ends before its end: it reached its limit, or the server's filter stopped it."""

REASONING_TOKENS = 8192
"""How much more a model may write than its answer where its server counts what it thinks, and thinking stays on."""


class Question(Value):
    """One question. ``seed`` makes answers reproducible. ``jpegs`` are images for the last message. ``schema`` is a
    JSON schema for the answer; with ``schema_in_object`` it is requested in the format of servers that only support
    JSON objects. ``slot`` selects a cache of the embedded server, None for any free one.
    """

    messages: Sequence[ChatMessage]
    max_tokens: int
    temperature: float
    seed: int | None = None
    jpegs: Sequence[bytes] = ()
    schema: Schema | None = None
    schema_in_object: bool = False
    slot: int | None = None

    @property
    def pictures_base64(self) -> list[str]:
        return [base64.b64encode(jpeg).decode() for jpeg in self.jpegs]


class Request(Value):
    """HTTP request: ``path`` is relative to the server's address. ``bounded``: the server enforces the question's
    limit; else the limit includes reasoning, or there is none.
    """

    path: str
    body: dict[str, Any]
    bounded: bool = True


class Chunk(Value):
    """Content of one message of the stream.

    ``alive``: hidden text such as reasoning; ``unfinished``: it announces more; ``closed``: the stream is over, with or
    without a complete answer. ``why`` is the server's reason for a cut. ``choice`` tells several answers to one
    question apart.
    """

    text: str = ""
    alive: bool = False
    ended: bool = False
    unfinished: bool = False
    closed: bool = False
    version: str = ""
    cut: Cut = ""
    why: str = ""
    choice: str = ""


def recorded_name(endpoint: ModelEndpoint, name: object, key: str | None = None) -> str:
    """Model name from a server, sanitised for the record: no key, no address, only the last part of a path."""
    if not isinstance(name, str) or "://" in name or urlsplit(endpoint.base_url).netloc.lower() in name.lower():
        return ""
    if name.startswith(("/", "~", ".")) or "\\" in name:
        name = name.replace("\\", "/").rstrip("/").rpartition("/")[2]
    return shortened(without(key, name), 100)


def json_object(endpoint: ModelEndpoint, document: str) -> dict[str, Any]:
    """Parse a JSON object. Raises UnusableError."""
    try:
        message = json.loads(document)
    except (ValueError, RecursionError):
        raise unusable(endpoint, f"“{document[:60]}” is not valid JSON") from None
    if not isinstance(message, dict):
        raise unusable(endpoint, "a message is not a JSON object")
    return message


MAX_LINE_BYTES = 1_000_000
_PART_BYTES, _MOST_UNPACKED_BYTES = 65_536, 6_000_000
# Many servers omit or misstate the content type; only certain mismatches are errors.
_OTHER_TYPES = ("text/html", "image/", "audio/", "video/", "application/pdf", "application/xml", "text/xml")


def check_type(endpoint: ModelEndpoint, response: "httpx.Response") -> None:
    """Raises LanguageModelError if the content type excludes an answer."""
    content_type = response.headers.get("content-type", "").lower()
    if content_type.startswith(_OTHER_TYPES):
        what = "a web page" if content_type.startswith("text/html") else content_type
        raise nonsense(endpoint, f"it is {what}")


# Comments and fields of server-sent events other than data.
_FIELD = re.compile(r":|(?:event|id|retry)(?::|$)|$")


async def documents(endpoint: ModelEndpoint, response: "httpx.Response") -> AsyncGenerator[str]:
    """JSON texts of the stream: lines for Ollama, data of server-sent events otherwise."""
    data: list[str] = []
    size = 0
    streams = endpoint.provider == "ollama"
    other = ""
    async with aclosing(_lines(endpoint, response)) as lines:
        async for line in lines:
            if endpoint.provider == "ollama":
                if line.strip():
                    yield line
            elif not streams and line.lstrip().startswith(("{", "[")):
                for document in _whole(await _rest(endpoint, line, lines)):
                    yield document
                return
            elif line.startswith("data:"):
                streams = True
                data.append(line[5:].removeprefix(" "))
                size += len(line)
                if size > MAX_LINE_BYTES:
                    raise nonsense(endpoint, "one message is over a megabyte")
            elif line.removeprefix("error:").lstrip().startswith("{"):
                # Some servers send a bare JSON error within a stream.
                yield line.removeprefix("error:")
            elif not line and data:
                for document in _messages(data):
                    yield document
                data, size = [], 0
            elif not _FIELD.match(line):
                other = other or line.strip()
    for document in _messages(data):
        yield document
    if other and not streams:
        yield other


async def _rest(endpoint: ModelEndpoint, first: str, lines: AsyncGenerator[str]) -> list[str]:
    """All lines of a response without streaming."""
    found, size = [first], len(first)
    async for line in lines:
        found.append(line)
        size += len(line)
        if size > MAX_LINE_BYTES:
            raise nonsense(endpoint, "the answer is over a megabyte")
    return found


def _whole(lines: list[str]) -> list[str]:
    """Messages of a complete response: one object, a list of them, or one per line."""
    try:
        message = json.loads("\n".join(lines))
    except (ValueError, RecursionError):
        return [line for line in lines if line.strip()]
    return [json.dumps(each) for each in (message if isinstance(message, list) else [message])]


def _messages(data: list[str]) -> list[str]:
    """One message, or several if the server omitted the empty line between them."""
    if len(data) < 2:
        return data
    message = "\n".join(data)
    try:
        json.loads(message)
    except (ValueError, RecursionError):
        return data
    return [message]


async def _lines(endpoint: ModelEndpoint, response: "httpx.Response") -> AsyncGenerator[str]:
    """Lines without their ends; unlike httpx's, limited in length."""
    pending = bytearray()
    async with aclosing(_blocks(response)) as blocks:
        async for block in blocks:
            *lines, rest = block.split(b"\n")
            for part in lines:
                pending += part
                if len(pending) > MAX_LINE_BYTES:
                    break
                yield _decoded(endpoint, bytes(pending).removesuffix(b"\r"))
                pending.clear()
            else:
                pending += rest
            if len(pending) > MAX_LINE_BYTES:
                raise nonsense(endpoint, "one line is over a megabyte")
    if pending:
        yield _decoded(endpoint, bytes(pending))


def _decoded(endpoint: ModelEndpoint, line: bytes) -> str:
    try:
        return line.removeprefix(codecs.BOM_UTF8).decode("utf-8")
    except UnicodeDecodeError:
        raise nonsense(endpoint, "it is not UTF-8 text") from None


async def small_object(response: "httpx.Response", limit_bytes: int) -> dict[str, Any]:
    """JSON object of a response, or the first of a list; empty if it is something else or too long."""
    return object_in(await small_body(response, limit_bytes))


async def small_body(response: "httpx.Response", limit_bytes: int) -> bytes:
    """Response body, truncated at the limit."""
    body = bytearray()
    async with aclosing(_blocks(response)) as blocks:
        async for block in blocks:
            body += block
            if len(body) > limit_bytes:
                break
    return bytes(body)


async def _blocks(response: "httpx.Response") -> AsyncGenerator[bytes]:
    """Blocks of a body, unpacked here in small parts, since httpx unpacks a block, and what is packed in it, at once.

    Raises httpx.HTTPError.
    """
    import httpx

    coding = response.headers.get("content-encoding", "identity").strip().lower()
    if coding not in ("identity", "gzip", "x-gzip", "deflate"):
        raise httpx.DecodingError(f"the answer is packed as {shortened(coding, 40)}")
    unpacker = zlib.decompressobj(zlib.MAX_WBITS | 32)
    size = 0
    async with aclosing(response.aiter_raw()) as blocks:  # type: ignore[type-var]  # typed as an iterator
        async for block in blocks:
            if coding == "identity":
                yield block
                continue
            part, packed = b"", block
            while packed or len(part) == _PART_BYTES:
                try:
                    part = unpacker.decompress(packed, _PART_BYTES)
                except zlib.error as error:
                    raise httpx.DecodingError("the answer cannot be unpacked") from error
                packed = unpacker.unconsumed_tail
                size += len(part)
                if size > _MOST_UNPACKED_BYTES:
                    raise httpx.DecodingError("the unpacked answer is too long")
                yield part
                await asyncio.sleep(0)  # so that timeouts come


def object_in(body: bytes) -> dict[str, Any]:
    """JSON object in a body, or the only one of a list; empty if it is something else."""
    try:
        message = json.loads(body)
    except (ValueError, RecursionError):
        return {}
    if isinstance(message, list) and len(message) == 1:
        message = message[0]  # as Gemini wraps its errors
    return message if isinstance(message, dict) else {}
