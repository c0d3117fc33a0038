"""Intents of people: naming, identification, consent."""

from caris_desktop.domain.events import ConsentKind
from caris_desktop.domain.intents.base_intents import Intent, IntentSpec, IntentTable
from caris_desktop.domain.translation import QT_TR_NOOP
from caris_desktop.domain.value_class import dataclass


@dataclass(frozen=True, slots=True)
class NamePerson(Intent):
    """Name a person, or remove the name with an empty one. Only the study's database stores the name."""

    person_id: str
    name: str


@dataclass(frozen=True, slots=True)
class AttendPerson(Intent):
    """Address this person from now on; empty: the nearest one."""

    person_id: str


@dataclass(frozen=True, slots=True)
class ConfirmPerson(Intent):
    """Identify a person as a known one: ``is_person_id``."""

    person_id: str
    is_person_id: str


@dataclass(frozen=True, slots=True)
class RejectPerson(Intent):
    """Record that a person is not ``is_person_id``, whether suggested or already identified. Permanent."""

    person_id: str
    is_person_id: str


@dataclass(frozen=True, slots=True)
class SetPersonGroup(Intent):
    """Assign a person to this group; empty: to none."""

    person_id: str
    group: str


@dataclass(frozen=True, slots=True)
class TagPerson(Intent):
    """Set a person's tags, and no others."""

    person_id: str
    tags: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class NotePerson(Intent):
    """Set the wizard's note about a person, which replaces the earlier one."""

    person_id: str
    note: str


@dataclass(frozen=True, slots=True)
class MergePeople(Intent):
    """Merge two identities of one person into ``into_person_id``."""

    person_id: str
    into_person_id: str


@dataclass(frozen=True, slots=True)
class SplitPerson(Intent):
    """Split off the person present: nothing of this visit, or of the named one, belongs to ``person_id``."""

    person_id: str
    visit_id: str = ""


@dataclass(frozen=True, slots=True)
class NoteConsent(Intent):
    """Record a person's consent, or its end."""

    person_id: str
    kind: ConsentKind
    given: bool


@dataclass(frozen=True, slots=True)
class UndoPeople(Intent):
    """Undo the last decision about people, except erasing."""


@dataclass(frozen=True, slots=True)
class LookUpPerson(Intent):
    """Search all sessions with a person: entries with all these words, or everything without words."""

    person_id: str
    text: str = ""


@dataclass(frozen=True, slots=True)
class ForgetPerson(Intent):
    """Erase all data about a person from the study's database, and blur them in its recordings, for good."""

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
