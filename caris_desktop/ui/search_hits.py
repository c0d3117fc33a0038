"""Search results over sessions, grouped by session: time, speaker and excerpt."""

import itertools
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from PySide6.QtCore import QAbstractListModel, QModelIndex, QPersistentModelIndex, QRect, QRectF, QSize, Qt, Signal
from PySide6.QtGui import QColor, QFont, QFontMetrics, QKeyEvent, QPainter
from PySide6.QtWidgets import QAbstractItemView, QListView, QStyle, QStyledItemDelegate, QStyleOptionViewItem, QWidget

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import LibraryStatus
from caris_desktop.recording.studies.study_query import PLACES_A_PAGE, SearchHit
from caris_desktop.ui import text_formatting, tokens
from caris_desktop.ui.session_table import local_time
from caris_desktop.ui.theme import Theme

_HIT_ROLE = int(Qt.ItemDataRole.UserRole)
_INDENT_PX = 12


class HitsModel(QAbstractListModel):
    """Search results, each session's under a heading; more are fetched on scrolling."""

    more_wanted = Signal(int)
    """New number of results to show."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self._hits: tuple[SearchHit, ...] = ()
        self._rows: list[SearchHit | Path] = []
        self._places: dict[Path, int] = {}
        self._wanted = 0
        self._whose: dict[Path, str] = {}
        self.pattern: re.Pattern[str] | None = None

    def show_hits(self, status: LibraryStatus) -> None:
        if status.updating and status.hits == self._hits:
            return  # former results stay until new ones arrive
        self._places, self._wanted = status.places, status.query.places
        shown = len(self._hits)
        if shown < len(status.hits) and self._hits and status.hits[:shown] == self._hits:
            more = _grouped(status.hits[shown:], after=self._hits[-1].folder)
            self.beginInsertRows(QModelIndex(), len(self._rows), len(self._rows) + len(more) - 1)
            self._hits = status.hits
            self._rows += more
            self.endInsertRows()
            return
        self.beginResetModel()
        self._hits = status.hits
        self._rows = _grouped(status.hits)
        self._whose = {
            entry.folder: f"{entry.participant or entry.folder.name} · {local_time(entry.started_utc)}"
            for entry in status.sessions
        }
        found = [re.escape(word.strip("\"'*")) for word in status.query.text.split() if word.strip("\"'*")]
        self.pattern = re.compile("|".join(found), re.IGNORECASE) if found else None
        self.endResetModel()

    def hit(self, row: int) -> SearchHit:
        """Result in ``row``, which is not a heading."""
        hit = self._rows[row]
        assert isinstance(hit, SearchHit)  # noqa: S101 (headings cannot be chosen)
        return hit

    def session_name(self, folder: Path) -> str:
        return self._whose.get(folder, folder.name)

    def rowCount(self, parent: QModelIndex | QPersistentModelIndex = QModelIndex()) -> int:  # noqa: B008
        return 0 if parent.isValid() else len(self._rows)

    def canFetchMore(self, _parent: QModelIndex | QPersistentModelIndex) -> bool:
        return self._wanted <= len(self._hits) < sum(self._places.values())

    def fetchMore(self, _parent: QModelIndex | QPersistentModelIndex) -> None:
        self._wanted += PLACES_A_PAGE
        self.more_wanted.emit(self._wanted)

    def flags(self, index: QModelIndex | QPersistentModelIndex) -> Qt.ItemFlag:
        is_hit = isinstance(self._rows[index.row()], SearchHit)
        return super().flags(index) if is_hit else Qt.ItemFlag.ItemNeverHasChildren

    def data(self, index: QModelIndex | QPersistentModelIndex, role: int = int(Qt.ItemDataRole.DisplayRole)) -> Any:
        hit = self._rows[index.row()]
        if isinstance(hit, Path):
            told = role in (Qt.ItemDataRole.DisplayRole, Qt.ItemDataRole.AccessibleTextRole)
            return self._heading(hit) if told else None
        if role == Qt.ItemDataRole.DisplayRole:
            return hit.snippet
        if role == _HIT_ROLE:
            return hit
        if role == Qt.ItemDataRole.AccessibleTextRole:
            at = text_formatting.elapsed(hit.session_s)
            return f"{self.session_name(hit.folder)}, {at}, {kind_words(hit.kind)}: {hit.snippet}"
        if role == Qt.ItemDataRole.ToolTipRole:
            lines = [hit.snippet, tr("Double-click to replay from here")]
            if hit.quoted:
                lines.insert(1, tr("Also contained in %n prompt(s) to the language model.", "", hit.quoted))
            return "\n".join(lines)
        return None

    def _heading(self, folder: Path) -> str:
        places = self._places.get(folder, 0)
        found = tr("1 match") if places == 1 else tr("%n matches", "", places)
        return f"{self.session_name(folder)} · {found}"


def _grouped(hits: Sequence[SearchHit], *, after: Path | None = None) -> list[SearchHit | Path]:
    """The results with the session's folder, as its heading, before the first of each session but ``after``."""
    rows: list[SearchHit | Path] = []
    for folder, of_session in itertools.groupby(hits, key=lambda hit: hit.folder):
        rows += (*([] if folder == after else [folder]), *of_session)
    return rows


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
    """Result row: time, speaker, and excerpt with highlighted matches; or the heading of a session."""

    _TIME_PX, _KIND_PX = 62, 100

    def __init__(self, theme: Theme, model: HitsModel, view: QListView) -> None:
        super().__init__(view)
        self._theme = theme
        self._model = model

    def sizeHint(self, _option: QStyleOptionViewItem, _index: QModelIndex | QPersistentModelIndex) -> QSize:
        return QSize(300, 32)

    def paint(
        self, painter: QPainter, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex
    ) -> None:
        hit: SearchHit | None = index.data(_HIT_ROLE)
        rect: QRect = option.rect
        theme = self._theme
        painter.save()
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        if option.state & QStyle.StateFlag.State_Selected:
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(theme.color("blue_soft"))
            painter.drawRoundedRect(QRectF(rect).adjusted(0, 1, 0, -1), 6, 6)
        inside = rect.adjusted(10, 0, -8, 0)
        if hit is None:
            font = theme.font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD)
            _draw_elided(painter, inside, str(index.data()), font, theme.color("text"))
        else:
            left = inside.left() + _INDENT_PX
            for text, width in (
                (text_formatting.elapsed(hit.session_s), self._TIME_PX),
                (kind_words(hit.kind), self._KIND_PX),
            ):
                box = QRect(left, rect.top(), width - 8, rect.height())
                _draw_elided(painter, box, text, theme.font(tokens.STATUS_PX), theme.color("dim"))
                left += width
            self._draw_snippet(painter, QRect(left, rect.top(), inside.right() - left, rect.height()), hit.snippet)
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


def _draw_elided(painter: QPainter, box: QRect, text: str, font: QFont, color: QColor) -> None:
    painter.setFont(font)
    painter.setPen(color)
    shown = QFontMetrics(font).elidedText(text, Qt.TextElideMode.ElideRight, box.width())
    painter.drawText(box, int(Qt.AlignmentFlag.AlignVCenter), shown)


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
    """List view in which Enter chooses and keys skip the headings."""

    chosen = Signal()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter):
            self.chosen.emit()
        else:
            super().keyPressEvent(event)

    def moveCursor(self, action: QAbstractItemView.CursorAction, modifiers: Qt.KeyboardModifier) -> QModelIndex:
        index = super().moveCursor(action, modifiers)
        return index.siblingAtRow(index.row() + 1) if _is_heading(index) else index

    def currentChanged(
        self, current: QModelIndex | QPersistentModelIndex, before: QModelIndex | QPersistentModelIndex
    ) -> None:
        super().currentChanged(current, before)
        above = current.sibling(current.row() - 1, 0)
        if _is_heading(above):
            self.scrollTo(above)  # keys do not reach it, so nothing else would show it


def _is_heading(index: QModelIndex | QPersistentModelIndex) -> bool:
    return index.isValid() and not index.flags() & Qt.ItemFlag.ItemIsEnabled
