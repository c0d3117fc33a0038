"""Replies from a model's partial output, made suitable for speech."""

import json
import re
import unicodedata

from caris_desktop.conversation.spoken_text import spoken

LONGEST_REPLY = 120
# Longer output cannot be three short replies.
_LONGEST_ANSWER = 8_000
_ABOUT_ITSELF = re.compile(r"\b(language model|as an ai|i am an ai|i'm an ai)\b", re.IGNORECASE)
# A sentence cut by the grammar rather than ended by the model.
_CUT_OFF = re.compile(r"(?:[\s,;:]|,\w{1,2})[.!?]$")
# Small models repeat themselves. "No, no, no" is still natural.
_OVER_AND_OVER = re.compile(r"\b(\w+(?:\W+\w+){1,7})(?:\W+\1\b){2,}|\b(\w+)(?:\W+\2\b){3,}", re.IGNORECASE)
_BEGINS = re.compile(r"^(?:(?:robot|reply|answer|assistant|guide)\s*\d?\s*:\s*)+", re.IGNORECASE)


def replies_in(written: str) -> tuple[str, ...]:
    """Complete text values in a possibly unfinished JSON object or list, without keys."""
    written = written[:_LONGEST_ANSWER]
    begin = min((place for place in (written.find("{"), written.find("[")) if place >= 0), default=-1)
    if begin < 0:
        return ()
    texts: list[str] = []
    within: list[str] = []
    awaits_key = False
    place = begin
    while place < len(written):
        character = written[place]
        place += 1
        if character in "{[":
            within.append(character)
            awaits_key = character == "{"
        elif character in "}]":
            if within:
                within.pop()
            if not within:
                break
            awaits_key = False
        elif character == ",":
            awaits_key = bool(within) and within[-1] == "{"
        elif character == ":":
            awaits_key = False
        elif character == '"':
            end = _end_of_text(written, place)
            if end is None:
                break
            if not awaits_key:
                texts.append(_unescaped(written[place:end]))
            place = end + 1
    return tuple(texts)


def _end_of_text(written: str, begin: int) -> int | None:
    place = begin
    while place < len(written):
        if written[place] == '"':
            return place
        place += 2 if written[place] == "\\" else 1
    return None


def _unescaped(text: str) -> str:
    try:
        return str(json.loads(f'"{text}"', strict=False))
    except ValueError:
        return ""


def fit_to_say(text: str) -> str:
    """One or two plain sentences of at most LONGEST_REPLY characters; empty if unsuitable."""
    text = text[: 10 * LONGEST_REPLY]
    if _CUT_OFF.search(text):
        return ""
    text = unicodedata.normalize("NFC", text.encode("utf-8", "ignore").decode("utf-8"))
    text = spoken(" ".join(text.split()))
    text = _BEGINS.sub("", text).strip(" \"'“”„«»")
    if _ABOUT_ITSELF.search(text) or not re.search(r"\w", text) or set(text) & set("{}<>"):
        # Braces are placeholders, which only the wizard fills.
        return ""
    if _OVER_AND_OVER.search(text):
        return ""
    return text if len(text) <= LONGEST_REPLY else _whole_sentences(text)


def _whole_sentences(text: str) -> str:
    """Leading complete sentences that fit."""
    ends = [
        place + 1
        for place in range(min(LONGEST_REPLY, len(text)))
        if text[place] in ".!?…" and not text[place + 1 : place + 2].strip()
    ]
    return text[: ends[-1]] if ends else ""


def words_of(text: str) -> list[str]:
    """Words in lower case without punctuation."""
    return re.findall(r"[^\W_]+(?:'[^\W_]+)*", text.lower().replace("’", "'"))


def same_words(text: str, other: str) -> bool:
    """True if two texts differ only in case and punctuation."""
    return words_of(text) == words_of(other)
