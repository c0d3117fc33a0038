"""Session panel: recording controls, marks, and an event log with the newest entry at the bottom."""

import bisect
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from PySide6.QtCore import QAbstractListModel, QModelIndex, QPoint, QRect, QSize, Qt, QUrl
from PySide6.QtGui import QDesktopServices, QFont, QFontMetrics, QHelpEvent, QPainter, QResizeEvent
from PySide6.QtWidgets import (
    QAbstractItemView,
    QMenu,
    QStyleOptionViewItem,
    QToolTip,
    QVBoxLayout,
    QWidget,
)

from caris_desktop.domain import intents
from caris_desktop.domain.events import Marked
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.state import PresentClock
from caris_desktop.live.status import RecordingStatus
from caris_desktop.scenario.scenario_model import PanelSettings
from caris_desktop.ui import event_messages, text_formatting, tokens
from caris_desktop.ui.panel import Panel, PanelContext, show_part
from caris_desktop.ui.people.shown_people import name_of
from caris_desktop.ui.status_bar import ROOM_LOW_S
from caris_desktop.ui.text_formatting import wrapped_tip
from caris_desktop.ui.theme import draw_icon
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.fast_table_view import FastTableView
from caris_desktop.ui.widgets.flow_layout import FlowRow
from caris_desktop.ui.widgets.labels import label, restyle
from caris_desktop.ui.widgets.row_delegate import Index, RowDelegate

LOG_ROWS = 2000
LOG_LINE_PX, LOG_LEAST_LINES = 26, 3
_AROUND_PX = 16
_EVERYTHING = QT_TR_NOOP("Everything")
_ICONS = {
    QT_TR_NOOP("Said"): "chat-text", QT_TR_NOOP("Moved"): "navigation-arrow", QT_TR_NOOP("People"): "user",
    QT_TR_NOOP("Session"): "info", QT_TR_NOOP("Problems"): "warning",
}  # fmt: skip
_SHOWN = {
    "everything": "", "said": event_messages.SAID, "moved": event_messages.MOVED, "people": event_messages.PEOPLE,
    "session": event_messages.SESSION, "problems": event_messages.PROBLEMS,
}  # fmt: skip
_CATEGORY_ROLE = int(Qt.ItemDataRole.UserRole)
_TIME_ROLE = _CATEGORY_ROLE + 1
IN_SESSION = ("starting", "recording", "paused")


class LogEntry(Value):
    """Log line. A later one with the same ``key`` replaces it."""

    stamp_ns: int
    category: str
    sentence: str
    key: str = ""


class SessionPanel(Panel):
    """Start, pause and stop, mark labels, and the log."""

    title = QT_TR_NOOP("Session")
    reads = ()

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("session_panel")
        self._toggle = ActionButton(self.theme, tr("Start recording"), icon="record", role="primary")
        self._toggle.setObjectName("session_toggle")
        self._toggle.clicked.connect(self._on_toggle)
        self._summary = label("", "small", wraps=True, objectName="session_what")
        self._folder = ActionButton(self.theme, "", icon="folder-open")
        self._folder.setAccessibleName(tr("Open folder"))
        self._folder.setToolTip(tr("Open the folder of the last session"))
        self._folder.setObjectName("session_folder")
        self._folder.clicked.connect(self._open_folder)
        self._export = ActionButton(self.theme, tr("Export…"), icon="export")
        self._export.setObjectName("session_export")
        self._export.setToolTip(tr("Export the last session as tables, for ELAN, as a report, …"))
        self._export.clicked.connect(lambda: self.window_requested.emit("export"))
        self._sessions = ActionButton(self.theme, tr("All sessions"), icon="archive")
        self._sessions.setObjectName("session_all")
        self._sessions.setToolTip(tr("Find, replay and export the sessions of this study"))
        self._sessions.clicked.connect(lambda: self.window_requested.emit("sessions"))
        self._has_library = False
        self._pause = ActionButton(self.theme, tr("Pause"), icon="pause")
        self._pause.setObjectName("session_pause")
        self._pause.clicked.connect(self._on_pause)
        self._note = ActionButton(self.theme, tr("Note"), icon="note-pencil")
        self._note.setObjectName("session_note")
        self._note.setToolTip(tr("Write a note about this moment"))
        self._note.bind(self.table, "note")
        self._labels = FlowRow(gap_px=6)
        self._label_buttons: list[ActionButton] = []
        self._show_labels()
        self._filter = ActionButton(
            self.theme, tr("Everything"), height_px=30, text_px=tokens.STATUS_PX + 1, menu_arrow=True
        )
        self._filter.setObjectName("log_filter")
        self._filter.setToolTip(tr("Events to show"))
        self._category = ""
        self._filter_menu = QMenu(self)
        self._filter_menu.setObjectName("log_filter_menu")
        for category in ("", *event_messages.CATEGORIES):
            action = self._filter_menu.addAction(tr(category or _EVERYTHING))
            action.triggered.connect(lambda _checked=False, chosen=category: self.show_category(chosen))
        self._filter.clicked.connect(self._open_filter_menu)
        self._model = EventLogModel(self.state.present, self)
        self._log = EventLogView()
        self._log.setObjectName("event_log")
        self._log.setAccessibleName(tr("Event log"))
        self._log.setModel(self._model)
        self._log.setItemDelegate(EventDelegate(self.theme, self._log))
        top = self._buttons = FlowRow(gap_px=8)
        for button in (self._toggle, self._pause, self._note, self._folder, self._export, self._sessions):
            top.add(button)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(14, _AROUND_PX // 2, 8, _AROUND_PX // 2)
        layout.setSpacing(8)
        layout.addWidget(top)
        layout.addWidget(self._summary)
        layout.addWidget(self._labels)
        layout.addWidget(self._log, 1)
        self._log.setMinimumHeight(LOG_LEAST_LINES * LOG_LINE_PX)
        self.state.time_jumped.connect(self._on_time_jumped)
        self.state.recording.changed.connect(self._refresh)
        self.state.event_happened.connect(self._on_event)
        self.every(500, self._refresh)
        self._refresh()

    def title_widgets(self) -> list[QWidget]:
        return [self._filter]

    def sizeHint(self) -> QSize:
        return QSize(420, 220)

    def minimumSizeHint(self) -> QSize:
        return QSize(240, 100)

    def log_lines(self) -> list[str]:
        """Log sentences of the selected category, oldest first."""
        return [entry.sentence for entry in self._model.chosen()]

    def show_scenario(self) -> None:
        self._show_labels()
        self._refresh()

    def _show_labels(self) -> None:
        """Create a button per label of the scenario with a row in the action table."""
        labels = [
            label
            for number, label in enumerate(self.console.scenario.recording.labels, start=1)
            if self.table.spec(f"label_{number}") is not None
        ]
        while len(self._label_buttons) > len(labels):
            button = self._label_buttons.pop()
            self._labels.remove(button)
            button.deleteLater()
        for number in range(len(self._label_buttons) + 1, len(labels) + 1):
            button = ActionButton(self.theme, height_px=30, text_px=tokens.STATUS_PX + 1, key_first=True)
            button.setObjectName(f"session_label_{number}")
            button.bind(self.table, f"label_{number}")
            self._labels.add(button)
            button.show()  # hidden widgets take no space
            self._label_buttons.append(button)
        for button, name in zip(self._label_buttons, labels, strict=True):
            button.set_label(name)
            button.setToolTip(tr("Mark this moment: {label}. Hold the key to mark an interval.").format(label=name))

    def save_state(self) -> list[LogEntry]:
        return self._model.entries()

    def restore_state(self, lasting: Sequence[LogEntry]) -> None:
        self._model.replace(lasting)
        self._log.scrollToBottom()

    def use_library(self, *, present: bool) -> None:
        self._has_library = present
        self._refresh()

    def _name_of(self, person_id: str) -> str:
        return name_of(self.console, person_id)

    def _on_event(self, event: object) -> None:
        entry = self._entry_of(event)
        if entry is not None:
            self._model.append(entry)

    def set_in_view(self, in_view: bool) -> None:
        self._model.set_in_view(in_view)
        super().set_in_view(in_view)

    def update_view(self) -> None:
        self._refresh()

    def _entry_of(self, event: object) -> LogEntry | None:
        described = event_messages.event_sentence(event, self._name_of)
        if described is None:
            return None
        stamp_ns: int = getattr(event, "stamp_ns", self.state.present.now_ns())
        return LogEntry(stamp_ns, *described, key=event.mark_id if isinstance(event, Marked) else "")

    def _on_time_jumped(self, events: Iterable[object]) -> None:
        """Rebuild the log for a seek: events up to that time."""
        entries = [self._entry_of(event) for event in events]
        self._model.replace([entry for entry in entries if entry is not None])
        self._log.scrollToBottom()

    def show_category(self, category: str) -> None:
        """Filter the log by one of ``event_words.CATEGORIES``; empty for all."""
        self._filter.set_label(tr(category or _EVERYTHING))
        self._model.set_category(category)
        self._log.scrollToBottom()
        self._category = category
        self.report_choices()

    def choices(self) -> dict[str, Any]:
        return {"category": self._category}

    def use_choices(self, stored: Mapping[str, Any]) -> None:
        if stored.get("category") in ("", *event_messages.CATEGORIES):
            self.show_category(stored["category"])

    def use_settings(self, settings: PanelSettings) -> None:
        self.show_category(_SHOWN[settings.session.shows])

    def _open_filter_menu(self) -> None:
        self._filter_menu.popup(self._filter.mapToGlobal(QPoint(0, self._filter.height() + 4)))

    def _on_toggle(self) -> None:
        if self.state.recording.value.state in IN_SESSION:
            self.console.do(intents.StopRecording())
        else:
            self.window_requested.emit("start")

    def _on_pause(self) -> None:
        self.console.do(intents.PauseRecording(paused=self.state.recording.value.state == "recording"))

    def _open_folder(self) -> None:
        folder: Path | None = self.state.recording.value.folder
        if folder is not None:
            QDesktopServices.openUrl(QUrl.fromLocalFile(str(folder)))

    def _contents_text(self) -> str:
        """Short text on what a session contains."""
        permissions = self.console.scenario.permissions
        photos = tr("photos") if permissions.photos else tr("no photos")
        if not permissions.audio_recording:
            sound = tr("no sound")
        else:
            sound = tr("sound") if self.console.microphone is not None else tr("no sound (no microphone)")
        if permissions.video_recording:
            return tr("robot, speech and events, video, {photos}, {sound}").format(photos=photos, sound=sound)
        return tr("robot, speech and events; no video, {photos}, {sound}").format(photos=photos, sound=sound)

    def _refresh(self) -> None:
        if not self.in_view:
            return
        status: RecordingStatus = self.state.recording.value
        in_session = status.state in IN_SESSION
        at_rest = status.state in ("idle", "failed")
        # A replay cannot record or mark.
        replay = self.table.spec("mark") is None
        in_session, at_rest = in_session and not replay, at_rest and not replay
        show_part(self._folder, status.folder is not None and at_rest)
        show_part(self._export, status.folder is not None and at_rest)
        show_part(self._sessions, self._has_library and at_rest)
        show_part(self._pause, in_session)
        show_part(self._note, status.state == "recording" and self.table.spec("note") is not None)
        paused = status.state == "paused"
        self._pause.set_label(
            tr("Resume") if paused else tr("Pause"),
            icon="record" if paused else "pause",
            role="primary" if paused else "plain",
        )
        self._pause.setToolTip(tr("Resume recording") if paused else tr("Pause recording"))
        self._pause.setEnabled(status.state != "starting")
        self._toggle.setEnabled(status.state not in ("starting", "stopping"))
        if status.state in (*IN_SESSION, "stopping"):
            stop = tr("Saving…") if status.state == "stopping" else tr("Stop recording")
            self._toggle.set_label(stop, icon="stop", role="plain")
        else:
            self._toggle.set_label(tr("Start recording"), icon="record", role="primary")
        role = "dim"
        match status.state:
            case "starting":
                text = tr("Getting ready to record")
                self.set_fact(tr("starting"))
            case "recording":
                text, role = self._size_and_room(status)
                lasted = text_formatting.elapsed((self.state.present.now_ns() - status.started_ns) / 1e9)
                self.set_fact(tr("recording {time}").format(time=lasted), "green")
            case "paused":
                nothing = tr("Nothing is being recorded. {size} so far.")
                text, role = nothing.format(size=text_formatting.size(status.written_bytes)), "amber"
                self.set_fact(tr("paused"), "amber")
            case "stopping":
                text = tr("Finishing the files")
                self.set_fact(tr("saving"))
            case "failed":
                text, role = tr(status.detail) or tr("Nothing is being recorded."), "red"
                self.set_fact(tr("not recording"), "red")
            case _:
                text = tr("Records {what}").format(what=self._contents_text())
                if status.folder is not None:
                    text = tr("Saved in {folder}").format(folder=status.folder.name)
                self.set_fact(tr("not recording"))
        self._summary.setText(text)
        restyle(self._summary, tone=role)
        self._fit()

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        self._fit()

    def _fit(self) -> None:
        """Divide a low panel: some log lines first, then labels; the recording line is dropped first.

        The top bar has the same commands as the buttons.
        """
        width = self.width() - 22
        room_px = self.height() - _AROUND_PX - LOG_LEAST_LINES * LOG_LINE_PX
        replay = self.table.spec("mark") is None
        buttons_px = 0 if replay else self._buttons.heightForWidth(width) + 8
        show_part(self._buttons, not replay and room_px >= buttons_px)
        room_px -= buttons_px
        labels = self.console.scenario.recording.labels if self.table.spec("mark") is not None else ()
        marking = self.state.recording.value.state == "recording" and bool(labels)
        labels_px = self._labels.heightForWidth(width) + 8 if marking else 0
        marking = marking and room_px >= labels_px
        show_part(self._labels, marking)
        room_px -= labels_px if marking else 0
        nothing_is_recorded = self.state.recording.value.state in ("failed", "paused")
        show_part(self._summary, nothing_is_recorded or room_px >= self._summary.heightForWidth(width) + 8)

    def _size_and_room(self, status: RecordingStatus) -> tuple[str, str]:
        """Size so far and remaining disk time, with their colour role."""
        # A replay shows the recorded contents, independent of the current microphone.
        so_far = tr("{size} so far").format(size=text_formatting.size(status.written_bytes))
        if self.table.spec("mark") is not None:
            so_far = tr("{size} so far: {kept}").format(
                size=text_formatting.size(status.written_bytes), kept=self._contents_text()
            )
        parts = [so_far, text_formatting.all_missing(status.dropped)]
        low = status.room_s is not None and status.room_s < ROOM_LOW_S
        if low and status.room_s is not None:
            parts.insert(0, tr("Room for {time} only").format(time=text_formatting.long_duration(status.room_s)))
        return " · ".join(part for part in parts if part), "amber" if low else "dim"


class EventLogModel(QAbstractListModel):
    """Bounded list of recent entries, optionally of one category. The view is updated only while visible."""

    def __init__(self, present: PresentClock, parent: QWidget) -> None:
        super().__init__(parent)
        self._present = present
        self._all: deque[LogEntry] = deque(maxlen=LOG_ROWS)
        self._rows: list[LogEntry] = []
        self._category = ""
        self._in_view = True

    def set_in_view(self, in_view: bool) -> None:
        self._in_view = in_view
        if in_view:
            self.set_category(self._category)

    def append(self, entry: LogEntry) -> None:
        if entry.key and self._renew(entry):
            return
        if len(self._all) >= LOG_ROWS:
            self._all.popleft()
        self._all.insert(_place_of(entry, self._all), entry)
        if not self._in_view or (self._category and entry.category != self._category):
            return
        if len(self._rows) >= LOG_ROWS:
            self.beginRemoveRows(QModelIndex(), 0, 0)
            del self._rows[0]
            self.endRemoveRows()
        row = _place_of(entry, self._rows)
        self.beginInsertRows(QModelIndex(), row, row)
        self._rows.insert(row, entry)
        self.endInsertRows()

    def _renew(self, entry: LogEntry) -> bool:
        """Replace the line of the same key, keeping its time; False if there is none."""
        row = _row_of(entry.key, self._all)
        if row is None:
            return False
        self._all[row] = renewed = replace(entry, stamp_ns=self._all[row].stamp_ns)
        row_number = _row_of(entry.key, self._rows) if self._in_view else None
        if row_number is not None:
            self._rows[row_number] = renewed
            self.dataChanged.emit(self.index(row_number), self.index(row_number))
        return True

    def entries(self) -> list[LogEntry]:
        return list(self._all)

    def replace(self, entries: Sequence[LogEntry]) -> None:
        self._all.clear()
        for entry in sorted(entries, key=lambda entry: entry.stamp_ns):
            if not (entry.key and self._renew(entry)):
                self._all.append(entry)
        self.set_category(self._category)

    def set_category(self, category: str) -> None:
        self._category = category
        if not self._in_view:
            return
        self.beginResetModel()
        self._rows = self.chosen()
        self.endResetModel()

    def chosen(self) -> list[LogEntry]:
        """Entries of the category, including those that the view has not shown yet."""
        return [entry for entry in self._all if not self._category or entry.category == self._category]

    def rowCount(self, parent: Index = QModelIndex()) -> int:  # noqa: B008
        return 0 if parent.isValid() else len(self._rows)

    def data(self, index: Index, role: int = int(Qt.ItemDataRole.DisplayRole)) -> Any:
        entry = self._rows[index.row()]
        if role == Qt.ItemDataRole.DisplayRole:
            return entry.sentence
        if role == _CATEGORY_ROLE:
            return entry.category
        if role == _TIME_ROLE:
            return text_formatting.clock_time(entry.stamp_ns, self._present.anchor)
        if role == Qt.ItemDataRole.AccessibleTextRole:
            return f"{text_formatting.clock_time(entry.stamp_ns, self._present.anchor)} {entry.sentence}"
        return None


def _place_of(entry: LogEntry, rows: Sequence[LogEntry] | deque[LogEntry]) -> int:
    """Insertion index by time: events of several processes arrive slightly out of order."""
    return bisect.bisect_right(rows, entry.stamp_ns, key=lambda row: row.stamp_ns)


def _row_of(key: str, rows: Sequence[LogEntry] | deque[LogEntry]) -> int | None:
    return next((row for row in reversed(range(len(rows))) if rows[row].key == key), None)


class EventDelegate(RowDelegate):
    """Row with time, icon and sentence; the tooltip shows an elided sentence."""

    _TIME_WIDTH_PX = 68
    _ICON_WIDTH_PX = 26

    def paint_row(self, painter: QPainter, rect: QRect, index: Index) -> None:
        category = str(index.data(_CATEGORY_ROLE))
        problem = category == "Problems"
        time_rect = QRect(rect.topLeft(), QSize(self._TIME_WIDTH_PX, rect.height()))
        self.paint_text(painter, time_rect, str(index.data(_TIME_ROLE)), self._theme.font(tokens.STATUS_PX), "dim")
        icon_rect = QRect(rect.left() + self._TIME_WIDTH_PX, rect.center().y() - 7, 15, 15)
        role = "amber" if problem else "dim"
        draw_icon(painter, icon_rect.toRectF(), _ICONS.get(category, "info"), self._theme.color(role))
        ink = "amber" if problem else "text"
        self.paint_text(painter, self._text_rect(rect), str(index.data()), self._font(), ink)

    def helpEvent(self, event: QHelpEvent, view: QAbstractItemView, option: QStyleOptionViewItem, index: Index) -> bool:
        sentence = str(index.data() or "")
        width = QFontMetrics(self._font()).horizontalAdvance(sentence)
        cut = width > self._text_rect(option.rect).width()
        QToolTip.showText(event.globalPos(), wrapped_tip(sentence) if cut else "", view)
        return True

    def _font(self) -> QFont:
        return self._theme.font(tokens.STATUS_PX + 1)

    def _text_rect(self, rect: QRect) -> QRect:
        return rect.adjusted(self._TIME_WIDTH_PX + self._ICON_WIDTH_PX, 0, -4, 0)


class EventLogView(FastTableView):
    """Follows the newest row until the wizard scrolls up."""

    def __init__(self) -> None:
        super().__init__(row_px=LOG_LINE_PX)
        self._at_end = True
        bar = self.verticalScrollBar()
        bar.valueChanged.connect(self._on_scrolled)
        bar.rangeChanged.connect(self._on_range_changed)

    def _on_scrolled(self, value: int) -> None:
        self._at_end = value >= self.verticalScrollBar().maximum() - 8

    def _on_range_changed(self, _minimum: int, maximum: int) -> None:
        if self._at_end:
            self.verticalScrollBar().setValue(maximum)

    def resizeEvent(self, event: QResizeEvent) -> None:
        at_end = self._at_end
        super().resizeEvent(event)
        self._at_end = at_end
        self._on_range_changed(0, self.verticalScrollBar().maximum())
