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
from caris_desktop.ui.wrapped_tip import wrapped_tip

PERSON_ROLE = int(Qt.ItemDataRole.UserRole)
_MANY = 20
"""Number of inserted or removed rows from which the model is reset, as on a search."""

Index = QModelIndex | QPersistentModelIndex


class PeopleModel(QAbstractListModel):
    """Persons in row order: present, former, known. ``captions`` are above the first row of a group.

    Decisions need ``may_decide``: not without naming permission, and not in a replay.
    """

    changed = Signal()  # after all signals about single rows

    def __init__(self, present: PresentClock, parent: QObject) -> None:
        super().__init__(parent)
        self._present = present
        self._camera = ""
        self._known: frozenset[str] = frozenset()
        self._unconfirmed: frozenset[str] = frozenset()
        self._shown_states: dict[str, tuple[object, ...]] = {}
        self.persons: list[PersonRow] = []
        self.captions: dict[int, str] = {}
        self.may_decide = False

    def row_of(self, person_id: str) -> int | None:
        """Row of this person; None if there is none."""
        return next((row for row, person in enumerate(self.persons) if person.person_id == person_id), None)

    def knows(self, person_id: str) -> bool:
        """Whether this person can still be named."""
        return person_id in self._known

    def is_unconfirmed(self, person_id: str) -> bool:
        """Whether their identity has not been confirmed since a crash."""
        return person_id in self._unconfirmed

    def show_unconfirmed(self, person_ids: frozenset[str]) -> None:
        if person_ids != self._unconfirmed:
            self._unconfirmed = person_ids
            self.refresh_ages()
            self.changed.emit()

    def show_persons(
        self, persons: Sequence[PersonRow], *, known: frozenset[str], held_rows: int = 0, camera: str = ""
    ) -> None:
        """Set the persons. The first ``held_rows`` stay in place, even for people who left, and their captions too.
        ``known``: ids that can be named; ``camera``: the one on display.
        """
        self._known, self._camera = known, camera
        newest = {person.person_id: person for person in persons}
        held = [newest.pop(row.person_id, replace(row, here=False)) for row in self.persons[:held_rows]]
        ordered = held + in_order(newest.values())
        self._arrange(ordered, may_reset=not held)
        self.persons = ordered
        stay = {row: text for row, text in self.captions.items() if row < len(held)}
        self.captions = stay | {row: text for row, text in captions(ordered).items() if row >= len(held)}
        self.refresh_ages()
        self.changed.emit()

    def _arrange(self, ordered: list[PersonRow], *, may_reset: bool) -> None:
        """Remove, move and insert rows individually, so that the others persist, with the name field in one of them."""
        root, ids = QModelIndex(), {person.person_id for person in ordered}
        if may_reset and len({person.person_id for person in self.persons} ^ ids) > _MANY:
            self.beginResetModel()
            self.persons = ordered
            self.endResetModel()
            return
        for row in reversed(range(len(self.persons))):
            if self.persons[row].person_id not in ids:
                self.beginRemoveRows(root, row, row)
                del self.persons[row]
                self.endRemoveRows()
        for place, person in enumerate(ordered):
            rows = range(place, len(self.persons))
            came_from = next((row for row in rows if self.persons[row].person_id == person.person_id), None)
            if came_from is None:
                self.beginInsertRows(root, place, place)
                self.persons.insert(place, person)
                self.endInsertRows()
            elif came_from != place and self.beginMoveRows(root, came_from, came_from, root, place):
                self.persons.insert(place, self.persons.pop(came_from))
                self.endMoveRows()

    def refresh_ages(self) -> None:
        """Refresh ages; only rows with changed text are repainted."""
        shown, self._shown_states = self._shown_states, {}
        for row, person in enumerate(self.persons):
            # Five hundred known people, whose rows have no age, cost nothing per second. The rest change continually.
            known = presence_of(person) == "known"
            lasting = person if known else replace(person, last_seen_ns=0, distance_m=None, bearing_rad=None)
            state = (lasting, self.knows(person.person_id), self.seen(person))
            self._shown_states[person.person_id] = state
            if state != shown.get(person.person_id):
                self.dataChanged.emit(self.index(row), self.index(row))

    def seen(self, person: PersonRow) -> str:
        """Second line of the row."""
        parts = what_is_seen(person, self._present.now_ns(), camera_on_show=self._camera)
        return " · ".join([tr(UNCONFIRMED), *parts] if self.is_unconfirmed(person.person_id) else parts)

    def rowCount(self, parent: Index = QModelIndex()) -> int:  # noqa: B008 (Qt's own default)
        return 0 if parent.isValid() else len(self.persons)

    def flags(self, index: Index) -> Qt.ItemFlag:
        editable = self.may_decide and self.knows(self.persons[index.row()].person_id)
        return super().flags(index) | (Qt.ItemFlag.ItemIsEditable if editable else Qt.ItemFlag.NoItemFlags)

    def data(self, index: Index, role: int = int(Qt.ItemDataRole.DisplayRole)) -> Any:
        person = self.persons[index.row()]
        if role == Qt.ItemDataRole.DisplayRole:
            return text_formatting.person_name(person)
        if role in (Qt.ItemDataRole.AccessibleTextRole, Qt.ItemDataRole.ToolTipRole):
            name, maybe = text_formatting.person_name(person), text_formatting.maybe(person)
            text = ", ".join(filter(None, (name, maybe, person.group, *person.tags, self.seen(person))))
            if role == Qt.ItemDataRole.AccessibleTextRole:
                return text
            hint = tr("{person}. Click to select this person.") if self.may_decide else "{person}"
            return wrapped_tip(hint.format(person=text))
        return person if role == PERSON_ROLE else None
