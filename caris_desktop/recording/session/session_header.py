"""Session time, and the session header (``session.json``): read leniently, since sessions may come from any source."""

import io
import json
import logging
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import field, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Any, Self, TypeVar, cast, get_args, get_origin, get_type_hints

from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import RecordingPaused, RobotChosen, ScenarioOpened, SessionStarted
from caris_desktop.domain.file_replacement import replace_file
from caris_desktop.domain.json_encoding import from_message
from caris_desktop.domain.schema import from_jsonable, to_jsonable
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.translation import QT_TR_NOOP, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.events_file import BlockIndex, Message
from caris_desktop.recording.session.loss_messages import read_loss
from caris_desktop.recording.session.manifest import MANIFEST_NAME, session_files


class SessionClock(Value):
    """Session clock; second 0 is ``started_ns``."""

    anchor: ClockAnchor
    started_ns: int

    def session_s(self, stamp_ns: int) -> float:
        """Seconds since the session start; negative for earlier values."""
        return (stamp_ns - self.started_ns) / 1e9

    def at_utc(self, utc_ns: int) -> int:
        """Session time of a moment in UTC."""
        return utc_ns - self.anchor.utc_ns + self.anchor.monotonic_ns

    def utc(self, stamp_ns: int) -> str:
        """ISO 8601 in UTC, microseconds: ``2026-11-21T10:14:02.123456Z``."""
        seconds, nanoseconds = divmod(self.anchor.utc_ns_at(stamp_ns), 1_000_000_000)
        moment = datetime.fromtimestamp(seconds, UTC)
        return f"{moment:%Y-%m-%dT%H:%M:%S}.{nanoseconds // 1000:06d}Z"

    def wall(self, stamp_ns: int) -> str:
        """Local time: ``10:14:02.123``."""
        seconds, nanoseconds = divmod(self.anchor.utc_ns_at(stamp_ns), 1_000_000_000)
        moment = datetime.fromtimestamp(seconds, UTC).astimezone()
        return f"{moment:%H:%M:%S}.{nanoseconds // 1_000_000:03d}"


def clock_text(seconds: float) -> str:
    """``12:04``, or ``1:02:04`` from an hour on."""
    sign = "−" if seconds < -0.5 else ""
    total_s = round(abs(seconds))
    hours, rest = divmod(total_s, 3600)
    return f"{sign}{hours}:{rest // 60:02d}:{rest % 60:02d}" if hours else f"{sign}{rest // 60}:{rest % 60:02d}"


# Pauses of a recording, from its events.


def pauses_of(events: Iterable[RecordingPaused], *, ended_ns: int) -> list[tuple[int, int]]:
    """Start and end of each pause in recording order; an unfinished one ends with the session."""
    pauses: list[tuple[int, int]] = []
    began_ns: int | None = None
    for event in events:
        if event.paused and began_ns is None:
            began_ns = event.stamp_ns
        elif not event.paused and began_ns is not None:
            pauses.append((began_ns, event.stamp_ns))
            began_ns = None
    if began_ns is not None and began_ns < ended_ns:
        pauses.append((began_ns, ended_ns))
    return pauses


_log = logging.getLogger(__name__)
T = TypeVar("T")
# 1 and 2 had our own schemas only, null for None, and no actor; 2 added the checksums.
FORMAT, FORMAT_VERSION = "caris-desktop session", 3
TRIAL_METADATA = "trial."
HEADER_NAME = "session.json"
_EVENTS = "events.mcap"
_LAST_UNTOLD_VERSION = 2
_MAX_HEADER_BYTES = 16 * 1024 * 1024
_CLOCK_NOTE = (
    "The UTC time of a timestamp is utc_ns + (stamp_ns - monotonic_ns). In events.mcap, publish_time is the "
    "measurement time of a value, from the robot's timestamp if its clock is known. log_time is the arrival time at "
    "the console. Both are in UTC."
)
_LEFT_OUT_IF_EMPTY = ("source", "lost", "losses", "repairs", "anonymised")
_MEDIA = ("videos", "audio")


class SessionError(Exception):
    """Folder that is not a readable session, with the reason as user text; ``values`` fill its ``{names}``."""

    def __init__(self, text: str, **values: object) -> None:
        super().__init__(localized(text, **values))


@contextmanager
def reading(path: Path, unreadable: Callable[..., Exception] = SessionError) -> Iterator[None]:
    """Context that raises SessionError, or another such error, with a user text instead of an OSError."""
    try:
        yield
    except OSError as error:
        raise unreadable(QT_TR_NOOP("{path} cannot be read: {why}."), path=path, why=error.strerror or error) from error


class VideoInfo(Value):
    """One video. Its time 0 is ``first_stamp_ns`` of the session clock.

    ``rate_hz`` is its mean frame rate; ``left_out`` counts frames that were not encoded, to keep up. ``delay_ms`` is
    how long a frame took from the camera to here (the median) and ``uncertainty_ms`` how far off that may be at most;
    the video shows frames when they were taken. None: not known, and they are shown when they arrived.
    """

    file_name: str
    camera: str
    frames: int = 0
    width_px: int = 0
    height_px: int = 0
    first_stamp_ns: int = 0
    last_stamp_ns: int = 0
    index_file: str = ""
    encoder: str = ""
    rate_hz: float = 0.0
    left_out: int = 0
    delay_ms: float | None = None
    uncertainty_ms: float | None = None


class AudioInfo(Value):
    """One sound file. Its time 0 is ``first_stamp_ns`` of the session clock.

    ``samples`` counts those of one channel; ``last_stamp_ns`` is the end of the last one.
    """

    file_name: str
    source: str = ""
    sample_rate_hz: int = 0
    channels: int = 1
    samples: int = 0
    first_stamp_ns: int = 0
    last_stamp_ns: int = 0


class RecordedScenario(Value):
    """Scenario at the start of the session."""

    title: str = ""
    file: str = ""
    sha256: str = ""


class RecordedRobot(Value):
    """Robot at the start of the session."""

    profile: str = ""
    address: str = ""


class RecordedPause(Value):
    """Pause of the recording, in session time; ``resumed_ns`` is None if it was not resumed."""

    paused_ns: int
    resumed_ns: int | None = None


class RecordedFile(Value):
    """Relative path of a file, and its size at the close."""

    name: str
    bytes: int


class Anonymised(Value):
    """How a copy of a session was anonymised: when, by which version, and what became of names, faces and voices.

    ``left_out`` has a sentence for each file that is not in the copy, or not whole.
    """

    utc: str = ""
    program_version: str = ""
    names: str = ""
    faces: str = ""
    voices: str = ""
    left_out: tuple[str, ...] = ()


class SessionHeader(Value):
    """Content of ``session.json``, field by field; what is missing or damaged there has its default.

    ``trial`` holds the answers of the start dialog by field name. ``software`` maps programs and libraries to versions;
    ``settings`` describes this run's settings as text. Neither contains keys or paths.

    ``ended_ns`` is None for a session that was not closed. ``counts`` are values per stream, ``dropped`` those that
    were not recorded, and ``lost`` those that a repair found missing, which ``losses`` describe. ``source`` describes
    the bag that the session was imported from. ``anonymised`` is set in an anonymised copy only. ``invalid_videos``
    are entries that cannot be understood; ``as_read`` is the content of the file, of which :meth:`to_json` preserves
    what was not changed.
    """

    clock: ClockAnchor
    format: str = FORMAT
    format_version: int = FORMAT_VERSION
    program_version: str = ""
    scenario: RecordedScenario = RecordedScenario()
    robot: RecordedRobot = RecordedRobot()
    trial: dict[str, str] = field(default_factory=dict)
    software: dict[str, str] = field(default_factory=dict)
    settings: dict[str, str] = field(default_factory=dict)
    started_ns: int = 0
    started_utc: str = ""
    ended_ns: int | None = None
    ended_utc: str | None = None
    duration_s: float | None = None
    reason: str | None = None
    pauses: tuple[RecordedPause, ...] = ()
    counts: dict[str, int] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    videos: tuple[VideoInfo, ...] = ()
    audio: tuple[AudioInfo, ...] = ()
    source: dict[str, Any] = field(default_factory=dict)
    files: tuple[RecordedFile, ...] = ()
    lost: dict[str, int] = field(default_factory=dict)
    losses: tuple[str, ...] = ()
    repairs: tuple[str, ...] = ()
    anonymised: Anonymised | None = None
    invalid_videos: tuple[str, ...] = ()
    as_read: Mapping[str, Any] = field(default_factory=dict, compare=False)

    @property
    def session_clock(self) -> SessionClock:
        return SessionClock(self.clock, self.started_ns)

    def started(self, started_ns: int) -> Self:
        """Header of a session that starts then."""
        return replace(self, started_ns=started_ns, started_utc=SessionClock(self.clock, started_ns).utc(started_ns))

    def ended(self, ended_ns: int, reason: str, **changes: Any) -> Self:
        """Header of the closed session, with further ``changes``."""
        clock = self.session_clock
        duration_s = round(clock.session_s(ended_ns), 3)
        return replace(
            self, ended_ns=ended_ns, ended_utc=clock.utc(ended_ns), duration_s=duration_s, reason=reason, **changes
        )

    def size_of(self, name: str) -> int | None:
        """Size of a file in bytes when the session was closed; None if unknown."""
        return next((file.bytes for file in self.files if file.name == name), None)

    def to_json(self) -> dict[str, Any]:
        """Content of the file."""
        now = _fields(self)
        if not self.as_read:
            return {key: value for key, value in now.items() if value or key not in _LEFT_OUT_IF_EMPTY}
        before = _fields(header_of(self.as_read, Path(HEADER_NAME)))
        return {**self.as_read, **{key: value for key, value in now.items() if value != before[key]}}

    def write(self, folder: Path, *, on_full: Callable[[], bool] = lambda: False) -> None:
        """Write ``session.json`` atomically and synced. ``on_full`` as in :func:`replace_file`. Raises OSError."""
        text = json.dumps(self.to_json(), indent=2, ensure_ascii=False) + "\n"
        replace_file(folder / HEADER_NAME, text.encode("utf-8", "replace"), durable=True, on_full=on_full)


def recorded_files(folder: Path) -> tuple[RecordedFile, ...]:
    """Files of a session but its header, which will list them. Raises OSError."""
    names = (name for name in session_files(folder) if name != HEADER_NAME)
    return tuple(RecordedFile(name, (folder / name).stat().st_size) for name in names)


_OUTSIDE_THE_FILE = ("invalid_videos", "as_read")
_KINDS = {name: kind for name, kind in get_type_hints(SessionHeader).items() if name not in _OUTSIDE_THE_FILE}


def _fields(header: SessionHeader) -> dict[str, Any]:
    data = {field.name: getattr(header, field.name) for field in fields(header) if field.name not in _OUTSIDE_THE_FILE}
    return {**to_jsonable(data), "clock": {**to_jsonable(header.clock), "note": _CLOCK_NOTE}}


def header_of(data: Mapping[str, Any], path: Path) -> SessionHeader:
    """Header from the content of ``path``. Raises SessionError if the start time is missing."""
    values: dict[str, Any] = {}
    invalid: list[str] = []
    for name, kind in _KINDS.items():
        if name in data:
            with suppress(ValueError):
                values[name] = _leniently(name, kind, data[name], invalid)
    try:
        SessionClock(values["clock"], values["started_ns"]).utc(values["started_ns"])
    except (KeyError, ValueError, OverflowError, OSError) as error:
        _log.info("%s: no start time: %r", path, error)
        raise SessionError(
            QT_TR_NOOP(
                "{path} does not contain the start time of the session. Restore it from a backup, or "
                "move it away to rebuild it from events.mcap as far as possible."
            ),
            path=path,
        ) from error
    values["losses"] = tuple(map(read_loss, values.get("losses", ())))
    return SessionHeader(**values, invalid_videos=tuple(invalid), as_read=data)


def _leniently(name: str, kind: Any, data: Any, invalid: list[str]) -> Any:
    """Value of a field, without those of its entries that do not fit."""
    if kind == dict[str, str] and isinstance(data, dict):
        return {str(key): str(value) for key, value in data.items()}
    if get_origin(kind) is dict and isinstance(data, dict):
        item = get_args(kind)[1]
        return {key: value for key, value in data.items() if item is Any or type(value) is item}
    if get_origin(kind) is not tuple or not isinstance(data, list):
        return from_jsonable(kind, data)
    item, found = get_args(kind)[0], []
    for entry in data:
        try:
            found.append(from_jsonable(item, {"first_stamp_ns": None, **entry} if name in _MEDIA else entry))
        except (ValueError, TypeError):
            invalid += [str(entry)[:200]] if name == "videos" else []
    return tuple(found)


def holds_record(folder: Path) -> bool:
    """True if ``folder`` contains events recorded by this program, with or without ``session.json``."""
    try:
        return events_file.is_ours(folder / _EVENTS)
    except OSError:
        return False


def is_session(folder: Path) -> bool:
    """True if ``folder`` contains a session, even one without ``session.json``."""
    return (folder / HEADER_NAME).exists() or holds_record(folder)


def inside(folder: Path, name: str) -> bool:
    """True if the file name is directly in ``folder``, also after resolving links."""
    return Path(name).name == name and (folder / name).resolve().parent == folder.resolve()


def read_header(folder: Path) -> SessionHeader:
    """Read ``session.json``; if it is lost, rebuild it from the events.

    Raises SessionError if ``folder`` is no session, one of another program or a newer version, or its start time is
    unknown.
    """
    return header_of(read_raw_header(folder), folder / HEADER_NAME)


def read_raw_header(folder: Path) -> dict[str, Any]:
    """Content of the header, which may lack the start time. Raises SessionError as :func:`read_header`."""
    if not folder.is_dir():
        raise SessionError(
            QT_TR_NOOP("{folder} is not a folder. A session is a folder that contains session.json and events.mcap."),
            folder=folder,
        )
    path = folder / HEADER_NAME
    with reading(folder):
        endless = next(_endless_in(folder), None)
    if endless is not None:
        raise SessionError(
            QT_TR_NOOP("{path} is a pipe or a device, which could be read forever. Remove it from the session."),
            path=endless,
        )
    for name in (HEADER_NAME, _EVENTS):
        if not inside(folder, name):
            raise SessionError(
                QT_TR_NOOP("{path} is a link to a location outside the session. It is not followed."),
                path=folder / name,
            )
    header = _recorded_header(folder, path)
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise SessionError(QT_TR_NOOP("{path} is not the header of a CARIS Desktop session."), path=path)
    version = header.get("format_version")
    if not isinstance(version, int) or version > FORMAT_VERSION:
        raise SessionError(
            QT_TR_NOOP(
                "{path} has version {version}; this program reads up to version {newest}. Update CARIS Desktop."
            ),
            path=path,
            version=version,
            newest=FORMAT_VERSION,
        )
    if not (folder / _EVENTS).is_file():
        raise SessionError(
            QT_TR_NOOP(
                "{folder} does not contain events.mcap: the events and the speech of the session are "
                "lost. Restore the file from a backup, if there is one. The other files in the folder "
                "were not changed."
            ),
            folder=folder,
        )
    return header


def _endless_in(folder: Path) -> Iterator[Path]:
    """Pipes and devices, also behind links, in a session, which may come from any source. Raises OSError."""
    with os.scandir(folder) as entries:
        for entry in entries:
            path = Path(entry.path)
            if entry.is_dir(follow_symlinks=False):
                yield from _endless_in(path)
            elif not entry.is_file(follow_symlinks=False) and path.exists() and not (path.is_file() or path.is_dir()):
                yield path


def _recorded_header(folder: Path, path: Path) -> Any:
    try:
        with path.open("rb") as file:
            content = file.read(_MAX_HEADER_BYTES + 1)
        if len(content) > _MAX_HEADER_BYTES:
            raise SessionError(
                QT_TR_NOOP("{path} is far too large for a session header ({size} bytes)."),
                path=path,
                size=path.stat().st_size,
            )
        return json.loads(content)
    except FileNotFoundError:
        missing = True
    except OSError as error:
        raise SessionError(
            QT_TR_NOOP("{path} cannot be read: {why}."), path=path, why=error.strerror or error
        ) from error
    except (ValueError, RecursionError) as error:
        _log.warning("%s: %s", path, error)
        missing = False
    if holds_record(folder):
        header = rebuilt_header(folder, missing=missing)
        if header is not None:
            return header.to_json()
        raise SessionError(
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
    if not missing:
        raise SessionError(
            QT_TR_NOOP("{path} is damaged, and there is no events.mcap next to it to rebuild it from."), path=path
        )
    if (folder / MANIFEST_NAME).is_file():
        raise SessionError(
            QT_TR_NOOP(
                "{folder} no longer contains session.json or events.mcap: the events of the session "
                "are lost. Restore both files from a backup. The other files in the folder were not "
                "changed."
            ),
            folder=folder,
        )
    raise SessionError(QT_TR_NOOP("{folder} is not a session: session.json is missing."), folder=folder)


def rebuilt_header(folder: Path, *, missing: bool) -> SessionHeader | None:
    """Header rebuilt from the events in ``folder``, as for an unclosed session; None if they do not suffice.

    ``missing``: there was no ``session.json``, rather than a damaged one.
    """
    try:
        with (folder / _EVENTS).open("rb") as file:
            index = events_file.scan(file, thorough=False)
            began = _beginning(file, index)
            if began is None:
                return None
            anchor, started_ns = began
            scenario = _first(file, index, ScenarioOpened)
            robot = _first(file, index, RobotChosen)
            metadata = _metadata(index)
            version = metadata.get("format_version", "")
            return SessionHeader(
                anchor,
                format_version=int(version) if version.isdecimal() else _LAST_UNTOLD_VERSION,
                program_version=metadata.get("program_version", ""),
                scenario=RecordedScenario()
                if scenario is None
                else RecordedScenario(scenario.title, scenario.file_name, scenario.sha256),
                robot=RecordedRobot()
                if robot is None
                else RecordedRobot(robot.name, without_credentials(robot.address)),
                trial={
                    key.removeprefix(TRIAL_METADATA): value
                    for key, value in metadata.items()
                    if key.startswith(TRIAL_METADATA)
                },
                losses=(
                    QT_TR_NOOP(
                        "session.json was missing. The session header was rebuilt from events.mcap. The "
                        "wizard's name, the settings and the record of missing data are lost."
                    )
                    if missing
                    else QT_TR_NOOP(
                        "session.json was damaged. The session header was rebuilt from events.mcap. The "
                        "wizard's name, the settings and the record of missing data are lost."
                    ),
                ),
            ).started(started_ns)
    except (OSError, ValueError, OverflowError) as error:
        _log.warning("%s: its head cannot be made anew: %s", folder, error)
        return None


def _beginning(file: IO[bytes], index: BlockIndex) -> tuple[ClockAnchor, int] | None:
    """A moment in session time and UTC, and the start in session time."""
    for topics in ({f"/{BY_TYPE[SessionStarted].name}"}, {channel.topic for channel in index.channels.values()}):
        for message, data in _messages(file, index, topics):
            stamp_ns = data.get("stamp_ns")
            # Messages with a robot stamp are published in robot time, which differs from their arrival.
            if isinstance(stamp_ns, int) and message.publish_ns > 0 and data.get("robot_stamp_ns") is None:
                # Values from before the session are older than it, and arrived at its start.
                return ClockAnchor(stamp_ns, message.publish_ns), message.log_ns - message.publish_ns + stamp_ns
    return None


def _first(file: IO[bytes], index: BlockIndex, kind: type[T]) -> T | None:
    for _, data in _messages(file, index, {f"/{BY_TYPE[kind].name}"}):
        with suppress(ValueError):
            return cast(T, from_message(BY_TYPE[kind], data))
    return None


def _messages(file: IO[bytes], index: BlockIndex, topics: set[str]) -> Iterator[tuple[Message, dict[str, Any]]]:
    """Messages of these topics."""
    channels = {number for number, channel in index.channels.items() if channel.topic in topics}
    for message, content in events_file.read_messages(file, index, channels):
        with suppress(ValueError, RecursionError):
            data = json.loads(content)
            if isinstance(data, dict):
                yield message, data


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
