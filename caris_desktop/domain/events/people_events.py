"""Events of people: appearance, identification, consent."""

from typing import Literal

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.value_class import dataclass

IdentifiedBy = Literal["wizard", "console"]
ConsentKind = Literal["face", "photo", "video", "sound"]
PersonDetail = Literal["group", "tags", "note"]
PeopleDecision = Literal["named", "group", "tags", "note", "identified", "rejected", "merged", "split", "consent"]


@dataclass(frozen=True, slots=True)
class PersonAppeared:
    """A track was confirmed as a person; ``number`` is that of "Person 3", 0 if unknown."""

    stamp_ns: int
    person_id: str
    track: int
    number: int = 0


@dataclass(frozen=True, slots=True)
class PersonLeft:
    """A person counts as gone. ``last_seen_ns`` is the last detection; None in old recordings."""

    stamp_ns: int
    person_id: str
    track: int
    last_seen_ns: int | None = None


@dataclass(frozen=True, slots=True)
class PersonRenamed:
    """The wizard named a person. The name itself is only in the study's database."""

    stamp_ns: int
    person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonSuggested:
    """A person resembles a known one; nothing is decided. ``confidence`` is how often such a match is right.

    ``runner_up_id`` is the next best match, empty if none. ``kind`` is the evidence: clothing or face.
    """

    stamp_ns: int
    person_id: str
    is_person_id: str
    confidence: float
    runner_up_id: str = ""
    runner_up: float = 0.0
    kind: str = ""


@dataclass(frozen=True, slots=True)
class PersonIdentified:
    """``person_id`` of this visit was identified as ``is_person_id``, the id in rows and boxes from now on.

    ``runner_up`` is the confidence of the next best match. ``actor`` confirmed it; the console if it was certain.
    """

    stamp_ns: int
    person_id: str
    is_person_id: str
    by: IdentifiedBy
    confidence: float
    runner_up: float = 0.0
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonRejected:
    """A person is not ``is_person_id``. If already identified as such, the visit is ``person_id``'s again."""

    stamp_ns: int
    person_id: str
    is_person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonDescribed:
    """A person's group, tags or note changed. The new values are only in the study's database."""

    stamp_ns: int
    person_id: str
    detail: PersonDetail
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PeopleMerged:
    """``person_id`` was merged into ``into_person_id``, in the past too."""

    stamp_ns: int
    person_id: str
    into_person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonSplit:
    """A visit was moved from ``from_person_id`` to ``person_id``."""

    stamp_ns: int
    person_id: str
    from_person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class ConsentNoted:
    """A person gave or withdrew consent of this kind."""

    stamp_ns: int
    person_id: str
    kind: ConsentKind
    given: bool
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonAttended:
    """Person that the wizard attends to from now on; empty: the nearest."""

    stamp_ns: int
    person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PeopleUndone:
    """The last decision about people was undone: ``person_id`` is as before."""

    stamp_ns: int
    person_id: str
    decision: PeopleDecision
    is_person_id: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonForgotten:
    """All data about a person were erased from the study's database."""

    stamp_ns: int
    person_id: str
    actor: Actor = ""
