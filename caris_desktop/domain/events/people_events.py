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
    """A track became a person for the wizard; ``number`` is that of "Person 3", 0 where it is not known."""

    stamp_ns: int
    person_id: str
    track: int
    number: int = 0


@dataclass(frozen=True, slots=True)
class PersonLeft:
    """A person has not been seen for a while: since ``last_seen_ns``, None in older recordings."""

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
    """Who is here looks like somebody known; nothing is decided. ``confidence`` is how often such a look is right.

    ``runner_up_id`` is who comes next, empty where nobody does. ``kind`` is what told: clothing or face.
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
    """Who was ``person_id`` so far in this visit is ``is_person_id``, whose id rows and boxes bear from now on.

    ``runner_up`` is the confidence of whom it was next likely to be. ``actor`` confirmed it; the console, where it was
    sure by itself.
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
    """Who is here is not ``is_person_id``. Where that was taken for granted, the visit is ``person_id``'s again."""

    stamp_ns: int
    person_id: str
    is_person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonDescribed:
    """A person's group, tags or note changed. What they are now is only in the study's database."""

    stamp_ns: int
    person_id: str
    detail: PersonDetail
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PeopleMerged:
    """``person_id`` is ``into_person_id`` from now on, in the past too."""

    stamp_ns: int
    person_id: str
    into_person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonSplit:
    """A visit that was ``from_person_id``'s belongs to ``person_id``."""

    stamp_ns: int
    person_id: str
    from_person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class ConsentNoted:
    """A person gave consent of this kind, or took it back."""

    stamp_ns: int
    person_id: str
    kind: ConsentKind
    given: bool
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonAttended:
    """Whom the wizard deals with from now on; empty: whoever is nearest."""

    stamp_ns: int
    person_id: str
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PeopleUndone:
    """The last decision about people was taken back: ``person_id`` is as before it."""

    stamp_ns: int
    person_id: str
    decision: PeopleDecision
    is_person_id: str = ""
    actor: Actor = ""


@dataclass(frozen=True, slots=True)
class PersonForgotten:
    """Everything that the study's database knew of a person was erased."""

    stamp_ns: int
    person_id: str
    actor: Actor = ""
