"""The dialect of Gemini's v1beta. https://ai.google.dev/api/generate-content"""

import base64
from typing import Any
from urllib.parse import quote, urlsplit

from caris_desktop.conversation.models.endpoint import ModelEndpoint
from caris_desktop.conversation.models.failures import blocked, nonsense, raise_error_object
from caris_desktop.conversation.models.question import Chunk, Question, Request, Schema, json_object
from caris_desktop.conversation.models.words import shortened, without

_ROLES = {"user": "user", "assistant": "model"}
_ENDED_WELL = ("STOP", "MAX_TOKENS")
# What https://ai.google.dev/api/caching#Schema knows; any other key makes it refuse the whole question.
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
    for jpeg in question.jpegs:
        picture = {"mimeType": "image/jpeg", "data": base64.b64encode(jpeg).decode()}
        contents[-1]["parts"].append({"inlineData": picture})
    config: dict[str, Any] = {"maxOutputTokens": question.max_tokens, "temperature": question.temperature}
    if question.seed is not None:
        config["seed"] = question.seed
    if question.schema is not None:
        config |= {"responseMimeType": "application/json", "responseSchema": schema_of(question.schema)}
    body: dict[str, Any] = {"contents": contents, "generationConfig": config}
    if system:
        body["systemInstruction"] = {"parts": [{"text": "\n\n".join(system)}]}
    version = "" if urlsplit(endpoint.base_url).path else "v1beta/"
    name = quote(endpoint.model, safe="")
    return Request(f"{version}models/{name}:streamGenerateContent?alt=sse", body)


def parse(endpoint: ModelEndpoint, document: str, key: str | None) -> Chunk:
    """One message of the stream. Raises LanguageModelError."""
    message = json_object(endpoint, document)
    raise_error_object(endpoint, message, key)
    feedback = message.get("promptFeedback")
    if isinstance(feedback, dict) and feedback.get("blockReason"):
        raise blocked(endpoint, str(feedback["blockReason"]))
    candidates = message.get("candidates", [])
    if not isinstance(candidates, list):
        raise nonsense(endpoint, "a message has no candidates")
    told = message.get("modelVersion")
    version = shortened(without(key, told), 100) if isinstance(told, str) else ""
    if not candidates:
        return Chunk(version=version)
    candidate = candidates[0]
    if not isinstance(candidate, dict):
        raise nonsense(endpoint, "a candidate is no object")
    text, alive = _text_of(endpoint, candidate.get("content", {}))
    reason = candidate.get("finishReason")
    if reason and reason not in _ENDED_WELL:
        raise blocked(endpoint, str(reason))
    return Chunk(text=text, alive=alive, ended=bool(reason), version=version)


def _text_of(endpoint: ModelEndpoint, content: object) -> tuple[str, bool]:
    """What it says, and whether it thinks, which nobody reads."""
    parts = content.get("parts", []) if isinstance(content, dict) else None
    if not isinstance(parts, list) or not all(isinstance(part, dict) for part in parts):
        raise nonsense(endpoint, "a candidate has no parts")
    texts = [part.get("text", "") for part in parts if not part.get("thought")]
    if not all(isinstance(text, str) for text in texts):
        raise nonsense(endpoint, "a part is not text")
    return "".join(texts), any(part.get("thought") for part in parts)


def schema_of(schema: Schema) -> Schema:
    """A JSON schema in the few words that Gemini's own has."""
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
