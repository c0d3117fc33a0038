"""Session header (``session.json``), read defensively, since sessions may come from any source."""

import io
import json
import logging
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any, TypeVar, cast

from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import RobotChosen, ScenarioOpened, SessionStarted
from caris_desktop.domain.json_encoding import from_message
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.session import mcap_chunks
from caris_desktop.recording.session.format import FORMAT, FORMAT_VERSION, TRIAL_METADATA
from caris_desktop.recording.session.manifest import MANIFEST_NAME
from caris_desktop.recording.session.mcap_chunks import BlockIndex, Message
from caris_desktop.recording.session.session_clock import SessionClock

T = TypeVar("T")
_EVENTS = "events.mcap"
_LIBRARY = "caris-desktop"
_LAST_UNTOLD_VERSION = 2


def holds_record(folder: Path) -> bool:
    """True if ``folder`` contains events recorded by this program, with or without ``session.json``."""
    try:
        return mcap_chunks.library_of(folder / _EVENTS) == _LIBRARY
    except OSError:
        return False


def rebuilt_header(folder: Path, *, missing: bool) -> dict[str, Any] | None:
    """Header rebuilt from the events in ``folder``, as for an unclosed session; None if they do not suffice.

    ``missing``: there was no ``session.json``, rather than a damaged one.
    """
    try:
        with (folder / _EVENTS).open("rb") as file:
            index = mcap_chunks.scan(file, thorough=False)
            began = _beginning(file, index)
            if began is None:
                return None
            anchor, started_ns = began
            clock = SessionClock(anchor, started_ns)
            scenario = _first(file, index, ScenarioOpened)
            robot = _first(file, index, RobotChosen)
            version = _metadata(index).get("format_version", "")
            return {
                "format": FORMAT,
                "format_version": int(version) if version.isdecimal() else _LAST_UNTOLD_VERSION,
                "program_version": _metadata(index).get("program_version", ""),
                "scenario": {"title": "", "file": "", "sha256": ""}
                if scenario is None
                else {"title": scenario.title, "file": scenario.file_name, "sha256": scenario.sha256},
                "robot": {"profile": "", "address": ""}
                if robot is None
                else {"profile": robot.name, "address": without_credentials(robot.address)},
                "trial": {
                    key.removeprefix(TRIAL_METADATA): value
                    for key, value in _metadata(index).items()
                    if key.startswith(TRIAL_METADATA)
                },
                "software": {},
                "settings": {},
                "clock": {"monotonic_ns": anchor.monotonic_ns, "utc_ns": anchor.utc_ns},
                "started_ns": started_ns,
                "started_utc": clock.utc(started_ns),
                "ended_ns": None,
                "reason": None,
                "losses": [
                    QT_TR_NOOP(
                        "session.json was missing. The session header was rebuilt from events.mcap. The "
                        "wizard's name, the settings and the record of missing data are lost."
                    )
                    if missing
                    else QT_TR_NOOP(
                        "session.json was damaged. The session header was rebuilt from events.mcap. The "
                        "wizard's name, the settings and the record of missing data are lost."
                    )
                ],
            }
    except (OSError, ValueError, OverflowError) as error:
        _log.warning("%s: its head cannot be made anew: %s", folder, error)
        return None


def _beginning(file: IO[bytes], index: BlockIndex) -> tuple[ClockAnchor, int] | None:
    """A moment in session time and UTC, and the start in session time."""
    topic = f"/{BY_TYPE[SessionStarted].name}"
    numbers = [number for number, channel in index.channels.items() if channel.topic == topic]
    for only in (numbers, list(index.channels)):
        for message, content in _messages(file, index, only):
            try:
                fields = json.loads(content)
                stamp_ns = fields["stamp_ns"]
            except (ValueError, KeyError, TypeError, RecursionError):
                continue
            # Messages with a robot stamp are published in robot time, which differs from their arrival.
            if isinstance(stamp_ns, int) and message.publish_ns > 0 and fields.get("robot_stamp_ns") is None:
                # Values from before the session are older than it, and arrived at its start.
                return ClockAnchor(stamp_ns, message.publish_ns), message.log_ns - message.publish_ns + stamp_ns
    return None


def _first(file: IO[bytes], index: BlockIndex, kind: type[T]) -> T | None:
    topic = f"/{BY_TYPE[kind].name}"
    numbers = [number for number, channel in index.channels.items() if channel.topic == topic]
    for _, content in _messages(file, index, numbers):
        try:
            return cast(T, from_message(BY_TYPE[kind], json.loads(content)))
        except (ValueError, RecursionError):
            continue
    return None


def _messages(file: IO[bytes], index: BlockIndex, channels: list[int]) -> Iterator[tuple[Message, bytes]]:
    """Messages of these channels in the first chunks that contain any."""
    blocks = sorted({int(number) for channel in channels for number in index.blocks_of.get(channel, ())})
    for number in blocks[:3]:
        try:
            content = mcap_chunks.read_block(file, index, number)
        except mcap_chunks.DamagedBlockError:
            continue
        for message in mcap_chunks.messages_of(content):
            if message.channel in channels:
                yield message, content[message.start : message.end]


def _metadata(index: BlockIndex) -> dict[str, str]:
    from mcap.data_stream import ReadDataStream
    from mcap.opcode import Opcode
    from mcap.records import Metadata

    for record in index.beside:
        if record[0] == Opcode.METADATA:
            metadata = Metadata.read(ReadDataStream(io.BytesIO(record[9:])))
            if metadata.name == "session":
                return dict(metadata.metadata)
    return {}


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
                QT_TR_NOOP("{path} is damaged, and there is no events.mcap next to it to rebuild it from."), path=path
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
