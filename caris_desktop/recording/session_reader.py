"""Reads a session folder, also one that was cut off in the middle."""

import json
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import SessionEnded
from caris_desktop.domain.schema import from_jsonable
from caris_desktop.domain.streams import BY_NAME, StreamSpec, spec_of_topic
from caris_desktop.recording.session_clock import SessionClock
from caris_desktop.recording.session_recorder import FORMAT, FORMAT_VERSION

_log = logging.getLogger(__name__)
_MAX_HEADER_BYTES = 16 * 1024 * 1024


class SessionError(Exception):
    """A folder that is no session, or one that cannot be read; the text is for people."""


@dataclass(frozen=True, slots=True)
class Session:
    """One recorded session. ``header`` is ``session.json`` as it is on disk.

    Where the recorder was killed, ``closed_properly`` is False, ``reason`` is empty and ``ended_ns`` is the newest
    stamp that was saved.
    """

    folder: Path
    header: dict[str, Any]
    clock: SessionClock
    ended_ns: int
    closed_properly: bool
    reason: str

    @property
    def started_ns(self) -> int:
        return self.clock.started_ns

    @property
    def duration_s(self) -> float:
        return max(0.0, self.clock.session_s(self.ended_ns))

    @property
    def trial(self) -> dict[str, str]:
        trial = self.header.get("trial")
        return {str(key): str(value) for key, value in trial.items()} if isinstance(trial, dict) else {}

    def values(self, *streams: str) -> Iterator[tuple[StreamSpec, Any]]:
        """Every value of these streams (all of them when none is named), as recorded, in the order of recording.

        Values of streams that this program does not know, and values that do not fit their type, are left out and
        logged.

        Raises
        ------
        KeyError
            If a name is not in the stream table.
        """
        wanted = {BY_NAME[name].name for name in streams}
        return _values(self.folder / "events.mcap", wanted)


def open_session(folder: Path) -> Session:
    """Read the header and, where the session was not closed properly, find out where it ends.

    Raises
    ------
    SessionError
        If ``folder`` is no session that this program can read.
    """
    if not folder.is_dir():
        raise SessionError(f"{folder} is no folder. A session is a folder with session.json and events.mcap in it.")
    header = _read_header(folder / "session.json")
    if not (folder / "events.mcap").is_file():
        raise SessionError(f"{folder} holds no events.mcap: nothing of the session was saved.")
    try:
        anchor = ClockAnchor(int(header["clock"]["monotonic_ns"]), int(header["clock"]["utc_ns"]))
        started_ns = int(header["started_ns"])
        ended_ns = header.get("ended_ns")
        reason = str(header.get("reason") or "")
        clock = SessionClock(anchor, started_ns)
        if isinstance(ended_ns, int):
            return Session(folder, header, clock, ended_ns, True, reason)
    except (KeyError, TypeError, ValueError) as error:
        raise SessionError(f"{folder / 'session.json'} does not say when the session began ({error!r}).") from error
    newest_ns, end = started_ns, None
    for _, value in _values(folder / "events.mcap", set()):
        newest_ns = max(newest_ns, value.stamp_ns)
        if isinstance(value, SessionEnded):
            end = value
    if end is not None:
        return Session(folder, header, clock, end.stamp_ns, True, end.reason)
    return Session(folder, header, clock, newest_ns, False, "")


def _read_header(path: Path) -> dict[str, Any]:
    try:
        with path.open("rb") as file:
            header = json.loads(file.read(_MAX_HEADER_BYTES))
    except FileNotFoundError as error:
        raise SessionError(f"{path.parent} is no session: it holds no session.json.") from error
    except OSError as error:
        raise SessionError(f"{path} cannot be read: {error.strerror or error}.") from error
    except ValueError as error:
        raise SessionError(f"{path} is damaged: {error}.") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise SessionError(f"{path} does not head a session of CARIS Desktop.")
    version = header.get("format_version")
    if not isinstance(version, int) or version > FORMAT_VERSION:
        raise SessionError(
            f"{path} has version {version}; this program reads up to version {FORMAT_VERSION}. Update CARIS Desktop."
        )
    return header


def _values(path: Path, wanted: set[str]) -> Iterator[tuple[StreamSpec, Any]]:
    from mcap.records import Channel, Message

    topics: dict[int, str] = {}
    unusable: set[str] = set()
    for record in _records(path):
        if isinstance(record, Channel):
            topics[record.id] = record.topic
        elif isinstance(record, Message):
            spec = spec_of_topic(topics.get(record.channel_id, ""))
            name = spec.name if spec is not None else topics.get(record.channel_id, "")
            if wanted and name not in wanted:
                continue
            try:
                if spec is None:
                    raise ValueError("not a stream of this program")  # noqa: TRY301 - told below, once a stream
                value = from_jsonable(spec.value_type, json.loads(record.data))
            except ValueError as error:
                if name not in unusable:
                    _log.warning("%s: values of %s are left out: %s", path, name, error)
                unusable.add(name)
                continue
            yield spec, value


def _records(path: Path) -> Iterator[Any]:
    """Records until the file ends or breaks off."""
    from mcap.stream_reader import StreamReader

    try:
        file = path.open("rb")
    except OSError as error:
        raise SessionError(f"{path} cannot be read: {error.strerror or error}.") from error
    with file:
        records = iter(StreamReader(file, record_size_limit=path.stat().st_size).records)
        while True:
            try:
                record = next(records)
            except StopIteration:
                return
            except Exception as error:
                # Cut or damaged bytes raise errors of many kinds (struct, zstd, overflow, memory, mcap's own).
                _log.info("%s breaks off at byte %d (%r)", path, file.tell(), error)
                return
            yield record
