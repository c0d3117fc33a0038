"""A log of every message that was delivered to a client, so that losses can be counted against it."""

import json
import time
from pathlib import Path
from typing import Any, TextIO

from caris_desktop.ros.dialect import decode_time
from caris_desktop.simulator.outbox import Published


class SentLog:
    """One JSON line per message and client: ``at_ns`` (this machine's clock), ``client``, ``topic``, ``sequence`` (of
    the topic, from 1), ``stamp_ns`` (of the header, null without one) and ``bytes``.

    Raises
    ------
    OSError
        When the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._file: TextIO = path.open("a", encoding="utf-8", buffering=1)

    def delivered(self, client: str, published: Published, size_bytes: int) -> None:
        """Note one message."""
        line = {
            "at_ns": time.time_ns(),
            "client": client,
            "topic": published.topic,
            "sequence": published.sequence,
            "stamp_ns": _stamp_ns(published.message),
            "bytes": size_bytes,
        }
        self._file.write(json.dumps(line, separators=(",", ":")) + "\n")

    def close(self) -> None:
        self._file.close()


def _stamp_ns(message: dict[str, Any]) -> int | None:
    header = message.get("header")
    try:
        return decode_time(header["stamp"]) if isinstance(header, dict) and "stamp" in header else None
    except ValueError:
        return None
