"""Texts and order of the People panel, computed without a window, and the pending identity question."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal

from PySide6.QtCore import QObject

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.state import LiveState
from caris_desktop.live.wizard_console import WizardConsole
from caris_desktop.people.presence import PersonRow, unnamed_label
from caris_desktop.ui import text_formatting

Presence = Literal["here", "was", "known"]
"""In front of a camera, seen earlier since the console started, or only known to the study."""

CAPTIONS: dict[Presence, str] = {"was": QT_TR_NOOP("Was here"), "known": QT_TR_NOOP("Known in this study")}
"""Above the first row of a group; people who are present need none."""
SPEAKING = QT_TR_NOOP("speaking")
_POSTURES = {"standing": QT_TR_NOOP("standing"), "sitting": QT_TR_NOOP("sitting")}
UNCONFIRMED = QT_TR_NOOP("not confirmed")
_AHEAD_RAD = math.radians(8)
_BESIDE_RAD = math.radians(110)


def presence_of(person: PersonRow) -> Presence:
    if person.here:
        return "here"
    return "was" if person.since_ns else "known"


def is_nameless_past(person: PersonRow) -> bool:
    """Whether a former person has neither a name nor any notes."""
    return presence_of(person) == "was" and not person.known and not text_formatting.has_given_name(person)


def in_order(persons: Iterable[PersonRow]) -> list[PersonRow]:
    """Present people by arrival, so that rows do not jump under the pointer; then former ones, latest first; then known
    ones by name.
    """

    def place(person: PersonRow) -> tuple[int, int, str]:
        match presence_of(person):
            case "here":
                return 0, person.since_ns, ""
            case "was":
                return 1, -person.last_seen_ns, ""
            case _:
                return 2, 0, text_formatting.person_name(person).casefold()

    return sorted(persons, key=place)


def captions(persons: Sequence[PersonRow]) -> dict[int, str]:
    """Captions by the row below them."""
    groups = [presence_of(person) for person in persons]
    return {
        groups.index(group): f"{tr(text)} · {groups.count(group)}"
        for group, text in CAPTIONS.items()
        if group in groups
    }


def is_identified(person: PersonRow) -> bool:
    """Whether the person was identified, which can be revoked."""
    return bool(person.visit_id) and person.visit_id != person.person_id


def found(person: PersonRow, query: str) -> bool:
    """Whether name, group and tags contain every word of the query."""
    there = " ".join((text_formatting.person_name(person), person.group, *person.tags)).casefold()
    return all(word in there for word in query.casefold().split())


def direction(bearing_rad: float) -> str:
    """Direction from the robot: ahead, left, right, behind."""
    away = abs(math.remainder(bearing_rad, math.tau))
    if away <= _AHEAD_RAD:
        return tr("ahead")
    if away > _BESIDE_RAD:
        return tr("behind")
    return tr("left") if math.remainder(bearing_rad, math.tau) > 0 else tr("right")


def as_permitted(persons: Iterable[PersonRow], *, naming: bool) -> tuple[PersonRow, ...]:
    """The rows, without names if the scenario does not permit naming."""
    return tuple(persons) if naming else tuple(map(_unnamed, persons))


def name_of(console: WizardConsole, person_id: str) -> str:
    """Name of a present or known person in this scenario; otherwise "Somebody"."""
    state = console.state
    rows = (*state.persons.value, *state.everybody.value)
    row = next((row for row in rows if row.person_id == person_id), None)
    if row is None:
        return tr("Somebody")
    return text_formatting.person_name(row if console.scenario.permissions.naming_people else _unnamed(row))


def _unnamed(person: PersonRow) -> PersonRow:
    name = unnamed_label(person.number) if person.number else tr("Person {number}").format(number=person.track)
    return replace(
        person, name=name, known=False, group="", tags=(), note="", suggestions=(), portrait="", visit_id="", summary=""
    )


def everyone(persons: Sequence[PersonRow], everybody: Sequence[PersonRow], now_ns: int) -> tuple[PersonRow, ...]:
    """Rows of present people, and of all others. The list of all people is updated later than that of present ones."""
    here = {person.person_id for person in persons}
    others = (person for person in everybody if person.person_id not in here)
    return (
        *persons,
        *(replace(person, here=False, last_seen_ns=now_ns) if person.here else person for person in others),
    )


def seen_elsewhere(person: PersonRow, camera_on_show: str) -> str:
    """Camera that sees the person, if not the one on display."""
    cameras = person.cameras or ((person.camera,) if person.camera else ())
    if not camera_on_show or not cameras or camera_on_show in cameras:
        return ""
    return text_formatting.camera_in_text(cameras[0])


def what_is_seen(person: PersonRow, now_ns: int, *, camera_on_show: str = "") -> list[str]:
    """Parts of a row's second line, most important first, as a narrow row shows only the beginning."""
    match presence_of(person):
        case "known":
            return [tr("known from before")]
        case "was":
            return [tr("left {ago}").format(ago=text_formatting.ago((now_ns - person.last_seen_ns) / 1e9))]
    where = (
        "" if person.distance_m is None else f"{person.distance_m:.1f} m",
        "" if person.bearing_rad is None else direction(person.bearing_rad),
    )
    posture = _POSTURES.get(person.posture, person.posture)
    recognised = tr("recognised") if text_formatting.has_given_name(person) else tr("was here before")
    parts = (
        tr(SPEAKING) if person.speaking else "",
        tr("hand raised") if person.hand_raised else "",
        ", ".join(filter(None, where)),
        tr(posture),
        seen_elsewhere(person, camera_on_show),
        tr("here {since}").format(since=text_formatting.since((now_ns - person.since_ns) / 1e9)),
        f"{recognised}, {text_formatting.percent(person.confidence)}"
        if is_identified(person) and person.confidence
        else "",
    )
    return [part for part in parts if part]


class RowButton(Value):
    """Button of a row; ``act``: yes, no, same, name, not or card. ``text`` is dropped if space is short and there is an
    icon; ``tip`` is the full text.
    """

    act: str
    text: str
    icon: str
    tip: str
    key: str = ""


def buttons_of(
    person: PersonRow, *, can_be_named: bool, unconfirmed: bool = False, yes_key: str = "", no_key: str = ""
) -> tuple[RowButton, ...]:
    """Buttons from left to right; none in a replay or without naming permission.

    ``unconfirmed``: the identity must be confirmed first.
    """
    name = text_formatting.person_name(person)
    card = RowButton("card", "", "identification-card", tr("Details of {name}").format(name=name))
    if person.suggestion is not None:
        other = text_formatting.name_in_words(person.suggestion.name)
        return (
            RowButton("yes", tr("Yes"), "", tr("Yes, this is {name}").format(name=other), yes_key),
            RowButton("no", tr("No"), "", tr("This is not {name}. The answer is saved.").format(name=other), no_key),
            card,
        )
    rename = RowButton("name", "", "pencil-simple", tr("Rename {name}").format(name=name))
    if unconfirmed:
        same = RowButton("same", tr("Confirm"), "check", tr("Yes, this is still {name} (Enter)").format(name=name))
        return same, rename, card
    if not can_be_named:
        return ()
    if not text_formatting.has_given_name(person):
        return RowButton("name", tr("Name"), "pencil-simple", tr("Give {name} a name").format(name=name)), card
    if is_identified(person) and presence_of(person) == "here":
        this_is_not = tr("This is not {name}. The answer is saved.").format(name=name)
        return RowButton("not", "", "user-minus", this_is_not), rename, card
    return rename, card


TO_READ_NS = 500_000_000
"""Minimum time before a new question can be answered: the key press may have been for the former one."""


class IdentityQuestion(Value):
    """Question whether ``person_id``, who is present, is ``is_person_id``; not answerable before ``from_ns``."""

    person_id: str
    is_person_id: str
    from_ns: int = 0


def is_asked(person: PersonRow, question: IdentityQuestion | None) -> bool:
    """Whether the question is about this person."""
    return question is not None and person.here and person.person_id == question.person_id


def with_one_question(persons: Iterable[PersonRow], question: IdentityQuestion | None) -> tuple[PersonRow, ...]:
    """Rows with only the pending suggestion, so that no answer goes to another one."""
    return tuple(
        replace(person, suggestions=()) if person.suggestions and not is_asked(person, question) else person
        for person in persons
    )


def next_asked(
    persons: tuple[PersonRow, ...], before: IdentityQuestion | None, *, selected: str, now_ns: int, ended_ns: int
) -> IdentityQuestion | None:
    """Next question: the selected person first, then the current question, then the person present longest.

    ``ended_ns``: when the former question was answered or withdrawn.
    """
    first_come = sorted(persons, key=lambda person: person.since_ns)
    open_now = {each.person_id: each.suggestion.person_id for each in first_come if each.here and each.suggestion}
    if not open_now:
        return None
    if selected in open_now:
        chosen = selected
    elif before is not None and open_now.get(before.person_id) == before.is_person_id:
        chosen = before.person_id
    else:
        chosen = next(iter(open_now))
    if before is not None and (before.person_id, before.is_person_id) == (chosen, open_now[chosen]):
        return before
    replaces = before is not None or now_ns - ended_ns < TO_READ_NS
    return IdentityQuestion(chosen, open_now[chosen], now_ns + TO_READ_NS if replaces else 0)


class PendingIdentityQuestion(QObject):
    """Updates ``state.asked_person`` from the people present."""

    def __init__(self, state: LiveState, parent: QObject) -> None:
        super().__init__(parent)
        self._state = state
        self._ended_ns = -TO_READ_NS
        state.persons.changed.connect(self._refresh)
        state.selected_person.changed.connect(self._refresh)
        self._refresh()

    def _refresh(self, _value: object = None) -> None:
        state, now_ns = self._state, self._state.present.now_ns()
        before: IdentityQuestion | None = state.asked_person.value
        question = next_asked(
            state.persons.value, before, selected=state.selected_person.value, now_ns=now_ns, ended_ns=self._ended_ns
        )
        if before is not None and question is None:
            self._ended_ns = now_ns
        state.asked_person.set(question)
