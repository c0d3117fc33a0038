"""Annotation files ``SESSION/annotations/CODER.json``, one for each coder.

They are outside the session's manifest, which is final when recording ends, while coding continues. A file that this
program cannot read is never overwritten.
"""

import errno
import hashlib
import json
import logging
import re
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

from caris_desktop.domain.file_replacement import no_room, replace_file
from caris_desktop.domain.free_names import RESERVED_ON_WINDOWS
from caris_desktop.domain.schema_fields import FieldSpec, data_of, value_from
from caris_desktop.domain.schema_validation import problems
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.annotation.annotation_editing import (
    AnnotationError,
    check_document,
    merge_documents,
    sorted_document,
    tiers_of_coder,
)
from caris_desktop.recording.annotation.annotation_model import (
    Annotation,
    AnnotationDocument,
    Named,
    Text,
    Tier,
    Vocabulary,
)
from caris_desktop.recording.session.session_header import SessionError, read_header, reading

# Schema of a coder's annotation file; checks, reading, writing and JSON Schema derive from it.

FORMAT: Literal["caris-desktop annotations"] = "caris-desktop annotations"
FORMAT_VERSION: Literal[1] = 1
_Id = Annotated[str, FieldSpec(shortest=1, longest=200)]
_Time = Annotated[int, FieldSpec(unit="milliseconds", at_least=0, at_most=2**32 - 1)]


class CodedInterval(Value):
    """A labelled stretch of time."""

    annotation_id: _Id
    start_ms: _Time
    end_ms: Annotated[_Time, FieldSpec("After start_ms.")]
    value: Text


class CodedTier(Value):
    """One row of the timeline."""

    tier_id: _Id
    name: Named
    vocabulary: Annotated[str, FieldSpec("A vocabulary of the file; empty: free text.", order=1)]
    annotations: Annotated[tuple[CodedInterval, ...], FieldSpec("In chronological order, without overlaps.", order=1)]
    participant: Annotated[Text, FieldSpec("Person that the tier is about.")] = ""


class Coding(Value):
    """What one coder made of a session: tiers of labelled stretches of time.

    Times are whole milliseconds since the session began (started_ns in session.json).
    """

    coder: Annotated[Named, FieldSpec("Coder of these tiers.")]
    vocabularies: Annotated[tuple[Vocabulary, ...], FieldSpec(order=1)]
    tiers: Annotated[tuple[CodedTier, ...], FieldSpec("In the order of the timeline.", order=1)]
    saved_utc: str = ""
    duration_ms: Annotated[_Time, FieldSpec("Duration of the session; 0: unknown.")] = 0
    format: Annotated[Literal["caris-desktop annotations"], FieldSpec(wanted=True, order=-1)] = FORMAT
    format_version: Annotated[Literal[1], FieldSpec("The version of this format.", wanted=True, order=-1)] = (
        FORMAT_VERSION
    )


_FOLDER = "annotations"
_MAX_FILE_MB = 64
_log = logging.getLogger(__name__)


def load_documents(folder: Path, *, on_damaged: Callable[[str], None] | None = None) -> AnnotationDocument:
    """Annotations of all coders in ``folder``, each in tiers of their own; empty if there are none.

    An unusable file is reported to ``on_damaged`` and left out; without that callback the first one raises
    AnnotationError.
    """
    documents = []
    for path in annotation_files(folder):
        try:
            document, _ = load_coding(path)
        except AnnotationError as error:
            if on_damaged is None:
                raise
            on_damaged(str(error))
            continue
        documents.append(document)
    merged = merge_documents(*documents)
    return replace(merged, duration_ms=max(merged.duration_ms, _duration_ms(folder)))


def save_coder(folder: Path, document: AnnotationDocument, coder: str) -> Path:
    """Write the tiers of ``coder`` atomically into the session in ``folder``; return the path.

    Raises AnnotationError if the tiers break the rules, the disk does not take them, or the coder's file is there and
    damaged: it stays as it is then.
    """
    mine = sorted_document(tiers_of_coder(document, coder))
    check_document(mine)
    target = folder / _FOLDER
    path = _path_of(folder, coder)
    text = json.dumps(coding_jsonable(mine, coder), indent=1, ensure_ascii=False, allow_nan=False) + "\n"
    try:
        target.mkdir(exist_ok=True)
        replace_file(path, text.encode(), durable=True)
    except OSError as error:
        raise AnnotationError(_explain(error, path)) from error
    return path


def annotation_files(folder: Path) -> tuple[Path, ...]:
    """Annotation files of all coders in ``folder``."""
    with reading(folder / _FOLDER, AnnotationError):
        paths = (folder / _FOLDER).glob("*.json")
        return tuple(sorted(path for path in paths if path.is_file() and not path.name.startswith(".")))


def _duration_ms(folder: Path) -> int:
    try:
        header = read_header(folder)
    except SessionError:
        return 0
    return 0 if header.ended_ns is None else max(0, -(-(header.ended_ns - header.started_ns) // 1_000_000))


def _path_of(folder: Path, coder: str) -> Path:
    """The coder's file: the one that names this coder, or an unused name."""
    plain = re.sub(r"[^A-Za-z0-9_-]+", "-", coder).strip("-")[:60]
    suffix = hashlib.sha256(coder.encode("utf-8", "replace")).hexdigest()[:8]
    if plain == coder and not RESERVED_ON_WINDOWS.fullmatch(plain):
        names = [f"{plain}.json", f"{plain}-{suffix}.json"]
    else:
        names = [f"{plain or 'coder'}-{suffix}.json"]
    files = {path.name.casefold(): path for path in annotation_files(folder)}
    for name in names:
        # On case-insensitive file systems, Anna and anna must not overwrite each other.
        path = files.get(name.casefold())
        if path is None:
            return folder / _FOLDER / name
        if load_coding(path)[1] == coder:
            return path
    raise AnnotationError(
        QT_TR_NOOP("{path} contains the annotations of another coder. Choose another coder name."),
        path=folder / _FOLDER / names[-1],
    )


def coding_jsonable(document: AnnotationDocument, coder: str) -> dict[str, Any]:
    """Content of a coder's file."""
    tiers = tuple(
        CodedTier(
            tier.tier_id,
            tier.name,
            tier.vocabulary,
            tuple(
                CodedInterval(item.annotation_id, item.start_ms, item.end_ms, item.value)
                for item in document.of_tier(tier.tier_id)
            ),
            tier.participant,
        )
        for tier in document.tiers
    )
    saved_utc = f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}"
    coding: dict[str, Any] = data_of(
        Coding, Coding(coder, document.vocabularies, tiers, saved_utc, document.duration_ms)
    )
    return coding


def file_content(path: Path) -> bytes:
    """Content of an annotation file of any format. Raises AnnotationError, also if it is too large."""
    with reading(path, AnnotationError), path.open("rb") as file:
        content = file.read(_MAX_FILE_MB * 2**20 + 1)
    if len(content) > _MAX_FILE_MB * 2**20:
        raise AnnotationError(
            QT_TR_NOOP("{path} is larger than {megabytes} MB: too large for an annotation file."),
            path=path,
            megabytes=_MAX_FILE_MB,
        )
    return content


def load_coding(path: Path) -> tuple[AnnotationDocument, str]:
    """Annotations of one coder from the file ``path``, and the coder. Raises AnnotationError."""
    try:
        data = json.loads(file_content(path))
    except (ValueError, RecursionError) as error:
        _log.warning("%s: %s", path, error)
        raise AnnotationError(
            QT_TR_NOOP(
                "{path} is damaged: it is incomplete or was edited by hand. The file was not changed. "
                "Restore it from a backup, or move it away to start again."
            ),
            path=path,
        ) from error
    version = data.get("format_version") if isinstance(data, dict) else None
    if isinstance(version, int) and version > FORMAT_VERSION:
        raise AnnotationError(
            QT_TR_NOOP(
                "{path} has version {version}; this program reads up to version {newest}. Update CARIS Desktop."
            ),
            path=path,
            version=version,
            newest=FORMAT_VERSION,
        )
    for place, problem in problems(Coding, data):
        _log.warning("%s: %s", path, problem)
        where = "/".join(str(step) for step in place) or QT_TR_NOOP("the file as a whole")
        raise AnnotationError(
            QT_TR_NOOP(
                "{path} is damaged: {where} is invalid; see the log for details. The file was not changed. "
                "Restore it from a backup, or move it away to start again."
            ),
            path=path,
            where=where,
        )
    coding: Coding = value_from(Coding, data)
    tiers = tuple(
        Tier(tier.tier_id, tier.name, coding.coder, tier.vocabulary, tier.participant) for tier in coding.tiers
    )
    annotations = tuple(
        Annotation(item.annotation_id, tier.tier_id, item.start_ms, item.end_ms, item.value)
        for tier in coding.tiers
        for item in tier.annotations
    )
    document = sorted_document(AnnotationDocument(tiers, coding.vocabularies, annotations, coding.duration_ms))
    try:
        check_document(document)
    except AnnotationError as error:
        raise AnnotationError(
            QT_TR_NOOP(
                "{path} is damaged. {error} The file was not changed. Restore it from a backup, or move it "
                "away to start again."
            ),
            path=path,
            error=error,
        ) from error
    return document, coding.coder


def _explain(error: OSError, path: Path) -> str:
    if no_room(error):
        return localized(
            QT_TR_NOOP("The disk is full: {file} was not saved. Free some disk space, then save again."), file=path.name
        )
    if error.errno in (errno.EROFS, errno.EACCES, errno.EPERM):
        return localized(
            QT_TR_NOOP(
                "{folder} cannot be written to ({why}): the annotations were not saved. Copy the session to "
                "a writable folder and annotate it there, or export the annotations."
            ),
            folder=path.parent,
            why=error.strerror,
        )
    return localized(
        QT_TR_NOOP("{path} was not saved: {why}. Check the disk, then save again."),
        path=path,
        why=error.strerror or error,
    )
