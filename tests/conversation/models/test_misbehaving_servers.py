"""Answers as given by real servers: with reasoning, odd chunks, refused parameters, and limits used up by reasoning."""

import asyncio
import contextlib
import gzip
import json
import random
import zlib
from collections.abc import Callable
from contextlib import AsyncExitStack
from typing import Any

import pytest

from caris_desktop.conversation.models.chat import AnswerNotes, ChatTimeouts, Retries, stream_chat
from caris_desktop.conversation.models.dialects import gemini_request, openai_request
from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint
from caris_desktop.conversation.models.question import REASONING_TOKENS, Question
from caris_desktop.conversation.models.reasoning import SpokenPart, Withdrawn
from caris_desktop.conversation.speech_checks import probe_language_model
from caris_desktop.live.background_worker import AsyncioThread
from tests.conversation.models.served import (
    AT_ONCE,
    LINES_HEAD,
    PATIENT,
    QUESTION,
    SSE_HEAD,
    Served,
    ask,
    refused,
    sends,
    serving,
)

ANSWER = "The lab closes at six."
SECRET = "The visitor seems confused; nobody may learn that the robot is remote-controlled."


def chunk(delta: Any, finish: Any = None, **more: Any) -> dict[str, Any]:
    return {"choices": [{"index": 0, "delta": delta, "finish_reason": finish}], **more}


def words(text: str, size: int = 3) -> list[dict[str, Any]]:
    return [chunk({"content": text[at : at + size]}) for at in range(0, len(text), size)]


def event(message: Any) -> bytes:
    return b"data: " + (message if isinstance(message, bytes) else json.dumps(message).encode()) + b"\n\n"


def sse(*messages: Any) -> bytes:
    return SSE_HEAD + b"".join(map(event, messages)) + b"data: [DONE]\n\n"


def whole(body: Any, status: str = "200 OK", kind: str = "application/json") -> bytes:
    data = body if isinstance(body, bytes) else json.dumps(body).encode()
    return f"HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {len(data)}\r\n\r\n".encode() + data


STOP = chunk({}, "stop")
Reply = Callable[[dict[str, Any]], bytes]


def asked(
    reply: Reply,
    *,
    provider: str = "openai",
    times: int = 1,
    max_tokens: int = 20,
) -> tuple[list[str], AnswerNotes, Served]:
    """Text of each answer, notes of the last one, and the server with its requests."""

    async def run() -> tuple[list[str], AnswerNotes, Served]:
        answers, notes = list[str](), AnswerNotes()

        async def answer(writer: asyncio.StreamWriter) -> None:
            writer.write(reply(served.bodies[-1]))
            await writer.drain()

        async with serving(answer) as served:
            endpoint = ModelEndpoint(provider, served.url, "some-model")  # type: ignore[arg-type]
            for _ in range(times):
                pieces, notes = list[str](), AnswerNotes()
                async for piece in stream_chat(
                    endpoint, QUESTION, local_only=False, max_tokens=max_tokens, temperature=0.5, seed=7,
                    timeouts=PATIENT, retries=AT_ONCE, notes=notes,
                ):  # fmt: skip
                    if isinstance(piece, Withdrawn):
                        pieces.clear()
                    pieces.append(piece)
                answers.append("".join(pieces))
        return answers, notes, served

    return asyncio.run(run())


@pytest.mark.parametrize("size", [1, 2, 3, 7, 1000])
@pytest.mark.parametrize(
    "written",
    [
        f"<think>\n{SECRET}\n</think>\n\n{ANSWER}",
        f"<thinking>{SECRET}</thinking>{ANSWER}",
        f"<Thought time='3'>{SECRET}</Thought> {ANSWER}",
        f"<reasoning>{SECRET}</reasoning>{ANSWER}",
        f"[THINK]{SECRET}[/THINK]{ANSWER}",
        f"◁think▷{SECRET}◁/think▷{ANSWER}",
        f"<seed:think>{SECRET}</seed:think>{ANSWER}",
        f"<|START_THINKING|>{SECRET}<|END_THINKING|><|START_RESPONSE|>{ANSWER}<|END_RESPONSE|>",
        f"<|channel|>analysis<|message|>{SECRET}<|end|><|start|>assistant<|channel|>final<|message|>{ANSWER}<|return|>",
        f"{SECRET}</think>\n\n{ANSWER}",
        f"{ANSWER}<|im_end|>\n<|im_start|>user\n{SECRET}",
        f"<think>{SECRET}</think>{ANSWER}<｜end▁of▁sentence｜>",
        f"<think></think>{ANSWER}</s>",
        f"<reasoning_content>{SECRET}</reasoning_content>{ANSWER}",
        f"<internal_monologue>{SECRET}</internal_monologue>{ANSWER}",
        f'<details type="reasoning" done="true" duration="3">{SECRET}</details>\n{ANSWER}',
        # Gemma 4, MedGemma
        f"<|channel>thought\n{SECRET}<channel|>{ANSWER}",
        f"thought\n{SECRET}<channel|>{ANSWER}<turn|>\n<|turn>user\n{SECRET}",
        f"<unused94>thought\n{SECRET}<unused95>{ANSWER}",
        # Solar Open, Apertus
        f"<|begin|>assistant<|think|>{SECRET}<|end|><|begin|>assistant<|content|>{ANSWER}<|end|>",
        f"<|inner_prefix|>{SECRET}<|inner_suffix|>{ANSWER}",
        f"<scratch_pad>{SECRET}</scratch_pad>{ANSWER}",
        f"<seed:cot_budget_reflect>{SECRET}</seed:cot_budget_reflect>{ANSWER}",
        f"<ctrl94>thought\n{SECRET}<ctrl95>{ANSWER}",
        # gpt-oss from a server that drops its tokens
        f"analysis{SECRET}assistantfinal{ANSWER}",
        f"analysis{SECRET}assistantcommentary{SECRET}assistantfinal{ANSWER}",
    ],
)
def test_reasoning_is_not_spoken_wherever_it_is_cut(written: str, size: int) -> None:
    answers, notes, _ = asked(lambda _body: sse(*words(written, size), STOP))
    assert answers == [ANSWER]
    assert notes.reasoned is ("think></think" not in written and "im_end" not in written)


@pytest.mark.parametrize("size", [1, 3, 1000])
@pytest.mark.parametrize(
    "written",
    [
        f"{ANSWER}<|end|><|user|>\n{SECRET}",
        f"{ANSWER}\n<|im_start|>user\n{SECRET}",
        f"{ANSWER}[INST] {SECRET} [/INST] {SECRET}",
        f" [/INST]{ANSWER}",
        f'{ANSWER}<tool_call>{{"name": "{SECRET}"}}</tool_call>',
        f"{ANSWER}<｜tool▁calls▁begin｜>{SECRET}<｜tool▁calls▁end｜>",
        f'{ANSWER}[TOOL_CALLS][{{"name": "{SECRET}"}}]',
        f"<function=look_up>{SECRET}</function>{ANSWER}",
        f'{ANSWER}<invoke name="x"><parameter name="y">{SECRET}</parameter></invoke>',
        f"<minimax:tool_call>{SECRET}</minimax:tool_call>{ANSWER}",
        f'{ANSWER}<｜DSML｜tool_calls>\n<｜DSML｜invoke name="x">{SECRET}</｜DSML｜invoke></｜DSML｜tool_calls>',
        f"<|action_start|><|plugin|>{SECRET}<|action_end|>{ANSWER}",
        f"{ANSWER}<tool_response>{SECRET}</tool_response>",
        f"<system-reminder>{SECRET}</system-reminder>{ANSWER}",
    ],
)
def test_turns_and_calls_that_a_model_adds_are_not_spoken(written: str, size: int) -> None:
    [answer], _, _ = asked(lambda _body: sse(*words(written, size), STOP))
    assert answer.strip() == ANSWER


def test_a_model_that_began_within_its_reasoning_does_so_again() -> None:
    pieces: list[list[str]] = []
    replies = [f"{SECRET}</think>{ANSWER}", f"{SECRET}</think>{ANSWER}", ANSWER]

    async def run() -> None:
        async def answer(writer: asyncio.StreamWriter) -> None:
            writer.write(sse(*words(replies[len(pieces)]), STOP))

        async with serving(answer) as served:
            endpoint = ModelEndpoint("openai", served.url, "m")
            for _ in replies:
                stream = stream_chat(
                    endpoint, QUESTION, local_only=False, max_tokens=20, temperature=0.5, timeouts=PATIENT
                )
                pieces.append([piece async for piece in stream])

    asyncio.run(run())
    assert any(isinstance(piece, Withdrawn) for piece in pieces[0])
    assert ["".join(each) for each in pieces[1:]] == [ANSWER, ANSWER], "nothing of it is shown for a moment either"


def test_the_name_of_a_channel_is_not_shown_for_a_moment() -> None:
    def shown(*pieces: str) -> list[str]:
        part = SpokenPart()
        return [text for piece in pieces for text in part.process(piece)] + part.end(whole=True)

    assert shown("analysis", "User", " asks.", "assistant", "final", "Hi.") == ["Hi."]
    assert shown("analysis", " is what", " we do.") == ["analysis is what", " we do."]
    assert shown("commentary") == ["commentary"]
    assert shown("analysis用户", "问好assistantfinal你好") == ["你好"]
    again = SpokenPart(within=True)
    assert [*again.process("analysisUser asks.assistantfinalHi."), *again.end(whole=True)] == ["Hi."]


@pytest.mark.parametrize(
    ("provider", "head", "thought"),
    [
        ("openai", SSE_HEAD, event(chunk({"reasoning_content": "Hmm. "}))),
        ("openai", SSE_HEAD, event(chunk({"content": "<think>Hmm. "}))),
        ("gemini", SSE_HEAD, event({"candidates": [{"content": {"parts": [{"text": "Hmm.", "thought": True}]}}]})),
        ("ollama", LINES_HEAD, json.dumps({"message": {"content": "", "thinking": "Hmm."}}).encode() + b"\n"),
    ],
)
def test_a_model_that_thinks_without_end_is_abandoned(provider: str, head: bytes, thought: bytes) -> None:
    async def think(writer: asyncio.StreamWriter) -> None:
        writer.write(head)
        while True:
            writer.write(thought)
            await writer.drain()
            await asyncio.sleep(0.01)

    short = ChatTimeouts(connect_s=20.0, first_token_s=0.5, between_tokens_s=20.0)
    error = refused(think, provider=provider, timeouts=short)
    assert "reasoned for 0.5 s" in error.what and "does not reason" in error.advice


def test_text_that_only_resembles_a_mark_is_spoken() -> None:
    for written in (
        "If x < 5 [see 1] then <b>this</b> ◁ is | said: a <= b, <thin> and [T",
        "analysis is what we do, [INSTRUMENTS] too.",
    ):
        assert asked(lambda _body, written=written: sse(*words(written, 2), STOP))[0] == [written]


@pytest.mark.logs("reported an error in the stream")
@pytest.mark.parametrize(
    "messages",
    [
        [chunk({"content": ANSWER}), {"choices": [{"index": 0, "delta": None, "finish_reason": "stop"}]}],
        [chunk({"content": ANSWER}), {"choices": [{"index": 0, "finish_reason": "stop"}]}],
        [chunk({"content": ANSWER}), STOP, {"choices": None, "usage": {"total_tokens": 9}}],
        [*words(ANSWER, 9)[:1], {"choices": None}, {"usage": {}}, {"choices": []}, *words(ANSWER, 9)[1:], STOP],
        [{"prompt_filter_results": [{"prompt_index": 0}]}, chunk({"content": ANSWER}), STOP],
        [b"null", b"7", b'"text"', b"[]", b"{broken", chunk({"content": ANSWER}), STOP],
        [chunk({"content": None, "role": "assistant"}), chunk({"content": ANSWER}), STOP],
        [chunk({"content": 7}), {"choices": [7]}, {"choices": 7}, chunk({"content": ANSWER}), STOP],
        [
            chunk({"content": [{"type": "thinking", "thinking": [{"type": "text", "text": SECRET}]}]}),
            chunk({"content": [{"type": "text", "text": ANSWER}]}), STOP,
        ],
        [chunk({"content": "", "reasoning_content": SECRET}), chunk({"content": ANSWER, "reasoning": SECRET}), STOP],
        [{"choices": [{"message": {"role": "assistant", "content": ANSWER}, "finish_reason": "stop"}]}],
        [chunk({"content": "The lab "}), {"choices": [{"index": 1, "delta": {"content": "Another."}}]},
         chunk({"content": "closes at six."}), {"choices": [{"index": 1, "delta": {}, "finish_reason": "stop"}]}, STOP],
        [chunk({"content": "The lab "}), {"choices": [{"delta": {"content": "closes at six."}}]}, STOP],
        # As LiteLLM numbers what follows the reasoning
        [chunk({"reasoning_content": SECRET}), {"choices": [{"index": 1, "delta": {"content": ANSWER}}]}, STOP],
        [chunk({"content": [{"type": "text", "text": SECRET, "thought": True}]}), chunk({"content": ANSWER}), STOP],
        [chunk({"thinking": SECRET}), chunk({"reasoning_text": SECRET}), chunk({"content": ANSWER}), STOP],
        # Each piece is marked as the end, or with a reason that is none.
        [chunk({"content": "The lab "}, "stop"), chunk({"content": "closes at six."}, "stop")],
        [chunk({"content": "The lab "}, "null"), chunk({"content": "closes at six."}, "null"), STOP],
        [chunk({"content": ANSWER}, "stop"), {"error": {"message": "usage could not be counted"}}],
        [b'{"choices": [{"delta": {"content": "The lab "}}]}\n'
         b'data: {"choices": [{"delta": {"content": "closes at six."}}]}'],
    ],
)  # fmt: skip
def test_chunks_of_no_use_are_skipped(messages: list[Any]) -> None:
    assert asked(lambda _body: sse(*messages))[0] == [ANSWER]


def test_a_whole_answer_stays_whole_however_the_server_ends() -> None:
    content = event(chunk({"content": ANSWER})) + event(STOP)
    broken_off = SSE_HEAD.replace(b"\r\n\r\n", b"\r\nContent-Length: 9999\r\n\r\n")
    chunked = SSE_HEAD.replace(b"\r\n\r\n", b"\r\nTransfer-Encoding: chunked\r\n\r\n")
    byte_order_mark = b"\xef\xbb\xbf"
    for reply in (
        broken_off + content,
        chunked + b"%x\r\n" % len(content) + content + b"\r\n",
        SSE_HEAD + byte_order_mark + content,
        SSE_HEAD.replace(b"200 OK", b"201 Created") + content,
        whole({"choices": [{"message": {"role": "assistant", "content": ANSWER}}]}),
    ):
        assert asked(lambda _body, reply=reply: reply)[0] == [ANSWER], reply


@pytest.mark.logs("answered with HTTP status 500")
def test_a_packed_answer_is_unpacked_and_never_fills_the_memory() -> None:
    def packed(coding: str, body: bytes) -> bytes:
        return SSE_HEAD.replace(b"\r\n\r\n", f"\r\nContent-Encoding: {coding}\r\n\r\n".encode()) + body

    answer = event(chunk({"content": ANSWER})) + event(STOP)
    assert asked(lambda _body: packed("gzip", gzip.compress(answer)))[0] == [ANSWER]
    assert asked(lambda _body: packed("deflate", zlib.compress(answer)))[0] == [ANSWER]
    bomb = gzip.compress(b"x" * (1 << 26))
    for coding, body in (("gzip", bomb), ("gzip, gzip", gzip.compress(bomb)), ("gzip", answer), ("zstd", answer)):
        for reply in (packed(coding, body), packed(coding, body).replace(b"200 OK", b"500 Internal Server Error")):
            with pytest.raises(LanguageModelError):
                asked(lambda _body, reply=reply: reply)


@pytest.mark.parametrize("indent", [None, 2])
def test_an_answer_that_comes_at_once_is_taken(indent: int | None) -> None:
    message = {"choices": [{"index": 0, "message": {"content": ANSWER}, "finish_reason": "stop"}], "usage": {}}
    assert asked(lambda _body: whole(json.dumps(message, indent=indent).encode()))[0] == [ANSWER]
    candidates = [{"content": {"parts": [{"text": part}]}} for part in ("The lab ", "closes at six.")]
    listed = [{"candidates": [candidates[0]]}, {"candidates": [{**candidates[1], "finishReason": "STOP"}]}]
    assert asked(lambda _body: whole(json.dumps(listed, indent=indent).encode()), provider="gemini")[0] == [ANSWER]


def test_a_server_that_goes_on_after_the_end_is_left() -> None:
    async def goes_on(writer: asyncio.StreamWriter) -> None:
        writer.write(SSE_HEAD + event(chunk({"content": ANSWER})) + event(STOP))
        while True:
            writer.write(event({"choices": [], "usage": {}}))
            await writer.drain()
            await asyncio.sleep(0.01)

    assert ask(goes_on)[0] == [ANSWER]


def refusing(*names: str, how: Callable[[str], dict[str, Any]]) -> Reply:
    def reply(body: dict[str, Any]) -> bytes:
        flat = {**body, **body.get("options", {}), **body.get("generationConfig", {})}
        refused = next((name for name in names if name in flat), "")
        if refused:
            return whole(how(refused), "400 Bad Request")
        if "contents" in body:
            return sse({"candidates": [{"content": {"parts": [{"text": ANSWER}]}, "finishReason": "STOP"}]})
        if "options" in body:
            return LINES_HEAD + json.dumps({"message": {"content": ANSWER}, "done": True}).encode() + b"\n"
        return sse(chunk({"content": ANSWER}), STOP)

    return reply


@pytest.mark.parametrize(
    ("provider", "names", "how"),
    [
        ("openai", ("temperature",), lambda name: {"error": {
            "message": "Only the default (1) value is supported.", "param": name, "code": "unsupported_value"}}),
        ("openai", ("max_tokens",), lambda name: {"error": {
            "message": f"Unsupported parameter: '{name}' is not supported with this model. Use 'max_completion_tokens' "
            "instead.", "param": None}}),
        ("openai", ("temperature", "max_tokens", "seed"), lambda name: {"detail": [
            {"loc": ["body", name], "msg": "Extra inputs are not permitted", "type": "extra_forbidden"}]}),
        ("openai", ("seed",), lambda name: {"object": "error", "message": f"Unknown parameter: {name}.", "code": 400}),
        ("ollama", ("think",), lambda _name: {"error": "\"some-model\" does not support thinking"}),
        ("ollama", ("temperature",), lambda name: {"error": f"invalid option: {name}"}),
        ("gemini", ("temperature", "maxOutputTokens"), lambda name: {"error": {
            "code": 400, "message": f"Invalid value at 'generation_config.{name}'", "status": "INVALID_ARGUMENT"}}),
    ],
)  # fmt: skip
def test_a_parameter_that_is_refused_is_left_out_once_and_for_all(
    provider: str, names: tuple[str, ...], how: Callable[[str], dict[str, Any]]
) -> None:
    answers, notes, served = asked(refusing(*names, how=how), provider=provider, times=2)
    assert answers == [ANSWER, ANSWER]
    assert len(served.bodies) == 2 + len(names), "it is remembered"
    assert set(notes.left_out) == set(names)


@pytest.mark.logs("answered with HTTP status")
@pytest.mark.parametrize(
    ("provider", "status", "error"),
    [
        ("openai", "400 Bad Request", {"object": "error", "message": "System role not supported", "code": 400}),
        ("openai", "500 Internal Server Error", {"error": {"message": "Jinja: System role not supported"}}),
        ("openai", "400 Bad Request", {"error": {
            "message": "Unsupported value: 'messages[0].role' does not support 'system' with this model.",
            "param": "messages[0].role"}}),
        ("gemini", "400 Bad Request", {"error": {"message": "Developer instruction is not enabled for gemma-3"}}),
    ],
)  # fmt: skip
def test_a_model_without_a_system_role_gets_its_prompt_with_the_question(
    provider: str, status: str, error: dict[str, Any]
) -> None:
    def reply(body: dict[str, Any]) -> bytes:
        if "systemInstruction" in body or any(one["role"] == "system" for one in body.get("messages", ())):
            return whole(error, status)
        return refusing(how=lambda _name: {})(body)

    answers, notes, served = asked(reply, provider=provider, times=2)
    assert answers == [ANSWER, ANSWER] and notes.left_out == ("system role",) and len(served.bodies) == 3
    sent: Any = served.bodies[-1]
    text = sent["contents"][0]["parts"][0]["text"] if provider == "gemini" else sent["messages"][0]["content"]
    assert text == "\n\n".join(message.content for message in QUESTION)


def test_a_server_that_does_not_stream_is_asked_for_the_whole_answer() -> None:
    def reply(body: dict[str, Any]) -> bytes:
        if "stream" in body:
            message = "Your organization must be verified to stream this model."
            return whole(
                {"error": {"message": message, "param": "stream", "code": "unsupported_value"}}, "400 Bad Request"
            )
        return whole({"choices": [{"message": {"content": ANSWER}, "finish_reason": "stop"}]})

    assert asked(reply)[0] == [ANSWER]


def test_reasoning_models_have_room_and_are_limited() -> None:
    def config(model: str) -> dict[str, Any]:
        endpoint = ModelEndpoint("gemini", "https://generativelanguage.googleapis.com", model)
        return dict(gemini_request(endpoint, Question(QUESTION, 64, 0.0)).body["generationConfig"])

    room = 64 + REASONING_TOKENS
    for model, limit, thinking in (
        ("gemini-2.5-flash", room, {"thinkingBudget": 0}), ("gemini-2.5-flash-lite", room, {"thinkingBudget": 0}),
        ("gemini-2.5-pro", room, {"thinkingBudget": 128}), ("gemini-3-pro-preview", room, {"thinkingLevel": "low"}),
        ("gemini-flash-latest", room, None), ("gemini-2.0-flash", 64, None), ("gemma-3-27b-it", 64, None),
    ):  # fmt: skip
        assert config(model)["maxOutputTokens"] == limit, model
        assert config(model).get("thinkingConfig") == thinking, model

    def body(model: str) -> dict[str, Any]:
        endpoint = ModelEndpoint("openai", "https://api.openai.com/v1", model)
        return dict(openai_request(endpoint, Question(QUESTION, 64, 0.0)).body)

    assert body("gpt-5-mini")["max_completion_tokens"] == room and body("gpt-5-mini")["reasoning_effort"] == "low"
    assert body("gpt-4o-mini")["max_completion_tokens"] == 64 and "reasoning_effort" not in body("gpt-4o-mini")


@pytest.mark.parametrize(
    ("provider", "used_up"),
    [
        ("gemini", {"candidates": [{"content": {"role": "model"}, "finishReason": "MAX_TOKENS", "index": 0}]}),
        ("gemini", {"candidates": [{"finishReason": "MAX_TOKENS"}], "usageMetadata": {"thoughtsTokenCount": 61}}),
        ("openai", chunk({"content": ""}, "length")),
        ("openai", chunk({"content": f"<think>{SECRET}"}, "length")),
        ("openai", chunk({"content": None, "reasoning_content": SECRET}, "length")),
    ],
)
def test_a_limit_that_thinking_uses_up_is_left_out(provider: str, used_up: dict[str, Any]) -> None:
    def reply(body: dict[str, Any]) -> bytes:
        limited = "max_tokens" in body or "maxOutputTokens" in body.get("generationConfig", {})
        answer = {"candidates": [{"content": {"parts": [{"text": ANSWER}]}, "finishReason": "STOP"}]}
        if provider == "openai":
            answer = chunk({"content": ANSWER}, "stop")
        return sse(used_up if limited else answer)

    answers, _, served = asked(reply, provider=provider, times=2)
    assert answers == [ANSWER, ANSWER] and len(served.bodies) == 3
    with pytest.raises(LanguageModelError, match=r"answer length limit while it was still reasoning"):
        asked(lambda _body: sse(used_up), provider=provider)


def test_without_a_limit_of_the_server_an_answer_is_held_to_it_here() -> None:
    def reply(body: dict[str, Any]) -> bytes:
        return sse(chunk({}, "length")) if "max_tokens" in body else sse(*words(ANSWER * 100, 10), STOP)

    [answers], notes, _ = asked(reply, max_tokens=20)
    assert 100 <= len(answers) < 120 and notes.cut == "length"


@pytest.mark.parametrize(
    ("provider", "reply", "cut"),
    [
        ("openai", sse(chunk({"content": "The lab closes"}), chunk({}, "length")), "length"),
        ("openai", sse(chunk({"content": "The lab closes"}), chunk({"content": ""}, "content_filter")), "filter"),
        ("gemini", sse({"candidates": [{"content": {"parts": [{"text": "The lab closes"}]}}]},
                       {"candidates": [{"finishReason": "SAFETY"}]}), "filter"),
        ("gemini", sse({"candidates": [{"content": {"parts": [{"text": "The lab closes"}]},
                                        "finishReason": "MAX_TOKENS"}]}), "length"),
        ("ollama", LINES_HEAD + b'{"message": {"content": "The lab closes"}, "done": false}\n'
                                b'{"message": {"content": ""}, "done": true, "done_reason": "length"}\n', "length"),
        ("openai", sse(chunk({"content": "The lab closes"}, "stop")), ""),
        ("openai", sse(chunk({"content": "The lab closes"}, "eos")), ""),
        ("openai", sse(chunk({"content": "The lab closes"}), chunk({}, "MAX_TOKENS")), "length"),
        ("openai", sse(chunk({"content": "The lab closes"}), chunk({}, "model_length")), "length"),
        ("openai", sse(chunk({"content": "The lab closes"}), chunk({}, "SAFETY")), "filter"),
        ("openai", sse(chunk({"content": "The lab closes"}), chunk({}, "content_filter: PROHIBITED")), "filter"),
        ("openai", sse(chunk({"content": "The lab closes"}), chunk({}, "sensitive")), "filter"),
    ],
)  # fmt: skip
def test_an_answer_that_is_cut_is_marked(provider: str, reply: bytes, cut: str) -> None:
    answers, notes, _ = asked(lambda _body: reply, provider=provider)
    assert (answers, notes.cut) == (["The lab closes"], cut)


@pytest.mark.logs("answered with HTTP status", "reported an error in the stream")
@pytest.mark.parametrize(
    ("reply", "reason", "advice"),
    [
        (whole({"object": "error", "message": "This model's maximum context length is 2048 tokens. However, you "
                "requested 2305 tokens.", "param": None}, "400 Bad Request"), "length is 2048", "Shorten the system"),
        (whole({"detail": [{"loc": ["body", "model"], "msg": "model not loaded"}]}, "422 Unprocessable"),
         "model: model not loaded", "Check the model's name"),
        (whole(b"model requires more system memory", "400 Bad Request", "text/plain"), "system memory", "smaller"),
        (whole({"error": {"message": "Invalid role: tool"}}, "400 Bad Request"), "Invalid role", "the reason names"),
        (sse(chunk({"content": "The lab "}), chunk({"content": ""}, "error")), "stopped with an error", "Ask again"),
        (sse(chunk({"content": "It "}), chunk({}, "insufficient_system_resource")), "insufficient_", "Ask again"),
        (sse(chunk({"content": "The lab "}), chunk({}, "abort")), "stopped with an error: abort", "Ask again"),
        (sse(chunk({"content": "The lab "}), {"object": "error", "message": "CUDA out of memory", "code": 500}),
         "stopped with an error: CUDA out of memory", "Ask again"),
        (SSE_HEAD + b'event: error\ndata: {"message": "slot is gone", "code": 500}\n\n', "slot is gone", "Ask again"),
        (SSE_HEAD + b'error: {"code": 500, "message": "slot is gone"}\n\n', "slot is gone", "Ask again"),
        (whole({"detail": "Not authenticated"}), "Not authenticated", "Ask again"),
        (whole({"success": False, "errors": [{"code": 7003, "message": "No route"}]}), "No route", "Ask again"),
        (whole(b"Bad gateway", kind="text/plain"), "Bad gateway", "address belongs to a language model"),
        (whole({"error": {"message": "Provider returned error", "code": 502, "metadata": {"raw": "no memory left"}}}),
         "Provider returned error: no memory left", "Ask again"),
        (whole({"error": {"message": "Insufficient Balance"}}, "402 Payment Required"), "Insufficient", "credit"),
        (whole({"error": {"code": "content_filter", "message": "The prompt triggered the content management policy."}},
               "400 Bad Request"), "content management", "Rephrase"),
        (whole({"error": {"message": "some-model is not a valid model ID"}}, "400 Bad Request"), "not a valid",
         "Check the model's name"),
        (whole({"detail": "Not Found"}, "404 Not Found"), "at this address", "/v1"),
        (sse(chunk({"tool_calls": [{"index": 0}]}), chunk({}, "tool_calls")), "called a tool", "tools"),
        # Mistral and Open WebUI
        (whole({"object": "error", "message": {"detail": [{"loc": ["body", "tools"], "msg": "Extra inputs"}]}},
               "422 Unprocessable"), "tools: Extra inputs", "the reason names"),
        (whole({"error": "model requires more system memory (5.5 GiB) than is available"}, "500 Internal Server Error"),
         "system memory", "smaller model"),
        (whole({"error": True, "message": "The server is asleep"}), "The server is asleep", "Ask again"),
        (whole({"error": {"type": "overloaded_error"}}), "overloaded_error", "Ask again"),
        (sse(chunk({"content": ""}, "content_filter")), "refused to answer this (content_filter)",
         "Rephrase the question"),
    ],
)  # fmt: skip
def test_the_true_reason_of_a_refusal_is_reported(reply: bytes, reason: str, advice: str) -> None:
    with pytest.raises(LanguageModelError) as caught:
        asked(lambda _body: reply)
    assert reason in caught.value.what and advice in caught.value.advice
    assert "does not have the model" not in caught.value.what


@pytest.mark.parametrize(
    ("messages", "ok", "found"),
    [
        (
            [*words(f"<think>{SECRET}</think>**The lab** closes at `six`."), STOP],
            True, ("answers “The lab closes at six.”", "first word after", "it reasons first"),
        ),
        ([chunk({"content": "The lab closes"}), chunk({}, "length")], False, ("its answer is cut off",)),
        ([chunk({"content": "***"}), STOP], False, ("None of this answer can be spoken",)),
        ([chunk({"content": f"<think>{SECRET}"}), STOP], False, ("reasoned but gave no answer",)),
    ],
)  # fmt: skip
def test_check_hears_the_answer_to_a_question_to_its_end(
    monkeypatch: pytest.MonkeyPatch, messages: list[Any], found: tuple[str, ...], *, ok: bool
) -> None:
    thread, stack = AsyncioThread(), AsyncExitStack()
    served = thread.submit(stack.enter_async_context(serving(sends(sse(*messages))))).result(10.0)
    monkeypatch.setenv("OPENAI_BASE_URL", served.url)
    try:
        result = probe_language_model("openai:m", local_only=True)
    finally:
        thread.submit(stack.aclose()).result(10.0)
        thread.stop()
    assert result.ok is ok, result
    assert all(part in f"{result.text} {result.advice}" for part in found), result
    assert "remote-controlled" not in result.text
    [question] = served.bodies[0]["messages"]  # type: ignore[misc]
    assert "?" in question["content"]


def test_one_connection_serves_question_after_question() -> None:
    connections, drops = list[asyncio.StreamWriter](), [False, False, False, True, False]

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connections.append(writer)
        with contextlib.suppress(asyncio.IncompleteReadError, asyncio.CancelledError, ConnectionError):
            while True:
                head = (await reader.readuntil(b"\r\n\r\n")).decode().lower()
                await reader.readexactly(int(head.split("content-length: ")[1].split("\r\n")[0]))
                body = b"".join(map(event, [*words(ANSWER), STOP, {"choices": [], "usage": {}}])) + b"data: [DONE]\n\n"
                chunked = b"%x\r\n%s\r\n0\r\n\r\n" % (len(body), body)
                writer.write(b"HTTP/1.1 200 OK\r\nTransfer-Encoding: chunked\r\n\r\n" + chunked)
                if drops.pop(0):
                    break  # as a server does with an idle connection
        writer.close()

    async def run() -> list[str]:
        server = await asyncio.start_server(answer, "127.0.0.1", 0)
        async with server:
            endpoint = ModelEndpoint("openai", f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}", "m")
            answers = []
            for _ in range(5):
                stream = stream_chat(
                    endpoint, QUESTION, local_only=False, max_tokens=20, temperature=0.5, timeouts=PATIENT,
                    retries=Retries(0),
                )  # fmt: skip
                answers.append("".join([piece async for piece in stream]))
            for writer in connections:
                writer.close()  # from Python 3.12 on, the server waits for them
        return answers

    assert asyncio.run(run()) == [ANSWER] * 5
    assert len(connections) == 2


@pytest.mark.parametrize(
    "name", ["gpt-oss:120b-cloud", "gpt-oss:120B-Cloud", "kimi:CLOUD", "my-cloud", "my-Cloud:latest"]
)
def test_a_model_of_ollamas_cloud_is_not_local_however_it_is_written(name: str) -> None:
    assert ModelEndpoint("ollama", "http://127.0.0.1:11434", name).leaves_computer
    assert not ModelEndpoint("ollama", "http://127.0.0.1:11434", "cloudy:7b").leaves_computer


@pytest.mark.parametrize(
    ("shown", "here"),
    [
        (whole({"remote_host": "https://ollama.com:443", "remote_model": "gpt-oss:120b"}), False),
        (whole({"remote_model": "gpt-oss:120b", "details": {}}), False),
        (whole({"details": {"family": "llama"}}), True),
        (whole({"error": "not found"}, "404 Not Found"), True),
    ],
)
def test_another_name_for_a_model_of_ollamas_cloud_gets_no_question_where_models_are_local(
    shown: bytes, *, here: bool
) -> None:
    async def run() -> list[str]:
        async def answer(writer: asyncio.StreamWriter) -> None:
            asked_to_show = "/api/show" in served.heads[-1]
            line = json.dumps({"message": {"content": ANSWER}, "done": True}).encode() + b"\n"
            writer.write(shown if asked_to_show else LINES_HEAD + line)
            await writer.drain()

        async with serving(answer) as served:
            endpoint = ModelEndpoint("ollama", served.url, "helper")
            stream = stream_chat(endpoint, QUESTION, local_only=True, max_tokens=9, temperature=0.0, timeouts=PATIENT)
            try:
                answers = [piece async for piece in stream]
            except LanguageModelError as error:
                answers = [error.what]
            return [*answers, *(head.split()[1] for head in served.heads)]

    told = asyncio.run(run())
    if here:
        assert told == [ANSWER, "/api/show", "/api/chat"]
    else:
        assert "not on this computer" in told[0] and told[1:] == ["/api/show"]


MUTATIONS = 200


def test_no_mutation_of_an_answer_kills_anything_or_lets_reasoning_out() -> None:
    """Each mutation gives an answer or an error message; reasoning is never spoken."""
    chance = random.Random(25)  # noqa: S311 - a test, not cryptography
    good = sse(*words(f"<think>{SECRET}</think>{ANSWER}"), STOP, {"choices": [], "usage": {}})
    lines = LINES_HEAD + b"".join(
        json.dumps({"message": {"content": part}, "done": False}).encode() + b"\n" for part in ("The lab ", "closes.")
    )
    marked = [
        b"<img src='/dev/zero'>",
        b"\x00",
        b"\xff\xfe",
        b"\x1b[2J",
        b"null",
        b"[" * 5000,
        b'{"a":' * 2000,
        b"\n\n",
    ]
    outcomes: list[str] = []
    for number in range(MUTATIONS):
        provider, stream = ("ollama", lines) if number % 4 == 3 else ("openai", good)
        head, body = stream.split(b"\r\n\r\n", 1)
        data = bytearray(body)
        for _ in range(chance.randint(1, 4)):
            at, length = chance.randrange(len(data)), chance.randint(0, 40)
            match chance.randrange(5):
                case 0:
                    del data[at : at + length]
                case 1:
                    data[at:at] = chance.choice(marked)
                case 2:
                    data[at:at] = data[chance.randrange(len(data)) :][:length]
                case 3:
                    data[at] = chance.randrange(256)
                case _:
                    data[at:] = b"" if chance.random() < 0.3 else data[at:]
            data = data or bytearray(b"\n")
        reply = head + b"\r\n\r\n" + bytes(data)
        try:
            [answers], _, _ = asked(lambda _body, reply=reply: reply, provider=provider)  # type: ignore[misc]
        except LanguageModelError as error:
            assert error.what and error.meaning and error.advice
            outcomes.append("failed")
        else:
            outcomes.append("answered")
            assert "remote-controlled" not in answers or b"<think>" not in _joined(bytes(data)), answers
    assert outcomes.count("answered") > MUTATIONS // 10 and outcomes.count("failed") > MUTATIONS // 10


def _joined(body: bytes) -> bytes:
    """Text of a mutated stream; a mutated reasoning mark makes the reasoning indistinguishable."""
    text = ""
    for line in body.split(b"\n"):
        try:
            text += json.loads(line.removeprefix(b"data: "))["choices"][0]["delta"]["content"]
        except (ValueError, LookupError, TypeError, RecursionError):
            continue
    return text.encode()
