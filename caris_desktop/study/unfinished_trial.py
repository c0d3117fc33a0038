"""Interrupted trials, so that the next run can offer to resume one.

One small file per running program, written while it records and removed when the recording or the program ends
properly, or on a termination signal. A file of a program that no longer runs means a crash or a power failure, even
after a reboot: a shutdown signals programs first.
"""

import json
import logging
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.foreign_text import parse_json
from caris_desktop.domain.schema import from_jsonable, to_jsonable
from caris_desktop.domain.value_class import Value

_log = logging.getLogger(__name__)
_MOST_BYTES = 64 * 1024
_MOST_PEOPLE = 100


class UnfinishedTrial(Value):
    """Interrupted trial: its session folder, settings, and people present.

    ``scenario`` is the path of its file, empty without one; ``robot`` the name of its profile. ``attended`` is the id
    of the attended person, ``step`` that of the protocol step.
    """

    session: Path
    scenario: str = ""
    robot: str = ""
    people: tuple[str, ...] = ()
    attended: str = ""
    step: str = ""


def save_unfinished(folder: Path, trial: UnfinishedTrial) -> None:
    """Note that this program records ``trial``. Raises OSError."""
    import psutil  # not needed by the first window or without a recording

    own = psutil.Process()
    data = to_jsonable(replace(trial, people=trial.people[:_MOST_PEOPLE])) | {"began": own.create_time()}
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    replace_file(folder / f"{own.pid}.json", json.dumps(data).encode(), durable=True)


def forget(folder: Path, pid: int | None = None) -> None:
    """Note that this program (or ``pid``) ended its recording properly. Raises OSError."""
    (folder / f"{os.getpid() if pid is None else pid}.json").unlink(missing_ok=True)


def take_newest(folder: Path, study: Path) -> UnfinishedTrial | None:
    """Most recently interrupted trial of ``study``, if any; each is reported once, and its file removed.

    Trials of running programs and other studies stay. Raises OSError.
    """
    if not folder.is_dir():
        return None
    newest: tuple[float, UnfinishedTrial] | None = None
    for path in sorted(folder.glob("*.json")):
        data, written_s = _read(path)
        if data is not None and _runs(path.stem, data.get("began")):
            continue
        try:
            trial = from_jsonable(UnfinishedTrial, data)
        except ValueError:
            trial = None
        if trial is None or not trial.session.is_dir():
            path.unlink(missing_ok=True)
            continue
        if not trial.session.resolve().is_relative_to(study.resolve()):
            continue
        path.unlink(missing_ok=True)
        if newest is None or written_s > newest[0]:
            newest = (written_s, trial)
    return newest[1] if newest is not None else None


def _read(path: Path) -> tuple[Mapping[str, Any] | None, float]:
    try:
        with path.open("rb") as file:
            data = parse_json(file.read(_MOST_BYTES))
        return (data if isinstance(data, dict) else None), path.stat().st_mtime
    except (OSError, ValueError) as error:
        _log.warning("%s is ignored: %s", path, error)
        return None, 0.0


def _runs(pid: str, began: object) -> bool:
    """True if the program that wrote the file still runs, checked against reuse of its process id."""
    if not pid.isdecimal() or not isinstance(began, (int, float)):
        return False
    import psutil

    try:
        return abs(psutil.Process(int(pid)).create_time() - began) < 1.0
    except psutil.NoSuchProcess:
        return False
    except psutil.AccessDenied:
        return True
