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
                QT_TR_NOOP("{folder} is no folder. A session is a folder with session.json and events.mcap in it."),
                folder=folder,
            )
        )
    path = folder / "session.json"
    for name in ("session.json", "events.mcap"):
        if not inside(folder, name):
            raise SessionError(
                localized(
                    QT_TR_NOOP("{path} is a link that leads out of the session. It is not followed."),
                    path=folder / name,
                )
            )
    header = _recorded_header(folder, path)
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise SessionError(localized(QT_TR_NOOP("{path} does not head a session of CARIS Desktop."), path=path))
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
                    "{folder} holds no events.mcap: what happened and what was said in the session is lost."
                    " Restore the file from a copy, if there is one; what else lies in the folder was left"
                    " alone."
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
                    QT_TR_NOOP("{path} is far too large to head a session ({size} bytes)."),
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
                        "{folder} holds neither session.json nor events.mcap any more: what happened in the"
                        " session is lost. Restore them from a copy; what else lies in the folder was left"
                        " alone."
                    ),
                    folder=folder,
                )
            )
        if missing:
            raise SessionError(
                localized(QT_TR_NOOP("{folder} is no session: it holds no session.json."), folder=folder)
            )
        raise SessionError(
            localized(
                QT_TR_NOOP("{path} is damaged, and there are no events.mcap beside it from which to make it anew."),
                path=path,
            )
        )
    header = rebuilt_header(folder, missing=missing)
    if header is None:
        raise SessionError(
            localized(
                QT_TR_NOOP(
                    "{path} was missing, and what is left of events.mcap does not say when the session began."
                    " Restore session.json from a copy; nothing was changed."
                )
                if missing
                else QT_TR_NOOP(
                    "{path} was damaged, and what is left of events.mcap does not say when the session began."
                    " Restore session.json from a copy; nothing was changed."
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
                    "{path} does not say when the session began. Restore it from a copy, or move it away:"
                    " it is made anew then from events.mcap, as far as that goes."
                ),
                path=folder / "session.json",
            )
        ) from error
    known = isinstance(ended_ns, int) and not isinstance(ended_ns, bool)
    return SessionTimes(clock, ended_ns if known else None, str(header.get("reason") or "") if known else "")
