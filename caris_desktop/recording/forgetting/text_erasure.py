"""Free text that may name a person: search, listing for review, and redaction."""

import hashlib
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Literal

from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.forgetting.search_terms import FORGOTTEN, FORGOTTEN_IN_YAML, PersonNames
from caris_desktop.recording.forgetting.speech_erasure import Sentences, without_words
from caris_desktop.recording.photo_file import PhotoFileError, texts_of, with_texts
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session import events_file as records
from caris_desktop.recording.session.events_file import copy_changed

Decision = Literal["redact", "keep", "remove", ""]
"""Decision about a place; ``remove`` is for whole files. Empty: undecided."""
_AROUND = 48
_STAMP = re.compile(r'"stamp_ns":\s*(-?\d+)')
_UTTERANCE = re.compile(r'"utterance_id":\s*"((?:[^"\\]|\\.)*)"')
_CHECKSUM = re.compile(r'"sha256":\s*"([0-9a-f]{64})"')
_YAML = (".yaml", ".yml")
# Keys of events that contain YAML texts of scenarios and profiles.
_YAML_INSIDE = ('"sha256":', '"profile":')
_BINARY_LOOK_BYTES = 8192
_AS_IT_IS = {"utf-8": "surrogateescape", "utf-16-le": "surrogatepass", "utf-16-be": "surrogatepass"}


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
    with path.open(encoding=encoding, errors=_AS_IT_IS[encoding], newline="") as file:
        yield from file


def inspect_text(work: TextWork, path: Path, file: str, encoding: str) -> bool:
    """List the places of a file; True if anything is to be redacted. Raises OSError."""
    to_change = False
    for number, line in enumerate(lines_of(path, encoding), start=1):
        found = work.find(line, file, lambda number=number: f"line {number}")  # type: ignore[misc]
        to_change = to_change or _is_to_change(found)
    return to_change


def rewrite_text(work: TextWork, path: Path, file: str, encoding: str, target: Path) -> int:
    """Rewrite a file redacted; return the number of changes. Raises OSError."""
    count = 0
    with target.open("w", encoding=encoding, errors=_AS_IT_IS[encoding], newline="") as written:
        for line in lines_of(path, encoding):
            text, here = work.redact(line, file, yaml=path.suffix.lower() in _YAML)
            written.write(text)
            count += here
    return count


# Photos, whose tags are text


def inspect_photo(work: TextWork, path: Path, file: str) -> bool:
    """List the places in a PNG's texts; True if anything is to be redacted. Raises OSError."""
    to_change = False
    for name, text in _photo_texts(path).items():
        to_change = _is_to_change(work.find(text, file, lambda name=name: f"its {name}")) or to_change  # type: ignore[misc]
    return to_change


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
                spans = work.find(text, file, lambda text=text: _moment_of(text, moment))  # type: ignore[misc]
                if _is_to_change(spans):
                    found.to_change = True
                    utterance = _UTTERANCE.search(text)
                    if utterance is not None:
                        found.utterances.add(utterance[1])
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
        written = DiskFile(target)
        try:
            copy_changed(opened, replace(index, beside=beside), written, lambda _channel, data: change(data))
            written.sync()
        finally:
            written.close()
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


# Text around a name


def _before(text: str, start: int) -> str:
    """Preceding text in the same line and JSON value."""
    around = text[max(0, start - _AROUND) : start]
    return re.split(r'[\n\r]|(?<!\\)"', around)[-1]


def _behind(text: str, end: int) -> str:
    return re.split(r'[\n\r]|(?<!\\)"', text[end : end + _AROUND])[0]


def _key(file: str, before: str, name: str, behind: str) -> str:
    key = "\0".join((file, before, name, behind))
    return hashlib.sha256(key.encode("utf-8", "surrogatepass")).hexdigest()[:10]
