"""Known people of the study, in memory and written through to the database if there is one."""

import logging
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, time, timedelta
from typing import TypeVar

from caris_desktop.domain.actor import Actor
from caris_desktop.domain.events import ConsentKind, Event, Problem
from caris_desktop.domain.translation import tr
from caris_desktop.people.identities import Identities
from caris_desktop.people.people_store import (
    About,
    Consent,
    HistoryEntry,
    HistoryKind,
    PeopleStore,
    PeopleStoreError,
    StoredEmbeddings,
    StoredPerson,
    new_person_id,
)

_log = logging.getLogger(__name__)
_T = TypeVar("_T")
_NOBODY_KNOWN = About()
_SUMMARY_CHARACTERS = 300
_MAX_HISTORY = 50

Undo = Callable[[], None]


class KnownPeople:
    """For one thread. If the database fails, the error is reported once and the data stays in memory.

    ``now`` is this computer's local time.
    """

    def __init__(self, store: PeopleStore | None = None, *, now: Callable[[], datetime] = datetime.now) -> None:
        self.store = store
        self.identities = Identities()
        self.session = ""  # folder of the current session
        self._now = now
        self._abouts: dict[str, About] = {}
        self._roots: dict[str, str] = {}
        self._consents: dict[str, dict[ConsentKind, Consent]] = {}
        self._consents_count_from_utc_ns = 0
        self._rejections: set[tuple[str, str]] = set()
        self._last_seen_utc_ns: dict[str, int] = {}
        self._problem: str = ""
        self._problem_reported = False
        self._day = self.today()
        if store is not None:
            self._load(store)

    def _load(self, store: PeopleStore) -> None:
        try:
            store.expire(day_began_utc_ns=self._midnight_utc_ns())
            everybody = store.everybody()
            consents, rejections, embeddings = store.consents(), store.rejections(), store.embeddings()
        except PeopleStoreError as error:
            self._problem = str(error)
            return
        self._consents = consents
        self._rejections = set(rejections)
        for person in everybody:
            self._take_in(person)
        for each in embeddings:
            self.identities.remember(each.person_id, each.kind, each.model, each.vectors)
        for person_id, root in self._roots.items():
            self.identities.link(person_id, root)
        for person_id in self._abouts:
            self.identities.settle(person_id, lasting=True)

    def _take_in(self, person: StoredPerson) -> None:
        if person.is_person_id:
            self._roots[person.person_id] = person.is_person_id
        elif person.about != _NOBODY_KNOWN:
            self._abouts[person.person_id] = person.about
        root = person.is_person_id or person.person_id
        self._last_seen_utc_ns[root] = max(person.last_seen_utc_ns, self._last_seen_utc_ns.get(root, 0))

    # Time

    def today(self) -> str:
        return self._now().date().isoformat()

    def utc_now_ns(self) -> int:
        return round(self._now().timestamp() * 1e9)

    def _midnight_utc_ns(self, *, days_later: int = 0) -> int:
        """Beginning of this day, or of a later one."""
        return round(datetime.combine(self._now().date() + timedelta(days_later), time.min).timestamp() * 1e9)

    def turn_day(self) -> bool:
        """True after midnight, when clothing embeddings expire."""
        if self.today() == self._day:
            return False
        self._day = self.today()
        self.identities.drop("clothing")
        self._write(lambda store: store.expire(day_began_utc_ns=self._midnight_utc_ns()))
        return True

    # Ids

    def add(self) -> str:
        """Id of a new person."""
        if self.store is not None:
            try:
                return self.store.add().person_id
            except PeopleStoreError as error:
                self._report(error)
        return new_person_id()

    def root_of(self, person_id: str) -> str:
        return self._roots.get(person_id, person_id)

    def ids_of(self, person_id: str) -> tuple[str, ...]:
        root = self.root_of(person_id)
        return (root, *(each for each, its_root in self._roots.items() if its_root == root))

    def about(self, person_id: str) -> About:
        return self._abouts.get(self.root_of(person_id), _NOBODY_KNOWN)

    def is_known(self, person_id: str) -> bool:
        """True if the wizard noted anything about them."""
        return self.root_of(person_id) in self._abouts

    def everybody(self) -> list[tuple[str, About]]:
        """Main ids of all known people with the notes on them, most recently seen first."""
        return sorted(self._abouts.items(), key=lambda known: -self._last_seen_utc_ns.get(known[0], 0))

    def namesakes(self, person_id: str, name: str) -> bool:
        """True if another person has that name."""
        root = self.root_of(person_id)
        return bool(name) and any(each != root and about.name == name for each, about in self._abouts.items())

    def describe(self, person_id: str, about: About) -> Undo:
        """Replace the notes on a person; return the undo function."""
        root, before = self.root_of(person_id), self.about(person_id)
        self._describe(root, about)
        return lambda: self._describe(root, before)

    def _describe(self, root: str, about: About) -> None:
        if about == _NOBODY_KNOWN:
            self._abouts.pop(root, None)
        else:
            self._abouts[root] = about
            self.identities.settle(root, lasting=True)
        self._write(lambda store: store.describe(root, about))

    def link(self, person_id: str, root: str) -> Undo:
        """Link an id and its linked ids to ``root``, or unlink it if empty; return the undo function."""
        before = {each: self._roots.get(each, "") for each in self.ids_of(person_id) if root} | {
            person_id: self._roots.get(person_id, "")
        }
        self._link(person_id, root)

        def back() -> None:
            for each, its_root in before.items():
                self._link(each, its_root)

        return back

    def _link(self, person_id: str, root: str) -> None:
        if root:
            for each in [each for each, its_root in self._roots.items() if its_root == person_id]:
                self._roots[each] = root
            self._roots[person_id] = root
        else:
            self._roots.pop(person_id, None)
        self.identities.link(person_id, root)
        self._write(lambda store: store.link(person_id, root))

    # Consents and rejections

    def ask_consents_again(self, again: bool) -> None:
        """While ``again``, consents noted before do not count."""
        if again != self.asks_consents_again:
            self._consents_count_from_utc_ns = self.utc_now_ns() if again else 0

    @property
    def asks_consents_again(self) -> bool:
        return self._consents_count_from_utc_ns > 0

    def consents(self, person_id: str) -> tuple[ConsentKind, ...]:
        """Valid consents of the person."""
        held, from_utc_ns = self._consents.get(self.root_of(person_id), {}), self._consents_count_from_utc_ns
        return tuple(kind for kind, noted in held.items() if noted.given and noted.noted_utc_ns >= from_utc_ns)

    def note_consent(self, person_id: str, kind: ConsentKind, *, given: bool, actor: Actor = "") -> Undo:
        root = self.root_of(person_id)
        before = kind in self.consents(root)
        self._note_consent(root, kind, given, actor)
        return lambda: self._note_consent(root, kind, before, actor)

    def _note_consent(self, root: str, kind: ConsentKind, given: bool, actor: Actor) -> None:
        consent = Consent(kind, given, self.utc_now_ns(), actor)
        self._consents.setdefault(root, {})[kind] = consent
        self._write(lambda store: store.note_consent(root, kind, given=given, actor=actor))
        if kind == "face" and not given:
            self.drop_faces(root)

    def drop_faces(self, person_id: str) -> None:
        ids = self.ids_of(person_id)
        self.identities.drop("face", ids)
        for each in ids:
            self._write(lambda store, each=each: store.drop_embeddings(each, "face"))  # type: ignore[misc]

    def reject(self, person_id: str, is_not_person_id: str, actor: Actor = "") -> Undo:
        pair = (person_id, self.root_of(is_not_person_id))
        if pair in self._rejections:
            return lambda: None
        self._rejections.add(pair)
        self._write(lambda store: store.reject(*pair, actor))

        def back() -> None:
            self._rejections.discard(pair)
            self._write(lambda store: store.take_back_rejection(*pair))

        return back

    def rejected_for(self, person_id: str) -> set[str]:
        """People that the visit, or the person in any visit, was rejected for."""
        ids = set(self.ids_of(person_id)) | {person_id}
        return {self.root_of(other) for each, other in self._rejections if each in ids}

    def confused(self) -> set[frozenset[str]]:
        """Pairs of people who were mixed up before."""
        return {frozenset((self.root_of(each), self.root_of(other))) for each, other in self._rejections}

    # Storage

    def store_embeddings(self, person_id: str) -> None:
        """Store the visit's embeddings: clothing until midnight, faces with consent."""
        may_keep_face = "face" in self.consents(person_id)
        for (kind, model), vectors in self.identities.views_of(person_id).items():
            if kind == "face" and not may_keep_face:
                self.identities.drop("face", [person_id])
                continue
            stored = StoredEmbeddings(person_id, kind, model, self._day if kind == "clothing" else "", vectors)
            expires_utc_ns = self._midnight_utc_ns(days_later=1) if kind == "clothing" else None
            self._write(
                lambda store, stored=stored, expires=expires_utc_ns: store.store_embeddings(
                    stored, expires_utc_ns=expires
                )  # type: ignore[misc]
            )

    def store_portrait(self, person_id: str, jpeg: bytes, quality: float) -> None:
        self._write(lambda store: store.store_portrait(person_id, jpeg, quality))

    def portrait(self, person_id: str) -> bytes | None:
        return self._read(lambda store: store.portrait(person_id), None)

    def note_visit(self, person_id: str, *, from_utc_ns: int, to_utc_ns: int) -> None:
        root = self.root_of(person_id)
        self._last_seen_utc_ns[root] = to_utc_ns
        self._write(
            lambda store: store.note_visit(
                person_id, from_utc_ns=from_utc_ns, to_utc_ns=to_utc_ns, session=self.session
            )
        )

    def add_history(self, person_id: str, kind: HistoryKind, text: str) -> None:
        self._write(
            lambda store: store.add_history(person_id, kind, text, utc_ns=self.utc_now_ns(), session=self.session)
        )

    def add_note(self, person_id: str, text: str) -> Undo:
        """Add a note, which stays in the history after a newer one replaces it."""
        self.add_history(person_id, "note", text)
        return lambda: self.take_back_history(person_id, "note", text)

    def take_back_history(self, person_id: str, kind: HistoryKind, text: str) -> None:
        self._write(lambda store: store.take_back_history(person_id, kind, text))

    def history(self, person_id: str, text: str = "") -> tuple[HistoryEntry, ...]:
        """History of a person over all sessions, newest first, filtered by all words of ``text``."""
        return self._read(lambda store: store.history(person_id, text), ())

    def summary(self, person_id: str) -> str:
        """Short summary of earlier visits; empty for a new person."""
        nothing: tuple[HistoryEntry, ...] = ()
        visits = self._read(lambda store: store.visits(person_id), nothing)
        lately = self._read(lambda store: store.history(person_id, at_most=_MAX_HISTORY), nothing)
        words = [entry.text for entry in lately if entry.kind in ("said", "heard")]
        parts = []
        if visits:
            last = datetime.fromtimestamp(visits[0].utc_ns / 1e9).strftime("%d %B, %H:%M").lstrip("0")
            times = "once" if len(visits) == 1 else f"{len(visits)} times"
            parts.append(f"was here {times} before, last on {last}")
        if words:
            parts.append(f"last words: “{words[0]}”")
        return "; ".join(parts)[:_SUMMARY_CHARACTERS]

    def forget(self, person_id: str) -> tuple[str, ...]:
        """Erase a person here and in the database; return all of their ids. Raises PeopleStoreError."""
        ids = self.ids_of(person_id)
        if self.store is not None:
            ids = tuple(dict.fromkeys((*ids, *self.store.forget(ids[0]))))
        self.identities.forget(ids)
        for each in ids:
            for held in (self._abouts, self._roots, self._consents, self._last_seen_utc_ns):
                held.pop(each, None)
        self._rejections = {pair for pair in self._rejections if not set(pair) & set(ids)}
        return ids

    def drop_visit(self, person_id: str) -> None:
        """Drop the data of an old visit."""
        self.identities.drop_visit(person_id)
        if person_id not in self._abouts and person_id not in self._roots:
            self._last_seen_utc_ns.pop(person_id, None)
            self._rejections = {pair for pair in self._rejections if pair[0] != person_id}

    def close(self) -> None:
        if self.store is not None:
            self.store.close()

    # Problems

    def problems(self, now_ns: int) -> list[Event]:
        """Database problems, reported once."""
        if not self._problem or self._problem_reported:
            return []
        self._problem_reported = True
        return [
            Problem(
                now_ns,
                "error",
                tr(self._problem),
                tr("People are still tracked, but their names are stored for this session only."),
                tr("Before the next session, choose another study folder or repair this one."),
            )
        ]

    def _read(self, read: Callable[[PeopleStore], _T], otherwise: _T) -> _T:
        if self.store is None:
            return otherwise
        try:
            return read(self.store)
        except PeopleStoreError as error:
            self._report(error)
            return otherwise

    def _write(self, write: Callable[[PeopleStore], None]) -> None:
        if self.store is None:
            return
        try:
            write(self.store)
        except PeopleStoreError as error:
            self._report(error)
        except KeyError:
            # Added while the database was not writable, or erased meanwhile: known in this session only.
            _log.warning("a person of this session is not in %s", self.store.path)

    def _report(self, error: PeopleStoreError) -> None:
        self._problem = self._problem or str(error)


def merged(about: About, other: About) -> About:
    """Merge data of two ids of one person; the first one's values win."""
    return replace(
        about,
        name=about.name or other.name,
        group=about.group or other.group,
        tags=tuple(dict.fromkeys((*about.tags, *other.tags))),
        note="\n".join(dict.fromkeys(filter(None, (about.note, other.note)))),
    )
