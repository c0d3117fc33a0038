"""Session list: find sessions by header or spoken words, replay and export them."""

import itertools
import re
from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

from PySide6.QtCore import (
    QItemSelectionModel,
    QModelIndex,
    QRect,
    QRectF,
    QSignalBlocker,
    QSize,
    Qt,
    QTimer,
    QUrl,
    Signal,
)
from PySide6.QtGui import (
    QCloseEvent,
    QDesktopServices,
    QFocusEvent,
    QFontMetrics,
    QKeyEvent,
    QPainter,
    QShowEvent,
    QStandardItem,
    QStandardItemModel,
)
from PySide6.QtWidgets import (
    QAbstractItemView,
    QListView,
    QSplitter,
    QStyle,
    QStyleOptionViewItem,
    QTableView,
    QWidget,
)

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.session_library import LiveSessionLibrary
from caris_desktop.live.status import LibraryStatus
from caris_desktop.recording.studies.study_query import PLACES_A_PAGE, SearchHit, SessionEntry, SessionQuery
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.focus_widget import VisualTabOrderMixin
from caris_desktop.ui.text_formatting import local_time, purpose_title
from caris_desktop.ui.theme import Theme, icon
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import FlowRow
from caris_desktop.ui.widgets.inputs import DropDown, add_clear_button
from caris_desktop.ui.widgets.labels import label, line_edit, named, restyle
from caris_desktop.ui.widgets.rows import VALUE_ROLE, Column, ColumnModel, Index, RowDelegate, set_up_table

_ROW_PX = 36


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


class SessionsModel(ColumnModel[SessionEntry]):
    """Sessions as rows. ``recording``: the session that goes on."""

    def __init__(self, theme: Theme, parent: QWidget) -> None:
        super().__init__(COLUMNS, parent)
        self._theme = theme
        self.recording: Path | None = None

    def row_of(self, folder: Path) -> int | None:
        return next((row for row, entry in enumerate(self.rows) if entry.folder == folder), None)

    def data(self, index: Index, role: int = Qt.ItemDataRole.DisplayRole) -> Any:
        entry, state = self.rows[index.row()], COLUMNS[index.column()].title == "State"
        goes_on = entry.folder == self.recording
        if role == Qt.ItemDataRole.DisplayRole and goes_on and state:
            return tr("Recording now")
        if role == Qt.ItemDataRole.ToolTipRole:
            lines = (str(entry.folder), tr("Recording now") if goes_on else state_words(entry), lacks_words(entry))
            return "\n".join(part for part in lines if part)
        if role == Qt.ItemDataRole.DecorationRole and state and _doubtful(entry) and not goes_on:
            return icon("warning", self._theme.color("amber"), 16)
        return super().data(index, role)


class SessionTable(QTableView):
    """Table view with selection of whole rows; Enter chooses."""

    chosen = Signal()

    def __init__(self) -> None:
        super().__init__()
        set_up_table(self, row_px=_ROW_PX)
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setSelectionMode(QAbstractItemView.SelectionMode.ExtendedSelection)
        self.setSortingEnabled(True)

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


_TYPING_PAUSE_MS = 120
_WIDEST_FILTER_PX = 240
_FILTERS = (
    ("participant", QT_TR_NOOP("All participants")),
    ("condition", QT_TR_NOOP("All conditions")),
    ("wizard", QT_TR_NOOP("All wizards")),
    ("scenario", QT_TR_NOOP("All scenarios")),
    ("purpose", QT_TR_NOOP("All types of runs")),
)


class SessionsWindow(VisualTabOrderMixin, QWidget):
    """Window owned by the main window. ``export_requested`` carries the selected folders."""

    export_requested = Signal(object)  # list of folders
    closed = Signal()

    def __init__(self, theme: Theme, library: LiveSessionLibrary, parent: QWidget | None = None) -> None:
        super().__init__(parent, Qt.WindowType.Window)
        self.setObjectName("sessions_window")
        self.setWindowTitle(tr("Sessions · CARIS Desktop"))
        self._theme = theme
        self._library = library
        self._listed: tuple[SessionEntry, ...] = ()
        self._known: dict[str, set[str]] = {name: set() for name, _ in _FILTERS}
        self.search = line_edit(
            "sessions_search", tr("Search"), placeholderText=tr("Search speech, notes and marks…"),
            textChanged=self._on_typed, returnPressed=self._find,
        )  # fmt: skip
        add_clear_button(self.search)
        self._typing = QTimer(self, singleShot=True, interval=_TYPING_PAUSE_MS)
        self._typing.timeout.connect(self._find)
        self._filters: dict[str, DropDown] = {}
        for name, text in _FILTERS:
            choice = DropDown(theme, f"sessions_{name}", tr(text))
            choice.setMinimumHeight(36)
            choice.addItem(tr(text), "")
            choice.show_whole(up_to_px=_WIDEST_FILTER_PX)
            choice.currentIndexChanged.connect(self._find)
            self._filters[name] = choice
        self.model = SessionsModel(theme, self)
        self.table = named(SessionTable(), "sessions_table", tr("Sessions"))
        self.table.setModel(self.model)
        self.table.chosen.connect(self._replay)
        self.table.doubleClicked.connect(lambda index: self._open_replay(self.model.rows[index.row()].folder))
        self.table.selectionModel().selectionChanged.connect(self._show_buttons)
        for number, column in enumerate(COLUMNS):
            heading_px = self.table.horizontalHeader().sectionSizeHint(number)
            self.table.setColumnWidth(number, max(column.width_px, heading_px))
        self.table.sortByColumn(0, Qt.SortOrder.DescendingOrder)
        self._places = PLACES_A_PAGE
        self.hits = HitsModel(self)
        self.hits.more_requested.connect(self._show_more)
        self.hit_list = named(HitList(), "sessions_hits", tr("Search results"))
        self.hit_list.setModel(self.hits)
        self.hit_list.setItemDelegate(HitDelegate(theme, self.hits, self.hit_list))
        self.hit_list.setUniformItemSizes(True)
        self.hit_list.setVerticalScrollMode(QAbstractItemView.ScrollMode.ScrollPerPixel)
        self.hit_list.activated.connect(self._on_hit_chosen)
        self.hit_list.selectionModel().currentChanged.connect(self._on_hit_current)
        self._found = label("", "note", objectName="sessions_found")
        self._hits_part = QWidget()
        self._empty = label(tone="dim", wraps=True, objectName="sessions_empty", alignment=Qt.AlignmentFlag.AlignCenter)
        layouts.vbox(self.table.viewport(), self._empty, margins_px=0)
        self._status = label("", "note", objectName="sessions_status")
        self._lacks = label("", "warning", wraps=True, objectName="sessions_lacks")
        self._lacks.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._lacks.hide()
        self._all = self._button("sessions_show_all", tr("Show all"), "x", self._show_all, role="ghost")
        self._open = self._button("sessions_open_folder", tr("Open folder"), "folder-open", self._open_folder)
        self._export = self._button("sessions_export", tr("Export…"), "export", self._on_export)
        self._replay_button = self._button("sessions_replay", tr("Replay"), "play", self._replay, role="primary")
        self._replay_button.set_key("Enter")
        self._lay_out()
        theme.changed.connect(self.table.viewport().update)
        library.found.follow(self._on_found)
        self.resize(self.sizeHint().boundedTo(self.screen().availableSize() - QSize(40, 80)))

    def sizeHint(self) -> QSize:
        return QSize(1180, 720)

    def _button(self, name: str, text: str, icon_name: str, do: Callable[[], None], **more: Any) -> ActionButton:
        more = {"icon": icon_name, "height_px": 36, "may_lose_words": True, "objectName": name, "clicked": do, **more}
        return ActionButton(self._theme, text, **more)

    def _lay_out(self) -> None:
        filters = FlowRow()
        for choice in self._filters.values():
            filters.add(choice)
        layouts.vbox(self._hits_part, self._found, (self.hit_list, 1), margins_px=(0, 4, 0, 0), spacing_px=4)
        splitter = QSplitter(Qt.Orientation.Vertical, childrenCollapsible=False)
        splitter.addWidget(self.table)
        splitter.addWidget(self._hits_part)
        splitter.setStretchFactor(0, 3)
        splitter.setStretchFactor(1, 2)
        buttons = self._open, self._export, self._replay_button
        foot = layouts.hbox(None, self._status, self._all, 1, *buttons, spacing_px=8)
        layouts.vbox(self, self.search, filters, (splitter, 1), self._lacks, foot, margins_px=16, spacing_px=12)

    # ---- search

    @property
    def query(self) -> SessionQuery:
        chosen: dict[str, Any] = {name: str(choice.currentData() or "") for name, choice in self._filters.items()}
        return SessionQuery(" ".join(self.search.text().split()), **chosen)

    def refresh(self) -> None:
        """Search again: there may be new sessions."""
        self._library.find(replace(self.query, places=self._places))

    def show_recording(self, folder: Path | None) -> None:
        """Set the session being recorded now, which is complete only afterwards."""
        if folder != self.model.recording:
            self.model.recording = folder
            self.table.viewport().update()
            self._show_buttons()

    def _on_typed(self, _text: str) -> None:
        self._typing.start()

    def _find(self, _index: int = 0) -> None:
        self._typing.stop()
        self._places = PLACES_A_PAGE
        self._library.find(self.query)

    def _show_more(self, places: int) -> None:
        self._places = places
        self.refresh()

    def _show_all(self) -> None:
        self.search.clear()
        for choice in self._filters.values():
            with QSignalBlocker(choice):
                choice.setCurrentIndex(0)
        self._find()

    def _on_found(self, status: LibraryStatus) -> None:
        if status.sessions != self._listed:
            # An unchanged list keeps its scroll position, however often the index is read.
            self._listed = status.sessions
            chosen = {entry.folder for entry in self.selected()}
            self.model.show_rows(status.sessions)
            rows = [row for folder in chosen if (row := self.model.row_of(folder)) is not None]
            selection = self.table.selectionModel()
            for row in rows:
                selection.select(
                    self.model.index(row, 0),
                    QItemSelectionModel.SelectionFlag.Select | QItemSelectionModel.SelectionFlag.Rows,
                )
            if rows:
                selection.setCurrentIndex(self.model.index(rows[0], 0), QItemSelectionModel.SelectionFlag.NoUpdate)
        self.hits.show_hits(status)
        searching = status.updating and bool(status.query.text) and not self._hits_part.isHidden()
        self._hits_part.setVisible(bool(status.hits) or searching)
        places = sum(status.places.values())
        found = tr("1 match for “{text}”") if places == 1 else tr("%n matches for “{text}”", "", places)
        self._found.setText(found.format(text=status.query.text) if places else tr("Searching…"))
        self._learn(status)
        self._say(status)
        self._show_buttons()

    def _learn(self, status: LibraryStatus) -> None:
        """Add every participant, condition, ... seen so far to the filters."""
        for name, choice in self._filters.items():
            values = {str(getattr(entry, name)) for entry in status.sessions} - {""}
            if not values <= self._known[name]:
                self._known[name] |= values
                ordered = sorted(self._known[name], key=natural_order)
                items = [(purpose_title(value) if name == "purpose" else value, value) for value in ordered]
                with QSignalBlocker(choice):
                    choice.fill([(choice.itemText(0), ""), *items], choice.currentData())
            choice.setVisible(bool(self._known[name]))

    def _say(self, status: LibraryStatus) -> None:
        filtered = status.query != SessionQuery()
        text = tr("1 session") if status.total == 1 else tr("%n sessions", "", status.total)
        if filtered:
            some = tr("{found} of 1 session") if status.total == 1 else tr("{found} of %n sessions", "", status.total)
            text = some.format(found=len(status.sessions))
        if status.detail:
            text = status.detail
        if status.updating:
            text = tr("{found} · updating…").format(found=text) if status.total else tr("Updating the list…")
        self._status.setText(text)
        restyle(self._status, role="warning" if status.detail else "note")
        self._all.setVisible(filtered)
        empty = ""
        if not status.sessions:
            if status.updating:
                empty = tr("Reading the sessions of this study…")
            elif status.total:
                empty = tr("No session matches. Search for other words or show all.")
            elif status.detail:
                empty = status.detail
            else:
                empty = tr("No sessions yet.\nA session appears here when its recording is stopped.")
        self._empty.setText(empty)
        self._empty.setVisible(bool(empty))

    # ---- commands

    def selected(self) -> list[SessionEntry]:
        """Selected sessions, top to bottom."""
        rows = sorted(index.row() for index in self.table.selectionModel().selectedRows())
        return [self.model.rows[row] for row in rows]

    def _show_buttons(self) -> None:
        chosen = self.selected()
        count = len(chosen)
        goes_on = any(entry.folder == self.model.recording for entry in chosen)
        wait = tr("This session is still being recorded") if goes_on else ""
        lacks = lacks_words(chosen[0]) if count == 1 and not goes_on else ""
        self._lacks.setText(lacks)
        self._lacks.setVisible(bool(lacks))
        for button, enabled in (
            (self._replay_button, count == 1 and not goes_on),
            (self._open, count == 1),
            (self._export, count > 0 and not goes_on),
        ):
            button.setEnabled(enabled)
        self._export.set_label(tr("Export %n sessions…", "", count) if count > 1 else tr("Export…"))
        for button in (self._replay_button, self._open, self._export):
            button.setToolTip(wait if wait and button is not self._open else button.text())

    def _replay(self) -> None:
        chosen = self.selected()
        if len(chosen) == 1:
            self._open_replay(chosen[0].folder)

    def _open_replay(self, folder: Path, at_ns: int | None = None) -> None:
        if folder != self.model.recording:
            self._library.open_replay(folder, at_ns=at_ns)

    def _on_hit_chosen(self, index: QModelIndex) -> None:
        hit = self.hits.hit(index.row())
        self._open_replay(hit.folder, hit.at_ns)

    def _on_hit_current(self, index: QModelIndex, _before: QModelIndex) -> None:
        """Select the session of a result, so that the buttons apply to it."""
        if index.isValid():
            row = self.model.row_of(self.hits.hit(index.row()).folder)
            if row is not None:
                self.table.selectRow(row)

    def _on_export(self) -> None:
        folders = [entry.folder for entry in self.selected()]
        if folders:
            self.export_requested.emit(folders)

    def _open_folder(self) -> None:
        chosen = self.selected()
        if len(chosen) == 1:
            QDesktopServices.openUrl(QUrl.fromLocalFile(str(chosen[0].folder)))

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        self.search.setFocus(Qt.FocusReason.OtherFocusReason)
        self.refresh()

    def closeEvent(self, event: QCloseEvent) -> None:
        super().closeEvent(event)
        self.closed.emit()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() == Qt.Key.Key_Down and self.search.hasFocus() and self.model.rowCount():
            self.table.setFocus(Qt.FocusReason.OtherFocusReason)
        else:
            super().keyPressEvent(event)


_INDENT_PX = 12


class HitsModel(QStandardItemModel):
    """Search results, each session's under a heading; more are fetched on scrolling."""

    more_requested = Signal(int)
    """New number of results to show."""

    def __init__(self, parent: QWidget) -> None:
        super().__init__(parent)
        self._hits: tuple[SearchHit, ...] = ()
        self._places = self._requested_places = 0
        self.pattern: re.Pattern[str] | None = None

    def show_hits(self, status: LibraryStatus) -> None:
        if status.updating and status.hits == self._hits:
            return  # former results stay until new ones arrive
        self._places, self._requested_places = sum(status.places.values()), status.query.places
        known = len(self._hits)
        if not known or known >= len(status.hits) or status.hits[:known] != self._hits:
            known = 0
            self.clear()
            found = [re.escape(word.strip("\"'*")) for word in status.query.text.split() if word.strip("\"'*")]
            self.pattern = re.compile("|".join(found), re.IGNORECASE) if found else None
        before, self._hits = self._hits[known - 1 : known], status.hits
        sessions = {
            entry.folder: f"{entry.participant or entry.folder.name} · {local_time(entry.started_utc)}"
            for entry in status.sessions
        }
        items: list[QStandardItem] = []
        for folder, of_session in itertools.groupby(status.hits[known:], key=attrgetter("folder")):
            session, places = sessions.get(folder, folder.name), status.places.get(folder, 0)
            if not before or before[0].folder != folder:
                matches = tr("1 match") if places == 1 else tr("%n matches", "", places)
                items.append(_row(f"{session} · {matches}", f"{session} · {matches}"))
                items[-1].setFlags(Qt.ItemFlag.ItemNeverHasChildren)
            items += (_row_of(hit, session) for hit in of_session)
        self.invisibleRootItem().appendRows(items)

    def hit(self, row: int) -> SearchHit:
        """Result in ``row``, which is not a heading."""
        hit: SearchHit = self.item(row).data(VALUE_ROLE)
        return hit

    def canFetchMore(self, _parent: Index) -> bool:
        return self._requested_places <= len(self._hits) < self._places

    def fetchMore(self, _parent: Index) -> None:
        self._requested_places += PLACES_A_PAGE
        self.more_requested.emit(self._requested_places)


def _row(text: str, spoken: str) -> QStandardItem:
    item = QStandardItem(text)
    item.setAccessibleText(spoken)
    item.setEditable(False)
    return item


def _row_of(hit: SearchHit, session: str) -> QStandardItem:
    at = text_formatting.elapsed(hit.session_s)
    item = _row(hit.snippet, f"{session}, {at}, {kind_words(hit.kind)}: {hit.snippet}")
    item.setData(hit, VALUE_ROLE)
    quoted = tr("Also contained in %n prompt(s) to the language model.", "", hit.quoted) if hit.quoted else ""
    item.setToolTip("\n".join(filter(None, (hit.snippet, quoted, tr("Double-click to replay from here")))))
    return item


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


class HitDelegate(RowDelegate):
    """Result row: time, speaker, and excerpt with highlighted matches; or the heading of a session."""

    _TIME_PX, _KIND_PX = 62, 100

    def __init__(self, theme: Theme, model: HitsModel, view: QListView) -> None:
        super().__init__(theme, view)
        self._model = model

    def sizeHint(self, _option: QStyleOptionViewItem, _index: Index) -> QSize:
        return QSize(300, 32)

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: Index) -> None:
        if option.state & QStyle.StateFlag.State_Selected:
            painter.save()
            painter.setRenderHint(QPainter.RenderHint.Antialiasing)
            painter.setPen(Qt.PenStyle.NoPen)
            painter.setBrush(self._theme.color("blue_soft"))
            painter.drawRoundedRect(QRectF(option.rect).adjusted(0, 1, 0, -1), 6, 6)
            painter.restore()
        super().paint(painter, option, index)

    def paint_row(self, painter: QPainter, rect: QRect, index: Index) -> None:
        hit: SearchHit | None = index.data(VALUE_ROLE)
        inside, font = rect.adjusted(10, 0, -8, 0), self._theme.font
        if hit is None:
            self.paint_text(painter, inside, str(index.data()), font(tokens.STATUS_PX, tokens.WEIGHT_SEMIBOLD), "text")
            return
        inside.setLeft(inside.left() + _INDENT_PX)
        for text, width in (
            (text_formatting.elapsed(hit.session_s), self._TIME_PX),
            (kind_words(hit.kind), self._KIND_PX),
        ):
            box = QRect(inside.left(), rect.top(), width - 8, rect.height())
            self.paint_text(painter, box, text, font(tokens.STATUS_PX), "dim")
            inside.setLeft(inside.left() + width)
        for text, found in _pieces(hit.snippet, self._model.pattern):
            weight = tokens.WEIGHT_SEMIBOLD if found else tokens.WEIGHT_NORMAL
            size_px = tokens.STATUS_PX + 1
            taken = self.paint_text(painter, inside, text, font(size_px, weight), "blue" if found else "text")
            if taken < QFontMetrics(font(size_px, weight)).horizontalAdvance(text):
                return  # elided
            inside.setLeft(inside.left() + taken)


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
    """List view in which keys skip the headings."""

    def moveCursor(self, action: QAbstractItemView.CursorAction, modifiers: Qt.KeyboardModifier) -> QModelIndex:
        index = super().moveCursor(action, modifiers)
        return index.siblingAtRow(index.row() + 1) if _is_heading(index) else index

    def currentChanged(self, current: Index, before: Index) -> None:
        super().currentChanged(current, before)
        above = current.sibling(current.row() - 1, 0)
        if _is_heading(above):
            self.scrollTo(above)  # keys do not reach it, so nothing else would show it


def _is_heading(index: Index) -> bool:
    return index.isValid() and not index.flags() & Qt.ItemFlag.ItemIsEnabled
