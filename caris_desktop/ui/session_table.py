"""Session table: columns, cell texts and sort order."""

import re
from collections.abc import Callable, Sequence
from datetime import datetime
from operator import attrgetter
from pathlib import Path
from typing import Any

from PySide6.QtCore import QAbstractTableModel, QModelIndex, QPersistentModelIndex, Qt, Signal
from PySide6.QtGui import QFocusEvent, QKeyEvent
from PySide6.QtWidgets import QAbstractItemView, QHeaderView, QTableView, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.recording.studies.study_query import SessionEntry
from caris_desktop.ui import text_formatting
from caris_desktop.ui.icons import icon
from caris_desktop.ui.theme import Theme

_ROW_PX = 36


class Column(Value):
    """Column of the session table: title, cell text and sort key."""

    title: str
    text: Callable[[SessionEntry], str]
    key: Callable[[SessionEntry], Any]
    width_px: int
    right: bool = False


_PURPOSES = {"practice": QT_TR_NOOP("Practice")}


def local_time(started_utc: str) -> str:
    """Local time as 2026-11-21 14:02; anything else unchanged."""
    try:
        return f"{datetime.fromisoformat(started_utc).astimezone():%Y-%m-%d %H:%M}"
    except ValueError:
        return started_utc


def purpose_title(purpose: str) -> str:
    """Title of a session's purpose; an unknown purpose unchanged."""
    return tr(_PURPOSES[purpose]) if purpose in _PURPOSES else purpose


def state_words(entry: SessionEntry) -> str:
    """Completeness of the session, its purpose and problems."""
    complete = tr("Copy") if entry.copy_of else tr("Complete")
    lost = tr("Incomplete") if entry.losses else complete
    parts = [lost if entry.closed_properly else tr("Ended unexpectedly")]
    if entry.purpose:
        parts.insert(0, purpose_title(entry.purpose))
    if entry.problems:
        parts.append(tr("1 problem") if entry.problems == 1 else tr("%n problems", "", entry.problems))
    return " · ".join(parts)


def lacks_words(entry: SessionEntry) -> str:
    """Missing data of a session, and whether it is a copy; usually empty."""
    copy = (
        tr("This is a copy of {session} and is not counted again.").format(session=entry.copy_of)
        if entry.copy_of
        else ""
    )
    return " ".join((copy, *map(tr, entry.losses))).strip()


def natural_order(text: str) -> tuple[tuple[int, int, str], ...]:
    """Natural sort key: P7 before P12."""
    parts = re.findall(r"\d+|\D+", text.casefold())
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts)


def _doubtful(entry: SessionEntry) -> bool:
    return not entry.closed_properly or bool(entry.losses or entry.copy_of)


def _text_column(title: str, field: str, width_px: int) -> Column:
    text = attrgetter(field)
    return Column(title, text, lambda entry: natural_order(text(entry)), width_px)


COLUMNS: tuple[Column, ...] = (
    Column(QT_TR_NOOP("Date"), lambda entry: local_time(entry.started_utc), attrgetter("started_utc"), 148),
    _text_column(QT_TR_NOOP("Participant"), "participant", 100),
    _text_column(QT_TR_NOOP("Condition"), "condition", 88),
    _text_column(QT_TR_NOOP("Trial"), "trial", 62),
    _text_column(QT_TR_NOOP("Recording"), "recording", 90),
    _text_column(QT_TR_NOOP("Wizard"), "wizard", 84),
    _text_column(QT_TR_NOOP("Scenario"), "scenario", 160),
    Column(
        QT_TR_NOOP("Length"), lambda entry: text_formatting.elapsed(entry.duration_s), attrgetter("duration_s"), 76,
        right=True,
    ),
    Column(
        QT_TR_NOOP("Size"), lambda entry: text_formatting.size(entry.size_bytes), attrgetter("size_bytes"), 86,
        right=True,
    ),
    Column(QT_TR_NOOP("Marks"), lambda entry: str(entry.marks), attrgetter("marks"), 66, right=True),
    Column(QT_TR_NOOP("State"), state_words, lambda entry: (_doubtful(entry), entry.purpose, entry.problems), 140),
)  # fmt: skip


class SessionsModel(QAbstractTableModel):
    """Sessions as rows, sorted by one column."""

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(parent)
        self._theme = theme
        self._entries: list[SessionEntry] = []
        self.recording: Path | None = None
        self._column, self._order = 0, Qt.SortOrder.DescendingOrder

    def show_entries(self, entries: Sequence[SessionEntry]) -> None:
        self.beginResetModel()
        self._entries = list(entries)
        self._sort()
        self.endResetModel()

    def entry(self, row: int) -> SessionEntry:
        return self._entries[row]

    def row_of(self, folder: Path) -> int | None:
        return next((row for row, entry in enumerate(self._entries) if entry.folder == folder), None)

    def rowCount(self, parent: QModelIndex | QPersistentModelIndex = QModelIndex()) -> int:  # noqa: B008
        return 0 if parent.isValid() else len(self._entries)

    def columnCount(self, parent: QModelIndex | QPersistentModelIndex = QModelIndex()) -> int:  # noqa: B008
        return 0 if parent.isValid() else len(COLUMNS)

    def data(self, index: QModelIndex | QPersistentModelIndex, role: int = int(Qt.ItemDataRole.DisplayRole)) -> Any:
        entry, column = self._entries[index.row()], COLUMNS[index.column()]
        goes_on = entry.folder == self.recording
        if role == Qt.ItemDataRole.DisplayRole:
            return tr("Recording now") if goes_on and column.title == "State" else column.text(entry)
        if role == Qt.ItemDataRole.TextAlignmentRole:
            return _alignment(column)
        if role == Qt.ItemDataRole.ToolTipRole:
            lines = (str(entry.folder), tr("Recording now") if goes_on else state_words(entry), lacks_words(entry))
            return "\n".join(part for part in lines if part)
        if role == Qt.ItemDataRole.DecorationRole and column.title == "State":
            return icon("warning", self._theme.color("amber"), 16) if _doubtful(entry) and not goes_on else None
        return None

    def headerData(
        self, section: int, orientation: Qt.Orientation, role: int = int(Qt.ItemDataRole.DisplayRole)
    ) -> Any:
        if orientation == Qt.Orientation.Horizontal:
            if role == Qt.ItemDataRole.DisplayRole:
                return tr(COLUMNS[section].title)
            if role == Qt.ItemDataRole.TextAlignmentRole:
                return _alignment(COLUMNS[section])
        return None

    def sort(self, column: int, order: Qt.SortOrder = Qt.SortOrder.AscendingOrder) -> None:
        self.layoutAboutToBeChanged.emit()
        before = self.persistentIndexList()
        entries = [(self._entries[index.row()], index.column()) for index in before]
        self._column, self._order = column, order
        self._sort()
        rows = {id(entry): row for row, entry in enumerate(self._entries)}
        self.changePersistentIndexList(before, [self.index(rows[id(entry)], place) for entry, place in entries])
        self.layoutChanged.emit()

    def _sort(self) -> None:
        key = COLUMNS[self._column].key
        self._entries.sort(key=key, reverse=self._order == Qt.SortOrder.DescendingOrder)


def _alignment(column: Column) -> int:
    side = Qt.AlignmentFlag.AlignRight if column.right else Qt.AlignmentFlag.AlignLeft
    return int(side | Qt.AlignmentFlag.AlignVCenter)


class SessionTable(QTableView):
    """Table view with selection of whole rows; Enter chooses."""

    chosen = Signal()

    def __init__(self) -> None:
        super().__init__()
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setSelectionMode(QAbstractItemView.SelectionMode.ExtendedSelection)
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setSortingEnabled(True)
        self.setShowGrid(False)
        self.setWordWrap(False)
        self.setTabKeyNavigation(False)
        self.setVerticalScrollMode(QAbstractItemView.ScrollMode.ScrollPerPixel)
        self.setHorizontalScrollMode(QAbstractItemView.ScrollMode.ScrollPerPixel)
        self.verticalHeader().hide()
        # Fixed row height: Qt need not measure 500 rows.
        self.verticalHeader().setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        self.verticalHeader().setDefaultSectionSize(_ROW_PX)
        header = self.horizontalHeader()
        header.setHighlightSections(False)
        header.setStretchLastSection(True)
        header.setSectionsClickable(True)

    def focusInEvent(self, event: QFocusEvent) -> None:
        super().focusInEvent(event)
        # Qt makes the first row current without showing it, and moves on from there.
        chosen = self.selectionModel().hasSelection()
        if event.reason() != Qt.FocusReason.MouseFocusReason and not chosen and self.currentIndex().isValid():
            self.selectRow(self.currentIndex().row())

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            self.chosen.emit()
        else:
            super().keyPressEvent(event)
