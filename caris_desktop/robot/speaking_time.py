"""Estimated speaking time of robots that do not report it."""

LONGEST_UTTERANCE_S = 120.0
# Characters per second of typical synthetic voices, for scripts denser than Latin.
_CHARACTERS_PER_S = {"zh": 4.5, "ja": 7.0, "ko": 6.5, "th": 11.0, "he": 11.0, "ar": 12.0, "hi": 12.0}
_USUAL_CHARACTERS_PER_S = 15.0


def estimated_duration_s(text: str, language: str = "") -> float:
    """Duration of a typical synthetic voice in that language (``de``, ``en-GB``)."""
    per_s = _CHARACTERS_PER_S.get(language.replace("_", "-").partition("-")[0].lower(), _USUAL_CHARACTERS_PER_S)
    return 0.4 + len(text) / per_s
