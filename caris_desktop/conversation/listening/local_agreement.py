"""Stable words of a growing transcript: those on which two successive recognition passes agree.

After LocalAgreement-2 (Liu et al. 2020; Macháček et al. 2023, "Turning Whisper into Real-Time Transcription System").
"""

import difflib
import re
from collections.abc import Sequence
from dataclasses import replace

from caris_desktop.domain.value_class import Value

_SENTENCE_END = (".", "?", "!", "。", "？", "！", "…")
_ALIGN_WORDS = 8
_SAME_TIME_S = 0.6
_NOT_SPOKEN = re.compile(r"[^\w']+")


class RecognisedWord(Value):
    """Recognised word without surrounding spaces; seconds from the start of the sound. ``probability`` is None if the
    engine does not provide it.
    """

    text: str
    start_s: float
    end_s: float
    probability: float | None = None

    @property
    def spoken(self) -> str:
        """Normalised form, for comparison."""
        return _NOT_SPOKEN.sub("", self.text.casefold())

    def later_by(self, seconds: float) -> "RecognisedWord":
        """Shift the times by ``seconds``."""
        return replace(self, start_s=self.start_s + seconds, end_s=self.end_s + seconds)


class AgreedWords:
    """Words of one turn. Committed words never change."""

    def __init__(self) -> None:
        self._committed: list[RecognisedWord] = []
        self._tentative: list[RecognisedWord] = []

    @property
    def committed(self) -> str:
        return " ".join(word.text for word in self._committed)

    @property
    def tentative(self) -> str:
        return " ".join(word.text for word in self._tentative)

    def texts_from(self, first: int) -> tuple[str, str]:
        """Committed and tentative text, without the words before ``first``."""
        behind = max(0, first - len(self._committed))
        committed, tentative = self._committed[first:], self._tentative[behind:]
        return " ".join(word.text for word in committed), " ".join(word.text for word in tentative)

    @property
    def words(self) -> tuple[RecognisedWord, ...]:
        """All words, committed and tentative."""
        return (*self._committed, *self._tentative)

    @property
    def committed_until_s(self) -> float:
        return self._committed[-1].end_s if self._committed else 0.0

    def add(self, recognised: Sequence[RecognisedWord]) -> None:
        """Add the result of another pass, from any start to the end of the sound so far."""
        new = list(recognised[self._already(recognised) :])
        agreed = 0
        for before, now in zip(self._tentative, new, strict=False):
            if before.spoken != now.spoken:
                break
            agreed += 1
        self._committed += new[:agreed]
        self._tentative = new[agreed:]

    def commit_all(self) -> None:
        """Commit all words: no further pass will change them."""
        self._committed += self._tentative
        self._tentative = []

    def cut_at_s(self, *, sentences: bool = True) -> float | None:
        """End of the last committed sentence, or word, before which sound is no longer needed; None
        if there is none.
        """
        ends = [word.end_s for word in self._committed if not sentences or word.text.endswith(_SENTENCE_END)]
        return ends[-1] if ends else None

    def _already(self, recognised: Sequence[RecognisedWord]) -> int:
        """Number of leading words that repeat committed ones."""
        if not self._committed:
            return 0
        # A pass may begin within the committed words, and recognise some of them differently.
        overlapping = [word for word in self._committed if not recognised or word.end_s > recognised[0].start_s - 0.1]
        last = [word.spoken for word in overlapping[-_ALIGN_WORDS:]]
        if last:
            spoken_words = [word.spoken for word in recognised]
            if spoken_words[: len(overlapping)] == [word.spoken for word in overlapping]:
                return len(overlapping)
            matcher = difflib.SequenceMatcher(None, last, spoken_words, autojunk=False)
            for block in reversed(matcher.get_matching_blocks()):
                at = block.b + block.size
                behind = len(last) - (block.a + block.size)
                if not block.size or at + behind > len(recognised):
                    continue
                known = overlapping[-behind - 1]
                # Times are inexact, above all after a pause; several words in a row rarely match by chance.
                if abs(recognised[at - 1].end_s - known.end_s) <= _SAME_TIME_S * block.size:
                    return at + behind
        until_s = self.committed_until_s
        return sum((word.start_s + word.end_s) / 2 <= until_s for word in recognised)
