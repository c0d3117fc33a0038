"""Proposal service: actions proposed by the language model, run after the wizard's confirmation."""

import secrets
from collections.abc import Callable, Sequence
from dataclasses import replace

from PySide6.QtCore import QObject, Qt, QTimer

from caris_desktop.conversation.suggestions import prompt, proposable_actions
from caris_desktop.conversation.suggestions.proposal_state import Card, Proposals
from caris_desktop.conversation.suggestions.suggestion_cycle import Round
from caris_desktop.domain import clock, intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import ChatMessage, LlmExchange
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.intents import Intent
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.bus import Bus
from caris_desktop.live.model_client import Asking, ModelClient
from caris_desktop.live.service import Handlers, Service
from caris_desktop.live.state import LiveState
from caris_desktop.live.status import LevelsStatus, ProposalStatus
from caris_desktop.scenario.scenario_model import Scenario

# The most likely action is wanted; there is no wording to vary.
_TEMPERATURE = 0.0


class ProposalsService(Service):
    """Maintains ``state.proposal``. ``do`` sends intents to the console, as a key does."""

    def __init__(
        self, state: LiveState, bus: Bus, model: ModelClient, *, do: Callable[[Intent], str], parent: QObject
    ) -> None:
        super().__init__(parent)
        self._state = state
        self._model = model
        self._do = do
        self._scenario: Scenario | None = None
        self._asking: Asking | None = None
        self._proposals = Proposals(bus.publish, lambda: f"a-{secrets.token_hex(4)}")
        self._timer = QTimer(self, singleShot=True, timerType=Qt.TimerType.PreciseTimer)
        self._timer.timeout.connect(self._on_time)
        state.levels.changed.connect(self._on_levels_changed)

    def handlers(self) -> Handlers:
        return {intents.ConfirmProposal: self._confirm, intents.VetoProposal: self._veto}

    def use_scenario(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self.drop(QT_TR_NOOP("another scenario was opened"))

    def _on_levels_changed(self, levels: LevelsStatus) -> None:
        if levels.actions == "off":
            self.drop(QT_TR_NOOP("the wizard turned off proposals"))
        elif levels.actions == "suggest":
            self._proposals.wait_for_key()
            self._show()

    def stop(self) -> None:
        self.drop(QT_TR_NOOP("the program is closing"))

    def ask_about(
        self, begun: Round, messages: Sequence[ChatMessage], recorded: Sequence[ChatMessage], replies: str
    ) -> None:
        """Ask which actions fit, after the model was asked for ``replies``."""
        offer = self._offer()
        if self._state.levels.value.actions == "off" or not offer.actions:
            return
        self._cancel(QT_TR_NOOP("a newer question was asked"))
        try:
            self._asking = self._model.ask(
                prompt.action_messages(messages, replies, offer),
                recorded=prompt.action_messages(recorded, replies, offer),
                purpose="actions",
                max_tokens=prompt.ACTION_TOKENS,
                temperature=_TEMPERATURE,
                schema=proposable_actions.schema_of(offer),
                turn_id=begun.turn_id,
                revision=begun.revision,
                on_text=lambda _text: None,
                on_end=lambda exchange: self._on_answer(begun, offer, exchange),
            )
        except UserFacingError:
            self._asking = None  # a missing model is reported with the replies

    def drop(self, reason: str) -> None:
        """Drop proposals whose subject is over."""
        self._cancel(reason)
        self._proposals.lapse(clock.now_ns(), reason)
        self._show()

    def _offer(self) -> proposable_actions.Offer:
        state, robot = self._state, self._state.robot.value
        head = robot.head if robot is not None else None
        return proposable_actions.proposable_here(
            self._scenario.permissions if self._scenario is not None else None,
            places=[place.name for place in state.places.value],
            controls=state.controls.value,
            pan_range_rad=head.pan_range_rad if head is not None else None,
            tilt_range_rad=head.tilt_range_rad if head is not None else None,
        )

    def _cancel(self, reason: str) -> None:
        asking, self._asking = self._asking, None
        if asking is not None:
            asking.cancel(reason)

    def _on_answer(self, begun: Round, offer: proposable_actions.Offer, exchange: LlmExchange) -> None:
        if self._asking is None or self._asking.exchange_id != exchange.exchange_id:
            return  # no longer needed
        self._asking = None
        if exchange.outcome != "answered":
            return
        now_ns = clock.now_ns()
        try:
            proposed = proposable_actions.proposed_in(exchange.answer, offer)
        except proposable_actions.NotOfferedError as refused:
            self._proposals.refuse(begun, exchange.model, str(refused), now_ns)
            return
        if proposed is not None and self._scenario is not None:
            acts = self._state.levels.value.actions == "act"
            countdown_ns = int(self._scenario.assistance.countdown_s * 1e9)
            self._proposals.offer(begun, proposed, exchange.model, now_ns, acts_after_ns=countdown_ns if acts else None)
            self._show()

    def _confirm(self, intent: intents.ConfirmProposal) -> None:
        card = self._proposals.answered(intent.proposal_id, clock.now_ns())
        if card is None:
            self._show()
            raise UserFacingError(
                tr("That proposal is no longer available."), tr("Nothing was done."),
                tr("Do it yourself if it is still needed."),
                severity="info",
            )  # fmt: skip
        self._carry_out(card, intent.actor)

    def _veto(self, intent: intents.VetoProposal) -> None:
        if self._proposals.answered(intent.proposal_id, clock.now_ns(), readable=False) is not None:
            self._proposals.end("vetoed", clock.now_ns(), intent.actor)
        self._show()

    def _carry_out(self, card: Card, actor: Actor) -> None:
        refused = self._do(replace(card.proposed.intent, actor=actor))
        self._proposals.end("refused" if refused else "confirmed", clock.now_ns(), actor, refused)
        self._show()

    def _on_time(self) -> None:
        now_ns = clock.now_ns()
        card = self._proposals.due(now_ns)
        if card is not None:
            self._carry_out(card, CONSOLE)
        self._proposals.pass_time(now_ns)
        self._show()

    def _show(self) -> None:
        card = self._proposals.card
        self._state.proposal.set(
            ProposalStatus()
            if card is None
            else ProposalStatus(
                card.proposal_id, card.proposed.words, card.proposed.moves, card.model,
                card.from_ns, card.lapses_ns, card.acts_ns,
            )
        )  # fmt: skip
        next_ns = self._proposals.next_ns
        if next_ns is None:
            self._timer.stop()
        else:
            self._timer.start(max(0, -(-(next_ns - clock.now_ns()) // 1_000_000)))
