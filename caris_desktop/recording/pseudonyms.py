"""Pseudonyms of wizards, coders and robot addresses in exports, and of participants in anonymised sessions.

The assignment is stored in the study's own folder, next to the database with participants' names, and nowhere else.
Speech and notes of a session are data and stay as they are.
"""

import contextlib
import hashlib
import json
import logging
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import field, replace
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from caris_desktop.domain.actor import OTHER_WIZARD
from caris_desktop.domain.events import RobotChosen
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.schema import from_jsonable, to_jsonable
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_editing import AnnotationError, with_coders_called
from caris_desktop.recording.annotation.annotation_model import AnnotationDocument
from caris_desktop.recording.annotation.annotation_store import annotation_files, load_documents
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.session_header import HEADER_NAME, SessionError, header_of, read_header, reading
from caris_desktop.recording.session.session_reader import Session

_log = logging.getLogger(__name__)
FILE_NAME = "pseudonyms.json"
_FORMAT, _FORMAT_VERSION = "caris-desktop pseudonyms", 1
_MAX_BYTES = 1024 * 1024
_WIZARD, _CODER, _PERSON = "W", "C", "P"
_ROBOT = "robot"
# Hosts that do not identify a location.
_OWN_HOSTS = ("localhost", "127.0.0.1", "::1", "0.0.0.0")  # noqa: S104 - compared, not bound
_ACTOR_BEGINS = f'"{OTHER_WIZARD}'.encode()
_ACTOR = re.compile(rb'("actor"\s*:\s*)(' + _ACTOR_BEGINS + rb'(?:[^"\\]|\\.)*")')
_ANOTHER = "another"
_ADDRESS = re.compile(rb"wss?://[^\s\"'\\<>(),;]+", re.IGNORECASE)
_IN_ADDRESS = b"s:/"  # one more slash would be looked for slowly in maps, whose unknown cells are slashes in base64


class Pseudonyms(Value):
    """Pseudonyms of the wizards (by case-insensitive name) and coders of a study, and of ``people`` (as wizards) whom
    its sessions were asked to hide. Names that are codes already are unchanged.
    """

    wizards: dict[str, str] = field(default_factory=dict)
    coders: dict[str, str] = field(default_factory=dict)
    people: dict[str, str] = field(default_factory=dict)

    def wizard(self, name: str) -> str:
        return self.wizards.get(_key(name), name)

    def coder(self, name: str) -> str:
        return self.coders.get(name, name)

    def participant(self, name: str) -> str:
        return self.people.get(_key(name), name)


def pseudonyms_of(sessions: Sequence[Path], people: Sequence[str] | None = None) -> Pseudonyms:
    """Pseudonyms of the study of ``sessions``; new names get the next numbers.

    Sessions outside of a study are numbered separately, in chronological order. With a list of ``people``, those and
    the participants whose entry is a name, which is one without a digit, get pseudonyms too.
    """
    studies: dict[Path, list[Path]] = {}
    for folder in sessions:
        studies.setdefault(folder.absolute().parent, []).append(folder.absolute())
    wizards: dict[str, str] = {}
    coders: dict[str, str] = {}
    others: dict[str, str] = {}
    for parent, folders in studies.items():
        stored = parent.parent / FILE_NAME if parent.name == "sessions" else None
        known = (
            _read_assignment(stored) if stored is not None else Pseudonyms(dict(wizards), dict(coders), dict(others))
        )
        named = () if people is None else map(_key, (*people, *_entries_of(folders, "participant")))
        now = Pseudonyms(
            _numbered(map(_key, _entries_of(folders, "wizard")), known.wizards, _WIZARD),
            _numbered(_coders_of(folders), known.coders, _CODER),
            _numbered(named, known.people, _PERSON),
        )
        if stored is not None and now != known:
            _persist(stored, now)
        wizards |= now.wizards
        coders |= now.coders
        others |= now.people
    return Pseudonyms(wizards, coders, others)


def pseudonymised(session: Session, of: Pseudonyms) -> Session:
    """Session with pseudonyms in its header and for each acting wizard, and the robot's profile name in place of its
    address.
    """
    scrub = scrubber_of(session, of)
    content = json.loads(scrub(json.dumps(session.header.to_json()).encode()))
    header = header_of(content, session.folder / HEADER_NAME)
    if header.trial.get("wizard"):
        header = replace(header, trial={**header.trial, "wizard": of.wizard(header.trial["wizard"])})
    names = hashlib.sha256(json.dumps([of.wizards, of.coders], sort_keys=True).encode()).hexdigest()
    return replace(session, header=header, scrub=scrub, coder_name=of.coder, wizard_name=of.wizard, names=names)


def scrubber_of(session: Session, of: Pseudonyms) -> Callable[[bytes], bytes]:
    """Function that replaces robot addresses and acting wizards in JSON and text of a session."""
    without_addresses, without_actors = address_scrubber(session), _actor_scrubber(of)
    return lambda content: without_actors(without_addresses(content))


def other_wizards(session: Session) -> list[str]:
    """Names of wizards who acted from other computers. Raises SessionError."""
    path = session.folder / "events.mcap"
    found: dict[str, None] = {}
    with reading(path), path.open("rb") as file:
        for content in events_file.intact_blocks(file, events_file.read_index(path)):
            for match in _ACTOR.finditer(content) if _ACTOR_BEGINS in content else ():
                with contextlib.suppress(ValueError):
                    found.setdefault(str(json.loads(match[2]))[len(OTHER_WIZARD) :])
    return list(found)


def coding_of(session: Session, *, on_damaged: Callable[[str], None]) -> AnnotationDocument:
    """Annotations of all coders, under the names that ``session`` gives them. Raises AnnotationError."""
    document = load_documents(session.folder, on_damaged=on_damaged)
    return with_coders_called(document, session.coder_name)


def _key(name: str) -> str:
    return " ".join(name.split()).casefold()


def address_scrubber(session: Session) -> Callable[[bytes], bytes]:
    """Replace robot addresses by the profile name in JSON and text."""
    chosen = [(session.header.robot.profile, session.header.robot.address)]
    chosen += [(event.name, event.address) for _, event in session.values(BY_TYPE[RobotChosen].name)]
    profiles = [name for name, _ in chosen if name and "://" not in name]
    default = json.dumps(profiles[0] if profiles else _ROBOT)[1:-1].encode()
    places: dict[bytes, bytes] = {}
    for profile, address in chosen:
        name = json.dumps(profile)[1:-1].encode() if profile and "://" not in profile else default
        try:
            parts = urlsplit(address)
            host, port = parts.hostname or "", parts.port
        except ValueError:
            continue
        if host and port is not None:
            places.setdefault(f"{host}:{port}".encode(), name)
        # A host called robot or kitchen reveals nothing by itself, and the word has other meanings: a speaker, a place.
        if host and host not in _OWN_HOSTS and not host.isalpha():
            places.setdefault(host.encode(), name)
    # Longest first: a host is a prefix of itself with a port.
    ordered = sorted((place.lower() for place in places), key=len, reverse=True)
    words = b"|".join(map(re.escape, ordered))
    of_host = re.compile(rb"(?<![\w.-])(?:" + words + rb")(?![\w-])(?!\.\w)", re.IGNORECASE) if ordered else None

    def in_place(match: re.Match[bytes]) -> bytes:
        found = match[0]
        return next((name for place, name in places.items() if place.lower() in found.lower()), default)

    def scrub(content: bytes) -> bytes:
        lowered = content.lower()
        if _IN_ADDRESS in lowered:
            content = _ADDRESS.sub(in_place, content)
        if of_host is not None and any(place in lowered for place in ordered):
            return of_host.sub(in_place, content)
        return content

    return scrub


def _actor_scrubber(of: Pseudonyms) -> Callable[[bytes], bytes]:
    """Replace other wizards by pseudonyms; a wizard without a session in the study becomes "another"."""

    def in_place(match: re.Match[bytes]) -> bytes:
        try:
            name = str(json.loads(match[2]))[len(OTHER_WIZARD) :]
        except ValueError:
            name = ""
        called = of.wizard(name)
        if called == name and not _is_code(name, _WIZARD):
            called = _ANOTHER
        return match[1] + json.dumps(f"{OTHER_WIZARD}{called}").encode()

    def scrub(content: bytes) -> bytes:
        return _ACTOR.sub(in_place, content) if _ACTOR_BEGINS in content else content

    return scrub


def _is_code(name: str, letter: str) -> bool:
    """True for a pseudonym of this letter. A participant has a code of the researcher, with a digit in it."""
    if letter == _PERSON:
        return len(name) < 2 or any(character.isdigit() for character in name)
    return re.fullmatch(rf"{letter}\d+", name, re.IGNORECASE) is not None


# Assignment


def _numbered(names: Iterable[str], known: dict[str, str], letter: str) -> dict[str, str]:
    """``known`` plus the next free numbers for new names."""
    numbered = dict(known)
    names = [name for name in dict.fromkeys(names) if name.strip()]
    taken = {name.upper() for name in names if _is_code(name, letter)} | set(known.values())
    number = 1
    for name in names:
        if name in numbered or _is_code(name, letter):
            continue
        while f"{letter}{number}" in taken:
            number += 1
        numbered[name] = f"{letter}{number}"
        taken.add(numbered[name])
    return numbered


def _entries_of(folders: Iterable[Path], name: str) -> list[str]:
    """Entries of the start dialog in chronological order of the sessions."""
    found: list[tuple[int, str]] = []
    for folder in folders:
        try:
            header = read_header(folder)
        except SessionError:
            continue
        found.append((header.clock.utc_ns_at(header.started_ns), header.trial.get(name, "").strip()))
    return [entry for _, entry in sorted(found)]


def _coders_of(folders: Iterable[Path]) -> list[str]:
    found = set()
    for folder in folders:
        try:
            paths = annotation_files(folder)
        except AnnotationError as error:
            _log.warning("%s", error)
            continue
        for path in paths:
            try:
                coder = json.loads(path.read_bytes()).get("coder")
            except (OSError, ValueError, AttributeError, RecursionError):
                continue
            if isinstance(coder, str):
                found.add(coder)
    return sorted(found)


def _read_assignment(path: Path) -> Pseudonyms:
    try:
        with path.open("rb") as file:
            data: Any = json.loads(file.read(_MAX_BYTES))
        if data["format"] != _FORMAT:
            raise ValueError("a file of something else")  # noqa: TRY301 - reported below, like its other errors
        return from_jsonable(Pseudonyms, data)
    except FileNotFoundError:
        return Pseudonyms()
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        _log.warning("%s cannot be read: the pseudonyms are made anew", path, exc_info=True)
        return Pseudonyms()


def _persist(path: Path, pseudonyms: Pseudonyms) -> None:
    """Store the assignment. Without it the numbers are the same as long as the sessions are."""
    data = {
        "format": _FORMAT,
        "format_version": _FORMAT_VERSION,
        "note": (
            "Assignment of pseudonyms to names. Store this file where the names of participants are stored, or "
            "delete it."
        ),
        **{name: names for name, names in to_jsonable(pseudonyms).items() if names or name != "people"},
    }
    try:
        replace_file(path, (json.dumps(data, indent=2, ensure_ascii=False) + "\n").encode(), durable=False)
    except OSError:
        _log.warning("%s could not be written", path, exc_info=True)
