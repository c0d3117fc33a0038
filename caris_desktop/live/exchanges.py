"""Questions of the wizard to the language model, several at a time. GUI thread."""

import secrets
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

from PySide6.QtCore import QObject

from caris_desktop.conversation.models.endpoint import ModelEndpoint
from caris_desktop.domain import clock
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import AnswerUsed, ChatMessage, LlmExchange
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.ports import ValueSink
from caris_desktop.domain.translation import QT_TR_NOOP, joined, tr
from caris_desktop.live.model_client import ModelClient
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import AssistantStatus, ExchangeStatus

MOST_SHOWN = 6
MOST_UNDER_WAY = 4


class Exchanges(QObject):
    """Maintains ``state.assistant``. ``publish`` receives the use of each answer, once.

    An unused answer counts as dismissed when it is removed: by the wizard, by newer ones, or with a change of model or
    participant.
    """

    def __init__(
        self, state: LiveState, client: ModelClient, publish: ValueSink, parent: QObject | None = None
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._client = client
        self._publish = publish
        self._rows: dict[str, ExchangeStatus] = {}  # in the order of asking
        self._none = AssistantStatus()

    # Model

    def use_endpoint(self, endpoint: ModelEndpoint, *, shown_as: str, local_only: bool) -> None:
        """Switch the model; ``shown_as``: its display name. Pending questions end; existing answers remain usable."""
        self._client.use(endpoint, shown_as=shown_as, local_only=local_only)
        self._show()

    def show_status(self, status: AssistantStatus) -> None:
        """Run without a model; ``status`` has the reason."""
        self._cancel_all(QT_TR_NOOP("the model is no longer available"))
        self._client.use_none(status.detail or QT_TR_NOOP("The model is still starting: ask again in a moment."))
        self._none = status
        self._show()

    # Questions

    def check_room(self) -> None:
        """Raise UserFacingError if no question can be asked now."""
        if not self._client.ready:
            raise UserFacingError(
                tr("The assistant cannot answer now."),
                tr("Your question is still in the field."),
                tr("The model is still starting: ask again in a moment.")
                if self._none.state == "starting"
                else (tr(self._none.detail) or tr("Check the scenario's model.")),
                severity="warning",
            )
        if sum(row.is_pending for row in self._rows.values()) >= MOST_UNDER_WAY:
            raise UserFacingError(
                tr("%n questions are already in progress.", "", MOST_UNDER_WAY),
                tr("Your question is still in the field."),
                tr("Wait for an answer, or cancel one of them."),
                severity="warning",
            )

    def prepare(self, question: str) -> str:
        """Add a question whose pictures are being read; returns its id. Raises UserFacingError."""
        self.check_room()
        exchange_id = f"x-{secrets.token_hex(4)}"
        self._rows[exchange_id] = ExchangeStatus(exchange_id, question, "preparing", self._client.model)
        for row in tuple(self._rows.values())[:-MOST_SHOWN]:
            if not row.is_pending:
                self._put_away(row.exchange_id)
        self._show()
        return exchange_id

    def ask(self, exchange_id: str, messages: Sequence[ChatMessage], *, actor: Actor = CONSOLE, **how: Any) -> None:
        """Ask a prepared question unless cancelled; ``how`` as in `ModelClient.ask`."""
        row = self._rows.get(exchange_id)
        if row is None or row.state != "preparing":
            return
        self._change(exchange_id, state="answering")
        try:
            self._client.ask(
                messages,
                purpose="question",
                exchange_id=exchange_id,
                on_text=lambda answer: self._change(exchange_id, answer=answer, detail=""),
                on_wait=lambda why: self._change(exchange_id, detail=why),
                on_end=self._on_end,
                actor=actor,
                **how,
            )
        except UserFacingError as failure:
            self.fail(exchange_id, joined((failure.what, failure.advice)))

    def fail(self, exchange_id: str, detail: str) -> None:
        """Mark a question as failed; the reason is shown with it."""
        self._change(exchange_id, state="failed", detail=detail)

    def cancel(self, why: str, exchange_id: str = "") -> None:
        """End one question or all pending ones; each is published before this returns."""
        if not exchange_id:
            self._cancel_all(why)
        elif exchange_id in self._rows:
            self._end(exchange_id, why)

    def dismiss(self, exchange_id: str, why: str, actor: Actor = CONSOLE) -> None:
        """Remove a question with its answer."""
        if exchange_id in self._rows:
            self._end(exchange_id, why)
            self._put_away(exchange_id, actor)
            self._show()

    def forget(self) -> None:
        """Remove all questions and answers for the next participant or a pause.

        Everything about them is published before this returns, so that it does not enter a later recording.
        """
        self._cancel_all(QT_TR_NOOP("cancelled because the session started, paused or ended"))
        for exchange_id in tuple(self._rows):
            self._put_away(exchange_id)
        self._show()

    def note_use(self, text: str, utterance_id: str, exchange_id: str = "", actor: Actor = CONSOLE) -> None:
        """Record that the wizard used an answer, perhaps edited; the newest if none is named."""
        row = self._rows.get(exchange_id or next(reversed(self._rows), ""))
        if row is None or row.use or not row.answer:
            return
        as_it_stood = text.split() == row.answer.split()
        use: Literal["said", "edited"] = "said" if as_it_stood else "edited"
        self._publish(AnswerUsed(clock.now_ns(), row.exchange_id, use, text, utterance_id, actor))
        self._change(row.exchange_id, use=use)

    def _cancel_all(self, why: str) -> None:
        for exchange_id in tuple(self._rows):
            self._end(exchange_id, why)

    def _end(self, exchange_id: str, why: str) -> None:
        if self._rows[exchange_id].state == "preparing":
            self._change(exchange_id, state="cancelled", detail=why)  # the model was not asked yet
        else:
            self._client.cancel(exchange_id, why)

    def _put_away(self, exchange_id: str, actor: Actor = CONSOLE) -> None:
        row = self._rows.pop(exchange_id)
        if row.state == "answered" and not row.use:
            self._publish(AnswerUsed(clock.now_ns(), exchange_id, "dismissed", row.answer, actor=actor))

    def _on_end(self, exchange: LlmExchange) -> None:
        self._change(exchange.exchange_id, state=exchange.outcome, answer=exchange.answer, detail=exchange.detail)

    def _change(self, exchange_id: str, **changes: Any) -> None:
        row = self._rows.get(exchange_id)
        if row is not None:
            self._rows[exchange_id] = replace(row, **changes)
            self._show()

    def _show(self) -> None:
        rows = tuple(reversed(self._rows.values()))
        newest = rows[0] if rows else ExchangeStatus("", "", "cancelled")
        state, detail = self._none.state, self._none.detail
        if self._client.ready:
            answering, failed = any(row.is_pending for row in rows), newest.state == "failed"
            state = "answering" if answering else "failed" if failed else "ready"
            detail = newest.detail
        self._state.assistant.set(
            AssistantStatus(
                state,
                self._client.model or self._none.model,
                newest.exchange_id,
                newest.question,
                newest.answer,
                detail,
                rows,
            )
        )
