"""Writer of ``events.mcap``: every value of the stream table as JSON, with a JSON Schema per channel."""

import json
from collections import Counter
from math import isfinite
from typing import Any

from caris_desktop.domain.clock import ClockAnchor, measured_ns
from caris_desktop.domain.events import LinkQuality
from caris_desktop.domain.foxglove import time_of, transforms_of
from caris_desktop.domain.json_encoding import TRANSFORMS_TOPIC, schema_of, to_message, transforms_schema
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.streams import StreamSpec
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.session.events_file import McapFile
from caris_desktop.recording.session.session_header import FORMAT_VERSION


class EventLog:
    """Writes one MCAP file in order of arrival.

    ``publish_time`` is the measurement time, by the robot's stamp and clock if known, else the value's own stamp;
    ``log_time`` is the arrival at the console. Both are UTC by the session's anchor.
    """

    def __init__(self, file: DiskFile, *, anchor: ClockAnchor, metadata: dict[str, str]) -> None:
        self._file = file
        self._anchor = anchor
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._transforms = 0
        self._robot_clock: LinkQuality | None = None
        self.counts: Counter[str] = Counter()
        self._writer = McapFile(file)
        self._writer.add_metadata("session", {"format_version": str(FORMAT_VERSION), **metadata})

    def write(self, spec: StreamSpec, value: Any, arrived_ns: int) -> None:
        """Write one value. Raises OSError if the disk fails, TypeError or ValueError if JSON cannot hold it."""
        log_ns = max(0, self._anchor.utc_ns_at(arrived_ns))
        happened_ns = max(0, self._anchor.utc_ns_at(self._happened_ns(value)))
        data = _bytes_of(to_message(spec, value, at_utc_ns=happened_ns))
        transforms = transforms_of(value, time_of(happened_ns))
        topic = spec.topic_of(value)
        if topic not in self._channels:
            self._register(topic, *schema_of(spec))
        self.counts[spec.name] += 1
        self._add(topic, data, log_ns, happened_ns, self.counts[spec.name])
        if transforms is not None:
            if TRANSFORMS_TOPIC not in self._channels:
                self._register(TRANSFORMS_TOPIC, *transforms_schema())
            self._transforms += 1
            self._add(TRANSFORMS_TOPIC, _bytes_of(transforms), log_ns, happened_ns, self._transforms)

    def _add(self, topic: str, data: bytes, log_ns: int, publish_ns: int, number: int) -> None:
        self._writer.add_message(
            self._channels[topic], data, log_time=log_ns, publish_time=publish_ns, sequence=number & 0xFFFFFFFF
        )

    def _happened_ns(self, value: Any) -> int:
        if isinstance(value, FrameRef):
            return value.shown_ns
        if isinstance(value, LinkQuality):
            self._robot_clock = value
        stamp_ns: int = value.stamp_ns
        offset_ms = None if self._robot_clock is None else self._robot_clock.clock_offset_ms
        uncertainty_ms = None if self._robot_clock is None else self._robot_clock.clock_uncertainty_ms
        if offset_ms is None or uncertainty_ms is None or not (isfinite(offset_ms) and isfinite(uncertainty_ms)):
            return stamp_ns
        measured = measured_ns(
            getattr(value, "robot_stamp_ns", None),
            arrival_ns=stamp_ns,
            offset_ns=round(offset_ms * 1e6),
            uncertainty_ns=round(uncertainty_ms * 1e6),
        )
        return stamp_ns if measured is None else measured

    def flush(self) -> None:
        """Close the current chunk, so that a kill does not lose it."""
        self._writer.flush()

    @property
    def file(self) -> DiskFile:
        return self._file

    def close(self) -> None:
        """Write the summary with the chunk index, and close the file."""
        try:
            self._writer.finish()
            self._file.sync()
        finally:
            self._file.close()

    def _register(self, topic: str, schema_name: str, schema: dict[str, Any]) -> None:
        text = json.dumps(schema)
        if text not in self._schemas:
            self._schemas[text] = self._writer.add_schema(schema_name, text.encode())
        self._channels[topic] = self._writer.add_channel(topic, self._schemas[text])


def _bytes_of(message: Any) -> bytes:
    return json.dumps(message, separators=(",", ":"), allow_nan=False).encode()
