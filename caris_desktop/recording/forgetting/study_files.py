"""Files of a study's folder, following links inside the study, and duplicates by content."""

import hashlib
import lzma
import os
import tarfile
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import field
from pathlib import Path

from caris_desktop.domain.value_class import dataclass
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
_SESSIONS = "sessions"
_SQLITE_MAGIC, _SQLITE_HEAD_BYTES = b"SQLite format 3\x00", 100
PEOPLE_APPLICATION_ID = 0x43615065
"""By which SQLite files of a study's people are known."""
PEOPLE_FILES = ("people.sqlite", "people.sqlite-wal", "people.sqlite-shm", "people.sqlite-journal")
"""The study's database, erased separately."""
_TAR = ".tar"
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
                target = path.resolve()
                inside = target.is_relative_to(home)
                recorded = path.is_dir() and (is_session(path) or path == study / _SESSIONS)
                if recorded:
                    waiting.append(path)
                elif not inside and path.exists():
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
    if path.suffix.lower() in (*MEDIA, *_CLOSED) or _is_people_database(path):
        return True
    packed: list[str] = []
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                packed = archive.namelist()
        elif _TAR in path.name.lower() or path.suffix.lower() == ".tgz":
            with tarfile.open(path) as archive:
                packed = archive.getnames()
    except (zipfile.BadZipFile, tarfile.TarError, EOFError, zlib.error, lzma.LZMAError):
        return True
    return any(name.lower().endswith((*MEDIA, *_CLOSED)) for name in packed)


def _is_people_database(path: Path) -> bool:
    """True for a copy of a people database: its data is encrypted, with the keys inside."""
    with path.open("rb") as file:
        head = file.read(_SQLITE_HEAD_BYTES)
    return head.startswith(_SQLITE_MAGIC) and head[68:72] == PEOPLE_APPLICATION_ID.to_bytes(4, "big")


def copies_in(files: Iterable[Path]) -> list[list[Path]]:
    """Groups of media files with equal content. Raises OSError."""
    by_size: dict[int, list[Path]] = {}
    for path in files:
        by_size.setdefault(path.stat().st_size, []).append(path)
    groups: list[list[Path]] = []
    for size_bytes, alike in by_size.items():
        if size_bytes and len(alike) > 1 and any(path.suffix.lower() in MEDIA for path in alike):
            groups += _same_bytes(alike)
    return groups


def _same_bytes(files: list[Path]) -> Iterator[list[Path]]:
    by_digest: dict[bytes, list[Path]] = {}
    for path in files:
        with path.open("rb") as file:
            by_digest.setdefault(hashlib.file_digest(file, "sha256").digest(), []).append(path)
    yield from (same for same in by_digest.values() if len(same) > 1)


def names_elsewhere(files: Iterable[Path]) -> list[Path]:
    """Files with a hard link from outside of ``files``. Raises OSError."""
    counted: dict[tuple[int, int], list[Path]] = {}
    links: dict[tuple[int, int], int] = {}
    for path in files:
        stat = path.stat()
        if stat.st_nlink > 1:
            counted.setdefault((stat.st_dev, stat.st_ino), []).append(path)
            links[stat.st_dev, stat.st_ino] = stat.st_nlink
    return [path for key, paths in counted.items() if len(paths) < links[key] for path in paths]
