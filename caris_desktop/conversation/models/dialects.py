"""Dialects of language model servers: OpenAI's chat completions, Ollama's API and Gemini's v1beta API."""

import re
from collections.abc import Callable
from typing import Any
from urllib.parse import quote, urlsplit

from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint, Provider
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

_Ask = Callable[[ModelEndpoint, Question], Request]
_Parse = Callable[[ModelEndpoint, dict[str, Any], str | None], Chunk]
_REASONS = re.compile(r"o\d|gpt-[5-9]")
# Finish reasons as servers spell them; any other one, as "stop", "end_turn" or "eos", ends a whole answer.
_REACHED_LIMIT = re.compile(r"length|max_?(?:output_?)?tokens", re.IGNORECASE)
_FILTERED = re.compile(r"filter|safety|sensitive|refus|recitation|prohibited|block|guardrail", re.IGNORECASE)
_FAILED = re.compile(r"error|abort|cancel|insufficient", re.IGNORECASE)
_NO_REASON = ("", "null", "none")
_PARTS = ("text", "output_text")


def _messages(question: Question) -> list[dict[str, Any]]:
    return [{"role": message.role, "content": message.content} for message in question.messages]


def openai_request(endpoint: ModelEndpoint, question: Question) -> Request:
    """Request to OpenAI and the many compatible servers, including the embedded one. Raises LanguageModelError if the
    model does not support all of it. https://platform.openai.com/docs/api-reference/chat
    """
    written = _messages(question)
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


def openai_parse(endpoint: ModelEndpoint, message: dict[str, Any], key: str | None) -> Chunk:
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
    text, reasons = _openai_text(endpoint, reply.get("content") or choice.get("text") or "")
    alive = reasons or any(value and name.startswith(("reasoning", "thinking")) for name, value in reply.items())
    finish = str(choice.get("finish_reason") or "")
    # A complete answer without streaming has no delta, and from simple servers no reason either.
    ended = finish.lower() not in _NO_REASON or ("message" in choice and "delta" not in choice)
    if _FAILED.search(finish):
        reason = "the server gave no reason" if finish == "error" else finish
        raise_error_object(endpoint, {"error": choice.get("error") or reason}, key)
    cut: Cut = "length" if _REACHED_LIMIT.search(finish) else "filter" if _FILTERED.search(finish) else ""
    unfinished = "finish_reason" in choice and not ended
    return Chunk(
        text, alive, ended, unfinished, version=version, cut=cut, why=finish, choice=str(choice.get("index") or 0)
    )


def _openai_text(endpoint: ModelEndpoint, content: object) -> tuple[str, bool]:
    """Text of a content, possibly in parts, and whether any part is reasoning."""
    if isinstance(content, str):
        return content, False
    parts = [part for part in content if isinstance(part, dict)] if isinstance(content, list) else []
    if not parts:
        raise unusable(endpoint, QT_TR_NOOP("the content is not text"))
    texts = [part.get("text") for part in parts if part.get("type", "text") in _PARTS and not part.get("thought")]
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


def ollama_request(endpoint: ModelEndpoint, question: Question) -> Request:
    """Request to Ollama. https://github.com/ollama/ollama/blob/main/docs/api.md"""
    written = _messages(question)
    if question.jpegs:
        written[-1]["images"] = question.pictures_base64
    options: dict[str, Any] = {"num_predict": question.max_tokens, "temperature": question.temperature}
    if question.seed is not None:
        options["seed"] = question.seed
    body: dict[str, Any] = {"model": endpoint.model, "messages": written, "stream": True, "options": options}
    # A conversation cannot wait for reasoning. Models without it accept the field, too.
    body["think"] = False
    if question.schema is not None:
        body["format"] = question.schema
    return Request("api/chat", body)


def ollama_parse(endpoint: ModelEndpoint, message: dict[str, Any], _key: str | None) -> Chunk:
    """Parse a line of the stream. Raises LanguageModelError."""
    ended = message.get("done") is True
    reason = str(message.get("done_reason", ""))
    cut: Cut = "length" if reason == "length" else ""
    inner = message.get("message")
    if inner is None:
        return Chunk(ended=ended, cut=cut, why=reason)
    text = inner.get("content") or "" if isinstance(inner, dict) else None
    if not isinstance(inner, dict) or not isinstance(text, str):
        raise unusable(endpoint, "a message has no content")
    return Chunk(text, alive=bool(inner.get("thinking")), ended=ended, cut=cut, why=reason)


_ROLES = {"user": "user", "assistant": "model"}
_GEMINI_CUTS: dict[str, Cut] = {"STOP": "", "MAX_TOKENS": "length"}
_VERSION = re.compile(r"gemini-(\d+)(?:\.(\d+))?")
# Keys of https://ai.google.dev/api/caching#Schema; any other makes it refuse the request.
_SCHEMA_KEYS = (
    "format", "title", "description", "nullable", "enum", "maxItems", "minItems", "required", "minProperties",
    "maxProperties", "minLength", "maxLength", "pattern", "minimum", "maximum", "propertyOrdering",
)  # fmt: skip


def gemini_request(endpoint: ModelEndpoint, question: Question) -> Request:
    """Request to Gemini. https://ai.google.dev/api/generate-content"""
    system = [message.content for message in question.messages if message.role == "system"]
    contents: list[dict[str, Any]] = [
        {"role": _ROLES[message.role], "parts": [{"text": message.content}]}
        for message in question.messages
        if message.role != "system"
    ]
    for picture in question.pictures_base64:
        contents[-1]["parts"].append({"inlineData": {"mimeType": "image/jpeg", "data": picture}})
    thinks, thinking = _thinking(endpoint.model)
    limit = question.max_tokens + (REASONING_TOKENS if thinks else 0)
    config: dict[str, Any] = {"maxOutputTokens": limit, "temperature": question.temperature}
    if thinking:
        config["thinkingConfig"] = thinking
    if question.seed is not None:
        config["seed"] = question.seed
    if question.schema is not None:
        config |= {"responseMimeType": "application/json", "responseSchema": _gemini_schema(question.schema)}
    body: dict[str, Any] = {"contents": contents, "generationConfig": config}
    if system:
        body["systemInstruction"] = {"parts": [{"text": "\n\n".join(system)}]}
    version = "" if urlsplit(endpoint.base_url).path else "v1beta/"
    name = quote(endpoint.model, safe="")
    return Request(f"{version}models/{name}:streamGenerateContent?alt=sse", body, bounded=not thinks)


def _thinking(model: str) -> tuple[bool, dict[str, Any]]:
    """Whether the model may reason, which counts against its limit, and the setting that minimises it.

    https://ai.google.dev/gemini-api/docs/thinking
    """
    match = _VERSION.match(model)
    if match is None:
        return not model.startswith("gemma"), {}
    version = int(match[1]), int(match[2] or 0)
    if version < (2, 5):
        return "thinking" in model, {}
    if version >= (3, 0):
        return True, {"thinkingLevel": "low"}
    return True, {"thinkingBudget": 128 if "pro" in model else 0}


def gemini_parse(endpoint: ModelEndpoint, message: dict[str, Any], key: str | None) -> Chunk:
    """Parse a message of the stream. Raises LanguageModelError."""
    feedback = message.get("promptFeedback")
    if isinstance(feedback, dict) and feedback.get("blockReason"):
        raise blocked(endpoint, str(feedback["blockReason"]))
    candidates = message.get("candidates") or []
    if not isinstance(candidates, list):
        raise unusable(endpoint, "a message has no candidates")
    version = recorded_name(endpoint, message.get("modelVersion"), key)
    if not candidates:
        return Chunk(version=version)
    candidate = candidates[0]
    if not isinstance(candidate, dict):
        raise unusable(endpoint, "a candidate is not an object")
    text, alive = _gemini_text(endpoint, candidate.get("content") or {})
    reason = str(candidate.get("finishReason") or "")
    cut = _GEMINI_CUTS.get(reason.upper(), "filter") if reason else ""
    return Chunk(text, alive, ended=bool(reason), version=version, cut=cut, why=reason)


def _gemini_text(endpoint: ModelEndpoint, content: object) -> tuple[str, bool]:
    """Text of a message, and whether it is reasoning."""
    parts = (content.get("parts") or []) if isinstance(content, dict) else None
    if not isinstance(parts, list) or not all(isinstance(part, dict) for part in parts):
        raise unusable(endpoint, "a candidate has no parts")
    texts = [part.get("text") or "" for part in parts if not part.get("thought")]
    if not all(isinstance(text, str) for text in texts):
        raise unusable(endpoint, "a part is not text")
    return "".join(texts), any(part.get("thought") for part in parts)


def _gemini_schema(schema: Schema) -> Schema:
    """JSON schema reduced to Gemini's subset."""
    written: Schema = {key: schema[key] for key in _SCHEMA_KEYS if key in schema}
    kinds = schema.get("type", ())
    kinds = [kinds] if isinstance(kinds, str) else list(kinds)
    if "null" in kinds:
        written["nullable"] = True
    if named := [kind for kind in kinds if kind != "null"]:
        written["type"] = str(named[0]).upper()
    if "const" in schema:
        written["enum"] = [schema["const"]]
    if "properties" in schema:
        written["properties"] = {name: _gemini_schema(inner) for name, inner in schema["properties"].items()}
        written.setdefault("propertyOrdering", list(schema["properties"]))
    if isinstance(schema.get("items"), dict):
        written["items"] = _gemini_schema(schema["items"])
    choices = schema.get("anyOf", schema.get("oneOf"))
    if choices:
        written["anyOf"] = [_gemini_schema(inner) for inner in choices]
    return written


DIALECTS: dict[Provider, tuple[_Ask, _Parse]] = {
    "embedded": (openai_request, openai_parse),
    "openai": (openai_request, openai_parse),
    "ollama": (ollama_request, ollama_parse),
    "gemini": (gemini_request, gemini_parse),
}
