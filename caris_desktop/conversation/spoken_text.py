"""Speakable form of model output: without Markdown, HTML, addresses and symbols."""

import html
import re
import unicodedata
from collections.abc import Callable, Iterable, Mapping

from caris_desktop.conversation.models.reasoning import SpokenPart
from caris_desktop.domain import person_marks
from caris_desktop.domain.value_class import Value

_FENCE = re.compile(r"^\s*(?:```|~~~)\S*\s*$", re.MULTILINE)
# Calls of tools, as Gemini writes them
_CALL_FENCE = re.compile(r"```tool_\w{1,20}\n.{0,5000}?(?:```|\Z)", re.DOTALL)
# Line prefixes: quotation, heading, bullet, check box; numbers if several lines have one, since "3. Stock" is a floor.
_LEADS = re.compile(r"^\s*(?:>\s*)*(?:#{1,6}\s+|[-*+•–◦▪‣●○·]\s+)?(?:\[[ xX]\]\s+)?")
_NUMBERED = re.compile(r"^\s*(?:>\s*)*\(?\d{1,2}[.):]\s+(?:\[[ xX]\]\s+)?")
_TARGET = r"\(\s*(?:<[^<>]{0,500}>|[^()\s]*(?:\([^()\s]*\)[^()\s]*)*)(?:\s+(?:\"[^\"]*\"|'[^']*'))?\s*\)"
_LINK = re.compile(rf"!?\[(?!\d{{1,2}}\])([^\[\]]*)\](?:{_TARGET}|\[[^\[\]]*\])")
_LINK_DEFINITION = re.compile(r"^\s*\[[^\[\]]{1,80}\]:\s*<?(?:https?|ftp|mailto):.*$", re.MULTILINE)
_CITATION = re.compile(r"\s?(?:\[\d{1,2}(?:\s?[,–-]\s?\d{1,2})*\]|\[\^[^\[\]]{0,80}\]:?|【[^【】]{0,80}】)")
# Bounded, here and below: a server could send text with pathological matching time.
_TAG = re.compile(
    r"<!--.{0,500}?-->|<(?:script|style)\b.{0,2000}?</(?:script|style)>|</?[a-zA-Z][^<>]*>", re.DOTALL | re.IGNORECASE
)
_ADDRESS = re.compile(r"<?(?:https?|ftp)://[^\s<>)]+>?|\bwww\.[^\s<>)]+")
_ESCAPED = re.compile(r"\\([\\`*_{}\[\]()#+.!|~<>-])")
_EMPHASIS = re.compile(r"(?<![\w*_~])(\*{1,3}|_{1,3}|~~)(?=\S)(.{1,300}?)(?<=\S)\1(?![\w*_~])")
_SIGNS = re.compile(r"[*`~|\\]+|(?<!\w)[_#]+(?!\d)|(?<=\w)_+(?!\w)")
_PICTOGRAMS = re.compile(
    "[\U0001f000-\U0001faff\u2190-\u21ff\u2300-\u23ff\u25a0-\u27bf\u2b00-\u2bff\u203c\u2049\u2139\ufe0f\u20e3]"
)
_TIMES = re.compile(r"(?<=\d)\s?\*\s?(?=\d)")
_ENDS = ".!?…:;,"
# Formulas of LaTeX
_FRACTION = re.compile(r"\\[dt]?frac\{([^{}]{0,100})\}\{([^{}]{0,100})\}")
_STYLED = re.compile(r"\\(?:text\w*|math\w*|boxed|emph|operatorname)\{([^{}]{0,200})\}")
_COMMAND = re.compile(r"\\([a-z]+)(?![a-z])", re.IGNORECASE)
_COMMAND_SIGNS = {
    "times": "×", "cdot": "×", "div": "÷", "pm": "±", "approx": "≈", "leq": "≤", "le": "≤", "geq": "≥", "ge": "≥",
    "neq": "≠", "circ": "°", "degree": "°", "pi": "π", "left": "", "right": "", "quad": " ",
}  # fmt: skip
_DELIMITER = re.compile(r"\\[()\[\]]|\$\$")
_INLINE = re.compile(r"(?<![\w$])\$(?=\S)([^$\n]{1,200}?)(?<=\S)\$(?![\w$])")
_POWER = re.compile(r"(?<=\w)\^\{?([\d°]{1,3})\}?")
_POWERS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")
_LINE_END_AS_TEXT = re.compile(r"\\[nr](?![a-z])")
# Models that were shown a transcript begin their answer like one, or quote it.
_SPEAKER = re.compile(
    r"^(?:\d{1,2}[.)]\s+(?=[\"“„«]))?(?:(?:robot|reply|answer|response|assistant|guide)\s*\d?\s*:\s*)*", re.IGNORECASE
)
_NEXT_TURN = re.compile(r"\s*[#*]*\s*(?:human|user|instruction)\s*:", re.IGNORECASE)
_QUOTED = re.compile(r"\"([^\"]+)\"|“([^“”]+)”|„([^„“”]+)[“”]|«([^«»]+)»|'([^']+)'")
LONGEST_WRITTEN = 20_000
"""Characters; nobody listens for as long as that takes."""


def spoken(written: str) -> str:
    """One line of text, list items as sentences; empty if nothing is speakable."""
    part = SpokenPart()
    text = "".join((*part.process(html.unescape(written[:LONGEST_WRITTEN])), *part.end(whole=True)))
    text = _without_links(_LINE_END_AS_TEXT.sub("\n", _without_formulas(_FENCE.sub("", _CALL_FENCE.sub("", text)))))
    lines = text.splitlines()
    # Some models go on with the next turn.
    others = next((number for number, line in enumerate(lines) if number and _NEXT_TURN.match(line)), None)
    lines = lines[:others]
    leads = [_LEADS, _NUMBERED] if sum(_NUMBERED.match(line) is not None for line in lines) > 1 else [_LEADS]
    lines = [spoken_line for line in lines if (spoken_line := _line(line, leads))]
    # List items need sentence ends to be audible as a list.
    ended = [line if line[-1] in _ENDS or line is lines[-1] else f"{line}." for line in lines]
    said = _SPEAKER.sub("", " ".join(ended))
    quoted = _QUOTED.fullmatch(said)
    return said[1:-1] if quoted else said


def _without_formulas(text: str) -> str:
    for _ in range(2):  # nested
        text = _STYLED.sub(r"\1", _FRACTION.sub(r"\1/\2", text))
    text = _DELIMITER.sub("", _INLINE.sub(r"\1", text))
    text = _COMMAND.sub(lambda command: _COMMAND_SIGNS.get(command[1], command[0]), text)
    return _POWER.sub(lambda power: power[1].translate(_POWERS), text)


def _without_links(text: str) -> str:
    text = _CITATION.sub("", _LINK.sub(r"\1", _LINK_DEFINITION.sub("", text)))
    return _TAG.sub(" ", _ADDRESS.sub(" ", text))


def _line(line: str, leads: Iterable[re.Pattern[str]]) -> str:
    for lead in leads:
        line = lead.sub("", line)
    line = _TIMES.sub(" × ", line)
    for _ in range(3):  # nested bold, italics, strike-through
        line = _EMPHASIS.sub(r"\2", line)
    line = _PICTOGRAMS.sub(" ", _SIGNS.sub(" ", _ESCAPED.sub(r"\1", line)))
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
