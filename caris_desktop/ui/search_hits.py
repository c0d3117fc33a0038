"""Search results over sessions: session, time, speaker and excerpt."""

import re
from pathlib import Path
from typing import Any

from PySide6.QtCore import QAbstractListModel, QModelIndex, QPersistentModelIndex, QRect, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QFontMetrics, QKeyEvent, QPainter
from PySide6.QtWidgets import QListView, QStyle, QStyledItemDelegate, QStyleOptionViewItem, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import LibraryStatus
from caris_desktop.recording.studies.study_query import PLACES_A_PAGE, SearchHit
from caris_desktop.ui import text_formatting, tokens
from caris_desktop.ui.session_table import local_time
from caris_desktop.ui.theme import Theme

_HIT_ROLE = int(Qt.ItemDataRole.UserRole)


class HitsModel(QAbstractListModel):
    """Search results; more are fetched on scrolling."""

    more_wanted = Signal(int)
    """New number of results to show."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self._hits: tuple[SearchHit, ...] = ()
        self._places = self._wanted = 0
        self._whose: dict[Path, str] = {}
        self.pattern: re.Pattern[str] | None = None

    def show_hits(self, status: LibraryStatus) -> None:
        if status.updating and status.hits == self._hits:
            return  # former results stay until new ones arrive
        self._places, self._wanted = status.places, status.query.places
        if self._hits and len(status.hits) > len(self._hits) and status.hits[: len(self._hits)] == self._hits:
            self.beginInsertRows(QModelIndex(), len(self._hits), len(status.hits) - 1)
            self._hits = status.hits
            self.endInsertRows()
            return
        self.beginResetModel()
        self._hits = status.hits
        self._whose = {
            entry.folder: " · ".join(part for part in (entry.participant, local_time(entry.started_utc)[:10]) if part)
            for entry in status.sessions
        }
        found = [re.escape(word.strip("\"'*")) for word in status.query.text.split() if word.strip("\"'*")]
        self.pattern = re.compile("|".join(found), re.IGNORECASE) if found else None
        self.endResetModel()

    def hit(self, row: int) -> SearchHit:
        return self._hits[row]

    def session_name(self, hit: SearchHit) -> str:
        return self._whose.get(hit.folder, hit.folder.name)

    def rowCount(self, parent: QModelIndex | QPersistentModelIndex = QModelIndex()) -> int:  # noqa: B008
        return 0 if parent.isValid() else len(self._hits)

    def canFetchMore(self, _parent: QModelIndex | QPersistentModelIndex) -> bool:
        return len(self._hits) < self._places and len(self._hits) >= self._wanted

    def fetchMore(self, _parent: QModelIndex | QPersistentModelIndex) -> None:
        self._wanted += PLACES_A_PAGE
        self.more_wanted.emit(self._wanted)

    def data(self, index: QModelIndex | QPersistentModelIndex, role: int = int(Qt.ItemDataRole.DisplayRole)) -> Any:
        hit = self._hits[index.row()]
        if role == Qt.ItemDataRole.DisplayRole:
            return hit.snippet
        if role == _HIT_ROLE:
            return hit
        if role == Qt.ItemDataRole.AccessibleTextRole:
            at = text_formatting.elapsed(hit.session_s)
            return f"{self.session_name(hit)}, {at}, {kind_words(hit.kind)}: {hit.snippet}"
        if role == Qt.ItemDataRole.ToolTipRole:
            lines = [hit.snippet, tr("Double-click to replay from here")]
            if hit.quoted:
                lines.insert(1, tr("Also contained in %n prompt(s) to the language model.", "", hit.quoted))
            return "\n".join(lines)
        return None


_KINDS = {
    "robot": QT_TR_NOOP("Robot"),
    "participant": QT_TR_NOOP("Participant"),
    "wizard": QT_TR_NOOP("Wizard"),
    "mark": QT_TR_NOOP("Mark"),
    "note": QT_TR_NOOP("Note"),
    "wizard_error": QT_TR_NOOP("Wizard error"),
    "assistant": QT_TR_NOOP("Assistant"),
    "problem": QT_TR_NOOP("Problem"),
    "annotation": QT_TR_NOOP("Annotation"),
    "session": QT_TR_NOOP("Session"),
}


def kind_words(kind: str) -> str:
    return tr(_KINDS[kind]) if kind in _KINDS else kind.replace("_", " ").capitalize()


class HitDelegate(QStyledItemDelegate):
    """Result row: session, time, speaker, and excerpt with highlighted matches."""

    _WHOSE_PX, _TIME_PX, _KIND_PX = 170, 62, 100

    def __init__(self, theme: Theme, model: HitsModel, view: QListView) -> None:
        super().__init__(view)
        self._theme = theme
        self._model = model

    def sizeHint(self, _option: QStyleOptionViewItem, _index: QModelIndex | QPersistentModelIndex) -> QSize:
        return QSize(300, 32)

    def paint(
        self, painter: QPainter, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex
    ) -> None:
        hit: SearchHit = index.data(_HIT_ROLE)
        rect: QRect = option.rect
        theme = self._theme
        painter.save()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if option.state & QStyle.StateFlag.State_Selected:
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(theme.color("blue_soft"))
            painter.drawRoundedRect(QRectF(rect).adjusted(0, 1, 0, -1), 6, 6)
        painter.setFont(theme.font(tokens.STATUS_PX))
        painter.setPen(theme.color("dim"))
        metrics, left = QFontMetrics(theme.font(tokens.STATUS_PX)), rect.left() + 10
        for text, width in (
            (self._model.session_name(hit), self._WHOSE_PX),
            (text_formatting.elapsed(hit.session_s), self._TIME_PX),
            (kind_words(hit.kind), self._KIND_PX),
        ):
            box = QRect(left, rect.top(), width - 8, rect.height())
            painter.drawText(
                box, int(Qt.AlignmentFlag.AlignVCenter), metrics.elidedText(text, Qt.TextElideMode.ElideRight, width)
            )
            left += width
        self._draw_snippet(painter, QRect(left, rect.top(), rect.right() - left - 8, rect.height()), hit.snippet)
        painter.restore()

    def _draw_snippet(self, painter: QPainter, rect: QRect, snippet: str) -> None:
        theme, left = self._theme, rect.left()
        for text, found in _pieces(snippet, self._model.pattern):
            font = theme.font(tokens.STATUS_PX + 1, tokens.WEIGHT_SEMIBOLD if found else tokens.WEIGHT_NORMAL)
            metrics = QFontMetrics(font)
            room = rect.right() - left
            if room <= 0:
                return
            shown = metrics.elidedText(text, Qt.TextElideMode.ElideRight, room)
            painter.setFont(font)
            painter.setPen(theme.color("blue" if found else "text"))
            painter.drawText(
                QRect(left, rect.top(), room + 2, rect.height()), int(Qt.AlignmentFlag.AlignVCenter), shown
            )
            left += metrics.horizontalAdvance(shown)
            if shown != text:
                return


def _pieces(text: str, pattern: re.Pattern[str] | None) -> list[tuple[str, bool]]:
    """The text split at the boundaries of the searched words."""
    if pattern is None:
        return [(text, False)]
    pieces, at = [], 0
    for match in pattern.finditer(text):
        if match.start() > at:
            pieces.append((text[at : match.start()], False))
        pieces.append((match.group(), True))
        at = match.end()
    if at < len(text):
        pieces.append((text[at:], False))
    return pieces


class HitList(QListView):
    """List view in which Enter chooses."""

    chosen = Signal()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            self.chosen.emit()
        else:
            super().keyPressEvent(event)
