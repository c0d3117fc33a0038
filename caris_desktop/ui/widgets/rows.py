"""Rows of lists by key, as items of a model or as widgets; delegate and table view for painted rows."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Generic, TypeVar

from PySide6.QtCore import QModelIndex, QObject, QPersistentModelIndex, QRect, QRectF, Qt
from PySide6.QtGui import QFont, QFontMetrics, QPainter, QPen, QStandardItem, QStandardItemModel
from PySide6.QtWidgets import (
    QAbstractItemView,
    QBoxLayout,
    QFrame,
    QHeaderView,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QTableView,
    QWidget,
)

from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.theme import Theme

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

    def remove_first(self) -> None:
        del self.values[0]
        self.removeRow(0)

    def _set(self, item: QStandardItem, value: Shown) -> None:
        item.setData(value, VALUE_ROLE)
        self._fill(item, value)

    def fill_again(self) -> None:
        """Set all texts again, because something else that they contain has changed."""
        for row, value in enumerate(self.values):
            self._fill(self.item(row), value)


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
        layouts.discard(row)
    for place, row in enumerate(rows.values()):
        if column.indexOf(row) != place:
            column.removeWidget(row)
            column.insertWidget(place, row)
        row.show()  # shown now, so that it can be focused
    return list(before.values())


Index = QModelIndex | QPersistentModelIndex
_TAG_PX = 17


class RowDelegate(QStyledItemDelegate):
    """Paints a row by ``paint_row`` with the colours of the theme."""

    def __init__(self, theme: Theme, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._theme = theme

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: Index) -> None:
        painter.save()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        self.paint_row(painter, option.rect, index)
        painter.restore()

    def paint_row(self, painter: QPainter, rect: QRect, index: Index) -> None:
        """Paint one row into ``rect``."""
        raise NotImplementedError

    def paint_text(self, painter: QPainter, rect: QRect, text: str, font: QFont, ink: str) -> int:
        """Paint text at the left, elided to ``rect``; returns its width in px."""
        metrics = QFontMetrics(font)
        shown = metrics.elidedText(text, Qt.TextElideMode.ElideRight, max(0, rect.width()))
        painter.setFont(font)
        painter.setPen(self._theme.color(ink))
        painter.drawText(rect, int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter), shown)
        return metrics.horizontalAdvance(shown)

    def paint_tags(self, painter: QPainter, rect: QRect, tags: Iterable[str]) -> None:
        """Paint the tags that fit into ``rect``, each in a box."""
        font = self._theme.font(tokens.STATUS_PX)
        left, top = rect.left(), rect.top() + (rect.height() - _TAG_PX) / 2
        for tag in tags:
            width = QFontMetrics(font).horizontalAdvance(tag) + 12
            if left + width > rect.left() + rect.width():
                break
            painter.setPen(QPen(self._theme.color("line_strong"), 1))
            painter.setBrush(Qt.BrushStyle.NoBrush)
            painter.drawRoundedRect(QRectF(left + 0.5, top, width, _TAG_PX), 5, 5)
            self.paint_text(painter, QRect(left + 6, rect.top(), width, rect.height()), tag, font, "dim")
            left += width + 6


def set_up_list(view: QAbstractItemView) -> None:
    """Set up a read-only list. A click does not take the focus, so that it interrupts neither typing nor driving."""
    view.setFrameShape(QFrame.Shape.NoFrame)
    view.setFocusPolicy(Qt.FocusPolicy.TabFocus)
    view.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
    view.setVerticalScrollMode(QAbstractItemView.ScrollMode.ScrollPerPixel)
    view.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)


class FastTableView(QTableView):
    """Displays a list model in rows of equal height.

    Not a QListView, which queries every row on each insertion, even with uniform item sizes.
    """

    def __init__(self, *, row_px: int) -> None:
        super().__init__()
        set_up_list(self)
        self.setShowGrid(False)
        self.setTabKeyNavigation(False)
        self.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.setWordWrap(False)
        self.horizontalHeader().hide()
        self.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
        rows = self.verticalHeader()
        rows.hide()
        rows.setMinimumSectionSize(row_px)
        rows.setDefaultSectionSize(row_px)
        rows.setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
