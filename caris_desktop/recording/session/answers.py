"""Use of language model answers in a session. Answers that were never audible count as unused."""

from collections.abc import Iterable, Sequence
from typing import Literal

from caris_desktop.domain.events import AnswerUsed, LlmExchange
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.session.utterances import SpokenUtterance

LlmUse = Literal["", "said", "edited", "dismissed", "unused"]
_SAID_WITHIN_NS = 5_000_000_000


@dataclass(frozen=True, slots=True)
class LlmAnswer:
    """Question to a language model, and the use of its answer: empty if it gave none."""

    exchange: LlmExchange
    use: LlmUse


def answers_of(
    exchanges: Iterable[LlmExchange], uses: Iterable[AnswerUsed], utterances: Sequence[SpokenUtterance]
) -> tuple[LlmAnswer, ...]:
    """The wizard's questions in recording order."""
    questions = questions_of(exchanges)
    became = answer_uses(questions, uses, utterances)
    return tuple(LlmAnswer(one, became[one.exchange_id] if one.outcome == "answered" else "") for one in questions)


def questions_of(exchanges: Iterable[LlmExchange]) -> tuple[LlmExchange, ...]:
    """Exchanges that the wizard asked; suggestions and proposals have events of their own."""
    return tuple(exchange for exchange in exchanges if exchange.purpose == "question")


def answer_uses(
    exchanges: Iterable[LlmExchange], uses: Iterable[AnswerUsed], utterances: Sequence[SpokenUtterance]
) -> dict[str, LlmUse]:
    """Use of each answer by exchange: said if it was audible unchanged, else edited, else dismissed."""
    by_exchange: dict[str, set[str]] = {}
    for use in uses:
        if not unheard(use, utterances):
            by_exchange.setdefault(use.exchange_id, set()).add(use.use)
    became: dict[str, LlmUse] = {}
    for exchange in exchanges:
        made = by_exchange.get(exchange.exchange_id, set())
        became[exchange.exchange_id] = (
            "said" if "said" in made else "edited" if "edited" in made else "dismissed" if made else "unused"
        )
    return became


def unheard(use: AnswerUsed, utterances: Iterable[SpokenUtterance]) -> bool:
    """True if an answer was to be spoken but was not audible: cancelled before, or speech failed."""
    if use.use == "dismissed":
        return False
    utterance = _utterance_of(use, utterances)
    return utterance is not None and not utterance.said


def _utterance_of(use: AnswerUsed, utterances: Iterable[SpokenUtterance]) -> SpokenUtterance | None:
    """The utterance by id; older recordings only allow matching by text and time."""
    robots = [item for item in utterances if item.speaker == "robot"]
    if use.utterance_id:
        return next((item for item in robots if item.utterance_id == use.utterance_id), None)
    words = use.text.split()
    apart_ns = [
        (abs(item.requested_ns - use.stamp_ns), item)
        for item in robots
        if item.requested_ns is not None and item.text.split() == words
    ]
    nearest = min(apart_ns, key=lambda pair: pair[0], default=None)
    return nearest[1] if nearest is not None and nearest[0] <= _SAID_WITHIN_NS else None
