"""Decisions about people by the wizard or the console: each is an event and can be undone."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace

from caris_desktop.domain import intents
from caris_desktop.domain.actor import CONSOLE, Actor
from caris_desktop.domain.events import (
    ANSWER,
    ConsentNoted,
    Event,
    IdentifiedBy,
    PeopleDecision,
    PeopleMerged,
    PeopleUndone,
    PersonAppeared,
    PersonDescribed,
    PersonDetail,
    PersonForgotten,
    PersonIdentified,
    PersonLeft,
    PersonRejected,
    PersonRenamed,
    PersonSplit,
    Problem,
    Severity,
)
from caris_desktop.domain.translation import tr
from caris_desktop.domain.value_class import Value
from caris_desktop.people.identities import UNDECIDED
from caris_desktop.people.known import KnownPeople, Undo, merged
from caris_desktop.people.people_store import About, PeopleStoreError
from caris_desktop.people.visit_log import Portraits, Visit, VisitLog

MAX_NAME_LENGTH = 80
MAX_NOTE_LENGTH = 4000
MAX_TAGS = 20
MOST_UNDONE = 50

PeopleIntent = (
    intents.NamePerson
    | intents.ConfirmPerson
    | intents.RejectPerson
    | intents.SetPersonGroup
    | intents.TagPerson
    | intents.NotePerson
    | intents.MergePeople
    | intents.SplitPerson
    | intents.NoteConsent
    | intents.UndoPeople
    | intents.ForgetPerson
)


# Intents about visits, or about nobody; the others are about a person.
_OfVisits = intents.ConfirmPerson | intents.RejectPerson | intents.SplitPerson | intents.UndoPeople


class _Done(Value):
    """Decision with its undo function. ``concerns`` are all ids that it affects."""

    decision: PeopleDecision
    person_id: str
    is_person_id: str
    concerns: frozenset[str]
    take_back: Undo


class Decisions:
    """For one thread."""

    def __init__(self, known: KnownPeople, visits: VisitLog, portraits: Portraits) -> None:
        self._known = known
        self._visits = visits
        self._portraits = portraits
        self._done: deque[_Done] = deque(maxlen=MOST_UNDONE)

    def do(self, intent: PeopleIntent, now_ns: int) -> list[Event]:
        """Events of an intent; a Problem if it cannot be executed."""
        if not isinstance(intent, _OfVisits) and not self._exists(intent.person_id):
            return [_unknown(now_ns)]
        match intent:
            case intents.NamePerson(person_id=person_id, name=name):
                return self._name(person_id, _one_line(name), now_ns, intent.actor)
            case intents.SetPersonGroup(person_id=person_id, group=group):
                return self._describe(person_id, "group", {"group": _one_line(group)}, now_ns, intent.actor)
            case intents.TagPerson(person_id=person_id, tags=tags):
                cleaned = tuple(dict.fromkeys(filter(None, map(_one_line, tags))))[:MAX_TAGS]
                return self._describe(person_id, "tags", {"tags": cleaned}, now_ns, intent.actor)
            case intents.NotePerson(person_id=person_id, note=note):
                shortened = note.strip()[:MAX_NOTE_LENGTH]
                return self._describe(person_id, "note", {"note": shortened}, now_ns, intent.actor)
            case intents.ConfirmPerson(person_id=person_id, is_person_id=is_person_id):
                visit = self._visits.find(person_id)
                if visit is None or not self._exists(is_person_id):
                    return [_unknown(now_ns)]
                return self.identify(visit, is_person_id, now_ns, intent.actor)
            case intents.RejectPerson(person_id=person_id, is_person_id=is_person_id):
                return self._reject(person_id, is_person_id, now_ns, intent.actor)
            case intents.MergePeople(person_id=person_id, into_person_id=into_person_id):
                return self._merge(person_id, into_person_id, now_ns, intent.actor)
            case intents.SplitPerson(person_id=person_id, visit_id=visit_id):
                return self._split(person_id, visit_id, now_ns, intent.actor)
            case intents.NoteConsent():
                root = self._known.root_of(intent.person_id)
                back = self._known.note_consent(root, intent.kind, given=intent.given, actor=intent.actor)
                self._remember("consent", root, "", back)
                return [ConsentNoted(now_ns, root, intent.kind, intent.given, intent.actor)]
            case intents.UndoPeople():
                if not self._done:
                    return [
                        _answer(
                            now_ns,
                            "info",
                            tr("There is nothing to undo."),
                            tr("Nothing was changed."),
                            tr("Erasing a person is permanent."),
                        )
                    ]
                done = self._done.pop()
                done.take_back()
                return [PeopleUndone(now_ns, done.person_id, done.decision, done.is_person_id, intent.actor)]
            case intents.ForgetPerson(person_id=person_id):
                return self._forget(person_id, now_ns, intent.actor)

    def identify(
        self, visit: Visit, is_person_id: str, now_ns: int, actor: Actor = CONSOLE, *, both_here: bool = False
    ) -> list[Event]:
        """Assign the visit to ``is_person_id``.

        ``both_here``: two cameras see the person, so that two present visits are no conflict.
        """
        root = self._known.root_of(is_person_id)
        if root == visit.person_id:
            return []
        if root == visit.visit_id:
            return self._split(visit.visit_id, visit.visit_id, now_ns, actor)
        if not both_here and visit.here and any(other.here for other in self._visits.of_person(root)):
            return [_here_already(now_ns)]
        suggested = next((guess for guess in visit.judgement.guesses if guess.person_id == root), None)
        others = [guess for guess in visit.judgement.guesses if guess.person_id != root]
        runner_up = others[0].confidence if others else 0.0
        before, confidence = visit.person_id, 0.0 if suggested is None else suggested.confidence
        concerned = [visit] if visit.identified else self._visits.of_person(visit.visit_id)
        back = [self._given_to(each, root) for each in concerned] + [self._known.link(visit.visit_id, root)]
        # The console's confidence does not apply to a wizard's decision.
        visit.confidence = confidence if actor == CONSOLE else 0.0
        visit.summary = self._known.summary(root)
        if actor != CONSOLE:
            # Undoing a decision of the console rejects the match, else it would be made again.
            self._remember("identified", visit.visit_id, root, _all([*back[::-1], visit.leave_to_wizard]))
        self._known.store_embeddings(visit.visit_id)
        by: IdentifiedBy = "console" if actor == CONSOLE else "wizard"
        return [PersonIdentified(now_ns, before, root, by, round(confidence, 3), round(runner_up, 3), actor)]

    def begin_another(self, visit: Visit, now_ns: int) -> Visit:
        """Begin the visit of another person on the tracks of this one."""
        new_id = self._known.add()
        other = Visit(new_id, new_id, visit.camera, visit.track, now_ns, now_ns, self._known.utc_now_ns())
        for track in tuple(visit.tracks):
            self._visits.begin(other, track)
        return other

    def forget_decisions(self) -> None:
        """Clear the undo history."""
        self._done.clear()

    def __len__(self) -> int:
        return len(self._done)

    def _name(self, person_id: str, name: str, now_ns: int, actor: Actor) -> list[Event]:
        root = self._known.root_of(person_id)
        back = self._known.describe(root, replace(self._known.about(root), name=name))
        self._remember("named", root, "", back)
        self._store_known(root)
        events: list[Event] = [PersonRenamed(now_ns, root, actor)]
        if self._known.namesakes(root, name):
            events.append(
                _answer(
                    now_ns,
                    "info",
                    tr("Two people now have the same name."),
                    tr("They remain two people, each with their own data."),
                    tr("If they are one person, merge them in the People panel; otherwise rename one of them."),
                )
            )
        return events

    def _describe(
        self, person_id: str, detail: PersonDetail, changes: dict[str, object], now_ns: int, actor: Actor
    ) -> list[Event]:
        root = self._known.root_of(person_id)
        about: About = replace(self._known.about(root), **changes)  # type: ignore[arg-type]
        if about == self._known.about(root):
            return []
        back = [self._known.describe(root, about)]
        if detail == "note" and about.note:
            back.append(self._known.add_note(root, about.note))
        self._remember(detail, root, "", _all(back))
        self._store_known(root)
        return [PersonDescribed(now_ns, root, detail, actor)]

    def _reject(self, person_id: str, is_person_id: str, now_ns: int, actor: Actor) -> list[Event]:
        visit = self._visits.find(person_id)
        if visit is None:
            return [_unknown(now_ns)]
        root = self._known.root_of(is_person_id)
        if root == visit.visit_id:
            return [_unknown(now_ns)]
        back: list[Undo] = [self._known.reject(visit.visit_id, root, actor)]
        if visit.person_id == root:
            back.append(self._given_to(visit, visit.visit_id))
            back.append(self._known.link(visit.visit_id, ""))
            visit.summary, visit.confidence = "", 0.0
        visit.judgement, visit.suggested_id = UNDECIDED, ""
        self._remember("rejected", visit.visit_id, root, _all(back[::-1]))
        return [PersonRejected(now_ns, visit.visit_id, root, actor)]

    def _merge(self, person_id: str, into_person_id: str, now_ns: int, actor: Actor) -> list[Event]:
        if not self._exists(into_person_id):
            return [_unknown(now_ns)]
        root, into = self._known.root_of(person_id), self._known.root_of(into_person_id)
        if root == into:
            return []
        back = [self._given_to(visit, into) for visit in self._visits.of_person(root)]
        about = merged(self._known.about(into), self._known.about(root))
        back.append(self._known.link(root, into))
        if about != self._known.about(into):
            back.append(self._known.describe(into, about))
        self._remember("merged", root, into, _all(back[::-1]))
        return [PeopleMerged(now_ns, root, into, actor)]

    def _split(self, person_id: str, visit_id: str, now_ns: int, actor: Actor) -> list[Event]:
        visit = self._visits.find(visit_id or person_id)
        if visit is None:
            return [_unknown(now_ns)]
        root = visit.person_id
        if visit.identified:
            back = [self._given_to(visit, visit.visit_id), self._known.link(visit.visit_id, "")]
            visit.summary, visit.confidence = "", 0.0
            self._remember("split", visit.visit_id, root, _all(back[::-1]))
            return [PersonSplit(now_ns, visit.visit_id, root, actor)]
        if not visit.here:
            return [_unknown(now_ns)]
        # A different person is there now: the visit ends, and a new one begins on the same tracks.
        other = self.begin_another(visit, now_ns)
        visit.here = False

        def back_again() -> None:
            for track in tuple(other.tracks):
                self._visits.attach(visit, track)
            visit.here, other.here = visit.here or other.here, False
            visit.leave_to_wizard()
            self._visits.drop(other)

        self._remember("split", other.visit_id, root, back_again)
        number = self._visits.number_of(other.visit_id)
        return [
            PersonLeft(now_ns, root, visit.track),
            PersonSplit(now_ns, other.visit_id, root, actor),
            PersonAppeared(now_ns, other.visit_id, visit.track, number),
        ]

    def _forget(self, person_id: str, now_ns: int, actor: Actor) -> list[Event]:
        root = self._known.root_of(person_id)
        visits = [visit for visit in self._visits if self._known.root_of(visit.person_id) == root]
        try:
            ids = set(self._known.forget(root)) | {visit.visit_id for visit in visits}
        except PeopleStoreError as error:
            message = str(error)
            return [
                _answer(
                    now_ns,
                    "error",
                    tr(message),
                    tr("The person is not erased yet."),
                    tr("Try again when the problem is fixed."),
                )
            ]
        self._done = deque((done for done in self._done if not done.concerns & ids), maxlen=MOST_UNDONE)
        for each in ids:
            self._portraits.drop_all_of(each)
        events: list[Event] = [PersonForgotten(now_ns, root, actor)]
        for visit in visits:
            self._visits.drop(visit)
            if visit.here:
                # Still in view, as an unknown person.
                other = self.begin_another(visit, now_ns)
                other.forgotten = True
                number = self._visits.number_of(other.visit_id)
                events.append(PersonAppeared(now_ns, other.visit_id, visit.track, number))
        return events

    def _given_to(self, visit: Visit, person_id: str) -> Undo:
        before = (visit.person_id, visit.summary, visit.confidence)
        visit.person_id = person_id
        self._visits.number_of(person_id)

        def back() -> None:
            visit.person_id, visit.summary, visit.confidence = before

        return back

    def _store_known(self, person_id: str) -> None:
        """Persist the person's data now, appearance included, against a power failure."""
        for visit in self._visits.of_person(person_id):
            visit.settled = True
            self._known.store_embeddings(visit.visit_id)

    def _remember(self, decision: PeopleDecision, person_id: str, is_person_id: str, take_back: Undo) -> None:
        concerns = {*self._known.ids_of(person_id), *(self._known.ids_of(is_person_id) if is_person_id else ())}
        self._done.append(_Done(decision, person_id, is_person_id, frozenset(concerns), take_back))

    def _exists(self, person_id: str) -> bool:
        return (
            self._visits.find(person_id) is not None
            or self._known.is_known(person_id)
            or self._known.identities.knows(self._known.root_of(person_id))
        )


def _all(undos: list[Undo]) -> Callable[[], None]:
    def back() -> None:
        for undo in undos:
            undo()

    return back


def _one_line(text: str) -> str:
    return " ".join(text.split())[:MAX_NAME_LENGTH]


def _answer(now_ns: int, severity: Severity, what: str, meaning: str, advice: str) -> Problem:
    return Problem(now_ns, severity, what, meaning, advice, cause=ANSWER)


def _here_already(now_ns: int) -> Problem:
    return _answer(
        now_ns,
        "info",
        tr("That person is already here."),
        tr("The same person cannot be here twice, so nothing was changed."),
        tr("Reject the identity of the other person, or merge the two if they are one person."),
    )


def _unknown(now_ns: int) -> Problem:
    return _answer(
        now_ns,
        "warning",
        tr("That person is no longer known."),
        tr("The request was not carried out."),
        tr("Choose a person from the People panel."),
    )
