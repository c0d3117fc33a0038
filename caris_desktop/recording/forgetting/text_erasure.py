"""Texts that name a person, or that the person said: search terms, places for review, and redaction."""

import base64
import hashlib
import html
import json
import re
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import field, replace
from functools import cache, cached_property, partial
from html.entities import codepoint2name
from itertools import product
from pathlib import Path
from typing import Any, Literal, get_args
from urllib.parse import quote

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.schema_fields import literals_of
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.forgetting.person_tracks import PersonTracks, fields_of, messages_of
from caris_desktop.recording.photo_file import PhotoFileError, texts_of, with_texts
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.session_conversation import UTTERANCE_STREAMS, SpokenUtterance
from caris_desktop.recording.session.session_data import spoken
from caris_desktop.recording.session.session_reader import Session

FORGOTTEN, FORGOTTEN_IN_YAML = "[forgotten]", "(forgotten)"
"""Replacements for a name. In YAML, a bracket at the start of a value has a meaning."""
AS_IT_IS = {"utf-8": "surrogateescape", "utf-16-le": "surrogatepass", "utf-16-be": "surrogatepass"}
"""Encodings of text files, with the error handlers that preserve all other bytes."""
_LEAST_PART = 3
# Names this long are matched inside longer words too, such as file names; shorter ones are often part of other words.
_DISTINCT = 8
# Word boundaries in a text as stored in a file: "\nAnna", "\u201cAnna" and "%20Anna" begin there too.
_WORD = (
    r"(?:(?<!{letter})|(?<=\\[nrtbf])|(?<=\\u[0-9a-fA-F]{{4}})|(?<=%[0-9a-fA-F]{{2}}))"
    r"(?:{forms})(?=(?:['’]?s)?(?!{letter}))"
)
# Digits are beside a name, as in "anna2.wav", if no code in hexadecimal digits can look like it.
_BESIDE_DIGITS = re.compile(r"(?=.{4})(?![a-f]*$)\D*", re.IGNORECASE)
_BETWEEN = r"(?:\s|\\[nrt]|%20|&nbsp;|&#160;|[+_.-])+"
# From here on, scripts have no spaces between words, so that nothing marks where a name begins.
_WITHOUT_SPACES = "\u0e00"
# Encodings of text files on Windows, older Macs, DOS (ZIP archives) and Unix, for example of tables of a spreadsheet.
_CODE_PAGES = (
    "cp1250", "cp1251", "cp1252", "cp1253", "cp1254", "cp1255", "cp1256", "cp1257", "cp1258", "cp874", "gbk", "cp932",
    "cp949", "big5", "euc_jp", "iso8859_2", "iso8859_5", "koi8_r", "mac_roman", "mac_latin2", "mac_cyrillic", "cp437",
    "cp850", "cp852", "cp866",
)  # fmt: skip
# How a letter beyond ASCII is written in HTML and RTF, and its bytes in e-mail, addresses, RTF, Python and Git.
_LETTERS: tuple[Callable[[str], str], ...] = (
    lambda letter: f"&{codepoint2name.get(ord(letter), '')};",
    lambda letter: f"&#x{ord(letter):x};",
    lambda letter: f"\\u{ord(letter)}?",
)
_BYTES = ("={:02x}", "%{:02x}", "\\'{:02x}", "\\x{:02x}", "\\{:03o}")
# Accents in LaTeX
_ACCENTS = dict(zip("\u0300\u0301\u0302\u0303\u0308\u0327\u0328\u030a\u030b\u030c", "`'^~\"ckrHv", strict=True))
_ACCENTED = ("\\{0}{1}", "\\{0}{{{1}}}", "{{\\{0}{1}}}", "{{\\{0}{{{1}}}}}")
# Letters that are not a letter with an accent, and how German and Nordic names are written without such keys.
_PLAIN_LETTERS = str.maketrans("øłđðı", "olddi") | str.maketrans({"ß": "ss", "æ": "ae", "œ": "oe"})
_TWO_LETTERS = str.maketrans({"ä": "ae", "ö": "oe", "ø": "oe", "ü": "ue", "å": "aa"})
# Checksums and base64 contain no names; paths have letters and slashes too, but shorter runs.
_CODES = ((re.compile(r"[A-Za-z0-9]*"), 32), (re.compile(r"[A-Za-z0-9+/=]*"), 250))
# Identifiers of several words, and what follows one that is a key: of JSON, or of a number in YAML and settings.
_IDENTIFIER = re.compile(r"[a-z][a-z0-9]*(?:_[a-z0-9]+)+")
_AFTER_KEY = re.compile(r'\\*"[ \t]*:|[ \t]*[:=][ \t]*-?\.?\d')
_FIELD = re.compile(r'"([a-z][a-z0-9_]*)\\*":\s*\\*"$')
_LONGEST_IDENTIFIER = 64
_PROBE_BYTES, _PROBES = 24, 6
_JPEG_SCAN = b"\xff\xda"


class ErasureStoppedError(UserFacingError):
    """Interrupted erasure; no data is lost, and the same command resumes it."""


@dataclass(frozen=True)
class PersonNames:
    """Names of one person. Parts of a compound name are matched too, since people are called by them."""

    names: tuple[str, ...]

    @cached_property
    def alternatives(self) -> tuple[str, ...]:
        """Names to search for, longest first."""
        found: dict[str, None] = {}
        for name in self.names:
            full_name = " ".join(name.split())
            parts = re.split(r"[\s\-.]+", full_name)
            # Of "Participant 7", the word alone is anybody's.
            if any(part.isdecimal() for part in parts):
                parts = []
            parts = [part for part in parts if len(part) >= _LEAST_PART and not _is_common(part)]
            for text in (full_name, *parts):
                if len(text) >= 2:
                    found.update(dict.fromkeys(_spellings(text)))
        return tuple(sorted(found, key=len, reverse=True))

    @cached_property
    def pattern(self) -> re.Pattern[str] | None:
        """Pattern for any kind of text file: plain, JSON, XML, URL. None without names."""
        patterns = []
        for text in self.alternatives:
            forms = [_BETWEEN.join(re.escape(part) for part in form.split()) for form in _forms(text)]
            either = "|".join(dict.fromkeys(forms))
            letter = r"[^\W\d_]" if _BESIDE_DIGITS.fullmatch(text) else r"[^\W_]"
            anywhere = rf"(?:{either})(?!\d)" if text[-1].isdecimal() else f"(?:{either})"
            patterns.append(anywhere if _is_distinct(text) else _WORD.format(letter=letter, forms=either))
        return re.compile("|".join(patterns), re.IGNORECASE) if patterns else None

    def spans(self, text: str) -> Iterator[tuple[int, int]]:
        """Positions of the person's names in ``text``."""
        if self.pattern is None:
            return
        # Most texts contain no name: this check is fast.
        small = text.lower()
        if not any(first in small for first in self._firsts):
            return
        for match in self.pattern.finditer(text):
            if not _is_of_program(text, *match.span()) and (
                _is_distinct(match[0]) or not _in_code(text, *match.span())
            ):
                yield match.span()

    @cached_property
    def _firsts(self) -> tuple[str, ...]:
        """What a text with a name contains, in lower case: letters that all its forms share, else their first words."""
        found: dict[str, None] = {}
        for text in self.alternatives:
            shared = max(re.findall(r"[a-z]+", text.split()[0].lower()), key=len, default="")
            forms = [shared] if len(shared) >= _LEAST_PART else [form.lower().split()[0] for form in _forms(text)]
            found.update(dict.fromkeys(forms))
        return tuple(found)

    @cached_property
    def beginnings(self) -> tuple[tuple[bytes, str], ...]:
        """Beginning of each form in a file, in lower-case ASCII, with its encoding."""
        found: dict[tuple[bytes, str], None] = {}
        for text in self.alternatives:
            for form in _forms(text):
                first = re.split(r"\s", form)[0]
                for cased in (first, first.lower(), first.upper(), first.title()):
                    for encoding, errors in AS_IT_IS.items():
                        found.setdefault((folded(cased.encode(encoding, errors)), encoding))
        return tuple(found)


@dataclass(frozen=True)
class SearchTerms:
    """All search terms. ``pictures`` are unique bytes: stored portraits and vectors."""

    words: PersonNames
    pictures: tuple[bytes, ...] = field(default=(), repr=False)

    @cached_property
    def probes(self) -> tuple[bytes, ...]:
        """Pieces of the images, plain and in base64 at each of its three alignments."""
        plain = [probe for picture in self.pictures for probe in _pieces(picture)]
        cuts = [probe[shift : shift + (len(probe) - shift) // 3 * 3] for probe in plain for shift in range(3)]
        return tuple(dict.fromkeys((*plain, *(base64.b64encode(cut) for cut in cuts if len(cut) >= 9))))


_FOLD = bytes(byte + 32 if 65 <= byte <= 90 else byte for byte in range(256))


def folded(data: bytes) -> bytes:
    """``data`` with ASCII letters in lower case."""
    return data.translate(_FOLD)


def _forms(text: str) -> tuple[str, ...]:
    """The text, and its escaped forms in different file types."""
    composed, decomposed = unicodedata.normalize("NFC", text), unicodedata.normalize("NFD", text)
    forms = [composed, decomposed]
    for plain in (composed, decomposed):
        forms += [
            json.dumps(plain)[1:-1],
            html.escape(plain),
            html.escape(plain, quote=False),
            plain.encode("ascii", "xmlcharrefreplace").decode(),
            quote(plain, safe=" "),
        ]
    if not text.isascii():
        for cased, code_page in product((composed, composed.lower(), composed.upper()), _CODE_PAGES):
            with suppress(UnicodeEncodeError):  # the code page lacks a letter
                forms.append(cased.encode(code_page).decode("utf-8", AS_IT_IS["utf-8"]))
        for cased in (composed, composed.lower(), composed.upper()):
            forms += _escaped(cased)
    return tuple(dict.fromkeys(forms))


def _escaped(text: str) -> Iterator[str]:
    """``text`` as written in files that hold only ASCII, and as UTF-8 that was read as Latin-1."""

    def each(change: Callable[[str], str]) -> str:
        return "".join(letter if letter.isascii() else change(letter) for letter in text)

    yield from map(each, _LETTERS)
    for style, encoding in product(_BYTES, ("utf-8", "cp1252")):
        with suppress(UnicodeEncodeError):
            yield each(lambda letter: "".join(map(style.format, letter.encode(encoding))))  # noqa: B023 - called here
    decomposed = re.compile(f"(.)([{''.join(_ACCENTS)}])")
    for style in _ACCENTED:
        yield decomposed.sub(lambda both: style.format(_ACCENTS[both[2]], both[1]), unicodedata.normalize("NFD", text))  # noqa: B023 - likewise
    yield text.encode().decode("latin-1")


def _is_distinct(text: str) -> bool:
    return len(text) >= _DISTINCT or text[0] >= _WITHOUT_SPACES


def _spellings(text: str) -> Iterator[str]:
    """``text``, and as typed without such keys or written by a recogniser."""
    for written in dict.fromkeys((text, text.replace("'", "’"), text.replace("’", "'"))):
        composed = unicodedata.normalize("NFC", written)
        yield composed
        yield _without_accents(composed)
        yield _without_accents(composed.lower().translate(_TWO_LETTERS))


def _without_accents(text: str) -> str:
    plain = "".join(letter for letter in unicodedata.normalize("NFKD", text) if not unicodedata.combining(letter))
    return unicodedata.normalize("NFC", plain.lower().translate(_PLAIN_LETTERS))


def _in_code(text: str, start: int, end: int) -> bool:
    """True inside something like a checksum: a long run of letters and digits."""
    for letters, longest in _CODES:
        after = letters.match(text, end)
        right = after.end() if after is not None else end
        left = start
        while left > max(0, start - longest) and letters.fullmatch(text, left - 1, left):
            left -= 1
        if right - left >= longest and any(letter.isdigit() for letter in text[left:right]):
            return True
    return False


def _is_of_program(text: str, start: int, end: int) -> bool:
    """True for a word of the program, as in the key ``range_max_m`` or the value ``"kind": "mark"``, that a person may
    be called too.
    """
    begin = max(0, start - _LONGEST_IDENTIFIER)
    around = text[begin : end + _LONGEST_IDENTIFIER]
    for word in _IDENTIFIER.finditer(around):
        if word.start() <= start - begin and end - begin <= word.end():
            return word[0] in _fields() or _AFTER_KEY.match(around, word.end()) is not None
    field = _FIELD.search(text[begin:start])
    if field is not None and text[start:end] in _fields().get(field[1], ()):
        return True
    is_key = text[begin:start].endswith('"') and _AFTER_KEY.match(text, end) is not None
    return is_key and _is_common(text[start:end])


def _is_common(part: str) -> bool:
    """True for a long word of the program, such as "participant", which is searched for within words, too."""
    return len(part) >= _DISTINCT and any(part.lower() in (name, *words) for name, words in _fields().items())


@cache
def _fields() -> Mapping[str, frozenset[str]]:
    """Fields of recorded values, with the words of the program that they may have."""
    found: dict[str, frozenset[str]] = {}
    kinds: Iterable[Any] = BY_TYPE
    for kind in kinds:
        for name, words in literals_of(kind).items():
            found[name] = found.get(name, frozenset()) | words
    return found


def _pieces(picture: bytes) -> Iterator[bytes]:
    """Distinctive pieces of an image: images of one program share their headers."""
    begin = picture.rfind(_JPEG_SCAN, 0, 4096) + 16 if picture[:2] == b"\xff\xd8" else 0
    content = picture[begin:]
    if len(content) < _PROBE_BYTES:
        content = picture
    count = min(_PROBES, max(1, len(content) // _PROBE_BYTES))
    step = max(1, (len(content) - _PROBE_BYTES) // max(1, count - 1)) if count > 1 else 1
    for number in range(count):
        piece = content[number * step : number * step + _PROBE_BYTES]
        if len(piece) >= 8 and len(set(piece)) >= 6:
            yield piece


def all_of(names: Iterable[str], pictures: Iterable[bytes]) -> SearchTerms:
    return SearchTerms(PersonNames(tuple(dict.fromkeys(name for name in names if name.strip()))), tuple(pictures))


AROUND_VISIT_NS = 2_000_000_000
"""Somebody speaks before a camera sees them, and after."""
_TOPICS = tuple(f"/{name}" for name in (*UTTERANCE_STREAMS, "hearing"))
_WORDS = ("text", "message", "heard_text", "detail", "committed", "tentative")
_UTTERANCE = re.compile(r'"utterance_id":\s*("(?:[^"\\]|\\.)*")')
# Sentences this long are distinctive; shorter ones match only as a whole value, line or cell.
_LONG, _LONG_WORDS = 12, 3


@dataclass(frozen=True)
class Sentences:
    """A person's sentences, to be found in any text."""

    texts: tuple[str, ...] = ()

    @property
    def long(self) -> tuple[str, ...]:
        return tuple(text for text in self.texts if len(text) >= _LONG and len(text.split()) >= _LONG_WORDS)

    @cached_property
    def _pattern(self) -> re.Pattern[str] | None:
        patterns = []
        for text in sorted(self.texts, key=len, reverse=True):
            for form in dict.fromkeys((text, json.dumps(text)[1:-1], json.dumps(text, ensure_ascii=False)[1:-1])):
                plain = r"\s+".join(map(re.escape, form.split()))
                patterns.append(
                    plain if text in self.long else rf'(?:^|(?<=[",\t;])|(?<=: )){plain}(?=["\t,;\r\n]|  \[|\]|$)'
                )
        return re.compile("|".join(patterns), re.MULTILINE) if patterns else None

    @cached_property
    def _firsts(self) -> tuple[str, ...]:
        """First words of each sentence, plain and JSON-escaped: a fast check that excludes most texts."""
        forms = (form for text in self.texts for form in (text, json.dumps(text)[1:-1]))
        return tuple({form.split()[0] for form in forms})

    def spans(self, text: str) -> Iterator[tuple[int, int]]:
        """Positions of the sentences."""
        if self._pattern is not None and any(first in text for first in self._firsts):
            yield from (match.span() for match in self._pattern.finditer(text))

    @property
    def probes(self) -> tuple[bytes, ...]:
        """Byte patterns for a file search."""
        forms = (form for text in self.long for form in (text, json.dumps(text)[1:-1]))
        return tuple(dict.fromkeys(form.encode("utf-8", "replace") for form in forms))


@dataclass(frozen=True)
class Speech:
    """Utterances of one session: ids of the person's own, ``doubtful`` ones of unknown speakers during their presence,
    and ``others`` of known other speakers.
    """

    theirs: frozenset[str] = frozenset()
    doubtful: tuple[SpokenUtterance, ...] = ()
    others: tuple[SpokenUtterance, ...] = ()


def speech_in(session: Session, person_ids: frozenset[str], tracks: PersonTracks) -> Speech:
    """Utterances of the session by speaker. Raises SessionError."""
    heard = [utterance for utterance in spoken(session) if utterance.speaker in ("participant", "")]
    return Speech(
        frozenset(one.utterance_id for one in heard if one.person_id in person_ids),
        tuple(one for one in heard if not one.person_id and one.text != FORGOTTEN and _is_during(one, tracks)),
        tuple(one for one in heard if one.person_id and one.person_id not in person_ids),
    )


def _is_during(utterance: SpokenUtterance, tracks: PersonTracks) -> bool:
    moments = [at for at in (utterance.start_ns, utterance.end_ns, utterance.requested_ns) if at is not None]
    return bool(moments) and any(
        min(moments) <= until_ns + AROUND_VISIT_NS and max(moments) >= from_ns - AROUND_VISIT_NS
        for from_ns, until_ns in tracks.visits_ns
    )


def sentences_of(session: Session, utterance_ids: Iterable[str]) -> Sentences:
    """All recorded texts of these utterances: partial, final and corrected.

    Raises OSError.
    """
    ids = frozenset(utterance_ids)
    found: dict[str, None] = {}
    for _, data in messages_of(session.folder / "events.mcap", lambda topic: topic.startswith(_TOPICS)):
        message = _read(data.decode("utf-8", "replace"), ids)
        for text in (message.get(key) for key in _WORDS if key not in ("message", "detail")):
            if isinstance(text, str) and text.strip() and text != FORGOTTEN:
                found.setdefault(" ".join(text.split()))
    return Sentences(tuple(found))


def without_words(message: str, utterance_ids: frozenset[str]) -> tuple[str, int]:
    """Recorded message without the texts of these utterances, and the number of changed texts."""
    fields = _read(message, utterance_ids)
    words = [key for key in _WORDS if isinstance(fields.get(key), str) and fields[key] not in ("", FORGOTTEN)]
    if not words:
        return message, 0
    return json.dumps(fields | dict.fromkeys(words, FORGOTTEN), separators=(",", ":")), 1


def _read(message: str, utterance_ids: frozenset[str]) -> dict[str, Any]:
    """Parsed message; empty if it is about another utterance."""
    named = _UTTERANCE.search(message)
    if named is None or json.loads(named[1]) not in utterance_ids:
        return {}
    return fields_of(message)


Decision = Literal["redact", "keep", "remove", ""]
"""Decision about a place; ``remove`` is for whole files. Empty: undecided."""
_AROUND, _TEXT_ENDS = 48, re.compile(r'[\n\r]|(?<!\\)"')
_STAMP = re.compile(r'"stamp_ns":\s*(-?\d+)')
_CHECKSUM = re.compile(r'"sha256":\s*"([0-9a-f]{64})"')
_YAML = (".yaml", ".yml")
# Keys of events that contain YAML texts of scenarios and profiles.
_YAML_INSIDE = ('"sha256":', '"profile":')
_BINARY_LOOK_BYTES = 8192


class Passage(Value):
    """Possible mention of the person: the name as written, with the text around it.

    Places with the same text in one file are merged, with their ``count``. ``where`` is a line, or a session time.
    ``kind`` limits the decisions: texts can be redacted, other files only removed or left as is. ``unexamined`` files
    may show or contain the person, which only a human can decide. ``speech`` was said by an unknown speaker during
    their presence.
    """

    key: str
    file: str
    where: str
    before: str
    name: str
    behind: str
    kind: Literal["text", "file", "file name", "unexamined", "speech"] = "text"
    count: int = 1


@dataclass(slots=True)
class TextWork:
    """Texts of one erasure. ``decisions`` are by key of place; ``otherwise`` applies to places without one.

    ``utterances`` and ``sentences`` are the person's speech, removed wherever it is found.
    """

    words: PersonNames
    decisions: Mapping[str, Decision]
    otherwise: Decision
    places: dict[str, Passage] = field(default_factory=dict)
    sentences: Sentences = Sentences()
    utterances: frozenset[str] = frozenset()

    def decided(self, place: Passage) -> Decision:
        """Decision on a place. Redaction does not apply to whole files, nor the default to unexamined ones."""
        decision = self.decisions.get(place.key) or ("" if place.kind == "unexamined" else self.otherwise)
        return "" if place.kind in ("file", "unexamined") and decision == "redact" else decision

    def open_places(self) -> list[Passage]:
        """Places without a decision."""
        return [place for place in self.places.values() if not self.decided(place)]

    def retains_name(self, file: str) -> bool:
        """True if a decision keeps the person's name in a file."""
        return any(place.file == file and self.decided(place) == "keep" for place in self.places.values())

    def find(self, text: str, file: str, where: Callable[[], str]) -> list[tuple[int, int, Decision]]:
        """Matches in a text, each with its decision."""
        spoken = list(self.sentences.spans(text))
        found: list[tuple[int, int, Decision]] = [(start, end, "redact") for start, end in spoken]
        for start, end in self.words.spans(text):
            if any(from_ <= start and end <= until for from_, until in spoken):
                continue
            # in the same line and JSON value
            before = _TEXT_ENDS.split(text[max(0, start - _AROUND) : start])[-1]
            behind = _TEXT_ENDS.split(text[end : end + _AROUND])[0]
            key = _key(file, before, text[start:end], behind)
            known = self.places.get(key) or Passage(key, file, where(), before, text[start:end], behind, count=0)
            found.append((start, end, self._noted(replace(known, count=known.count + 1))))
        return sorted(found)

    def note_file(self, file: str, words: str, *, count: int = 1) -> Decision:
        """Note a file with the person that can only be removed or left as is."""
        return self._noted(Passage(_key(file, "", "", ""), file, "in it", "", words.strip(), "", "file", count))

    def note_unexamined(self, file: str, reason: str) -> Decision:
        """Note a file without detection that may show or contain the person."""
        return self._noted(Passage(_key(file, "", "", ""), file, "in it", "", reason, "", "unexamined"))

    def note_speech(self, file: str, utterance_id: str, where: str, words: str) -> Decision:
        """Note speech of an unknown speaker during the person's presence."""
        return self._noted(Passage(_key(file, utterance_id, "", ""), file, where, "", words, "", "speech"))

    def note_name(self, file: str, name: str) -> Decision:
        """Note a file name that names the person."""
        return self._noted(Passage(_key(file, "", "name", ""), file, "its name", "", name, "", "file name"))

    def redact(self, text: str, file: str, *, yaml: bool) -> tuple[str, int]:
        """Redact names by decision, and the person's speech; return the text and the number of changes."""
        quiet = replace(self, places={})
        changed, words = without_words(text, self.utterances)
        changed, count = redacted(changed, quiet.find(changed, file, str), yaml=yaml)
        return changed, words + count

    def _noted(self, place: Passage) -> Decision:
        self.places[place.key] = place
        return self.decided(place)


def redacted(text: str, found: list[tuple[int, int, Decision]], *, yaml: bool) -> tuple[str, int]:
    """Text without the names to redact, and their number."""
    parts, at, count = [], 0, 0
    for start, end, decision in found:
        if decision == "redact" and start >= at:
            parts += [text[at:start], FORGOTTEN_IN_YAML if yaml else FORGOTTEN]
            at, count = end, count + 1
    return "".join([*parts, text[at:]]), count


# Files of text


def encoding_of(path: Path) -> str | None:
    """Encoding of a text file; None if it is not text. Raises OSError."""
    with path.open("rb") as file:
        head = file.read(_BINARY_LOOK_BYTES)
    if head.startswith(b"\xff\xfe"):
        return "utf-16-le"
    if head.startswith(b"\xfe\xff"):
        return "utf-16-be"
    return None if b"\0" in head else "utf-8"


def lines_of(path: Path, encoding: str) -> Iterator[str]:
    """Lines with their ends; undecodable bytes are preserved."""
    with path.open(encoding=encoding, errors=AS_IT_IS[encoding], newline="") as file:
        yield from file


def inspect_text(work: TextWork, path: Path, file: str, encoding: str) -> bool:
    """List the places of a file; True if anything is to be redacted. Raises OSError."""
    found: list[tuple[int, int, Decision]] = []
    for number, line in enumerate(lines_of(path, encoding), start=1):
        found += work.find(line, file, lambda number=number: f"line {number}")  # type: ignore[misc]
    return _is_to_change(found)


def rewrite_text(work: TextWork, path: Path, file: str, encoding: str, target: Path) -> int:
    """Rewrite a file redacted; return the number of changes. Raises OSError."""
    count = 0
    with target.open("w", encoding=encoding, errors=AS_IT_IS[encoding], newline="") as written:
        for line in lines_of(path, encoding):
            text, here = work.redact(line, file, yaml=path.suffix.lower() in _YAML)
            written.write(text)
            count += here
    return count


# Photos, whose tags are text


def inspect_photo(work: TextWork, path: Path, file: str) -> bool:
    """List the places in a PNG's texts; True if anything is to be redacted. Raises OSError."""
    found: list[tuple[int, int, Decision]] = []
    for name, text in _photo_texts(path).items():
        found += work.find(text, file, lambda name=name: f"its {name}")  # type: ignore[misc]
    return _is_to_change(found)


def rewrite_photo(work: TextWork, path: Path, file: str, target: Path) -> int:
    """Rewrite a photo with redacted texts; return the number of changes. Raises OSError."""
    changed = {name: work.redact(text, file, yaml=False) for name, text in _photo_texts(path).items()}
    target.write_bytes(with_texts(path.read_bytes(), {name: text for name, (text, _) in changed.items()}))
    return sum(count for _, count in changed.values())


def _photo_texts(path: Path) -> dict[str, str]:
    try:
        return texts_of(path.read_bytes())
    except PhotoFileError:
        return {}


# Event logs


@dataclass(slots=True)
class EventTexts:
    """Result for an event log: whether anything is to be redacted, and the affected utterances."""

    to_change: bool = False
    utterances: set[str] = field(default_factory=set)


def inspect_events(work: TextWork, path: Path, file: str, moment: Callable[[int], str]) -> EventTexts:
    """List the places of an MCAP file. Raises OSError."""
    found = EventTexts()
    with path.open("rb") as opened:
        index = events_file.scan(opened)

        def scan(value: bytes) -> bytes:
            spans = work.find(_text_of(value), file, lambda: "recording header")
            found.to_change |= _is_to_change(spans)
            return value

        for record in index.beside:
            changed_metadata(record, scan)
        for content in events_file.intact_blocks(opened, index):
            for message in events_file.messages_of(content):
                text = _text_of(content[message.start : message.end])
                text, words = without_words(text, work.utterances)
                found.to_change = found.to_change or words > 0
                stamp = _STAMP.search(text)
                where = partial(moment, int(stamp[1])) if stamp is not None else lambda: "somewhere"
                spans = work.find(text, file, where)
                if _is_to_change(spans):
                    found.to_change = True
                    utterance = _UTTERANCE.search(text)
                    if utterance is not None:
                        found.utterances.add(utterance[1][1:-1])
    return found


def rewrite_events(work: TextWork, path: Path, file: str, target: Path) -> int:
    """Rewrite an MCAP file redacted; unaffected chunks are copied. Raises OSError."""
    count = 0

    def change(data: bytes) -> bytes:
        nonlocal count
        text = _text_of(data)
        yaml = any(key in text for key in _YAML_INSIDE)
        changed, here = work.redact(text, file, yaml=yaml)
        count += here
        return _with_own_checksum(changed).encode("utf-8", "surrogateescape") if here else data

    with path.open("rb") as opened:
        index = events_file.scan(opened)
        beside = tuple(changed_metadata(record, change) for record in index.beside)
        with DiskFile(target) as written:
            index = replace(index, beside=beside)
            events_file.copy_changed(opened, index, written, lambda _channel, data: change(data))
            written.sync()
    return count


def _with_own_checksum(message: str) -> str:
    """Message with an updated checksum of its text: names can be guessed from the old one."""
    checksum = _CHECKSUM.search(message)
    if checksum is None:
        return message
    try:
        content = str(parse_json(message)["content"])
    except (ValueError, KeyError, TypeError):
        content = ""
    digest = hashlib.sha256(content.encode("utf-8", "replace")).hexdigest()
    return message[: checksum.start(1)] + digest + message[checksum.end(1) :]


def changed_metadata(record: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """Metadata record with changed values; other records unchanged."""
    if record[0] != events_file.METADATA:
        return record
    body = record[events_file.HEAD.size :]
    name_end = events_file.text_end(body, 0)
    entries: dict[str, str] = {}
    at = name_end + 4
    while at < len(body):
        key_end = events_file.text_end(body, at)
        value_end = events_file.text_end(body, key_end)
        value = change(body[key_end + 4 : value_end])
        entries[body[at + 4 : key_end].decode("utf-8", "replace")] = value.decode("utf-8", "replace")
        at = value_end
    return events_file.record(events_file.METADATA, body[:name_end] + events_file.text_map(entries))


def _text_of(data: bytes) -> str:
    return data.decode("utf-8", "surrogateescape")


def _is_to_change(found: list[tuple[int, int, Decision]]) -> bool:
    return any(decision == "redact" for _, _, decision in found)


def _key(file: str, before: str, name: str, behind: str) -> str:
    key = "\0".join((file, before, name, behind))
    return hashlib.sha256(key.encode("utf-8", "surrogatepass")).hexdigest()[:10]


_HEAD = """\
# Texts and files that may name or show the person to be erased. Replace each ? with a decision:
#   redact   replace the name or the utterance with [forgotten], and silence its audio
#   keep     leave it unchanged, because it does not name the person, or another person said it
#   remove   remove the whole file; for files that cannot be edited or searched
# Then run the same command again with --review THIS_FILE. This file contains the name: it is deleted when all
# decisions are made.
"""
_PERSON, _NAMES = "# person: ", "# names: "
_ESCAPED = re.compile(r"\\u([0-9a-fA-F]{4})")
_MAX_BYTES = 64 << 20
_DECISIONS = tuple(decision for decision in get_args(Decision) if decision)


class Review(Value):
    """Decisions by key of place; ``names`` are the search terms."""

    person_id: str
    names: tuple[str, ...]
    decisions: Mapping[str, Decision]


def write_review(path: Path, person_id: str, names: Iterable[str], places: Iterable[Passage]) -> None:
    """Write the review file. Raises OSError."""
    lines = [_HEAD, f"{_PERSON}{person_id}\n", f"{_NAMES}{' | '.join(names)}\n"]
    file = None
    for place in places:
        if place.file != file:
            file = place.file
            lines.append(f"\n# {_plain(file)}\n")
        often = f" ({place.count} times)" if place.count > 1 else ""
        words = f"{_plain(place.before)}»{_plain(place.name)}«{_plain(place.behind)}"
        allowed = "  [the whole file: keep or remove]" if place.kind in ("file", "unexamined") else ""
        lines.append(f"?  {place.key}  {place.where}{often}: {words}{allowed}\n")
    replace_file(path, "".join(lines).encode("utf-8", "replace"), durable=True)


def read_review(path: Path) -> Review:
    """Read the decisions. Raises ErasureStoppedError for an unreadable file or an invalid line."""
    try:
        with path.open("rb") as file:
            text = file.read(_MAX_BYTES).decode("utf-8", "replace")
    except OSError as error:
        raise ErasureStoppedError(
            localized(QT_TR_NOOP("{path} cannot be read: {why}."), path=path, why=error.strerror or error),
            QT_TR_NOOP("Nothing was changed."),
            QT_TR_NOOP("Enter the path of the list of texts again."),
        ) from error
    person_id = ""
    names: tuple[str, ...] = ()
    decisions: dict[str, Decision] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if line.startswith(_NAMES):
            names = tuple(name.strip() for name in line.removeprefix(_NAMES).split(" | ") if name.strip())
        if line.startswith(_PERSON):
            person_id = line.removeprefix(_PERSON).strip()
        words = line.split(maxsplit=2)
        if not words or line.startswith(("#", "?")):
            continue
        if len(words) < 2 or words[0] not in _DECISIONS:
            raise ErasureStoppedError(
                localized(
                    QT_TR_NOOP("Line {number} of {path} starts with {word}, which is not a decision."),
                    number=number,
                    path=path,
                    word=repr(words[0]),
                ),
                QT_TR_NOOP("Nothing was changed."),
                localized(
                    QT_TR_NOOP("Enter one of {words} there, or leave the ? for later."), words=", ".join(_DECISIONS)
                ),
            )
        decisions[words[1]] = words[0]  # type: ignore[assignment]
    return Review(person_id, names, decisions)


def _plain(text: str) -> str:
    """Single line with JSON escapes resolved."""
    text = _ESCAPED.sub(lambda found: chr(int(found[1], 16)), text)
    return "".join(letter if letter.isprintable() else " " for letter in text)
