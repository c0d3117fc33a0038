"""Language models of others: their process as the console starts it, and the console's own client."""

import asyncio
import multiprocessing
import os
import queue
import time
from collections.abc import Iterator
from contextlib import aclosing
from pathlib import Path
from typing import Any

import httpx
import pytest

from caris_desktop.app.plugin_contracts import check_language_model
from caris_desktop.conversation.embedded_server import EmbeddedReady, run_embedded_server
from caris_desktop.conversation.models.chat import stream_chat
from caris_desktop.conversation.models.connection import model_version
from caris_desktop.conversation.models.endpoint import EMBEDDED_KEY, LanguageModelError, ModelEndpoint, resolve_endpoint
from caris_desktop.domain.events import ChatMessage
from caris_desktop.domain.plugins import PluginCall, PluginFailed
from tests.support.plugins import install

_CONTEXT = multiprocessing.get_context("spawn")


def source(body: str, before: str = "") -> str:
    return f"""
import os, time
{before}

class Plugin:
    caris_interface = 1

    def answer(self, messages, *, max_tokens, temperature, seed, schema):
        {body}
"""


class Running:
    """Process of a plug-in, which is installed as ``lab``."""

    def __init__(self, folder: Path, module: str, monkeypatch: pytest.MonkeyPatch) -> None:
        install(folder, "language_models", "lab", module, monkeypatch)
        self.connection, theirs = _CONTEXT.Pipe()
        self.process = _CONTEXT.Process(target=run_embedded_server, args=(theirs, "plugin:lab", 0), daemon=True)
        self.process.start()
        theirs.close()

    def until(self, kind: type[Any]) -> Any:
        while self.connection.poll(60):
            if isinstance(message := self.connection.recv(), kind):
                return message
        raise queue.Empty

    def endpoint(self) -> ModelEndpoint:
        ready: EmbeddedReady = self.until(EmbeddedReady)
        assert ready.plugin is not None and ready.plugin.package == "lab-lab 2.1"
        os.environ[EMBEDDED_KEY] = ready.key
        return resolve_endpoint("plugin:lab", embedded_url=ready.url)

    def end(self) -> None:
        self.connection.close()
        self.process.join(10)
        if self.process.exitcode is None:
            self.process.kill()


@pytest.fixture
def started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    running: list[Running] = []

    def start(module: str) -> Running:
        running.append(Running(tmp_path, module, monkeypatch))
        return running[-1]

    yield start
    for each in running:
        each.end()


async def answer(endpoint: ModelEndpoint, **given: Any) -> list[str]:
    settings = {"local_only": False, "max_tokens": 20, "temperature": 0.0, "seed": 7} | given
    return [piece async for piece in stream_chat(endpoint, [ChatMessage("user", "Hello?")], **settings)]


def test_an_answer_comes_piece_by_piece_with_its_version(started: Any) -> None:
    body = "said = messages[-1]['content']; yield 'Hello '; yield f'{said} {seed}'"
    endpoint = started(source(body)).endpoint()
    versions: list[str] = []
    assert "".join(asyncio.run(answer(endpoint, on_version=versions.append))) == "Hello Hello? 7"
    assert versions == ["lab (lab-lab 2.1)"]
    assert asyncio.run(model_version(endpoint, local_only=False)) == "lab (lab-lab 2.1)"
    assert endpoint.leaves_computer, "nobody knows where it sends the question"
    with pytest.raises(LanguageModelError, match="allows only local models"):
        asyncio.run(answer(endpoint, local_only=True))
    assert httpx.get(f"{endpoint.base_url}/v1/models").status_code == 401, "others on this computer may not ask"


def test_a_schema_is_passed_on_and_an_answer_is_cut_at_its_length(started: Any) -> None:
    endpoint = started(source("yield str(schema) if schema else 'long ' * 1000")).endpoint()
    assert "".join(asyncio.run(answer(endpoint, schema={"type": "integer"}))) == "{'type': 'integer'}"
    assert len("".join(asyncio.run(answer(endpoint)))) == 100


def test_nobody_waiting_closes_the_iterator(started: Any, tmp_path: Path) -> None:
    body = f"""
        try:
            while True:
                yield 'again '
                time.sleep(0.05)
        finally:
            open({str(tmp_path / "closed")!r}, 'w').close()
"""
    endpoint = started(source(body.strip())).endpoint()

    async def begin() -> None:
        settings: dict[str, Any] = {"local_only": False, "max_tokens": 4000, "temperature": 0.0}
        async with aclosing(stream_chat(endpoint, [ChatMessage("user", "Hello?")], **settings)) as stream:
            await anext(stream)

    asyncio.run(begin())
    deadline_s = time.monotonic() + 20
    while not (tmp_path / "closed").exists():
        assert time.monotonic() < deadline_s, "it goes on for nobody"
        time.sleep(0.05)
    # The next question does not wait for the last one.
    assert asyncio.run(answer(endpoint, max_tokens=1)) == ["again"]


@pytest.mark.logs("reported an error in the stream")
@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("yield 'Well '; raise KeyError('who')", "it raised KeyError: 'who'"),
        ("return None", "it raised TypeError: 'NoneType' object is not iterable"),
        ("yield 3", "it yielded something else than text"),
        ("print('hello'); yield 'Well.'", "it printed “hello”"),
    ],
)
def test_a_failure_is_reported_with_its_reason(body: str, reason: str, started: Any) -> None:
    running = started(source(body))
    with pytest.raises(LanguageModelError, match="stopped with an error: it") as failed:
        asyncio.run(answer(running.endpoint()))
    assert reason in failed.value.what
    failure: PluginFailed = running.until(PluginFailed)
    assert (failure.plugin.name, failure.reason) == ("lab", reason)


@pytest.mark.logs("reported an error in the stream")
def test_a_lost_network_is_no_failure_of_the_plug_in(started: Any) -> None:
    running = started(source("raise TimeoutError('the lab server is slow')"))
    endpoint = running.endpoint()
    for _ in range(2):
        with pytest.raises(LanguageModelError, match="the lab server is slow"):
            asyncio.run(answer(endpoint))
    while running.connection.poll(0.5):
        assert isinstance(running.connection.recv(), PluginCall)


@pytest.mark.parametrize(
    ("module", "reason"),
    [
        (source("yield 'Well.'", "raise ImportError('no such library')"), "it raised ImportError: no such library"),
        ("class Plugin: caris_interface = 9", "it is written for version 9 of the interface, and this program has"),
    ],
)
def test_a_model_that_cannot_be_loaded_is_reported(module: str, reason: str, started: Any) -> None:
    failure: PluginFailed = started(module).until(PluginFailed)
    assert failure.reason.startswith(reason)


@pytest.mark.parametrize(
    ("pieces", "message"),
    [
        (["  "], "a question has an answer"),
        ([3], "something else than text"),
        (['{"answer": 3}'], "does not keep the schema"),
    ],
)
def test_the_contract_refuses(pieces: list[Any], message: str) -> None:
    class Model:
        caris_interface = 1

        def answer(self, _messages: Any, **_settings: Any) -> Iterator[Any]:
            yield from pieces

    with pytest.raises(AssertionError, match=message):
        check_language_model(Model)
