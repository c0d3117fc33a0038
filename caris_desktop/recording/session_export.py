"""Export of recorded sessions: format table, atomic writing, progress and cancellation."""

import contextlib
import gc
import logging
import os
import platform
import re
import secrets
import shutil
import time
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Protocol, TypeVar

import psutil

from caris_desktop.domain.file_replacement import no_room
from caris_desktop.domain.free_names import free_name
from caris_desktop.domain.plugin_process import call_apart
from caris_desktop.domain.plugins import Plugin, PluginError, find, installed, load
from caris_desktop.domain.process_settings import step_back
from caris_desktop.domain.translation import QT_TR_NOOP, LocalizedText, joined, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.csv_cells import SHOWN, CsvStyle
from caris_desktop.recording.pseudonyms import Pseudonyms, pseudonymised, pseudonyms_of
from caris_desktop.recording.session.recovery import missing_words
from caris_desktop.recording.session.session_header import SessionError, is_session, reading
from caris_desktop.recording.session.session_reader import Session, open_session
from caris_desktop.recording.study_file import StudyFile, study_of

_log = logging.getLogger(__name__)
_PARTIAL_SUFFIX = ".exporting"
_PROGRESS_EVERY_S = 0.1
PLUGIN_WITHIN_S = 120.0
"""Longest time of a plug-in from one report of its progress to the next."""


R = TypeVar("R")
Progress = Callable[[float, str], None]


class Runner(Protocol):
    """Runs a job on each of these folders and yields each result, or why there is none, as soon as it is there."""

    def __call__(
        self, job: Callable[[Path, Progress], R], folders: Sequence[Path], progress: Progress, /
    ) -> Generator[tuple[Path, R | Exception]]: ...


def run_here(
    job: Callable[[Path, Progress], R], folders: Sequence[Path], progress: Progress
) -> Generator[tuple[Path, R]]:
    """Runner in this process."""
    for number, folder in enumerate(folders):
        yield folder, job(folder, partial(_report, progress, number, len(folders)))


def _report(progress: Progress, number: int, count: int, fraction: float, what: str) -> None:
    progress((number + min(1.0, max(0.0, fraction))) / count, what)


def _no_progress(_fraction: float) -> None:
    """Ignore progress."""


class ExportContext(Value):
    """Context of an exporter. ``progress`` gets 0..1 at any rate.

    ``licence`` is an SPDX identifier or an address, empty if none was chosen. ``warn`` takes a sentence on data that
    was left out of a successful export, ``notify`` one on anything else that a reader should know. Wizards, coders and
    the robot's address are pseudonymised unless ``with_names``: with ``pseudonyms`` if several exports share them, else
    with the study's. Of the tables, ``parquet`` writes those of ``tables``, or all. ``template`` is the researcher's
    own, for formats that are texts. ``study`` is the study file of the session, read if None; its licence is used if
    no other was chosen.
    """

    progress: Callable[[float], None] = _no_progress
    licence: str = ""
    warn: Callable[[str], None] = _log.warning
    notify: Callable[[str], None] = _log.info
    with_names: bool = False
    pseudonyms: Pseudonyms | None = None
    csv: CsvStyle = SHOWN
    tables: Collection[str] = ()
    template: Path | None = None
    study: StudyFile | None = None


class Exporter(Protocol):
    """Export of one session, of the group ``caris_desktop.exporters``: a function with the attribute
    ``caris_interface = 1``, or an object like one.

    The program calls it for each session that a user exports in the format of its name: from the export dialog or by
    ``caris-desktop export --to NAME``. A plug-in is imported and called in a process of its own for each session, in
    the main thread. The process is not the window's, the robot link's or the recorder's, and has low priority; several
    sessions may be exported at a time. It gets two minutes from one report of ``context.progress`` to the next.

    It fills ``out``, an existing, empty folder, and returns the paths of all files that it wrote there. It writes
    nothing elsewhere, and nothing in ``session.folder``. ``session`` has the pseudonyms that the user asked for in its
    header, its values and its tables (``rows`` of :mod:`caris_desktop.recording.tables.build`); the files of
    ``session.folder`` have not. The folder appears under its final name once the function has returned.

    OSError and SessionError mean that this session cannot be exported: the user reads the text, and the next session
    may succeed. An exporter that raises anything else, prints, is too slow, ends its process, or returns anything else
    is switched off for the rest of the export, and the user is told its name; what it wrote is deleted, and the
    other formats are exported. Log with :mod:`logging`.
    """

    def __call__(self, session: Session, out: Path, context: ExportContext, /) -> list[Path]: ...


class ExportFormat(Value):
    """Export format: an exporter of this name, with the texts that a menu shows without importing it.

    ``together``: its exporter takes a sequence of sessions, and exports them once.
    """

    name: str
    title: str
    description: str
    together: bool = False

    def write(self, sessions: Sequence[Session], out: Path, context: ExportContext) -> list[Path]:
        """Export ``sessions``, one without ``together``. Raises PluginError, and what exporters raise."""
        plugin = find("exporters", self.name)
        if plugin.is_built_in:
            exporter = load(plugin)
            paths: list[Path] = exporter(sessions if self.together else sessions[0], out, context)
            return paths
        plain = replace(context, progress=_no_progress, warn=_log.warning, notify=_log.info)
        result: list[Path] | Exception = call_apart(
            plugin, _write_apart, sessions[0].folder, out, plain, plugin,
            within_s=PLUGIN_WITHIN_S, on_report=lambda name, value: getattr(context, name)(value),
        )  # fmt: skip
        if isinstance(result, Exception):
            raise result
        return result


def _write_apart(  # noqa: PLR0917 - the arguments of a process have no names
    exporter: Exporter,
    report: Callable[[str, object], None],
    folder: Path,
    out: Path,
    context: ExportContext,
    plugin: Plugin,
) -> list[Path] | Exception:
    """Job of a plug-in's process: the paths written, or why this session cannot be exported."""
    context = replace(
        context, progress=partial(report, "progress"), warn=partial(report, "warn"), notify=partial(report, "notify")
    )
    try:
        return checked_paths(plugin, exporter(_opened(folder, context.pseudonyms), out, context), out)
    except (OSError, SessionError, ExportError) as error:
        return error


def checked_paths(plugin: Plugin, written: object, out: Path) -> list[Path]:
    """What an exporter returned, if it is what its interface promises. Raises PluginError."""
    files = {path for path in out.rglob("*") if path.is_file()}
    if not isinstance(written, list | tuple) or set(written) != files or not files:
        raise PluginError(plugin, QT_TR_NOOP("it did not return the files that it wrote"))
    return list(written)


FORMATS: tuple[ExportFormat, ...] = (
    ExportFormat(
        "csv",
        QT_TR_NOOP("Tables (CSV)"),
        QT_TR_NOOP("One tidy table for each kind of value and event, with a data dictionary."),
    ),
    ExportFormat(
        "parquet", QT_TR_NOOP("Tables (Parquet)"), QT_TR_NOOP("The same tables, typed, for pandas, R and DuckDB.")
    ),
    ExportFormat(
        "tables",
        QT_TR_NOOP("Study tables"),
        QT_TR_NOOP(
            "One tidy set of tables over all sessions (CSV, Parquet, SPSS) with a codebook, an R script and a notebook."
        ),
        together=True,
    ),
    ExportFormat(
        "eaf",
        QT_TR_NOOP("ELAN"),
        QT_TR_NOOP("A project with media, tiers and controlled vocabularies; opens in ELAN with a double-click."),
    ),
    ExportFormat(
        "textgrid",
        QT_TR_NOOP("Praat TextGrid"),
        QT_TR_NOOP("The tiers for Praat, in session time and in the time of each audio file."),
    ),
    ExportFormat("vtt", QT_TR_NOOP("Captions (WebVTT)"), QT_TR_NOOP("The transcript as captions for the video.")),
    ExportFormat("rosbag2", QT_TR_NOOP("ROS bags"), QT_TR_NOOP("Standard messages for ROS 2 (MCAP) and ROS 1.")),
    ExportFormat(
        "frames",
        QT_TR_NOOP("Training data"),
        QT_TR_NOOP("Driving for LeRobot, images with boxes for YOLO and MOT, dialogue as JSONL."),
    ),
    ExportFormat(
        "lerobot",
        QT_TR_NOOP("Training data of a study"),
        QT_TR_NOOP("One LeRobot dataset of the driving in all sessions, and their dialogue as JSONL."),
        together=True,
    ),
    ExportFormat(
        "rocrate",
        QT_TR_NOOP("Archive (RO-Crate)"),
        QT_TR_NOOP("The whole session with metadata and licence, for a repository."),
    ),
    ExportFormat(
        "html",
        QT_TR_NOOP("Report"),
        QT_TR_NOOP("One readable page: timeline, trajectory, talk time, transcript, problems."),
    ),
    ExportFormat(
        "methods",
        QT_TR_NOOP("Methods sheet"),
        QT_TR_NOOP(
            "The details that a paper on a Wizard-of-Oz study must report, filled in from the log. One sheet "
            "for all sessions."
        ),
        together=True,
    ),
)
BY_FORMAT: dict[str, ExportFormat] = {fmt.name: fmt for fmt in FORMATS}
"""The program's own."""


def all_formats() -> dict[str, ExportFormat]:
    """Formats by name, those of plug-ins last. Imports none of them."""
    others = [plugin for plugin in installed("exporters").values() if not plugin.is_built_in]
    text = QT_TR_NOOP("Plug-in: {package}.")
    return BY_FORMAT | {
        one.name: ExportFormat(one.name, one.name, localized(text, package=one.package)) for one in others
    }


class ExportRequest(Value):
    """Sessions to export in one or several formats.

    Each session gets the folder ``out/NAME``, or ``out`` itself without ``folder_per_session`` (single session only);
    with several formats, each gets a subfolder. ``with_names`` and ``template``: see ExportContext.
    """

    sessions: tuple[Path, ...]
    formats: tuple[str, ...]
    out: Path
    licence: str = ""
    folder_per_session: bool = True
    with_names: bool = False
    csv: CsvStyle = SHOWN
    template: Path | None = None


class ExportProgress(Value):
    """Progress of an ExportRequest, 0..1, and the item being written, as text."""

    fraction: float
    what: str


class ExportFinished(Value):
    """Folders written, one per session, and a sentence per failure.

    ``notices`` list repairs and missing data of sessions that were not closed properly.
    """

    written: tuple[Path, ...]
    problems: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()


class ExportError(Exception):
    """Export that was not made, with the reason as user text; ``values`` fill its ``{names}``. Nothing was
    overwritten.
    """

    def __init__(self, text: str, **values: object) -> None:
        super().__init__(localized(text, **values))


class _DiskFullError(ExportError):
    """Full disk: the remaining sessions would fail too."""


def run_exports(connection: Connection, request: ExportRequest) -> None:
    """Process entry point: send ExportProgress, then ExportFinished.

    To cancel, kill the process and call :func:`remove_partial_exports`; it also ends when ``connection`` is closed.
    """
    step_back(10)  # the robot may be in use at the same time

    def report(fraction: float, what: str) -> None:
        connection.send(ExportProgress(fraction, what))

    try:
        connection.send(export_all(request, report))
    except (BrokenPipeError, EOFError):
        _log.warning("nobody waits for the export any more; it ended")


def export_all(
    request: ExportRequest,
    progress: Progress = lambda _fraction, _what: None,
    *,
    run: Runner = run_here,
) -> ExportFinished:
    """Write everything in ``request``. Failures go into the result and do not stop the rest.

    An interruption (KeyboardInterrupt, an exception of ``progress``) leaves complete exports only. ``run`` decides
    where the sessions are exported.
    """
    report = _Throttled(progress)
    known = all_formats()
    unknown = [name for name in request.formats if name not in known]
    if unknown or not request.formats:
        return ExportFinished((), (_unknown_format(", ".join(unknown)),))
    if not request.folder_per_session and len(request.sessions) != 1:
        return ExportFinished((), (QT_TR_NOOP("Each session needs its own folder. Nothing was written."),))
    remove_partial_exports(request.out)
    folders = dict(zip(export_folders(request), request.sessions, strict=True))
    together = tuple(name for name in request.formats if known[name].together and len(folders) > 1)
    apart = replace(request, formats=tuple(name for name in request.formats if name not in together))
    pseudonyms = None if request.with_names else pseudonyms_of(request.sessions)
    before, done = written_in(folders), dict[Path, _Exported]()
    job = partial(_export_one, apart, folders, pseudonyms, before=before)
    with contextlib.closing(run(job, tuple(folders), report)) as results:
        for target, result in results:
            if isinstance(result, Exception):
                result = _Exported(problems=(_message_for(folders[target].name, result),))  # noqa: PLW2901 - the same, said otherwise
            done[target] = result
            if result.disk_full:
                break
    # By a process whose result was no longer awaited.
    done |= {target: _Exported(True, True) for target in written_in(folders) if target not in (*before, *done)}
    in_order = [(target, done[target]) for target in folders if target in done]
    written = [target for target, result in in_order if result.written]
    problems = [problem for _, result in in_order for problem in result.problems]
    if left := len(folders) - len(done):
        problems.append(QT_TR_NOOP("%n further session(s) were not exported: the disk is full.", "", left))
    notices = [notice for _, result in in_order for notice in result.notices]
    opened = [folders[target] for target, result in in_order if result.opened]
    for name in together if opened else ():
        title = localized(known[name].title)
        what = localized(QT_TR_NOOP("{format} of all sessions"), format=title)
        warnings: list[str] = []
        context = ExportContext(
            partial(report, what=what), request.licence, warnings.append, notify=notices.append, csv=request.csv,
            template=request.template, pseudonyms=pseudonyms,
        )  # fmt: skip
        target = request.out.absolute() / name
        try:
            sessions = [_opened(folder, pseudonyms) for folder in opened]
            with whole_folder(target, opened[0]) as place:
                _write(known[name], sessions, place, context)
            problems += warnings
            written.append(target)
        except ExportError as error:
            problems.append(_message_for(title, error))
    report(1.0, QT_TR_NOOP("done"), now=True)
    return ExportFinished(tuple(written), tuple(problems), tuple(notices))


def export_folders(request: ExportRequest) -> tuple[Path, ...]:
    """Output folder of each session."""
    out = request.out.absolute()
    if not request.folder_per_session:
        return (out,) * len(request.sessions)
    return tuple(out / name for name in export_names(request.sessions))


def export_names(sessions: Sequence[Path]) -> list[str]:
    """Name of the output folder of each session. Sessions of the same name are distinguished by their studies."""
    names = [folder.absolute().name for folder in sessions]
    folded = [name.casefold() for name in names]
    taken: set[str] = set()
    targets = []
    for folder, name in zip(sessions, names, strict=True):
        if folded.count(name.casefold()) > 1:
            parent = folder.absolute().parent
            study = (parent.parent if parent.name == "sessions" else parent).name or "study"
            name = f"{study}_{name}"  # noqa: PLW2901 - the name it goes by from here on
        unique = free_name(name, "", lambda name: name.casefold() in taken)
        taken.add(unique.casefold())
        targets.append(unique)
    return targets


def written_in(targets: Iterable[Path]) -> list[Path]:
    """Output folders that contain something."""
    return [target for target in targets if _entries(target, "")]


def sessions_in(path: Path) -> tuple[Path, ...]:
    """Session folders under ``path``: itself, or those of a study.

    Non-empty folders of a study that are not sessions are included, so that they are reported.

    Raises ExportError if it is neither.
    """
    if is_session(path):
        return (path,)
    with reading(path, ExportError):
        inside = path / "sessions" if (path / "sessions").is_dir() else path
        folders = sorted(
            entry
            for entry in inside.iterdir()
            if entry.is_dir() and not entry.name.startswith(".") and any(entry.iterdir())
        )
    if inside is path:
        folders = [folder for folder in folders if is_session(folder)]
    if not folders:
        raise ExportError(
            QT_TR_NOOP(
                "{path} is not a session or a study: it contains neither a session.json nor sessions. "
                "Nothing was written."
            ),
            path=path,
        )
    return tuple(folders)


def export_session(folder: Path, fmt: str, out: Path, context: ExportContext | None = None) -> list[Path]:
    """Write the session in ``folder`` as ``fmt`` atomically into the folder ``out``; return the paths.

    Raises ExportError if the session cannot be read, the format is unknown, or ``out`` cannot be used or holds files
    already.
    """
    known = all_formats()
    if fmt not in known:
        raise ExportError(_unknown_format(fmt))
    context = context or ExportContext()
    pseudonyms = None if context.with_names else context.pseudonyms or pseudonyms_of([folder])
    session = _opened(folder, pseudonyms)
    with whole_folder(out, folder) as partial:
        written = _write(known[fmt], [session], partial, replace(context, pseudonyms=pseudonyms))
    return [out.absolute() / path.relative_to(partial) for path in written]


def remove_partial_exports(out: Path) -> None:
    """Remove partial folders of killed exports into ``out``, except those still being written."""
    out = out.absolute()
    candidates = [*_entries(out.parent, f".{out.name[:_NAME_CHARACTERS]}."), *_entries(out, ".")]
    for path in candidates:
        match = _PARTIAL_NAME.fullmatch(path.name)
        writer = (match[1], int(match[2]), int(match[3])) if match else None
        if writer is not None and not path.is_symlink() and path.is_dir() and not _is_running(*writer):
            _log.info("removing %s, which a killed export left", path)
            shutil.rmtree(path, ignore_errors=True)


# One session


class _Exported(Value):
    """Result of one session; ``disk_full``: the remaining sessions would fail, too."""

    written: bool = False
    opened: bool = False
    problems: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()
    disk_full: bool = False


def _export_one(
    request: ExportRequest,
    folders: Mapping[Path, Path],
    pseudonyms: Pseudonyms | None,
    target: Path,
    progress: Progress,
    *,
    before: Collection[Path],
) -> _Exported:
    """Write the session of ``target`` in all formats; no format: only open it."""
    folder = folders[target]
    progress(0.0, localized("{session}", session=folder.absolute().name))  # a name, not a translatable text
    try:
        session = _opened(folder, pseudonyms)
    except ExportError as error:
        return _Exported(problems=(_message_for(folder.name, error),))
    damaged = missing_words(session.header, Counter(session.lost) - Counter(session.header.lost))
    problems: list[str] = [_message_for(folder.name, loss) for loss in damaged]
    sentences = [each for each in dict.fromkeys((*session.notices, *session.losses)) if each not in damaged]
    notices = tuple(_message_for(folder.name, sentence) for sentence in sentences)
    try:
        # Else it was written by a process that died before it could report it.
        if request.formats and (target in before or not written_in([target])):
            problems += _export_formats(session, request, target, pseudonyms, progress)
    except ExportError as error:
        problems.append(_message_for(folder.name, error))
        return _Exported(False, True, tuple(problems), notices, isinstance(error, _DiskFullError))
    return _Exported(bool(request.formats), True, tuple(problems), notices)


def _export_formats(
    session: Session, request: ExportRequest, out: Path, pseudonyms: Pseudonyms | None, tell: Progress
) -> tuple[str, ...]:
    """Write one session in all formats; return problems and warnings. Raises ExportError if every format failed."""
    name, known = session.folder.absolute().name, all_formats()
    formats = [known[fmt] for fmt in request.formats]
    problems: list[str] = []
    failed = 0
    with whole_folder(out, session.folder) as partial:
        for number, fmt in enumerate(formats):
            title = _message_for(name, fmt.title)

            def progress(fraction: float, *, number: int = number, title: str = title) -> None:
                tell((number + min(1.0, max(0.0, fraction))) / len(formats), title)

            progress(0.0)
            place = partial / fmt.name if len(formats) > 1 else partial
            place.mkdir(exist_ok=True)
            warnings: list[str] = []
            context = ExportContext(
                progress, request.licence, warnings.append, csv=request.csv, template=request.template,
                pseudonyms=pseudonyms,
            )  # fmt: skip
            try:
                _write(fmt, [session], place, context)
            except _DiskFullError:
                raise
            except ExportError as error:
                if len(formats) == 1:
                    raise
                problems.append(_message_for(title, error))
                shutil.rmtree(place, ignore_errors=True)
                failed += 1
            problems += [_message_for(title, warning) for warning in dict.fromkeys(warnings)]
        if failed == len(formats):
            raise ExportError(joined(problems))
    return tuple(problems)


def _opened(folder: Path, pseudonyms: Pseudonyms | None) -> Session:
    try:
        session = open_session(folder)
        return session if pseudonyms is None else pseudonymised(session, pseudonyms)
    except SessionError as error:
        raise ExportError(str(error)) from error


def _write(fmt: ExportFormat, sessions: Sequence[Session], out: Path, context: ExportContext) -> list[Path]:
    """Write the files, and convert any exception to ExportError: the next format or session may succeed."""
    what = sessions[0].folder if len(sessions) == 1 else f"{len(sessions)} sessions"
    try:
        study = context.study or study_of(sessions[0].folder)
        licence = context.licence or (study.licence if study else "")
        with _few_collections():
            return fmt.write(sessions, out, replace(context, study=study, licence=licence))
    except (SessionError, ExportError) as error:
        raise ExportError(str(error)) from error
    except PluginError as error:
        raise ExportError(
            QT_TR_NOOP(
                "The plug-in {name} ({package}) was switched off: {reason}. Its partial files were deleted; the "
                "session itself is unchanged."
            ),
            name=error.plugin.name,
            package=error.plugin.package,
            reason=error.reason,
        ) from error
    except (BrokenPipeError, EOFError):
        # The receiver of the progress has ended.
        raise
    except OSError as error:
        _log.info("export of %s as %s", what, fmt.name, exc_info=True)
        raise _failure(out, error) from error
    except Exception as error:
        _log.exception("export of %s as %s", what, fmt.name)
        raise ExportError(
            QT_TR_NOOP(
                "The export as {format} failed ({kind}: {error}). Its partial files were deleted; the "
                "session itself is unchanged."
            ),
            format=fmt.name,
            kind=type(error).__name__,
            error=error,
        ) from error


@contextlib.contextmanager
def _few_collections() -> Iterator[None]:
    """Values of a session have no reference cycles: looking for some after every 700 objects takes a quarter of the
    time.
    """
    before = gc.get_threshold()
    gc.set_threshold(1_000_000, 50, 100)
    try:
        yield
    finally:
        gc.set_threshold(*before)


def attempt(session: Session, read: Callable[[Session], object], warn: Callable[[str], None]) -> bool:
    """Whether one session of several could be read; otherwise it is reported, and the rest goes on. Raises OSError."""
    try:
        read(session)
    except OSError:
        raise
    except Exception as error:
        _log.info("%s is left out", session.folder, exc_info=True)
        warn(localized(QT_TR_NOOP("{session} is left out: {why}"), session=session.folder.name, why=error))
        return False
    return True


@contextlib.contextmanager
def whole_folder(out: Path, session_folder: Path) -> Iterator[Path]:
    """Temporary folder that replaces ``out`` on success and is removed otherwise.

    Raises ExportError if ``out`` cannot be created or is not empty.
    """
    out = out.absolute()
    _refuse_inside(out, session_folder)
    partial: Path | None = None
    try:
        try:
            if out.exists() and (not out.is_dir() or any(out.iterdir())):
                raise ExportError(
                    QT_TR_NOOP("{out} exists and is not empty. Nothing was written; choose another folder."),
                    out=out,
                )
            out.parent.mkdir(parents=True, exist_ok=True)
            prefix = f".{out.name[:_NAME_CHARACTERS]}.{_host()}.{os.getpid()}-{_started(psutil.Process())}."
            partial = out.parent / f"{prefix}{secrets.token_hex(4)}{_PARTIAL_SUFFIX}"
            partial.mkdir()
        except OSError as error:
            raise _failure(out, error) from error
        yield partial
        try:
            if out.exists():
                out.rmdir()
            partial.replace(out)
        except OSError as error:
            raise _failure(out, error) from error
    finally:
        if partial is not None and partial.exists():
            shutil.rmtree(partial, ignore_errors=True)


def _refuse_inside(out: Path, session_folder: Path) -> None:
    """Inside a session's folder, allow only a new export folder that no session file uses."""
    session_folder = session_folder.resolve()
    place = out.resolve()
    if session_folder not in (place, *place.parents):
        return
    inside = place.relative_to(session_folder).parts
    if len(inside) != 1 or not inside[0].startswith("export-"):
        raise ExportError(
            QT_TR_NOOP(
                "{out} is inside the recorded session. Nothing was written; choose a folder outside the "
                "session, or {new}."
            ),
            out=out,
            new=session_folder / "export-1",
        )


def _failure(out: Path, error: OSError) -> ExportError:
    if no_room(error):
        full = QT_TR_NOOP(
            "The export to {folder} failed: {why}. Its partial files were deleted. Free some disk space, or "
            "choose another disk."
        )
        return _DiskFullError(localized(full, folder=out, why=error.strerror or error))
    failed = QT_TR_NOOP("The export to {folder} failed: {why}. Its partial files were deleted.")
    return ExportError(failed, folder=out, why=error.strerror or error)


def _message_for(name: str, message: object) -> LocalizedText:
    """Prefix a message with a session's name; both keep their template values."""
    return localized(QT_TR_NOOP("{name}: {told}"), name=name, told=localized(str(message)))


def _unknown_format(name: str) -> str:
    return localized(
        QT_TR_NOOP("Unknown format '{name}'. Allowed: {formats}."), name=name, formats=", ".join(all_formats())
    )


# Partial folders name their writer: .NAME.HOST.PID-STARTED.RANDOM.exporting

_NAME_CHARACTERS = 80
_PARTIAL_NAME = re.compile(r"\..*\.([^.]*)\.(\d+)-(\d+)\.[^.]*" + re.escape(_PARTIAL_SUFFIX))


def _is_running(host: str, pid: int, started: int) -> bool:
    if host != _host():
        # A study on a shared disk: processes of other hosts cannot be checked.
        return True
    try:
        process = psutil.Process(pid)
        return process.status() != psutil.STATUS_ZOMBIE and _started(process) == started
    except psutil.NoSuchProcess:
        return False
    except psutil.Error:
        return True


def _started(process: psutil.Process) -> int:
    return int(process.create_time())


def _host() -> str:
    return re.sub(r"[^A-Za-z0-9-]+", "-", platform.node())[:40]


def _entries(folder: Path, beginning: str) -> Sequence[Path]:
    try:
        return [path for path in folder.iterdir() if path.name.startswith(beginning)]
    except OSError:
        return []


class _Throttled:
    """Limits progress to ten reports per second, and always reports a new item."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._what = ""
        self._at_s = 0.0

    def __call__(self, fraction: float, what: str, *, now: bool = False) -> None:
        now_s = time.monotonic()
        if now or what != self._what or now_s - self._at_s >= _PROGRESS_EVERY_S:
            self._what, self._at_s = what, now_s
            self._progress(fraction, what)
