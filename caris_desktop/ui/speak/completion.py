"""Completion of a partial sentence from phrases and earlier utterances."""

import re
from collections.abc import Iterable

_LEAST = 2
_LEAST_WITHIN = 6
_MOST_WORDS = 8
_LOOKED_AT = 120
_WORD_STARTS = re.compile(r"\b\w")


def completion(text: str, sentences: Iterable[str]) -> str:
    """Continuation of ``text``; empty if none. The first match in ``sentences`` wins.

    Sentences that begin with the text precede those that contain its last words.
    """
    written = text.casefold()
    if len(written.strip()) < _LEAST:
        return ""
    folded = [(sentence.casefold(), sentence) for sentence in sentences]
    # Case folding may change the length, which would shift positions.
    candidates = [(lower, sentence) for lower, sentence in folded if len(lower) == len(sentence)]
    for lower, sentence in candidates:
        if lower.startswith(written) and len(sentence) > len(text):
            return sentence[len(text) :]
    tails = _tails(written)
    # A longer tail contains the shortest one: this filter keeps completion fast enough for typing.
    candidates = [(lower, sentence) for lower, sentence in candidates if tails and tails[-1] in lower]
    for tail in tails:
        for lower, sentence in candidates:
            at = _within(tail, lower)
            if at and at < len(sentence):
                return sentence[at:]
    return ""


def _tails(written: str) -> list[str]:
    """Last words, longest sequence first; never a single word, which is too ambiguous."""
    starts = [match.start() for match in _WORD_STARTS.finditer(written, max(0, len(written) - _LOOKED_AT))]
    tails = [written[start:] for start in starts[-_MOST_WORDS:-1]]
    return [tail for tail in tails if len(tail) >= _LEAST_WITHIN]


def _within(tail: str, sentence: str) -> int:
    """Position after these words in the sentence; 0 if not found."""
    at = sentence.find(tail)
    while at > 0 and sentence[at - 1].isalnum():
        at = sentence.find(tail, at + 1)
    return at + len(tail) if at >= 0 else 0
