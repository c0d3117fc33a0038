"""Current action proposal of the language model, and its outcome. Time is injected."""

from collections.abc import Callable
from dataclasses import fields, replace

from caris_desktop.conversation.suggestions.proposable_actions import Proposed
from caris_desktop.conversation.suggestions.suggestion_cycle import Round
from caris_desktop.domain.actor import CONSOLE, MODEL, Actor
from caris_desktop.domain.events import ProposalChanged, ProposalState
from caris_desktop.domain.value_class import Value

TO_READ_NS = 300_000_000
LAPSES_NS = 15_000_000_000
_MISSED_NS = 1_000_000_000


class Card(Value):
    """Displayed proposal. Keys work from ``from_ns``; it is executed at ``acts_ns`` without a key, or lapses."""

    proposal_id: str
    proposed: Proposed
    begun: Round
    model: str
    from_ns: int
    lapses_ns: int
    acts_ns: int | None = None


def arguments_of(proposed: Proposed) -> dict[str, float | str | bool]:
    """Arguments of the intent without the actor."""
    intent = proposed.intent
    return {each.name: getattr(intent, each.name) for each in fields(intent) if each.name != "actor"}


class Proposals:
    """Holds one proposal at a time. ``report`` receives each event at once."""

    def __init__(self, report: Callable[[ProposalChanged], None], new_id: Callable[[], str]) -> None:
        self._report = report
        self._new_id = new_id
        self.card: Card | None = None

    def offer(self, begun: Round, proposed: Proposed, model: str, now_ns: int, *, acts_after_ns: int | None) -> None:
        """Display a proposal in place of the present one. Robot motion requires a key, whatever the countdown."""
        self.lapse(now_ns, "replaced by another proposal")
        acts_ns = None if acts_after_ns is None or proposed.moves else now_ns + acts_after_ns
        lapses_ns = max(now_ns + LAPSES_NS, (acts_ns or 0) + _MISSED_NS)
        self.card = Card(self._new_id(), proposed, begun, model, now_ns + TO_READ_NS, lapses_ns, acts_ns)
        self._report_state(self.card, "displayed" if acts_ns is None else "counting", now_ns, actor=MODEL)

    def refuse(self, begun: Round, model: str, reason: str, now_ns: int) -> None:
        """Record an invalid proposal without displaying it."""
        self._report(
            ProposalChanged(
                now_ns, self._new_id(), "refused", begun.turn_id, begun.revision, "", {}, model, reason, CONSOLE
            )
        )

    def answered(self, proposal_id: str, now_ns: int, *, readable: bool = True) -> Card | None:
        """Proposal that a key refers to; None if it is not current. ``readable``: only after ``from_ns``."""
        self.pass_time(now_ns)
        card = self.card
        if card is None or card.proposal_id != proposal_id or (readable and now_ns < card.from_ns):
            return None
        return card

    def end(self, state: ProposalState, now_ns: int, actor: Actor, detail: str = "") -> None:
        """End the proposal with this state."""
        if self.card is not None:
            card, self.card = self.card, None
            self._report_state(card, state, now_ns, actor=actor, detail=detail)

    def lapse(self, now_ns: int, reason: str) -> None:
        self.end("lapsed", now_ns, CONSOLE, reason)

    def pass_time(self, now_ns: int) -> None:
        card = self.card
        if card is not None and now_ns >= card.lapses_ns:
            self.lapse(now_ns, "it was not confirmed")
        elif card is not None and card.acts_ns is not None and now_ns - card.acts_ns >= _MISSED_NS:
            self.wait_for_key()

    def wait_for_key(self) -> None:
        """Cancel the countdown."""
        if self.card is not None:
            self.card = replace(self.card, acts_ns=None)

    def due(self, now_ns: int) -> Card | None:
        """Proposal whose countdown ends now; None if the end was missed, as while the program was suspended."""
        card = self.card
        if card is None or card.acts_ns is None:
            return None
        return card if 0 <= now_ns - card.acts_ns < _MISSED_NS else None

    @property
    def next_ns(self) -> int | None:
        """Next time at which ``pass_time`` is needed."""
        if self.card is None:
            return None
        return min(self.card.lapses_ns, self.card.acts_ns or self.card.lapses_ns)

    def _report_state(self, card: Card, state: ProposalState, now_ns: int, *, actor: Actor, detail: str = "") -> None:
        self._report(
            ProposalChanged(
                now_ns, card.proposal_id, state, card.begun.turn_id, card.begun.revision,
                type(card.proposed.intent).__name__, arguments_of(card.proposed), card.model, detail, actor,
            )
        )  # fmt: skip
