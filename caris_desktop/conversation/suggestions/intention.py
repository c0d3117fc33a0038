"""Dialogue act of a reply, and comparison of replies."""

import re
from collections.abc import Sequence
from typing import Literal

from caris_desktop.conversation.suggestions.replies import words_of

Intention = Literal["question", "yes", "no", "thanks", "greeting", "farewell", "sorry", "acknowledgement", "statement"]

_OPENINGS: Sequence[tuple[Intention, str]] = (
    ("farewell", r"goodbye|bye|see you|take care|have a (nice|good|great)|until next time"),
    ("greeting", r"hello|hi|hey|welcome|good (morning|afternoon|evening)|nice to meet"),
    ("thanks", r"thanks|thank you"),
    ("sorry", r"sorry|i'?m sorry|i am sorry|my apologies|excuse me"),
    ("no", r"no|nope|not really|i'?m afraid not|unfortunately|never"),
    ("yes", r"yes|yeah|yep|sure|of course|certainly|absolutely|definitely|exactly|right"),
    (
        "acknowledgement",
        r"i see|i understand|i hear you|okay|ok|alright|got it|(that'?s |what )?(a |an )?(very )?"
        r"(good|great|nice|interesting|excellent) (question|point|idea|to hear)|that sounds|how (nice|interesting)",
    ),
)
_ONLY_ONE: tuple[Intention, ...] = ("thanks", "greeting", "farewell", "sorry", "acknowledgement")
"""Of these there is no second one to choose from: whatever their words are, they do the same."""
# Stop words.
_SMALL = frozenset(words_of(
    "a an and are as at be been but can could did do does for from had has have he her here him his how i if in is it "
    "its just let me my of on or our out she so some that the their them then there they this to too up us very was we "
    "were what when where which who why will with would you your please may might must should shall about also"
))  # fmt: skip
_NEAR_DUPLICATE, _ALIKE = 0.6, 0.34


def intention_of(text: str) -> Intention:
    """Dialogue act by the beginning and end; after a polite opening, that of the longer rest."""
    lowered = " ".join(text.lower().replace("’", "'").split())
    for intention, opening in _OPENINGS:
        match = re.match(rf"(?:{opening})\b[\s,.!?-]*", lowered)
        if match is None:
            continue
        rest = lowered[match.end() :]
        if intention in ("yes", "no") or len(rest.split()) < 4:
            return intention
        return intention_of(rest)
    return "question" if lowered.endswith("?") else "statement"


def same_intention(text: str, other: str) -> bool:
    """True if two replies are equivalent, leaving nothing to choose."""
    does, other_does = intention_of(text), intention_of(other)
    if {does, other_does} == {"yes", "no"}:
        return False
    alike = _alike(text, other)
    if does != other_does:
        return alike >= _NEAR_DUPLICATE
    return does in _ONLY_ONE or alike >= _ALIKE


def _alike(text: str, other: str) -> float:
    """Share of common content words."""
    words, others = (frozenset(words_of(each)) - _SMALL for each in (text, other))
    if not words or not others:
        return 1.0 if words == others else 0.0
    return len(words & others) / min(len(words), len(others)) if len(words & others) > 1 else _jaccard(words, others)


def _jaccard(words: frozenset[str], others: frozenset[str]) -> float:
    return len(words & others) / len(words | others)
