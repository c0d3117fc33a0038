"""What is asked of a model in any dialect, and what a message of its answer says."""

import json
from collections.abc import Sequence
from typing import Any, Literal

from caris_desktop.conversation.models.endpoint import ModelEndpoint
from caris_desktop.conversation.models.failures import unusable
from caris_desktop.domain.events import ChatMessage
from caris_desktop.domain.value_class import dataclass

Schema = dict[str, Any]
Cut = Literal["", "length", "filter"]
"""Why an answer ends before its end: it reached its limit, or the server's filter stopped it."""

REASONING_TOKENS = 8192
"""How much more a model may write than its answer where its server counts what it thinks, and thinking stays on."""


@dataclass(frozen=True, slots=True)
class Question:
    """One question. ``seed`` makes the same model answer alike. ``jpegs`` are pictures that go with the last message.
    ``schema`` is the JSON schema that the answer has to follow; with ``schema_in_object`` it is asked for as servers do
    that know a JSON object only. ``slot`` is which memory of the embedded server answers, None for whichever is free.
    """

    messages: Sequence[ChatMessage]
    max_tokens: int
    temperature: float
    seed: int | None = None
    jpegs: Sequence[bytes] = ()
    schema: Schema | None = None
    schema_in_object: bool = False
    slot: int | None = None


@dataclass(frozen=True, slots=True)
class Request:
    """As it is posted: ``path`` below the address of the server. ``bounded``: the server ends the answer itself at the
    limit of the question; else the limit has room for reasoning, or there is none.
    """

    path: str
    body: dict[str, Any]
    bounded: bool = True


@dataclass(frozen=True, slots=True)
class Chunk:
    """What one message of the stream said. ``alive`` is True for text the wizard does not see (a model's reasoning),
    ``unfinished`` where it says itself that more follows, ``closed`` where the stream is over, whether or not the
    answer is. ``why`` is the server's word for a cut.
    """

    text: str = ""
    alive: bool = False
    ended: bool = False
    unfinished: bool = False
    closed: bool = False
    version: str = ""
    cut: Cut = ""
    why: str = ""


def json_object(endpoint: ModelEndpoint, document: str) -> dict[str, Any]:
    """Raises UnusableError where it is none."""
    try:
        message = json.loads(document)
    except (ValueError, RecursionError):
        raise unusable(endpoint, f"“{document[:60]}” is not JSON") from None
    if not isinstance(message, dict):
        raise unusable(endpoint, "a message is not a JSON object")
    return message
