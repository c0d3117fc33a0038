"""Known names in texts, replaced by pseudonyms."""

import re
import unicodedata
from collections.abc import Collection, Iterator, Mapping

from caris_desktop.recording.forgetting.search_terms import PersonNames

_SEVERAL = "[name]"
"""Pseudonym of a part of a name that several people have."""
_BETWEEN = re.compile(r"(?:\s|\\[nrt]|%20|&nbsp;|&#160;|[+_.-])+")
_HOME = re.compile(r"(?:/(?:home|Users)/|\b[A-Za-z]:\\Users\\)[^/\\\s\"':;,]+")
_HOMES = ("/home/", "/Users/", ":\\Users\\")
_IN_YAML = str.maketrans("[]{}", "()()")  # a bracket at the start of a value has a meaning there
_KEY_LINE = re.compile(r"(?:^[ \t-]*|[{,][ \t]*)[\"']?([a-z][a-z0-9_]*)[\"']?[ \t]*:", re.MULTILINE)
_KEY = re.compile(r"[a-z][a-z0-9_]*")
_UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "Ä": "Ae", "Ö": "Oe", "Ü": "Ue", "ß": "ss"})
_LONG = 8
"""Shorter names such as Max are also words of the program, as in the key ``max``."""


class KnownNames:
    """Names with their pseudonyms. Parts of a name are replaced too, since people are called by them; so are home
    folders in paths, and ``folders``.
    """

    def __init__(self, pseudonyms: Mapping[str, str], folders: Collection[str] = ()) -> None:
        self._folders = tuple(folder for folder in folders if len(folder) > 1)
        spelt = {way: pseudonym for name, pseudonym in pseudonyms.items() for way in _spellings(name)}
        spelt |= pseudonyms
        self._words = PersonNames(tuple(spelt))
        self._of: dict[str, str] = {}
        whole = {_plain(name): pseudonym for name, pseudonym in spelt.items()}
        for name in spelt:
            pseudonym = whole[_plain(name)]
            for form in map(_plain, PersonNames((name,)).alternatives):
                known = self._of.setdefault(form, whole.get(form, pseudonym))
                if known != pseudonym and form not in whole:
                    self._of[form] = _SEVERAL

    def named(self, text: str) -> bool:
        """True if the text contains a known name."""
        return next(self._words.spans(text), None) is not None

    def replace(self, text: str, *, yaml: bool = False) -> str:
        """Text with pseudonyms. In YAML, keys that are words of the program stay."""
        for folder in self._folders:
            text = text.replace(folder, "~")
        keys = [match.span(1) for match in _KEY_LINE.finditer(text)] if yaml and self.named(text) else []
        return self._replace(text, keys, yaml=yaml)

    def replace_key(self, key: str) -> str:
        """Key of a JSON object with pseudonyms, unless it is a word of the program."""
        return self._replace(key, [(0, len(key))] if _KEY.fullmatch(key) else [])

    def _replace(self, text: str, keys: Collection[tuple[int, int]], *, yaml: bool = False) -> str:
        parts, at = [], 0
        for start, end in self._words.spans(text):
            if end - start < _LONG and any(begin <= start and end <= until for begin, until in keys):
                continue
            pseudonym = self._of.get(_plain(text[start:end]), _SEVERAL)
            parts += [text[at:start], pseudonym.translate(_IN_YAML) if yaml else pseudonym]
            at = end
        changed = "".join([*parts, text[at:]])
        return _HOME.sub("~", changed) if any(word in changed for word in _HOMES) else changed


def _spellings(name: str) -> Iterator[str]:
    """German names as typed elsewhere, and as a pseudonym file has them in small letters."""
    yield name.translate(_UMLAUTS)
    yield name.replace("ss", "ß")


def _plain(text: str) -> str:
    return _BETWEEN.sub(" ", unicodedata.normalize("NFC", text)).strip().casefold()
