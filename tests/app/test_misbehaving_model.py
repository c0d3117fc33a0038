"""Faults of a language model server while the wizard speaks, types and asks."""

import time
from collections.abc import Callable, Iterator
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from PySide6.QtCore import QCoreApplication
from PySide6.QtWidgets import QApplication

from caris_desktop.app import composition
from caris_desktop.conversation.models.chat import ChatTimeouts, Retries, stream_chat
from caris_desktop.conversation.models.endpoint import ModelEndpoint
from caris_desktop.domain import intents
from caris_desktop.domain.events import LlmExchange, UtteranceChanged
from caris_desktop.live.background_worker import AsyncioThread
from caris_desktop.live.console import Console
from caris_desktop.live.services.assistant_service import AssistantService
from caris_desktop.live.status import AssistantStatus
from tests.conversation.models.served import SSE_HEAD, Answer, Served, delta, sends, serving
from tests.support.polling import wait_for

pytestmark = pytest.mark.logs(r"live\.bus: ", "answered with HTTP status", "exchange with .* failed")
WAIT = ChatTimeouts(connect_s=0.5, first_token_s=0.5, between_tokens_s=0.5)
# Servers that answer at once get enough time on a busy machine.
_LONG = ChatTimeouts(connect_s=20.0, first_token_s=20.0, between_tokens_s=20.0)
_WAITS = {"never": WAIT, "half": replace(_LONG, between_tokens_s=WAIT.between_tokens_s)}


def whole(status: str, *headers: str, body: bytes = b"") -> Answer:
    head = "".join(f"{header}\r\n" for header in headers)
    return sends(f"HTTP/1.1 {status}\r\n{head}Content-Length: {len(body)}\r\n\r\n".encode() + body)


# Behaviour, message to the wizard, and partial answer.
WAYS: dict[str, tuple[Answer, str, str]] = {
    "never": (sends(then_waits=True), "did not start to answer within 0.5 s", ""),
    "500": (whole("500 Oh"), "failed (HTTP status 500)", ""),
    "429": (whole("429 Busy", "Retry-After: 600"), "is not accepting questions now", ""),
    "half": (sends(SSE_HEAD, delta("Half an"), then_waits=True), "sent nothing for 0.5 s", "Half an"),
    "json": (sends(SSE_HEAD, b"data: {broken\n\n"), "is not valid JSON", ""),
    "page": (whole("200 OK", "Content-Type: text/html", body=b"<html>"), "it is a web page", ""),
    "line": (sends(SSE_HEAD, b"data: " + b"x" * 10_000_000), "one line is over a megabyte", ""),
    "plain": (sends(b"SSH-2.0-OpenSSH_9.2\r\n"), "failed", ""),
}


@pytest.fixture(scope="module")
def servers() -> Iterator[dict[str, Served]]:
    thread = AsyncioThread()
    stack = AsyncExitStack()

    async def start() -> dict[str, Served]:
        return {name: await stack.enter_async_context(serving(answer)) for name, (answer, _, _) in WAYS.items()}

    yield thread.submit(start()).result(10.0)
    thread.submit(stack.aclose()).result(10.0)
    thread.stop()


class Desk:
    def __init__(self, study: Path, servers: dict[str, Served]) -> None:
        scenario = composition.find_scenario("tour-guide")
        scenario = replace(
            scenario, assistant=replace(scenario.assistant, model="openai:never", models=("openai:500",))
        )
        parts = composition.parts(study=composition.open_study(study))

        async def no_models() -> tuple[str, ...]:
            return ()

        async def as_asked(endpoint: ModelEndpoint, messages: Any, **given: Any) -> Any:
            """Each question goes to the server that it names."""
            way = messages[-1].content.rpartition(" ")[2]
            given |= {"timeouts": _WAITS.get(way, _LONG), "retries": Retries(at_most=1, first_s=0.01)}
            async for piece in stream_chat(replace(endpoint, base_url=servers[way].url), messages, **given):
                yield piece

        parts = replace(
            parts,
            assistant=replace(
                parts.assistant,
                stream_chat=as_asked,
                list_models=no_models,
                resolve_endpoint=lambda model, _url: ModelEndpoint("openai", "http://127.0.0.1:1/v1", model),
            ),
        )
        self.console = Console(parts, scenario)
        self.happened: list[Any] = []
        self.console.state.event_happened.connect(self.happened.append)
        next(service for service in self.console._services if isinstance(service, AssistantService)).start()

    @property
    def status(self) -> AssistantStatus:
        status: AssistantStatus = self.console.state.assistant.value
        return status

    @property
    def exchanges(self) -> list[LlmExchange]:
        return [event for event in self.happened if isinstance(event, LlmExchange)]

    def until(self, seen: Callable[[], Any], what: str) -> None:
        def look() -> Any:
            QCoreApplication.processEvents()
            return seen()

        wait_for(look, what, timeout_s=20.0)


@pytest.fixture
def desk(qapp: QApplication, tmp_path: Path, servers: dict[str, Served]) -> Iterator[Desk]:
    desk = Desk(tmp_path / "study", servers)
    yield desk
    desk.console.shutdown()


@pytest.mark.parametrize("ways", [("never", "500", "429", "half"), ("json", "page", "line", "plain")])
def test_each_failure_is_reported_next_to_its_question_while_the_wizard_continues(
    desk: Desk, ways: tuple[str, ...]
) -> None:
    for way in ways:
        assert desk.console.do(intents.Ask(f"What of {way}")) == ""
    assert desk.console.do(intents.Ask("One more of never")) != "", "the field keeps what is refused"
    # Speech, silence and marks do not wait for a model.
    assert desk.console.do(intents.Say("Please follow me.", "typed")) == ""
    assert any(row.is_pending for row in desk.status.exchanges)
    desk.until(lambda: any(isinstance(event, UtteranceChanged) for event in desk.happened), "the utterance")
    assert desk.console.do(intents.Mark("Laughs")) == desk.console.do(intents.Silence()) == ""
    desk.until(lambda: not any(row.is_pending for row in desk.status.exchanges), "the end of every question")
    for row in desk.status.exchanges:
        _, expected, answer = WAYS[row.question.rpartition(" ")[2]]
        assert (row.state, row.answer) == ("failed", answer)
        assert expected in row.detail
    desk.until(lambda: len(desk.exchanges) == 4, "each exchange, once")
    assert {exchange.outcome for exchange in desk.exchanges} == {"failed"}
    # A new question is handled by the same rules, without state of the previous ones.
    assert desk.console.do(intents.Ask("Once more of json")) == ""
    desk.until(lambda: desk.status.exchanges[0].state == "failed", "the end of the next question")


def test_a_question_is_cancelled_before_and_after_the_first_word(desk: Desk, servers: dict[str, Served]) -> None:
    for way in ("never", "half"):
        assert desk.console.do(intents.Ask(f"What of {way}")) == ""
    desk.until(lambda: desk.status.exchanges[0].answer == "Half an", "the first words")
    began_s = time.monotonic()
    for row in desk.status.exchanges:
        assert desk.console.do(intents.CancelAnswer(row.exchange_id)) == ""
    assert [row.state for row in desk.status.exchanges] == ["cancelled", "cancelled"]
    assert time.monotonic() - began_s < WAIT.first_token_s, "nobody waits for the server to notice"
    desk.until(servers["never"].client_gone.is_set, "that the server was left")
