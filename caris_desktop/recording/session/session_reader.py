"""Reader of session folders, including interrupted recordings."""

import json
import logging
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Any, TypeVar

from caris_desktop.domain.events import SessionEnded
from caris_desktop.domain.json_encoding import TRANSFORMS_TOPIC, from_message
from caris_desktop.domain.streams import BY_NAME, BY_TYPE, StreamSpec, spec_of_topic
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.session import events_file
from caris_desktop.recording.session.recovery import losses_of, missing_values, repair_session
from caris_desktop.recording.session.session_header import (
    SessionClock,
    SessionError,
    SessionHeader,
    read_header,
    reading,
)

__all__ = ["Session", "SessionError", "open_session"]
_log = logging.getLogger(__name__)
T = TypeVar("T")
_EVENTS = "events.mcap"
_decode = json.JSONDecoder().raw_decode  # one that skips spaces by itself takes twice the time for short messages
_SPACES = " \t\n\r"  # of JSON
RECOVERED = "recovered"
"""Reason of an unintended end: the record stops where something broke."""


def _as_it_is(content: T) -> T:
    return content


class Session(Value):
    """One recorded session. ``header`` is ``session.json``.

    For an interrupted recording ``closed_properly`` is False, ``reason`` is ``recovered``, or empty without a repair,
    and ``ended_ns`` is the time of the last saved value. ``notices`` are user texts on repairs at opening or their
    failure; ``losses`` describe missing data, and ``lost`` counts missing values per stream.

    For pseudonymisation, ``scrub`` is applied to the JSON of each value; ``wizard_name`` and ``coder_name`` map names,
    and ``names`` is a digest of that assignment, empty without one.
    """

    folder: Path
    header: SessionHeader
    clock: SessionClock
    ended_ns: int
    closed_properly: bool
    reason: str
    notices: tuple[str, ...] = ()
    losses: tuple[str, ...] = ()
    lost: Mapping[str, int] = field(default_factory=dict)
    scrub: Callable[[bytes], bytes] = field(default=_as_it_is, compare=False)
    wizard_name: Callable[[str], str] = field(default=_as_it_is, compare=False)
    coder_name: Callable[[str], str] = field(default=_as_it_is, compare=False)
    names: str = ""

    @property
    def started_ns(self) -> int:
        return self.clock.started_ns

    @property
    def duration_s(self) -> float:
        return max(0.0, self.clock.session_s(self.ended_ns))

    @property
    def trial(self) -> dict[str, str]:
        return self.header.trial

    @property
    def identity(self) -> tuple[Any, ...]:
        """Identity shared with copies only: clock anchor, start, and trial fields."""
        anchor = self.clock.anchor
        whose = (self.trial.get(name, "") for name in ("participant", "condition", "trial", "recording", "wizard"))
        return anchor.utc_ns - anchor.monotonic_ns, self.started_ns, *whose

    def values(self, *streams: str) -> Iterator[tuple[StreamSpec, Any]]:
        """Values of these streams (default: all) in recording order.

        Values of unknown streams, and those that do not fit their type, are left out and logged.

        Raises KeyError if a name is not in the stream table.
        """
        return ((spec, value) for _, spec, value in self.arrivals(*streams))

    def arrivals(self, *streams: str) -> Iterator[tuple[int, StreamSpec, Any]]:
        """As :meth:`values`, each with its arrival at the console in session time."""
        names = {BY_NAME[name].name for name in streams}
        return _values(self, names)

    @property
    def pseudonymised(self) -> bool:
        return bool(self.names)


def open_session(folder: Path, *, repair: bool = True) -> Session:
    """Open a session; one that was not closed properly is repaired first, with ``notices``.

    Without ``repair`` nothing on disk is changed, and a session in progress can be read.

    Raises SessionError if ``folder`` is no session that this program can read, or, to be repaired, one that is still
    being recorded.
    """
    header = read_header(folder)
    notices: tuple[str, ...] = ()
    if repair:
        report = repair_session(folder)
        notices = report.sentences
        if report.repaired:
            header = read_header(folder)
    clock, reason = header.session_clock, header.reason or ""
    with reading(folder / _EVENTS):
        missing = missing_values(folder, header)
    losses, lost = losses_of(folder, header, missing), missing + Counter(header.lost)
    session = Session(folder, header, clock, clock.started_ns, False, "", notices, losses, lost)
    if header.ended_ns is not None:
        return replace(session, ended_ns=header.ended_ns, closed_properly=reason != RECOVERED, reason=reason)
    for _, end in session.values(BY_TYPE[SessionEnded].name):
        return replace(session, ended_ns=end.stamp_ns, closed_properly=end.reason != RECOVERED, reason=end.reason)
    path = folder / _EVENTS
    with reading(path):
        ends_utc_ns = events_file.read_index(path).ends_utc_ns
    return replace(
        session, ended_ns=max(clock.started_ns, clock.at_utc(int(ends_utc_ns.max()) if len(ends_utc_ns) else 0))
    )


def value_reader(path: Path) -> Callable[[str, bytes], tuple[StreamSpec, Any] | None]:
    """Decoder of a channel's messages by topic and data; None, logged once per kind, if they do not fit."""
    unusable: set[str] = set()
    specs: dict[str, StreamSpec | None] = {}

    def read(topic: str, data: bytes) -> tuple[StreamSpec, Any] | None:
        if topic not in specs:
            specs[topic] = spec_of_topic(topic)
        spec = specs[topic]
        name = spec.name if spec is not None else topic
        try:
            if spec is None:
                raise ValueError("not a stream of this program")  # noqa: TRY301 - reported below, once a stream
            text = data.decode("utf-8", "surrogatepass").strip(_SPACES)
            message, end = _decode(text)
            if end != len(text):
                raise ValueError("more than one JSON value")  # noqa: TRY301 - likewise
            return spec, from_message(spec, message)
        except (ValueError, RecursionError) as error:
            if name not in unusable:
                _log.warning("%s: values of %s are left out: %s", path, name, error)
            unusable.add(name)
            return None

    return read


def _values(session: Session, names: set[str]) -> Iterator[tuple[int, StreamSpec, Any]]:
    path, scrub = session.folder / _EVENTS, session.scrub
    with reading(path):
        index = events_file.read_index(path)
        file = path.open("rb")
    if index.damaged_bytes:
        _log.info("%s: %d bytes are damaged or cut off", path, index.damaged_bytes)
    topics = {number: its.topic for number, its in index.channels.items() if its.topic != TRANSFORMS_TOPIC}
    if names:
        specs = {number: spec_of_topic(topic) for number, topic in topics.items()}
        topics = {number: topics[number] for number, spec in specs.items() if spec is not None and spec.name in names}
    read, session_from_utc_ns = value_reader(path), session.clock.at_utc(0)
    with file, reading(path):
        for message, data in events_file.read_messages(file, index, topics):
            found = read(topics[message.channel], scrub(data))
            if found is not None:
                yield message.log_ns + session_from_utc_ns, *found
