"""Intents of people: naming, identification, consent."""

from caris_desktop.domain.events import ConsentKind
from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class NamePerson(Intent):
    """Give somebody a name, or take it back with an empty one. The name goes into the study's database alone."""

    person_id: str
    name: str


@dataclass(frozen=True, slots=True)
class AttendPerson(Intent):
    """What is said from now on is said to this person; empty: to whoever is nearest."""

    person_id: str


@dataclass(frozen=True, slots=True)
class ConfirmPerson(Intent):
    """Who is here is somebody known: ``is_person_id``."""

    person_id: str
    is_person_id: str


@dataclass(frozen=True, slots=True)
class RejectPerson(Intent):
    """Who is here is not ``is_person_id``, whether that was suggested or taken for granted already. Remembered."""

    person_id: str
    is_person_id: str


@dataclass(frozen=True, slots=True)
class SetPersonGroup(Intent):
    """Somebody belongs to this group, or with an empty one to none."""

    person_id: str
    group: str


@dataclass(frozen=True, slots=True)
class TagPerson(Intent):
    """Somebody has these tags and no others."""

    person_id: str
    tags: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class NotePerson(Intent):
    """What the wizard wants to remember about somebody, instead of what was noted before."""

    person_id: str
    note: str


@dataclass(frozen=True, slots=True)
class MergePeople(Intent):
    """Two who were taken for different people are one: ``into_person_id``."""

    person_id: str
    into_person_id: str


@dataclass(frozen=True, slots=True)
class SplitPerson(Intent):
    """Who is here now is somebody else: of this visit, or of the one named, nothing belongs to ``person_id``."""

    person_id: str
    visit_id: str = ""


@dataclass(frozen=True, slots=True)
class NoteConsent(Intent):
    """Somebody gave their consent, or took it back."""

    person_id: str
    kind: ConsentKind
    given: bool


@dataclass(frozen=True, slots=True)
class UndoPeople(Intent):
    """Take back the last decision about people; forgetting cannot be."""


@dataclass(frozen=True, slots=True)
class LookUpPerson(Intent):
    """Find what there was with somebody over all sessions: entries with all these words, or with none everything."""

    person_id: str
    text: str = ""


@dataclass(frozen=True, slots=True)
class ForgetPerson(Intent):
    """Erase everything that the study's database knows of somebody, and cover them in its recordings, for good."""

    person_id: str


PEOPLE: IntentTable = {
    NamePerson: IntentSpec(QT_TR_NOOP("Naming the person"), "naming_people"),
    AttendPerson: IntentSpec(QT_TR_NOOP("Addressing the person")),
    ConfirmPerson: IntentSpec(QT_TR_NOOP("Confirming the identity"), "naming_people"),
    RejectPerson: IntentSpec(QT_TR_NOOP("Rejecting the identity"), "naming_people"),
    SetPersonGroup: IntentSpec(QT_TR_NOOP("Changing the person's group"), "naming_people"),
    TagPerson: IntentSpec(QT_TR_NOOP("Tagging the person"), "naming_people"),
    NotePerson: IntentSpec(QT_TR_NOOP("Changing the note about the person"), "naming_people"),
    MergePeople: IntentSpec(QT_TR_NOOP("Merging the two people"), "naming_people"),
    SplitPerson: IntentSpec(QT_TR_NOOP("Splitting the person"), "naming_people"),
    # Consent and erasure are the participant's decision in every scenario.
    NoteConsent: IntentSpec(QT_TR_NOOP("Noting consent")),
    UndoPeople: IntentSpec(QT_TR_NOOP("Undoing the last decision about people")),
    LookUpPerson: IntentSpec(QT_TR_NOOP("Searching the person's history"), "naming_people", quiet=True),
    ForgetPerson: IntentSpec(QT_TR_NOOP("Erasing the person")),
}
