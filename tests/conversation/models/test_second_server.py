"""A third-party server, `python -m llama_cpp.server`: recorded answers, and the server itself.

With the address of such a server (or any other with OpenAI's API) in CARIS_TEST_MODEL_SERVER the real one is tested,
too: ``pip install "llama-cpp-python[server]"`` in a separate environment, then ``python -m llama_cpp.server --model
WEIGHTS.gguf --n_ctx 512 --port 18099``.
"""

import asyncio
import json
import os
from collections.abc import Coroutine
from typing import Any, TypeVar
from urllib.parse import urlsplit

import pytest

from caris_desktop.conversation.models.chat import Retries, stream_chat
from caris_desktop.conversation.models.connection import models_here
from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint
from caris_desktop.conversation.suggestions.prompt import replies_in, replies_schema
from caris_desktop.domain.events import ChatMessage
from tests.conversation.models.served import PATIENT, SSE_HEAD, Answer, Served, ask, refused, sends, serving
from tests.support.tcp_proxy import TcpProxy

SERVER = os.environ.get("CARIS_TEST_MODEL_SERVER", "").rstrip("/")
real = pytest.mark.skipif(not SERVER, reason="CARIS_TEST_MODEL_SERVER names no model server to ask")
Result = TypeVar("Result")
SCHEMA = replies_schema(whole_sentences=True)

# Recorded from llama-cpp-python 0.3.36, except the numbers.
_CHUNK = {"id": "chatcmpl-475df8ac", "model": "smollm2", "created": 1795423910, "object": "chat.completion.chunk"}
BEGIN: dict[str, Any] = {"index": 0, "delta": {"role": "assistant"}, "logprobs": None, "finish_reason": None}
END: dict[str, Any] = {"index": 0, "delta": {}, "logprobs": None, "finish_reason": "length"}
DONE = b"data: [DONE]\r\n\r\n"
NO_JSON_SCHEMA = {
    "error": {
        "message": "1 validation error:\n  {'type': 'literal_error', 'loc': ('body', 'response_format', 'type'), "
        "'msg': \"Input should be 'text' or 'json_object'\", 'input': 'json_schema'}",
        "type": "internal_server_error", "param": None, "code": None,
    }
}  # fmt: skip


def chunk(choice: dict[str, Any]) -> bytes:
    return b"data: " + json.dumps({**_CHUNK, "choices": [choice]}).encode() + b"\r\n\r\n"


def word(text: str) -> bytes:
    return chunk({"index": 0, "delta": {"content": text}, "logprobs": None, "finish_reason": None})


def test_an_answer_as_it_was_recorded() -> None:
    pieces, _ = ask(sends(SSE_HEAD, chunk(BEGIN), word("A"), word(" robot"), chunk(END), DONE))
    assert pieces == ["A", " robot"]


@pytest.mark.parametrize(
    "parts",
    [
        # Beyond its context it stops answering; of two concurrent questions it drops one.
        (SSE_HEAD,),
        (SSE_HEAD, chunk(BEGIN), DONE),
    ],
)
def test_an_answer_that_never_began_is_a_failure_that_says_what_to_do(parts: tuple[bytes, ...]) -> None:
    error = refused(sends(*parts))
    assert "returned an empty answer" in error.what
    assert "shorten the question" in error.advice


def test_an_answer_that_it_drops_for_the_next_question_is_not_taken_for_whole() -> None:
    pieces: list[str] = []
    with pytest.raises(LanguageModelError, match="stopped in the middle of the answer"):
        ask(sends(SSE_HEAD, chunk(BEGIN), word("A"), word(" robot"), DONE), pieces=pieces)
    assert pieces == ["A", " robot"]


def refusal(status: str, message: dict[str, Any]) -> Answer:
    body = json.dumps(message).encode()
    return sends(f"HTTP/1.1 {status}\r\nContent-Length: {len(body)}\r\n\r\n".encode() + body)


def in_turn(*answers: Answer) -> Answer:
    left = list(answers)

    async def speak(writer: asyncio.StreamWriter) -> None:
        await left.pop(0)(writer)

    return speak


def asked_with_schema(answer: Answer) -> tuple[str, Served]:
    async def run() -> tuple[str, Served]:
        async with serving(answer) as served:
            return await whole(ModelEndpoint("openai", served.url, "smollm2"), schema=SCHEMA), served

    return asyncio.run(run())


async def whole(endpoint: ModelEndpoint, question: str = "Hello!", **given: Any) -> str:
    asked = {"local_only": True, "max_tokens": 80, "temperature": 0.0, "timeouts": PATIENT} | given
    return "".join([piece async for piece in stream_chat(endpoint, [ChatMessage("user", question)], **asked)])


def test_a_server_that_knows_a_json_object_only_is_asked_for_that_at_once() -> None:
    answer = sends(SSE_HEAD, chunk(BEGIN), word("{}"), chunk(END), DONE)
    text, served = asked_with_schema(in_turn(refusal("500 Internal Server Error", NO_JSON_SCHEMA), answer))
    assert text == "{}"
    asked = [body["response_format"] for body in served.bodies]
    assert asked == [
        {"type": "json_schema", "json_schema": {"name": "answer", "strict": True, "schema": SCHEMA}},
        {"type": "json_object", "schema": SCHEMA},
    ]


def test_a_field_that_it_refuses_in_both_forms_is_left_out() -> None:
    second = refusal("400 Bad Request", {"error": {"message": "response_format is unknown"}})
    answer = sends(SSE_HEAD, chunk(BEGIN), word("{}"), chunk(END), DONE)
    text, served = asked_with_schema(in_turn(refusal("400 Bad Request", NO_JSON_SCHEMA), second, answer))
    assert text == "{}" and "response_format" not in served.bodies[-1]


# Real server


def with_the_real_one(talk: "Coroutine[Any, Any, Result]") -> Result:
    async def run() -> Result:
        async with asyncio.timeout(240.0):
            return await talk

    return asyncio.run(run())


async def there(address: str = SERVER) -> ModelEndpoint:
    names = await models_here(ModelEndpoint("openai", SERVER, ""))
    assert names, "it lists its models"
    return ModelEndpoint("openai", address, names[0])


@real
def test_the_real_one_lists_its_models_and_answers_piece_by_piece() -> None:
    async def talk() -> list[str]:
        asked = [ChatMessage("system", "Answer in one sentence."), ChatMessage("user", "What is a robot?")]
        return [
            piece async for piece in stream_chat(await there(), asked, local_only=True, max_tokens=12, temperature=0.0)
        ]

    assert 3 <= len(with_the_real_one(talk())) <= 12


@real
def test_the_real_one_is_left_before_and_after_the_first_word() -> None:
    async def talk() -> None:
        endpoint = await there()
        asked = [ChatMessage("user", "Count as far as you can.")]
        begun = stream_chat(endpoint, asked, local_only=True, max_tokens=300, temperature=1.0)
        await anext(begun)
        await begun.aclose()
        assert await whole(endpoint, max_tokens=4)
        waiting = asyncio.ensure_future(whole(endpoint, "Read this: " + "word " * 300, max_tokens=100))
        await asyncio.sleep(0.1)
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        assert await whole(endpoint, max_tokens=4)

    with_the_real_one(talk())


@real
def test_the_real_one_writes_suggestions_as_their_schema_says() -> None:
    async def talk() -> str:
        return await whole(await there(), "Write three replies to: hello.", schema=SCHEMA, max_tokens=200)

    written = with_the_real_one(talk())
    assert set(json.loads(written)) == set(SCHEMA["required"])
    assert len(replies_in(written)) == len(SCHEMA["required"])


@real
@pytest.mark.logs("answered with HTTP status")
def test_the_real_one_fails_clearly_beyond_its_context() -> None:
    async def talk() -> None:
        await whole(await there(), "word " * 40_000, retries=Retries(at_most=0))

    with pytest.raises(LanguageModelError) as caught:
        with_the_real_one(talk())
    assert caught.value.advice


@real
@pytest.mark.logs("exchange with .* failed")
def test_the_real_one_is_gone_in_the_middle_of_its_answer() -> None:
    async def talk(proxy: TcpProxy) -> list[str]:
        endpoint = await there(f"http://127.0.0.1:{proxy.port}")
        pieces: list[str] = []
        asked = [ChatMessage("user", "Tell a long story.")]
        with pytest.raises(LanguageModelError, match="stopped in the middle of the answer"):
            async for piece in stream_chat(endpoint, asked, local_only=True, max_tokens=400, temperature=1.0):
                pieces.append(piece)
                if len(pieces) == 3:
                    proxy.cut(refuse=True)
        return pieces

    with TcpProxy(urlsplit(SERVER).port or 80) as proxy:
        assert len(with_the_real_one(talk(proxy))) >= 3
