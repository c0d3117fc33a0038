"""Study folder: location of one study's sessions and people database, and defaults for the next trial."""

import json
import logging
import re
import shutil
import tempfile
import unicodedata
from collections.abc import Mapping
from dataclasses import asdict, fields, replace
from datetime import datetime
from pathlib import Path

import platformdirs

from caris_desktop.domain.events import TrialDetails
from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.file_replacement import narrow, replace_file
from caris_desktop.domain.foreign_text import parse_json, typed_path
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value

_log = logging.getLogger(__name__)
MIN_FREE_BYTES = 200 * 1024 * 1024
_MAX_DETAILS_BYTES = 64 * 1024
_MAX_DETAIL_CHARACTERS = 200


class StudyFolderError(UserFacingError):
    """Unusable study folder. English text with separate values, for translation."""


class StudyFolder(Value):
    """Paths inside one study folder. ``narrowed`` counts files and folders that were readable by other users."""

    path: Path
    narrowed: int = 0

    @property
    def sessions(self) -> Path:
        return self.path / "sessions"

    @property
    def people_database(self) -> Path:
        return self.path / "people.sqlite"

    @property
    def last_details(self) -> Path:
        return self.path / "last-trial.json"


def default_study_path() -> Path:
    """``CARIS Desktop/default study`` under the user's documents, or under the data folder without one."""
    documents = Path(platformdirs.user_documents_dir())
    home = documents if documents.is_dir() else Path(platformdirs.user_data_dir("caris-desktop", appauthor=False))
    return home / "CARIS Desktop" / "default study"


def open_study_folder(path: Path | None = None) -> StudyFolder:
    """Study folder at ``path`` (or the default), created if missing, and tested for writing.

    Raises
    ------
    StudyFolderError
        If it cannot be made or written.
    """
    folder = StudyFolder((default_study_path() if path is None else typed_path(path)).absolute())
    try:
        folder.sessions.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder.sessions) as probe:
            probe.write(b"x")
            probe.flush()
    except OSError as error:
        raise _unusable(folder.path, error) from error
    # Only the study's own: its folder may contain much else.
    own = [folder.path / name for name in ("sessions", "photos", "forgotten", "models", folder.last_details.name)]
    return replace(folder, narrowed=narrow([*own, *folder.path.glob("*.sqlite*")]))


def free_bytes(folder: StudyFolder) -> int | None:
    """Free bytes on the study's disk; None if unknown."""
    try:
        return shutil.disk_usage(folder.path).free
    except OSError as error:
        _log.warning("free room of %s: %s", folder.path, error)
        return None


def new_session_folder(
    folder: StudyFolder, details: TrialDetails, *, now: datetime | None = None, min_free_bytes: int = MIN_FREE_BYTES
) -> Path:
    """Create an empty folder such as ``sessions/2026-11-21_10-14-02_P07``, local time; never an existing one.

    Raises
    ------
    StudyFolderError
        If it cannot be made, or less than ``min_free_bytes`` are free.
    """
    try:
        free_bytes = shutil.disk_usage(folder.sessions).free
    except OSError as error:
        raise _unusable(folder.path, error) from error
    if free_bytes < min_free_bytes:
        raise StudyFolderError(
            localized(
                QT_TR_NOOP("Only {free_mb} MB are free on the disk that contains {path}."),
                free_mb=f"{free_bytes / 1e6:.0f}",
                path=folder.path,
            ),
            QT_TR_NOOP("No session was started: a recording needs disk space for its video."),
            localized(
                QT_TR_NOOP("Free at least {least_mb} MB, or choose another study folder."),
                least_mb=f"{min_free_bytes / 1e6:.0f}",
            ),
        )
    name = f"{now or datetime.now().astimezone():%Y-%m-%d_%H-%M-%S}"
    participant = file_name_part(details.participant)
    if participant:
        name = f"{name}_{participant}"
    for number in range(1, 1000):
        path = folder.sessions / (name if number == 1 else f"{name}-{number}")
        try:
            path.mkdir()
        except FileExistsError:
            continue
        except OSError as error:
            raise _unusable(folder.path, error) from error
        return path
    raise StudyFolderError(
        localized(
            QT_TR_NOOP("{sessions} already contains a thousand sessions from this second."), sessions=folder.sessions
        ),
        QT_TR_NOOP("No session was started."),
        QT_TR_NOOP("Check the computer's clock."),
    )


def file_name_part(text: str) -> str:
    """``text`` as a safe part of a file name: ASCII letters, digits, ``-`` and ``_``, at most 40; may be empty."""
    ascii_text = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return re.sub(r"[^A-Za-z0-9_-]+", "-", ascii_text).strip("-_")[:40].strip("-_")


def load_last_details(folder: StudyFolder) -> TrialDetails:
    """Last answers of the start dialog in this study; empty if there are none."""
    try:
        with folder.last_details.open("rb") as file:
            data = parse_json(file.read(_MAX_DETAILS_BYTES))
    except FileNotFoundError:
        return TrialDetails()
    except (OSError, ValueError) as error:
        _log.warning("%s is ignored: %s", folder.last_details, error)
        return TrialDetails()
    if not isinstance(data, Mapping):
        _log.warning("%s is ignored: no trial details in it", folder.last_details)
        return TrialDetails()
    texts = {field.name: data.get(field.name) for field in fields(TrialDetails)}
    return TrialDetails(**{key: text[:_MAX_DETAIL_CHARACTERS] for key, text in texts.items() if isinstance(text, str)})


def save_last_details(folder: StudyFolder, details: TrialDetails) -> None:
    """Save ``details`` for the next start dialog. Raises StudyFolderError on failure."""
    text = json.dumps(asdict(details), indent=2, ensure_ascii=False)
    try:
        replace_file(folder.last_details, text.encode("utf-8", "replace"), durable=True)
    except OSError as error:
        raise _unusable(folder.path, error) from error


def _unusable(path: Path, error: OSError) -> StudyFolderError:
    return StudyFolderError(
        localized(QT_TR_NOOP("The study folder {path} cannot be used: {why}."), path=path, why=error.strerror or error),
        QT_TR_NOOP("No session can be recorded there. Driving and speaking still work."),
        QT_TR_NOOP("Choose a writable folder, or free some space on its disk."),
    )


def following(details: TrialDetails) -> TrialDetails:
    """Suggested details for the next session: the same, with a numeric trial incremented."""
    details = replace(details, recording="")
    return replace(details, trial=str(int(details.trial) + 1)) if details.trial.isdecimal() else details


def with_recording_number(details: TrialDetails, last: TrialDetails) -> TrialDetails:
    """Details with a recording number, incremented if the last session was the same trial of the same participant."""
    plain = replace(details, recording="", purpose="", wizard="")
    again = plain == replace(last, recording="", purpose="", wizard="") and plain != TrialDetails()
    number = int(last.recording) + 1 if again and last.recording.isdecimal() else 1
    return replace(details, recording=str(number))
