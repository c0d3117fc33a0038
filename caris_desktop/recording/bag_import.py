"""Bags that this program did not record become session folders, so that replay, annotation and export work on them."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path


class BagError(Exception):
    """A bag that could not become a session; the text is for people. Nothing of it was kept."""


@dataclass(frozen=True, slots=True)
class TopicReport:
    """What became of one topic: ``became`` is the stream it was read as, empty where ``reason`` says why not."""

    topic: str
    type: str
    messages: int
    used: int
    became: str = ""
    reason: str = ""


@dataclass(frozen=True, slots=True)
class ImportReport:
    """A bag that became a session. ``values`` counts what was written, by stream; ``notes`` are sentences."""

    folder: Path
    kind: str
    started_utc: str
    duration_s: float
    values: dict[str, int]
    topics: tuple[TopicReport, ...]
    notes: tuple[str, ...] = field(default=())

    @property
    def not_understood(self) -> tuple[TopicReport, ...]:
        return tuple(topic for topic in self.topics if not topic.became)


def import_bag(path: Path, folder: Path, progress: Callable[[float], None] = lambda _fraction: None) -> ImportReport:
    """Turn the bag at ``path`` into a session in ``folder``, which must not exist. Nothing is written beside the bag.

    ``path`` is a ROS 1 ``.bag``, a rosbag2 folder (SQLite or MCAP), or an MCAP file with ROS messages. ``progress``
    takes 0..1; whatever it raises ends the import, and nothing of it remains.

    Raises
    ------
    BagError
        If the bag cannot be read, or holds nothing that this program knows, or ``folder`` cannot be made.
    """
    raise NotImplementedError
