"""Search terms of an erasure: a person's names in every written form, and bytes of their images."""

import base64
import html
import json
import re
import unicodedata
from collections.abc import Iterable, Iterator
from dataclasses import field
from functools import cached_property
from urllib.parse import quote

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.value_class import dataclass

FORGOTTEN, FORGOTTEN_IN_YAML = "[forgotten]", "(forgotten)"
"""Replacements for a name. In YAML, a bracket at the start of a value has a meaning."""
_LEAST_PART = 3
# Names this long are matched inside longer words too, such as file names; shorter ones are often part of other words.
_DISTINCT = 8
# Word boundaries in a text as stored in a file: "\nAnna", "\u201cAnna" and "%20Anna" begin there too.
_BEGINS = r"(?:(?<![^\W_])|(?<=\\[nrtbf])|(?<=\\u[0-9a-fA-F]{4})|(?<=%[0-9a-fA-F]{2}))"
_ENDS = r"(?=(?:['’]?s)?(?![^\W_]))"
_BETWEEN = r"(?:\s|\\[nrt]|%20|&nbsp;|&#160;|[+_.-])+"
# From here on, scripts have no spaces between words, so that nothing marks where a name begins.
_WITHOUT_SPACES = "\u0e00"
# Checksums and base64 contain no names; paths have letters and slashes too, but shorter runs.
_CODES = ((re.compile(r"[A-Za-z0-9]*"), 32), (re.compile(r"[A-Za-z0-9+/=]*"), 250))
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
            parts = [part for part in re.split(r"[\s\-.]+", full_name) if len(part) >= _LEAST_PART]
            for text in (full_name, *parts):
                if len(text) >= 2:
                    found.setdefault(unicodedata.normalize("NFC", text))
                    found.setdefault(_without_accents(text))
        return tuple(sorted(found, key=len, reverse=True))

    @cached_property
    def pattern(self) -> re.Pattern[str] | None:
        """Pattern for any kind of text file: plain, JSON, XML, URL. None without names."""
        patterns = []
        for text in self.alternatives:
            forms = [_joined(form) for form in _forms(text)]
            either = "|".join(dict.fromkeys(forms))
            patterns.append(f"(?:{either})" if _is_distinct(text) else f"{_BEGINS}(?:{either}){_ENDS}")
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
            if _is_distinct(match[0]) or not _in_code(text, *match.span()):
                yield match.span()

    @cached_property
    def _firsts(self) -> tuple[str, ...]:
        """First word of each form, in lower case."""
        return tuple({form.lower().split()[0] for text in self.alternatives for form in _forms(text)})

    @cached_property
    def beginnings(self) -> tuple[tuple[bytes, str], ...]:
        """Beginning of each form in a file, in lower-case ASCII, with its encoding."""
        found: dict[tuple[bytes, str], None] = {}
        for text in self.alternatives:
            for form in _forms(text):
                first = re.split(r"\s", form)[0]
                for cased in (first, first.lower(), first.upper(), first.title()):
                    for encoding in ("utf-8", "utf-16-le", "utf-16-be"):
                        found.setdefault((folded(cased.encode(encoding, "replace")), encoding))
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
        coded = [text for probe in plain for text in _in_base64(probe)]
        return tuple(dict.fromkeys((*plain, *coded)))


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
    return tuple(dict.fromkeys(forms))


def _joined(form: str) -> str:
    return _BETWEEN.join(re.escape(part) for part in form.split())


def _is_distinct(text: str) -> bool:
    return len(text) >= _DISTINCT or text[0] >= _WITHOUT_SPACES


def _without_accents(text: str) -> str:
    """``text`` without accents, as typed without such keys or written by a recogniser."""
    plain = "".join(letter for letter in unicodedata.normalize("NFKD", text) if not unicodedata.combining(letter))
    return unicodedata.normalize("NFC", plain)


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


def _in_base64(piece: bytes) -> Iterator[bytes]:
    for shift in range(3):
        cut = piece[shift : shift + (len(piece) - shift) // 3 * 3]
        if len(cut) >= 9:
            yield base64.b64encode(cut)


def all_of(names: Iterable[str], pictures: Iterable[bytes]) -> SearchTerms:
    return SearchTerms(PersonNames(tuple(dict.fromkeys(name for name in names if name.strip()))), tuple(pictures))
