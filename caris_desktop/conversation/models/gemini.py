"""Dialect of Gemini's v1beta API. https://ai.google.dev/api/generate-content"""

import re
from typing import Any
from urllib.parse import quote, urlsplit

from caris_desktop.conversation.models.endpoint import ModelEndpoint
from caris_desktop.conversation.models.failures import blocked, unusable
from caris_desktop.conversation.models.question import (
    REASONING_TOKENS,
    Chunk,
    Cut,
    Question,
    Request,
    Schema,
    recorded_name,
)

_ROLES = {"user": "user", "assistant": "model"}
_CUTS: dict[str, Cut] = {"STOP": "", "MAX_TOKENS": "length"}
_VERSION = re.compile(r"gemini-(\d+)(?:\.(\d+))?")
# Keys of https://ai.google.dev/api/caching#Schema; any other makes it refuse the request.
_SCHEMA_KEYS = (
    "format", "title", "description", "nullable", "enum", "maxItems", "minItems", "required", "minProperties",
    "maxProperties", "minLength", "maxLength", "pattern", "minimum", "maximum", "propertyOrdering",
)  # fmt: skip


def request(endpoint: ModelEndpoint, question: Question) -> Request:
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
        config |= {"responseMimeType": "application/json", "responseSchema": schema_of(question.schema)}
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


def parse(endpoint: ModelEndpoint, message: dict[str, Any], key: str | None) -> Chunk:
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
    text, alive = _text_of(endpoint, candidate.get("content") or {})
    reason = str(candidate.get("finishReason") or "")
    cut = _CUTS.get(reason, "filter") if reason else ""
    return Chunk(text, alive, ended=bool(reason), version=version, cut=cut, why=reason)


def _text_of(endpoint: ModelEndpoint, content: object) -> tuple[str, bool]:
    """Text of a message, and whether it is reasoning."""
    parts = (content.get("parts") or []) if isinstance(content, dict) else None
    if not isinstance(parts, list) or not all(isinstance(part, dict) for part in parts):
        raise unusable(endpoint, "a candidate has no parts")
    texts = [part.get("text") or "" for part in parts if not part.get("thought")]
    if not all(isinstance(text, str) for text in texts):
        raise unusable(endpoint, "a part is not text")
    return "".join(texts), any(part.get("thought") for part in parts)


def schema_of(schema: Schema) -> Schema:
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
        written["properties"] = {name: schema_of(inner) for name, inner in schema["properties"].items()}
        written.setdefault("propertyOrdering", list(schema["properties"]))
    if isinstance(schema.get("items"), dict):
        written["items"] = schema_of(schema["items"])
    choices = schema.get("anyOf", schema.get("oneOf"))
    if choices:
        written["anyOf"] = [schema_of(inner) for inner in choices]
    return written
