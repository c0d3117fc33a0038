"""Intents of the language model: questions, answers and prompts."""

from typing import Literal

from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass

PromptPart = Literal["conversation", "step", "people", "history", "things", "notes"]
"""What goes along with a question unless it is left out: what was said, the present step of the protocol, who is here,
what is known of them, what else is in view, and the notes."""
CAMERA_PICTURE = "camera "
"""Before the name of a camera among the pictures of a question: what it shows now."""


@dataclass(frozen=True, slots=True)
class Ask(Intent):
    """Ask the language model, beside what else it is asked; the answer streams into ``state.assistant``.

    ``pictures`` are file names of photos, or CAMERA_PICTURE and the name of a camera.
    """

    question: str
    leave_out: tuple[PromptPart, ...] = ()
    pictures: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class CancelAnswer(Intent):
    """Let the language model end its answer; all that are under way where none is named."""

    exchange_id: str = ""


@dataclass(frozen=True, slots=True)
class SayAnswer(Intent):
    """Say an answer of the language model, possibly edited by the wizard; the newest where none is named."""

    text: str
    exchange_id: str = ""


@dataclass(frozen=True, slots=True)
class DismissAnswer(Intent):
    """Put a question and its answer away, unsaid; one under way is cancelled."""

    exchange_id: str


@dataclass(frozen=True, slots=True)
class AskAboutPhoto(Intent):
    """Ask the language model about a photo, which it gets with the question."""

    file_name: str
    question: str


@dataclass(frozen=True, slots=True)
class ChooseModel(Intent):
    """Ask this model from now on: ``embedded``, ``ollama:NAME``, ``openai:NAME`` or ``gemini:NAME``."""

    model: str


@dataclass(frozen=True, slots=True)
class ChoosePrompt(Intent):
    """Use this role or style of the scenario from now on; none where the name is empty."""

    kind: Literal["role", "style"]
    name: str


@dataclass(frozen=True, slots=True)
class EditPrompt(Intent):
    """Other words for this session: of the system prompt, the notes, or the role or style of that name."""

    kind: Literal["system_prompt", "notes", "role", "style"]
    text: str
    name: str = ""


@dataclass(frozen=True, slots=True)
class ResetPrompts(Intent):
    """All texts, and model, role and style, as the scenario has them."""


ASSISTANT: IntentTable = {
    Ask: IntentSpec(QT_TR_NOOP("Asking the assistant"), "assistant"),
    CancelAnswer: IntentSpec(QT_TR_NOOP("Cancelling the answer")),
    SayAnswer: IntentSpec(QT_TR_NOOP("Speaking the answer"), "assistant", also="speech"),
    DismissAnswer: IntentSpec(QT_TR_NOOP("Dismissing the answer")),
    AskAboutPhoto: IntentSpec(QT_TR_NOOP("Asking about the photo"), "assistant", also="photos"),
    ChooseModel: IntentSpec(QT_TR_NOOP("Choosing the language model"), "assistant"),
    ChoosePrompt: IntentSpec(QT_TR_NOOP("Choosing the assistant's role or style"), "assistant"),
    EditPrompt: IntentSpec(QT_TR_NOOP("Changing the assistant's prompts"), "assistant"),
    ResetPrompts: IntentSpec(QT_TR_NOOP("Resetting the assistant"), "assistant"),
}
