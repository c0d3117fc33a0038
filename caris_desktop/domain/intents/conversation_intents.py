"""Intents that correct utterances."""

from caris_desktop.domain.corrections import WhoSpoke
from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class CorrectUtterance(Intent):
    """Correct an utterance's text or speaker, or set its tags; None leaves a value as it is.

    ``speaker`` and ``person_id`` may be empty for "not sure".
    """

    utterance_id: str
    text: str | None = None
    speaker: WhoSpoke | None = None
    person_id: str | None = None
    tags: tuple[str, ...] | None = None


CONVERSATION: IntentTable = {CorrectUtterance: IntentSpec(QT_TR_NOOP("Correcting the transcript"))}
