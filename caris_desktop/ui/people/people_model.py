"""Model of the People panel. Notifies the view only of visible changes."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from PySide6.QtCore import QAbstractListModel, QModelIndex, QObject, QPersistentModelIndex, Qt, Signal

from caris_desktop.domain.translation import tr
from caris_desktop.live.state import PresentClock
from caris_desktop.people.presence import PersonRow
from caris_desktop.ui import text_formatting
from caris_desktop.ui.people.shown_people import UNCONFIRMED, captions, in_order, presence_of, what_is_seen

PERSON_ROLE = int(Qt.ItemDataRole.UserRole)
_MANY = 20
"""Number of inserted or removed rows from which the model is reset, as on a search."""

Index = QModelIndex | QPersistentModelIndex


class PeopleModel(QAbstractListModel):
    """Persons in row order: present, former, known."""

    arranged = Signal()  # rows inserted, removed or moved

    def __init__(self, present: PresentClock, parent: QObject) -> None:
        super().__init__(parent)
        self._present = present
        self._camera = ""
        self._persons: list[PersonRow] = []
        self._shown_states: list[tuple[object, ...]] = []
        self._row_of: dict[str, int] = {}
        self._known: frozenset[str] = frozenset()
        self._captions: dict[int, str] = {}
        self._unconfirmed: frozenset[str] = frozenset()

    @property
    def persons(self) -> Sequence[PersonRow]:
        return self._persons

    @property
    def captions(self) -> dict[int, str]:
        """Captions above the first row of each group."""
        return self._captions

    def row_of(self, person_id: str) -> int | None:
        """Row of this person; None if there is none."""
        return self._row_of.get(person_id)

    def knows(self, person_id: str) -> bool:
        """Whether this person can still be named."""
        return person_id in self._known

    def show_unconfirmed(self, person_ids: frozenset[str]) -> None:
        """Mark people whose identity has not been confirmed since a crash."""
        if person_ids != self._unconfirmed:
            self._unconfirmed = person_ids
            self.refresh_ages()

    def is_unconfirmed(self, person_id: str) -> bool:
        return person_id in self._unconfirmed

    def show_persons(
        self, persons: Sequence[PersonRow], *, known: frozenset[str], held_rows: int = 0, camera: str = ""
    ) -> None:
        """Set the persons. The first ``held_rows`` stay in place, even for people who left. ``known``: ids that can be
        named; ``camera``: the one on display.
        """
        self._known, self._camera = known, camera
        held_rows = min(held_rows, len(self._persons))
        ordered = self._in_place(persons, held_rows)
        if [person.person_id for person in ordered] != [person.person_id for person in self._persons]:
            self._arrange(ordered)
            self._persons = ordered
            self._row_of = {person.person_id: row for row, person in enumerate(ordered)}
            self._caption(held_rows)
            self.arranged.emit()
        else:
            self._persons = ordered
            self._caption(held_rows)
        self.refresh_ages()

    def _caption(self, held_rows: int) -> None:
        """Captions of held rows stay too."""
        stay = {row: text for row, text in self._captions.items() if row < held_rows}
        now = stay | {row: text for row, text in captions(self._persons).items() if row >= held_rows}
        if now != self._captions:
            self._captions = now
            self.arranged.emit()

    def _in_place(self, persons: Sequence[PersonRow], held_rows: int) -> list[PersonRow]:
        newest = {person.person_id: person for person in persons}
        held = [newest.pop(row.person_id, replace(row, here=False)) for row in self._persons[:held_rows]]
        return held + in_order(newest.values())

    def _arrange(self, ordered: Sequence[PersonRow]) -> None:
        """Remove, move and insert rows individually, so that the others persist."""
        root, ids = QModelIndex(), {person.person_id for person in ordered}
        there = {person.person_id for person in self._persons}
        if len(there ^ ids) > _MANY:
            self.beginResetModel()
            self._persons, self._shown_states = list(ordered), [()] * len(ordered)
            self.endResetModel()
            return
        for row in reversed(range(len(self._persons))):
            if self._persons[row].person_id not in ids:
                self.beginRemoveRows(root, row, row)
                del self._persons[row], self._shown_states[row]
                self.endRemoveRows()
        for place, person in enumerate(ordered):
            if person.person_id not in there:
                self.beginInsertRows(root, place, place)
                self._persons.insert(place, person)
                self._shown_states.insert(place, ())
                self.endInsertRows()
            elif self._persons[place].person_id != person.person_id:
                came_from = next(
                    row for row in range(place, len(self._persons)) if self._persons[row].person_id == person.person_id
                )
                if self.beginMoveRows(root, came_from, came_from, root, place):
                    self._persons.insert(place, self._persons.pop(came_from))
                    self._shown_states.insert(place, self._shown_states.pop(came_from))
                    self.endMoveRows()

    def refresh_ages(self) -> None:
        """Refresh ages; only rows with changed text are repainted."""
        now_ns = self._present.now_ns()
        for row, person in enumerate(self._persons):
            # Rows of known people have no age: five hundred cost nothing per second.
            if presence_of(person) == "known":
                state: tuple[object, ...] = (
                    person,
                    self.knows(person.person_id),
                    self.is_unconfirmed(person.person_id),
                )
            else:
                state = (
                    _without_time(person),
                    *what_is_seen(person, now_ns, camera_on_show=self._camera),
                    self.knows(person.person_id),
                    self.is_unconfirmed(person.person_id),
                )
            if state != self._shown_states[row]:
                self._shown_states[row] = state
                self.dataChanged.emit(self.index(row), self.index(row))

    def seen(self, person: PersonRow) -> str:
        """Second line of the row."""
        parts = what_is_seen(person, self._present.now_ns(), camera_on_show=self._camera)
        return " · ".join([tr(UNCONFIRMED), *parts] if self.is_unconfirmed(person.person_id) else parts)

    def rowCount(self, parent: Index = QModelIndex()) -> int:  # noqa: B008 (Qt's own default)
        return 0 if parent.isValid() else len(self._persons)

    def data(self, index: Index, role: int = int(Qt.ItemDataRole.DisplayRole)) -> Any:
        person = self._persons[index.row()]
        if role == Qt.ItemDataRole.DisplayRole:
            return text_formatting.person_name(person)
        if role == Qt.ItemDataRole.AccessibleTextRole:
            parts = (
                text_formatting.person_name(person),
                text_formatting.maybe(person),
                person.group,
                *person.tags,
                self.seen(person),
            )
            return ", ".join(filter(None, parts))
        return person if role == PERSON_ROLE else None


def _without_time(person: PersonRow) -> PersonRow:
    """The row without values that change continually: last detection and exact position."""
    return replace(person, last_seen_ns=0, distance_m=None, bearing_rad=None)
