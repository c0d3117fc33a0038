"""Dialect of Ollama. https://github.com/ollama/ollama/blob/main/docs/api.md"""

from typing import Any

from caris_desktop.conversation.models.endpoint import ModelEndpoint
from caris_desktop.conversation.models.failures import unusable
from caris_desktop.conversation.models.question import Chunk, Cut, Question, Request


def request(endpoint: ModelEndpoint, question: Question) -> Request:
    written: list[dict[str, Any]] = [
        {"role": message.role, "content": message.content} for message in question.messages
    ]
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


def parse(endpoint: ModelEndpoint, message: dict[str, Any], _key: str | None) -> Chunk:
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
