"""``events.mcap``: every value of the stream table as JSON, each channel with its JSON Schema."""

import json
from collections import Counter
from math import isfinite
from typing import Any

from caris_desktop.domain.clock import ClockAnchor, measured_ns
from caris_desktop.domain.events import LinkQuality
from caris_desktop.domain.schema import json_schema, to_jsonable
from caris_desktop.domain.sensing import FrameRef
from caris_desktop.domain.streams import StreamSpec
from caris_desktop.recording.disk_file import DiskFile
from caris_desktop.recording.session.mcap_file import McapFile


class EventLog:
    """Writes one MCAP file, in the order of arrival.

    ``publish_time`` is when a value was measured, by the robot's stamp and clock where both are known, and else its
    own stamp; ``log_time`` is when it arrived at the console. Both are UTC by the session's anchor.
    """

    def __init__(self, file: DiskFile, *, anchor: ClockAnchor, metadata: dict[str, str]) -> None:
        self._file = file
        self._anchor = anchor
        self._channels: dict[str, int] = {}
        self._schemas: dict[type[Any], int] = {}
        self._robot_clock: LinkQuality | None = None
        self.counts: Counter[str] = Counter()
        self._writer = McapFile(file, library="caris-desktop")
        self._writer.add_metadata("session", metadata)

    def write(self, spec: StreamSpec, value: Any, arrived_ns: int) -> None:
        """Raises OSError when the disk does not take it, TypeError or ValueError when JSON cannot hold it."""
        data = json.dumps(to_jsonable(value), separators=(",", ":"), allow_nan=False).encode()
        topic = spec.topic_of(value)
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._register(spec, topic)
        self.counts[spec.name] += 1
        self._writer.add_message(
            channel,
            data,
            log_time=max(0, self._anchor.utc_ns_at(arrived_ns)),
            publish_time=max(0, self._anchor.utc_ns_at(self._happened_ns(value))),
            sequence=self.counts[spec.name] & 0xFFFFFFFF,
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
        """Close the chunk in progress: from here on a kill does not lose it."""
        self._writer.flush()

    @property
    def file(self) -> DiskFile:
        return self._file

    def close(self) -> None:
        """Write the index that lets readers jump, and close the file."""
        try:
            self._writer.finish()
            self._file.sync()
        finally:
            self._file.close()

    def _register(self, spec: StreamSpec, topic: str) -> int:
        schema = self._schemas.get(spec.value_type)
        if schema is None:
            text = json.dumps(json_schema(spec.value_type)).encode()
            schema = self._writer.add_schema(f"caris.{spec.value_type.__name__}", "jsonschema", text)
            self._schemas[spec.value_type] = schema
        return self._writer.add_channel(topic, "json", schema)
