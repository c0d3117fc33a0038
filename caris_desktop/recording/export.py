"""Exports recorded sessions for analysis: the list of formats, and how one is written whole or not at all."""

import importlib
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from caris_desktop.recording.session_reader import Session, SessionError, open_session


def _no_progress(_fraction: float) -> None:
    """Nobody watches."""


@dataclass(frozen=True, slots=True)
class ExportContext:
    """What a format gets to work with. ``progress`` takes 0..1, as often as one likes.

    ``licence`` is an SPDX identifier or an address, empty where none was chosen.
    """

    progress: Callable[[float], None] = _no_progress
    licence: str = ""


Exporter = Callable[[Session, Path, ExportContext], list[Path]]
"""Fills an existing, empty folder from a session and gives the paths written. Raises OSError, SessionError."""


@dataclass(frozen=True, slots=True)
class ExportFormat:
    """One format. ``module`` and ``function`` name its Exporter, which is imported when it is used."""

    name: str
    title: str
    description: str
    module: str
    function: str

    def exporter(self) -> Exporter:
        exporter: Exporter = getattr(importlib.import_module(self.module), self.function)
        return exporter


def _format(name: str, title: str, description: str) -> ExportFormat:
    return ExportFormat(name, title, description, f"caris_desktop.recording.exporters.{name}", f"write_{name}")


FORMATS: tuple[ExportFormat, ...] = (
    _format("csv", "Tables (CSV)", "One tidy table for each kind of value and event, with a data dictionary."),
    _format("parquet", "Tables (Parquet)", "The same tables, typed, for pandas, R and DuckDB."),
    _format("eaf", "ELAN", "A project with media, tiers and controlled vocabularies; opens in ELAN by double click."),
    _format("textgrid", "Praat TextGrid", "The tiers for Praat."),
    _format("vtt", "Captions (WebVTT)", "What was said, as captions of the video."),
    _format("rosbag2", "ROS bags", "Standard messages for ROS 2 (MCAP) and ROS 1."),
    _format("frames", "Learning data", "Images and boxes for YOLO and MOT; episodes of driving and dialogue as JSONL."),
    _format("rocrate", "Archive (RO-Crate)", "The whole session with metadata and licence, for a repository."),
    _format("html", "Report", "One page for people: time line, trajectory, talk time, transcript, problems."),
    _format("methods", "Methods sheet", "What a paper has to report of a Wizard-of-Oz study, filled from the log."),
)
BY_FORMAT: dict[str, ExportFormat] = {fmt.name: fmt for fmt in FORMATS}


class ExportError(Exception):
    """An export that was not made; the text is for people. Nothing was overwritten."""


def export_session(folder: Path, fmt: str, out: Path, context: ExportContext | None = None) -> list[Path]:
    """Write the session in ``folder`` as ``fmt`` into the folder ``out``, whole or not at all; the paths written.

    Raises
    ------
    ExportError
        If the session cannot be read, the format is unknown, or ``out`` cannot be used or holds files already.
    """
    chosen = BY_FORMAT.get(fmt)
    if chosen is None:
        raise ExportError(f"Unknown format '{fmt}'. Allowed: {', '.join(BY_FORMAT)}.")
    try:
        session = open_session(folder)
    except SessionError as error:
        raise ExportError(str(error)) from error
    out = out.absolute()
    partial: Path | None = None
    try:
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise ExportError(f"{out} exists and is not empty. Nothing was written; choose another folder.")
        out.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}."))
        partial.chmod(0o755)
        written = chosen.exporter()(session, partial, context or ExportContext())
        if out.exists():
            out.rmdir()
        partial.replace(out)
    except OSError as error:
        raise ExportError(f"The export to {out} failed: {error.strerror or error}. Nothing was kept of it.") from error
    except SessionError as error:
        raise ExportError(str(error)) from error
    finally:
        if partial is not None and partial.exists():
            shutil.rmtree(partial, ignore_errors=True)
    return [out / path.relative_to(partial) for path in written]
