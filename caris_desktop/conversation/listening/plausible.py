"""What a recogniser says of sound without words: it is trained on subtitles, and writes what stands in those."""

import re
from collections.abc import Sequence

from caris_desktop.conversation.listening.agreement import HeardWord

_NOTHING_SAID = 0.6
_UNLIKELY = -1.0
_WORST = -1.6
_AFTER_VOICE_S = 0.15
_REPEATED_AT_MOST = 3
_LONG_PHRASE = 4
_WORDS_A_SECOND = 5.0
"""Nobody says the same phrase twice as fast as this."""
_SUBTITLES = frozenset(
    (
        "thank you", "thanks", "thank you very much", "thanks for watching", "thank you for watching", "bye", "bye bye",
        "you", "so", "okay", "oh", "please subscribe", "subscribe", "the end", "subtitles by the amara org community",
        "thank you so much for watching", "see you next time", "see you in the next video", "music", "applause",
    )
)  # fmt: skip
_UNSURE_OF_SUBTITLE = 0.35
_SIGNS = re.compile(r"[^\w\s']+")
_BRACKETED = re.compile(r"^[\[(♪*].*[\])♪*]$")


def is_nothing(text: str, *, no_speech: float, log_probability: float) -> bool:
    """Whether a stretch of text is what a recogniser writes where nobody speaks."""
    said = " ".join(_SIGNS.sub(" ", text.casefold()).split())
    if not said or _BRACKETED.match(text.strip()):
        return True
    if log_probability < _WORST or (no_speech > _NOTHING_SAID and log_probability < _UNLIKELY):
        return True
    return said in _SUBTITLES and no_speech > _UNSURE_OF_SUBTITLE


def within_voice(words: Sequence[HeardWord], voice_ended_s: float) -> list[HeardWord]:
    """Those that begin while there is voice: what is written after it was not said."""
    return [word for word in words if word.start_s < voice_ended_s + _AFTER_VOICE_S]


def without_repetition(words: Sequence[HeardWord]) -> list[HeardWord]:
    """A phrase of one to six words that comes over and over is a recogniser that is stuck, and so is one that comes
    twice in the time that it takes once: it is kept once.

    People do say a word three times, and a question twice.
    """
    kept = _said_once(list(words))
    for length in range(1, 7):
        at = 0
        while at + length <= len(kept):
            phrase = [word.spoken for word in kept[at : at + length]]
            times = 1
            while [word.spoken for word in kept[at + times * length : at + (times + 1) * length]] == phrase:
                times += 1
            if times > _REPEATED_AT_MOST:
                del kept[at + length : at + times * length]
            at += 1
    return kept


def _said_once(words: list[HeardWord]) -> list[HeardWord]:
    for length in range(len(words) // 2, _LONG_PHRASE - 1, -1):
        for at in range(len(words) - 2 * length + 1):
            both = words[at : at + 2 * length]
            again = [word.spoken for word in both[:length]] == [word.spoken for word in both[length:]]
            if again and len(both) > _WORDS_A_SECOND * (both[-1].end_s - both[0].start_s):
                return words[: at + length] + words[at + 2 * length :]
    return _without_half_again(words)


def _without_half_again(words: list[HeardWord]) -> list[HeardWord]:
    """The same where the second time breaks off, as the sound does."""
    for length in range(len(words) // 2, _LONG_PHRASE - 1, -1):
        tail = [word.spoken for word in words[-length:]]
        for at in range(len(words) - 2 * length + 1):
            both = words[at:]
            again = [word.spoken for word in both[:length]] == tail
            if again and len(both) > _WORDS_A_SECOND * (both[-1].end_s - both[0].start_s):
                return words[:-length]
    return words
