"""Removal of reasoning and template tokens from an answer.

Servers pass reasoning on as text if they do not know the model's markers: tags, as of DeepSeek, Qwen, Magistral, Kimi
and Command, or channels, as of gpt-oss (https://cookbook.openai.com/articles/openai-harmony) and Gemma 4. Calls of
tools and turns that a model adds are removed, too.
"""

import re

_TAGS = (
    r"[\w:-]{0,20}(?:think|thought|reason|monologue|scratch_?pad|cot_)[\w:-]{0,20}"
    r"|reflection|analysis|cot|rationale|deliberation"
)
# Written as text where the server does not know the model's calls, or what its template tells the model.
_CALLS = (
    r"[\w:-]{0,20}(?:tool|function)_?(?:calls?|code|use|outputs?|results?|responses?)|[\w:-]{0,20}_tool|tools|invoke"
    r"|functions?(?:=[\w.:-]{1,80})?|system-reminder"
)
_DSML = r"[|｜]DSML[|｜][^<>]{0,120}"
_MARK = re.compile(
    rf"<(?P<end>/?)(?:{_TAGS})(?:\s[^<>]{{0,80}})?>|\[(?P<end_2>/?)THINK\]|◁(?P<end_3>/?)think▷"
    r"|<(?P<end_4>)\|channel>|<channel(?P<end_5>\|)>|<(?P<end_6>)(?:unused|ctrl)94>|<(?:unused|ctrl)9(?P<end_7>5)>"
    rf"|(?P<aside><(?:(?:{_CALLS})(?:\s[^<>]{{0,120}})?|{_DSML})>|<details type=\"reasoning\"[^<>]{{0,80}}>"
    r"|\[TOOL_CALLS\])"
    rf"|(?P<aside_end></(?:{_CALLS}|details|{_DSML})>)"
    r"|<[|｜](?P<name>[^|｜<>\s]{1,40})[|｜]>|(?P<over></s>|<end_of_turn>|<turn\|>|\[INST\])"
    r"|(?P<line><start_of_turn>|<\|turn>)|<s>|\[/INST\]",
    re.IGNORECASE,
)
_ENDS = tuple(name for name in _MARK.groupindex if re.fullmatch(r"end(_\d)?", name))
# Possible beginning of a marker that continues in the next piece.
_BEGUN = re.compile(
    rf"(?:<(?:[|｜/]?[^|｜<>\s]{{0,40}}[|｜]?|/?(?:{_TAGS}|{_CALLS}|details)\s[^<>]{{0,120}}|/?{_DSML}|/[|｜]\w{{0,4}})"
    r"|\[/?[A-Z_]{0,10}|◁/?t?h?i?n?k?)$",
    re.IGNORECASE,
)
_ENDS_TURN = re.compile(
    r"im_end|eot_id|eom_id|end_?of_?text|endoftext|end▁of▁sentence|return|END_OF_TURN_TOKEN|user|system|observation",
    re.IGNORECASE,
)
# Channels of gpt-oss from a server that drops their tokens and leaves their names in the text.
_BARE_CHANNEL = re.compile(r"\s*(?:assistant)?(?:analysis|commentary)(?=[^\W\d_a-z]|[\"'])")
_BARE_CHANNELS = ("analysis", "commentary", "assistantanalysis", "assistantcommentary")
_BARE_CHANNEL_WITHIN = 40  # characters
_BARE_FINAL = "assistantfinal"


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
        self._lead: str | None = ""  # beginning of the answer
        self._held = ""  # end of it that may name a bare channel
        self._bare: str | None = None  # end of a bare channel's text

    def process(self, piece: str) -> list[str]:
        """Visible text of a piece; a Withdrawn in it voids earlier text."""
        given: list[str] = []
        self._pending += self._without_bare_channels(piece, given)
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
        self._give(self._pending + self._held, given)
        self._pending = self._held = ""
        if whole and self._assumed and self._hides:
            given.append("".join(self._assumed).lstrip())
        return [text for text in given if text]

    def _without_bare_channels(self, piece: str, given: list[str]) -> str:
        if self._lead is not None:
            self._lead += piece
            if named := _BARE_CHANNEL.match(self._lead):
                if self._began or self._pending:
                    self.begins_within = True
                    given.append(Withdrawn())
                piece, self._bare = self._lead[named.end() :], ""
                self._lead, self._held, self._pending, self._assumed = None, "", "", []
                self._hides, self._began, self.reasoned = False, False, True
            elif self._lead.strip() in _BARE_CHANNELS:
                self._held += piece
                return ""
            else:
                piece, self._held = self._held + piece, ""
                if len(self._lead) > _BARE_CHANNEL_WITHIN:
                    self._lead = None
        if self._bare is None:
            return piece
        _, final, answer = (self._bare + piece).partition(_BARE_FINAL)
        self._bare = None if final else (self._bare + piece)[-len(_BARE_FINAL) :]
        return answer

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
        name = (mark["name"] or "").lower()
        next_turn = mark["line"] or name in ("im_start", "start_header_id")
        if mark["over"] or _ENDS_TURN.fullmatch(name) or (next_turn and not self._hides):
            self._over = self._over or self._began
        if mark["line"]:
            self._header, self._header_is_line = [], True
        elif mark["aside"] or mark["aside_end"]:
            self._hides = bool(mark["aside"])
        elif name:
            self._read_token(name)
        elif (end := next((mark[end] for end in _ENDS if mark[end] is not None), None)) is not None:
            self._tag(opens=not end, given=given)

    def _tag(self, *, opens: bool, given: list[str]) -> None:
        if not opens and not self._hides:
            self.begins_within = self.reasoned = True
            self._began = False
            given.clear()
            given.append(Withdrawn())
        self._hides = opens
        self._assumed.clear()

    def _read_token(self, name: str) -> None:
        if name in ("start", "channel", "start_header_id", "im_start", "begin"):
            self._header, self._header_is_line = [], name == "im_start"
        elif name in ("message", "end_header_id", "content"):
            channel = "".join(self._header or ()).strip().lower()
            self._hides = name == "message" and channel.startswith(("analysis", "commentary", "thought"))
            self._header = None
        elif name == "end":
            self._over = self._over or (self._began and not self._hides)
            self._hides, self._header = False, None
        elif "tool" in name or name.startswith("action_") or name in ("python_tag", "plugin", "interpreter"):
            self._hides = not (name.startswith("/") or "end" in name)
        elif "think" in name or "thought" in name or name.startswith("inner_"):
            self._hides, self._header = not re.search(r"/|end|suffix", name), None
