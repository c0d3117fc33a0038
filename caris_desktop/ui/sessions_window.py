"""Session list: find sessions by header or spoken words, replay and export them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtCore import QItemSelectionModel, QModelIndex, QSize, Qt, QTimer, QUrl, Signal
from PySide6.QtGui import QCloseEvent, QDesktopServices, QKeyEvent, QPainter, QPaintEvent, QShowEvent
from PySide6.QtWidgets import (
    QAbstractItemView,
    QLabel,
    QLineEdit,
    QSplitter,
    QWidget,
)

from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.live.status import LibraryStatus
from caris_desktop.live.wizard_console import SessionLibrary
from caris_desktop.recording.studies.study_query import PLACES_A_PAGE, SessionEntry, SessionQuery
from caris_desktop.ui import layouts, tokens
from caris_desktop.ui.search_hits import HitDelegate, HitList, HitsModel
from caris_desktop.ui.session_table import (
    COLUMNS,
    SessionsModel,
    SessionTable,
    lacks_words,
    natural_order,
    purpose_title,
)
from caris_desktop.ui.tab_order import VisualTabOrderMixin
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.clear_button import add_clear_button
from caris_desktop.ui.widgets.drop_down import DropDown
from caris_desktop.ui.widgets.flow_layout import FlowRow

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

    def __init__(self, theme: Theme, library: SessionLibrary, parent: QWidget | None = None) -> None:
        super().__init__(parent, Qt.WindowType.Window)
        self.setObjectName("sessions_window")
        self.setWindowTitle(tr("Sessions · CARIS Desktop"))
        self._theme = theme
        self._library = library
        self._shown: tuple[SessionEntry, ...] = ()
        self._known: dict[str, set[str]] = {name: set() for name, _ in _FILTERS}
        self.search = QLineEdit(placeholderText=tr("Search speech, notes and marks…"))
        self.search.setObjectName("sessions_search")
        self.search.setAccessibleName(tr("Search"))
        add_clear_button(self.search)
        self.search.setMinimumHeight(36)
        self.search.textChanged.connect(self._on_typed)
        self.search.returnPressed.connect(self._find)
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
        self.table = SessionTable()
        self.table.setModel(self.model)
        self.table.setObjectName("sessions_table")
        self.table.setAccessibleName(tr("Sessions"))
        self.table.chosen.connect(self._replay)
        self.table.doubleClicked.connect(self._on_row_chosen)
        self.table.selectionModel().selectionChanged.connect(self._on_selection_changed)
        for number, column in enumerate(COLUMNS):
            heading_px = self.table.horizontalHeader().sectionSizeHint(number)
            self.table.setColumnWidth(number, max(column.width_px, heading_px))
        self.table.sortByColumn(0, Qt.SortOrder.DescendingOrder)
        self._places = PLACES_A_PAGE
        self.hits = HitsModel(self)
        self.hits.more_wanted.connect(self._show_more)
        self.hit_list = HitList()
        self.hit_list.setObjectName("sessions_hits")
        self.hit_list.setAccessibleName(tr("Search results"))
        self.hit_list.setModel(self.hits)
        self.hit_list.setItemDelegate(HitDelegate(theme, self.hits, self.hit_list))
        self.hit_list.setUniformItemSizes(True)
        self.hit_list.setVerticalScrollMode(QAbstractItemView.ScrollMode.ScrollPerPixel)
        self.hit_list.doubleClicked.connect(self._on_hit_chosen)
        self.hit_list.chosen.connect(self._on_hit_entered)
        self.hit_list.selectionModel().currentChanged.connect(self._on_hit_current)
        self._found = QLabel()
        self._found.setObjectName("sessions_found")
        self._hits_part = QWidget()
        self._empty = QLabel(self.table, alignment=Qt.AlignmentFlag.AlignCenter, wordWrap=True)
        self._empty.setObjectName("sessions_empty")
        self._status = QLabel()
        self._status.setObjectName("sessions_status")
        self._lacks = QLabel(wordWrap=True, textFormat=Qt.TextFormat.PlainText)
        self._lacks.setObjectName("sessions_lacks")
        self._lacks.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self._lacks.hide()
        self._all = self._button("sessions_show_all", tr("Show all"), "x", self._show_all, look="ghost")
        self._open = self._button("sessions_open_folder", tr("Open folder"), "folder-open", self._open_folder)
        self._export = self._button("sessions_export", tr("Export…"), "export", self._on_export)
        self._replay_button = self._button("sessions_replay", tr("Replay"), "play", self._replay, look="primary")
        self._replay_button.set_key("Enter")
        self._lay_out()
        library.found.changed.connect(self._on_found)
        theme.restyle_on_change(self._style)
        self._on_found(library.found.value)
        self.resize(self.sizeHint().boundedTo(self.screen().availableSize() - QSize(40, 80)))

    def sizeHint(self) -> QSize:
        return QSize(1180, 720)

    def _button(self, name: str, text: str, icon_name: str, do: Callable[[], None], **more: Any) -> ActionButton:
        button = ActionButton(self._theme, text, icon=icon_name, height_px=36, may_lose_words=True, **more)
        button.setObjectName(name)
        button.clicked.connect(do)
        return button

    def _lay_out(self) -> None:
        filters = FlowRow()
        for choice in self._filters.values():
            filters.add(choice)
        below = layouts.vbox(self._hits_part, margins_px=(0, 4, 0, 0), spacing_px=4)
        below.addWidget(self._found)
        below.addWidget(self.hit_list, 1)
        splitter = QSplitter(Qt.Orientation.Vertical, childrenCollapsible=False)
        splitter.addWidget(self.table)
        splitter.addWidget(self._hits_part)
        splitter.setStretchFactor(0, 3)
        splitter.setStretchFactor(1, 2)
        buttons = layouts.hbox(spacing_px=8)
        buttons.addWidget(self._status)
        buttons.addWidget(self._all)
        buttons.addStretch(1)
        for button in (self._open, self._export, self._replay_button):
            buttons.addWidget(button)
        layout = layouts.vbox(self, margins_px=16, spacing_px=12)
        layout.addWidget(self.search)
        layout.addWidget(filters)
        layout.addWidget(splitter, 1)
        layout.addWidget(self._lacks)
        layout.addLayout(buttons)

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
            choice.blockSignals(True)
            choice.setCurrentIndex(0)
            choice.blockSignals(False)
        self._find()

    def _on_found(self, status: LibraryStatus) -> None:
        if status.sessions != self._shown:
            # An unchanged list keeps its scroll position, however often the index is read.
            self._shown = status.sessions
            chosen = {entry.folder for entry in self.selected()}
            self.model.show_entries(status.sessions)
            self._select(chosen)
        self.hits.show_hits(status)
        searching = status.updating and bool(status.query.text) and not self._hits_part.isHidden()
        self._hits_part.setVisible(bool(status.hits) or searching)
        places = sum(status.places.values())
        found = tr("1 match for “{text}”") if places == 1 else tr("%n matches for “{text}”", "", places)
        self._found.setText(found.format(text=status.query.text) if places else tr("Searching…"))
        self._learn(status)
        self._say(status)
        self._show_buttons()

    def _select(self, folders: set[Path]) -> None:
        rows = [row for folder in folders if (row := self.model.row_of(folder)) is not None]
        selection = self.table.selectionModel()
        for row in rows:
            selection.select(
                self.model.index(row, 0),
                QItemSelectionModel.SelectionFlag.Select | QItemSelectionModel.SelectionFlag.Rows,
            )
        if rows:
            selection.setCurrentIndex(self.model.index(rows[0], 0), QItemSelectionModel.SelectionFlag.NoUpdate)

    def _learn(self, status: LibraryStatus) -> None:
        """Add every participant, condition, ... seen so far to the filters."""
        for name, choice in self._filters.items():
            seen = {str(getattr(entry, name)) for entry in status.sessions} - {""}
            if not seen <= self._known[name]:
                self._known[name] |= seen
                current = choice.currentData()
                choice.blockSignals(True)
                while choice.count() > 1:
                    choice.removeItem(1)
                for value in sorted(self._known[name], key=natural_order):
                    choice.addItem(purpose_title(value) if name == "purpose" else value, value)
                choice.setCurrentIndex(max(0, choice.findData(current)))
                choice.blockSignals(False)
            choice.setVisible(bool(self._known[name]))

    def _say(self, status: LibraryStatus) -> None:
        filtered = status.query != SessionQuery()
        text = tr("1 session") if status.total == 1 else tr("%n sessions", "", status.total)
        if filtered:
            some = tr("{found} of 1 session") if status.total == 1 else tr("{found} of %n sessions", "", status.total)
            text = some.format(found=len(status.sessions))
        role = "dim"
        if status.detail:
            text, role = status.detail, "amber"
        if status.updating:
            text = tr("{found} · updating…").format(found=text) if status.total else tr("Updating the list…")
        self._status.setText(text)
        self._theme.color_text(self._status, role)
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
        self._place_empty()

    # ---- commands

    def selected(self) -> list[SessionEntry]:
        """Selected sessions, top to bottom."""
        rows = sorted(index.row() for index in self.table.selectionModel().selectedRows())
        return [self.model.entry(row) for row in rows]

    def _on_selection_changed(self, _selected: object, _deselected: object) -> None:
        self._show_buttons()

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

    def _on_row_chosen(self, index: QModelIndex) -> None:
        self._open_replay(self.model.entry(index.row()).folder)

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

    def _on_hit_entered(self) -> None:
        index = self.hit_list.currentIndex()
        if index.isValid():
            self._on_hit_chosen(index)

    def _on_export(self) -> None:
        folders = [entry.folder for entry in self.selected()]
        if folders:
            self.export_requested.emit(folders)

    def _open_folder(self) -> None:
        chosen = self.selected()
        if len(chosen) == 1:
            QDesktopServices.openUrl(QUrl.fromLocalFile(str(chosen[0].folder)))

    # ---- style

    def _style(self) -> None:
        self.table.setFont(self._theme.font(tokens.STATUS_PX + 1))
        for label in (self._status, self._found, self._lacks):
            self._theme.style_text(label, "dim", tokens.STATUS_PX)
        self._theme.color_text(self._lacks, "amber")
        self._theme.color_text(self._empty, "dim")
        self._say(self._library.found.value)
        self.table.viewport().update()
        self.update()

    def _place_empty(self) -> None:
        self._empty.setGeometry(self.table.viewport().geometry())

    def resizeEvent(self, event: Any) -> None:
        super().resizeEvent(event)
        QTimer.singleShot(0, self, self._place_empty)

    def showEvent(self, event: QShowEvent) -> None:
        super().showEvent(event)
        self.search.setFocus(Qt.FocusReason.OtherFocusReason)
        self.refresh()
        QTimer.singleShot(0, self, self._place_empty)

    def closeEvent(self, event: QCloseEvent) -> None:
        super().closeEvent(event)
        self.closed.emit()

    def keyPressEvent(self, event: QKeyEvent) -> None:
        if event.key() == Qt.Key.Key_Down and self.search.hasFocus() and self.model.rowCount():
            self.table.setFocus(Qt.FocusReason.OtherFocusReason)
        else:
            super().keyPressEvent(event)

    def paintEvent(self, _event: QPaintEvent) -> None:
        QPainter(self).fillRect(self.rect(), self._theme.color("window"))
