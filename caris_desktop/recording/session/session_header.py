"""Session header (``session.json``), read defensively, since sessions may come from any source."""

import json
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.session.format import FORMAT, FORMAT_VERSION
from caris_desktop.recording.session.header_recovery import holds_record, rebuilt_header
from caris_desktop.recording.session.manifest import MANIFEST_NAME
from caris_desktop.recording.session.session_clock import SessionClock

_log = logging.getLogger(__name__)
_MAX_HEADER_BYTES = 16 * 1024 * 1024


class SessionError(Exception):
    """Folder that is not a readable session; the text is for people."""


@dataclass(frozen=True, slots=True)
class SessionTimes:
    """Times of a session. ``ended_ns`` is None if it was not closed."""

    clock: SessionClock
    ended_ns: int | None
    reason: str


def read_header(folder: Path) -> dict[str, Any]:
    """Read ``session.json``; if it is lost, rebuild it from the events.

    Raises
    ------
    SessionError
        If ``folder`` is no session, or one of another program or a newer version.
    """
    if not folder.is_dir():
        raise SessionError(
            localized(
                QT_TR_NOOP(
                    "{folder} is not a folder. A session is a folder that contains session.json and events.mcap."
                ),
                folder=folder,
            )
        )
    path = folder / "session.json"
    for name in ("session.json", "events.mcap"):
        if not inside(folder, name):
            raise SessionError(
                localized(
                    QT_TR_NOOP("{path} is a link to a location outside the session. It is not followed."),
                    path=folder / name,
                )
            )
    header = _recorded_header(folder, path)
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise SessionError(localized(QT_TR_NOOP("{path} is not the header of a CARIS Desktop session."), path=path))
    version = header.get("format_version")
    if not isinstance(version, int) or version > FORMAT_VERSION:
        raise SessionError(
            localized(
                QT_TR_NOOP(
                    "{path} has version {version}; this program reads up to version {newest}. Update CARIS Desktop."
                ),
                path=path,
                version=version,
                newest=FORMAT_VERSION,
            )
        )
    if not (folder / "events.mcap").is_file():
        raise SessionError(
            localized(
                QT_TR_NOOP(
                    "{folder} does not contain events.mcap: the events and the speech of the session are "
                    "lost. Restore the file from a backup, if there is one. The other files in the folder "
                    "were not changed."
                ),
                folder=folder,
            )
        )
    return header


def is_session(folder: Path) -> bool:
    """True if ``folder`` contains a session, even one without ``session.json``."""
    return (folder / "session.json").exists() or holds_record(folder)


def _recorded_header(folder: Path, path: Path) -> Any:
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_HEADER_BYTES + 1)
        if len(content) > _MAX_HEADER_BYTES:
            raise SessionError(
                localized(
                    QT_TR_NOOP("{path} is far too large for a session header ({size} bytes)."),
                    path=path,
                    size=path.stat().st_size,
                )
            )
        return json.loads(content)
    except FileNotFoundError:
        missing = True
    except OSError as error:
        raise SessionError(
            localized(QT_TR_NOOP("{path} cannot be read: {why}."), path=path, why=error.strerror or error)
        ) from error
    except (ValueError, RecursionError) as error:
        _log.warning("%s: %s", path, error)
        missing = False
    if not holds_record(folder):
        if missing and (folder / MANIFEST_NAME).is_file():
            raise SessionError(
                localized(
                    QT_TR_NOOP(
                        "{folder} no longer contains session.json or events.mcap: the events of the session "
                        "are lost. Restore both files from a backup. The other files in the folder were not "
                        "changed."
                    ),
                    folder=folder,
                )
            )
        if missing:
            raise SessionError(
                localized(QT_TR_NOOP("{folder} is not a session: session.json is missing."), folder=folder)
            )
        raise SessionError(
            localized(
                QT_TR_NOOP("{path} is damaged, and there is no events.mcap next to it to rebuild it from."),
                path=path,
            )
        )
    header = rebuilt_header(folder, missing=missing)
    if header is None:
        raise SessionError(
            localized(
                QT_TR_NOOP(
                    "{path} was missing, and the rest of events.mcap does not contain the start time of the "
                    "session. Restore session.json from a backup; nothing was changed."
                )
                if missing
                else QT_TR_NOOP(
                    "{path} was damaged, and the rest of events.mcap does not contain the start time of the "
                    "session. Restore session.json from a backup; nothing was changed."
                ),
                path=path,
            )
        )
    return header


def inside(folder: Path, name: str) -> bool:
    """True if the file name is directly in ``folder``, also after resolving links."""
    return Path(name).name == name and (folder / name).resolve().parent == folder.resolve()


def times_of(header: Mapping[str, Any], folder: Path) -> SessionTimes:
    """Times from the header. Raises SessionError if they are missing."""
    try:
        anchor = ClockAnchor(int(header["clock"]["monotonic_ns"]), int(header["clock"]["utc_ns"]))
        clock = SessionClock(anchor, int(header["started_ns"]))
        ended_ns = header.get("ended_ns")
        clock.utc(clock.started_ns)
    except (KeyError, TypeError, ValueError, OverflowError, OSError) as error:
        _log.warning("%s: %r", folder / "session.json", error)
        raise SessionError(
            localized(
                QT_TR_NOOP(
                    "{path} does not contain the start time of the session. Restore it from a backup, or "
                    "move it away to rebuild it from events.mcap as far as possible."
                ),
                path=folder / "session.json",
            )
        ) from error
    known = isinstance(ended_ns, int) and not isinstance(ended_ns, bool)
    return SessionTimes(clock, ended_ns if known else None, str(header.get("reason") or "") if known else "")
