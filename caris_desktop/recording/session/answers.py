"""Use of a language model's texts in a session. Those that were never audible count as unused."""

from collections.abc import Iterable, Sequence
from typing import Literal

from caris_desktop.domain.events import AnswerUsed, LlmExchange
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session.session_suggestions import Fate, ShownReply
from caris_desktop.recording.session.utterances import SpokenUtterance

LlmUse = Literal["", "said", "edited", "dismissed", "superseded", "expired", "unused"]
_USE_OF_FATE: dict[Fate, LlmUse] = {
    "taken": "said", "edited": "edited", "dismissed": "dismissed", "superseded": "superseded", "expired": "expired",
}  # fmt: skip
"""The use of an exchange is that of its suggestion which comes first here."""
_SAID_WITHIN_NS = 5_000_000_000


class LlmAnswer(Value):
    """Exchange with a language model, and the use of its answer: empty if it gave none.

    Of an exchange for suggested replies, ``shown`` counts those that the wizard saw, ``latency_ms`` is that of the
    first one, and ``edit_distance`` of the one that was used; None for other exchanges, and without such a suggestion.
    """

    exchange: LlmExchange
    use: LlmUse
    shown: int | None = None
    latency_ms: float | None = None
    edit_distance: int | None = None


def answers_of(
    exchanges: Iterable[LlmExchange], uses: Iterable[AnswerUsed], utterances: Sequence[SpokenUtterance]
) -> tuple[LlmAnswer, ...]:
    """The wizard's questions in recording order."""
    questions = questions_of(exchanges)
    became = answer_uses(questions, uses, utterances)
    return tuple(LlmAnswer(one, became[one.exchange_id] if one.outcome == "answered" else "") for one in questions)


def reply_answers_of(
    exchanges: Iterable[LlmExchange], replies: Iterable[ShownReply], utterances: Sequence[SpokenUtterance]
) -> tuple[LlmAnswer, ...]:
    """Exchanges for suggested replies, in recording order. Their outcome does not tell the use: replies are shown while
    the model writes, and a newer turn cancels it.
    """
    asked = [exchange for exchange in exchanges if exchange.purpose == "replies"]
    of_exchange: dict[str, list[ShownReply]] = {}
    for reply in replies:
        # Older recordings have no revision.
        possible = [
            exchange
            for exchange in asked
            if exchange.turn_id == reply.turn_id
            and exchange.revision in (0, reply.revision)
            and exchange.asked_ns <= reply.shown_ns
        ]
        if possible:
            newest = max(possible, key=lambda exchange: exchange.asked_ns)
            of_exchange.setdefault(newest.exchange_id, []).append(reply)
    unheard_ids = {utterance.utterance_id for utterance in utterances if not utterance.said}
    return tuple(_of_replies(exchange, of_exchange.get(exchange.exchange_id, []), unheard_ids) for exchange in asked)


def _of_replies(exchange: LlmExchange, replies: list[ShownReply], unheard_ids: set[str]) -> LlmAnswer:
    if not replies:
        return LlmAnswer(exchange, "unused" if exchange.outcome == "answered" else "", 0)
    used = min(replies, key=lambda reply: [*_USE_OF_FATE].index(reply.fate))
    unheard = used.was_said and used.utterance_id in unheard_ids
    latencies_ms = [reply.latency_ms for reply in replies if reply.latency_ms is not None]
    return LlmAnswer(
        exchange, "unused" if unheard else _USE_OF_FATE[used.fate], len(replies), min(latencies_ms, default=None),
        used.edit_distance,
    )  # fmt: skip


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
