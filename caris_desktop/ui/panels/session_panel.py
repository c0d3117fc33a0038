"""Session panel: recording controls, marks, and an event log with the newest entry at the bottom."""

import bisect
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from PySide6.QtCore import QPoint, QRect, QSize, Qt, QUrl
from PySide6.QtGui import QDesktopServices, QFont, QFontMetrics, QHelpEvent, QPainter, QResizeEvent, QStandardItem
from PySide6.QtWidgets import (
    QAbstractItemView,
    QMenu,
    QStyleOptionViewItem,
    QToolTip,
    QWidget,
)

from caris_desktop.domain import intents
from caris_desktop.domain.events import Marked
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.domain.value_class import Value
from caris_desktop.live.status import RecordingStatus
from caris_desktop.scenario.scenario_model import PanelSettings
from caris_desktop.ui import event_messages, layouts, text_formatting, tokens
from caris_desktop.ui.panel import Panel, PanelContext, show_part
from caris_desktop.ui.people.shown_people import name_of
from caris_desktop.ui.status_bar import ROOM_LOW_S
from caris_desktop.ui.text_formatting import wrapped_tip
from caris_desktop.ui.theme import draw_icon
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import FlowRow
from caris_desktop.ui.widgets.labels import label, named, restyle
from caris_desktop.ui.widgets.rows import VALUE_ROLE, FastTableView, Index, KeyedItems, RowDelegate

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
_TIME_ROLE = VALUE_ROLE + 1
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
    preferred_size, least_size = QSize(420, 220), QSize(240, 100)
    reads = ()

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("session_panel")
        button = partial(ActionButton, self.theme)
        self._toggle = button(tr("Start recording"), icon="record", role="primary", objectName="session_toggle")
        self._toggle.clicked.connect(self._on_toggle)
        self._summary = label("", "small", wraps=True, objectName="session_what")
        self._folder = button(icon="folder-open", objectName="session_folder", clicked=self._open_folder)
        self._folder.setAccessibleName(tr("Open folder"))
        self._folder.setToolTip(tr("Open the folder of the last session"))
        self._export = button(tr("Export…"), icon="export", objectName="session_export")
        self._export.setToolTip(tr("Export the last session as tables, for ELAN, as a report, …"))
        self._export.clicked.connect(lambda: self.window_requested.emit("export"))
        self._sessions = button(tr("All sessions"), icon="archive", objectName="session_all")
        self._sessions.setToolTip(tr("Find, replay and export the sessions of this study"))
        self._sessions.clicked.connect(lambda: self.window_requested.emit("sessions"))
        self._has_library = False
        self._pause = button(tr("Pause"), icon="pause", objectName="session_pause", clicked=self._on_pause)
        self._note = button(tr("Note"), icon="note-pencil", objectName="session_note")
        self._note.setToolTip(tr("Write a note about this moment"))
        self._note.bind(self.table, "note")
        self._labels = FlowRow(gap_px=6)
        self._label_buttons: list[ActionButton] = []
        self._show_labels()
        self._filter = button(
            tr("Everything"), height_px=30, text_px=tokens.STATUS_PX + 1, menu_arrow=True, objectName="log_filter",
            toolTip=tr("Events to show"), clicked=self._open_filter_menu,
        )  # fmt: skip
        self._category = ""
        self._filter_menu = named(QMenu(self), "log_filter_menu")
        for category in ("", *event_messages.CATEGORIES):
            action = self._filter_menu.addAction(tr(category or _EVERYTHING))
            action.triggered.connect(lambda _checked=False, chosen=category: self.show_category(chosen))
        self._entries: list[LogEntry] = []
        self._model = KeyedItems[LogEntry](self, lambda entry: entry.key or id(entry), self._fill)
        self._log = named(EventLogView(), "event_log", tr("Event log"))
        self._log.setModel(self._model)
        self._log.setItemDelegate(EventDelegate(self.theme, self._log))
        self._log.setMinimumHeight(LOG_LEAST_LINES * LOG_LINE_PX)
        self._buttons = FlowRow(self._toggle, self._pause, self._note, self._folder, self._export, self._sessions)
        around = (14, _AROUND_PX // 2, 8, _AROUND_PX // 2)
        layouts.vbox(self, self._buttons, self._summary, self._labels, (self._log, 1), margins_px=around, spacing_px=8)
        self.state.time_jumped.connect(self._on_time_jumped)
        self.state.recording.changed.connect(self._refresh)
        self.state.event_happened.connect(self._on_event)
        self.every(500, self._refresh)
        self._refresh()

    def title_widgets(self) -> list[QWidget]:
        return [self._filter]

    def log_lines(self) -> list[str]:
        """Log sentences of the selected category, oldest first."""
        return [entry.sentence for entry in self._chosen()]

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
        return list(self._entries)

    def restore_state(self, lasting: Sequence[LogEntry]) -> None:
        self._replace_log(lasting)

    def use_library(self, *, present: bool) -> None:
        self._has_library = present
        self._refresh()

    def _name_of(self, person_id: str) -> str:
        return name_of(self.console, person_id)

    def _on_event(self, event: object) -> None:
        entry = self._entry_of(event)
        if entry is not None:
            self._add(entry)
            if self.in_view:
                self._show_log()

    def update_view(self) -> None:
        self._show_log()
        self._refresh()

    # ---- log

    def _add(self, entry: LogEntry) -> None:
        """Add an entry by time, as events of several processes arrive slightly out of order; or replace the one of the
        same key, with its time.
        """
        entries = self._entries
        rows = reversed(range(len(entries))) if entry.key else ()
        row = next((row for row in rows if entries[row].key == entry.key), None)
        if row is not None:
            entries[row] = replace(entry, stamp_ns=entries[row].stamp_ns)
            return
        if len(entries) >= LOG_ROWS:
            gone = entries.pop(0)
            if self._model.values and self._model.values[0] is gone:
                self._model.remove_first()
        bisect.insort_right(entries, entry, key=lambda each: each.stamp_ns)

    def _replace_log(self, entries: Iterable[LogEntry]) -> None:
        self._entries.clear()
        for entry in sorted(entries, key=lambda entry: entry.stamp_ns):
            self._add(entry)
        self._show_log()
        self._log.scrollToBottom()

    def _chosen(self) -> list[LogEntry]:
        return [entry for entry in self._entries if self._category in ("", entry.category)]

    def _show_log(self) -> None:
        self._model.show_values(self._chosen())

    def _fill(self, item: QStandardItem, entry: LogEntry) -> None:
        at = text_formatting.clock_time(entry.stamp_ns, self.state.present.anchor)
        item.setText(entry.sentence)
        item.setData(at, _TIME_ROLE)
        item.setData(f"{at} {entry.sentence}", Qt.ItemDataRole.AccessibleTextRole)

    def _entry_of(self, event: object) -> LogEntry | None:
        described = event_messages.event_sentence(event, self._name_of)
        if described is None:
            return None
        stamp_ns: int = getattr(event, "stamp_ns", self.state.present.now_ns())
        return LogEntry(stamp_ns, *described, key=event.mark_id if isinstance(event, Marked) else "")

    def _on_time_jumped(self, events: Iterable[object]) -> None:
        """Rebuild the log for a seek: events up to that time."""
        self._replace_log(entry for event in events if (entry := self._entry_of(event)) is not None)

    def show_category(self, category: str) -> None:
        """Filter the log by one of ``event_words.CATEGORIES``; empty for all."""
        self._filter.set_label(tr(category or _EVERYTHING))
        self._category = category
        self._show_log()
        self._log.scrollToBottom()
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
            case "recording":
                text, role = self._size_and_room(status)
            case "paused":
                nothing = tr("Nothing is being recorded. {size} so far.")
                text, role = nothing.format(size=text_formatting.size(status.written_bytes)), "amber"
            case "stopping":
                text = tr("Finishing the files")
            case "failed":
                text, role = tr(status.detail) or tr("Nothing is being recorded."), "red"
            case _:
                text = tr("Records {what}").format(what=self._contents_text())
                if status.folder is not None:
                    text = tr("Saved in {folder}").format(folder=status.folder.name)
        # The button in the top bar says every other state.
        self.set_fact(tr("not recording") if status.state == "failed" else "", role)
        self._summary.setText(text)
        restyle(self._summary, tone=role)
        self.fit()

    def fit(self) -> None:
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


class EventDelegate(RowDelegate):
    """Row with time, icon and sentence; the tooltip shows an elided sentence."""

    _TIME_WIDTH_PX = 68
    _ICON_WIDTH_PX = 26

    def paint_row(self, painter: QPainter, rect: QRect, index: Index) -> None:
        category = index.data(VALUE_ROLE).category
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
