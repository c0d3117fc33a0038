"""Logs of delivered messages and of executed commands, to count losses and late commands."""

import json
import time
from pathlib import Path
from typing import Any, TextIO

from caris_desktop.ros.dialect import decode_time
from caris_desktop.simulator.client_outbox import Published


class _Lines:
    def __init__(self, path: Path) -> None:
        self._file: TextIO = path.open("a", encoding="utf-8", buffering=1)

    def close(self) -> None:
        self._file.close()

    def _write(self, line: dict[str, Any]) -> None:
        # CBOR includes bytes and undefined values, too.
        self._file.write(json.dumps(line, separators=(",", ":"), default=str) + "\n")


class SentLog(_Lines):
    """One JSON line per message and client: ``at_ns`` (this computer's clock), ``client``, ``topic``, ``sequence`` (of
    the topic, from 1), ``stamp_ns`` (of the header, null without one) and ``bytes``.

    Raises
    ------
    OSError
        When the file cannot be written.
    """

    def delivered(self, client: str, published: Published, size_bytes: int) -> None:
        """Log one delivered message."""
        self._write({
            "at_ns": time.time_ns(),
            "client": client,
            "topic": published.topic,
            "sequence": published.sequence,
            "stamp_ns": _stamp_ns(published.message),
            "bytes": size_bytes,
        })  # fmt: skip


class ObeyedLog(_Lines):
    """One JSON line per executed message of a client: ``at_ns`` (monotonic clock, shared by all processes), ``client``,
    ``topic`` and ``message``; per executed service call: ``at_ns``, ``client``, ``service`` and ``request``; and per
    client: ``at_ns``, ``connected``.

    Raises
    ------
    OSError
        When the file cannot be written.
    """

    def connected(self, client: str) -> None:
        """Log an accepted client."""
        self._write({"at_ns": time.monotonic_ns(), "connected": client})

    def obeyed(self, client: str, topic: str, message: dict[str, Any]) -> None:
        """Log one executed message."""
        self._write({"at_ns": time.monotonic_ns(), "client": client, "topic": topic, "message": message})

    def called(self, client: str, service: str, request: Any) -> None:
        """Log one executed service call."""
        self._write({"at_ns": time.monotonic_ns(), "client": client, "service": service, "request": request})


def _stamp_ns(message: dict[str, Any]) -> int | None:
    header = message.get("header")
    try:
        return decode_time(header["stamp"]) if isinstance(header, dict) and "stamp" in header else None
    except ValueError:
        return None
