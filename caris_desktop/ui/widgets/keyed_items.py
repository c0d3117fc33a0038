"""Items of a list view by key: unchanged rows stay, with their selection, place and measured height."""

from collections.abc import Callable, Hashable, Sequence
from typing import Generic, TypeVar

from PySide6.QtCore import QObject, Qt
from PySide6.QtGui import QStandardItem, QStandardItemModel

VALUE_ROLE = int(Qt.ItemDataRole.UserRole)
Shown = TypeVar("Shown")


class KeyedItems(QStandardItemModel, Generic[Shown]):
    """List model of ``values``. ``key`` identifies a value; ``fill`` sets the texts of its item.

    Qt stores the texts: laying out thousands of rows calls no Python code.
    """

    def __init__(
        self, parent: QObject, key: Callable[[Shown], Hashable], fill: Callable[[QStandardItem, Shown], None]
    ) -> None:
        super().__init__(parent)
        self._key = key
        self._fill = fill
        self.values: list[Shown] = []

    def row_of(self, key: Hashable) -> int | None:
        """Row of this key, searched from the newest."""
        return next((row for row in reversed(range(len(self.values))) if self._key(self.values[row]) == key), None)

    def show_values(self, values: Sequence[Shown]) -> None:
        """Set the values, each with a key of its own."""
        both = zip(self.values, values, strict=False)
        changed = (row for row, (before, now) in enumerate(both) if before is not now)
        same = next(changed, min(len(self.values), len(values)))
        keys, before_keys = ({self._key(value) for value in rows[same:]} for rows in (values, self.values))
        for row in reversed(range(same, len(self.values))):
            if self._key(self.values[row]) not in keys:
                del self.values[row]
                self.removeRow(row)
        for row, value in enumerate(values[same:], start=same):
            key = self._key(value)
            if key not in before_keys:
                item = QStandardItem()
                item.setEditable(False)
                self._set(item, value)
                self.values.insert(row, value)
                self.insertRow(row, item)
                continue
            came_from = next(at for at in range(row, len(self.values)) if self._key(self.values[at]) == key)
            if came_from != row:
                self.values.insert(row, self.values.pop(came_from))
                self.insertRow(row, self.takeRow(came_from))
            before, self.values[row] = self.values[row], value
            if before != value:
                self._set(self.item(row), value)

    def _set(self, item: QStandardItem, value: Shown) -> None:
        item.setData(value, VALUE_ROLE)
        self._fill(item, value)

    def fill_again(self) -> None:
        """Set all texts again, because something else that they contain has changed."""
        for row, value in enumerate(self.values):
            self._fill(self.item(row), value)
