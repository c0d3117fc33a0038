"""Presence tracker: turns tracks into visits and identifies known people; time is injected."""

import itertools
import math
import re
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import field, replace
from typing import Literal

from caris_desktop.domain.actor import CONSOLE
from caris_desktop.domain.corrections import Corrections
from caris_desktop.domain.events import (
    ConsentKind,
    Event,
    PersonAppeared,
    PersonLeft,
    PersonSplit,
    PersonSuggested,
    PhotoTaken,
    SessionEnded,
    SessionStarted,
    UtteranceChanged,
    UtteranceCorrected,
)
from caris_desktop.domain.geometry import Pose2D
from caris_desktop.domain.person_values import PersonLooks, PersonPortrait
from caris_desktop.domain.sensing import People, PeopleInMap
from caris_desktop.domain.value_class import Value, dataclass
from caris_desktop.people.decisions import Decisions, PeopleIntent
from caris_desktop.people.identities import GOOD_QUALITY
from caris_desktop.people.known import KnownPeople
from caris_desktop.people.multi_camera_tracks import MultiCameraTracks
from caris_desktop.people.people_store import HistoryEntry
from caris_desktop.people.visit_log import Portraits, Spot, Track, Visit, VisitLog

CONFIRM_FRAMES = 3
LEAVE_AFTER_S = 1.5
# Of two cameras, the one that saw a person first determines the row, until it has lost them for this long.
_OTHER_CAMERA_AFTER_NS = 1_000_000_000
# After a longer absence a person is identified again, whatever the track number.
_SAME_VISIT_WITHIN_NS = 3_000_000_000
# After this many embeddings without a match, a person counts as new.
_STRANGER_AFTER = 8
_STRANGER_FROM = 0.7
# A row is updated only by visible differences.
_MOVED_M, _TURNED_RAD, _MOVED_EVERY_NS = 0.2, 0.15, 500_000_000

Recognise = Literal["nobody", "clothing", "faces"]

HistoryEvent = UtteranceChanged | UtteranceCorrected | PhotoTaken | SessionStarted | SessionEnded


def unnamed_label(number: int) -> str:
    """Recorded label of an unnamed person: ``Person 3``."""
    return f"Person {number}"


def is_unnamed_label(name: str) -> bool:
    """True for a label of :func:`unnamed_label`."""
    return unnamed_number(name) is not None


def unnamed_number(name: str) -> int | None:
    """Number in an :func:`unnamed_label`; None for a name."""
    label = re.fullmatch(r"Person (\d+)", name)
    return None if label is None else int(label[1])


class Suggestion(Value):
    """Who somebody may be: one of the known people, and how often such a suggestion is right."""

    person_id: str
    name: str
    confidence: float


class PersonRow(Value):
    """One row of the People panel. ``name`` is what to show: the given name, or "Person 3".

    ``since_ns`` is when this visit began, on the session clock. ``camera`` is the one that sees them, empty in older
    recordings. ``number`` is the 3 of "Person 3", which they keep when they have a name too; 0 in older recordings.

    ``visit_id`` is the id with which this visit began; it differs from ``person_id`` where it is known who it is, by
    the wizard, or by the console with ``confidence``. ``suggestions`` are the two likeliest while it is not. ``known``:
    something was written down about them. ``portrait`` is the key of their picture in ``state.portraits``, empty
    without one. ``distance_m`` and ``bearing_rad`` (left positive) are seen from the robot; None where not known.
    ``summary`` is what there was with them before this visit. Nothing but ids, places and times of it is recorded.
    """

    person_id: str
    track: int
    name: str
    here: bool
    since_ns: int
    last_seen_ns: int
    camera: str = ""
    number: int = 0
    visit_id: str = ""
    known: bool = False
    group: str = ""
    tags: tuple[str, ...] = ()
    note: str = ""
    portrait: str = ""
    suggestions: tuple[Suggestion, ...] = ()
    confidence: float = 0.0
    consents: tuple[ConsentKind, ...] = ()
    distance_m: float | None = None
    bearing_rad: float | None = None
    speaking: bool = False
    posture: str = ""
    hand_raised: bool | None = None
    facing: bool | None = None
    summary: str = ""
    cameras: tuple[str, ...] = ()

    @property
    def suggestion(self) -> Suggestion | None:
        return self.suggestions[0] if self.suggestions else None


PortraitsOf = Literal["everybody", "consenting", "nobody"]


class RecognitionSettings(Value):
    """Recognition of people: none, by their clothes within a day, or by their faces too.

    The console asks the wizard from a confidence of ``ask_at``, about people with notes. From ``confirm_at`` it decides
    without asking; at 1 it never does. ``portraits``: people of whom a photo may be saved; ``consenting`` are those
    whose consent to photos is noted.
    """

    recognise: Recognise = "clothing"
    confirm_at: float = 0.95
    portraits: PortraitsOf = "everybody"
    ask_at: float = 0.7


class PresenceTracker:
    """People in front of the cameras. For one thread.

    A track becomes a person after ``confirm_frames`` frames, and leaves ``LEAVE_AFTER_S`` after the last detection, or
    later if its camera is processed rarely. A track number that returns soon continues its visit, until
    :meth:`restart_tracks`; after a longer time only if recognition is off. Each camera has its own tracks.

    Without a database in ``known``, data lasts as long as this object.
    """

    def __init__(
        self,
        known: KnownPeople | None = None,
        *,
        confirm_frames: int = CONFIRM_FRAMES,
        settings: RecognitionSettings = RecognitionSettings(),
    ) -> None:
        self.portraits = Portraits()
        self._known = KnownPeople() if known is None else known
        self._confirm_frames = confirm_frames
        self._settings = settings
        self._candidates: dict[Track, Candidate] = {}
        self._visits = VisitLog()
        self._decisions = Decisions(self._known, self._visits, self.portraits)
        self._cameras = MultiCameraTracks(self._visits, self._decisions, self._known)
        self._in_frame: dict[str, frozenset[Track]] = {}
        self._patience = PresenceTimeout(round(LEAVE_AFTER_S * 1e9))
        self._speaking = ""
        self._participant_history = UtteranceHistory(self._known)
        self._portraits_fetched: dict[str, bool] = {}

    def use_settings(self, settings: RecognitionSettings, *, may_decide: bool = True) -> None:
        """Apply a scenario's settings; with less recognition, learned data is no longer used.

        Where the scenario does not name people (``may_decide``), earlier decisions cannot be undone either.
        """
        if settings.recognise == "nobody":
            for visit in self._visits:
                visit.suggested_id = ""
        if not may_decide:
            self._decisions.forget_decisions()
        self._settings = settings

    def ask_consents_again(self, again: bool) -> None:
        """While ``again``, earlier consents do not count; they remain stored."""
        self._known.ask_consents_again(again)

    # Detections

    def update(self, people: People, known_ns: int | None = None) -> tuple[People, list[Event]]:
        """Add one frame's tracks. ``known_ns`` is when the result was available, some time after the image.

        Returns the frame with ``person_id`` filled in for confirmed people, and the events.
        """
        now_ns = people.stamp_ns
        self._patience.note_detection(people.camera, now_ns, now_ns if known_ns is None else known_ns)
        events: list[Event] = []
        self._in_frame[people.camera] = frozenset((people.camera, box.track) for box in people.boxes)
        for box in people.boxes:
            self._cameras.see((people.camera, box.track), now_ns)
            events += self._see((people.camera, box.track), now_ns)
            visit = self._visits.of_track((people.camera, box.track))
            if visit is not None and (people.camera, box.track) == (visit.camera, visit.track):
                visit.posture, visit.hand_raised, visit.facing = box.posture, box.hand_raised, box.facing
        events += self._let_leave(now_ns, self._patience.in_pictures_ns)
        boxes = tuple(replace(box, person_id=self._id_of((people.camera, box.track))) for box in people.boxes)
        return replace(people, boxes=boxes), events

    def tick(self, now_ns: int) -> list[Event]:
        """End the visits of people not seen for a while; call it without frames, too."""
        return self._let_leave(now_ns, self._patience.now_ns)

    def _let_leave(self, now_ns: int, patience_ns: Callable[[str], int]) -> list[Event]:
        self._candidates = {
            track: candidate
            for track, candidate in self._candidates.items()
            if now_ns - candidate.last_seen_ns <= patience_ns(track[0])
        }
        overdue = [visit for visit in self._visits.here() if now_ns - visit.last_seen_ns > patience_ns(visit.camera)]
        events = [event for visit in overdue for event in self._leave(visit, now_ns)]
        self._known.turn_day()
        return [*events, *self._known.problems(now_ns)]

    def add_embeddings(self, embedding: PersonLooks) -> list[Event]:
        """Add an appearance embedding, for learning and identification."""
        if self._settings.recognise != "nobody":
            self._cameras.add_embeddings(embedding)
        visit = self._visits.of_track((embedding.camera, embedding.track))
        candidate = self._candidates.get((embedding.camera, embedding.track))
        if visit is None and candidate is not None and self._settings.recognise != "nobody":
            candidate.add_embeddings(embedding)
        if visit is None or not visit.here or visit.forgotten or not self._may_learn_face(visit, embedding):
            return []
        if embedding.kind == "clothing" and not visit.by_hand and len({camera for camera, _ in visit.tracks}) == 1:
            match self._known.identities.still_the_same(visit.visit_id, embedding):
                case "doubtful":
                    return []
                case "somebody else":
                    return self._replace_by_another(visit, embedding.stamp_ns)
        if not self._known.identities.see(visit.visit_id, embedding):
            return []
        visit.embedding_count += 1
        return [] if visit.identified or self._known.is_known(visit.person_id) else self._recognise(visit, embedding)

    def add_portrait(self, portrait: PersonPortrait) -> None:
        """Add the best portrait of a visit so far."""
        track = portrait.camera, portrait.track
        visit = self._visits.of_track(track)
        candidate = self._candidates.get(track)
        if visit is None and candidate is not None:
            candidate.portrait = portrait
        if visit is None or visit.forgotten or self._settings.recognise == "nobody":
            return
        # A portrait counts as an image, in which people may have to be unrecognisable.
        consents = self._settings.portraits == "consenting" and "photo" in self._known.consents(visit.person_id)
        if self._settings.portraits != "everybody" and not consents:
            return
        if portrait.quality > visit.portrait_quality:
            visit.portrait_quality = portrait.quality
            self.portraits.drop(_portrait_key(visit))
            visit.portraits += 1
            self.portraits.put(_portrait_key(visit), portrait.jpeg)
            self._known.store_portrait(visit.visit_id, portrait.jpeg, portrait.quality)

    def add_places(self, places: PeopleInMap, map_from_robot: Pose2D | None) -> list[Event]:
        """Add positions, and join tracks of several cameras; ``map_from_robot`` is None if unknown."""
        self._cameras.add_places(places)
        if map_from_robot is not None:
            self._note_places(places, map_from_robot)
        return self._cameras.join_and_part(places.stamp_ns)

    def _note_places(self, places: PeopleInMap, map_from_robot: Pose2D) -> None:
        """Note positions relative to the robot's current pose."""
        for place in places.people:
            candidate = self._candidates.get((places.camera, place.track))
            if candidate is not None:
                candidate.spot = place.x_m, place.y_m
            visit = self._visits.of_track((places.camera, place.track)) or self._visits.find(place.person_id)
            if visit is None or not visit.here:
                continue
            visit.spot = place.x_m, place.y_m
            in_robot = map_from_robot.inverse() @ Pose2D(place.x_m, place.y_m, 0.0)
            distance_m, bearing_rad = math.hypot(in_robot.x_m, in_robot.y_m), math.atan2(in_robot.y_m, in_robot.x_m)
            moved = (
                visit.distance_m is None
                or visit.bearing_rad is None
                or abs(distance_m - visit.distance_m) >= _MOVED_M
                or abs(bearing_rad - visit.bearing_rad) >= _TURNED_RAD
            )
            if moved and places.stamp_ns - visit.placed_ns >= _MOVED_EVERY_NS:
                visit.distance_m, visit.bearing_rad = round(distance_m, 2), round(bearing_rad, 3)
                visit.placed_ns = places.stamp_ns

    def note(self, event: HistoryEvent) -> None:
        """Add events about people to their history."""
        match event:
            case SessionStarted():
                self._known.session = event.folder
            case SessionEnded():
                self._known.session = ""
            case PhotoTaken(person_id=person_id, person_ids=person_ids, file_name=file_name):
                for shown_id in dict.fromkeys(each for each in (person_id, *person_ids) if each):
                    self._known.add_history(self._visit_id(shown_id), "photo", file_name)
            case UtteranceChanged(speaker="participant", state=state, person_id=person_id):
                self._speaking = person_id if state in ("requested", "started") else ""
                if state == "finished":
                    visit_id = self._visit_id(person_id) if person_id else ""
                    self._participant_history.add(event.utterance_id, visit_id, event.text)
            case UtteranceCorrected():
                self._participant_history.correct(event, self._visit_id)
            case UtteranceChanged(speaker="robot", state="finished" | "interrupted", person_id=person_id) if person_id:
                self._known.add_history(self._visit_id(person_id), "said", event.text)

    # Decisions

    def do(self, intent: PeopleIntent, now_ns: int) -> list[Event]:
        """Events of an intent; a Problem if it cannot be executed."""
        here = self._visits.here()
        events = self._decisions.do(intent, now_ns)
        for visit in here:
            if not visit.here and visit in self._visits:
                self._end(visit)
        return [*events, *self._known.problems(now_ns)]

    # Rows for display

    def persons(self, *, include_left: bool = False) -> tuple[PersonRow, ...]:
        """People present, in order of their first appearance; with ``include_left`` also those who left."""
        of_person: dict[str, list[Visit]] = {}
        for visit in self._visits:
            if visit.here or include_left:
                of_person.setdefault(visit.person_id, []).append(visit)
        return tuple(self._row(visits) for visits in of_person.values())

    def everybody(self) -> tuple[PersonRow, ...]:
        """People present, people who left, and people known from earlier sessions, without duplicates."""
        rows = self.persons(include_left=True)
        present_ids = {row.person_id for row in rows}
        before = tuple(
            PersonRow(
                known_id, -1, self._name_of(known_id), here=False, since_ns=0, last_seen_ns=0,
                known=True, group=about.group, tags=about.tags, note=about.note,
                portrait=self._portrait_of(known_id), consents=self._known.consents(known_id),
            )
            for known_id, about in self._known.everybody() if known_id not in present_ids
        )  # fmt: skip
        return (*sorted(rows, key=lambda row: not row.here), *before)

    def history(self, person_id: str, text: str = "") -> tuple[HistoryEntry, ...]:
        """History of a person over all sessions, newest first, filtered by all words of ``text``."""
        return self._known.history(person_id, text)

    def restart_tracks(self, now_ns: int) -> list[Event]:
        """End all visits, since a restarted tracker reuses its numbers."""
        self._candidates.clear()
        self._in_frame.clear()
        self._cameras.forget()
        events = [event for visit in self._visits.here() for event in self._leave(visit, now_ns)]
        self._visits.forget_tracks()
        return events

    def close(self) -> None:
        for visit in self._visits.here():
            self._end(visit)
        self._known.close()

    # Tracks

    def _see(self, track: Track, now_ns: int) -> list[Event]:
        visit = self._visits.of_track(track)
        away = visit is not None and not visit.here and now_ns - visit.last_seen_ns > _SAME_VISIT_WITHIN_NS
        if away and self._settings.recognise != "nobody":
            # A tracker's own match suffices for a short absence only.
            self._visits.detach(track)
            visit = None
        if visit is None:
            candidate = self._candidates.setdefault(track, Candidate(0, now_ns, now_ns))
            candidate.frames += 1
            candidate.last_seen_ns = now_ns
            if candidate.frames < self._confirm_frames:
                return []
            lost = [each for each in self._visits if self._is_lost(each, now_ns)]
            joined = same_visit(candidate, lost, self._known.identities.likeness, self._known.is_known, now_ns)
            if joined is None:
                learned = self._settings.recognise != "nobody" and any(
                    self._known.identities.views_of(each.visit_id) for each in lost
                )
                waits = learned and candidate.is_undecided(now_ns)
                return [] if waits else self._appear(track, now_ns)
            for before in [each for each in joined.tracks if each[0] == track[0]]:
                self._visits.detach(before)
            self._visits.attach(joined, track)
            del self._candidates[track]
            visit = joined
            if candidate.portrait is not None:
                self.add_portrait(candidate.portrait)
        visit.last_seen_ns = now_ns
        if track == (visit.camera, visit.track) or now_ns - visit.seen_by_camera_ns > _OTHER_CAMERA_AFTER_NS:
            visit.camera, visit.track = track
            visit.seen_by_camera_ns = now_ns
        if visit.here:
            return []
        alone = not self._is_here(visit.person_id)
        visit.here, visit.since_ns = True, now_ns
        visit.from_utc_ns = self._known.utc_now_ns()
        number = self._visits.number_of(visit.person_id)
        return [PersonAppeared(now_ns, visit.person_id, visit.track, number)] if alone else []

    def _is_lost(self, visit: Visit, now_ns: int) -> bool:
        """True if a new track may continue that visit, which has no track in view."""
        within_ns = SHORT_GAP_NS if visit.spot is None else JOINED_WITHIN_NS
        if visit.forgotten or now_ns - visit.last_seen_ns > within_ns:
            return False
        in_view = any(track in self._in_frame.get(track[0], ()) for track in visit.tracks)
        others = (other for other in self._visits.of_person(visit.person_id) if other is not visit)
        return not in_view and not any(other.here for other in others)

    def _appear(self, track: Track, now_ns: int) -> list[Event]:
        candidate = self._candidates.pop(track)
        seen_already = self._cameras.seen_by_another(track)
        if seen_already is not None:
            self._visits.attach(seen_already, track)
            return []
        person_id = self._known.add()
        visit = Visit(person_id, person_id, *track, now_ns, now_ns, self._known.utc_now_ns())
        visit.seen_by_camera_ns = now_ns
        self._visits.begin(visit, track)
        if candidate.portrait is not None:
            self.add_portrait(candidate.portrait)
        number = self._visits.number_of(person_id)
        return [PersonAppeared(now_ns, person_id, track[1], number), *self._known.problems(now_ns)]

    def _leave(self, visit: Visit, now_ns: int) -> list[Event]:
        visit.here = False
        self._end(visit)
        for old in self._visits.too_many():
            self._visits.drop(old)
            self._known.drop_visit(old.visit_id)
            self.portraits.drop(_portrait_key(old))
        if self._is_here(visit.person_id):
            return []
        return [PersonLeft(now_ns, visit.person_id, visit.track, visit.last_seen_ns)]

    def _end(self, visit: Visit) -> None:
        """Store a visit that ended."""
        self._known.note_visit(visit.visit_id, from_utc_ns=visit.from_utc_ns, to_utc_ns=self._known.utc_now_ns())
        if not visit.settled and not visit.resembles_somebody:
            self._settle(visit)
        if visit.settled or visit.identified:
            self._known.store_embeddings(visit.visit_id)
        if "face" not in self._known.consents(visit.person_id):
            self._known.identities.drop("face", [visit.visit_id])
        self._known.identities.end_visit(visit.visit_id)
        visit.distance_m = visit.bearing_rad = None

    def _is_here(self, person_id: str) -> bool:
        return any(visit.here for visit in self._visits.of_person(person_id))

    def _id_of(self, track: Track) -> str:
        visit = self._visits.of_track(track)
        return "" if visit is None else visit.person_id

    def _visit_id(self, person_id: str) -> str:
        """Id for storing events with a person: undoing their identification includes these."""
        visit = self._visits.find(person_id)
        return person_id if visit is None or not visit.here else visit.visit_id

    # Identification

    def _may_learn_face(self, visit: Visit, embedding: PersonLooks) -> bool:
        """The face of an identified person is learned only with consent."""
        if self._settings.recognise == "nobody":
            return False
        if embedding.kind == "clothing":
            return True
        decided = visit.identified or visit.settled or self._known.is_known(visit.person_id)
        if self._settings.recognise != "faces":
            return False
        # An unidentified face may be compared only with stored faces, whose owners consented.
        may_compare = not decided and not self._known.asks_consents_again
        return may_compare or "face" in self._known.consents(visit.person_id)

    def _replace_by_another(self, visit: Visit, now_ns: int) -> list[Event]:
        """End the visit and begin another: a track that switched people must not pass on a name."""
        events = self._leave(visit, now_ns)
        other = self._decisions.begin_another(visit, now_ns)
        other.seen_by_camera_ns = now_ns
        return [
            *events,
            PersonSplit(now_ns, other.visit_id, visit.person_id, CONSOLE),
            PersonAppeared(now_ns, other.visit_id, other.track, self._visits.number_of(other.visit_id)),
        ]

    def _recognise(self, visit: Visit, embedding: PersonLooks) -> list[Event]:
        here = self._visits.here()
        impossible = {other.person_id for other in here} | self._known.rejected_for(visit.visit_id)
        visit.judgement = judgement = self._known.identities.judge(
            visit.visit_id, impossible=impossible, confused=self._known.confused()
        )
        best, second = judgement.best, judgement.runner_up
        visit.resembles_somebody = best is not None
        if best is None:
            visit.suggested_id = ""
            if not visit.settled and visit.embedding_count >= _STRANGER_AFTER and judgement.stranger >= _STRANGER_FROM:
                self._settle(visit)
            return []
        confirm_at = 1.0 if visit.by_hand else self._settings.confirm_at
        sure = judgement.sure and best.confidence >= confirm_at and confirm_at < 1.0
        if sure and not self._contested(visit, here):
            visit.suggested_id = ""
            return self._decisions.identify(visit, best.person_id, embedding.stamp_ns)
        # A wizard cannot answer a question about an unnamed person who left.
        nameless = {each for each in self._known.identities.people() if not self._known.is_known(each)}
        visit.judgement = judgement = self._known.identities.judge(
            visit.visit_id, impossible=impossible | nameless, confused=self._known.confused()
        )
        best, second = judgement.best, judgement.runner_up
        if best is None or best.confidence < self._settings.ask_at:
            visit.suggested_id = ""
            return []
        if best.person_id == visit.suggested_id:
            return []
        visit.suggested_id = best.person_id
        return [
            PersonSuggested(
                embedding.stamp_ns,
                visit.visit_id,
                best.person_id,
                round(best.confidence, 3),
                "" if second is None else second.person_id,
                0.0 if second is None else round(second.confidence, 3),
                best.kind,
            )
        ]

    def _contested(self, visit: Visit, here: list[Visit]) -> bool:
        """True if another person present may be the same: only a wizard can tell them apart."""
        best = visit.judgement.best
        return best is not None and any(
            guess.person_id == best.person_id
            for other in here
            if other is not visit and not other.identified
            for guess in other.judgement.guesses
        )

    def _settle(self, visit: Visit) -> None:
        """Add the visit to the gallery as a new person."""
        if visit.embedding_count and not visit.forgotten:
            visit.settled = True
            if "face" not in self._known.consents(visit.person_id):
                self._known.identities.drop("face", [visit.visit_id])
            self._known.identities.settle(visit.visit_id)

    # Rows

    def _row(self, visits: list[Visit]) -> PersonRow:
        # Of several visits of a person the first is used, so that the row is stable across cameras.
        visit = max(visits, key=lambda each: (each.here, -each.since_ns if each.here else each.last_seen_ns))
        about = self._known.about(visit.person_id)
        number = self._visits.number_of(visit.person_id)
        here = [each for each in visits if each.here]
        placed = max(here, key=lambda each: each.placed_ns, default=visit)
        return PersonRow(
            visit.person_id,
            visit.track,
            about.name or unnamed_label(number),
            here=visit.here,
            since_ns=min((each.since_ns for each in here), default=visit.since_ns),
            last_seen_ns=visit.last_seen_ns,
            camera=visit.camera,
            number=number,
            visit_id=visit.visit_id,
            known=self._known.is_known(visit.person_id),
            group=about.group,
            tags=about.tags,
            note=about.note,
            portrait=_portrait_key(visit) if visit.portraits else self._portrait_of(visit.person_id),
            suggestions=() if visit.identified else self._suggestions(visit),
            confidence=round(visit.confidence, 2),
            consents=self._known.consents(visit.person_id),
            distance_m=placed.distance_m,
            bearing_rad=placed.bearing_rad,
            speaking=visit.here and self._speaking == visit.person_id,
            posture=visit.posture,
            hand_raised=visit.hand_raised,
            facing=visit.facing,
            summary=visit.summary,
            cameras=tuple(dict.fromkeys(camera for each in here for camera, _ in sorted(each.tracks))),
        )

    def _suggestions(self, visit: Visit) -> tuple[Suggestion, ...]:
        if not visit.suggested_id or self._known.is_known(visit.person_id):
            return ()
        return tuple(
            Suggestion(guess.person_id, self._name_of(guess.person_id), round(guess.confidence, 2))
            for guess in visit.judgement.guesses[:2]
        )

    def _name_of(self, person_id: str) -> str:
        return self._known.about(person_id).name or unnamed_label(self._visits.number_of(person_id))

    def _portrait_of(self, person_id: str) -> str:
        """Key of a known person's portrait, loaded from the database on first use."""
        key = f"{person_id}/0"
        if key not in self._portraits_fetched:
            self._portraits_fetched[key] = False
            jpeg = self._known.portrait(person_id)
            if jpeg:
                self.portraits.put(key, jpeg)
                self._portraits_fetched[key] = True
        return key if self._portraits_fetched[key] else ""


def _portrait_key(visit: Visit) -> str:
    return f"{visit.visit_id}/{visit.portraits}"


_MOST_NS = 6_000_000_000
# Number of detection runs whose longest interval counts, and how many such intervals without a person mean a departure.
_MAX_TIMES, _MISSED = 5, 2.5


class PresenceTimeout:
    """Presence timeout per camera: how long a person counts as present after the last detection. It grows with the
    detection interval and latency of the camera: without a detection run, absence is unknown.

    Timeout per camera, from its recent detection runs.
    """

    def __init__(self, least_ns: int) -> None:
        self._least_ns = least_ns
        self._detections_ns: dict[str, deque[int]] = {}
        self._late_ns: dict[str, deque[int]] = {}

    def note_detection(self, camera: str, taken_ns: int, known_ns: int) -> None:
        self._detections_ns.setdefault(camera, deque(maxlen=_MAX_TIMES)).append(taken_ns)
        self._late_ns.setdefault(camera, deque(maxlen=_MAX_TIMES)).append(known_ns - taken_ns)

    def in_pictures_ns(self, camera: str) -> int:
        """Timeout in image time: from the last detection to a later image without the person."""
        detections_ns = self._detections_ns.get(camera, ())
        apart_ns = max((after - before for before, after in itertools.pairwise(detections_ns)), default=0)
        return max(self._least_ns, min(round(_MISSED * apart_ns), _MOST_NS))

    def now_ns(self, camera: str) -> int:
        """Timeout in real time: from the last detection until now, including latency."""
        late_ns = max(self._late_ns.get(camera, ()), default=0)
        return self.in_pictures_ns(camera) + min(late_ns, _MOST_NS)


_MAX_UTTERANCES = 200
"""Utterances that are corrected later than after so many others stay as they are in the history."""


class UtteranceHistory:
    """Participants' utterances in their histories, updated by later corrections.

    History entry per utterance.
    """

    def __init__(self, known: KnownPeople) -> None:
        self._known = known
        self._entries: dict[str, _Heard] = {}
        self._corrections = Corrections()

    def add(self, utterance_id: str, person_id: str, text: str) -> None:
        """Add an utterance. ``person_id`` is the visit's own id, empty for an unknown speaker."""
        self._entries[utterance_id] = _Heard(person_id, text, "", "")
        if len(self._entries) > _MAX_UTTERANCES:
            del self._entries[next(iter(self._entries))]
        self._write(self._entries[utterance_id], person_id, text)

    def correct(self, event: UtteranceCorrected, visit_of: Callable[[str], str]) -> None:
        """Apply a correction. ``visit_of`` returns the visit of a person."""
        self._corrections.take(event)
        entry, made = self._entries.get(event.utterance_id), self._corrections.of(event.utterance_id)
        if entry is None:
            return
        person_id = entry.person_id
        if made.person_id is not None:
            person_id = visit_of(made.person_id) if made.person_id else ""
        if made.speaker not in (None, "participant"):
            person_id = ""
        self._write(entry, person_id, entry.text if made.text is None else made.text)

    def _write(self, entry: "_Heard", person_id: str, text: str) -> None:
        if (person_id, text) == (entry.stored_for, entry.stored_text):
            return
        if entry.stored_for:
            self._known.take_back_history(entry.stored_for, "heard", entry.stored_text)
        if person_id:
            self._known.add_history(person_id, "heard", text)
        entry.stored_for, entry.stored_text = person_id, text


@dataclass(slots=True)
class _Heard:
    """Original speaker and text, and the current history entry."""

    person_id: str
    text: str
    stored_for: str
    stored_text: str


JOINED_WITHIN_NS = 30_000_000_000
"""A person lost for longer is identified again."""
SHORT_GAP_NS = 3_000_000_000
"""For so long a tracker or a turn of the camera loses somebody; then appearance or place alone is enough."""
DECIDED_WITHIN_NS = 1_500_000_000
"""A track that may be somebody who was lost waits for its embeddings no longer than this."""
_MAX_EMBEDDINGS, _LEAST_TO_JOIN = 6, 2
# The same clothes reach 0.89 to 0.98, the most similar stranger 0.88 (see LINES in identities).
_ALIKE_FROM, _AHEAD_BY = 0.89, 0.02
_STANDS_WITHIN_M, _WALKS_MPS, _NEAR_M = 0.8, 1.5, 0.6
# For a visit without a name, where a wrong match by position passes nothing on.
_NEAR_WITHOUT_NAME_M = 1.0


@dataclass(slots=True)
class Candidate:
    """Track joining: continue a visit on a new track after the camera turned or lost the person, by appearance and
    place.

    Track that is not yet confirmed as a person.
    """

    frames: int
    first_seen_ns: int
    last_seen_ns: int
    embeddings: list[PersonLooks] = field(default_factory=list)
    portrait: PersonPortrait | None = None
    spot: Spot | None = None

    def add_embeddings(self, embedding: PersonLooks) -> None:
        if embedding.kind == "clothing" and embedding.quality >= GOOD_QUALITY:
            self.embeddings = [*self.embeddings, embedding][-_MAX_EMBEDDINGS:]

    def is_undecided(self, now_ns: int) -> bool:
        """True while another embedding may still identify the person."""
        return len(self.embeddings) < _LEAST_TO_JOIN and now_ns - self.first_seen_ns < DECIDED_WITHIN_NS


Likeness = Callable[[str, PersonLooks], float | None]


def same_visit(
    candidate: Candidate, lost: Iterable[Visit], likeness: Likeness, is_known: Callable[[str], bool], now_ns: int
) -> Visit | None:
    """The ``lost`` visit that the track continues: the only possible one, by appearance or position.

    ``is_known``: whether there are notes on a person.
    """
    possible: list[tuple[float, Visit]] = []
    for visit in lost:
        gap_ns = now_ns - visit.last_seen_ns
        away_m = None if candidate.spot is None or visit.spot is None else math.dist(candidate.spot, visit.spot)
        if away_m is not None and away_m > _STANDS_WITHIN_M + _WALKS_MPS * gap_ns / 1e9:
            continue
        if away_m is None and gap_ns > SHORT_GAP_NS:
            continue
        similarities = [alike for each in candidate.embeddings if (alike := likeness(visit.visit_id, each)) is not None]
        if similarities:
            alike = sum(similarities) / len(similarities)
            if alike >= _ALIKE_FROM:
                possible.append((alike, visit))
        elif away_m is not None:
            near_m = _NEAR_WITHOUT_NAME_M if not is_known(visit.person_id) else _NEAR_M
            if away_m <= near_m and (gap_ns <= SHORT_GAP_NS or not is_known(visit.person_id)):
                possible.append((0.0, visit))
    possible.sort(key=lambda each: -each[0])
    if not possible or (len(possible) > 1 and possible[0][0] - possible[1][0] < _AHEAD_BY):
        return None
    return possible[0][1]
