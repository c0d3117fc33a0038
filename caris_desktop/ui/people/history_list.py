"""History of a person over all sessions: time and one line per entry."""

from collections.abc import Sequence
from datetime import datetime
from typing import Any

from PySide6.QtCore import QAbstractListModel, QModelIndex, QObject, QPersistentModelIndex, QRect, QRectF, Qt
from PySide6.QtGui import QFontMetrics, QPainter
from PySide6.QtWidgets import QStyledItemDelegate, QStyleOptionViewItem

from caris_desktop.domain.translation import tr
from caris_desktop.people.people_store import HistoryEntry
from caris_desktop.ui import text_formatting, tokens
from caris_desktop.ui.icons import draw_icon
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.fast_table_view import FastTableView

ROW_PX = 26
_ICONS = {"visit": "user", "said": "robot", "heard": "chat-text", "photo": "camera", "note": "note-pencil"}
_ENTRY_ROLE = int(Qt.ItemDataRole.UserRole)
_Index = QModelIndex | QPersistentModelIndex


def when(utc_ns: int, today: datetime) -> str:
    """Time as 14:02; 21 Nov, 14:02 on another day; 21 Nov 2025, 14:02 in another year."""
    at = datetime.fromtimestamp(utc_ns / 1e9)
    if at.date() == today.date():
        return f"{at:%H:%M}"
    return f"{text_formatting.day_of(at, with_year=at.year != today.year)}, {at:%H:%M}"


def what(entry: HistoryEntry) -> str:
    """The entry as one line."""
    match entry.kind:
        case "visit":
            if entry.until_utc_ns is None:
                return tr("Visit")
            lasted = text_formatting.long_duration((entry.until_utc_ns - entry.utc_ns) / 1e9)
            return tr("Visit, {time}").format(time=lasted)
        case "said":
            return tr("Robot: “{text}”").format(text=entry.text)
        case "heard":
            return f"“{entry.text}”"
        case "photo":
            return tr("Photo {name}").format(name=entry.text.rsplit("/", 1)[-1])
        case _:
            return entry.text


class HistoryModel(QAbstractListModel):
    def __init__(self, parent: QObject) -> None:
        super().__init__(parent)
        self._entries: Sequence[HistoryEntry] = ()

    @property
    def times(self) -> list[str]:
        """Unique times shown before the entries."""
        today = datetime.now()
        return list(dict.fromkeys(when(entry.utc_ns, today) for entry in self._entries))

    def show_entries(self, entries: Sequence[HistoryEntry]) -> None:
        self.beginResetModel()
        self._entries = entries
        self.endResetModel()

    def rowCount(self, parent: _Index = QModelIndex()) -> int:  # noqa: B008 (Qt's own default)
        return 0 if parent.isValid() else len(self._entries)

    def data(self, index: _Index, role: int = int(Qt.ItemDataRole.DisplayRole)) -> Any:
        entry = self._entries[index.row()]
        if role == Qt.ItemDataRole.DisplayRole:
            return what(entry)
        if role in (Qt.ItemDataRole.ToolTipRole, Qt.ItemDataRole.AccessibleTextRole):
            session = f" · {entry.session}" if entry.session else ""
            return f"{when(entry.utc_ns, datetime.now())}{session}\n{what(entry)}"
        return entry if role == _ENTRY_ROLE else None


class HistoryList(FastTableView):
    """History list, newest entry first."""

    def __init__(self, theme: Theme) -> None:
        super().__init__(row_px=ROW_PX)
        self.setObjectName("person_history")
        self.setAccessibleName(tr("History"))
        self.entries = HistoryModel(self)
        self.setModel(self.entries)
        self.setItemDelegate(_EntryDelegate(theme, self))


class _EntryDelegate(QStyledItemDelegate):
    def __init__(self, theme: Theme, view: HistoryList) -> None:
        super().__init__(view)
        self._theme = theme
        self._entries = view.entries
        self._times_px = 0
        view.entries.modelReset.connect(self._measure)

    def _measure(self) -> None:
        """Width of the longest time."""
        metrics = QFontMetrics(self._theme.font(tokens.STATUS_PX))
        self._times_px = max((metrics.horizontalAdvance(time) for time in self._entries.times), default=0) + 12

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: _Index) -> None:
        theme, rect = self._theme, option.rect
        entry: HistoryEntry = index.data(_ENTRY_ROLE)
        font = theme.font(tokens.STATUS_PX)
        metrics = QFontMetrics(font)
        time = when(entry.utc_ns, datetime.now())
        painter.save()
        painter.setFont(font)
        painter.setPen(theme.color("dim"))
        left = int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        wide = self._times_px
        painter.drawText(QRect(rect.left(), rect.top(), wide, rect.height()), left, time)
        icon = QRectF(rect.left() + wide, rect.center().y() - 7, 15, 15)
        draw_icon(painter, icon, _ICONS[entry.kind], theme.color("dim"))
        painter.setPen(theme.color("text"))
        room = rect.adjusted(wide + 22, 0, -4, 0)
        painter.drawText(room, left, metrics.elidedText(what(entry), Qt.TextElideMode.ElideRight, room.width()))
        painter.restore()
