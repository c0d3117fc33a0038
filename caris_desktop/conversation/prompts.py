"""The messages for a question to the assistant: pure, and bounded so that the smallest model can hold them."""

from collections import Counter
from collections.abc import Iterable, Sequence

from caris_desktop.conversation.transcript import Turn, turns_of
from caris_desktop.domain.events import ChatMessage, UtteranceChanged

MAX_SYSTEM_CHARACTERS = 2000
MAX_QUESTION_CHARACTERS = 1500
MAX_CONVERSATION_CHARACTERS = 1500
MAX_TURN_CHARACTERS = 300
MAX_PEOPLE = 8
MAX_THINGS = 20
MAX_LABEL_CHARACTERS = 40
MAX_HISTORY_CHARACTERS = 240


def build_messages(
    question: str,
    *,
    system_prompt: str,
    conversation: Sequence[UtteranceChanged] = (),
    people: Sequence[str] = (),
    things: Iterable[str] = (),
    label_characters: int = MAX_LABEL_CHARACTERS,
) -> tuple[ChatMessage, ...]:
    """System message, the newest turns as the dialogue that they were, and the question as the last user message.

    What the robot said are the model's own turns: small models parrot a transcript that stands inside a question.
    ``people`` are labels of those who are here. What is asked may leave this computer, so they must be labels that may:
    opaque ones, unless the study says otherwise. ``things`` are the names of what else is in view, one for each thing.
    """
    system = _shortened(system_prompt.strip(), MAX_SYSTEM_CHARACTERS)
    labels = [label for label in (_shortened(_one_line(person), label_characters) for person in people) if label]
    if labels:
        more = f" and {len(labels) - MAX_PEOPLE} more" if len(labels) > MAX_PEOPLE else ""
        system = f"{system}\n\nPeople here now: {', '.join(labels[:MAX_PEOPLE])}{more}.".strip()
    seen = [_counted(name, number) for name, number in Counter(map(_one_line, things)).most_common(MAX_THINGS)]
    if seen:
        system = f"{system}\n\nIn view: {', '.join(seen)}.".strip()
    messages = [ChatMessage("system", system)] if system else []
    for message in (*_newest_turns(turns_of(conversation)), ChatMessage("user", _question(question))):
        # Some chat templates insist on alternating roles.
        if messages and messages[-1].role == message.role:
            messages[-1] = ChatMessage(message.role, f"{messages[-1].content}\n{message.content}")
        else:
            messages.append(message)
    return tuple(messages)


def characters_too_long(question: str) -> int:
    """By how much a question is longer than what is told of it to a model; 0 where all of it is."""
    return max(0, len(question.strip()) - MAX_QUESTION_CHARACTERS)


def _question(question: str) -> str:
    return _shortened(question.strip(), MAX_QUESTION_CHARACTERS)


def _newest_turns(turns: Sequence[Turn]) -> list[ChatMessage]:
    messages: list[ChatMessage] = []
    left = MAX_CONVERSATION_CHARACTERS
    for turn in reversed(turns):
        if not turn.said or not turn.text.strip():
            continue
        text = _shortened(_one_line(turn.text), MAX_TURN_CHARACTERS)
        left -= len(text) + 1
        if left < 0:
            break
        messages.append(ChatMessage("assistant" if turn.speaker == "robot" else "user", text))
    return messages[::-1]


def _counted(name: str, number: int) -> str:
    name = _shortened(name, MAX_LABEL_CHARACTERS)
    if number == 1:
        return f"1 {name}"
    return f"{number} {name}{'es' if name.endswith(('s', 'x', 'ch', 'sh')) else 's'}"


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _shortened(text: str, characters: int) -> str:
    return text if len(text) <= characters else text[: characters - 1].rstrip() + "…"
