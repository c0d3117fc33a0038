"""Intents of the language model: questions, answers and prompts."""

from typing import Literal

from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass

PromptPart = Literal["conversation", "step", "people", "history", "things", "notes"]
"""Context of a question unless left out: the conversation, the current step of the protocol, the people present, their
history, other things in view, and the notes."""
CAMERA_PICTURE = "camera "
"""Prefix of a camera name among the images of a question: its current frame."""


@dataclass(frozen=True, slots=True)
class Ask(Intent):
    """Ask the language model, in parallel to other questions; the answer streams into ``state.assistant``.

    ``pictures`` are file names of photos, or CAMERA_PICTURE and the name of a camera.
    """

    question: str
    leave_out: tuple[PromptPart, ...] = ()
    pictures: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class CancelAnswer(Intent):
    """Cancel an answer of the language model; all answers in progress if none is named."""

    exchange_id: str = ""


@dataclass(frozen=True, slots=True)
class SayAnswer(Intent):
    """Say an answer of the language model, possibly edited by the wizard; the newest if none is named."""

    text: str
    exchange_id: str = ""


@dataclass(frozen=True, slots=True)
class DismissAnswer(Intent):
    """Dismiss a question and its answer, unsaid; cancel it if in progress."""

    exchange_id: str


@dataclass(frozen=True, slots=True)
class AskAboutPhoto(Intent):
    """Ask the language model about a photo, which is sent with the question."""

    file_name: str
    question: str


@dataclass(frozen=True, slots=True)
class ChooseModel(Intent):
    """Ask this model from now on: ``embedded``, ``ollama:NAME``, ``openai:NAME`` or ``gemini:NAME``."""

    model: str


@dataclass(frozen=True, slots=True)
class ChoosePrompt(Intent):
    """Use this role or style of the scenario from now on; none if the name is empty."""

    kind: Literal["role", "style"]
    name: str


@dataclass(frozen=True, slots=True)
class EditPrompt(Intent):
    """Change a text for this session: the system prompt, the notes, or the role or style of that name."""

    kind: Literal["system_prompt", "notes", "role", "style"]
    text: str
    name: str = ""


@dataclass(frozen=True, slots=True)
class ResetPrompts(Intent):
    """Restore all texts, model, role and style of the scenario."""


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
