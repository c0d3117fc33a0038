"""Recovery of a lost or damaged ``session.json`` from a session's events."""

import io
import json
import logging
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, TypeVar, cast

from caris_desktop.domain.address import without_credentials
from caris_desktop.domain.clock import ClockAnchor
from caris_desktop.domain.events import RobotChosen, ScenarioOpened, SessionStarted
from caris_desktop.domain.json_encoding import from_message
from caris_desktop.domain.streams import BY_TYPE
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.recording.session import mcap_chunks
from caris_desktop.recording.session.format import FORMAT, TRIAL_METADATA
from caris_desktop.recording.session.mcap_chunks import BlockIndex, Message
from caris_desktop.recording.session.session_clock import SessionClock

_log = logging.getLogger(__name__)
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
