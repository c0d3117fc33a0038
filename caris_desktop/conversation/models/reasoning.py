"""Removal of reasoning and template tokens from an answer.

Servers pass reasoning on as text if they do not know the model's markers: tags, as of DeepSeek, Qwen, Magistral, Kimi
and Command, or channels, as of gpt-oss (https://cookbook.openai.com/articles/openai-harmony).
"""

import re

_TAGS = "thinking|think|thoughts?|reasoning|reflection|analysis|scratchpad|seed:think"
_MARK = re.compile(
    rf"<(?P<end>/?)(?:{_TAGS})(?:\s[^<>]{{0,80}})?>|\[(?P<end_2>/?)THINK\]|◁(?P<end_3>/?)think▷"
    r"|<[|｜](?P<name>[^|｜<>\s]{1,40})[|｜]>|(?P<over></s>|<end_of_turn>)|(?P<line><start_of_turn>)|<s>",
    re.IGNORECASE,
)
# Possible beginning of a marker that continues in the next piece.
_BEGUN = re.compile(
    rf"(?:<(?:[|｜/]?[^|｜<>\s]{{0,40}}[|｜]?|/?(?:{_TAGS})\s[^<>]{{0,80}})|\[/?T?H?I?N?K?|◁/?t?h?i?n?k?)$",
    re.IGNORECASE,
)
_ENDS_TURN = re.compile(
    r"im_end|eot_id|eom_id|end_?of_?text|endoftext|end▁of▁sentence|return|END_OF_TURN_TOKEN", re.IGNORECASE
)


class Withdrawn(str):
    """Marks all previous pieces as reasoning, whose beginning was not marked."""

    __slots__ = ()


class SpokenPart:
    """Incremental filter that returns the visible part of one answer.

    ``within``: the answer begins within reasoning, as with templates that open it.
    """

    def __init__(self, *, within: bool = False) -> None:
        self.reasoned = False
        self.begins_within = within
        self._pending = ""
        self._hides = within  # the open channel or tag is hidden
        self._header: list[str] | None = None  # header of a channel or turn, as far as received
        self._header_is_line = False
        self._assumed: list[str] = []  # hidden only because earlier answers began within reasoning
        self._over = False
        self._began = False

    def process(self, piece: str) -> list[str]:
        """Visible text of a piece; a Withdrawn in it voids earlier text."""
        self._pending += piece
        given: list[str] = []
        at = 0
        for mark in _MARK.finditer(self._pending):
            self._give(self._pending[at : mark.start()], given)
            self._read(mark, given)
            at = mark.end()
        rest = self._pending[at:]
        begun = _BEGUN.search(rest)
        cut = begun.start() if begun is not None else len(rest)
        self._give(rest[:cut], given)
        self._pending = rest[cut:]
        return given

    def end(self, *, whole: bool) -> list[str]:
        """Visible rest. ``whole``: the model ended normally, so that text not marked as reasoning is visible."""
        given: list[str] = []
        self._give(self._pending, given)
        self._pending = ""
        if whole and self._assumed and self._hides:
            given.append("".join(self._assumed).lstrip())
        return [text for text in given if text]

    def _give(self, text: str, given: list[str]) -> None:
        if not text or self._over:
            return
        if self._header is not None and self._header_is_line and "\n" in text:
            self._header = None
            text = text.partition("\n")[2]
        if self._header is not None:
            self._header.append(text)
        elif self._hides:
            self.reasoned = True
            if self.begins_within:
                self._assumed.append(text)
        else:
            # Text before the first word followed the reasoning.
            text = text if self._began else text.lstrip()
            if text:
                self._began = True
                given.append(text)

    def _read(self, mark: re.Match[str], given: list[str]) -> None:
        name = mark["name"]
        if mark["over"] or (name and _ENDS_TURN.fullmatch(name)):
            self._over = self._over or self._began
        elif mark["line"]:
            self._header, self._header_is_line = [], True
        elif name:
            self._read_token(name.lower())
        elif any(mark[end] is not None for end in ("end", "end_2", "end_3")):
            self._tag(opens=not (mark["end"] or mark["end_2"] or mark["end_3"]), given=given)

    def _tag(self, *, opens: bool, given: list[str]) -> None:
        if not opens and not self._hides:
            self.begins_within = self.reasoned = True
            self._began = False
            given.clear()
            given.append(Withdrawn())
        self._hides = opens
        self._assumed.clear()

    def _read_token(self, name: str) -> None:
        if name in ("start", "channel", "start_header_id", "im_start"):
            self._header, self._header_is_line = [], name == "im_start"
        elif name in ("message", "end_header_id"):
            channel = "".join(self._header or ()).strip().lower()
            self._hides = name == "message" and channel.startswith(("analysis", "commentary", "thought"))
            self._header = None
        elif name == "end":
            self._hides, self._header = False, None
        elif "think" in name or "thought" in name:
            self._hides = name.startswith(("start", "begin"))
