"""Streaming chat with real HTTP servers on loopback that answer correctly, misbehave or vanish."""

import asyncio
import json
import ssl
import sys
import types
from dataclasses import replace
from pathlib import Path

import pytest

from caris_desktop.conversation.models.chat import ChatTimeouts, Retries, stream_chat
from caris_desktop.conversation.models.connection import model_version, models_here
from caris_desktop.conversation.models.dialects import ollama_request, openai_request
from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint, Provider, resolve_endpoint
from caris_desktop.conversation.models.question import Question
from tests.conversation.models.served import (
    LINES_HEAD,
    PATIENT,
    QUESTION,
    SSE_HEAD,
    Answer,
    Served,
    ask,
    collect,
    delta,
    ollama_line,
    refused,
    sends,
    serving,
)  # fmt: skip
from tests.support.certificates import Authority


def test_openai_answer_arrives_piece_by_piece() -> None:
    role = b'data: {"choices": [{"delta": {"role": "assistant"}, "finish_reason": null}]}\n\n'
    pieces, served = ask(
        sends(SSE_HEAD, b": ping\n\n", role, delta("Straight "), delta("on."), delta("", "stop"), b"data: [DONE]\n\n")
    )
    assert pieces == ["Straight ", "on."]
    assert served.heads[0].startswith("POST /v1/chat/completions HTTP/1.1")
    assert "authorization" not in served.heads[0].lower()
    assert served.bodies == [
        {
            "model": "some-model",
            "messages": [
                {"role": "system", "content": "You guide tours."},
                {"role": "user", "content": "Where is the café?"},
            ],
            "stream": True,
            "max_tokens": 20,
            "temperature": 0.5,
        }
    ]


def test_a_seed_goes_to_servers_that_take_one() -> None:
    async def body_of(provider: str) -> dict[str, object]:
        lines = [ollama_line("Hi"), ollama_line("", done=True)]
        answer = sends(LINES_HEAD, *lines) if provider == "ollama" else sends(SSE_HEAD, delta("Hi"), delta("", "stop"))
        async with serving(answer) as served:
            endpoint = ModelEndpoint(provider, served.url, "some-model")  # type: ignore[arg-type]
            async for _ in stream_chat(endpoint, QUESTION, local_only=False, max_tokens=9, temperature=0.0, seed=77):
                pass
            return served.bodies[0]

    assert asyncio.run(body_of("openai"))["seed"] == 77
    options = asyncio.run(body_of("ollama"))["options"]
    assert isinstance(options, dict)
    assert options["seed"] == 77
    # A server with a copy of OpenAI's API may refuse unknown parameters.
    foreign = ModelEndpoint("openai", "https://models.example.org/v1", "m")
    assert "seed" not in openai_request(foreign, Question(QUESTION, 9, 0.0, seed=77)).body
    assert ModelEndpoint("openai", "https://api.openai.com/v1", "m").takes_seed
    assert ModelEndpoint("openai", "https://me:key@models.example.org:8443/v1", "m").server == "models.example.org:8443"


def test_a_picture_goes_with_the_question_as_each_server_takes_it() -> None:
    def last_message(provider: str) -> dict[str, object]:
        endpoint = ModelEndpoint(provider, "http://127.0.0.1:1/v1", "m")  # type: ignore[arg-type]
        request = ollama_request if provider == "ollama" else openai_request
        body = request(endpoint, Question(QUESTION, 9, 0.0, jpegs=(b"\xff\xd8",))).body
        assert [message["content"] for message in body["messages"][:-1]] == [each.content for each in QUESTION[:-1]]
        return dict(body["messages"][-1])

    asked = QUESTION[-1].content
    assert last_message("openai")["content"] == [
        {"type": "text", "text": asked},
        {"type": "image_url", "image_url": {"url": "data:image/jpeg;base64,/9g="}},
    ]
    to_ollama = last_message("ollama")
    assert (to_ollama["content"], to_ollama["images"]) == (asked, ["/9g="])
    with pytest.raises(LanguageModelError, match="cannot process pictures"):
        last_message("embedded")


def test_ollama_answer_arrives_piece_by_piece() -> None:
    pieces, served = ask(
        sends(LINES_HEAD, ollama_line("Straight "), ollama_line("on."), ollama_line("", done=True)), provider="ollama"
    )
    assert pieces == ["Straight ", "on."]
    assert served.heads[0].startswith("POST /api/chat HTTP/1.1")
    assert served.bodies[0]["options"] == {"num_predict": 20, "temperature": 0.5}


def told_versions(*told: dict[str, object], key_env: str | None = None) -> list[str]:
    choice = {"index": 0, "delta": {"content": "Yes."}}
    messages = [b"data: " + json.dumps({"choices": [choice], **one}).encode() + b"\n\n" for one in told]

    async def run() -> list[str]:
        versions: list[str] = []
        async with serving(sends(SSE_HEAD, *messages, b"data: [DONE]\n\n")) as served:
            endpoint = ModelEndpoint("openai", served.url, "some-model", (key_env,) if key_env else ())
            stream = stream_chat(
                endpoint, QUESTION, local_only=False, max_tokens=9, temperature=0.0, on_version=versions.append
            )
            assert [piece async for piece in stream] == ["Yes."] * len(told)
            return versions

    return asyncio.run(run())


def test_the_model_and_its_fingerprint_are_reported_as_the_server_reports_them() -> None:
    full: dict[str, object] = {"model": "some-model-2026-08-06", "system_fingerprint": "fp_1"}
    assert told_versions(full, full) == ["some-model-2026-08-06 fp_1"]
    assert told_versions({"model": "org/some-model", "system_fingerprint": None}) == ["org/some-model"]
    assert told_versions({}) == []
    assert told_versions({"model": 7, "system_fingerprint": ["fp"]}) == []


def test_a_version_holds_no_key_no_address_and_no_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TEST_MODEL_KEY", "sk-very-secret")
    told = told_versions({"model": "m sk-very-secret", "system_fingerprint": "fp"}, key_env="TEST_MODEL_KEY")
    assert told == ["m [key] fp"]
    assert told_versions({"model": "http://lab-pc/models/m"}) == []
    assert told_versions({"model": "/home/somebody/models/small.gguf"}) == ["small.gguf"]
    assert told_versions({"model": "C:\\Users\\Somebody\\small.gguf"}) == ["small.gguf"]


def test_a_server_that_goes_by_its_address_reports_no_version() -> None:
    async def answer(writer: asyncio.StreamWriter) -> None:
        host, port = writer.get_extra_info("sockname")
        writer.write(json_reply({"data": [{"id": f"small at {host}:{port}"}]}))

    async def run() -> str:
        async with serving(answer) as served:
            return await model_version(ModelEndpoint("embedded", served.url, "embedded"), local_only=True)

    assert asyncio.run(run()) == ""


DIGEST = "BAF6A787FDFF" + "0" * 52
TAGS = {"models": [{"name": "other:1b", "digest": "1" * 64}, {"name": "small:latest", "digest": DIGEST.lower()}]}


def listed_version(reply: bytes, *, model: str = "small", provider: Provider = "ollama") -> tuple[str, list[str]]:
    async def run() -> tuple[str, list[str]]:
        async with serving(sends(reply)) as served:
            return await model_version(ModelEndpoint(provider, served.url, model), local_only=True), served.heads

    return asyncio.run(run())


def json_reply(message: object, status: str = "200 OK") -> bytes:
    return f"HTTP/1.1 {status}\r\nConnection: close\r\n\r\n{json.dumps(message)}".encode()


def test_ollama_reports_the_digest_of_a_model_in_its_list() -> None:
    version, heads = listed_version(json_reply(TAGS))
    assert version == "sha256:baf6a787fdff"
    assert heads[0].startswith("GET /api/tags HTTP/1.1")
    assert listed_version(json_reply(TAGS), model="small:latest")[0] == version
    assert listed_version(json_reply(TAGS), model="other:1b")[0] == "sha256:111111111111"


@pytest.mark.parametrize(
    "reply",
    [
        json_reply({"models": []}),
        json_reply({"models": [None, {"name": "small", "digest": "http://lab-pc/x"}, {"name": "small"}]}),
        json_reply(["small"]),
        json_reply(TAGS, "404 Not Found"),
        b"HTTP/1.1 200 OK\r\nConnection: close\r\n\r\n<html>",
        b"SSH-2.0\r\n",
    ],
)
def test_a_server_that_reports_no_version_leaves_it_empty(reply: bytes) -> None:
    assert listed_version(reply)[0] == ""


def test_nobody_is_requested_a_version_that_comes_with_the_answer() -> None:
    assert listed_version(json_reply(TAGS), provider="openai") == ("", [])


def test_a_server_that_is_not_there_reports_no_version() -> None:
    assert asyncio.run(model_version(ModelEndpoint("ollama", "http://127.0.0.1:9", "m"), local_only=True)) == ""


def test_bytes_may_be_cut_anywhere() -> None:
    stream = SSE_HEAD + (delta("Grüße ") + delta("你好", "stop")).replace(b"\n", b"\r\n") + b"data: [DONE]\n\n"
    pieces, _ = ask(sends(*(stream[at : at + 1] for at in range(len(stream)))))
    assert pieces == ["Grüße ", "你好"]


def test_a_finished_answer_does_not_wait_for_a_server_that_keeps_the_line_open() -> None:
    pieces, _ = ask(sends(SSE_HEAD, delta("Yes.", "stop"), then_waits=True))
    assert pieces == ["Yes."]


def test_hidden_reasoning_counts_as_life_but_is_not_shown() -> None:
    async def answer(writer: asyncio.StreamWriter) -> None:
        writer.write(SSE_HEAD)
        for _ in range(4):
            writer.write(delta("", reasoning_content="hmm"))
            await asyncio.sleep(0.15)
        writer.write(delta("Yes.", "stop"))

    assert ask(answer)[0] == ["Yes."]


@pytest.mark.logs("answered with HTTP status")
def test_the_key_is_sent_and_reported_to_nobody_else(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("TEST_MODEL_KEY", "sk-very-secret")
    body = b'{"error": {"message": "Incorrect API key provided: sk-very-secret"}}'
    head = f"HTTP/1.1 401 Unauthorized\r\nContent-Length: {len(body)}\r\n\r\n".encode()
    caplog.set_level("DEBUG")
    error = refused(sends(head + body), key_env="TEST_MODEL_KEY")
    assert "refused access" in error.what
    assert "TEST_MODEL_KEY" in error.advice
    assert "sk-very-secret" not in f"{error} {error.__cause__} {caplog.text}"
    _, served = ask(sends(SSE_HEAD, delta("Yes.", "stop")), key_env="TEST_MODEL_KEY")
    assert "authorization: bearer sk-very-secret" in served.heads[0].lower()


def test_the_key_may_be_in_the_keyring(monkeypatch: pytest.MonkeyPatch) -> None:
    keyring = types.ModuleType("keyring")
    keyring.get_password = lambda service, name: f"{service}/{name}"  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "keyring", keyring)
    monkeypatch.delenv("TEST_MODEL_KEY", raising=False)
    _, served = ask(sends(SSE_HEAD, delta("Yes.", "stop")), key_env="TEST_MODEL_KEY")
    assert "authorization: bearer caris-desktop/test_model_key" in served.heads[0].lower()


def test_a_key_with_a_line_break_is_not_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TEST_MODEL_KEY", "sk-one\nsk-two")
    error = refused(sends(SSE_HEAD), key_env="TEST_MODEL_KEY")
    assert "characters" in error.what
    assert "sk-" not in str(error)


def test_openai_itself_is_not_asked_without_a_key(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    endpoint = resolve_endpoint("openai:some-model", embedded_url=None, environment={})
    with pytest.raises(LanguageModelError, match="OPENAI_API_KEY"):
        asyncio.run(collect(endpoint))


def status(line: str, body: bytes = b"") -> bytes:
    return f"HTTP/1.1 {line}\r\nContent-Length: {len(body)}\r\n\r\n".encode() + body


@pytest.mark.logs("answered with HTTP status", "reported an error in the stream", "exchange with .* failed")
@pytest.mark.parametrize(
    ("provider", "reply", "expected"),
    [
        ("ollama", status("404 Not Found", b'{"error": "model not found"}'), "ollama pull some-model"),
        ("openai", status("404 Not Found", b"<html>"), "does not have the model"),
        ("openai", status("429 Too Many Requests"), "Wait a moment"),
        ("openai", status("500 Internal Server Error", b"\xff\xfe"), "HTTP status 500"),
        ("openai", status("302 Found"), "HTTP status 302"),
        ("openai", status("400 Bad Request", b'{"error": {"message": "too\\n\\u001b[31mlong"}}'), "too [31mlong"),
        ("openai", SSE_HEAD + b'data: {"error": {"message": "out of memory"}}\n\n', "out of memory"),
        ("openai", SSE_HEAD + b'{"error": "out of memory"}\n', "out of memory"),
        ("ollama", LINES_HEAD + b'{"error": "out of memory"}\n', "out of memory"),
        ("openai", SSE_HEAD + b"data: {broken\n\n", "is not valid JSON"),
        ("openai", SSE_HEAD + b"data: " + b"[" * 100_000 + b"\n\n", "is not valid JSON"),
        ("openai", SSE_HEAD + b"data: []\n\n", "not a JSON object"),
        ("openai", SSE_HEAD + b'data: {"choices": [7]}\n\n', "no delta"),
        ("openai", SSE_HEAD + b'data: {"choices": [{"delta": {"content": 7}}]}\n\n', "not text"),
        ("openai", SSE_HEAD + b"data: \xff\xfe\n\n", "not UTF-8"),
        ("ollama", LINES_HEAD + b'{"message": 7}\n', "no content"),
        ("openai", SSE_HEAD + b"data: " + b"x" * 1_100_000, "over a megabyte"),
        ("openai", SSE_HEAD + (b"data: " + b"x" * 90_000 + b"\n") * 12, "over a megabyte"),
        ("openai", SSE_HEAD + b"data: " + b"x" * 10_000_000, "over a megabyte"),
        ("ollama", LINES_HEAD + b"x" * 10_000_000, "over a megabyte"),
        ("openai", b"HTTP/1.1 200 OK\r\nContent-Type: text/html\r\n\r\n<html>Log in", "it is a web page"),
        ("ollama", b"HTTP/1.1 200 OK\r\nContent-Type: image/png\r\n\r\n\x89PNG", "it is image/png"),
        ("openai", SSE_HEAD, "returned an empty answer"),
        ("openai", SSE_HEAD + delta("", "stop"), "returned an empty answer"),
        ("openai", SSE_HEAD + delta("Half an") + b"data: [DONE]\n\n", "stopped in the middle of the answer"),
        ("ollama", LINES_HEAD + ollama_line("", done=True), "returned an empty answer"),
        ("openai", SSE_HEAD + delta("Half an"), "stopped in the middle of the answer"),
        ("ollama", LINES_HEAD + ollama_line("Half an"), "stopped in the middle of the answer"),
        (
            "openai",
            b"HTTP/1.1 200 OK\r\nContent-Length: 9999\r\n\r\n" + delta("Half an"),
            "stopped in the middle of the answer",
        ),
        ("openai", b"SSH-2.0-OpenSSH_9.2\r\n", "connection"),
        ("openai", b"", "connection"),
    ],
)
def test_an_invalid_answer_becomes_a_clear_error(provider: str, reply: bytes, expected: str) -> None:
    error = refused(sends(reply), provider=provider)
    assert expected in f"{error.what} {error.advice}"
    assert error.what and error.meaning and error.advice


def test_pieces_before_the_line_was_cut_are_retained() -> None:
    pieces: list[str] = []
    with pytest.raises(LanguageModelError, match="stopped in the middle of the answer"):
        ask(sends(SSE_HEAD, delta("Half "), delta("an")), pieces=pieces)
    assert pieces == ["Half ", "an"]


@pytest.mark.parametrize("head", [b"", SSE_HEAD, SSE_HEAD + b": ping\n\n" * 3])
def test_a_server_that_never_begins_is_abandoned(head: bytes) -> None:
    # The timeout covers the connection and the first token.
    short = ChatTimeouts(connect_s=0.5, first_token_s=0.2, between_tokens_s=20.0)
    error = refused(sends(head, then_waits=True), timeouts=short)
    assert "did not start to answer" in error.what


def test_a_server_that_falls_silent_is_abandoned() -> None:
    error = refused(sends(SSE_HEAD, delta("Half an"), then_waits=True), timeouts=replace(PATIENT, between_tokens_s=0.3))
    assert "sent nothing for" in error.what


def test_an_answer_without_end_is_abandoned() -> None:
    async def answer(writer: asyncio.StreamWriter) -> None:
        writer.write(SSE_HEAD)
        while True:
            writer.write(delta("x" * 50_000))
            await writer.drain()

    assert "the answer is too long" in refused(answer).what


def test_the_readers_own_pauses_are_not_held_against_the_server() -> None:
    async def run() -> list[str]:
        pieces = []
        async with serving(sends(SSE_HEAD, delta("a"), delta("b"), delta("c", "stop"))) as served:
            endpoint = ModelEndpoint("openai", served.url, "m")
            limits = ChatTimeouts(first_token_s=5.0, between_tokens_s=0.2)
            async for piece in stream_chat(
                endpoint, QUESTION, local_only=False, max_tokens=9, temperature=0.0, timeouts=limits
            ):
                pieces.append(piece)
                await asyncio.sleep(0.3)
        return pieces

    assert asyncio.run(run()) == ["a", "b", "c"]


@pytest.mark.logs("exchange with .* failed")
def test_nobody_listening_is_reported_with_what_to_do() -> None:
    endpoint = ModelEndpoint("ollama", "http://127.0.0.1:9", "m")
    with pytest.raises(LanguageModelError, match="ollama serve"):
        asyncio.run(collect(endpoint))


@pytest.mark.parametrize("way", ["cancel", "close"])
def test_giving_up_closes_the_line_to_the_server(way: str) -> None:
    async def run() -> bool:
        async with serving(sends(SSE_HEAD, delta("Well, "), then_waits=True)) as served:
            endpoint = ModelEndpoint("openai", served.url, "m")
            stream = stream_chat(endpoint, QUESTION, local_only=False, max_tokens=9, temperature=0.0)
            assert await anext(stream) == "Well, "
            if way == "close":
                await stream.aclose()
            else:
                waiting = asyncio.ensure_future(anext(stream))
                await asyncio.sleep(0)
                waiting.cancel()
                with pytest.raises(asyncio.CancelledError):
                    await waiting
            async with asyncio.timeout(5.0):
                await served.client_gone.wait()
        return True

    assert asyncio.run(run())


def test_a_proxy_never_sees_local_requests(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
    monkeypatch.delenv("NO_PROXY", raising=False)
    assert ask(sends(SSE_HEAD, delta("Yes.", "stop")))[0] == ["Yes."]


@pytest.mark.parametrize(
    ("model", "environment", "provider", "base_url", "name"),
    [
        ("embedded", {}, "embedded", "http://127.0.0.1:5000", "embedded"),
        ("ollama:llama3.2:1b", {}, "ollama", "http://127.0.0.1:11434", "llama3.2:1b"),
        ("ollama:m", {"OLLAMA_HOST": "0.0.0.0"}, "ollama", "http://127.0.0.1:11434", "m"),
        ("ollama:m", {"OLLAMA_HOST": ":8080"}, "ollama", "http://127.0.0.1:8080", "m"),
        ("ollama:m", {"OLLAMA_HOST": "lab-pc"}, "ollama", "http://lab-pc:11434", "m"),
        ("ollama:m", {"OLLAMA_HOST": "https://lab-pc/models/"}, "ollama", "https://lab-pc:443/models", "m"),
        ("ollama:m", {"OLLAMA_HOST": "[::1]:9000"}, "ollama", "http://[::1]:9000", "m"),
        ("openai:gpt", {}, "openai", "https://api.openai.com/v1", "gpt"),
        ("openai:m", {"OPENAI_BASE_URL": "http://lab-pc:8000"}, "openai", "http://lab-pc:8000", "m"),
        ("openai:m", {"OPENAI_BASE_URL": "http://[::1]/v1/chat/completions/"}, "openai", "http://[::1]/v1", "m"),
    ],
)
def test_models_are_found_where_the_scenario_and_environment_say(
    model: str, environment: dict[str, str], provider: str, base_url: str, name: str
) -> None:
    endpoint = resolve_endpoint(model, embedded_url="http://127.0.0.1:5000", environment=environment)
    assert (endpoint.provider, endpoint.base_url, endpoint.model) == (provider, base_url, name)


@pytest.mark.parametrize(
    ("model", "environment", "expected"),
    [
        ("", {}, "is not a valid language model"),
        ("gemini:", {}, "is not a valid language model"),
        ("ollama:", {}, "is not a valid language model"),
        ("embedded", {}, "not running"),
        ("ollama:m", {"OLLAMA_HOST": "ftp://lab-pc"}, "OLLAMA_HOST"),
        ("openai:m", {"OPENAI_BASE_URL": "http://lab-pc:port"}, "OPENAI_BASE_URL"),
        ("openai:m", {"OPENAI_BASE_URL": "http://me:secret@lab-pc"}, "keys do not belong"),
        ("openai:m", {"OPENAI_BASE_URL": "http://lab pc"}, "OPENAI_BASE_URL"),
        ("openai:m", {"OPENAI_BASE_URL": "https://lab-pc/v1?api-version=1"}, "OPENAI_BASE_URL"),
    ],
)
def test_unusable_models_and_addresses_are_refused(model: str, environment: dict[str, str], expected: str) -> None:
    with pytest.raises(LanguageModelError, match=expected) as caught:
        resolve_endpoint(model, embedded_url=None, environment=environment)
    assert "secret" not in str(caught.value)


RETRY_AT_ONCE = Retries(first_s=0.01)


def in_turn(*replies: bytes) -> Answer:
    """A different reply to each request; the last one repeatedly."""
    left = list(replies)

    async def answer(writer: asyncio.StreamWriter) -> None:
        writer.write(left.pop(0) if len(left) > 1 else left[0])
        await writer.drain()

    return answer


GOOD = SSE_HEAD + delta("Yes.", "stop")


@pytest.mark.logs("answered with HTTP status", "exchange with .* failed")
@pytest.mark.parametrize("first", [status("503 Service Unavailable"), status("500 Oh"), status("429 Too Many"), b""])
def test_a_server_that_is_busy_is_asked_again_before_it_began(first: bytes) -> None:
    pieces, served = ask(in_turn(first, GOOD), retries=RETRY_AT_ONCE)
    assert pieces == ["Yes."]
    assert served.bodies[0] == served.bodies[1]


@pytest.mark.logs("answered with HTTP status")
def test_it_is_asked_three_times_and_no_more() -> None:
    async def run() -> int:
        async with serving(sends(status("503 Service Unavailable"))) as served:
            with pytest.raises(LanguageModelError, match="HTTP status 503"):
                await collect(ModelEndpoint("openai", served.url, "m"), retries=RETRY_AT_ONCE)
            return len(served.bodies)

    assert asyncio.run(run()) == 3


def refused_by(answer: Answer) -> tuple[LanguageModelError, Served]:
    async def run() -> tuple[LanguageModelError, Served]:
        async with serving(answer) as served:
            with pytest.raises(LanguageModelError) as caught:
                await collect(ModelEndpoint("openai", served.url, "m"), retries=RETRY_AT_ONCE)
            return caught.value, served

    return asyncio.run(run())


@pytest.mark.logs("answered with HTTP status")
@pytest.mark.parametrize(
    ("header", "body", "waits_s"),
    [
        ("Retry-After: 3", b"", 3.0),
        ("Retry-After: 3600", b"", None),
        ("Retry-After: Wed, 21 Oct 2015 07:28:00 GMT", b"", 0.0),
        ("Retry-After: whenever", b"", 0.0),
        ("X-Nothing: 1", b'{"error": {"details": [{"retryDelay": "2.5s"}, 7]}}', 2.5),
        ("X-Nothing: 1", b'[{"error": {"details": [{"retryDelay": "900s"}]}}]', None),
    ],
)
def test_the_time_that_a_server_requests_is_given_up_to_a_bound(
    monkeypatch: pytest.MonkeyPatch, header: str, body: bytes, waits_s: float | None
) -> None:
    waited: list[float] = []
    really_sleep = asyncio.sleep

    async def sleep(seconds: float) -> None:
        if seconds >= 0.005:  # the test server pauses between its parts
            waited.append(seconds)
        await really_sleep(0)

    monkeypatch.setattr(asyncio, "sleep", sleep)
    busy = f"HTTP/1.1 429 Too Many\r\n{header}\r\nContent-Length: {len(body)}\r\n\r\n".encode() + body
    if waits_s is None:
        error, _served = refused_by(in_turn(busy, GOOD))
        assert "accepts no questions for" in error.advice
        assert waited == []
    else:
        assert ask(in_turn(busy, GOOD), retries=RETRY_AT_ONCE)[0] == ["Yes."]
        assert len(waited) == 1 and max(waits_s, 0.005) <= waited[0] <= max(waits_s, 0.02)


@pytest.mark.logs("answered with HTTP status")
def test_a_permanent_error_is_requested_once() -> None:
    for line in ("400 Bad Request", "401 Unauthorized", "404 Not Found"):
        _told, served = refused_by(in_turn(status(line), GOOD))
        assert len(served.bodies) == 1


def test_an_answer_that_has_begun_is_never_requested_again() -> None:
    error, served = refused_by(in_turn(SSE_HEAD + delta("Half an"), GOOD))
    assert "stopped in the middle of the answer" in error.what
    assert len(served.bodies) == 1


@pytest.mark.logs("answered with HTTP status")
def test_waiting_for_a_busy_server_is_reported_and_can_be_cancelled() -> None:
    async def run() -> list[str]:
        told: list[str] = []
        busy = asyncio.Event()

        def take(why: str) -> None:
            told.append(why)
            busy.set()

        async with serving(sends(b"HTTP/1.1 429 Busy\r\nRetry-After: 9\r\nContent-Length: 0\r\n\r\n")) as served:
            endpoint = ModelEndpoint("openai", served.url, "m")
            stream = stream_chat(endpoint, QUESTION, local_only=False, max_tokens=9, temperature=0.0, on_wait=take)
            waiting = asyncio.ensure_future(anext(stream))
            await busy.wait()
            waiting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await waiting
        return told

    (told,) = asyncio.run(run())
    assert "is not accepting questions now" in told and "tries again in 9 s" in told


@pytest.mark.parametrize(
    "endpoint",
    [
        ModelEndpoint("openai", "https://api.openai.com/v1", "m", ("OPENAI_API_KEY",)),
        ModelEndpoint("gemini", "https://generativelanguage.googleapis.com", "m", ("GEMINI_API_KEY",)),
        ModelEndpoint("ollama", "http://192.168.1.7:11434", "m"),
        ModelEndpoint("ollama", "http://127.0.0.1:9", "big:120b-cloud"),
        ModelEndpoint("ollama", "http://127.0.0.1:9", "big:cloud"),
        ModelEndpoint("embedded", "http://[2001:db8::1]:80", "embedded"),
    ],
)
def test_with_local_models_only_nothing_is_sent_or_even_looked_up(
    monkeypatch: pytest.MonkeyPatch, endpoint: ModelEndpoint
) -> None:
    async def nobody(*_: object, **__: object) -> object:
        raise AssertionError("somebody was looked up or connected to")

    async def run() -> None:
        loop = asyncio.get_running_loop()
        monkeypatch.setattr(loop, "getaddrinfo", nobody)
        monkeypatch.setattr(loop, "create_connection", nobody)
        with pytest.raises(LanguageModelError, match="allows only local models"):
            await anext(stream_chat(endpoint, QUESTION, local_only=True, max_tokens=9, temperature=0.0))
        assert await model_version(endpoint, local_only=True) == ""
        assert await models_here(endpoint) == ()

    asyncio.run(run())


def test_a_name_that_stands_for_this_computer_has_to_lead_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    async def elsewhere(*_: object, **__: object) -> list[tuple[object, ...]]:
        return [(2, 1, 6, "", ("127.0.0.1", 0)), (2, 1, 6, "", ("192.0.2.1", 0))]

    async def run() -> None:
        monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", elsewhere)
        endpoint = ModelEndpoint("openai", "http://localhost:9/v1", "m")
        with pytest.raises(LanguageModelError, match="not on this computer"):
            await anext(stream_chat(endpoint, QUESTION, local_only=True, max_tokens=9, temperature=0.0))

    asyncio.run(run())


@pytest.mark.logs("answered with HTTP status")
def test_a_local_server_cannot_send_a_question_on_to_another() -> None:
    async def run() -> tuple[LanguageModelError, int]:
        async with serving(sends(GOOD)) as other:
            moved = f"HTTP/1.1 307 Moved\r\nLocation: {other.url}\r\nContent-Length: 0\r\n\r\n".encode()
            async with serving(sends(moved)) as served:
                with pytest.raises(LanguageModelError) as caught:
                    await collect(ModelEndpoint("openai", served.url, "m"))
            return caught.value, len(other.heads)

    error, asked = asyncio.run(run())
    assert "not followed" in error.what
    assert asked == 0


@pytest.mark.logs("exchange with .* failed")
def test_a_server_that_cannot_prove_who_it_is_gets_nothing(tmp_path: Path) -> None:
    files = Authority(tmp_path).issue("127.0.0.1")
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    context.load_cert_chain(files.certificate, files.key)

    async def run() -> tuple[LanguageModelError, list[str]]:
        async with serving(sends(GOOD), tls=context) as served:
            with pytest.raises(LanguageModelError) as caught:
                await collect(ModelEndpoint("openai", served.url, "m"), retries=RETRY_AT_ONCE)
            return caught.value, served.heads

    error, heads = asyncio.run(run())
    assert "cannot be verified" in error.what and "not trusted: this computer does not know" in error.what
    assert heads == []
