"""Dialect of OpenAI's chat completions, used by many servers including the embedded one.

https://platform.openai.com/docs/api-reference/chat
"""

import re
from typing import Any
from urllib.parse import urlsplit

from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint
from caris_desktop.conversation.models.failures import blocked, raise_error_object, unusable
from caris_desktop.conversation.models.question import (
    REASONING_TOKENS,
    Chunk,
    Cut,
    Question,
    Request,
    Schema,
    recorded_name,
)
from caris_desktop.domain.translation import QT_TR_NOOP

_REASONS = re.compile(r"o\d|gpt-[5-9]")
_CUTS: dict[object, Cut] = {"length": "length", "max_tokens": "length", "content_filter": "filter"}
_PARTS = ("text", "output_text")


def request(endpoint: ModelEndpoint, question: Question) -> Request:
    """Build the request. Raises LanguageModelError if the model does not support all of it."""
    written: list[dict[str, Any]] = [
        {"role": message.role, "content": message.content} for message in question.messages
    ]
    if question.jpegs:
        if endpoint.provider == "embedded":
            raise LanguageModelError(
                QT_TR_NOOP("The embedded language model cannot process pictures."),
                QT_TR_NOOP("The assistant cannot answer."),
                QT_TR_NOOP("Ask without the picture, or choose another model."),
            )
        pictures = [
            {"type": "image_url", "image_url": {"url": f"data:image/jpeg;base64,{picture}"}}
            for picture in question.pictures_base64
        ]
        written[-1]["content"] = [{"type": "text", "text": written[-1]["content"]}, *pictures]
    # OpenAI's newer models refuse the old name; compatible servers often know only that one.
    limit_name = "max_completion_tokens" if endpoint.is_openai else "max_tokens"
    reasons = endpoint.is_openai and bool(_REASONS.match(endpoint.model))
    body: dict[str, Any] = {
        "model": endpoint.model,
        "messages": written,
        "stream": True,
        # Reasoning counts towards the limit.
        limit_name: question.max_tokens + (REASONING_TOKENS if reasons else 0),
        "temperature": question.temperature,
    }
    if reasons:
        body["reasoning_effort"] = "low"
    if question.seed is not None and endpoint.takes_seed:
        body["seed"] = question.seed
    if question.schema is not None and question.schema_in_object:
        # https://github.com/abetlen/llama-cpp-python#json-schema-mode
        body["response_format"] = {"type": "json_object", "schema": question.schema}
    elif question.schema is not None:
        body["response_format"] = {
            "type": "json_schema",
            "json_schema": {"name": "answer", "strict": _is_closed(question.schema), "schema": question.schema},
        }
    if endpoint.provider == "embedded":
        # Reuse the common prefix with the previous question.
        body["cache_prompt"] = True
        if question.slot is not None:
            body["id_slot"] = question.slot
    path = ("" if urlsplit(endpoint.base_url).path else "v1/") + "chat/completions"
    return Request(path, body, bounded=not reasons)


def parse(endpoint: ModelEndpoint, message: dict[str, Any], key: str | None) -> Chunk:
    """Parse a message of the stream, or a complete answer without streaming. Raises LanguageModelError."""
    # Model and fingerprint from a message of the stream.
    parts = [recorded_name(endpoint, message.get("model"), key)]
    if endpoint.provider != "embedded":  # the fingerprint of the embedded build has no information
        parts.append(recorded_name(endpoint, message.get("system_fingerprint"), key))
    version = " ".join(part for part in parts if part)
    choices = message.get("choices")
    if not choices:
        return Chunk(version=version)  # usage or filter results
    choice = choices[0] if isinstance(choices, list) else None
    reply = (choice.get("delta") or choice.get("message") or {}) if isinstance(choice, dict) else None
    if not isinstance(choice, dict) or not isinstance(reply, dict):
        raise unusable(endpoint, QT_TR_NOOP("a choice has no delta"))
    if isinstance(refusal := reply.get("refusal"), str) and refusal:
        raise blocked(endpoint, refusal)
    text, reasons = _text_of(endpoint, reply.get("content") or choice.get("text") or "")
    alive = reasons or bool(reply.get("reasoning_content") or reply.get("reasoning"))
    finish = choice.get("finish_reason")
    if finish == "error":
        raise_error_object(endpoint, {"error": "the server gave no reason"}, key)
    unfinished = "finish_reason" in choice and not finish
    cut = _CUTS.get(finish, "") if isinstance(finish, str) else ""
    return Chunk(text, alive, bool(finish), unfinished, version=version, cut=cut, why=str(finish))


def _text_of(endpoint: ModelEndpoint, content: object) -> tuple[str, bool]:
    """Text of a content, possibly in parts, and whether any part is reasoning."""
    if isinstance(content, str):
        return content, False
    parts = [part for part in content if isinstance(part, dict)] if isinstance(content, list) else []
    if not parts:
        raise unusable(endpoint, QT_TR_NOOP("the content is not text"))
    texts = [part.get("text") for part in parts if part.get("type", "text") in _PARTS]
    return "".join(text for text in texts if isinstance(text, str)), len(texts) < len(parts)


def refuses_schema(request: Request, status: int, error_text: str) -> bool:
    """True if the server refused because it does not know this schema format."""
    return (
        "json_schema" in request.body.get("response_format", ())
        and status in (400, 422, 500, 501)
        and ("response_format" in error_text or "json_schema" in error_text)
    )


def _is_closed(schema: Schema) -> bool:
    """True if the schema is closed, as strict mode requires: all keys required, no others."""
    if schema.get("type") == "object":
        named = schema.get("properties", {})
        if schema.get("additionalProperties") is not False or set(schema.get("required", ())) != set(named):
            return False
        return all(_is_closed(each) for each in named.values())
    inner = [schema["items"]] if isinstance(schema.get("items"), dict) else []
    return all(_is_closed(each) for each in (*inner, *schema.get("anyOf", ())))
