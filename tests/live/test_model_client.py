"""Concurrent exchanges with a language model, each with its own end."""

import asyncio
import json
from collections.abc import AsyncIterator, Iterator, Sequence
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.conversation.embedded_server import REPLIES_SLOT
from caris_desktop.conversation.models import failures
from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint
from caris_desktop.conversation.models.reasoning import Withdrawn
from caris_desktop.domain.events import ChatMessage, LlmExchange
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.recorded_messages import retranslate
from caris_desktop.domain.translation import QT_TR_NOOP, localized, tr
from caris_desktop.live.background_worker import AsyncioThread
from caris_desktop.live.model_client import ModelClient, Purpose

EMBEDDED = ModelEndpoint("embedded", "http://127.0.0.1:9", "embedded")
ELSEWHERE = ModelEndpoint("openai", "https://models.example.org/v1", "m")
_SERVER = "models.example.org"


class Talk:
    """Model that repeats the question word by word, and a client."""

    def __init__(self, asyncio_thread: AsyncioThread) -> None:
        self.published: list[LlmExchange] = []
        self.given: list[dict[str, Any]] = []
        self.asked: list[tuple[ChatMessage, ...]] = []
        self.texts: dict[str, list[str]] = {}
        self.waits: list[str] = []
        self.ended: list[LlmExchange] = []
        self.client = ModelClient(asyncio_thread, self._stream, self.published.append, ask_version=_no_version)
        self.client.use(EMBEDDED, display_name="Small", local_only=True)

    async def _stream(
        self, _endpoint: ModelEndpoint, messages: Sequence[ChatMessage], **given: Any
    ) -> AsyncIterator[str]:
        self.given.append(given)
        self.asked.append(tuple(messages))
        question = messages[-1].content
        for word in question.split():
            yield f"{word} "
        if "reasons" in question:
            yield Withdrawn()
            yield "Only this."
            given["notes"].reasoned = True
        if "is cut" in question:
            given["notes"].cut = "length"
            given["notes"].left_out = ("temperature", "seed")
        if "busy" in question:
            given["on_wait"]("It is busy.")
        if "broken off" in question:
            raise failures.broke_off(ELSEWHERE)
        if "fails" in question:
            raise LanguageModelError("It broke.", "No answer.", "Ask again.")
        if "crashes" in question:
            raise RuntimeError("the key is sk-secret")
        if "waits" in question:
            await asyncio.Event().wait()

    def ask(self, question: str, *, purpose: Purpose = "question", **more: Any) -> str:
        texts: list[str] = []
        asking = self.client.ask(
            [ChatMessage("user", question)], purpose=purpose, max_tokens=9, temperature=0.0,
            on_text=texts.append, on_wait=self.waits.append, on_end=self.ended.append, **more,
        )  # fmt: skip
        self.texts[asking] = texts
        return asking


async def _no_version(_endpoint: ModelEndpoint, *, local_only: bool) -> str:
    return ""


@pytest.fixture
def talk(qtbot: QtBot) -> Iterator[Talk]:
    thread = AsyncioThread()
    yield Talk(thread)
    thread.stop()


def test_several_requests_are_pending_and_each_has_its_own_fate(talk: Talk, qtbot: QtBot) -> None:
    waiting, failing = talk.ask("this waits"), talk.ask("this fails")
    schema = {"type": "object"}
    plain = talk.ask("this ends", purpose="replies", turn_id="u-7", revision=3, schema=schema, actor="wizard")
    qtbot.waitUntil(lambda: len(talk.ended) == 2 and bool(talk.texts[waiting]))
    assert talk.client.answering
    talk.client.cancel(waiting, "the conversation moved on")
    talk.client.cancel(waiting, "once is enough")
    assert not talk.client.answering
    outcomes = {exchange.exchange_id: exchange for exchange in talk.ended}
    assert outcomes[waiting].outcome == "cancelled"
    assert outcomes[waiting].detail == "the conversation moved on"
    assert outcomes[waiting].answer == "this waits"
    assert (outcomes[failing].outcome, outcomes[failing].detail) == (
        "failed", "It broke. Ask again.",
    )  # fmt: skip
    exchange = outcomes[plain]
    assert (exchange.outcome, exchange.purpose, exchange.turn_id, exchange.revision) == (
        "answered",
        "replies",
        "u-7",
        3,
    )
    assert exchange.actor == "wizard"
    assert talk.published == talk.ended, "each is recorded once"
    assert [given["schema"] for given in talk.given] == [None, None, schema]
    assert talk.texts[plain][0] == "this "


def test_the_recorded_question_may_be_shorter_than_the_request(talk: Talk, qtbot: QtBot) -> None:
    talk.ask("Who is Ada?", recorded=[ChatMessage("user", "Who is person 3?")], jpegs=[b"jpeg"], photo="a.png")
    qtbot.waitUntil(lambda: bool(talk.ended))
    assert talk.published[0].messages == (ChatMessage("user", "Who is person 3?"),)
    assert talk.published[0].photo == "a.png"
    assert talk.given[0]["jpegs"] == (b"jpeg",)


def test_a_wait_for_a_busy_server_is_reported(talk: Talk, qtbot: QtBot) -> None:
    talk.ask("busy")
    qtbot.waitUntil(lambda: bool(talk.ended))
    assert talk.waits == ["It is busy."]


def test_another_model_ends_all_that_was_asked_of_the_one_before(talk: Talk, qtbot: QtBot) -> None:
    talk.ask("first waits")
    talk.ask("second waits")
    talk.client.use(ELSEWHERE, display_name="Large", local_only=False)
    assert [(exchange.model, exchange.outcome) for exchange in talk.published] == [("Small", "cancelled")] * 2
    assert (talk.client.model, talk.client.answers_here) == ("Large", False)


def test_the_same_model_again_ends_nothing(talk: Talk, qtbot: QtBot) -> None:
    asking = talk.ask("this waits")
    talk.client.use(EMBEDDED, display_name="Small", local_only=True)
    assert talk.client.answering and talk.published == []
    talk.client.use(EMBEDDED, display_name="Small", local_only=False)
    assert [exchange.exchange_id for exchange in talk.published] == [asking]


def test_without_a_model_nobody_is_asked(talk: Talk) -> None:
    talk.client.use_none("It is still starting.")
    with pytest.raises(UserFacingError, match="It is still starting"):
        talk.ask("Where?")
    assert not talk.client.answering and talk.published == []


@pytest.mark.usefixtures("trial_language")
def test_the_reason_of_a_missing_answer_is_english_in_the_record(talk: Talk, qtbot: QtBot) -> None:
    talk.ask("broken off")
    qtbot.waitUntil(lambda: bool(talk.published))
    detail = talk.published[0].detail
    place = "The language model server at models.example.org"
    assert detail == f"{place} stopped in the middle of the answer. Use the partial answer, or ask again."
    server = tr("The language model server at {server}").format(server=_SERVER)
    broke, then = (
        tr("{place} stopped in the middle of the answer.").format(place=server),
        tr("Use the partial answer, or ask again."),
    )
    assert broke in tr(detail) and then in tr(detail)
    assert then in tr(retranslate(str.__str__(json.loads(json.dumps(detail))))), "in a replay"


@pytest.mark.usefixtures("trial_language")
def test_the_reason_of_a_wait_is_in_the_wizards_language(talk: Talk, qtbot: QtBot) -> None:
    why = localized(QT_TR_NOOP("{what} The console tries again in {seconds} s."), what="Busy.", seconds=3)
    asking = talk.ask("this waits")
    talk.client._waits.emit(asking, why)
    qtbot.waitUntil(lambda: bool(talk.waits))
    assert tr(talk.waits[0]) == tr(why) != why
    talk.client.cancel(asking, "")


@pytest.mark.logs("the language model exchange failed")
def test_an_error_of_the_program_ends_it_and_reports_no_secret(talk: Talk, qtbot: QtBot) -> None:
    talk.ask("this crashes")
    qtbot.waitUntil(lambda: bool(talk.ended))
    assert talk.ended[0].outcome == "failed"
    assert "sk-secret" not in talk.ended[0].detail


@pytest.mark.parametrize(("endpoint", "read"), [(EMBEDDED, 1), (ELSEWHERE, 0)])
def test_only_the_model_of_this_program_is_warmed_up_and_nothing_is_recorded_of_it(
    talk: Talk, qtbot: QtBot, endpoint: ModelEndpoint, read: int
) -> None:
    talk.client.use(endpoint, display_name="Model", local_only=False)
    talk.client.warm_up([ChatMessage("system", "You guide tours."), ChatMessage("user", "Hello.")], "question")
    talk.ask("Where?")
    qtbot.waitUntil(lambda: bool(talk.ended))
    assert [given["max_tokens"] for given in talk.given] == [1] * read + [9]
    assert len(talk.published) == 1


def test_a_delayed_value_is_read_once_as_it_is_then(talk: Talk, qtbot: QtBot) -> None:
    said = ["Hello."]
    for _ in range(3):  # another scenario with another model, and the report of the model
        talk.client.warm_up_soon(lambda: [ChatMessage("user", text) for text in said], "question")
    assert talk.given == [], "the window comes first"
    said[:] = ["Good evening."]
    qtbot.waitUntil(lambda: bool(talk.given))
    talk.ask("Where?")
    qtbot.waitUntil(lambda: bool(talk.ended))
    assert [given["max_tokens"] for given in talk.given] == [1, 9]
    assert talk.asked[0] == (ChatMessage("user", "Good evening."),)


def test_nothing_is_read_soon_for_a_model_that_answers_elsewhere(talk: Talk, qtbot: QtBot) -> None:
    read: list[str] = []

    def messages() -> list[ChatMessage]:
        read.append("read")
        return []

    talk.client.warm_up_soon(messages, "question")
    talk.client.use(ELSEWHERE, display_name="Large", local_only=False)
    talk.client._soon.timeout.emit()
    assert read == [] and talk.given == []


def test_participants_and_wizard_questions_share_one_memory(talk: Talk, qtbot: QtBot) -> None:
    talk.client.warm_up([ChatMessage("user", "Hello.")], "replies")
    purposes: tuple[Purpose, ...] = ("replies", "question", "actions", "question", "question")
    for purpose in purposes:
        talk.ask("this waits", purpose=purpose)
    qtbot.waitUntil(lambda: len(talk.given) == 6)
    assert [given["slot"] for given in talk.given] == [REPLIES_SLOT, REPLIES_SLOT, 1, REPLIES_SLOT, 2, 1]
    talk.client.use(ELSEWHERE, display_name="Large", local_only=False)
    talk.ask("Where?", purpose="replies")
    qtbot.waitUntil(lambda: len(talk.given) == 7)
    assert talk.given[-1]["slot"] is None


def test_it_is_reported_that_another_model_is_in_use(talk: Talk, qtbot: QtBot) -> None:
    with qtbot.waitSignal(talk.client.model_changed):
        talk.client.use(ELSEWHERE, display_name="Large", local_only=False)
    with qtbot.assertNotEmitted(talk.client.model_changed):
        talk.client.use(ELSEWHERE, display_name="Large", local_only=False)


def test_late_reasoning_is_not_in_the_answer(talk: Talk, qtbot: QtBot) -> None:
    asking = talk.ask("it reasons and answers")
    qtbot.waitUntil(lambda: bool(talk.ended))
    assert talk.published[0].answer == "Only this."
    assert not talk.texts[asking] or "Only this." not in talk.texts[asking][0]


def test_an_answer_that_is_cut_is_marked_with_what_was_left_out(talk: Talk, qtbot: QtBot) -> None:
    talk.ask("this is cut")
    talk.ask("this is whole")
    qtbot.waitUntil(lambda: len(talk.ended) == 2)
    cut, whole = sorted(talk.published, key=lambda exchange: exchange.answer)
    assert (cut.outcome, cut.cut, cut.parameters) == ("answered", "length", {"max_tokens": 9})
    assert "cut off" in cut.detail and cut.seed is None
    assert (whole.cut, whole.detail, whole.parameters["temperature"]) == ("", "", 0.0)
