"""Row widgets in a layout by key: a row stays the same widget while its key is there."""

from collections.abc import Callable, Sequence
from typing import TypeVar

from PySide6.QtWidgets import QBoxLayout, QWidget

Row = TypeVar("Row", bound=QWidget)


def show_rows(column: QBoxLayout, rows: dict[str, Row], keys: Sequence[str], make: Callable[[str], Row]) -> list[Row]:
    """Show a row for each key at the top of ``column``, in this order, and update ``rows``.

    ``make`` creates a missing row. Returns the rows of former keys, which are deleted later.
    """
    before = dict(rows)
    rows.clear()
    rows.update({key: before.pop(key) if key in before else make(key) for key in keys})
    for row in before.values():
        column.removeWidget(row)
        row.hide()
        row.deleteLater()
    for place, row in enumerate(rows.values()):
        if column.indexOf(row) != place:
            column.removeWidget(row)
            column.insertWidget(place, row)
        row.show()  # shown now, so that it can be focused
    return list(before.values())
