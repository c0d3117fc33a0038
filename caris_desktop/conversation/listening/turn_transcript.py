"""End-of-turn detection by words, combined with the sound.

Neither suffices: the network judges melody and silence, while a sentence that ends in "with the" continues however
final it sounds. A full stop by the recogniser reflects both.
"""

import math
import re

_ENGLISH = (
    "a an the every each another my your our their its his such several many few "
    "of to with at for from by as than into onto upon between among during without within towards against until per "
    "and or but because if when while although whereas unless whether that who whose which what how why where "
    "i we he she they it's i'm we're they're he's she's that's there's you're i've we've they've you've "
    "i'll we'll they'll he'll she'll you'll i'd we'd they'd "
    "very really rather quite almost just even um uh er erm uhm hmm well so not"
)
_GOES_ON = {"en": frozenset(_ENGLISH.split())}
"""Words after which people go on, nearly always; of a language that is not here the marks alone are looked at."""
_ENGLISH_VERBS = (
    "am is are was were be been being have has had do does did will would can could shall should may might must"
)
_GOES_ON_WITHOUT_PRONOUN = {"en": frozenset(_ENGLISH_VERBS.split())}
"""The same, but for short answers: "Yes, I do", "it was"."""
_ENGLISH_PRONOUNS = ("i", "you", "he", "she", "it", "we", "they", "this", "that", "there")
_PRONOUNS = {"en": frozenset(_ENGLISH_PRONOUNS)}
_ENGLISH_BEGINNINGS = """
i think, i guess, i mean, i wonder, i would say, i suppose, i believe, i am afraid, i'm afraid, i hope,
tell me, told me, asked me, ask me, show me, give me, gave me, do you think, do you know, let me,
would like, i like, can you, could you, would you, will you, can i, could i, may i,
there is, there are, there was, there were, is there, are there,
have to, had to, has to, want to, going to, able to, used to,
out of, one of, a lot of, kind of, sort of, because of, instead of, next to, how many, how much,
the first, the last, the next, the same, the most, the best, my first, in front
"""
_BEGINNINGS = {"en": tuple(tuple(each.split()) for each in _ENGLISH_BEGINNINGS.split(","))}
"""What more has to follow."""
_ENGLISH_ALONE = "yesterday sometimes usually normally actually maybe perhaps however often once then also"
_ALONE = {"en": frozenset(_ENGLISH_ALONE.split())}
"""What a sentence may begin with and is hardly one: the second word at most."""
_ENGLISH_SUBORDINATE = "when if because since after before while whenever although though once until as unless"
_SUBORDINATE = {"en": frozenset(_ENGLISH_SUBORDINATE.split())}
_ASKS = {"en": _GOES_ON_WITHOUT_PRONOUN["en"]}
_SHORT_CLAUSE = 7
"""Words: a clause that begins with "when" and is no longer has another one behind it."""
_ENDED = (".", "!", "。", "！")
_QUESTION = ("?", "？")
_OPEN = ("...", "…", ",", "，", "-", "–", ":")
_SENTENCE = re.compile(r"[.?!]\s+")
_EDGES = ".,!?…-–:;\"'"
# Log odds that a turn is over at a pause: logistic regression on synthetic turns of four voices, with sentences outside
# of the test set. The sound has a higher weight than those voices, with little melody, would give.
_AT_ANY_PAUSE, _GOING_ON, _FULL_STOP, _QUESTION_MARK, _SOUND = -1.45, -1.45, 1.7, 1.05, 0.15
_LEAST_SURE = 0.005


def with_words(turn_over: float, text: str, language: str) -> float:
    """Probability that a turn is over, from its sound and its transcript so far."""
    sound = min(1.0 - _LEAST_SURE, max(_LEAST_SURE, turn_over))
    odds = _AT_ANY_PAUSE + _SOUND * math.log(sound / (1.0 - sound))
    written = text.rstrip()
    # Recognisers hear the melody, too.
    if goes_on(written, language):
        odds += _GOING_ON
    elif written.endswith(_QUESTION):
        odds += _QUESTION_MARK
    elif written.endswith(_ENDED):
        odds += _FULL_STOP
    return 1.0 / (1.0 + math.exp(-odds))


def goes_on(text: str, language: str) -> bool:
    """True if a text ends where sentences rarely end."""
    written = text.rstrip()
    if written.endswith(_OPEN):
        return True
    words = [bare for word in written.casefold().split() if (bare := word.strip(_EDGES))]
    if not words:
        return False
    last, before = words[-1], words[-2] if len(words) > 1 else ""
    # A question may end in any of them: where are you from?
    if not written.endswith(_QUESTION) and (
        last in _GOES_ON.get(language, ())
        or (last in _GOES_ON_WITHOUT_PRONOUN.get(language, ()) and before not in _PRONOUNS.get(language, ()))
    ):
        return True
    if any(tuple(words[-len(each) :]) == each for each in _BEGINNINGS.get(language, ())):
        return True
    if len(words) <= 2 and last in _ALONE.get(language, ()):
        return True
    clause = _SENTENCE.split(written)[-1].casefold()
    first, *rest = [word.strip(_EDGES) for word in clause.split()] or [""]
    return (
        first in _SUBORDINATE.get(language, ())
        and "," not in clause
        and len(rest) < _SHORT_CLAUSE
        and not (rest and rest[0] in _ASKS.get(language, ()))
    )
