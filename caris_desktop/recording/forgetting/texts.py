"""Free text that may name a person: found, listed for somebody to decide on, and replaced."""

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Literal

from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.forgetting.canaries import FORGOTTEN, FORGOTTEN_IN_YAML, PersonNames
from caris_desktop.recording.forgetting.speech import Sentences, without_words
from caris_desktop.recording.photo_file import PhotoFileError, texts_of, with_texts
from caris_desktop.recording.session import mcap_blocks
from caris_desktop.recording.session import mcap_records as records
from caris_desktop.recording.session.mcap_rewriting import copy_changed

Decision = Literal["redact", "keep", "remove", ""]
"""What is to become of a place; ``remove`` is for whole files. Empty: nobody has decided."""
_AROUND = 48
_STAMP = re.compile(r'"stamp_ns":\s*(-?\d+)')
_UTTERANCE = re.compile(r'"utterance_id":\s*"((?:[^"\\]|\\.)*)"')
_CHECKSUM = re.compile(r'"sha256":\s*"([0-9a-f]{64})"')
_YAML = (".yaml", ".yml")
# The texts of scenarios and profiles, as the events that tell of them hold them.
_YAML_INSIDE = ('"sha256":', '"profile":')
_BINARY_LOOK_BYTES = 8192
_AS_IT_IS = {"utf-8": "surrogateescape", "utf-16-le": "surrogatepass", "utf-16-be": "surrogatepass"}


@dataclass(frozen=True, slots=True)
class Passage:
    """Where the person may be named: the words before, the name as it stands there, and the words behind.

    Places with the same words in one file are one, ``count`` times. ``where`` is a line, or a moment of the session.
    ``kind`` says what can be done: a text can be changed, another file only be removed or kept. ``unexamined`` files
    may show the person or sound like them; nothing tells, so that only somebody who looks can decide. ``speech`` was
    said while they were there, by nobody knows whom.
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
    """The texts of one forgetting. ``decisions`` are by key of place; ``otherwise`` is for those without one.

    ``utterances`` and ``sentences`` are what the person said: their words go, wherever they are found.
    """

    words: PersonNames
    decisions: Mapping[str, Decision]
    otherwise: Decision
    places: dict[str, Passage] = field(default_factory=dict)
    sentences: Sentences = Sentences()
    utterances: frozenset[str] = frozenset()

    def decided(self, place: Passage) -> Decision:
        """What nobody can do to a whole file is no decision about it, nor is what holds of texts."""
        decision = self.decisions.get(place.key) or ("" if place.kind == "unexamined" else self.otherwise)
        return "" if place.kind in ("file", "unexamined") and decision == "redact" else decision

    def open_places(self) -> list[Passage]:
        """Those that wait for somebody to decide."""
        return [place for place in self.places.values() if not self.decided(place)]

    def kept(self, file: str) -> bool:
        """Whether the person stays named in a file, since somebody decided so."""
        return any(place.file == file and self.decided(place) == "keep" for place in self.places.values())

    def look(self, text: str, file: str, where: Callable[[], str]) -> list[tuple[int, int, Decision]]:
        """What stands where in a text, and what is to become of it."""
        spoken = list(self.sentences.spans(text))
        found: list[tuple[int, int, Decision]] = [(start, end, "redact") for start, end in spoken]
        for start, end in self.words.spans(text):
            if any(from_ <= start and end <= until for from_, until in spoken):
                continue
            before, behind = _before(text, start), _behind(text, end)
            key = _key(file, before, text[start:end], behind)
            known = self.places.get(key)
            if known is None:
                self.places[key] = Passage(key, file, where(), before, text[start:end], behind)
            else:
                self.places[key] = replace(known, count=known.count + 1)
            found.append((start, end, self.decided(self.places[key])))
        return sorted(found)

    def note_file(self, file: str, words: str, *, count: int = 1) -> Decision:
        """A file that cannot be changed inside shows or names the person."""
        return self._noted(Passage(_key(file, "", "", ""), file, "in it", "", words.strip(), "", "file", count))

    def note_unexamined(self, file: str, why: str) -> Decision:
        """Nothing looked for the person in a file, which may show or hold them."""
        return self._noted(Passage(_key(file, "", "", ""), file, "in it", "", why, "", "unexamined"))

    def note_speech(self, file: str, utterance_id: str, where: str, words: str) -> Decision:
        """Something was said while the person was there, and nobody knows by whom."""
        return self._noted(Passage(_key(file, utterance_id, "", ""), file, where, "", words, "", "speech"))

    def note_name(self, file: str, name: str) -> Decision:
        """The name of a file names the person."""
        return self._noted(Passage(_key(file, "", "name", ""), file, "its name", "", name, "", "file name"))

    def redact(self, text: str, file: str, *, yaml: bool) -> tuple[str, int]:
        """A text without what is to go: names as decided, and the person's own words; how much that is."""
        quiet = replace(self, places={})
        changed, words = without_words(text, self.utterances)
        changed, count = redacted(changed, quiet.look(changed, file, str), yaml=yaml)
        return changed, words + count

    def _noted(self, place: Passage) -> Decision:
        self.places[place.key] = place
        return self.decided(place)


def redacted(text: str, found: list[tuple[int, int, Decision]], *, yaml: bool) -> tuple[str, int]:
    """The text without the names that are to go, and how many those are."""
    parts, at, count = [], 0, 0
    for start, end, decision in found:
        if decision == "redact" and start >= at:
            parts += [text[at:start], FORGOTTEN_IN_YAML if yaml else FORGOTTEN]
            at, count = end, count + 1
    return "".join([*parts, text[at:]]), count


# Files of text


def encoding_of(path: Path) -> str | None:
    """How the text of a file is written; None for what is no text. Raises OSError."""
    with path.open("rb") as file:
        head = file.read(_BINARY_LOOK_BYTES)
    if head.startswith(b"\xff\xfe"):
        return "utf-16-le"
    if head.startswith(b"\xfe\xff"):
        return "utf-16-be"
    return None if b"\0" in head else "utf-8"


def lines_of(path: Path, encoding: str) -> Iterator[str]:
    """With their ends, and bytes that are no text as they were."""
    with path.open(encoding=encoding, errors=_AS_IT_IS[encoding], newline="") as file:
        yield from file


def look_at_text(work: TextWork, path: Path, file: str, encoding: str) -> bool:
    """List the places of a file; whether anything in it is to be replaced. Raises OSError."""
    wanted = False
    for number, line in enumerate(lines_of(path, encoding), start=1):
        found = work.look(line, file, lambda number=number: f"line {number}")  # type: ignore[misc]
        wanted = wanted or _is_to_change(found)
    return wanted


def rewrite_text(work: TextWork, path: Path, file: str, encoding: str, target: Path) -> int:
    """Write a file anew without what is to go; how much that is. Raises OSError."""
    count = 0
    with target.open("w", encoding=encoding, errors=_AS_IT_IS[encoding], newline="") as written:
        for line in lines_of(path, encoding):
            text, here = work.redact(line, file, yaml=path.suffix.lower() in _YAML)
            written.write(text)
            count += here
    return count


# Photos, whose tags are text


def look_at_photo(work: TextWork, path: Path, file: str) -> bool:
    """List the places in what a PNG tells of itself; whether anything is to be replaced. Raises OSError."""
    wanted = False
    for name, text in _photo_texts(path).items():
        wanted = _is_to_change(work.look(text, file, lambda name=name: f"its {name}")) or wanted  # type: ignore[misc]
    return wanted


def rewrite_photo(work: TextWork, path: Path, file: str, target: Path) -> int:
    """Write a photo anew without what is to go of its texts; how much that is. Raises OSError."""
    changed = {name: work.redact(text, file, yaml=False) for name, text in _photo_texts(path).items()}
    target.write_bytes(with_texts(path.read_bytes(), {name: text for name, (text, _) in changed.items()}))
    return sum(count for _, count in changed.values())


def _photo_texts(path: Path) -> dict[str, str]:
    try:
        return texts_of(path.read_bytes())
    except PhotoFileError:
        return {}


# Records of events


@dataclass(slots=True)
class EventTexts:
    """What a record of events holds of the person: whether anything is to go, and which utterances that is in."""

    to_change: bool = False
    utterances: set[str] = field(default_factory=set)


def look_at_events(work: TextWork, path: Path, file: str, moment: Callable[[int], str]) -> EventTexts:
    """List the places of an MCAP file. Raises OSError."""
    found = EventTexts()
    with path.open("rb") as opened:
        index = mcap_blocks.scan(opened)

        def look(value: bytes) -> bytes:
            spans = work.look(_text_of(value), file, lambda: "what heads the record")
            found.to_change |= _is_to_change(spans)
            return value

        for record in index.beside:
            _changed_metadata(record, look)
        for number in range(index.count):
            try:
                content = mcap_blocks.read_block(opened, index, number)
            except mcap_blocks.DamagedBlockError:
                continue
            for message in mcap_blocks.messages_of(content):
                text = _text_of(content[message.start : message.end])
                text, words = without_words(text, work.utterances)
                found.to_change = found.to_change or words > 0
                spans = work.look(text, file, lambda text=text: _moment_of(text, moment))  # type: ignore[misc]
                if _is_to_change(spans):
                    found.to_change = True
                    utterance = _UTTERANCE.search(text)
                    if utterance is not None:
                        found.utterances.add(utterance[1])
    return found


def rewrite_events(work: TextWork, path: Path, file: str, target: Path) -> int:
    """Write an MCAP file anew without what is to go: blocks without it stay as they are. Raises OSError."""
    count = 0

    def change(data: bytes) -> bytes:
        nonlocal count
        text = _text_of(data)
        yaml = any(key in text for key in _YAML_INSIDE)
        changed, here = work.redact(text, file, yaml=yaml)
        count += here
        return _with_own_checksum(changed).encode("utf-8", "surrogateescape") if here else data

    with path.open("rb") as opened:
        index = mcap_blocks.scan(opened)
        beside = tuple(_changed_metadata(record, change) for record in index.beside)
        written = DiskFile(target)
        try:
            copy_changed(opened, _with_beside(index, beside), written, change)
            written.sync()
        finally:
            written.close()
    return count


def _with_own_checksum(message: str) -> str:
    """A message that tells the checksum of its text, with that of the text as it is now: names can be guessed from the
    one before.
    """
    checksum = _CHECKSUM.search(message)
    if checksum is None:
        return message
    try:
        content = str(parse_json(message)["content"])
    except (ValueError, KeyError, TypeError):
        content = ""
    digest = hashlib.sha256(content.encode("utf-8", "replace")).hexdigest()
    return message[: checksum.start(1)] + digest + message[checksum.end(1) :]


def _with_beside(index: mcap_blocks.BlockIndex, beside: tuple[bytes, ...]) -> mcap_blocks.BlockIndex:
    return replace(index, beside=beside)


def _changed_metadata(record: bytes, change: Callable[[bytes], bytes]) -> bytes:
    """A record of names and values, changed in its values; others as they are."""
    if record[0] != records.METADATA:
        return record
    body = record[records.HEAD.size :]
    name_end = records.text_end(body, 0)
    entries: dict[str, str] = {}
    at = name_end + 4
    while at < len(body):
        key_end = records.text_end(body, at)
        value_end = records.text_end(body, key_end)
        value = change(body[key_end + 4 : value_end])
        entries[body[at + 4 : key_end].decode("utf-8", "replace")] = value.decode("utf-8", "replace")
        at = value_end
    return records.record(records.METADATA, body[:name_end] + records.text_map(entries))


def _text_of(data: bytes) -> str:
    return data.decode("utf-8", "surrogateescape")


def _is_to_change(found: list[tuple[int, int, Decision]]) -> bool:
    return any(decision == "redact" for _, _, decision in found)


def _moment_of(text: str, moment: Callable[[int], str]) -> str:
    stamp = _STAMP.search(text)
    return moment(int(stamp[1])) if stamp is not None else "somewhere"


# What stands around a name


def _before(text: str, start: int) -> str:
    """In the same line and the same value of JSON."""
    around = text[max(0, start - _AROUND) : start]
    return re.split(r'[\n\r]|(?<!\\)"', around)[-1]


def _behind(text: str, end: int) -> str:
    return re.split(r'[\n\r]|(?<!\\)"', text[end : end + _AROUND])[0]


def _key(file: str, before: str, name: str, behind: str) -> str:
    whole = "\0".join((file, before, name, behind))
    return hashlib.sha256(whole.encode("utf-8", "surrogatepass")).hexdigest()[:10]
