"""Asking the language model: one question at a time, streamed into ``state.assistant``. GUI thread.

The stream itself runs on the asyncio thread and reports through signals, at most every 30 ms.
"""

import asyncio
import logging
import secrets
from collections.abc import AsyncIterator, Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace

from PySide6.QtCore import QObject, Signal

from caris_desktop.conversation.language_models import LanguageModelError, ModelEndpoint
from caris_desktop.domain import clock
from caris_desktop.domain.events import AnswerUsed, ChatMessage, LlmExchange, LlmOutcome
from caris_desktop.domain.ports import ValueSink
from caris_desktop.live.asyncio_thread import AsyncioThread
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import AssistantStatus

_log = logging.getLogger(__name__)
_SHOW_EVERY_NS = 30_000_000
StreamChat = Callable[..., AsyncIterator[str]]


@dataclass(frozen=True, slots=True)
class _Asked:
    exchange_id: str
    endpoint: ModelEndpoint
    model: str
    messages: tuple[ChatMessage, ...]
    max_tokens: int
    temperature: float
    asked_ns: int


class AssistantDirector(QObject):
    """Owns the exchange under way. ``publish`` receives the recorded events."""

    _answer_grew = Signal(str, str)
    _exchange_ended = Signal(object)

    def __init__(
        self,
        state: LiveState,
        asyncio_thread: AsyncioThread,
        stream_chat: StreamChat,
        publish: ValueSink,
        parent: QObject | None = None,
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._asyncio = asyncio_thread
        self._stream_chat = stream_chat
        self._publish = publish
        self._endpoint: ModelEndpoint | None = None
        self._shown_as = ""
        self._running: Future[None] | None = None
        self._last_answer: tuple[str, str] | None = None
        self._answer_grew.connect(self._on_answer_grew)
        self._exchange_ended.connect(self._on_exchange_ended)

    def use_endpoint(self, endpoint: ModelEndpoint, *, shown_as: str) -> None:
        """From now on ask this model; ``shown_as`` is its name for the wizard."""
        self._endpoint = endpoint
        self._shown_as = shown_as
        self._state.assistant.set(AssistantStatus(state="ready", model=shown_as))

    def show_status(self, status: AssistantStatus) -> None:
        """No model (yet): ``status`` says why."""
        self._endpoint = None
        self._state.assistant.set(status)

    def ask(self, question: str, messages: Sequence[ChatMessage], *, max_tokens: int, temperature: float) -> bool:
        """False when no model is ready. A question under way is cancelled."""
        if self._endpoint is None:
            return False
        self.cancel()
        asked = _Asked(
            f"x-{secrets.token_hex(4)}",
            self._endpoint,
            self._shown_as,
            tuple(messages),
            max_tokens,
            temperature,
            clock.now_ns(),
        )
        self._state.assistant.set(
            AssistantStatus(state="answering", model=self._shown_as, exchange_id=asked.exchange_id, question=question)
        )
        self._running = self._asyncio.submit(self._exchange(asked))
        return True

    def cancel(self) -> None:
        if self._running is not None:
            self._running.cancel()
            self._running = None

    def note_use(self, text: str) -> None:
        """The wizard said the answer, perhaps edited."""
        if self._last_answer is not None:
            exchange_id, answer = self._last_answer
            use = "said" if text.strip() == answer.strip() else "edited"
            self._publish(AnswerUsed(clock.now_ns(), exchange_id, "said" if use == "said" else "edited", text))

    async def _exchange(self, asked: _Asked) -> None:
        pieces: list[str] = []
        first_token_ns: int | None = None
        shown_ns = 0
        outcome: LlmOutcome = "answered"
        detail = ""
        try:
            async for piece in self._stream_chat(
                asked.endpoint, asked.messages, max_tokens=asked.max_tokens, temperature=asked.temperature
            ):
                now_ns = clock.now_ns()
                first_token_ns = first_token_ns or now_ns
                pieces.append(piece)
                if now_ns - shown_ns >= _SHOW_EVERY_NS:
                    shown_ns = now_ns
                    self._answer_grew.emit(asked.exchange_id, "".join(pieces))
        except asyncio.CancelledError:
            outcome, detail = "cancelled", "cancelled by the wizard"
        except LanguageModelError as error:
            outcome, detail = "failed", f"{error.what} {error.advice}"
        except Exception as error:
            _log.exception("the language model exchange failed")
            outcome, detail = "failed", f"The answer could not be read ({error}). Ask again."
        self._exchange_ended.emit(
            LlmExchange(
                stamp_ns=clock.now_ns(),
                exchange_id=asked.exchange_id,
                provider=asked.endpoint.provider,
                model=asked.model,
                messages=asked.messages,
                answer="".join(pieces).strip(),
                outcome=outcome,
                asked_ns=asked.asked_ns,
                first_token_ns=first_token_ns,
                parameters={"max_tokens": asked.max_tokens, "temperature": asked.temperature},
                detail=detail,
            )
        )

    def _on_answer_grew(self, exchange_id: str, answer: str) -> None:
        status = self._state.assistant.value
        if status.exchange_id == exchange_id:
            self._state.assistant.set(replace(status, answer=answer))

    def _on_exchange_ended(self, exchange: LlmExchange) -> None:
        self._publish(exchange)
        status = self._state.assistant.value
        if status.exchange_id != exchange.exchange_id:
            return
        self._running = None
        self._last_answer = (exchange.exchange_id, exchange.answer)
        state = "failed" if exchange.outcome == "failed" else "ready"
        self._state.assistant.set(
            replace(
                status, state="failed" if state == "failed" else "ready", answer=exchange.answer, detail=exchange.detail
            )
        )
