"""Notes panel: the wizard's notes, each with its time."""

from operator import attrgetter
from typing import Any

from PySide6.QtCore import (
    QAbstractItemModel,
    QEvent,
    QModelIndex,
    QPoint,
    QRect,
    QSize,
    Qt,
    Signal,
)
from PySide6.QtGui import QFontMetrics, QKeyEvent, QPainter, QResizeEvent, QStandardItem
from PySide6.QtWidgets import (
    QFrame,
    QListView,
    QPlainTextEdit,
    QStackedLayout,
    QStyleOptionViewItem,
    QWidget,
)

from caris_desktop.domain import intents
from caris_desktop.domain.translation import QT_TR_NOOP, tr
from caris_desktop.recording.session.session_marks import FinalMark
from caris_desktop.ui import layouts, text_formatting, tokens
from caris_desktop.ui.panel import Panel, PanelContext, show_part
from caris_desktop.ui.theme import Theme
from caris_desktop.ui.widgets.buttons import ActionButton
from caris_desktop.ui.widgets.containers import FlowRow
from caris_desktop.ui.widgets.inputs import SubmitLineEdit
from caris_desktop.ui.widgets.labels import label, named
from caris_desktop.ui.widgets.rows import VALUE_ROLE, Index, KeyedItems, RowDelegate, set_up_list

_TIME_PX, _SIDE_PX, _ABOVE_PX = 72, 12, 5
_TIME_ROLE = VALUE_ROLE + 1
_LONGEST = 1000
_SHARE_OF_STUDY = 0.5
_WITHOUT_NOTES_PX = 124  # the field, and two lines in place of the notes
_AROUND_STUDY_PX = 56  # margins, frame and scroll bar next to the text
_MANY_PX = 100_000
_ROOMY_PX = 220
_AT_ONCE_UNDONE = 50
_LIST_KEYS = (Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_Delete)


class NotesPanel(Panel):
    """Notes of the session in chronological order, with a field for the next one.

    A note's time is when its writing began. A click selects it for editing or removal, which can be undone; in a replay
    it seeks to its time.
    """

    title = QT_TR_NOOP("Notes")
    preferred_size, least_size = QSize(320, 240), QSize(200, 110)
    reads = ()

    def __init__(self, context: PanelContext) -> None:
        super().__init__(context)
        self.setObjectName("notes_panel")
        self._began_ns: int | None = None
        self._changing = ""  # the note being edited
        self._undo_with: list[intents.Intent] = []
        self.model = KeyedItems[FinalMark](self, attrgetter("mark_id"), self._fill)
        self.view = named(NotesView(self.theme, self.model), "notes_list", tr("Notes"))
        self.view.clicked.connect(self._on_clicked)
        self.view.activated.connect(self._on_activated)
        self.view.removal_requested.connect(self.remove_current)
        self.view.undo_requested.connect(self.undo)
        self._of_study = named(QPlainTextEdit(readOnly=True, tabChangesFocus=True), "notes_of_study")
        self._of_study.setAccessibleName(tr("Notes from the scenario"))
        self._of_study.setFrameShape(QFrame.Shape.NoFrame)
        self._unfolded: bool | None = None  # None: automatic, shown if there is room and no note
        self._fold = self._small_button("notes_fold", tr("Scenario"), "", self._on_fold)
        self._fold.setToolTip(tr("Show or hide the scenario's notes"))
        self._show_study()
        self._empty = label("", "note", wraps=True, objectName="notes_empty", alignment=Qt.AlignmentFlag.AlignCenter)
        self._empty.setContentsMargins(20, 4, 20, 4)
        self._change = self._small_button("notes_change", tr("Change"), "pencil-simple", self.change_current)
        self._remove = self._small_button("notes_remove", tr("Remove"), "trash", self.remove_current)
        self._undo = self._small_button("notes_undo", tr("Undo"), "arrow-u-up-left", self.undo)
        self._acts = FlowRow(self._change, self._remove, self._undo, gap_px=6)
        self.field = SubmitLineEdit(objectName="notes_field", maxLength=_LONGEST, textEdited=self._on_edited)
        self.field.setFixedHeight(tokens.CONTROL_HEIGHT_PX)
        self.field.returnPressed.connect(self._on_entered)
        self.hold.escape_pressed.connect(self._give_up_changing)
        holder = QWidget()
        self._stack = QStackedLayout(holder)
        self._stack.addWidget(self.view)
        self._stack.addWidget(self._empty)
        below = layouts.vbox(None, self._acts, self.field, margins_px=(_SIDE_PX, 0, _SIDE_PX, 2), spacing_px=6)
        of_study = layouts.vbox(None, self._of_study, margins_px=(_SIDE_PX, 2, _SIDE_PX, 0))
        layouts.vbox(self, of_study, (holder, 1), below, margins_px=(1, 4, 1, 8), spacing_px=4)
        self.watch(self._on_changed, self.state.notes.changed, self.state.recording.changed)
        self.view.selectionModel().currentChanged.connect(self._on_changed)
        self.update_view()

    def _small_button(self, name: str, text: str, icon: str, slot: Any) -> ActionButton:
        return ActionButton(
            self.theme, text, icon=icon, height_px=30, text_px=tokens.STATUS_PX + 1, objectName=name, clicked=slot
        )

    def title_widgets(self) -> list[QWidget]:
        return [self._fold]

    def show_scenario(self) -> None:
        self._show_study()
        self.update_view()

    def _show_study(self) -> None:
        """Show the scenario's notes for the wizard with a button that folds them, if there are any."""
        text = self.console.scenario.notes.strip()
        if text != self._of_study.toPlainText():
            self._of_study.setPlainText(text)
            self._unfolded = None
        show_part(self._fold, bool(text))

    def _on_fold(self) -> None:
        self._unfolded = self._of_study.isHidden()
        self.fit()

    def fit(self) -> None:
        """Size the scenario's notes: as high as needed, at most half of the panel, or more while it has no others."""
        text = self._of_study
        unfolded = self._unfolded
        if unfolded is None:
            unfolded = self.height() >= _ROOMY_PX and not self.state.notes.value
        show_part(text, unfolded and bool(text.toPlainText()))
        icon = "caret-down" if unfolded else "caret-right"
        name = tr("Hide the scenario's notes") if unfolded else tr("Show the scenario's notes")
        self._fold.set_label(tr("Scenario"), icon=icon, name=name)
        room = QRect(0, 0, self.width() - _AROUND_STUDY_PX, _MANY_PX)
        wrapped = text.fontMetrics().boundingRect(room, int(Qt.TextFlag.TextWordWrap), text.toPlainText())
        needed = wrapped.height() + _AROUND_STUDY_PX // 2
        most = round(self.height() * _SHARE_OF_STUDY)
        if not self.state.notes.value:
            most = max(most, self.height() - _WITHOUT_NOTES_PX)
        text.setFixedHeight(min(needed, most))

    def focus_target(self) -> QWidget:
        return self.field if self._may_write else self.view

    @property
    def _may_write(self) -> bool:
        return self.state.present.live

    # ---- display

    def update_view(self) -> None:
        self._on_changed()

    def _on_changed(self, *_values: object) -> None:
        if not self.in_view:
            return
        self.fit()
        notes: tuple[FinalMark, ...] = self.state.notes.value
        if self._changing and all(note.mark_id != self._changing for note in notes):
            self._give_up_changing()
        self.model.show_values(notes)
        self._stack.setCurrentWidget(self.view if notes else self._empty)
        recording = self.state.recording.value.state == "recording"
        count = len(notes)
        self.set_fact("" if not count else tr("1 note") if count == 1 else tr("%n notes", "", count))
        self._empty.setText(
            tr("No notes in this session.") if not self._may_write
            else tr("Your notes appear here with their time and are saved in the session.") if recording
            else tr("Notes are saved while a session is being recorded.")
        )  # fmt: skip
        chosen = self._current() is not None and not self._changing
        show_part(self._change, chosen and self._may_write)
        show_part(self._remove, chosen and self._may_write)
        show_part(self._undo, bool(self._undo_with) and recording)
        show_part(self._acts, self._may_write and ((chosen and bool(notes)) or bool(self._undo_with)))
        show_part(self.field, self._may_write)
        hint = tr("Edit the note, Enter saves it") if self._changing else tr("Write a note, Enter adds it")
        self.field.setPlaceholderText(hint)
        self.field.setAccessibleName(hint)
        self.field.setToolTip(tr("The note gets the time at which you start writing. A word like #laughs is a tag."))

    def _fill(self, item: QStandardItem, note: FinalMark) -> None:
        at = text_formatting.clock_time(note.start_ns, self.state.present.anchor)
        text = f"{note.label}: {note.note}" if note.label else note.note
        item.setText(text)
        item.setData(at, _TIME_ROLE)
        spoken = tr("{time}, {note}").format(time=at, note=f"{text} {changed_words(note)}".strip())
        item.setData(spoken, Qt.ItemDataRole.AccessibleTextRole)

    def _current(self) -> FinalMark | None:
        note: FinalMark | None = self.view.currentIndex().data(VALUE_ROLE)
        return note

    # ---- commands

    def _on_edited(self, text: str) -> None:
        if not text:
            self._began_ns = None
        elif self._began_ns is None:
            self._began_ns = self.state.present.now_ns()

    def _on_entered(self) -> None:
        text = " ".join(self.field.text().split())
        if not text:
            return
        if self._changing:
            note = next((note for note in self.state.notes.value if note.mark_id == self._changing), None)
            if note is not None and note.note != text:
                self._do(intents.ChangeNote(note.mark_id, text), intents.ChangeNote(note.mark_id, note.note))
            self._give_up_changing()
            return
        now_ns = self.state.present.now_ns()
        earlier_s = min(86_400.0, (now_ns - (self._began_ns or now_ns)) / 1e9)
        added = intents.AddNote(text, earlier_s=earlier_s)
        if self._do(added, intents.RemoveNote(added.note_id)):
            self.field.clear()
            self._began_ns = None
            self.view.scrollToBottom()

    def change_current(self) -> None:
        """Edit the selected note in the field."""
        note = self._current()
        if note is not None and self._may_write:
            self._changing = note.mark_id
            self.field.setText(note.note)
            self.field.setFocus(Qt.FocusReason.OtherFocusReason)
            self._on_changed()

    def remove_current(self) -> None:
        note = self._current()
        if note is not None and self._may_write:
            is_note = note.kind == "note"
            back = intents.RestoreNote(note.mark_id) if is_note else intents.ChangeNote(note.mark_id, note.note)
            self._do(intents.RemoveNote(note.mark_id), back)

    def undo(self) -> None:
        """Undo the last edit in this panel; the record keeps both."""
        if self._undo_with:
            self.console.do(self._undo_with.pop())
            self._on_changed()

    def _do(self, intent: intents.Intent, back: intents.Intent) -> bool:
        done = not self.console.do(intent)
        if done:
            self._undo_with = [*self._undo_with, back][-_AT_ONCE_UNDONE:]
            self._on_changed()
        return done

    def _give_up_changing(self) -> None:
        if self._changing:
            self._changing = ""
            self.field.clear()
            self._on_changed()

    def _on_clicked(self, index: QModelIndex) -> None:
        if not self._may_write:
            self.moment_requested.emit(index.data(VALUE_ROLE).start_ns)

    def _on_activated(self, index: QModelIndex) -> None:
        if self._may_write:
            self.change_current()
        else:
            self._on_clicked(index)

    def save_state(self) -> tuple[str, int | None]:
        return ("" if self._changing else self.field.text(), self._began_ns)

    def restore_state(self, lasting: tuple[str, int | None]) -> None:
        text, self._began_ns = lasting
        self.field.setText(text)


def changed_words(note: FinalMark) -> str:
    """ "changed" for a note that was edited; the session has both versions."""
    return tr("edited") if note.rewritten else ""


class NotesView(QListView):
    """Rows of variable height."""

    removal_requested = Signal()
    undo_requested = Signal()

    def __init__(self, theme: Theme, model: QAbstractItemModel) -> None:
        super().__init__()
        self.setModel(model)
        self.setItemDelegate(_NoteDelegate(theme, self))
        self.setResizeMode(QListView.ResizeMode.Adjust)
        set_up_list(self)

    def event(self, event: QEvent) -> bool:
        if event.type() == QEvent.Type.ShortcutOverride and isinstance(event, QKeyEvent):
            with_ctrl = event.modifiers() & Qt.KeyboardModifier.ControlModifier
            if event.key() in _LIST_KEYS or (with_ctrl and event.key() == Qt.Key.Key_Z):
                event.accept()
                return True
        return super().event(event)

    def keyPressEvent(self, event: QKeyEvent) -> None:
        with_ctrl = bool(event.modifiers() & Qt.KeyboardModifier.ControlModifier)
        if event.key() == Qt.Key.Key_Delete:
            self.removal_requested.emit()
        elif event.key() == Qt.Key.Key_Z and with_ctrl:
            self.undo_requested.emit()
        elif event.key() in (Qt.Key.Key_Return, Qt.Key.Key_Enter, Qt.Key.Key_F2) and self.currentIndex().isValid():
            self.activated.emit(self.currentIndex())
        else:
            super().keyPressEvent(event)

    def resizeEvent(self, event: QResizeEvent) -> None:
        super().resizeEvent(event)
        if event.size().width() != event.oldSize().width():
            self.scheduleDelayedItemsLayout()


class _NoteDelegate(RowDelegate):
    """Time on the left, edit mark below it, wrapped text on the right."""

    def __init__(self, theme: Theme, view: QListView) -> None:
        super().__init__(theme, view)
        self._view = view

    def sizeHint(self, _option: QStyleOptionViewItem, index: Index) -> QSize:
        width = self._view.viewport().width()
        metrics = QFontMetrics(self._theme.font(tokens.BODY_PX))
        room = QRect(0, 0, max(40, width - _TIME_PX - 2 * _SIDE_PX), 10_000)
        height = metrics.boundingRect(room, int(Qt.TextFlag.TextWordWrap), str(index.data())).height()
        lines = 2 if index.data(VALUE_ROLE).rewritten else 1
        least = lines * (QFontMetrics(self._theme.font(tokens.STATUS_PX)).height() + 1)
        return QSize(max(1, width), max(height, least) + 2 * _ABOVE_PX)

    def paint_row(self, painter: QPainter, rect: QRect, index: Index) -> None:
        if index.row() == self._view.currentIndex().row():
            painter.fillRect(rect, self._theme.color("raised"))
        inner = rect.adjusted(_SIDE_PX, _ABOVE_PX, -_SIDE_PX, -_ABOVE_PX)
        top = int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop)
        painter.setFont(self._theme.font(tokens.STATUS_PX))
        painter.setPen(self._theme.color("dim"))
        aside = QRect(inner.topLeft(), QSize(_TIME_PX - 6, inner.height()))
        painter.drawText(aside.translated(QPoint(0, 1)), top, str(index.data(_TIME_ROLE)))
        note: FinalMark = index.data(VALUE_ROLE)
        if note.rewritten:
            painter.drawText(aside, int(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignBottom), changed_words(note))
        painter.setFont(self._theme.font(tokens.BODY_PX))
        painter.setPen(self._theme.color("text"))
        painter.drawText(inner.adjusted(_TIME_PX, 0, 0, 0), top | int(Qt.TextFlag.TextWordWrap), str(index.data()))
