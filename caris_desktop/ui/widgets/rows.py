"""Rows of lists by key, as items of a model or as widgets; sorted tables; delegate and view for painted rows."""

from collections.abc import Callable, Hashable, Iterable, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

from PySide6.QtCore import QAbstractTableModel, QModelIndex, QObject, QPersistentModelIndex, QRect, QRectF, Qt
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

from caris_desktop.domain.translation import tr
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


class Column(NamedTuple):
    """Column of a table. ``key``: by which it is sorted; ``right``: aligned there, as numbers are."""

    title: str
    text: Callable[[Any], str]
    key: Callable[[Any], Any]
    width_px: int
    right: bool = False
    tip: str = ""


class ColumnModel(QAbstractTableModel, Generic[Shown]):
    """Values as rows with ``columns``, sorted by one of them."""

    def __init__(self, columns: Sequence[Column], parent: QObject) -> None:
        super().__init__(parent)
        self._columns = columns
        self._sorted_by, self._order = 0, Qt.SortOrder.AscendingOrder
        self.rows: list[Shown] = []

    def show_rows(self, rows: Iterable[Shown]) -> None:
        self.beginResetModel()
        self.set_rows(rows)
        self.endResetModel()

    def set_rows(self, rows: Iterable[Shown]) -> None:
        """Set and sort the values. The caller reports the change."""
        key, descending = self._columns[self._sorted_by].key, self._order == Qt.SortOrder.DescendingOrder
        self.rows = sorted(rows, key=key, reverse=descending)

    def sort(self, column: int, order: Qt.SortOrder = Qt.SortOrder.AscendingOrder) -> None:
        self.layoutAboutToBeChanged.emit()
        before = self.persistentIndexList()
        values = [(self.rows[index.row()], index.column()) for index in before]
        self._sorted_by, self._order = column, order
        self.set_rows(self.rows)
        places = {id(value): row for row, value in enumerate(self.rows)}
        self.changePersistentIndexList(before, [self.index(places[id(value)], at) for value, at in values])
        self.layoutChanged.emit()

    def rowCount(self, parent: Index = QModelIndex()) -> int:  # noqa: B008 (Qt's own default)
        return 0 if parent.isValid() else len(self.rows)

    def columnCount(self, parent: Index = QModelIndex()) -> int:  # noqa: B008 (Qt's own default)
        return 0 if parent.isValid() else len(self._columns)

    def headerData(self, section: int, orientation: Qt.Orientation, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        if orientation != Qt.Orientation.Horizontal:
            return None
        match role:
            case Qt.ItemDataRole.DisplayRole:
                return tr(self._columns[section].title)
            case Qt.ItemDataRole.ToolTipRole:
                return tr(self._columns[section].tip)
        return self._alignment(section, role)

    def data(self, index: Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        if role == Qt.ItemDataRole.DisplayRole:
            return self._columns[index.column()].text(self.rows[index.row()])
        return self._alignment(index.column(), role)

    def _alignment(self, column: int, role: int) -> int | None:
        if role != Qt.ItemDataRole.TextAlignmentRole:
            return None
        side = Qt.AlignmentFlag.AlignRight if self._columns[column].right else Qt.AlignmentFlag.AlignLeft
        return int(side | Qt.AlignmentFlag.AlignVCenter)


def set_up_table(view: QTableView, *, row_px: int) -> None:
    """Set up a read-only table with rows of equal height, which Tab leaves."""
    view.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
    view.setVerticalScrollMode(QAbstractItemView.ScrollMode.ScrollPerPixel)
    view.setHorizontalScrollMode(QAbstractItemView.ScrollMode.ScrollPerPixel)
    view.setShowGrid(False)
    view.setWordWrap(False)
    view.setTabKeyNavigation(False)
    view.horizontalHeader().setHighlightSections(False)
    view.horizontalHeader().setStretchLastSection(True)
    rows = view.verticalHeader()
    rows.hide()
    rows.setMinimumSectionSize(row_px)
    rows.setDefaultSectionSize(row_px)
    rows.setSectionResizeMode(QHeaderView.ResizeMode.Fixed)  # Qt need not measure hundreds of rows


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
        set_up_table(self, row_px=row_px)
        self.setSelectionMode(QAbstractItemView.SelectionMode.NoSelection)
        self.horizontalHeader().hide()
        self.horizontalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Stretch)
