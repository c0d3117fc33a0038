"""Synthetic people as vectors: one direction per person, with variation per embedding."""

from datetime import datetime, timedelta

import numpy as np

from caris_desktop.domain.events import Event
from caris_desktop.domain.person_values import LooksKind, PersonLooks
from caris_desktop.domain.sensing import People, PersonBox
from caris_desktop.people.identities import Vectors, unit
from caris_desktop.people.known import KnownPeople
from caris_desktop.people.people_store import PeopleStore
from caris_desktop.people.presence import PresenceTracker, RecognitionSettings

FRAME_NS = 250_000_000
_LENGTH = 512


def direction(number: int) -> Vectors:
    """Embedding of a person. A negative number is very similar to the positive one, a number above 1000 slightly."""
    if number > 1000:
        return unit(direction(number - 1000) + np.float32(0.48) * direction(number - 500))
    if number < 0:
        return unit(direction(-number) + np.float32(0.2) * direction(1000 - number))
    return unit(np.random.default_rng([7, number]).normal(size=_LENGTH).astype(np.float32))


class Room:
    """Camera with people who come and go; ``stray`` is the variation of their embeddings."""

    def __init__(
        self,
        store: PeopleStore | None = None,
        *,
        settings: RecognitionSettings = RecognitionSettings(),
        morning: datetime = datetime(2026, 11, 23, 9, 0),
        stray: float = 0.25,
    ) -> None:
        self.now_ns = 0
        self.morning = morning
        self.knowing = KnownPeople(store, now=self.now)
        self.presence = PresenceTracker(self.knowing, confirm_frames=1, settings=settings)
        self.events: list[Event] = []
        self._stray = stray
        self._chance = np.random.default_rng(5)
        self._track = 0

    def now(self) -> datetime:
        return self.morning + timedelta(microseconds=self.now_ns / 1000.0)

    def look(self, number: int) -> Vectors:
        """Embedding of a person in one frame."""
        strays = unit(self._chance.normal(size=_LENGTH).astype(np.float32))
        return unit(direction(number) + self._stray * strays)

    def visit(
        self, *numbers: int, frames: int = 12, kind: LooksKind = "clothing", leaves: bool = True, quality: float = 0.9
    ) -> list[str]:
        """Let these people appear in frames every 250 ms, and leave; returns the ids of their visits."""
        tracks = {self._track + 1 + index: number for index, number in enumerate(numbers)}
        self._track += len(numbers)
        self.see(tracks, frames=frames, kind=kind, quality=quality)
        rows = {row.track: row.visit_id for row in self.presence.persons()}
        if leaves:
            self.wait(4.0)
        return [rows[track] for track in tracks]

    def see(self, tracks: dict[int, int], *, frames: int, kind: LooksKind = "clothing", quality: float = 0.9) -> None:
        """Detect each person as the given track."""
        for _ in range(frames):
            self.now_ns += FRAME_NS
            boxes = tuple(PersonBox(track, "", 10.0 * track, 20.0, 30.0, 90.0, 0.9) for track in tracks)
            frame = People(self.now_ns, "front", self.now_ns // FRAME_NS, 640, 480, boxes, 8.0)
            self.events += self.presence.update(frame)[1]
            for track, number in tracks.items():
                looks = PersonLooks(self.now_ns, "front", track, kind, f"{kind}-net", self.look(number), quality)
                self.events += self.presence.add_embeddings(looks)

    def wait(self, seconds: float) -> None:
        """Detect nobody for this time."""
        self.now_ns += round(seconds * 1e9)
        self.events += self.presence.tick(self.now_ns)

    def of(self, kind: type[Event]) -> list[Event]:
        return [event for event in self.events if isinstance(event, kind)]
