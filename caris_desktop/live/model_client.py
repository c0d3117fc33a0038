"""Client of language models: streams each exchange, reports progress, and publishes it once. GUI thread.

Streams run on the asyncio thread and report through signals.
"""

import asyncio
import logging
import os
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable, Coroutine, Sequence
from concurrent.futures import Future
from dataclasses import field, replace
from typing import Any, Literal

from PySide6.QtCore import QObject, Signal

from caris_desktop.conversation.embedded_server import REPLIES_SLOT, SLOTS
from caris_desktop.conversation.models.chat import AnswerNotes, ChatTimeouts
from caris_desktop.conversation.models.connection import model_version, models_here
from caris_desktop.conversation.models.embedded_models import added_models
from caris_desktop.conversation.models.endpoint import LanguageModelError, ModelEndpoint, ollama_url, openai_url
from caris_desktop.conversation.models.question import Cut
from caris_desktop.conversation.models.reasoning import Withdrawn
from caris_desktop.domain import clock
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import ChatMessage, LlmExchange, LlmOutcome
from caris_desktop.domain.failure import RefusedError
from caris_desktop.domain.ports import ValueSink
from caris_desktop.domain.translation import QT_TR_NOOP, joined, localized
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.live.background_worker import AsyncioThread, new_timer
from caris_desktop.live.service import PANELS_FIRST_MS

_log = logging.getLogger(__name__)
_SEEDS = 2**31  # accepted by all servers
Purpose = Literal["question", "replies", "actions"]
# A suggestion after half a minute would be useless: the conversation has moved on.
_TIMEOUTS: dict[Purpose, ChatTimeouts] = {
    "question": ChatTimeouts(),
    "replies": ChatTimeouts(first_token_s=15.0, between_tokens_s=10.0),
    "actions": ChatTimeouts(first_token_s=15.0, between_tokens_s=10.0),
}
# Intervals of partial text: reading speed for answers, first words for suggestions.
_REPORT_EVERY_NS: dict[Purpose, int] = {"question": 30_000_000, "replies": 10_000_000, "actions": 30_000_000}
_CUT_WORDS: dict[Cut, str] = {
    "": "",
    "length": QT_TR_NOOP("The answer is cut off: it reached the length limit (assistant.max_tokens)."),
    "filter": QT_TR_NOOP("The answer is cut off: the server's filter stopped it."),
}
StreamChat = Callable[..., AsyncIterator[str]]


@dataclass(slots=True)
class _Response:
    """Response so far. Written on the asyncio thread, read from both."""

    pieces: list[str] = field(default_factory=list)
    first_token_ns: int | None = None
    version: str = ""
    notes: AnswerNotes = field(default_factory=AnswerNotes)
    exchange: LlmExchange | None = None


class _Running(Value):
    """``asked`` is the exchange without its answer; ``slot`` that of the embedded server."""

    asked: LlmExchange
    endpoint: ModelEndpoint
    slot: int | None
    response: _Response
    future: Future[None]
    on_text: Callable[[str], None]
    on_wait: Callable[[str], None]
    on_end: Callable[[LlmExchange], None]


class ModelClient(QObject):
    """Asks the current model, several questions at a time. ``publish`` receives each exchange once.

    ``ask_version`` determines the model's version, possibly while its first question is running.
    """

    answering_changed = Signal()
    """``answering`` changed."""
    model_changed = Signal()
    """The model changed."""
    _grew = Signal(str, str)
    _waits = Signal(str, object)
    _ended = Signal(object)

    def __init__(
        self,
        asyncio_thread: AsyncioThread,
        stream_chat: StreamChat,
        publish: ValueSink,
        parent: QObject | None = None,
        *,
        ask_version: Callable[..., Awaitable[str]] = model_version,
    ) -> None:
        super().__init__(parent)
        self._asyncio = asyncio_thread
        self._stream_chat = stream_chat
        self._ask_version = ask_version
        self._publish = publish
        self._endpoint: ModelEndpoint | None = None
        self._local_only = True
        self._shown_as = ""
        self._no_model_reason: str = QT_TR_NOOP("No language model is set up.")
        self._versions: dict[ModelEndpoint, str] = {}
        self._asking_version: Future[None] | None = None
        self._running: dict[str, _Running] = {}
        self._to_read: dict[Purpose, Callable[[], Sequence[ChatMessage]]] = {}
        self._soon = new_timer(self, self._read_pending, PANELS_FIRST_MS, single_shot=True)
        self._grew.connect(self._on_grew)
        self._waits.connect(self._on_waits)
        self._ended.connect(self._on_ended)

    @property
    def ready(self) -> bool:
        """Whether there is a model."""
        return self._endpoint is not None

    @property
    def model(self) -> str:
        """Name of the current model, for wizard and record; empty if none."""
        return self._shown_as if self._endpoint is not None else ""

    @property
    def answering(self) -> bool:
        """Whether an exchange is in progress."""
        return bool(self._running)

    @property
    def embedded(self) -> bool:
        """Whether the model is the embedded one, or one that the user added."""
        endpoint = self._endpoint
        return endpoint is not None and endpoint.provider == "embedded" and not endpoint.is_plugin

    @property
    def answers_here(self) -> bool:
        """Whether this computer runs the model."""
        return self._endpoint is not None and not self._endpoint.leaves_computer

    def use(self, endpoint: ModelEndpoint, *, display_name: str, local_only: bool) -> None:
        """Switch the model; with ``local_only`` only if it runs on this computer. Exchanges with the former model are
        cancelled; with the same model they continue.
        """
        if (endpoint, display_name, local_only) == (self._endpoint, self._shown_as, self._local_only):
            return
        self.cancel_all(QT_TR_NOOP("another model was chosen"))
        self._endpoint, self._shown_as, self._local_only = endpoint, display_name, local_only
        self._find_version(endpoint, local_only=local_only)
        self.model_changed.emit()

    def warm_up(self, messages: Sequence[ChatMessage], purpose: Purpose) -> None:
        """Have the embedded model preload the prompt of the next question of that ``purpose``, to answer it faster. Not
        reported or recorded; other models are unaffected.
        """
        if self._endpoint is not None and self.embedded and messages:
            self._submit(self._read(self._endpoint, tuple(messages), self._slot(purpose)))

    def warm_up_soon(self, messages: Callable[[], Sequence[ChatMessage]], purpose: Purpose) -> None:
        """Preload after a short delay, with the ``messages`` of that time, so that a change of scenario or model is not
        slowed. A question before that reads its own prompt.
        """
        self._to_read[purpose] = messages
        self._soon.start()

    def _read_pending(self) -> None:
        waiting, self._to_read = self._to_read, {}
        if self.embedded:
            for purpose, messages in waiting.items():
                self.warm_up(messages(), purpose)

    async def _read(self, endpoint: ModelEndpoint, messages: tuple[ChatMessage, ...], slot: int | None) -> None:
        try:
            async for _ in self._stream_chat(
                endpoint, messages, local_only=True, max_tokens=1, temperature=0.0, slot=slot
            ):
                pass
        except LanguageModelError as error:
            _log.info("the language model was not warmed up: %s", error.what)

    def _slot(self, purpose: Purpose) -> int | None:
        """Slot of the embedded server: a fixed one for replies, whose prompt it has read; for questions the least busy
        other one.
        """
        if not self.embedded:
            return None
        if purpose != "question":
            return REPLIES_SLOT
        taken = [running.slot for running in self._running.values()]
        return min((slot for slot in range(SLOTS) if slot != REPLIES_SLOT), key=taken.count)

    def use_none(self, reason: str) -> None:
        """Run without a model; ``reason`` is part of the refusals."""
        self.cancel_all(QT_TR_NOOP("the model is no longer available"))
        self._endpoint, self._no_model_reason = None, reason

    def ask(
        self,
        messages: Sequence[ChatMessage],
        *,
        purpose: Purpose,
        max_tokens: int,
        temperature: float,
        on_text: Callable[[str], None],
        on_end: Callable[[LlmExchange], None],
        on_wait: Callable[[str], None] = lambda _reason: None,
        schema: dict[str, Any] | None = None,
        jpegs: Sequence[bytes] = (),
        photo: str = "",
        turn_id: str = "",
        revision: int = 0,
        recorded: Sequence[ChatMessage] | None = None,
        actor: Actor = CONSOLE,
        exchange_id: str = "",
    ) -> str:
        """Start an exchange; returns its id. Raises UserFacingError without a model.

        ``on_text`` receives the answer so far, repeatedly; ``on_wait`` the reason of a retry with a busy server;
        ``on_end`` the published exchange, once, whether answered, cancelled or failed. All are called in the GUI
        thread. ``schema``: JSON schema of the answer. ``jpegs`` are attached to the last message, ``photo`` names them
        in the record. ``recorded`` replaces ``messages`` in the record if these hold more than permitted.
        ``exchange_id`` is generated unless given.
        """
        if self._endpoint is None:
            raise RefusedError(
                QT_TR_NOOP("The assistant cannot answer now."),
                QT_TR_NOOP("No question was sent."),
                self._no_model_reason,
            )
        endpoint, slot = self._endpoint, self._slot(purpose)
        asked = LlmExchange(
            stamp_ns=0,
            exchange_id=exchange_id or f"x-{secrets.token_hex(4)}",
            provider=endpoint.provider,
            model=self._shown_as,
            messages=tuple(messages if recorded is None else recorded),
            answer="",
            outcome="answered",
            asked_ns=clock.now_ns(),
            first_token_ns=None,
            parameters={"max_tokens": max_tokens, "temperature": temperature},
            server=endpoint.server,
            seed=secrets.randbelow(_SEEDS) if endpoint.takes_seed else None,
            actor=actor,
            photo=photo,
            purpose=purpose,
            turn_id=turn_id,
            revision=revision,
        )
        response = _Response()
        options = {
            "local_only": self._local_only, "max_tokens": max_tokens, "temperature": temperature, "seed": asked.seed,
            "jpegs": tuple(jpegs), "schema": schema, "slot": slot, "timeouts": _TIMEOUTS[purpose],
        }  # fmt: skip
        future = self._asyncio.submit(self._exchange(asked, endpoint, response, tuple(messages), options))
        self._running[asked.exchange_id] = _Running(asked, endpoint, slot, response, future, on_text, on_wait, on_end)
        if endpoint not in self._versions and (self._asking_version is None or self._asking_version.done()):
            self._find_version(endpoint, local_only=self._local_only)
        if len(self._running) == 1:
            self.answering_changed.emit()
        return asked.exchange_id

    def cancel(self, exchange_id: str, reason: str) -> None:
        """Cancel an exchange: ``on_end`` is called and it is published before this returns. No effect after the end."""
        running = self._running.get(exchange_id)
        if running is not None:
            running.future.cancel()
            # It may just have ended, with the signal still pending.
            self._conclude(
                running.response.exchange
                or self._ended_exchange(running.asked, running.endpoint, running.response, "cancelled", reason)
            )

    def cancel_all(self, reason: str) -> None:
        """Cancel all exchanges."""
        for exchange_id in tuple(self._running):
            self.cancel(exchange_id, reason)

    # Version

    def _find_version(self, endpoint: ModelEndpoint, *, local_only: bool) -> None:
        self._asking_version = self._submit(self._store_version(endpoint, local_only=local_only))

    def _submit(self, work: Coroutine[Any, Any, None]) -> "Future[None] | None":
        try:
            return self._asyncio.submit(work)
        except RuntimeError:  # the loop has ended: the console is closing
            work.close()
            return None

    async def _store_version(self, endpoint: ModelEndpoint, *, local_only: bool) -> None:
        version = await self._ask_version(endpoint, local_only=local_only)
        if version:
            self._versions[endpoint] = version

    # Stream

    async def _exchange(
        self,
        asked: LlmExchange,
        endpoint: ModelEndpoint,
        response: _Response,
        messages: tuple[ChatMessage, ...],
        options: dict[str, Any],
    ) -> None:
        reported_ns = 0
        outcome: LlmOutcome = "answered"
        detail = ""

        def take_version(version: str) -> None:
            response.version = version

        try:
            async for piece in self._stream_chat(
                endpoint,
                messages,
                on_version=take_version,
                on_wait=lambda reason: self._waits.emit(asked.exchange_id, reason),
                notes=response.notes,
                **options,
            ):
                now_ns = clock.now_ns()
                if isinstance(piece, Withdrawn):
                    response.pieces.clear()
                response.first_token_ns = response.first_token_ns or now_ns
                response.pieces.append(piece)
                if now_ns - reported_ns >= _REPORT_EVERY_NS[asked.purpose]:
                    reported_ns = now_ns
                    self._grew.emit(asked.exchange_id, "".join(response.pieces))
        except asyncio.CancelledError:
            outcome, detail = "cancelled", QT_TR_NOOP("cancelled because the program closed")
        except LanguageModelError as error:
            outcome, detail = "failed", joined((error.what, error.advice))
        except Exception as error:
            _log.exception("the language model exchange failed")
            outcome, detail = (
                "failed",
                localized(QT_TR_NOOP("The answer could not be read ({error}). Ask again."), error=type(error).__name__),
            )
        if outcome == "answered":
            detail = _CUT_WORDS[response.notes.cut]
        exchange = self._ended_exchange(asked, endpoint, response, outcome, detail)
        if outcome != "cancelled":
            response.exchange = exchange
        self._ended.emit(exchange)

    def _on_grew(self, exchange_id: str, answer: str) -> None:
        running = self._running.get(exchange_id)
        if running is not None:
            running.on_text(answer)

    def _on_waits(self, exchange_id: str, reason: str) -> None:
        running = self._running.get(exchange_id)
        if running is not None:
            running.on_wait(reason)

    def _on_ended(self, exchange: LlmExchange) -> None:
        if exchange.exchange_id in self._running:
            self._conclude(exchange)

    def _conclude(self, exchange: LlmExchange) -> None:
        running = self._running.pop(exchange.exchange_id)
        self._publish(exchange)
        running.on_end(exchange)
        if not self._running:
            self.answering_changed.emit()

    def _ended_exchange(
        self, asked: LlmExchange, endpoint: ModelEndpoint, response: _Response, outcome: LlmOutcome, detail: str
    ) -> LlmExchange:
        left_out = response.notes.left_out
        return replace(
            asked,
            stamp_ns=clock.now_ns(),
            answer="".join(response.pieces).strip(),
            outcome=outcome,
            first_token_ns=response.first_token_ns,
            parameters={
                name: value for name, value in asked.parameters.items() if name != "temperature" or name not in left_out
            },
            detail=detail,
            model_version=response.version or self._versions.get(endpoint, ""),
            seed=None if "seed" in left_out else asked.seed,
            cut=response.notes.cut if outcome == "answered" else "",
        )


# Language models offered by servers on this computer, listed in the background.


_FIRST_AFTER_MS = 3000
_EVERY_MS = 60_000
ListModels = Callable[[], Coroutine[Any, Any, tuple[str, ...]]]


async def local_models() -> tuple[str, ...]:
    """Models that the user added, and those of local Ollama and OpenAI-compatible servers, named as in a scenario.

    No other server is queried. Each has five seconds.
    """
    found = [f"embedded:{model.name}" for model in added_models()]
    for provider, url in (("ollama", ollama_url), ("openai", openai_url)):
        try:
            endpoint = ModelEndpoint("ollama" if provider == "ollama" else "openai", url(os.environ), "")
        except LanguageModelError:
            continue  # reported when such a model is chosen
        found += [f"{provider}:{name}" for name in await models_here(endpoint)]
    return tuple(found)


class ModelLists(QObject):
    """Refreshes the list every minute; ``found`` reports changes."""

    found = Signal()
    _listed = Signal(object)

    def __init__(self, asyncio_thread: AsyncioThread, list_models: ListModels, parent: QObject) -> None:
        super().__init__(parent)
        self._asyncio = asyncio_thread
        self._list_models = list_models
        self.models: tuple[str, ...] = ()
        self._timer = new_timer(self, self._query, single_shot=True)
        self._listed.connect(self._on_listed)

    def start(self) -> None:
        if not self._timer.isActive():
            self._timer.start(_FIRST_AFTER_MS)

    def refresh(self) -> None:
        self._timer.start(0)

    def stop(self) -> None:
        self._timer.stop()

    def _query(self) -> None:
        self._timer.start(_EVERY_MS)
        self._asyncio.submit(self._list())

    async def _list(self) -> None:
        self._listed.emit(await self._list_models())

    def _on_listed(self, models: tuple[str, ...]) -> None:
        if models != self.models:
            self.models = models
            self.found.emit()
