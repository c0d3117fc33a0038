"""Asking the language model: one question at a time, streamed into ``state.assistant``. GUI thread.

The stream itself runs on the asyncio thread and reports through signals, at most every 30 ms.
"""

import asyncio
import logging
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from typing import Literal

from PySide6.QtCore import QObject, Signal

from caris_desktop.conversation.language_models import (
    LanguageModelError,
    ModelEndpoint,
    model_version,
    server_of,
    takes_seed,
)
from caris_desktop.domain import clock
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import AnswerUsed, ChatMessage, LlmExchange, LlmOutcome
from caris_desktop.domain.ports import ValueSink
from caris_desktop.live.asyncio_thread import AsyncioThread
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import AssistantStatus

_log = logging.getLogger(__name__)
_SHOW_EVERY_NS = 30_000_000
_SEEDS = 2**31  # what every server takes
StreamChat = Callable[..., AsyncIterator[str]]
AskVersion = Callable[[ModelEndpoint], Awaitable[str]]


@dataclass(frozen=True, slots=True)
class _Asked:
    exchange_id: str
    endpoint: ModelEndpoint
    model: str
    messages: tuple[ChatMessage, ...]
    recorded: tuple[ChatMessage, ...]
    max_tokens: int
    temperature: float
    asked_ns: int
    seed: int | None
    actor: Actor
    photo: str
    jpeg: bytes | None


@dataclass(slots=True)
class _Heard:
    """What came of a question so far. Written on the asyncio thread, read from both."""

    pieces: list[str] = field(default_factory=list)
    first_token_ns: int | None = None
    version: str = ""
    exchange: LlmExchange | None = None


@dataclass(frozen=True, slots=True)
class _Running:
    asked: _Asked
    heard: _Heard
    future: Future[None]


class Exchanges(QObject):
    """Owns the exchange under way. ``publish`` receives the recorded events: each exchange once, and of each answer
    what was done with it.

    ``ask_version`` is asked for the version of a model while its first question may be under way already.
    """

    _answer_grew = Signal(str, str)
    _exchange_ended = Signal(object)

    def __init__(
        self,
        state: LiveState,
        asyncio_thread: AsyncioThread,
        stream_chat: StreamChat,
        publish: ValueSink,
        parent: QObject | None = None,
        *,
        ask_version: AskVersion = model_version,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._asyncio = asyncio_thread
        self._stream_chat = stream_chat
        self._ask_version = ask_version
        self._publish = publish
        self._endpoint: ModelEndpoint | None = None
        self._shown_as = ""
        self._versions: dict[ModelEndpoint, str] = {}
        self._asking_version: Future[None] | None = None
        self._running: _Running | None = None
        self._last: LlmExchange | None = None
        self._last_used = False
        self._answer_grew.connect(self._on_answer_grew)
        self._exchange_ended.connect(self._on_exchange_ended)

    def use_endpoint(self, endpoint: ModelEndpoint, *, shown_as: str) -> None:
        """From now on ask this model; ``shown_as`` is its name for the wizard. What the last one answered is gone."""
        self._put_away("another model was chosen")
        self._endpoint = endpoint
        self._shown_as = shown_as
        self._state.assistant.set(AssistantStatus(state="ready", model=shown_as))
        self._find_version(endpoint)

    def show_status(self, status: AssistantStatus) -> None:
        """No model (yet): ``status`` says why."""
        self._put_away("the model is not there any more")
        self._endpoint = None
        self._state.assistant.set(status)

    def ask(
        self,
        question: str,
        messages: Sequence[ChatMessage],
        *,
        max_tokens: int,
        temperature: float,
        actor: Actor = CONSOLE,
        recorded: Sequence[ChatMessage] | None = None,
        photo: str = "",
        jpeg: bytes | None = None,
    ) -> bool:
        """False when no model is ready. A question under way is cancelled, an answer not used is dismissed. ``jpeg`` is
        a picture that goes with the question, ``photo`` its file name. ``recorded`` is what the record has instead of
        ``messages``, where these tell more than it may hold.
        """
        if self._endpoint is None:
            return False
        self._put_away("cancelled by the next question", actor)
        asked = _Asked(
            f"x-{secrets.token_hex(4)}",
            self._endpoint,
            self._shown_as,
            tuple(messages),
            tuple(messages if recorded is None else recorded),
            max_tokens,
            temperature,
            clock.now_ns(),
            secrets.randbelow(_SEEDS) if takes_seed(self._endpoint) else None,
            actor,
            photo,
            jpeg,
        )
        self._state.assistant.set(
            AssistantStatus(state="answering", model=self._shown_as, exchange_id=asked.exchange_id, question=question)
        )
        heard = _Heard()
        self._running = _Running(asked, heard, self._asyncio.submit(self._exchange(asked, heard)))
        if asked.endpoint not in self._versions and (self._asking_version is None or self._asking_version.done()):
            self._find_version(asked.endpoint)
        return True

    def cancel(self, why: str = "cancelled by the wizard") -> None:
        """End the exchange under way; it is published before this returns."""
        running = self._running
        if running is None:
            return
        running.future.cancel()
        # It may have ended just now, with the news of it still on its way.
        self._conclude(running.heard.exchange or self._ended(running.asked, running.heard, "cancelled", why))

    def forget(self) -> None:
        """Put question and answer away, for the next participant or a pause.

        Everything about them is published before this returns, so that nothing of it reaches a later recording.
        """
        self._put_away("cancelled as the session began, paused or ended")
        status = self._state.assistant.value
        if self._endpoint is not None:
            self._state.assistant.set(AssistantStatus(state="ready", model=self._shown_as))
        else:
            self._state.assistant.set(replace(status, exchange_id="", question="", answer=""))

    def note_use(self, text: str, utterance_id: str, actor: Actor = CONSOLE) -> None:
        """The wizard has the answer said, perhaps edited."""
        if self._last is not None:
            as_it_stood = text.split() == self._last.answer.split()
            self._last_used = True
            use: Literal["said", "edited"] = "said" if as_it_stood else "edited"
            self._publish(AnswerUsed(clock.now_ns(), self._last.exchange_id, use, text, utterance_id, actor))

    def _put_away(self, why: str, actor: Actor = CONSOLE) -> None:
        self.cancel(why)
        last, self._last = self._last, None
        if last is not None and last.outcome == "answered" and not self._last_used:
            self._publish(AnswerUsed(clock.now_ns(), last.exchange_id, "dismissed", last.answer, actor=actor))

    def _find_version(self, endpoint: ModelEndpoint) -> None:
        asking = self._keep_version(endpoint)
        try:
            self._asking_version = self._asyncio.submit(asking)
        except RuntimeError:  # the loop has ended: the console closes
            asking.close()

    async def _keep_version(self, endpoint: ModelEndpoint) -> None:
        version = await self._ask_version(endpoint)
        if version:
            self._versions[endpoint] = version

    async def _exchange(self, asked: _Asked, heard: _Heard) -> None:
        shown_ns = 0
        outcome: LlmOutcome = "answered"
        detail = ""

        def take_version(version: str) -> None:
            heard.version = version

        try:
            async for piece in self._stream_chat(
                asked.endpoint,
                asked.messages,
                max_tokens=asked.max_tokens,
                temperature=asked.temperature,
                seed=asked.seed,
                told_version=take_version,
                **({} if asked.jpeg is None else {"jpeg": asked.jpeg}),
            ):
                now_ns = clock.now_ns()
                heard.first_token_ns = heard.first_token_ns or now_ns
                heard.pieces.append(piece)
                if now_ns - shown_ns >= _SHOW_EVERY_NS:
                    shown_ns = now_ns
                    self._answer_grew.emit(asked.exchange_id, "".join(heard.pieces))
        except asyncio.CancelledError:
            outcome, detail = "cancelled", "cancelled as the program closed"
        except LanguageModelError as error:
            outcome, detail = "failed", f"{error.what} {error.advice}"
        except Exception as error:
            _log.exception("the language model exchange failed")
            outcome, detail = "failed", f"The answer could not be read ({error}). Ask again."
        exchange = self._ended(asked, heard, outcome, detail)
        if outcome != "cancelled":
            heard.exchange = exchange
        self._exchange_ended.emit(exchange)

    def _ended(self, asked: _Asked, heard: _Heard, outcome: LlmOutcome, detail: str) -> LlmExchange:
        return LlmExchange(
            stamp_ns=clock.now_ns(),
            exchange_id=asked.exchange_id,
            provider=asked.endpoint.provider,
            model=asked.model,
            messages=asked.recorded,
            answer="".join(heard.pieces).strip(),
            outcome=outcome,
            asked_ns=asked.asked_ns,
            first_token_ns=heard.first_token_ns,
            parameters={"max_tokens": asked.max_tokens, "temperature": asked.temperature},
            detail=detail,
            model_version=heard.version or self._versions.get(asked.endpoint, ""),
            server=server_of(asked.endpoint),
            seed=asked.seed,
            actor=asked.actor,
            photo=asked.photo,
        )

    def _on_answer_grew(self, exchange_id: str, answer: str) -> None:
        if self._running is not None and self._running.asked.exchange_id == exchange_id:
            self._state.assistant.set(replace(self._state.assistant.value, answer=answer))

    def _on_exchange_ended(self, exchange: LlmExchange) -> None:
        if self._running is not None and self._running.asked.exchange_id == exchange.exchange_id:
            self._conclude(exchange)

    def _conclude(self, exchange: LlmExchange) -> None:
        self._running = None
        self._publish(exchange)
        self._last, self._last_used = exchange, False
        self._state.assistant.set(
            replace(
                self._state.assistant.value,
                state="failed" if exchange.outcome == "failed" else "ready",
                answer=exchange.answer,
                detail=exchange.detail,
            )
        )
