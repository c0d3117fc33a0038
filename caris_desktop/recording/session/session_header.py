"""``session.json``: what heads a session, read with care: it may come from anywhere."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.recording.recorder.session_recorder import FORMAT, FORMAT_VERSION
from caris_desktop.recording.session.session_clock import SessionClock

_MAX_HEADER_BYTES = 16 * 1024 * 1024


class SessionError(Exception):
    """A folder that is no session, or one that cannot be read; the text is for people."""


@dataclass(frozen=True, slots=True)
class SessionTimes:
    """When a session was. ``ended_ns`` is None where it was not closed."""

    clock: SessionClock
    ended_ns: int | None
    reason: str


def read_header(folder: Path) -> dict[str, Any]:
    """``session.json`` of a folder that has what makes a session.

    Raises
    ------
    SessionError
        If ``folder`` is no session, or one of another program or a newer version.
    """
    if not folder.is_dir():
        raise SessionError(f"{folder} is no folder. A session is a folder with session.json and events.mcap in it.")
    path = folder / "session.json"
    for name in ("session.json", "events.mcap"):
        if not inside(folder, name):
            raise SessionError(f"{folder / name} is a link that leads out of the session. It is not followed.")
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_HEADER_BYTES + 1)
        if len(content) > _MAX_HEADER_BYTES:
            raise SessionError(f"{path} is far too large to head a session ({path.stat().st_size} bytes).")
        header = json.loads(content)
    except FileNotFoundError as error:
        raise SessionError(f"{folder} is no session: it holds no session.json.") from error
    except OSError as error:
        raise SessionError(f"{path} cannot be read: {error.strerror or error}.") from error
    except (ValueError, RecursionError) as error:
        raise SessionError(f"{path} is damaged: {error}.") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise SessionError(f"{path} does not head a session of CARIS Desktop.")
    version = header.get("format_version")
    if not isinstance(version, int) or version > FORMAT_VERSION:
        raise SessionError(
            f"{path} has version {version}; this program reads up to version {FORMAT_VERSION}. Update CARIS Desktop."
        )
    if not (folder / "events.mcap").is_file():
        raise SessionError(f"{folder} holds no events.mcap: nothing of the session was saved.")
    return header


def inside(folder: Path, name: str) -> bool:
    """Whether a file of that name lies in ``folder`` itself, and not somewhere that a link leads to."""
    return Path(name).name == name and (folder / name).resolve().parent == folder.resolve()


def times_of(header: Mapping[str, Any], folder: Path) -> SessionTimes:
    """Raises SessionError when the header does not tell."""
    try:
        anchor = ClockAnchor(int(header["clock"]["monotonic_ns"]), int(header["clock"]["utc_ns"]))
        clock = SessionClock(anchor, int(header["started_ns"]))
        ended_ns = header.get("ended_ns")
        clock.utc(clock.started_ns)
    except (KeyError, TypeError, ValueError, OverflowError, OSError) as error:
        raise SessionError(f"{folder / 'session.json'} does not say when the session began ({error!r}).") from error
    known = isinstance(ended_ns, int) and not isinstance(ended_ns, bool)
    return SessionTimes(clock, ended_ns if known else None, str(header.get("reason") or "") if known else "")
