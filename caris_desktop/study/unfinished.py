"""Which trial was being recorded, so that after an end that nobody wanted the next run can offer to go on with it.

One small file for each running program, written while it records and gone when the recording or the program ends in
order, or as soon as it is told to end. What is left of a program that runs no more tells of a crash or a power cut,
also where the computer was started anew since: whoever shuts it down tells its programs before.
"""

import json
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.foreign_json import parse_json
from caris_desktop.domain.value_class import dataclass

_log = logging.getLogger(__name__)
_MOST_BYTES = 64 * 1024
_MOST_PEOPLE = 100


@dataclass(frozen=True, slots=True)
class UnfinishedTrial:
    """What was under way: the session folder, what it was recorded with, and who was there.

    ``scenario`` is the path of its file, empty where it has none; ``robot`` the name of its profile. ``attended`` is
    the id of whom the wizard meant, ``step`` that of the protocol's step that was under way.
    """

    session: Path
    scenario: str = ""
    robot: str = ""
    people: tuple[str, ...] = ()
    attended: str = ""
    step: str = ""


def keep(folder: Path, trial: UnfinishedTrial) -> None:
    """Write down that this program records ``trial``. Raises OSError."""
    import psutil  # neither the first window nor a program that records nothing needs it

    own = psutil.Process()
    data = {
        "session": str(trial.session), "scenario": trial.scenario, "robot": trial.robot,
        "people": list(trial.people[:_MOST_PEOPLE]), "attended": trial.attended,
        "step": trial.step,
        "began": own.create_time(),
    }  # fmt: skip
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    replace_file(folder / f"{own.pid}.json", json.dumps(data).encode(), durable=True)


def forget(folder: Path, pid: int | None = None) -> None:
    """This program (or ``pid``) ended its recording in order. Raises OSError."""
    (folder / f"{os.getpid() if pid is None else pid}.json").unlink(missing_ok=True)


def take_newest(folder: Path, study: Path) -> UnfinishedTrial | None:
    """The trial of ``study`` that broke off last, if any; each is told of once, as its file goes.

    Those of programs that still run, and of another study, stay. Raises OSError.
    """
    if not folder.is_dir():
        return None
    newest: tuple[float, UnfinishedTrial] | None = None
    for path in sorted(folder.glob("*.json")):
        data, written_s = _read(path)
        if data is not None and _runs(path.stem, data.get("began")):
            continue
        trial = None if data is None else _trial(data)
        if data is None or trial is None or not trial.session.is_dir():
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
    """Whether the program that wrote this still runs, and not another one that has its number now."""
    if not pid.isdecimal() or not isinstance(began, (int, float)):
        return False
    import psutil

    try:
        return abs(psutil.Process(int(pid)).create_time() - began) < 1.0
    except psutil.NoSuchProcess:
        return False
    except psutil.AccessDenied:
        return True


def _trial(data: Mapping[str, Any]) -> UnfinishedTrial | None:
    texts = {key: data.get(key) for key in ("session", "scenario", "robot", "attended")}
    people, step = data.get("people"), data.get("step")
    if not (all(isinstance(text, str) for text in texts.values()) and isinstance(people, list)):
        return None
    return UnfinishedTrial(
        Path(str(texts["session"])), str(texts["scenario"]), str(texts["robot"]),
        tuple(person for person in people if isinstance(person, str)), str(texts["attended"]),
        step if isinstance(step, str) else "",
    )  # fmt: skip
