"""Erasure of a person from the people database, and the search terms for the study's files."""

import shutil
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import field
from datetime import UTC, datetime
from pathlib import Path

from caris_desktop.domain.failure import UserFacingError
from caris_desktop.domain.translation import QT_TR_NOOP, joined, localized
from caris_desktop.domain.value_class import Value
from caris_desktop.people.people_store import PeopleStore, PeopleStoreError, StoredPerson

_LEAST_FREE_BYTES = 1 << 20
_NOTHING_CHANGED = QT_TR_NOOP("No person was erased; nothing was changed.")


class PersonToForget(Value):
    """Person to erase: all of their ids, the main one first, with names and images."""

    person_ids: tuple[str, ...]
    names: tuple[str, ...]
    pictures: tuple[bytes, ...] = field(repr=False)


def find_person(database: Path, who: str) -> PersonToForget | None:
    """Look up a person by id or name; None if the study has none.

    Raises
    ------
    UserFacingError
        If several have this name, or the database cannot be read.
    """
    if not database.exists():
        return None
    with _opened(database, _NOTHING_CHANGED) as store:
        person_id = _id_of(store, who)
        if person_id is None:
            return None
        traces = store.traces_of(person_id)
        people = [store.get(each) for each in traces.person_ids]
        names = dict.fromkeys(person.name for person in people if person is not None and person.name)
        return PersonToForget(traces.person_ids, tuple(names), traces.blobs)


def erase(database: Path, person_ids: tuple[str, ...]) -> None:
    """Delete keys and rows of these ids. Idempotent. Raises UserFacingError."""
    if not database.exists():
        return
    with _opened(database, QT_TR_NOOP("The person is not yet erased from the study's database.")) as store:
        for number, person_id in enumerate(person_ids):
            # The first id includes all linked ids. Repeat it even if it was deleted: a kill may have left pages that
            # contain them.
            if number == 0 or store.get(person_id) is not None:
                store.forget(person_id)


def rewrite_texts(database: Path, rewrite: Callable[[str, str], str]) -> None:
    """Apply ``rewrite`` to all notes and history texts, given the owner's id and the text.

    Raises UserFacingError.
    """
    if not database.exists():
        return
    with _opened(database, QT_TR_NOOP("Data about other people may still name the person.")) as store:
        store.rewrite_texts(rewrite)


@contextmanager
def _opened(database: Path, meaning: str) -> Iterator[PeopleStore]:
    """Raises UserFacingError with this ``meaning`` if the database cannot be used."""
    try:
        with closing(PeopleStore(database)) as store:
            yield store
    except PeopleStoreError as error:
        # SQLite reports a full disk in many ways.
        full = shutil.disk_usage(database.parent).free < _LEAST_FREE_BYTES
        advice = QT_TR_NOOP("The disk is full: free some disk space, then try again.")
        raise UserFacingError(str(error), meaning, advice if full else QT_TR_NOOP("Then try again.")) from error


def _id_of(store: PeopleStore, who: str) -> str | None:
    if store.get(who) is not None:
        return who
    name = " ".join(who.split()).casefold()
    called = [
        person for person in store.everybody() if person.name and " ".join(person.name.split()).casefold() == name
    ]
    roots = {store.ids_of(person.person_id)[0]: person for person in called}
    if len(roots) > 1:
        raise UserFacingError(
            localized(QT_TR_NOOP("{count} people in this study are called {who}."), count=len(roots), who=who),
            _NOTHING_CHANGED,
            localized(
                QT_TR_NOOP("Specify one of them by id: {ids}."),
                ids=joined((_described(root, person) for root, person in roots.items()), "; "),
            ),
        )
    return next(iter(roots), None)


def _described(person_id: str, person: StoredPerson) -> str:
    seen_at = datetime.fromtimestamp(person.last_seen_utc_ns // 1_000_000_000, UTC).astimezone()
    return localized(QT_TR_NOOP("{id}, last seen {time}"), id=person_id, time=f"{seen_at:%Y-%m-%d %H:%M}")
