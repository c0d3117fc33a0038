"""Requests and answer chunks, independent of the dialect."""

import base64
import json
from collections.abc import Sequence
from typing import Any, Literal
from urllib.parse import urlsplit

from caris_desktop.conversation.models.endpoint import ModelEndpoint
from caris_desktop.conversation.models.failure_texts import shortened, without
from caris_desktop.conversation.models.failures import unusable
from caris_desktop.domain.events import ChatMessage
from caris_desktop.domain.value_class import Value

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
    """Content of one message of the stream. ``alive``: hidden text such as reasoning; ``unfinished``: it announces
    more; ``closed``: the stream is over, with or without a complete answer. ``why`` is the server's reason for a cut.
    """

    text: str = ""
    alive: bool = False
    ended: bool = False
    unfinished: bool = False
    closed: bool = False
    version: str = ""
    cut: Cut = ""
    why: str = ""


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
