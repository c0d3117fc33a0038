"""The messages for a question to the assistant: pure, and bounded so that the smallest model can hold them."""

from collections.abc import Sequence

from caris_desktop.conversation.transcript import Turn, turns_of
from caris_desktop.domain.events import ChatMessage, UtteranceChanged

MAX_SYSTEM_CHARACTERS = 2000
MAX_QUESTION_CHARACTERS = 1500
MAX_CONVERSATION_CHARACTERS = 1500
MAX_TURN_CHARACTERS = 300
MAX_PEOPLE = 8
MAX_LABEL_CHARACTERS = 40
_SPEAKERS = {"robot": "You", "participant": "Participant", "wizard": "Wizard"}


def build_messages(
    question: str,
    *,
    system_prompt: str,
    conversation: Sequence[UtteranceChanged] = (),
    people: Sequence[str] = (),
) -> tuple[ChatMessage, ...]:
    """One system and one user message, which every model's chat template takes.

    ``people`` are labels of those who are here. The exchange is recorded and may leave this computer, so they must be
    labels that may: opaque ones, unless the study says otherwise. What others said stands in the user message, where
    it has no more weight than the question.
    """
    system = _shortened(system_prompt.strip(), MAX_SYSTEM_CHARACTERS)
    labels = [label for label in (_shortened(_one_line(person), MAX_LABEL_CHARACTERS) for person in people) if label]
    if labels:
        more = f" and {len(labels) - MAX_PEOPLE} more" if len(labels) > MAX_PEOPLE else ""
        system = f"{system}\n\nPeople here now: {', '.join(labels[:MAX_PEOPLE])}{more}.".strip()
    asked = _shortened(question.strip(), MAX_QUESTION_CHARACTERS)
    said = _newest_lines(turns_of(conversation))
    user = f"Said so far:\n{said}\n\nNow: {asked}" if said else asked
    messages = [ChatMessage("system", system)] if system else []
    return (*messages, ChatMessage("user", user))


def _newest_lines(turns: Sequence[Turn]) -> str:
    lines: list[str] = []
    left = MAX_CONVERSATION_CHARACTERS
    for turn in reversed(turns):
        if not turn.said or not turn.text.strip():
            continue
        line = f"{_SPEAKERS[turn.speaker]}: {_shortened(_one_line(turn.text), MAX_TURN_CHARACTERS)}"
        left -= len(line) + 1
        if left < 0:
            break
        lines.append(line)
    return "\n".join(reversed(lines))


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _shortened(text: str, characters: int) -> str:
    return text if len(text) <= characters else text[: characters - 1].rstrip() + "…"
