"""Evaluation of re-identification with people who leave and return, against ground truth."""

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from random import Random

import numpy as np
from numpy.typing import NDArray

from caris_desktop.domain.events import PersonIdentified
from caris_desktop.domain.intents import NamePerson
from caris_desktop.domain.person_values import PersonLooks
from caris_desktop.domain.sensing import FrameRef, People, PersonBox
from caris_desktop.people.known import KnownPeople
from caris_desktop.people.presence import PresenceTracker, RecognitionSettings
from caris_desktop.perception.appearance_embedding import AppearanceModel
from caris_desktop.perception.inference_messages import DetectionRequest
from caris_desktop.perception.kalman_tracker import overlaps, view_qualities
from caris_desktop.perception.perceiver import Perceiver
from caris_desktop.simulator.simulated_people import Visit
from tests.support.walkers import FilmedFrame, TrueBox

RATE_HZ = 2.0
MORNING = datetime(2026, 11, 23, 9, 0)
_CONFIDENCE = 0.8
_LEAST_PX = (20.0, 60.0)
_SAME_BOX = 0.4
_NAMED_AFTER = 3  # frames, to exclude people who are covered when they appear


@dataclass(frozen=True, slots=True)
class Sight:
    """One frame: detected people, their embeddings, and the true person of each track."""

    people: People
    embeddings: tuple[PersonLooks, ...]
    truly: dict[int, TrueBox]


@dataclass
class Outcome:
    """Results for the true visits of known people after their first one.

    Each visit is assessed by the row that represented it longest: ``suggested`` if the right person was among its first
    two suggestions at the end, or was its name; ``named`` if the console had identified it automatically. ``wrong``
    counts all false automatic identifications, including strangers and temporary rows. ``told`` has each displayed
    confidence with its correctness.
    """

    returns: int = 0
    suggested: int = 0
    named: int = 0
    wrong: int = 0
    told: list[tuple[float, bool]] = field(default_factory=list)

    @property
    def suggested_share(self) -> float:
        return self.suggested / max(1, self.returns)

    @property
    def named_share(self) -> float:
        return self.named / max(1, self.returns)


def visits_of(
    people: Sequence[int], *, rounds: int, seed: int, clothes: Sequence[int] = (0,), stays_s: float = 6.0
) -> list[Visit]:
    """Visits in which everybody comes once per round in random order, two or three at a time; ``clothes`` by round."""
    chance = Random(f"{seed}/returns")  # noqa: S311 - a test, not cryptography
    visits, comes_s = [], 0.0
    for number in range(rounds):
        for person in chance.sample(people, len(people)):
            stay_s = stays_s * chance.uniform(0.8, 1.2)
            visits.append(Visit(person, comes_s, stay_s, clothes[number % len(clothes)]))
            comes_s += 0.75 * stays_s * chance.uniform(0.8, 1.2)
        comes_s += 8.0
    return visits


def seen(frames: Iterable[FilmedFrame], network: AppearanceModel) -> Iterator[Sight]:
    """Result of a perfect detector and tracker."""
    for frame in frames:
        boxes = [box for box in frame.boxes if box.width_px >= _LEAST_PX[0] and box.height_px >= _LEAST_PX[1]]
        if not boxes:
            yield Sight(_people(frame.stamp_ns, ()), (), {})
            continue
        corners = _corners(boxes)
        height_px, width_px = frame.image_bgr.shape[:2]
        qualities = view_qualities(corners, np.full(len(boxes), _CONFIDENCE), (float(width_px), float(height_px)))
        vectors = network.embed(frame.image_bgr, list(corners)).astype(np.float32)
        looks = tuple(
            PersonLooks(frame.stamp_ns, "front", box.visit, "clothing", network.name, vector, float(quality))
            for box, vector, quality in zip(boxes, vectors, qualities, strict=True)
        )
        found = tuple(
            PersonBox(box.visit, "", box.left_px, box.top_px, box.width_px, box.height_px, _CONFIDENCE) for box in boxes
        )
        yield Sight(_people(frame.stamp_ns, found), looks, {box.visit: box for box in boxes})


def found(frames: Iterable[FilmedFrame], perceiver: Perceiver) -> Iterator[Sight]:
    """Result of the real detector and tracker; a track belongs to the person with the largest overlap."""
    for number, frame in enumerate(frames):
        height_px, width_px = frame.image_bgr.shape[:2]
        ref = FrameRef(frame.stamp_ns, None, "front", "", 0, number, width_px, height_px)
        boxes = perceiver.perceive(frame.image_bgr, DetectionRequest(ref)).boxes
        looks = tuple(
            PersonLooks(
                frame.stamp_ns, "front", box.track, "clothing", perceiver.appearance_model,
                box.embedding.astype(np.float32), box.quality,
            )
            for box in boxes if box.embedding is not None
        )  # fmt: skip
        people = tuple(
            PersonBox(box.track, "", box.left_px, box.top_px, box.width_px, box.height_px, box.confidence)
            for box in boxes
        )
        yield Sight(_people(frame.stamp_ns, people), looks, _whose(people, frame.boxes))


def _whose(people: Sequence[PersonBox], true_boxes: Sequence[TrueBox]) -> dict[int, TrueBox]:
    """True box of each track with an overlap."""
    if not people or not true_boxes:
        return {}
    share = overlaps(_corners(people), _corners(true_boxes))
    return {
        box.track: true_boxes[int(row.argmax())]
        for box, row in zip(people, share, strict=True)
        if row.max() >= _SAME_BOX
    }


def _corners(boxes: Sequence[PersonBox] | Sequence[TrueBox]) -> NDArray[np.float64]:
    return np.array(
        [(box.left_px, box.top_px, box.left_px + box.width_px, box.top_px + box.height_px) for box in boxes]
    )


def _people(stamp_ns: int, boxes: tuple[PersonBox, ...]) -> People:
    return People(stamp_ns, "front", stamp_ns // 10**6, 640, 480, boxes, 8.0)


def recognised(
    sights: Iterable[Sight],
    known: Iterable[int],
    settings: RecognitionSettings = RecognitionSettings(),
) -> Outcome:
    """Results if the wizard names the ``known`` at their first visit and does nothing else."""
    to_name = set(known)
    everybody = frozenset(to_name)
    now_ns = 0
    knowing = KnownPeople(now=lambda: MORNING + timedelta(microseconds=now_ns / 1000.0))
    presence = PresenceTracker(knowing, confirm_frames=1, settings=settings)
    sights_of: dict[str, Counter[int]] = defaultdict(Counter)  # by visit: number of frames per person
    rows_of: dict[int, Counter[str]] = defaultdict(Counter)  # by true visit: number of frames per row
    person_of: dict[int, int] = {}
    named_at_first: set[str] = set()
    first_visits: set[int] = set()
    identified: list[tuple[str, str]] = []
    told: list[tuple[str, str, float]] = []
    last_told: dict[str, list[str]] = defaultdict(list)
    for sight in sights:
        now_ns = sight.people.stamp_ns
        events = presence.update(sight.people)[1]
        for embedding in sight.embeddings:
            events += presence.add_embeddings(embedding)
        identified += [(event.person_id, event.is_person_id) for event in events if isinstance(event, PersonIdentified)]
        for row in presence.persons():
            true_box = sight.truly.get(row.track)
            person = -1 if true_box is None else true_box.person
            sights_of[row.visit_id][person] += person >= 0
            if true_box is not None:
                person_of[true_box.visit] = person
                rows_of[true_box.visit][row.visit_id] += 1
            if true_box is not None and person in to_name and sights_of[row.visit_id][person] >= _NAMED_AFTER:
                to_name.remove(person)
                first_visits.add(true_box.visit)
                named_at_first.add(row.visit_id)
                presence.do(NamePerson(row.person_id, f"Name {person}"), now_ns)
            elif row.person_id != row.visit_id:
                last_told[row.visit_id] = [row.person_id]
            else:
                last_told[row.visit_id] = [suggested.person_id for suggested in row.suggestions]
                told += [(row.visit_id, each.person_id, each.confidence) for each in row.suggestions[:1]]
    truth = {visit_id: seen_as.most_common(1)[0][0] for visit_id, seen_as in sights_of.items()}
    outcome = Outcome()
    names = {visit_id: truth[root] for visit_id, root in identified if root in named_at_first}
    outcome.wrong = sum(truth[visit_id] != truth[root] for visit_id, root in identified)
    outcome.told = [(confidence, truth[visit_id] == truth[root]) for visit_id, root, confidence in told]
    for visit, person in person_of.items():
        if person in everybody and visit not in first_visits:
            row_id = rows_of[visit].most_common(1)[0][0]
            outcome.returns += 1
            outcome.suggested += person in {truth[each] for each in last_told[row_id]}
            outcome.named += names.get(row_id) == person
    return outcome
