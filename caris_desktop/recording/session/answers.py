"""What became of the answers of language models. What nobody heard was not used, whatever was asked for."""

from collections.abc import Iterable, Sequence
from typing import Literal

from caris_desktop.domain.events import AnswerUsed, LlmExchange
from caris_desktop.recording.session.utterances import SpokenUtterance

LlmUse = Literal["said", "edited", "dismissed", "unused"]
_SAID_WITHIN_NS = 5_000_000_000


def questions_of(exchanges: Iterable[LlmExchange]) -> tuple[LlmExchange, ...]:
    """What the wizard asked. Of suggestions and proposals there are events of their own."""
    return tuple(exchange for exchange in exchanges if exchange.purpose == "question")


def answer_uses(
    exchanges: Iterable[LlmExchange], uses: Iterable[AnswerUsed], utterances: Sequence[SpokenUtterance]
) -> dict[str, LlmUse]:
    """What became of each answer, by exchange: said if it ever was heard as it stood, else edited, else dismissed."""
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
    """Whether an answer was to be said and nobody heard it: it was silenced first, or the voice failed."""
    if use.use == "dismissed":
        return False
    utterance = _utterance_of(use, utterances)
    return utterance is not None and not utterance.said


def _utterance_of(use: AnswerUsed, utterances: Iterable[SpokenUtterance]) -> SpokenUtterance | None:
    """By its id; older records have only the same words at about the same time."""
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
