"""Requests and answers of each dialect, in the format of its public reference.

The texts are invented; the keys, their nesting and the sequence of messages follow the reference given at each.
"""

import asyncio
import json
from typing import Any

import pytest

from caris_desktop.conversation.models.connection import model_version, models_here
from caris_desktop.conversation.models.dialects import gemini_request, ollama_request, openai_request
from caris_desktop.conversation.models.endpoint import EMBEDDED_KEY, KEYED_BY, ModelEndpoint
from caris_desktop.conversation.models.question import REASONING_TOKENS, Question
from caris_desktop.domain.events import ChatMessage
from tests.conversation.models.served import (
    LINES_HEAD,
    PATIENT,
    SSE_HEAD,
    Answer,
    Served,
    collect,
    refused,
    sends,
    serving,
)  # fmt: skip
from tests.support.mutations import mutated

# https://platform.openai.com/docs/api-reference/chat-streaming and
# https://platform.openai.com/docs/guides/structured-outputs
OPENAI_ANSWER = (
    {"role": "assistant", "content": "", "refusal": None},
    {"content": "Over"},
    {"content": " there."},
    {},
)

# https://github.com/ollama/ollama/blob/main/docs/api.md#generate-a-chat-completion
OLLAMA_ANSWER = (
    {"message": {"role": "assistant", "content": "Over", "images": None}, "done": False},
    {"message": {"role": "assistant", "content": "", "thinking": "Where was it?"}, "done": False},
    {"message": {"role": "assistant", "content": " there."}, "done": False},
    {"done": True, "done_reason": "stop", "total_duration": 4883583458, "eval_count": 282},
)
# https://ai.google.dev/api/generate-content#v1beta.GenerateContentResponse
GEMINI_ANSWER = (
    {
        "candidates": [
            {"content": {"parts": [{"text": "Where was it?", "thought": True}], "role": "model"}, "index": 0}
        ],
        "usageMetadata": {"promptTokenCount": 15, "totalTokenCount": 15},
        "modelVersion": "gemini-2.5-flash",
        "responseId": "Il0taoSY",
    },
    {"candidates": [{"content": {"parts": [{"text": "Over"}], "role": "model"}, "index": 0}]},
    {
        "candidates": [
            {
                "content": {"parts": [{"text": " there."}, {"thoughtSignature": "EjQKMgEM"}], "role": "model"},
                "finishReason": "STOP",
                "index": 0,
            }
        ],
        "modelVersion": "gemini-2.5-flash",
    },
)
SCHEMA: dict[str, Any] = {
    "type": "object",
    "properties": {
        "answer": {"type": ["string", "null"], "maxLength": 80},
        "place": {"enum": ["Kitchen", "Lab"]},
        "all": {"type": "array", "items": {"type": "object", "properties": {"x": {"const": "a"}}, "required": ["x"]}},
    },
    "required": ["answer", "place", "all"],
    "additionalProperties": False,
    "$schema": "https://json-schema.org/draft/2020-12/schema",
}
TALK = (
    ChatMessage("system", "You guide tours."),
    ChatMessage("user", "Hello."),
    ChatMessage("assistant", "Hi."),
    ChatMessage("user", "What is this?"),
)


def sse(*messages: dict[str, Any], done: bool = False) -> Answer:
    parts = [b"data: " + json.dumps(message).encode() + b"\r\n\r\n" for message in messages]
    return sends(SSE_HEAD, *parts, *([b"data: [DONE]\n\n"] if done else []))


def answered(endpoint_of: Any, answer: Answer) -> tuple[str, Served]:
    async def run() -> tuple[str, Served]:
        async with serving(answer) as served:
            return "".join(await collect(endpoint_of(served.url), PATIENT)), served

    return asyncio.run(run())


def test_openai() -> None:
    chunks = [
        {
            "id": "chatcmpl-123", "object": "chat.completion.chunk", "created": 1694268190, "model": "gpt-4o-mini",
            "system_fingerprint": "fp_44709d6fcb",
            "choices": [
                {"index": 0, "delta": delta, "logprobs": None, "finish_reason": None if delta else "stop"}
            ],
        }
        for delta in OPENAI_ANSWER
    ]  # fmt: skip
    text, served = answered(lambda url: ModelEndpoint("openai", url, "gpt-4o-mini"), sse(*chunks, done=True))
    assert text == "Over there."
    assert served.heads[0].startswith("POST /v1/chat/completions")
    real = ModelEndpoint("openai", "https://api.openai.com/v1", "gpt-4o-mini")
    request = openai_request(real, Question(TALK, 20, 0.5, seed=7, schema=SCHEMA, jpegs=(b"\xff\xd8", b"\xff\xd9")))
    assert request.path == "chat/completions"
    assert request.body == {
        "model": "gpt-4o-mini",
        "messages": [
            {"role": "system", "content": "You guide tours."},
            {"role": "user", "content": "Hello."},
            {"role": "assistant", "content": "Hi."},
            {
                "role": "user",
                "content": [
                    {"type": "text", "text": "What is this?"},
                    {"type": "image_url", "image_url": {"url": "data:image/jpeg;base64,/9g="}},
                    {"type": "image_url", "image_url": {"url": "data:image/jpeg;base64,/9k="}},
                ],
            },
        ],
        "stream": True,
        "max_completion_tokens": 20,
        "temperature": 0.5,
        "seed": 7,
        "response_format": {
            "type": "json_schema",
            # Not strict, which requires every object to be closed and every key to be required.
            "json_schema": {"name": "answer", "strict": False, "schema": SCHEMA},
        },
    }
    closed = {
        "type": "object",
        "properties": {"a": {"type": "string"}},
        "required": ["a"],
        "additionalProperties": False,
    }
    strict = openai_request(real, Question(TALK, 20, 0.5, schema=closed)).body["response_format"]["json_schema"]
    assert strict["strict"] is True


def test_openai_that_refuses_is_no_answer() -> None:
    chunk = {"choices": [{"index": 0, "delta": {"refusal": "I cannot help with that."}, "finish_reason": None}]}
    assert "refused to answer this (I cannot help with that.)" in refused(sse(chunk)).what


def test_ollama() -> None:
    lines = [
        json.dumps({"model": "llava", "created_at": "2026-01-01T00:00:00Z"} | message) for message in OLLAMA_ANSWER
    ]
    text, served = answered(
        lambda url: ModelEndpoint("ollama", url, "llava"), sends(LINES_HEAD, *(f"{line}\n".encode() for line in lines))
    )
    assert text == "Over there."
    assert served.heads[0].startswith("POST /api/chat")
    endpoint = ModelEndpoint("ollama", "http://127.0.0.1:11434", "llava")
    request = ollama_request(endpoint, Question(TALK, 20, 0.5, seed=7, schema=SCHEMA, jpegs=(b"\xff\xd8",)))
    assert request.path == "api/chat"
    assert request.body == {
        "model": "llava",
        "messages": [
            {"role": "system", "content": "You guide tours."},
            {"role": "user", "content": "Hello."},
            {"role": "assistant", "content": "Hi."},
            {"role": "user", "content": "What is this?", "images": ["/9g="]},
        ],
        "stream": True,
        "format": SCHEMA,
        "options": {"num_predict": 20, "temperature": 0.5, "seed": 7},
        "think": False,
    }


def test_gemini(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GEMINI_API_KEY", raising=False)
    monkeypatch.setenv("GOOGLE_API_KEY", "AIza-secret")
    text, served = answered(
        lambda url: ModelEndpoint("gemini", url, "gemini-2.5-flash", KEYED_BY["gemini"]), sse(*GEMINI_ANSWER)
    )
    assert text == "Over there."
    assert served.heads[0].startswith("POST /v1beta/models/gemini-2.5-flash:streamGenerateContent?alt=sse HTTP/1.1")
    assert "x-goog-api-key: aiza-secret" in served.heads[0].lower()
    assert "secret" not in served.heads[0].splitlines()[0]
    endpoint = ModelEndpoint("gemini", "https://generativelanguage.googleapis.com", "gemini-2.5-flash")
    request = gemini_request(endpoint, Question(TALK, 20, 0.5, seed=7, schema=SCHEMA, jpegs=(b"\xff\xd8",)))
    assert request.body == {
        "systemInstruction": {"parts": [{"text": "You guide tours."}]},
        "contents": [
            {"role": "user", "parts": [{"text": "Hello."}]},
            {"role": "model", "parts": [{"text": "Hi."}]},
            {
                "role": "user",
                "parts": [{"text": "What is this?"}, {"inlineData": {"mimeType": "image/jpeg", "data": "/9g="}}],
            },
        ],
        "generationConfig": {
            # Reasoning tokens count against the limit; the console limits the answer itself.
            "maxOutputTokens": 20 + REASONING_TOKENS,
            "thinkingConfig": {"thinkingBudget": 0},
            "temperature": 0.5,
            "seed": 7,
            "responseMimeType": "application/json",
            # https://ai.google.dev/api/caching#Schema: no additionalProperties, no $schema, no const
            "responseSchema": {
                "type": "OBJECT",
                "properties": {
                    "answer": {"type": "STRING", "nullable": True, "maxLength": 80},
                    "place": {"enum": ["Kitchen", "Lab"]},
                    "all": {
                        "type": "ARRAY",
                        "items": {
                            "type": "OBJECT",
                            "properties": {"x": {"enum": ["a"]}},
                            "required": ["x"],
                            "propertyOrdering": ["x"],
                        },
                    },
                },
                "required": ["answer", "place", "all"],
                "propertyOrdering": ["answer", "place", "all"],
            },
        },
    }


@pytest.mark.logs("answered with HTTP status", "reported an error")
@pytest.mark.parametrize(
    ("answer", "expected"),
    [
        (sse({"promptFeedback": {"blockReason": "SAFETY"}}), "refused to answer this (SAFETY)"),
        (sse({"candidates": [{"finishReason": "RECITATION", "index": 0}]}), "refused to answer this (RECITATION)"),
        (sse({"error": {"code": 500, "message": "Oh.", "status": "INTERNAL"}}), "stopped with an error: Oh."),
        (sse({"candidates": [7]}), "is not an object"),
        (sse({"candidates": [{"content": {"parts": [{"text": 7}]}}]}), "not text"),
        (sse({"candidates": 7}), "no candidates"),
        (sse(*GEMINI_ANSWER[:2]), "stopped in the middle of the answer"),
    ],
)
def test_gemini_that_does_not_answer(monkeypatch: pytest.MonkeyPatch, answer: Answer, expected: str) -> None:
    monkeypatch.setenv("TEST_MODEL_KEY", "AIza-secret")
    assert expected in refused(answer, provider="gemini", key_env="TEST_MODEL_KEY").what


@pytest.mark.logs("answered with HTTP status")
def test_geminis_word_for_a_wrong_key_is_understood_and_the_key_not_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TEST_MODEL_KEY", "AIza-secret")
    # https://ai.google.dev/gemini-api/docs/troubleshooting
    told = {"error": {"code": 400, "message": "API key not valid: AIza-secret", "status": "INVALID_ARGUMENT"}}
    body = json.dumps([told]).encode()
    reply = b"HTTP/1.1 400 Bad Request\r\nContent-Length: %d\r\n\r\n" % len(body) + body
    error = refused(sends(reply), provider="gemini", key_env="TEST_MODEL_KEY")
    assert "refused access" in error.what and "TEST_MODEL_KEY" in error.advice
    assert "AIza" not in str(error)


def test_gemini_is_not_asked_without_a_key(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in KEYED_BY["gemini"]:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("caris_desktop.conversation.models.connection._key_from_keyring", lambda names: (names[0], ""))
    endpoint = ModelEndpoint("gemini", "http://127.0.0.1:9", "m", KEYED_BY["gemini"])
    with pytest.raises(Exception, match="keyring set caris-desktop GEMINI_API_KEY"):
        asyncio.run(collect(endpoint))


_TAGS = {"models": [{"name": "m:latest", "model": "m:latest", "digest": "sha256:" + 64 * "a"}, {"name": "b"}]}
_DATA = {"object": "list", "data": [{"id": "small", "object": "model"}, {"id": "/home/me/big.gguf"}]}


@pytest.mark.parametrize(("provider", "plain"), [("ollama", _TAGS), ("embedded", _DATA), ("openai", _DATA)])
def test_no_mutation_of_a_list_of_models_does_harm(
    request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, provider: Any, plain: dict[str, Any]
) -> None:
    """Any mutation gives names that can be displayed, without folders."""
    monkeypatch.setenv(EMBEDDED_KEY, "key")
    replies = [b'{"models": [{"name": []}], "data": [{"id": {}}]}']
    whole = json.dumps(plain).encode()
    replies += [mutated(whole, seed) for seed in range(200 if request.config.getoption("--long") else 20)]

    async def listed(reply: bytes) -> tuple[str, ...]:
        async with serving(sends(b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n" + reply)) as served:
            endpoint = ModelEndpoint(provider, served.url, "m")
            return (*await models_here(endpoint), await model_version(endpoint, local_only=True))

    for number, reply in enumerate(replies):
        names = asyncio.run(listed(reply))
        assert all(name.isprintable() and "/home" not in name for name in names), (number, names)


def test_servers_on_this_computer_list_their_models() -> None:
    # https://github.com/ollama/ollama/blob/main/docs/api.md#list-local-models,
    # https://platform.openai.com/docs/api-reference/models/list
    tags = {"models": [{"name": "llava:7b", "model": "llava:7b", "size": 1}, {"name": "codellama:13b"}, 7]}
    data = {"object": "list", "data": [{"id": "small", "object": "model"}, {"id": "/home/me/big.gguf"}]}

    async def listed(provider: Any, reply: object) -> tuple[tuple[str, ...], list[str]]:
        answer = sends(b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n" + json.dumps(reply).encode())
        async with serving(answer) as served:
            return await models_here(ModelEndpoint(provider, served.url, "")), served.heads

    names, heads = asyncio.run(listed("ollama", tags))
    assert names == ("codellama:13b", "llava:7b") and heads[0].startswith("GET /api/tags")
    names, heads = asyncio.run(listed("openai", data))
    assert names == ("big.gguf", "small") and heads[0].startswith("GET /v1/models")
    assert asyncio.run(listed("ollama", ["nothing"]))[0] == ()
