"""Exports a recorded session for analysis."""

import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from caris_desktop.recording.exporters.csv import write_csv
from caris_desktop.recording.session_reader import Session, SessionError, open_session

Exporter = Callable[[Session, Path], list[Path]]
EXPORTERS: Mapping[str, Exporter] = {"csv": write_csv}


class ExportError(Exception):
    """An export that was not made; the text is for people. Nothing was overwritten."""


def export_session(folder: Path, fmt: str, out: Path) -> list[Path]:
    """Write the session in ``folder`` as ``fmt`` into the folder ``out``, whole or not at all; the paths written.

    Raises
    ------
    ExportError
        If the session cannot be read, the format is unknown, or ``out`` cannot be used or holds files already.
    """
    exporter = EXPORTERS.get(fmt)
    if exporter is None:
        raise ExportError(f"Unknown format '{fmt}'. Allowed: {', '.join(EXPORTERS)}.")
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
        written = exporter(session, partial)
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
