"""Intents of suggested replies and proposals of the language model: the wizard decides on them."""

from caris_desktop.domain.events import AssistanceLevel, AssistedFunction
from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class SaySuggestion(Intent):
    """Say this suggested reply, which was read at that rank."""

    rank: int
    suggestion_id: str


@dataclass(frozen=True, slots=True)
class SayEditedSuggestion(Intent):
    """Say an edited suggested reply."""

    suggestion_id: str
    text: str


@dataclass(frozen=True, slots=True)
class DismissSuggestions(Intent):
    """Dismiss all suggested replies, and the filler to be said automatically."""

    @property
    def reduces_motion(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class ConfirmProposal(Intent):
    """Carry out a proposal of the model."""

    proposal_id: str


@dataclass(frozen=True, slots=True)
class VetoProposal(Intent):
    """Reject a proposal of the language model."""

    proposal_id: str

    @property
    def reduces_motion(self) -> bool:
        return True


@dataclass(frozen=True, slots=True)
class SetLevel(Intent):
    """Set the automation of the language model, up to what the scenario allows."""

    function: AssistedFunction
    level: AssistanceLevel

    @property
    def reduces_motion(self) -> bool:
        return self.level == "off"


SUGGESTIONS: IntentTable = {
    SaySuggestion: IntentSpec(QT_TR_NOOP("Saying the suggestion"), "assistant", also="speech"),
    SayEditedSuggestion: IntentSpec(QT_TR_NOOP("Saying the edited suggestion"), "assistant", also="speech"),
    DismissSuggestions: IntentSpec(QT_TR_NOOP("Dismissing the suggestions")),
    ConfirmProposal: IntentSpec(QT_TR_NOOP("Confirming the proposal"), "assistant"),
    VetoProposal: IntentSpec(QT_TR_NOOP("Rejecting the proposal")),
    SetLevel: IntentSpec(QT_TR_NOOP("Setting the assistance level"), "assistant"),
}
