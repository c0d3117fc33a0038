"""Files that an erasure searches and changes, of the study and of the user elsewhere, and its journal.

With the journal, which holds no personal data, an erasure can resume after a kill at any time.
"""

import hashlib
import json
import logging
import os
import re
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import field, replace
from pathlib import Path
from typing import Any

from caris_desktop.domain.file_replacement import SHOWN_CHARACTERS, bring_to_disk
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.recording.forgetting.byte_search import is_damage, opener_of
from caris_desktop.recording.forgetting.text_erasure import PersonNames, Sentences
from caris_desktop.recording.session.manifest import digest_of
from caris_desktop.recording.session.session_header import is_session

MEDIA = (
    ".mp4", ".mkv", ".webm", ".mov", ".avi", ".m4v", ".wmv", ".mpg", ".mpeg", ".ts", ".wav", ".flac", ".mp3", ".ogg",
    ".oga", ".opus", ".m4a", ".aac", ".wma", ".aif", ".aiff", ".png", ".jpg", ".jpeg", ".gif", ".bmp", ".tif", ".tiff",
    ".webp", ".heic", ".avif", ".pcm", ".bag", ".db3",
)  # fmt: skip
"""How names of files end that hold film, sound or pictures."""
_CLOSED = (
    ".7z", ".rar", ".lz4", ".br", ".iso", ".img", ".dmg", ".pdf", ".feather", ".arrow", ".h5", ".hdf5", ".duckdb",
    ".gpg", ".age", ".enc", ".kdbx",
)  # fmt: skip
"""Of files whose content is packed in a way that the search for bytes does not unpack."""
_BEGINNINGS = (
    b"\xff\xd8\xff", b"\x89PNG", b"GIF8", b"II*\0", b"MM\0*", b"\x1aE\xdf\xa3", b"\0\0\1\xba", b"\0\0\1\xb3", b"FLV\1",
    b"\x30\x26\xb2\x75", b"RIFF", b"OggS", b"fLaC", b"ID3\2", b"ID3\3", b"ID3\4", b"\xff\xfb", b"\xff\xf3", b"\xff\xf1",
    b"caff\0", b"#!AMR", b"#ROSBAG", b"7z\xbc\xaf", b"Rar!", b"\4\x22\x4d\x18", b"\x5d\0\0", b"\x1f\x9d", b"%PDF",
    b"\x89HDF", b"ARROW1", b"age-encryption", b"-----BEGIN PGP", b"MATLAB 5.0 MAT", b"$FL3", b"PACK\0\0\0", b"MSCF",
    b"\xd0\xcf\x11\xe0", b"!BDN", b"LZIP", b"hsqs", b"xar!", b"8BPS", b"\xff\x0a", b"\0\0\0\x0cJXL ",
)  # fmt: skip
"""First bytes of files of both kinds, since a copy may have any name."""
_EMBEDDED = re.compile(
    rb"(?:image|audio|video)/[\w.+-]+(?:;base64,|\"\s*:)|<binary |^PHOTO[;:]|\\pict\b"
    rb"|^Content-Transfer-Encoding: *base64",
    re.IGNORECASE | re.MULTILINE,
)
"""A picture, sound or packed text within a text: a web page, notebook, e-mail, book, address card or RTF."""
_BLOCK_BYTES, _OVERLAP_BYTES = 1 << 20, 256
_ARCHIVES = (".zip", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".zst", ".docx", ".xlsx", ".pptx", ".odt", ".ods", ".odp")
_SESSIONS = "sessions"
_SQLITE_MAGIC, _HEAD_BYTES = b"SQLite format 3\x00", 512
PEOPLE_APPLICATION_ID = 0x43615065
"""By which SQLite files of a study's people are known."""
PEOPLE_FILES = ("people.sqlite", "people.sqlite-wal", "people.sqlite-shm", "people.sqlite-journal")
"""The study's database, erased separately."""
_OF_EXPORT = "export-"


@dataclass(slots=True)
class StudyFiles:
    """``files`` and ``sessions`` by path; ``refused`` are links out of the study with their targets.

    A link to a folder of sessions, or to one session, is followed: its target belongs to the study. Other links are
    not, since their targets may be unrelated.
    """

    files: list[Path] = field(default_factory=list)
    sessions: list[Path] = field(default_factory=list)
    refused: list[tuple[Path, Path]] = field(default_factory=list)


def files_of(study: Path) -> StudyFiles:
    """List the study's files. Raises OSError."""
    found = StudyFiles()
    home = study.resolve()
    been: set[Path] = set()
    waiting = [study]
    while waiting:
        folder = waiting.pop()
        real = folder.resolve()
        if real in been:
            continue
        been.add(real)
        if is_session(folder) and not any(part.startswith(_OF_EXPORT) for part in folder.relative_to(study).parts):
            found.sessions.append(folder)
        for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
            path = Path(entry.path)
            if entry.is_symlink():
                target = Path(os.path.realpath(path))  # resolve() fails for a link to itself before Python 3.13
                if path.is_dir() and (is_session(path) or path == study / _SESSIONS):
                    waiting.append(path)
                elif not target.is_relative_to(home) and path.exists():
                    found.refused.append((path, target))
            elif entry.is_dir(follow_symlinks=False):
                waiting.append(path)
            elif entry.is_file(follow_symlinks=False):
                found.files.append(path)
    found.files.sort()
    found.sessions.sort()
    return found


def is_opaque(path: Path) -> bool:
    """True if a file may show or contain a person undetected by a byte search. Raises OSError."""
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if path.suffix.lower() in (*MEDIA, *_CLOSED) or _is_people_database(head) or _is_of_content(head):
        return True
    packed: list[str] = []
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                packed = archive.namelist()
        elif tarfile.is_tarfile(path):
            with tarfile.open(path) as archive:
                packed = archive.getnames()
        elif (opener := opener_of(head)) is not None:
            with path.open("rb") as file, opener(file) as unpacked:
                return _is_of_content(unpacked.read(_HEAD_BYTES))
    except Exception as error:
        if not is_damage(error):
            raise
        return True
    if any(name.lower().endswith((*MEDIA, *_CLOSED, *_ARCHIVES)) for name in packed):
        return True
    return b"\0" not in head and _has_embedded(path)


def _has_embedded(path: Path) -> bool:
    with path.open("rb") as file:
        before = b""
        while block := file.read(_BLOCK_BYTES):
            if _EMBEDDED.search(before + block):
                return True
            before = block[-_OVERLAP_BYTES:]
    return False


def _is_of_content(head: bytes) -> bool:
    """True for media and packed content by its first bytes, since a copy may have any name."""
    return (
        head.startswith(_BEGINNINGS)
        or head[4:8] in (b"ftyp", b"jP  ")
        or head[8:12] in (b"AIFF", b"AIFC", b"DUCK")
        or b"GGG" in (head[0:377:188], head[4:389:192])  # packets of MPEG transport streams
        or _is_zlib(head)
    )


def _is_zlib(head: bytes) -> bool:
    """True for a bare zlib stream, as Git's history of a study is made of."""
    try:
        return head.startswith(b"x") and bool(zlib.decompressobj().decompress(head))
    except zlib.error:
        return False


def _is_people_database(head: bytes) -> bool:
    """True for a copy of a people database: its data is encrypted, with the keys inside."""
    return head.startswith(_SQLITE_MAGIC) and head[68:72] == PEOPLE_APPLICATION_ID.to_bytes(4, "big")


def copies_in(files: Iterable[Path]) -> list[list[Path]]:
    """Groups of media files with equal content. Raises OSError."""
    by_size: dict[int, list[Path]] = {}
    for path in files:
        by_size.setdefault(path.stat().st_size, []).append(path)
    by_digest: dict[str, list[Path]] = {}
    for size_bytes, alike in by_size.items():
        if size_bytes and len(alike) > 1 and any(path.suffix.lower() in MEDIA for path in alike):
            for path in alike:
                by_digest.setdefault(digest_of(path), []).append(path)
    return [same for same in by_digest.values() if len(same) > 1]


def names_elsewhere(files: Iterable[Path]) -> list[Path]:
    """Files with a hard link from outside of ``files``. Raises OSError."""
    counted: dict[tuple[int, int, int], list[Path]] = {}
    for path in files:
        stat = path.stat()
        counted.setdefault((stat.st_nlink, stat.st_dev, stat.st_ino), []).append(path)
    return [path for (links, *_), paths in counted.items() if len(paths) < links for path in paths]


_log = logging.getLogger(__name__)
FOLDER = "forgotten"
PART = ".forgetting.part"


class Change(Value):
    """Change of one file. ``after`` is the SHA-256 of its new content, empty if removed.

    The old digest is not recorded: a name could be guessed from it by trial.
    """

    file: str
    what: str
    after: str
    count: int = 0


class Journal:
    """JSON lines in ``STUDY/forgotten``, each flushed to disk before its action. Methods raise OSError."""

    def __init__(self, study: Path, person_id: str, *, without_names: Callable[[str], str]) -> None:
        """``without_names`` redacts file names, which may contain anything."""
        self._study = study
        self._without_names = without_names
        self.path = path_of(study, person_id)
        self.resumed = self.path.exists()
        self._lines: list[dict[str, Any]] = []
        self._changes: dict[tuple[str, str], Change] = {}
        self._left: set[str] = set()
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self.resumed:
            content = self.path.read_bytes()
            complete = content[: content.rfind(b"\n") + 1]
            for line in complete.splitlines():
                self._remember(parse_json(line))
            if len(complete) < len(content):
                # A kill truncated the last line; its action did not happen.
                with self.path.open("r+b") as file:
                    file.truncate(len(complete))
        else:
            self.path.touch()
            bring_to_disk(self.path.parent)

    def note(self, **entry: Any) -> None:
        with self.path.open("ab") as file:
            file.write(json.dumps(entry, separators=(",", ":")).encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        self._remember(entry)

    def noted(self, key: str) -> Any:
        """Last noted value of ``key``; None if there is none."""
        return next((line[key] for line in reversed(self._lines) if key in line), None)

    def changes(self) -> list[Change]:
        """Last completed change of each file and kind."""
        return list(self._changes.values())

    def changes_in(self, folder: Path) -> list[Change]:
        """Those of files in ``folder``, named relative to it."""
        inside = f"{self.name_of(folder)}/"
        found = (change for change in self._changes.values() if change.file.startswith(inside))
        return [replace(change, file=change.file.removeprefix(inside)) for change in found]

    def was_done(self, path: Path, what: str) -> bool:
        """True if the change was made and the file is still as it left it."""
        change = self._changes.get((self.name_of(path), what))
        if change is None:
            return False
        try:
            # Or as a later step left it.
            return digest_of(path) in self._left
        except FileNotFoundError:
            return change.after == ""

    def replace(self, path: Path, what: str, make: Callable[[Path], int]) -> None:
        """Replace a file by what ``make`` writes to the given path; ``make`` returns the number of changes.

        The old file stays if that fails.
        """
        # Not replace_file: videos are written by another program to a path, and the journal entry must come between the
        # completion of the new file and the replacement of the old.
        part = path.with_name(f".{path.name[:SHOWN_CHARACTERS]}{PART}")
        part.unlink(missing_ok=True)
        try:
            count = make(part)
            bring_to_disk(part)
            part.chmod(path.stat().st_mode & 0o7777)
            self.note(file=self.name_of(path), what=what, after=digest_of(part), count=count)
            part.replace(path)
        except BaseException:
            part.unlink(missing_ok=True)
            raise
        bring_to_disk(path.parent)

    def remove(self, path: Path, what: str) -> None:
        self.note(file=self.name_of(path), what=what, after="", count=1)
        path.unlink()

    def name_of(self, path: Path) -> str:
        """Path of the file in the study, or of the user's other files relative to their home folder."""
        if path.is_relative_to(self._study):
            return self._without_names(path.relative_to(self._study).as_posix())
        home = Path.home()
        return self._without_names(f"~/{path.relative_to(home).as_posix()}" if path.is_relative_to(home) else str(path))

    def end(self) -> None:
        self.path.unlink(missing_ok=True)
        bring_to_disk(self.path.parent)

    def _remember(self, entry: dict[str, Any]) -> None:
        self._lines.append(entry)
        if "file" in entry:
            entry = {key: value for key, value in entry.items() if key != "before"}  # written by older versions
            change = Change(**entry)
            self._changes[change.file, change.what] = change
            self._left.add(change.after)


def path_of(study: Path, person_id: str) -> Path:
    """Path of this person's journal while the erasure is in progress."""
    plain = hashlib.sha256(person_id.encode()).hexdigest()[:12]
    return study / FOLDER / f"under-way-{plain}.jsonl"


def first_line_of(journal: Path) -> dict[str, Any]:
    """First line of a journal. Raises OSError."""
    with journal.open("rb") as file:
        line = file.readline()
    first = parse_json(line) if line.endswith(b"\n") else {}
    return first if isinstance(first, dict) else {}


class OwnFiles(Value):
    """Their locations. ``histories`` contain typed sentences, ``logs`` may be written at any time.

    ``voices`` contain robot speech audio left by a killed program. ``others`` are treated like study files, except for
    ``excepted``.
    """

    histories: Path | None = None
    logs: Path | None = None
    voices: tuple[Path, ...] = ()
    others: tuple[Path, ...] = ()
    excepted: tuple[Path, ...] = field(default=())

    def files(self) -> list[Path]:
        """All files except the audio. Raises OSError."""
        folders = [folder for folder in (self.histories, self.logs, *self.others) if folder is not None]
        found = {path for folder in folders for path in _files_in(folder)}
        return sorted(path for path in found if not any(path.is_relative_to(folder) for folder in self.excepted))

    def is_history(self, path: Path) -> bool:
        return self.histories is not None and path.is_relative_to(self.histories)

    def is_log(self, path: Path) -> bool:
        return self.logs is not None and path.is_relative_to(self.logs)

    def sounds(self) -> list[Path]:
        """The audio; not behind links, which another user may have put into the folder for temporary files."""
        return sorted(path for folder in self.voices if not folder.is_symlink() for path in _files_in(folder))


def _files_in(folder: Path) -> Iterator[Path]:
    return (path for path in folder.rglob("*") if not path.is_symlink() and path.is_file())


def without_lines(path: Path, words: PersonNames, target: Path) -> int:
    """Rewrite a file without the lines that name the person; return their number. Raises OSError."""
    dropped = 0
    with target.open("wb") as written:
        for line in path.read_bytes().splitlines(keepends=True):
            if next(words.spans(line.decode("utf-8", "surrogateescape")), None) is None:
                written.write(line)
            else:
                dropped += 1
    return dropped


def blot_out(path: Path, words: PersonNames, sentences: Sentences) -> int:
    """Overwrite names and sentences in a log in place, since a running program appends to this very file.

    Returns their number. Raises OSError.
    """
    count, at = 0, 0
    with path.open("r+b") as file:
        for line in file.read().splitlines(keepends=True):
            text = line.decode("utf-8", "surrogateescape")
            for start, end in (*words.spans(text), *sentences.spans(text)):
                before, name = (part.encode("utf-8", "surrogateescape") for part in (text[:start], text[start:end]))
                file.seek(at + len(before))
                file.write(b"-" * len(name))
                count += 1
            at += len(line)
    return count
