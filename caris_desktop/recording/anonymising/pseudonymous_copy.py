"""Copy of a session's files as they are, but for the names that its reader replaces: wizards, coders, addresses."""

import json
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path

from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_editing import AnnotationError, with_coders_called
from caris_desktop.recording.annotation.annotation_store import coding_jsonable, load_coding
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.session.events_file import copy_changed, intact_blocks, scan
from caris_desktop.recording.session.manifest import MANIFEST_NAME, digest_of, manifest_entries, session_files
from caris_desktop.recording.session.session_header import HEADER_NAME
from caris_desktop.recording.session.session_reader import Session

CODINGS = "annotations/"
_EVENTS = "events.mcap"
# Session headers, including those from before a repair.
_HEADS = re.compile(r"session\.json|recovered/[^/]*session\.json[^/]*")
_TEXTS = (".json", ".txt", ".csv", ".yaml", ".md")
_MAX_TEXT_BYTES = 64 * 1024 * 1024
_BLOCK_BYTES, _COPIED_AT_ONCE_BYTES = 1 << 20, 1 << 24


class CopiedFile(Value):
    """One file of the copy. ``changed``: with pseudonyms; ``unlike_manifest``: changed since the session closed."""

    name: str
    size_bytes: int
    sha256: str
    changed: bool
    unlike_manifest: bool


def copy_session(
    session: Session, folder: Path, warn: Callable[[str], None], progress: Callable[[float], None]
) -> Iterator[CopiedFile]:
    """Copy all files of a session, its manifest and annotations into ``folder``, and yield each.

    With pseudonyms, the header has the sizes of the copies, and the manifest their checksums, unless a file was changed
    after the session closed. ``warn`` gets a sentence for each file that is left out. Raises OSError.
    """
    names = session_files(session.folder)
    manifest: dict[str, str] = {}
    if (session.folder / MANIFEST_NAME).is_file():
        manifest |= filter(None, manifest_entries(session.folder))
        names.append(MANIFEST_NAME)
    names += sorted(
        f"{CODINGS}{path.name}"
        for path in (session.folder / CODINGS).glob("*.json")
        if path.is_file() and not path.is_symlink() and not path.name.startswith(".")
    )
    if session.pseudonymised:
        # The header contains the sizes of the copies, so it comes late.
        names.sort(key=lambda name: (name == MANIFEST_NAME, name == HEADER_NAME, bool(_HEADS.fullmatch(name))))
    sizes = {name: (session.folder / name).stat().st_size for name in names}
    total_bytes, done = max(1, sum(sizes.values())), 0
    new_checksums: dict[str, tuple[str, str]] = {}
    sizes_anew: dict[str, tuple[str, int]] = {}

    def copied(count: int) -> None:
        nonlocal done
        done += count
        progress(min(1.0, done / total_bytes))

    for name in names:
        source, original, changed = session.folder / name, "", False
        try:
            new_name, content = _pseudonymous(session, name) if session.pseudonymised else (name, None)
        except _ExcludedError as error:
            new_checksums[name], sizes_anew[name] = (digest_of(source, copied), ""), ("", 0)
            warn(localized(str(error), file=name))
            continue
        target = folder / new_name
        target.parent.mkdir(parents=True, exist_ok=True)
        if name == HEADER_NAME and sizes_anew:
            content = _with_sizes(content or source.read_bytes(), sizes_anew)
        if content is not None:
            target.write_bytes(content)
            original = digest_of(source)
        elif session.pseudonymised and name == _EVENTS and _copy_scrubbed(session, source, target):
            original = digest_of(source)
        elif name == MANIFEST_NAME and new_checksums:
            target.write_bytes(_manifest_renewed(source.read_bytes(), new_checksums))
            changed = True
        else:
            copy_file(source, target)
        sha256 = digest_of(target, copied)
        if original:
            new_checksums[name] = original, sha256
            sizes_anew[name] = new_name, target.stat().st_size
        yield CopiedFile(
            name=new_name,
            size_bytes=target.stat().st_size,
            sha256=sha256,
            changed=changed or bool(original),
            unlike_manifest=manifest.get(name, original or sha256) != (original or sha256),
        )


def copy_file(source: Path, target: Path) -> None:
    """Copy to a separate file, sharing disk blocks (copy on write) where supported."""
    with source.open("rb") as original, target.open("wb") as copy:
        if hasattr(os, "copy_file_range"):
            try:
                while os.copy_file_range(original.fileno(), copy.fileno(), _COPIED_AT_ONCE_BYTES):
                    pass
            except OSError:
                # Not supported between these disks: start over with a plain copy.
                original.seek(0)
                copy.seek(0)
                copy.truncate()
        # Empty if copy_file_range copied everything.
        while block := original.read(_BLOCK_BYTES):
            copy.write(block)


_FOUND = QT_TR_NOOP("{file} is excluded from the archive: it was saved by a repair and may reveal where the robot is.")
_LARGE = QT_TR_NOOP("{file} is excluded from the archive: it is too large to search for names.")
_DAMAGED = QT_TR_NOOP("{file} is excluded from the archive: it is damaged and may contain the wizard's name.")
_CODER_DAMAGED = QT_TR_NOOP("{file} is excluded from the archive: it is damaged and may contain a coder's name.")


class _ExcludedError(Exception):
    """File that must not be in the copy; the text says why."""


def _pseudonymous(session: Session, name: str) -> tuple[str, bytes | None]:
    """Name of a file in the copy, and its content if that changes. Raises _ExcludedError."""
    path = session.folder / name
    if name.startswith("recovered/") and ".mcap" in name:
        raise _ExcludedError(_FOUND)
    if not name.endswith(_TEXTS) and not _HEADS.fullmatch(name):
        return name, None
    if path.stat().st_size > _MAX_TEXT_BYTES:
        raise _ExcludedError(_LARGE)
    content = path.read_bytes()
    changed = session.scrub(content)
    try:
        if _HEADS.fullmatch(name):
            changed = _with_pseudonym(changed, session.wizard_name)
        elif name.startswith(CODINGS):
            coder, coding = renamed_coding(path, session.coder_name)
            if f"{CODINGS}{coder}.json" != name:
                return f"{CODINGS}{coder}.json", session.scrub(coding)
    except (ValueError, RecursionError, AnnotationError) as error:
        raise _ExcludedError(_DAMAGED if _HEADS.fullmatch(name) else _CODER_DAMAGED) from error
    return name, None if changed == content else changed


def renamed_coding(path: Path, name_of: Callable[[str], str]) -> tuple[str, bytes]:
    """Pseudonym of a coder, and their annotations under it. Raises AnnotationError."""
    document, coder = load_coding(path)
    content = coding_jsonable(with_coders_called(document, name_of), name_of(coder))
    return name_of(coder), (json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _copy_scrubbed(session: Session, source: Path, target: Path) -> bool:
    """Copy the recording without robot addresses; False, and nothing written, if there are none."""
    with source.open("rb") as file:
        index = scan(file, thorough=False)
        if not any(session.scrub(content) != content for content in intact_blocks(file, index)):
            return False
        with DiskFile(target) as copy:
            copy_changed(file, index, copy, lambda _channel, data: session.scrub(data))
    return True


def _with_sizes(head: bytes, anew: dict[str, tuple[str, int]]) -> bytes:
    """Session header with names and sizes of the copies; files left out are dropped."""
    header = parse_json(head)
    files = header.get("files")
    if isinstance(files, list) and all(isinstance(file, dict) for file in files):
        entries = [
            {**file, "name": name, "bytes": size}
            for file in files
            for name, size in [anew.get(str(file.get("name")), (file.get("name"), file.get("bytes")))]
        ]
        header["files"] = [file for file in entries if file["name"]]
    return (json.dumps(header, indent=2, ensure_ascii=False) + "\n").encode("utf-8", "replace")


def _with_pseudonym(content: bytes, wizard_name: Callable[[str], str]) -> bytes:
    """Session header with the wizard's pseudonym. Raises ValueError."""
    header = parse_json(content)
    trial = header.get("trial") if isinstance(header, dict) else None
    wizard = str(trial.get("wizard") or "") if isinstance(trial, dict) else ""
    if not isinstance(trial, dict) or wizard_name(wizard) == wizard:
        return content
    trial["wizard"] = wizard_name(wizard)
    return (json.dumps(header, indent=2, ensure_ascii=False) + "\n").encode("utf-8", "replace")


def _manifest_renewed(content: bytes, new_checksums: dict[str, tuple[str, str]]) -> bytes:
    """Manifest with the checksums of the copies; lines of files changed earlier stay."""
    lines = content.decode("utf-8", "surrogateescape").splitlines(keepends=True)
    for name, (original, copy) in new_checksums.items():
        line = re.compile(rf"{original} [ *]{re.escape(name)}\n?")
        new_line = f"{copy}  {name}\n" if copy else ""
        lines = [new_line if line.fullmatch(one) else one for one in lines]
    return "".join(lines).encode("utf-8", "surrogateescape")
