"""Speakable form of model output: without Markdown, HTML, addresses and symbols."""

import html
import re
import unicodedata
from collections.abc import Callable, Mapping

from caris_desktop.conversation.models.reasoning import SpokenPart
from caris_desktop.domain import person_marks
from caris_desktop.domain.value_class import Value

_FENCE = re.compile(r"^\s*(?:```|~~~)\S*\s*$", re.MULTILINE)
# Line prefixes: quotation, heading, bullet or number, check box.
_LEADS = re.compile(r"^\s*(?:>\s*)*(?:#{1,6}\s+|[-*+•–]\s+|\(?\d{1,2}[.):]\s+)?(?:\[[ xX]\]\s+)?")
_LINK = re.compile(r"!?\[([^\[\]]*)\](?:\([^()\s]*(?:\s+\"[^\"]*\")?\)|\[[^\[\]]*\])|\[\^[^\[\]]*\]")
# Bounded, here and below: a server could send text with pathological matching time.
_TAG = re.compile(
    r"<!--.{0,500}?-->|<(?:script|style)\b.{0,2000}?</(?:script|style)>|</?[a-zA-Z][^<>]*>", re.DOTALL | re.IGNORECASE
)
_ADDRESS = re.compile(r"<?(?:https?|ftp)://[^\s<>)]+>?|\bwww\.[^\s<>)]+")
_ESCAPED = re.compile(r"\\([\\`*_{}\[\]()#+.!|~<>-])")
_EMPHASIS = re.compile(r"(?<![\w*_~])(\*{1,3}|_{1,3}|~~)(?=\S)(.{1,300}?)(?<=\S)\1(?![\w*_~])")
_SIGNS = re.compile(r"[*`~|\\]+|(?<!\w)[_#]+(?!\d)|(?<=\w)_+(?!\w)")
_PICTOGRAMS = re.compile("[\U0001f000-\U0001faff\u2600-\u27bf\ufe0f\u20e3]")
_TIMES = re.compile(r"(?<=\d)\s?\*\s?(?=\d)")
_ENDS = ".!?…:;,"
LONGEST_WRITTEN = 20_000
"""Characters; nobody listens for as long as that takes."""


def spoken(written: str) -> str:
    """One line of text, list items as sentences; empty if nothing is speakable."""
    part = SpokenPart()
    text = "".join((*part.process(written[:LONGEST_WRITTEN]), *part.end(whole=True)))
    lines = [spoken_line for line in _without_tags(_FENCE.sub("", text)).splitlines() if (spoken_line := _line(line))]
    # List items need sentence ends to be audible as a list.
    ended = [line if line[-1] in _ENDS or line is lines[-1] else f"{line}." for line in lines]
    return " ".join(ended)


def _without_tags(text: str) -> str:
    return html.unescape(_TAG.sub(" ", _ADDRESS.sub(" ", _LINK.sub(r"\1", text))))


def _line(line: str) -> str:
    line = _TIMES.sub(" × ", _LEADS.sub("", line))
    for _ in range(3):  # nested bold, italics, strike-through
        line = _EMPHASIS.sub(r"\2", line)
    line = _PICTOGRAMS.sub(" ", _SIGNS.sub(" ", _ESCAPED.sub(r"\1", line)))
    # Tags written as entities appear last, and are removed too.
    line = _TAG.sub(" ", line)
    readable = (character if unicodedata.category(character)[0] != "C" else "" for character in line)
    line = re.sub(r"\s+(?=[.,!?;:…](?:\s|$))", "", " ".join("".join(readable).split()))
    return line if re.search(r"\w", line) else ""


# Placeholders in phrases, as in "Hello, {name}!": detection and filling, for speech and for the record.

NAME, PLACE = "name", "place"
"""Placeholders the console can fill."""
_GAP = re.compile(r"\{([a-z][a-z ]{0,38})\}")


class Words(Value):
    """Text as spoken and as recorded, with ids instead of names."""

    spoken: str
    recorded: str


def gaps(text: str) -> tuple[str, ...]:
    """Placeholders in order, without duplicates or person marks."""
    return tuple(dict.fromkeys(_GAP.findall(text)))


def missing(text: str, words: Mapping[str, Words]) -> tuple[str, ...]:
    """Placeholders without a value."""
    return tuple(gap for gap in gaps(text) if gap not in words)


def fill_placeholders(text: str, words: Mapping[str, Words], name_of: Callable[[str], str]) -> Words:
    """Fill the placeholders of ``text``; ``name_of`` returns the spoken name for a person mark."""
    spoken = _GAP.sub(lambda gap: words[gap[1]].spoken if gap[1] in words else gap[0], text)
    recorded = _GAP.sub(lambda gap: words[gap[1]].recorded if gap[1] in words else gap[0], text)
    return Words(person_marks.with_names(spoken, name_of), recorded)
