"""Tracks of a person in a session's video, interpolated between detections."""

import json
import logging
import math
import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Iterator
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

from caris_desktop.domain.value_class import dataclass
from caris_desktop.recording.session import events_file

_log = logging.getLogger(__name__)
# A person seen at both ends of such a gap was present in it. Longer gaps without detection are covered entirely.
_GAP_NS = 3_000_000_000
_QUICK_NS = 500_000_000
_HOLD_NS = 1_500_000_000
_VISIT_GAP_NS = 10_000_000_000
# Margins of the covered area relative to the box, and a person's motion per second.
_PAD_WIDTH, _PAD_HEIGHT, _PAD_LEAST = 0.15, 0.08, 0.01
_WALKS_PER_S, _NODS_PER_S = 0.2, 0.05
_STAMP = re.compile(rb'"stamp_ns":\s*(-?\d+)')
_NAMELESS = re.compile(rb'"person_id":\s*""')
_CAMERA = re.compile(rb'"camera":\s*"((?:[^"\\]|\\.)*)"')
_PEOPLE = "/people"
_LINKS = ("/event/person_identified", "/event/people_merged")
_UNDONE = "/event/people_undone"
_UNLINKS = ("/event/person_rejected", "/event/person_split", _UNDONE)
# Undoing a rejection or split restores the link.
_UNDONE_TO_LINKS = ("rejected", "split")
_WHOM = ("is_person_id", "into_person_id", "from_person_id")


class Area(NamedTuple):
    """Area of an image, in fractions of its width and height."""

    left: float
    top: float
    right: float
    bottom: float

    def joined(self, other: "Area") -> "Area":
        return Area(*map(min, self[:2], other[:2]), *map(max, self[2:], other[2:]))

    def padded(self, *, after_s: float) -> "Area":
        wide = max(_PAD_LEAST, _PAD_WIDTH * (self.right - self.left)) + _WALKS_PER_S * after_s
        high = max(_PAD_LEAST, _PAD_HEIGHT * (self.bottom - self.top)) + _NODS_PER_S * after_s
        return Area(
            max(0.0, self.left - wide),
            max(0.0, self.top - high),
            min(1.0, self.right + wide),
            min(1.0, self.bottom + high),
        )


WHOLE = Area(0.0, 0.0, 1.0, 1.0)


_Track = list[tuple[int, Area]]
"""Session times, and where the person was then."""


@dataclass(slots=True)
class PersonTracks:
    """Tracks of one person in one session, in session time.

    ``detections_ns`` are the times of each camera's detections, with or without people.
    """

    tracks: dict[str, list[_Track]]
    detections_ns: dict[str, list[int]]
    visits_ns: list[tuple[int, int]]

    @property
    def any(self) -> bool:
        return bool(self.visits_ns)

    def seen_by(self, camera: str) -> bool:
        """True if a video of this camera may show the person; without any detection it may show anyone."""
        return bool(self.tracks.get(camera)) or (self.any and not self.detections_ns.get(camera))

    def areas_at(self, camera: str, at_ns: int) -> tuple[Area, ...]:
        """Areas of the image to cover."""
        if self._unseen(camera, at_ns):
            return (WHOLE,)
        found = (self._area_of(track, camera, at_ns) for track in self.tracks.get(camera, ()))
        return tuple(area for area in found if area is not None)

    def _area_of(self, track: _Track, camera: str, at_ns: int) -> Area | None:
        after = bisect_right(track, at_ns, key=itemgetter(0))
        if 0 < after < len(track) and track[after][0] - track[after - 1][0] <= _GAP_NS:
            (first_ns, first), (second_ns, second) = track[after - 1], track[after]
            gap_ns = second_ns - first_ns
            if gap_ns > _QUICK_NS:
                return first.joined(second).padded(after_s=min(at_ns - first_ns, second_ns - at_ns) / 1e9)
            share = (at_ns - first_ns) / gap_ns
            between = (one + share * (other - one) for one, other in zip(first, second, strict=True))
            return Area(*between).padded(after_s=0.0)
        held = None
        if after and at_ns <= self._held_until(camera, track[after - 1][0]):
            first_ns, first = track[after - 1]
            held = first.padded(after_s=(at_ns - first_ns) / 1e9)
        if after < len(track) and at_ns >= self._held_from(camera, track[after][0]):
            second_ns, second = track[after]
            coming = second.padded(after_s=(second_ns - at_ns) / 1e9)
            held = coming if held is None else held.joined(coming)
        return held

    def _held_until(self, camera: str, seen_ns: int) -> int:
        detections_ns = self.detections_ns.get(camera, [])
        at = bisect_right(detections_ns, seen_ns)
        next_ns = detections_ns[at] if at < len(detections_ns) else seen_ns
        return min(max(seen_ns + _HOLD_NS, next_ns), seen_ns + _GAP_NS)

    def _held_from(self, camera: str, seen_ns: int) -> int:
        detections_ns = self.detections_ns.get(camera, [])
        at = bisect_left(detections_ns, seen_ns) - 1
        before_ns = detections_ns[at] if at >= 0 else seen_ns
        return max(min(seen_ns - _HOLD_NS, before_ns), seen_ns - _GAP_NS)

    def _unseen(self, camera: str, at_ns: int) -> bool:
        """True if no detection ran and the person may have been present."""
        detections_ns = self.detections_ns.get(camera, [])
        if not detections_ns:
            return any(begin_ns - _GAP_NS <= at_ns <= end_ns + _GAP_NS for begin_ns, end_ns in self.visits_ns)
        after = bisect_right(detections_ns, at_ns)
        before_ns = detections_ns[after - 1] if after else None
        next_ns = detections_ns[after] if after < len(detections_ns) else None
        if before_ns is None or next_ns is None:
            edge_ns = detections_ns[0] if before_ns is None else detections_ns[-1]
            return abs(at_ns - edge_ns) > _HOLD_NS and self._seen_near(camera, edge_ns)
        if next_ns - before_ns <= _GAP_NS or at_ns == before_ns:
            return False
        return self._seen_near(camera, before_ns) or self._seen_near(camera, next_ns)

    def _seen_near(self, camera: str, at_ns: int) -> bool:
        return any(
            bisect_left(track, at_ns - _GAP_NS, key=itemgetter(0))
            < bisect_right(track, at_ns + _GAP_NS, key=itemgetter(0))
            for track in self.tracks.get(camera, ())
        )


def sightings_in(events: Path, person_ids: frozenset[str]) -> PersonTracks:
    """Tracks of these ids from ``events.mcap``. Raises OSError."""
    id_texts = tuple(json.dumps(person_id).encode() for person_id in person_ids)
    detections_ns: dict[str, list[int]] = {}
    boxes: list[tuple[str, int, int, str, Area]] = []
    for _, data in messages_of(events, lambda topic: topic == _PEOPLE):
        stamp, camera = _STAMP.search(data), _CAMERA.search(data)
        if stamp is not None and camera is not None:
            detections_ns.setdefault(json.loads(b'"' + camera[1] + b'"'), []).append(int(stamp[1]))
        if _NAMELESS.search(data) or any(person_id in data for person_id in id_texts):
            boxes += _detections_in(data, person_ids)
    return _combine(boxes, detections_ns)


def links_in(events: Path) -> Iterator[tuple[bool, str, str]]:
    """Identity decisions in order: (linked or unlinked, who, same as whom). Raises OSError."""
    for topic, data in messages_of(events, lambda topic: topic in _LINKS or topic in _UNLINKS):
        message = fields_of(data)
        who = str(message.get("person_id") or "")
        whom = next((str(message[name]) for name in _WHOM if message.get(name)), "")
        if who and whom:
            again = topic == _UNDONE and message.get("decision") in _UNDONE_TO_LINKS
            yield again or topic in _LINKS, who, whom


def everyone_who_is(person_ids: Iterable[str], links: Iterable[tuple[bool, str, str]]) -> frozenset[str]:
    """These ids and all ids linked to them."""
    taken_for: dict[tuple[str, str], None] = {}
    for holds, who, whom in links:
        if holds:
            taken_for[who, whom] = None
        else:
            taken_for.pop((who, whom), None)
    found = set(person_ids)
    while more := {who for who, whom in taken_for if whom in found} - found:
        found |= more
    return frozenset(found)


def messages_of(events: Path, is_selected: Callable[[str], bool]) -> Iterator[tuple[str, bytes]]:
    """Topic and data of some channels' messages in recording order. Raises OSError."""
    index = events_file.read_index(events)
    topics = {number: channel.topic for number, channel in index.channels.items() if is_selected(channel.topic)}
    with events.open("rb") as file:
        for message, data in events_file.read_messages(file, index, topics):
            yield topics[message.channel], data


def fields_of(data: bytes | str) -> dict[str, Any]:
    """Fields of a message; empty if it cannot be read."""
    try:
        message = json.loads(data)
    except (ValueError, RecursionError):
        return {}
    return message if isinstance(message, dict) else {}


def _detections_in(data: bytes, person_ids: frozenset[str]) -> Iterator[tuple[str, int, int, str, Area]]:
    """Camera, track, time, id and area of each box that is the person's or unidentified."""
    message = fields_of(data)
    try:
        stamp_ns, camera = int(message["stamp_ns"]), str(message["camera"])
        width_px, height_px = float(message["frame_width_px"]), float(message["frame_height_px"])
        for box in message["boxes"]:
            person_id = str(box["person_id"])
            if person_id and person_id not in person_ids:
                continue
            left, top = float(box["left_px"]), float(box["top_px"])
            right, bottom = left + float(box["width_px"]), top + float(box["height_px"])
            area = Area(left / width_px, top / height_px, right / width_px, bottom / height_px)
            if all(map(math.isfinite, area)):
                yield camera, int(box["track"]), stamp_ns, person_id, area
    except (KeyError, TypeError, ValueError, ZeroDivisionError):
        _log.warning("boxes that cannot be read are left out", exc_info=True)


def _combine(boxes: list[tuple[str, int, int, str, Area]], detections_ns: dict[str, list[int]]) -> PersonTracks:
    theirs = {(camera, track) for camera, track, _, person_id, _ in boxes if person_id}
    tracks: dict[str, dict[int, _Track]] = {}
    visits: list[int] = []
    for camera, track, stamp_ns, _, area in sorted(boxes):
        # A track's boxes before its identification belong to the same person.
        if (camera, track) in theirs:
            tracks.setdefault(camera, {}).setdefault(track, []).append((stamp_ns, area))
            visits.append(stamp_ns)
    visits_ns: list[tuple[int, int]] = []
    for stamp_ns in sorted(visits):
        if visits_ns and stamp_ns - visits_ns[-1][1] <= _VISIT_GAP_NS:
            visits_ns[-1] = visits_ns[-1][0], stamp_ns
        else:
            visits_ns.append((stamp_ns, stamp_ns))
    return PersonTracks(
        {camera: list(of_camera.values()) for camera, of_camera in tracks.items()},
        {camera: sorted(stamps_ns) for camera, stamps_ns in detections_ns.items()},
        visits_ns,
    )
