"""What must not be found any more: the names of a person in every form that is written, and bytes of their pictures."""

import base64
import html
import json
import re
import unicodedata
from collections.abc import Iterable, Iterator
from dataclasses import field
from functools import cached_property
from urllib.parse import quote

from caris_desktop.domain.failure import ToldFailure
from caris_desktop.domain.value_class import dataclass

FORGOTTEN, FORGOTTEN_IN_YAML = "[forgotten]", "(forgotten)"
"""What stands where a name was. In YAML a bracket at the beginning of a value means something."""
_LEAST_PART = 3
# So long a name is found inside of longer words too, such as those of files; what is shorter is often a part of others.
_DISTINCT = 8
# Where a word begins and ends in a text as it lies in a file: "\nAnna", "\u201cAnna" and "%20Anna" begin there too.
_BEGINS = r"(?:(?<![^\W_])|(?<=\\[nrtbf])|(?<=\\u[0-9a-fA-F]{4})|(?<=%[0-9a-fA-F]{2}))"
_ENDS = r"(?=(?:['’]?s)?(?![^\W_]))"
_BETWEEN = r"(?:\s|\\[nrt]|%20|&nbsp;|&#160;|[+_.-])+"
# From here on scripts put no spaces between words, so nothing tells where a name begins.
_WITHOUT_SPACES = "\u0e00"
# Checksums, and bytes written as letters, name nobody; a path has letters and slashes too, but not that many.
_CODES = ((re.compile(r"[A-Za-z0-9]*"), 32), (re.compile(r"[A-Za-z0-9+/=]*"), 250))
_PROBE_BYTES, _PROBES = 24, 6
_JPEG_SCAN = b"\xff\xda"


class ForgettingStopped(ToldFailure):
    """Forgetting cannot go on; nothing is lost, and the same command goes on where it stopped."""


@dataclass(frozen=True)
class PersonNames:
    """The names of one person. Parts of a name of several are found as well, since people are called by them."""

    names: tuple[str, ...]

    @cached_property
    def alternatives(self) -> tuple[str, ...]:
        """What to look for, the longest first."""
        found: dict[str, None] = {}
        for name in self.names:
            whole = " ".join(name.split())
            parts = [part for part in re.split(r"[\s\-.]+", whole) if len(part) >= _LEAST_PART]
            for text in (whole, *parts):
                if len(text) >= 2:
                    found.setdefault(unicodedata.normalize("NFC", text))
                    found.setdefault(_without_accents(text))
        return tuple(sorted(found, key=len, reverse=True))

    @cached_property
    def pattern(self) -> re.Pattern[str] | None:
        """In a text of whatever kind of file: plain, in JSON, in XML, in an address. None without any name."""
        wanted = []
        for text in self.alternatives:
            forms = [_joined(form) for form in _forms(text)]
            either = "|".join(dict.fromkeys(forms))
            wanted.append(f"(?:{either})" if _is_distinct(text) else f"{_BEGINS}(?:{either}){_ENDS}")
        return re.compile("|".join(wanted), re.IGNORECASE) if wanted else None

    def spans(self, text: str) -> Iterator[tuple[int, int]]:
        """Where the person is named."""
        if self.pattern is None:
            return
        # Most texts name nobody, and are told at once by that.
        small = text.lower()
        if not any(first in small for first in self._firsts):
            return
        for match in self.pattern.finditer(text):
            if _is_distinct(match[0]) or not _in_code(text, *match.span()):
                yield match.span()

    @cached_property
    def _firsts(self) -> tuple[str, ...]:
        """The first word of each form, in small letters."""
        return tuple({form.lower().split()[0] for text in self.alternatives for form in _forms(text)})

    @cached_property
    def beginnings(self) -> tuple[tuple[bytes, str], ...]:
        """How each of them begins in a file, in small ASCII letters, with the encoding."""
        found: dict[tuple[bytes, str], None] = {}
        for text in self.alternatives:
            for form in _forms(text):
                first = re.split(r"\s", form)[0]
                for cased in (first, first.lower(), first.upper(), first.title()):
                    for encoding in ("utf-8", "utf-16-le", "utf-16-be"):
                        found.setdefault((folded(cased.encode(encoding, "replace")), encoding))
        return tuple(found)


@dataclass(frozen=True)
class Canaries:
    """All of it. ``pictures`` are bytes that nobody else's data holds: portraits and vectors, as they are."""

    words: PersonNames
    pictures: tuple[bytes, ...] = field(default=(), repr=False)

    @cached_property
    def probes(self) -> tuple[bytes, ...]:
        """Pieces of the pictures, and the same as base64 writes them at each of its three places."""
        plain = [probe for picture in self.pictures for probe in _pieces(picture)]
        coded = [text for probe in plain for text in _in_base64(probe)]
        return tuple(dict.fromkeys((*plain, *coded)))


_FOLD = bytes(byte + 32 if 65 <= byte <= 90 else byte for byte in range(256))


def folded(data: bytes) -> bytes:
    """With small letters in place of large ones, as far as ASCII goes."""
    return data.translate(_FOLD)


def _forms(text: str) -> tuple[str, ...]:
    """As it is, and as files of different kinds escape it."""
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
    return tuple(dict.fromkeys(forms))


def _joined(form: str) -> str:
    return _BETWEEN.join(re.escape(part) for part in form.split())


def _is_distinct(text: str) -> bool:
    return len(text) >= _DISTINCT or text[0] >= _WITHOUT_SPACES


def _without_accents(text: str) -> str:
    """As somebody types it who has no such keys, or a recogniser writes it."""
    plain = "".join(letter for letter in unicodedata.normalize("NFKD", text) if not unicodedata.combining(letter))
    return unicodedata.normalize("NFC", plain)


def _in_code(text: str, start: int, end: int) -> bool:
    """Whether it stands in something like a checksum: letters and digits without an end."""
    for letters, longest in _CODES:
        after = letters.match(text, end)
        right = after.end() if after is not None else end
        left = start
        while left > max(0, start - longest) and letters.fullmatch(text, left - 1, left):
            left -= 1
        if right - left >= longest and any(letter.isdigit() for letter in text[left:right]):
            return True
    return False


def _pieces(picture: bytes) -> Iterator[bytes]:
    """Some of it that others do not share: pictures of one program begin alike."""
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


def _in_base64(piece: bytes) -> Iterator[bytes]:
    for shift in range(3):
        cut = piece[shift : shift + (len(piece) - shift) // 3 * 3]
        if len(cut) >= 9:
            yield base64.b64encode(cut)


def all_of(names: Iterable[str], pictures: Iterable[bytes]) -> Canaries:
    return Canaries(PersonNames(tuple(dict.fromkeys(name for name in names if name.strip()))), tuple(pictures))
