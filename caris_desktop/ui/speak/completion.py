"""What a half-written sentence goes on with: phrases of the scenario, and sentences that were typed before."""

import re
from collections.abc import Iterable

_LEAST = 2
_LEAST_WITHIN = 6
_MOST_WORDS = 8
_LOOKED_AT = 120
_WORD_STARTS = re.compile(r"\b\w")


def completion(text: str, sentences: Iterable[str]) -> str:
    """What comes after ``text``; empty where nothing fits. The first of ``sentences`` that goes on like it counts.

    One that begins like it goes before one that has its last words somewhere within.
    """
    written = text.casefold()
    if len(written.strip()) < _LEAST:
        return ""
    folded = [(sentence.casefold(), sentence) for sentence in sentences]
    # Where folding changes the length, as of some letters, places in one text are not those in the other.
    candidates = [(lower, sentence) for lower, sentence in folded if len(lower) == len(sentence)]
    for lower, sentence in candidates:
        if lower.startswith(written) and len(sentence) > len(text):
            return sentence[len(text) :]
    tails = _tails(written)
    # Whatever has more of the last words has the last ones, too: a key must not wait for the rest to be looked through.
    candidates = [(lower, sentence) for lower, sentence in candidates if tails and tails[-1] in lower]
    for tail in tails:
        for lower, sentence in candidates:
            at = _within(tail, lower)
            if at and at < len(sentence):
                return sentence[at:]
    return ""


def _tails(written: str) -> list[str]:
    """The last words, the most of them first; never a single one, which goes on in too many ways."""
    starts = [match.start() for match in _WORD_STARTS.finditer(written, max(0, len(written) - _LOOKED_AT))]
    tails = [written[start:] for start in starts[-_MOST_WORDS:-1]]
    return [tail for tail in tails if len(tail) >= _LEAST_WITHIN]


def _within(tail: str, sentence: str) -> int:
    """Where the sentence goes on behind these words; 0 where it does not have them."""
    at = sentence.find(tail)
    while at > 0 and sentence[at - 1].isalnum():
        at = sentence.find(tail, at + 1)
    return at + len(tail) if at >= 0 else 0
