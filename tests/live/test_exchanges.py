"""Recording of each question to the model, without data of the previous session."""

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from typing import Any

import pytest
from pytestqt.qtbot import QtBot

from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint
from caris_desktop.domain.events import AnswerUsed, ChatMessage, LlmExchange
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.live.background_worker import AsyncioThread
from caris_desktop.live.model_client import ModelClient
from caris_desktop.live.services.assistant_service import MOST_EXCHANGES_SHOWN, MOST_PENDING_EXCHANGES, Exchanges
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import AssistantStatus

PROMPT = (ChatMessage("system", "You guide tours."), ChatMessage("user", "Where is the café?"))
MODEL = ModelEndpoint("ollama", "http://127.0.0.1:11434", "small")


class Desk:
    """The service with a model that answers ``pieces`` and then ends, fails, or waits for cancellation."""

    def __init__(self, asyncio_thread: AsyncioThread) -> None:
        self.asyncio = asyncio_thread
        self.pieces = ["Straight ", "on."]
        self.waits = False
        self.failure: LanguageModelError | None = None
        self.tells = ""
        self.seeds: list[int | None] = []
        self.looks_up: Callable[[], str] = lambda: ""
        self.published: list[Any] = []
        self.closed = threading.Event()
        self.state = LiveState()
        client = ModelClient(asyncio_thread, self._stream_chat, self._publish, ask_version=self._ask_version)
        self.asking = Exchanges(self.state, client, self._publish)
        self.use(MODEL, "Small")

    def _publish(self, value: Any) -> None:
        self.published.append(value)

    async def _stream_chat(
        self,
        _endpoint: ModelEndpoint,
        _messages: object,
        *,
        on_version: Callable[[str], None],
        seed: int | None,
        **_more: object,
    ) -> AsyncIterator[str]:
        self.seeds.append(seed)
        try:
            if self.tells:
                on_version(self.tells)
            for piece in self.pieces:
                yield piece
            if self.failure is not None:
                raise self.failure
            if self.waits:
                await asyncio.Event().wait()
        finally:
            self.closed.set()

    def use(self, endpoint: ModelEndpoint, display_name: str) -> None:
        self.asking.use_endpoint(endpoint, display_name=display_name, local_only=False)

    async def _ask_version(self, endpoint: ModelEndpoint, *, local_only: bool) -> str:
        return await asyncio.to_thread(self.looks_up)

    def ask(self, question: str = "Where?") -> str:
        exchange_id = self.asking.prepare(question)
        self.asking.ask(exchange_id, PROMPT, max_tokens=20, temperature=0.5)
        return exchange_id

    @property
    def rows(self) -> list[tuple[str, str, str]]:
        """Question, state and use of each exchange, newest first."""
        return [(row.question, row.state, row.use) for row in self.shown.exchanges]

    @property
    def shown(self) -> AssistantStatus:
        status: AssistantStatus = self.state.assistant.value
        return status

    @property
    def exchanges(self) -> list[LlmExchange]:
        return [value for value in self.published if isinstance(value, LlmExchange)]

    @property
    def uses(self) -> list[tuple[str, str, str]]:
        """Exchange, use and text."""
        return [(use.exchange_id, use.use, use.text) for use in self.published if isinstance(use, AnswerUsed)]

    @property
    def outline(self) -> list[str]:
        """Outcomes and uses in the order of publication."""
        return [value.outcome if isinstance(value, LlmExchange) else value.use for value in self.published]

    def has_run(self) -> None:
        """Run the ready tasks of the asyncio thread, without delivering their results to the GUI thread."""
        for _ in range(3):
            self.asyncio.submit(asyncio.sleep(0)).result(10.0)


@pytest.fixture
def desk(qtbot: QtBot) -> Iterator[Desk]:
    thread = AsyncioThread()
    yield Desk(thread)
    thread.stop()


def _answered(desk: Desk, qtbot: QtBot) -> LlmExchange:
    count = len(desk.exchanges)
    desk.ask()
    qtbot.waitUntil(lambda: len(desk.exchanges) == count + 1)
    return desk.exchanges[-1]


def test_an_exchange_is_recorded_with_all_that_led_to_it(desk: Desk, qtbot: QtBot) -> None:
    desk.tells = "small-2026 fp_1"
    exchange = _answered(desk, qtbot)
    assert (exchange.provider, exchange.model, exchange.model_version) == ("ollama", "Small", "small-2026 fp_1")
    assert exchange.messages == PROMPT
    assert exchange.parameters == {"max_tokens": 20, "temperature": 0.5}
    assert (exchange.server, exchange.seed) == ("127.0.0.1:11434", desk.seeds[0])
    assert (exchange.answer, exchange.outcome) == ("Straight on.", "answered")
    assert exchange.first_token_ns is not None
    assert 0 < exchange.asked_ns <= exchange.first_token_ns <= exchange.stamp_ns
    assert (desk.shown.state, desk.shown.answer) == ("ready", "Straight on.")


def test_each_question_has_a_seed_of_its_own_where_the_server_takes_one(desk: Desk, qtbot: QtBot) -> None:
    seeds = [_answered(desk, qtbot).seed for _ in range(3)]
    assert seeds == desk.seeds
    assert len(set(seeds)) == 3
    desk.use(ModelEndpoint("openai", "https://somebody:secret@models.example.org:8443/v1", "big"), "Big")
    exchange = _answered(desk, qtbot)
    assert (exchange.server, exchange.seed) == ("models.example.org:8443", None)


def test_the_version_is_asked_once_next_to_the_first_answer_and_never_holds_it_up(desk: Desk, qtbot: QtBot) -> None:
    asked: list[None] = []
    told = threading.Event()

    def look_up() -> str:
        asked.append(None)
        assert told.wait(10.0)
        return "sha256:0123456789ab"

    desk.has_run()
    desk.looks_up = look_up
    desk.use(MODEL, "Small")
    assert _answered(desk, qtbot).model_version == ""
    told.set()
    qtbot.waitUntil(lambda: _answered(desk, qtbot).model_version == "sha256:0123456789ab")
    assert len(asked) == 1


def test_a_version_that_was_not_to_be_had_is_requested_with_the_next_question(desk: Desk, qtbot: QtBot) -> None:
    desk.has_run()
    desk.looks_up = lambda: "sha256:0123456789ab"
    qtbot.waitUntil(lambda: _answered(desk, qtbot).model_version == "sha256:0123456789ab")


def test_an_answer_that_nobody_used_is_dismissed_once(desk: Desk, qtbot: QtBot) -> None:
    first = _answered(desk, qtbot)
    second = _answered(desk, qtbot)
    assert desk.uses == [], "both can still be said"
    desk.asking.dismiss(first.exchange_id, "", "wizard")
    desk.asking.dismiss(first.exchange_id, "", "wizard")
    assert desk.uses == [(first.exchange_id, "dismissed", "Straight on.")]
    desk.asking.show_status(AssistantStatus(state="off"))
    desk.use(MODEL, "Small")
    desk.asking.forget()
    desk.asking.forget()
    assert desk.uses[1:] == [(second.exchange_id, "dismissed", "Straight on.")]


def test_several_questions_are_pending_and_each_ends_as_it_ends(desk: Desk, qtbot: QtBot) -> None:
    answered = desk.ask("First?")
    qtbot.waitUntil(lambda: desk.shown.state == "ready")
    desk.waits = True
    cancelled, waiting = desk.ask("Second?"), desk.ask("Third?")
    qtbot.waitUntil(lambda: all(row.answer for row in desk.shown.exchanges))
    assert desk.shown.state == "answering"
    desk.asking.cancel("cancelled by the wizard", cancelled)
    assert desk.rows == [("Third?", "answering", ""), ("Second?", "cancelled", ""), ("First?", "answered", "")]
    desk.asking.note_use("Straight on!", "u-1", answered)
    desk.asking.note_use("Straight on.", "u-2", answered)
    assert desk.uses == [(answered, "edited", "Straight on!")], "each has one fate, whatever is said of it again"
    desk.asking.dismiss(waiting, "cancelled by the wizard")
    assert desk.rows == [("Second?", "cancelled", ""), ("First?", "answered", "edited")]
    desk.asking.forget()
    assert (desk.rows, desk.outline) == ([], ["answered", "cancelled", "edited", "cancelled"])


def test_no_more_than_a_few_are_asked_at_once_and_the_oldest_answers_make_room(desk: Desk, qtbot: QtBot) -> None:
    for _ in range(MOST_EXCHANGES_SHOWN + 1):
        _answered(desk, qtbot)
    assert len(desk.rows) == MOST_EXCHANGES_SHOWN
    assert desk.uses == [(desk.exchanges[0].exchange_id, "dismissed", "Straight on.")]
    desk.waits = True
    for _ in range(MOST_PENDING_EXCHANGES):
        desk.ask()
    with pytest.raises(UserFacingError, match="still in the field"):
        desk.asking.prepare("One more?")
    desk.asking.cancel("enough")
    assert desk.shown.state == "ready"


def test_a_question_cancelled_before_its_pictures_are_read_is_never_sent(desk: Desk) -> None:
    exchange_id = desk.asking.prepare("What is this?")
    assert desk.rows == [("What is this?", "preparing", "")]
    desk.asking.cancel("cancelled by the wizard", exchange_id)
    desk.asking.ask(exchange_id, PROMPT, max_tokens=20, temperature=0.5)
    assert desk.rows == [("What is this?", "cancelled", "")]
    assert desk.seeds == [] and desk.published == []


@pytest.mark.parametrize(
    ("answer", "text", "use"),
    [
        ("Straight on.", "Straight on.", "said"),
        ("Straight on,\n\nthen left.", "Straight on, then left.", "said"),
        ("Straight on.", "Straight on!", "edited"),
    ],
)
def test_an_answer_that_was_used_is_not_dismissed(desk: Desk, qtbot: QtBot, answer: str, text: str, use: str) -> None:
    desk.pieces = [answer]
    exchange = _answered(desk, qtbot)
    desk.asking.note_use(text, "u-1", exchange.exchange_id)
    desk.asking.forget()
    assert desk.uses == [(exchange.exchange_id, use, text)]


def test_failed_and_cancelled_questions_are_not_dismissed(desk: Desk, qtbot: QtBot) -> None:
    desk.failure = LanguageModelError("It broke.", "No answer.", "Ask again.")
    assert _answered(desk, qtbot).outcome == "failed"
    desk.failure, desk.waits = None, True
    desk.ask()
    qtbot.waitUntil(lambda: desk.shown.answer != "")
    desk.asking.cancel("cancelled by the wizard")
    desk.asking.forget()
    assert desk.outline == ["failed", "cancelled"]


def test_forgetting_publishes_the_pending_question_at_once_and_nothing_afterwards(desk: Desk, qtbot: QtBot) -> None:
    desk.waits = True
    desk.ask()
    qtbot.waitUntil(lambda: desk.shown.answer != "")
    desk.asking.forget()
    assert desk.outline == ["cancelled"], "before the next session can begin"
    assert desk.exchanges[0].answer == "Straight on." and desk.exchanges[0].messages == PROMPT
    assert desk.shown == AssistantStatus(state="ready", model="Small")
    assert desk.closed.wait(10.0), "the model was told to stop"
    desk.has_run()
    qtbot.wait(1)
    desk.asking.note_use("Straight on.", "u-1")
    assert desk.outline == ["cancelled"]
    assert desk.shown == AssistantStatus(state="ready", model="Small")


def test_an_answer_that_came_as_all_was_forgotten_is_recorded_as_answered_and_dismissed(
    desk: Desk, qtbot: QtBot
) -> None:
    desk.ask()
    desk.has_run()
    desk.asking.forget()
    assert desk.outline == ["answered", "dismissed"]
    qtbot.wait(1)
    assert desk.outline == ["answered", "dismissed"]
    assert desk.shown.answer == "" and desk.shown.question == ""


def test_another_model_ends_the_question_to_the_last_one(desk: Desk, qtbot: QtBot) -> None:
    desk.waits = True
    desk.ask()
    desk.use(ModelEndpoint("openai", "http://127.0.0.1:1/v1", "other"), "Other")
    assert [(exchange.model, exchange.outcome) for exchange in desk.exchanges] == [("Small", "cancelled")]
    assert (desk.shown.state, desk.shown.model) == ("ready", "Other")


def test_an_answer_of_an_earlier_model_can_still_be_spoken(desk: Desk, qtbot: QtBot) -> None:
    exchange = _answered(desk, qtbot)
    desk.use(ModelEndpoint("openai", "http://127.0.0.1:1/v1", "other"), "Other")
    assert [(row.model, row.answer) for row in desk.shown.exchanges] == [("Small", "Straight on.")]
    desk.asking.note_use("Straight on.", "u-1", exchange.exchange_id)
    assert desk.uses == [(exchange.exchange_id, "said", "Straight on.")]


def test_forgetting_keeps_why_there_is_no_model(desk: Desk, qtbot: QtBot) -> None:
    _answered(desk, qtbot)
    desk.asking.show_status(AssistantStatus(state="failed", detail="The language model stopped."))
    desk.asking.forget()
    assert desk.shown == AssistantStatus(state="failed", detail="The language model stopped.")


def test_a_model_that_is_ready_after_the_console_has_closed_harms_nobody(desk: Desk) -> None:
    desk.asyncio.stop()
    desk.use(MODEL, "Small")
