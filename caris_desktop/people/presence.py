"""Who is here: turns tracks into people, by pure logic on injected time."""

import itertools
import logging
import re
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import Event, PersonAppeared, PersonLeft, PersonRenamed, Problem
from caris_desktop.domain.sensing import People
from caris_desktop.people.register import PeopleRegister, PeopleStoreError, new_person_id

log = logging.getLogger(__name__)

CONFIRM_FRAMES = 3
LEAVE_AFTER_S = 1.5
MAX_NAME_LENGTH = 80
# Of how many looks the longest pause counts, and how many pauses of that length without somebody are a leaving.
_LOOKS, _LOOKS_MISSED = 5, 2.5
_MOST_PATIENCE_NS = 6_000_000_000


def unnamed_label(number: int) -> str:
    """What the wizard reads for the session's person of this number who has no name."""
    return f"Person {number}"


def is_unnamed_label(name: str) -> bool:
    """Whether it is one of :func:`unnamed_label`, and nobody's name."""
    return re.fullmatch(r"Person \d+", name) is not None


@dataclass(frozen=True, slots=True)
class PersonRow:
    """One row of the People panel. ``name`` is what to show: the given name, or "Person 3".

    ``since_ns`` is when this visit began, on the session clock. ``camera`` is the one that sees them, empty in older
    recordings. ``number`` is the 3 of "Person 3", which they keep when they have a name too; 0 in older recordings.
    """

    person_id: str
    track: int
    name: str
    here: bool
    since_ns: int
    last_seen_ns: int
    camera: str = ""
    number: int = 0


_Track = tuple[str, int]  # camera, and its tracker's number


@dataclass(slots=True)
class _Candidate:
    """A track that was seen in too few frames to be a person yet."""

    frames: int
    last_seen_ns: int


class Presence:
    """Who is in front of the cameras. For one thread.

    A track becomes a person once it was seen in ``confirm_frames`` frames, and leaves after ``leave_after_s`` without
    being seen, or later where its camera is looked at rarely: who was not looked for is not gone. A track number that
    returns is the same person again, until :meth:`restart_tracks`. Each camera has tracks of its own.

    Without a ``register`` names last for this object only. A register that fails never costs a person: the failure
    is reported once as a Problem, and names are kept here.
    """

    def __init__(
        self,
        register: PeopleRegister | None = None,
        *,
        confirm_frames: int = CONFIRM_FRAMES,
        leave_after_s: float = LEAVE_AFTER_S,
    ) -> None:
        self._register = register
        self._confirm_frames = confirm_frames
        self._leave_after_ns = round(leave_after_s * 1e9)
        self._candidates: dict[_Track, _Candidate] = {}
        self._id_of_track: dict[_Track, str] = {}
        self._rows: dict[str, PersonRow] = {}
        self._looks_ns: dict[str, deque[int]] = {}
        self._problem_reported = False

    def update(self, people: People) -> tuple[People, list[Event]]:
        """Take in one frame's tracks.

        Returns the same frame with ``person_id`` filled in for everybody who is confirmed, and what happened.
        """
        now_ns = people.stamp_ns
        self._looks_ns.setdefault(people.camera, deque(maxlen=_LOOKS)).append(now_ns)
        events: list[Event] = []
        for box in people.boxes:
            events += self._see((people.camera, box.track), now_ns)
        events += self.tick(now_ns)
        boxes = tuple(
            replace(box, person_id=self._id_of_track.get((people.camera, box.track), "")) for box in people.boxes
        )
        return replace(people, boxes=boxes), events

    def tick(self, now_ns: int) -> list[Event]:
        """Let people leave who have not been seen for a while; to be called also when no frames arrive."""
        self._candidates = {
            track: candidate
            for track, candidate in self._candidates.items()
            if now_ns - candidate.last_seen_ns <= self._patience_ns(track[0])
        }
        overdue = [
            row for row in self._rows.values() if row.here and now_ns - row.last_seen_ns > self._patience_ns(row.camera)
        ]
        return [event for row in overdue for event in self._leave(row, now_ns)]

    def _patience_ns(self, camera: str) -> int:
        looks_ns = self._looks_ns.get(camera, ())
        apart_ns = max((after - before for before, after in itertools.pairwise(looks_ns)), default=0)
        return max(self._leave_after_ns, min(round(_LOOKS_MISSED * apart_ns), _MOST_PATIENCE_NS))

    def rename(self, person_id: str, name: str, *, now_ns: int, actor: Actor = "") -> list[Event]:
        """Give a person a name, or take it away with an empty one. The event does not carry it."""
        row = self._rows.get(person_id)
        if row is None:
            return [
                Problem(
                    now_ns,
                    "warning",
                    "That person is not known any more.",
                    "The name was not kept.",
                    "Choose a person from the People panel.",
                )
            ]
        name = " ".join(name.split())[:MAX_NAME_LENGTH]
        events = self._store(now_ns, lambda register: register.rename(person_id, name))
        self._rows[person_id] = replace(row, name=name or unnamed_label(row.number))
        return [PersonRenamed(now_ns, person_id, actor), *events]

    def persons(self, *, include_left: bool = False) -> tuple[PersonRow, ...]:
        """Who is here, in the order in which they first appeared; with ``include_left`` also who was."""
        return tuple(row for row in self._rows.values() if row.here or include_left)

    def restart_tracks(self, now_ns: int) -> list[Event]:
        """The tracker began to count anew: its numbers no longer mean the people that they meant."""
        self._candidates.clear()
        self._id_of_track.clear()
        return [event for row in self.persons() for event in self._leave(row, now_ns)]

    def close(self) -> None:
        if self._register is not None:
            self._register.close()

    def _see(self, track: _Track, now_ns: int) -> list[Event]:
        person_id = self._id_of_track.get(track)
        if person_id is None:
            candidate = self._candidates.setdefault(track, _Candidate(0, now_ns))
            candidate.frames += 1
            candidate.last_seen_ns = now_ns
            return self._appear(track, now_ns) if candidate.frames >= self._confirm_frames else []
        row = self._rows[person_id]
        if row.here:
            self._rows[person_id] = replace(row, last_seen_ns=now_ns)
            return []
        self._rows[person_id] = replace(row, here=True, since_ns=now_ns, last_seen_ns=now_ns)
        return [PersonAppeared(now_ns, person_id, row.track, row.number)]

    def _appear(self, track: _Track, now_ns: int) -> list[Event]:
        del self._candidates[track]
        person_id = new_person_id()
        problems: list[Event] = []
        if self._register is not None:
            try:
                person_id = self._register.add().person_id
            except PeopleStoreError as error:
                problems = self._report(error, now_ns)
        self._id_of_track[track] = person_id
        camera, its_track = track
        number = len(self._rows) + 1
        self._rows[person_id] = PersonRow(
            person_id,
            its_track,
            unnamed_label(number),
            here=True,
            since_ns=now_ns,
            last_seen_ns=now_ns,
            camera=camera,
            number=number,
        )
        return [PersonAppeared(now_ns, person_id, its_track, number), *problems]

    def _leave(self, row: PersonRow, now_ns: int) -> list[Event]:
        self._rows[row.person_id] = replace(row, here=False)
        return [
            PersonLeft(now_ns, row.person_id, row.track),
            *self._store(now_ns, lambda register: register.seen(row.person_id)),
        ]

    def _store(self, now_ns: int, write: Callable[[PeopleRegister], None]) -> list[Event]:
        if self._register is None:
            return []
        try:
            write(self._register)
        except PeopleStoreError as error:
            return self._report(error, now_ns)
        except KeyError:
            # Appeared while the register could not be written, or was erased meanwhile: known to this session only.
            log.warning("a person of this session is not in %s", self._register.path)
        return []

    def _report(self, error: PeopleStoreError, now_ns: int) -> list[Event]:
        if self._problem_reported:
            return []
        self._problem_reported = True
        return [
            Problem(
                now_ns,
                "error",
                str(error),
                "People are still followed, but their names are kept for this session only.",
                "Choose another study folder, or repair this one, before the next session.",
            )
        ]
