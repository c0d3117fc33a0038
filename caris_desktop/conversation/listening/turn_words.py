"""Whether somebody has finished, by their words, beside how they sound.

Neither is enough: the network judges by melody and silence, and a sentence that ends in "with the" goes on however
final it sounds.
"""

_ENGLISH = (
    "a an the every another my your our their its of to with in on at for from by about as than into and or "
    "but so because if when while which whose i we he she they i'm it's we're they're very really um uh er erm "
    "hmm"
)
_GOES_ON = {"en": frozenset(_ENGLISH.split())}
"""Words after which people go on, nearly always; of a language that is not here the marks alone are looked at."""
_ENDED = (".", "?", "!", "。", "？", "！")
_OPEN = ("...", "…", ",", "，", "-", "–", ":")
_AT_MOST, _LESS = 0.1, 0.5


def with_words(turn_over: float, text: str, language: str) -> float:
    """How likely a turn is over, 0 to 1: by its sound, and by what was made out in it so far."""
    last = text.rstrip().rpartition(" ")[2]
    # A question may end in any of them: where are you from?
    if not last.endswith("?") and last.strip(".,!…-").casefold() in _GOES_ON.get(language, ()):
        return min(turn_over, _AT_MOST)
    if last.endswith(_OPEN):
        return _LESS * turn_over
    # Whoever writes it down hears the melody too, with other ears.
    return float(turn_over**0.5) if last.endswith(_ENDED) else turn_over
