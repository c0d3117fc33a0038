"""Erasure of one person from everything in a study's folder, step by step, resumable after a kill at any time.

The caller knows the study's database: it passes in the search terms and a function that erases the person there. The
database comes last, so that until then the same command can resume.
"""

import contextlib
import json
import logging
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import field, replace
from datetime import UTC, datetime
from functools import cache, partial
from pathlib import Path
from typing import Any, Literal

from caris_desktop.domain.file_replacement import no_room, replace_file
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.free_names import free_path
from caris_desktop.domain.translation import QT_TR_NOOP, LocalizedText, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.forgetting import media, text_erasure
from caris_desktop.recording.forgetting.byte_search import ATTRIBUTES, ByteSearch, Searched
from caris_desktop.recording.forgetting.erasure_files import (
    FOLDER,
    PART,
    PEOPLE_FILES,
    Change,
    Journal,
    OwnFiles,
    StudyFiles,
    blot_out,
    copies_in,
    files_of,
    first_line_of,
    is_opaque,
    names_elsewhere,
    path_of,
    without_lines,
)
from caris_desktop.recording.forgetting.media import SessionMedia, examined_media, people_in, photos_of
from caris_desktop.recording.forgetting.person_tracks import (
    PersonTracks,
    everyone_who_is,
    links_in,
    messages_of,
    sightings_in,
)
from caris_desktop.recording.forgetting.text_erasure import (
    Decision,
    ErasureStoppedError,
    PersonNames,
    Sentences,
    Speech,
    TextWork,
    all_of,
    sentences_of,
    speech_in,
    write_review,
)
from caris_desktop.recording.session.folder_lock import LOCK_NAME, FolderHeldError, hold, is_held
from caris_desktop.recording.session.manifest import MANIFEST_NAME, write_manifest
from caris_desktop.recording.session.session_header import SessionError, clock_text, read_raw_header
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.studies.study_index import DATABASE_NAME
from caris_desktop.recording.table_files import delete_tables

_log = logging.getLogger(__name__)
RECEIPT = "RECEIPT.json"
_FORMAT, _FORMAT_VERSION = "caris-desktop forgetting", 1
_PEOPLE, _SCENARIO = "people.sqlite", "/event/scenario_opened"
# Temporary files that a kill may leave; none has replaced its target yet.
_PARTS = (f".*{PART}", f".{RECEIPT}.*.part", ".review-*.part", f".{MANIFEST_NAME}.*.part")
_KINDS = (
    ("video", "video", "videos"),
    ("photo", "photo", "photos"),
    ("sound", "audio file", "audio files"),
    ("text", "text file", "text files"),
    ("export", "exported file", "exported files"),
    ("copy", "copy", "copies"),
    ("history", "list of typed sentences", "lists of typed sentences"),
    ("log", "log", "logs"),
    ("attributes", "file's attributes", "files' attributes"),
)
_OF_MEDIA = ("video", "photo", "sound")
_PICTURES = (".png", ".jpg", ".mp4")
_UNEXAMINED = QT_TR_NOOP("it was not searched for people")
_NOT_CHANGED = QT_TR_NOOP("The changes made so far remain, and nothing else was changed.")
_IN_THE_MIDDLE = QT_TR_NOOP(
    "Erasing stopped before it finished: the changes made so far remain, and nothing else was changed."
)


Rewrite = Callable[[str, str], str]
"""Receives the owner of a text and the text; returns the text to store."""


class ForgetRequest(Value):
    """Person to erase, and options. ``names`` and ``pictures`` are the person's data in the study's database.

    ``recordings``: mask the person in video and photos, or remove those files. ``decisions`` come from a review, by key
    of place; ``otherwise`` applies to places without one, empty: they wait for a decision. ``only_texts`` leaves video
    and photos as they are. ``texts_of_people`` applies a function to all texts in the database. ``own_files`` are the
    user's files outside of the study.
    """

    study: Path
    person_ids: tuple[str, ...]
    names: tuple[str, ...] = ()
    pictures: tuple[bytes, ...] = field(default=(), repr=False)
    recordings: Literal["mask", "remove"] = "mask"
    otherwise: Decision = ""
    decisions: Mapping[str, Decision] = field(default_factory=dict)
    review: Path | None = None
    keep_exports: bool = False
    only_texts: bool = False
    texts_of_people: Callable[[Rewrite], None] = lambda _rewrite: None
    own_files: OwnFiles = OwnFiles()


class Forgotten(Value):
    """Result of an erasure. ``review`` lists ``waiting`` places and files that need a decision.

    ``left`` names files that still contain the person without a decision, ``problems`` lists failures, and ``closed``
    what could not be unpacked and was searched as stored. ``unexamined`` are media without detection and without a
    decision.
    """

    receipt: Path
    review: Path | None
    waiting: int
    left: tuple[str, ...]
    problems: tuple[str, ...]
    closed: tuple[str, ...] = ()
    unexamined: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """True if no trace of the person is known to remain."""
        return not (self.waiting or self.left or self.problems)


def unfinished_erasures(study: Path) -> list[str]:
    """Ids of people whose erasure was begun and not finished. Raises OSError."""
    found = [first_line_of(path).get("person_id") for path in (study / FOLDER).glob("under-way-*.jsonl")]
    return [str(person_id) for person_id in found if person_id]


def review_path(study: Path, person_id: str) -> Path:
    """Path of the review file."""
    journal = path_of(study, person_id)
    return journal.with_name(f"{journal.stem.replace('under-way', 'review')}.txt")


def forget_person(
    request: ForgetRequest, erase: Callable[[], None], progress: Callable[[float, str], None] = lambda _f, _w: None
) -> Forgotten:
    """Erase the person, or resume. ``erase`` deletes them from the study's database and may be called repeatedly.

    Raises ErasureStoppedError if it cannot start or continue: a recording is running, the disk is full, a file cannot
    be read. The same request resumes it.
    """
    with _explained(request.study):
        recorded = next((folder for folder in files_of(request.study).sessions if is_held(folder)), None)
        if recorded is not None:
            raise ErasureStoppedError(
                localized(QT_TR_NOOP("{session} is currently being recorded or repaired."), session=recorded.name),
                QT_TR_NOOP("No person was erased; nothing was changed."),
                QT_TR_NOOP("Stop the recording first, then try again."),
            )
        (request.study / FOLDER).mkdir(exist_ok=True)
        try:
            lock = hold(request.study / FOLDER)
        except FolderHeldError as error:
            raise ErasureStoppedError(
                QT_TR_NOOP("Another person is already being erased from this study."),
                QT_TR_NOOP("Nothing was changed."),
                QT_TR_NOOP("Wait until that has finished."),
            ) from error
        with lock:
            return _Forgetting(request, erase, progress).run()


_OF_SESSION = "export-"
# The study's own folders next to the sessions.
_OWN = ("sessions", "photos", "forgotten")
_STATISTICS = "statistics"
# A folder with one of these files is an export, with all its content.
_MARKS = (
    "ro-crate-metadata.json", "data_dictionary.csv", "data_dictionary.parquet", "report.html", "methods.html",
    "captions.vtt", "session.TextGrid", "session.bag", "media.txt", "data.yaml", "boxes.csv", "episodes.jsonl",
    "turns.jsonl", "meta/info.json",
)  # fmt: skip
# Types that exporters write; scripts and notes next to them are the user's.
_WRITTEN = (
    ".csv", ".parquet", ".json", ".jsonl", ".md", ".html", ".eaf", ".pfsx", ".textgrid", ".vtt", ".bag", ".mcap",
    ".yaml", ".cff", ".ini", ".txt", ".sql", ".duckdb", ".jpg", ".png", ".mp4", ".wav",
)  # fmt: skip
_SHOWS = (".png", ".jpg", ".mp4", ".wav", ".bag", ".mcap", ".html")


class _Exports:
    """Exports inside a study's folder. ``sessions`` are the names of its session folders."""

    def __init__(self, study: Path, sessions: Iterable[str]) -> None:
        self._study = study
        self._sessions = frozenset(sessions)
        self._is_export = cache(lambda folder: any((folder / mark).is_file() for mark in _MARKS))

    def of(self, path: Path) -> Path | None:
        """Export folder that ``path`` belongs to; None if it is not part of one."""
        parts = path.relative_to(self._study).parts
        if parts[0] == "sessions":
            inside = len(parts) > 3 and parts[2].startswith(_OF_SESSION)
            return self._study.joinpath(*parts[:3]) if inside else None
        if parts[0] in _OWN or path.suffix.lower() not in _WRITTEN:
            return None
        for count in range(1, len(parts)):
            folder = self._study.joinpath(*parts[:count])
            if parts[:count] == (_STATISTICS,) or self._is_export(folder):
                return folder
        return None

    def shown_in(self, export: Path) -> frozenset[str]:
        """Sessions that the export may show: its own if its path names one, else all."""
        parts = export.relative_to(self._study).parts
        return frozenset(parts) & self._sessions or self._sessions


class _Forgetting:
    """One run, with the study held."""

    def __init__(
        self, request: ForgetRequest, erase: Callable[[], None], progress: Callable[[float, str], None]
    ) -> None:
        self._request = request
        self._study = request.study
        self._erase = erase
        self._progress = progress
        self._terms = all_of(request.names, request.pictures)
        self._words: PersonNames = self._terms.words
        self._search = ByteSearch(self._terms)
        self._texts = TextWork(self._words, request.decisions, request.otherwise)
        self._journal = Journal(self._study, request.person_ids[0], without_names=self._without_names)
        self._review = review_path(self._study, request.person_ids[0])
        self._problems: list[str] = []
        self._exports_named: list[str] = []
        self._seen_in: dict[Path, PersonTracks] = {}
        self._examined: set[str] = set()
        self._speech: dict[Path, Speech] = {}
        self._spoken: dict[Path, frozenset[str]] = {}
        self._sentences: dict[Path, Sentences] = {}
        self._spoken_search = ByteSearch(all_of((), ()))
        self._events: dict[Path, text_erasure.EventTexts] = {}

    def run(self) -> Forgotten:
        begun = self._journal.noted("begun")
        if begun is None:
            begun = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
            self._journal.note(person_id=self._request.person_ids[0], begun=begun)
        delete_tables(files_of(self._study).sessions)
        for path in (*files_of(self._study).files, *self._request.own_files.files()):
            if any(path.match(pattern) for pattern in _PARTS):
                path.unlink()
        erasing = self._journal.noted("erasing")
        if erasing is not None and not self._words.names:
            # Everything else was done, and the database erasure is finished or was in progress.
            return self._finish(begun, erasing, int(self._journal.noted("waiting") or 0))
        listed = self._listed()
        exports = _Exports(self._study, (folder.name for folder in listed.sessions))
        sessions = [folder for folder in listed.sessions if exports.of(folder / "events.mcap") is None]
        self._problems += [
            localized(
                QT_TR_NOOP(
                    "{link} points outside the study, to {target}. That location was neither searched nor "
                    "changed: erase the person there yourself, or move it into the study folder and try "
                    "again."
                ),
                link=self._journal.name_of(link),
                target=self._without_names(str(target)),
            )
            for link, target in listed.refused
        ]
        if self._journal.noted("copies") is None:
            # Before the first change, after which identical files are no longer identical.
            copies = [[self._journal.name_of(path) for path in same] for same in copies_in(listed.files)]
            elsewhere = [self._journal.name_of(path) for path in names_elsewhere(listed.files)]
            self._journal.note(copies=copies, elsewhere=elsewhere)
        self._find_person_tracks(sessions)
        self._find_speech(sessions)
        self._notify(0.05, QT_TR_NOOP("Searching the study"))
        found = self._found_in(self._listed().files)
        if self._journal.noted("found") is None:
            self._journal.note(found=_counts(found.values()), files=sum(bool(one.hits) for one in found.values()))
        found = self._without_exports(found, exports)
        for number, folder in enumerate(sessions):
            session = localized(QT_TR_NOOP("Session {number} of {count}"), number=number + 1, count=len(sessions))
            self._notify(0.1 + 0.7 * number / len(sessions), session)
            self._in_session(folder, found, 0.7 / len(sessions))
        if not self._request.only_texts:
            for path in photos_of(self._study / "photos", self._ids):
                # Taken without a session: no tracks show where the person is in it.
                self._journal.remove(path, "photo")
                found.pop(path, None)
        self._treat_copies(found)
        for folder in sessions:
            if any(change.what == "copy" for change in self._journal.changes_in(folder)):
                self._seal(folder)
        for path, searched in found.items():
            if path.exists() and not any(path.is_relative_to(folder) for folder in sessions):
                self._in_file(path, searched, self._texts)
        self._inspect_unexamined(found, sessions, exports)
        self._in_own_files()
        self._in_database()
        for folder in sessions:
            self._in_events(folder)
        # The search index is rebuilt from the sessions on the next search.
        for suffix in ("", "-wal", "-shm", "-journal"):
            (self._study / f"{DATABASE_NAME}{suffix}").unlink(missing_ok=True)
        delete_tables(listed.sessions)  # another program may have made them meanwhile
        changed = {change.file for change in self._journal.changes()}
        self._problems += [
            localized(
                QT_TR_NOOP("{file} has a hard link outside the study. The file is unchanged there: delete it there."),
                file=name,
            )
            for name in self._journal.noted("elsewhere")
            if name in changed
        ]
        self._rename_files(self._study.rglob("*"))
        self._rename_files(self._request.own_files.files())
        self._relink(path for path in self._study.rglob("*") if path.is_symlink())
        self._notify(0.85, QT_TR_NOOP("Searching all files again, byte by byte"))
        proof = self._proof(sessions)
        proof["not_looked_at"] = sorted(
            place.file for place in self._texts.places.values() if place.kind == "unexamined"
        )
        waiting = self._texts.open_places()
        if waiting:
            write_review(self._review, self._request.person_ids[0], self._words.names, waiting)
        self._journal.note(erasing=proof, waiting=len(waiting))
        return self._finish(begun, proof, len(waiting))

    # Tracks of the person

    def _find_person_tracks(self, sessions: list[Path]) -> None:
        links: list[tuple[bool, str, str]] = []
        for folder in sessions:
            with self._reporting_problems(folder):
                # Truncated recordings are repaired first, as on every opening.
                open_session(folder)
                links += links_in(folder / "events.mcap")
        self._ids = everyone_who_is(self._request.person_ids, links)
        for number, folder in enumerate(sessions):
            self._notify(0.05 * number / len(sessions), QT_TR_NOOP("Finding where the person appears"))
            with self._reporting_problems(folder):
                self._seen_in[folder] = sightings_in(folder / "events.mcap", self._ids)

    def _find_speech(self, sessions: list[Path]) -> None:
        """Collect the person's speech, before it is removed from the recording."""
        for folder in sessions:
            tracks = self._seen_in.get(folder)
            if tracks is None:
                continue
            with self._reporting_problems(folder):
                session = open_session(folder, repair=False)
                self._speech[folder] = speech = speech_in(session, self._ids, tracks)
                file = self._journal.name_of(folder / "events.mcap")
                moment = _moments_of(session)
                redacted = set(speech.theirs)
                for utterance in speech.doubtful:
                    words, where = utterance.text, moment(utterance.start_ns or 0)
                    if self._texts.note_speech(file, utterance.utterance_id, where, words) in ("redact", "remove"):
                        redacted.add(utterance.utterance_id)
                self._spoken[folder] = frozenset(redacted)
                self._sentences[folder] = sentences_of(session, redacted)
        everywhere = {text: None for sentences in self._sentences.values() for text in sentences.long}
        self._texts.sentences = Sentences(tuple(everywhere))
        self._spoken_search = ByteSearch(all_of((), self._texts.sentences.probes))

    def _work_in(self, folder: Path) -> TextWork:
        """Text search of one session, which adds the person's speech there; the list of places is shared."""
        return replace(
            self._texts,
            sentences=self._sentences.get(folder, Sentences()),
            utterances=self._spoken.get(folder, frozenset()),
        )

    def _listed(self) -> StudyFiles:
        """Files to search and change: without the database, which erases separately, and the review file."""
        listed = files_of(self._study)
        listed.files = [
            path
            for path in listed.files
            if path.name != LOCK_NAME
            and not (path.parent == self._study and path.name in PEOPLE_FILES)
            and path not in (self._review, self._request.review)
        ]
        return listed

    def _found_in(self, files: Iterable[Path]) -> dict[Path, Searched]:
        return {path: self._search.file(path) for path in files}

    def _treat_copies(self, found: dict[Path, Searched]) -> None:
        """Apply the change of one copy (covered, silenced, removed) to its other copies."""
        paths = {self._journal.name_of(path): path for path in self._listed().files}
        for names in self._journal.noted("copies"):
            changes = {change.file: change for change in self._journal.changes() if change.file in names}
            done = next((change for change in changes.values() if change.what in _OF_MEDIA), None)
            if done is None:
                continue
            for path in (paths[name] for name in names if name in paths and name not in changes):
                if done.after and done.file in paths:
                    self._journal.replace(path, "copy", partial(_copied, paths[done.file]))
                    found[path] = self._search.file(path)
                else:
                    self._journal.remove(path, "copy")
                    found.pop(path, None)

    # Media without detection

    def _inspect_unexamined(self, found: dict[Path, Searched], sessions: list[Path], exports: _Exports) -> None:
        """List archives, and media without detection that may show the person or contain their voice."""
        blind = {
            folder.name for folder in sessions if not (seen := self._seen_in.get(folder)) or not seen.detections_ns
        }
        examined = {change.file for change in self._journal.changes() if change.what == "copy"}
        for names in self._journal.noted("copies"):
            if not self._examined.isdisjoint(names):
                examined.update(names)
        for path, searched in found.items():
            if not path.exists() or self._journal.name_of(path) in examined:
                continue
            export = exports.of(path)
            if searched.closed:
                self._decide_on(path, QT_TR_NOOP("it could not be decompressed"))
            if any(path.is_relative_to(folder) for folder in sessions) or not is_opaque(path):
                continue
            tagged = path.parent == self._study / "photos" and people_in(path)
            if not tagged if export is None else exports.shown_in(export) & blind:
                self._decide_on(path, _UNEXAMINED)

    def _decide_on(self, path: Path, reason: str) -> None:
        if path.exists() and self._texts.note_unexamined(self._journal.name_of(path), reason) == "remove":
            self._journal.remove(path, "file")

    # Outside of the study

    def _in_own_files(self) -> None:
        own_files = self._request.own_files
        for path in own_files.sounds():
            self._journal.remove(path, "sound")
        for path, searched in self._found_in(own_files.files()).items():
            if own_files.is_log(path):
                count = blot_out(path, self._words, self._texts.sentences)
                if count:
                    self._journal.note(file=self._journal.name_of(path), what="log", after="-", count=count)
            elif searched.hits and own_files.is_history(path):
                self._journal.replace(path, "history", partial(without_lines, path, self._words))
            else:
                self._in_file(path, searched, self._texts)

    # Exports

    def _without_exports(self, found: dict[Path, Searched], exports: _Exports) -> dict[Path, Searched]:
        """Remove exports that name the person or show sessions in which the person was seen; return the other files."""
        seen_in = {folder.name for folder, seen in self._seen_in.items() if seen.any}
        spoke_in = {folder.name for folder, spoken in self._spoken.items() if spoken}
        sentences = Sentences(tuple({text: None for sentence in self._sentences.values() for text in sentence.texts}))
        inside: dict[Path, list[Path]] = {}
        named: set[Path] = set()
        concerned: dict[Path, None] = {}
        for path, searched in found.items():
            export = exports.of(path)
            if export is None:
                continue
            inside.setdefault(export, []).append(path)
            shown_in = exports.shown_in(export)
            if searched.hits or (shown_in & spoke_in and _may_hold(path, sentences)):
                named.add(path)
            if path in named or (path.suffix.lower() in _SHOWS and shown_in & seen_in):
                concerned[export] = None
        self._exports_named = [self._journal.name_of(path) for path in concerned]
        for export in concerned:
            for path in inside[export]:
                if not self._request.keep_exports:
                    self._journal.remove(path, "export")
                elif path in named:
                    count = max(1, len(found[path].hits))
                    self._texts.note_file(self._journal.name_of(path), "an export", count=count)
            if not self._request.keep_exports:
                _remove_empty(export)
        treated = {path for export in concerned for path in inside[export]}
        return {path: searched for path, searched in found.items() if path not in treated}

    # One session

    def _in_session(self, folder: Path, found: dict[Path, Searched], share: float) -> None:
        mine = {path: searched for path, searched in found.items() if path.is_relative_to(folder)}
        named = {path: searched for path, searched in mine.items() if searched.hits}
        tracks = self._seen_in.get(folder)
        unexamined = [path for path in mine if is_opaque(path)]
        session, problem = None, None
        try:
            session = open_session(folder, repair=False)
        except SessionError as error:
            problem = error
        else:
            looked_at = examined_media(session, tracks)
            self._examined.update(self._journal.name_of(path) for path in looked_at)
            unexamined = [
                path
                for path in unexamined
                if path not in looked_at and not path.relative_to(folder).parts[0].startswith(_OF_SESSION)
            ]
        concerned = (tracks is not None and tracks.any) or self._spoken.get(folder) or self._journal.changes_in(folder)
        if not named and not unexamined and not concerned:
            return
        if problem is not None:
            self._problems.append(_message_for(folder, problem))
        work = self._work_in(folder)
        with hold(folder):
            for path in mine:
                if path.suffix == ".mcap":
                    self._events[path] = text_erasure.inspect_events(
                        work, path, self._journal.name_of(path), _moments_of(session)
                    )
            if session is not None and tracks is not None:
                of_media = SessionMedia(session, tracks, self._ids, self._journal)
                before = self._progress_at
                if not self._request.only_texts:
                    of_media.treat_pictures(
                        self._request.recordings,
                        progress=lambda done, what: self._notify(before + 0.9 * share * done, f"{folder.name}: {what}"),
                    )
                # Before the person's speech is removed, which determines where to silence.
                spoken, speech = self._spoken.get(folder, frozenset()), self._speech.get(folder, Speech())
                named_in = frozenset().union(*(self._events[path].utterances for path in mine if path in self._events))
                audible = [
                    utterance
                    for utterance in (*speech.others, *speech.doubtful)
                    if utterance.utterance_id not in spoken
                ]
                of_media.treat_sound(self._request.recordings, named_in | spoken, audible)
                self._problems += [_message_for(folder, problem) for problem in of_media.problems]
            for path, searched in mine.items():
                if path.exists() and path not in self._events:
                    self._in_file(path, searched, work)
            for path in unexamined:
                self._decide_on(path, _UNEXAMINED)
            self._rename_files(folder.rglob("*"))

    def _in_events(self, folder: Path) -> None:
        """Rewrite the event log last, since it is the only source of the person's speech: after a kill it must still be
        found.
        """
        concerned = [path for path, events in self._events.items() if path.is_relative_to(folder)]
        work = self._work_in(folder)
        with hold(folder):
            for path in concerned:
                if self._events[path].to_change:
                    file = self._journal.name_of(path)
                    self._journal.replace(path, "text", partial(text_erasure.rewrite_events, work, path, file))
            if self._journal.changes_in(folder):
                self._seal(folder)

    def _in_file(self, path: Path, searched: Searched, work: TextWork) -> None:
        """Rewrite a file that names the person or contains their speech, or list its places."""
        file = self._journal.name_of(path)
        encoding = text_erasure.encoding_of(path)
        tagged = [hit for hit in searched.hits if hit.inside == ATTRIBUTES]
        if tagged:
            searched = replace(searched, hits=tuple(hit for hit in searched.hits if hit not in tagged))
            if self._texts.note_name(file, tagged[0].words) == "redact":
                self._journal.replace(path, "attributes", partial(_copied, path))  # which has none
        if not searched.hits and (not work.sentences.texts or is_opaque(path)):
            return
        if path.suffix == ".mcap":
            if text_erasure.inspect_events(work, path, file, str).to_change:
                self._journal.replace(path, "text", lambda part: text_erasure.rewrite_events(work, path, file, part))
            return
        if path.suffix.lower() == ".png" and all(hit.what == "name" and not hit.inside for hit in searched.hits):
            if text_erasure.inspect_photo(work, path, file):
                self._journal.replace(path, "text", lambda part: text_erasure.rewrite_photo(work, path, file, part))
            return
        if encoding is not None and all(hit.what == "name" and not hit.inside for hit in searched.hits):
            if text_erasure.inspect_text(work, path, file, encoding):
                self._journal.replace(
                    path, "text", lambda part: text_erasure.rewrite_text(work, path, file, encoding, part)
                )
            return
        hits = searched.hits or self._spoken_search.file(path).hits
        words = hits[0].words or f"a {hits[0].what}" if searched.hits else "a sentence by this person"
        if hits and work.note_file(file, words, count=len(hits)) == "remove":
            self._journal.remove(path, "text")

    def _seal(self, folder: Path) -> None:
        """Note the erasure in the session header and update the checksums."""
        header = folder / "session.json"
        try:
            recorded = read_raw_header(folder)
        except SessionError as error:
            self._problems.append(_message_for(folder, error))
            return
        if header.is_file():
            begun = self._journal.noted("begun")
            changes = self._journal.changes_in(folder)
            removed = {change.file for change in changes if not change.after}
            covered = {change.file for change in changes if change.what == "video" and change.after}
            data = dict(recorded)
            videos = data.get("videos")
            if isinstance(videos, list):
                data["videos"] = [
                    {**video, "encoder": media.ENCODER.title} if video.get("file_name") in covered else video
                    for video in videos
                    if isinstance(video, dict) and video.get("file_name") not in removed
                ]
            sounds = data.get("audio")
            if isinstance(sounds, list):
                data["audio"] = [one for one in sounds if isinstance(one, dict) and one.get("file_name") not in removed]
            files = data.get("files")
            if isinstance(files, list):
                data["files"] = [
                    {**one, "bytes": (folder / str(one["name"])).stat().st_size}
                    for one in files
                    if isinstance(one, dict) and (folder / str(one.get("name"))).is_file()
                ]
            forgotten = data.get("forgotten")
            dates = [str(date) for date in forgotten] if isinstance(forgotten, list) else []
            data["forgotten"] = [*dates, *([] if begun in dates else [begun])]
            if any(change.what == "text" and change.file.endswith(".mcap") for change in changes):
                _report_checksum_of_scenario(data, folder)
            content = (json.dumps(data, indent=2, ensure_ascii=False) + "\n").encode("utf-8", "replace")
            if content != header.read_bytes():
                self._journal.replace(header, "header", lambda part: part.write_bytes(content) and 1)
        if (folder / MANIFEST_NAME).exists():
            write_manifest(folder)

    # The rest of the study

    def _in_database(self) -> None:
        """List the places in texts about other people in the study's database, and replace those to redact."""
        found: list[tuple[int, int, Decision]] = []
        for whose, text in self._texts_in_database():
            if whose not in self._request.person_ids:  # theirs are deleted anyway
                found += self._texts.find(text, _PEOPLE, lambda whose=whose: f"data stored about {whose}")  # type: ignore[misc]
        if any(decision == "redact" for _, _, decision in found):
            self._request.texts_of_people(lambda _whose, text: self._texts.redact(text, _PEOPLE, yaml=False)[0])

    def _texts_in_database(self) -> list[tuple[str, str]]:
        """Owner and content of each text in the study's database."""
        texts: list[tuple[str, str]] = []

        def read(whose: str, text: str) -> str:
            texts.append((whose, text))
            return text

        self._request.texts_of_people(read)
        return texts

    def _rename_files(self, paths: Iterable[Path]) -> None:
        """Rename files and folders that name the person, deepest first."""
        for path in sorted(paths, key=lambda path: -len(path.parts)):
            new = self._without_names(path.name)
            if new == path.name:
                continue
            if self._texts.note_name(self._journal.name_of(path), path.name) == "redact":
                path.rename(free_path(renamed := path.with_name(new), renamed.suffix))

    def _relink(self, links: Iterable[Path]) -> None:
        """Redact the targets of links to files that were renamed or are missing."""
        for link in links:
            target = str(link.readlink())
            new = self._without_names(target)
            if new == target or self._texts.note_name(self._journal.name_of(link), target) != "redact":
                continue
            if link.exists():
                self._problems.append(
                    localized(
                        QT_TR_NOOP(
                            "{file} leads to a path that names the person. Rename the path, then correct {file}."
                        ),
                        file=self._journal.name_of(link),
                    )
                )
            else:
                link.unlink()
                link.symlink_to(new)

    def _without_names(self, text: str) -> str:
        changed, _ = text_erasure.redacted(
            text, [(start, end, "redact") for start, end in self._words.spans(text)], yaml=False
        )
        return changed

    # The end

    def _proof(self, sessions: list[Path]) -> dict[str, Any]:
        """Search every byte of the study and of the user's own files; the database is searched after its erasure."""
        found = self._found_in([*self._listed().files, *self._request.own_files.files()])
        # The sentence may be another person's in another session.
        spoken = {
            path: self._spoken_search.file(path)
            for path in found
            if not is_opaque(path) and not any(path.is_relative_to(folder) for folder in sessions)
        }
        for folder, sentences in self._sentences.items():
            search = ByteSearch(all_of((), sentences.probes))
            spoken |= {path: search.file(path) for path in found if path.is_relative_to(folder) and not is_opaque(path)}
        waiting = {place.file for place in self._texts.open_places()}
        left, retained, still = [], 0, 0
        for path, searched in found.items():
            hits = [*searched.hits, *(spoken[path].hits if path in spoken else ())]
            if not hits:
                continue
            file = self._journal.name_of(path)
            if file in waiting:
                still += len(hits)
            elif self._texts.retains_name(file):
                retained += len(hits)
            else:
                left.append(file)
        return {
            **_counts(found.values()),
            "sentences": sum(len(one.hits) for one in spoken.values()),
            "files": len(found),
            "bytes": sum(searched.searched_bytes for searched in found.values()),
            "kept_by_decision": retained,
            "waiting_for_decision": still,
            "left": left,
            "not_unpacked": [
                f"{self._journal.name_of(path)}: {self._without_names(what)}"
                for path, searched in found.items()
                for what in searched.closed
            ],
        }

    def _finish(self, begun: str, proof: dict[str, Any], waiting: int) -> Forgotten:
        self._notify(0.97, QT_TR_NOOP("Erasing the person from the study database"))
        self._erase()
        database = [path for path in self._study.glob(f"{_PEOPLE}*") if path.is_file()]
        in_database = sum(len(self._search.file(path).hits) for path in database) + sum(
            self._texts.redact(text, _PEOPLE, yaml=False)[0] != text for _, text in self._texts_in_database()
        )
        left = [*proof["left"], *([_PEOPLE] if in_database else [])]
        outcome = Forgotten(
            self._study / FOLDER / RECEIPT,
            self._review if waiting else None,
            waiting,
            tuple(left),
            tuple(dict.fromkeys(self._problems)),
            tuple(proof["not_unpacked"]),
            tuple(proof.get("not_looked_at", ())) if waiting else (),
        )
        self._write_receipt(outcome, begun, proof, in_database)
        if not waiting:
            # Its removal is recorded in itself, since it contains the name.
            for review in (self._review, self._request.review):
                if review is not None:
                    review.unlink(missing_ok=True)
        self._journal.end()
        self._notify(1.0, QT_TR_NOOP("Done"))
        return outcome

    def _write_receipt(self, outcome: Forgotten, begun: str, proof: dict[str, Any], in_database: int) -> None:
        path = outcome.receipt
        changes = self._journal.changes()
        doubtful = [place for place in self._texts.places.values() if place.kind == "speech"]
        decided = [self._texts.decided(place) for place in doubtful]
        theirs = sum(len(of.theirs) for of in self._speech.values())
        receipt = {
            "complete": outcome.complete,
            "begun_utc": begun,
            "ended_utc": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
            "resumed": self._journal.resumed,
            "recordings": self._request.recordings,
            "steps": _steps(changes),
            "waiting_for_decision": outcome.waiting,
            "utterances": {
                "theirs_removed": theirs,
                "nobodys_removed": sum(map(len, self._spoken.values())) - theirs,
                "nobodys_kept": decided.count("keep"),
                "nobodys_waiting": decided.count(""),
            },
            "exports_concerned": self._exports_named,
            "problems": [self._without_names(problem) for problem in self._problems],
            "search_before": self._journal.noted("found"),
            "search_after": {**proof, "in_people_database": in_database},
            "files": [
                {"file": change.file, "what": change.what, "removed": not change.after, "count": change.count}
                for change in sorted(changes, key=lambda change: (change.file, change.what))
            ],
        }
        content = {"format": _FORMAT, "format_version": _FORMAT_VERSION, "receipts": [*_receipts_in(path), receipt]}
        text = json.dumps(content, indent=2, ensure_ascii=False) + "\n"
        # Names of files that are not UTF-8 become escapes of JSON.
        replace_file(path, text.encode("utf-8", "backslashreplace"), durable=True)

    _progress_at = 0.0

    def _notify(self, fraction: float, what: str) -> None:
        self._progress_at = fraction
        # Translatable texts with values contain no names.
        self._progress(min(1.0, fraction), what if isinstance(what, LocalizedText) else self._without_names(what))

    @contextlib.contextmanager
    def _reporting_problems(self, folder: Path) -> Iterator[None]:
        """Report problems of one session and continue with the others."""
        try:
            yield
        except SessionError as error:
            self._problems.append(_message_for(folder, error))
        except FileNotFoundError as error:
            self._problems.append(_message_for(folder, localized(QT_TR_NOOP("{file} is missing"), file=error.filename)))


def _message_for(folder: Path, message: object) -> LocalizedText:
    return localized(QT_TR_NOOP("{name}: {told}"), name=folder.name, told=message)


def _may_hold(path: Path, sentences: Sentences) -> bool:
    """True if an export file may contain one of these sentences. Binary files may contain them undetected."""
    encoding = text_erasure.encoding_of(path)
    if encoding is None:
        return path.suffix.lower() not in _PICTURES
    return any(next(sentences.spans(line), None) is not None for line in text_erasure.lines_of(path, encoding))


def _copied(source: Path, part: Path) -> int:
    shutil.copyfile(source, part)
    return 1


def receipt_words(path: Path) -> str:
    """Summary of the newest receipt as a sentence. Raises OSError."""
    newest: dict[str, Any] = next(reversed(_receipts_in(path)), {})
    steps, after, counts = newest.get("steps", {}), newest.get("search_after", {}), newest.get("utterances", {})
    done = [
        f"{count} {kind if count == 1 else kinds} {verb}"
        for what, kind, kinds in _KINDS
        for verb in ("changed", "removed")
        if (count := steps.get(what, {}).get(verb, 0))
    ]
    found = sum(after.get(what, 0) for what in ("names", "pictures", "sentences", "in_people_database"))
    speech = (
        f" Removed {counts.get('theirs_removed', 0)} utterances by this person and {counts.get('nobodys_removed', 0)} "
        f"that may be; {counts.get('nobodys_kept', 0)} retained, {counts.get('nobodys_waiting', 0)} undecided."
        if any(counts.values())
        else ""
    )
    searched = f"{after.get('bytes', 0) / 1e6:.0f} MB in {after.get('files', 0)} files were searched byte by byte"
    return f"{', '.join(done) or 'No recording had to be changed'}. {searched}: {found} matches.{speech}"


def _moments_of(session: Session | None) -> Callable[[int], str]:
    if session is None:
        return str
    clock = session.clock
    return lambda stamp_ns: clock_text(clock.session_s(stamp_ns))


def _report_checksum_of_scenario(header: dict[str, Any], folder: Path) -> None:
    """Update the checksum of the scenario's text to the recorded one."""
    entry = header.get("scenario")
    opened = [parse_json(data) for _, data in messages_of(folder / "events.mcap", lambda topic: topic == _SCENARIO)]
    checksums = {str(event.get("file_name")): str(event.get("sha256")) for event in opened}
    if isinstance(entry, dict) and entry.get("sha256") not in checksums.values():
        header["scenario"] = {**entry, "sha256": checksums.get(str(entry.get("file")), "")}


def _steps(changes: list[Change]) -> dict[str, dict[str, int]]:
    """Changed and removed files per kind of step, with the number of places or images."""
    steps: dict[str, dict[str, int]] = {}
    for change in changes:
        step = steps.setdefault(change.what, {"changed": 0, "removed": 0, "places": 0})
        step["changed" if change.after else "removed"] += 1
        step["places"] += change.count
    return steps


def _counts(found: Any) -> dict[str, int]:
    hits = [hit.what for searched in found for hit in searched.hits]
    return {"names": hits.count("name"), "pictures": hits.count("picture")}


def _receipts_in(path: Path) -> list[Any]:
    try:
        stored = parse_json(path.read_bytes())["receipts"]
    except FileNotFoundError:
        return []
    except (ValueError, KeyError, TypeError):
        _log.warning("%s cannot be read and is begun anew", path, exc_info=True)
        return []
    receipts = stored if isinstance(stored, list) else []
    for receipt in receipts:
        for file in receipt.get("files", ()) if isinstance(receipt, dict) else ():
            # Earlier versions wrote checksums, from which names can be guessed.
            if isinstance(file, dict) and "after" in file:
                file["removed"] = not file.pop("after")
                file.pop("before", None)
    return receipts


def _remove_empty(folder: Path) -> None:
    """Remove empty folders inside and above ``folder``."""
    folders = sorted((path for path in folder.rglob("*") if path.is_dir()), key=lambda path: -len(path.parts))
    for path in (*folders, folder, folder.parent):
        with contextlib.suppress(OSError):  # not empty
            path.rmdir()


@contextlib.contextmanager
def _explained(study: Path) -> Iterator[None]:
    try:
        yield
    except FolderHeldError as error:
        raise ErasureStoppedError(
            localized(QT_TR_NOOP("{file} is currently in use."), file=error.filename),
            _NOT_CHANGED,
            QT_TR_NOOP("Try again when it is no longer in use."),
        ) from error
    except OSError as error:
        if no_room(error):
            raise ErasureStoppedError(
                QT_TR_NOOP("The disk is full."),
                _IN_THE_MIDDLE,
                QT_TR_NOOP(
                    "Free as much disk space as the study's largest video or audio file takes, then try "
                    "again: erasing resumes where it stopped."
                ),
            ) from error
        raise ErasureStoppedError(
            localized(
                QT_TR_NOOP("{file} cannot be read or written: {why}."),
                file=error.filename or study,
                why=error.strerror or error,
            ),
            _IN_THE_MIDDLE,
            QT_TR_NOOP("Make the file accessible, then try again: erasing resumes where it stopped."),
        ) from error
